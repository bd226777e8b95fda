"""A force's bias is taken off pushes that show it, and off the session's others if all agree."""

import numpy as np
import pytest
from tables import POSE, SETUP, TIME, TIP, written

from slipmap.models.measurements.importing import import_dataset

LATE = TIME > 0.6  # the finger already pushes
FORCE = np.column_stack([2.0 * (np.gradient(POSE[:, 0]) > 1e-6), 0.0 * TIME])


def imported(tmp_path, biases, late=()):
    """Pushes with biases of their own, some of which are recorded from after the touch on."""
    for number, bias in enumerate(biases):
        rows = LATE if number in late else np.ones(len(TIME), dtype=bool)
        force = FORCE + bias + 0.002 * np.sin(7.0 * np.arange(len(TIME)))[:, None]
        columns = [each[rows] for each in (TIME, POSE, TIP + np.array([0.0, 0.001 * number]), force)]
        written(tmp_path / f"p{number}.csv", ["t", "x", "y", "theta", "a", "b", "fx", "fy"], columns)
    (tmp_path / "setup.yaml").write_text(
        SETUP + "tip_pose: {position: [a, b]}\nft_wrench: {force: [fx, fy]}\n"
    )
    told: list[str] = []
    return import_dataset(tmp_path, tmp_path / "setup.yaml", tell=told.append), told


def pushing(dataset):
    """(k, 2) median force of each push while the object moves, N."""
    found = []
    for trial in dataset.trials:
        force = trial.ft_wrench
        found.append(np.median(force.values[(force.time > 0.7) & (force.time < 1.1), :2], axis=0))
    return np.array(found)


def test_a_push_without_rows_before_touch_takes_the_bias_of_the_others(tmp_path):
    dataset, told = imported(tmp_path, [(9.0, -3.0), (9.1, -3.0), (9.0, -2.9), (9.05, -3.0)], late=(1, 3))
    assert pushing(dataset) == pytest.approx(np.tile([2.0, 0.0], (4, 1)), abs=0.12)
    assert any("of the other pushes taken off" in step for step in dataset.provenance)
    assert not any("the force's bias" in text for text in told)


def test_biases_that_differ_are_not_carried_over_but_told(tmp_path):
    dataset, told = imported(tmp_path, [(9.0, -3.0), (-4.0, 1.0), (1.0, 6.0)], late=(2,))
    assert pushing(dataset)[2] == pytest.approx([3.0, 6.0], abs=0.01)
    (warning,) = [text for text in told if "the force's bias" in text]
    assert warning.startswith("p2.csv: the force's bias is unknown") and "ft_wrench.offset" in warning
    assert "in p0.csv, p1.csv it is up to 9.5 N and differs" in warning


@pytest.mark.parametrize("late", [(1, 2), (1,)])
def test_a_bias_that_a_single_push_shows_is_told_as_such(tmp_path, late):
    _, told = imported(tmp_path, [(400.0, -300.0), (0.0, 0.0), (0.0, 0.0)], late)
    (warning,) = [text for text in told if "the force's bias" in text]
    assert "in p0.csv it is 500 N, and no other push shows one" in warning


def test_a_far_clock_that_one_recording_does_not_show_is_that_of_the_session(tmp_path):
    for number in range(4):
        rows = (TIME > 0.6) & (TIME < 1.15) if number == 0 else np.ones(len(TIME), dtype=bool)
        columns = [each[rows] for each in (TIME, POSE, TIP + np.array([0.0, 0.001 * number]))]
        written(tmp_path / f"p{number}.csv", ["t", "x", "y", "theta", "a", "b"], columns)
        written(tmp_path / f"f{number}.csv", ["t", "fx", "fy"], [TIME[rows] + 77.0, FORCE[rows]])
    (tmp_path / "setup.yaml").write_text(
        SETUP + "object_pose: {source: p*.csv}\ntip_pose: {source: p*.csv, position: [a, b]}\n"
        "ft_wrench: {source: f*.csv, force: [fx, fy]}\n"
    )
    told: list[str] = []
    dataset = import_dataset(tmp_path, tmp_path / "setup.yaml", tell=told.append)
    assert [trial.name for trial in dataset.trials] == [f"p{number}.csv" for number in range(4)]
    assert dataset.trials[0].ft_wrench.time[0] == pytest.approx(0.61, abs=0.03)
    assert any("p0.csv: ft_wrench alone does not show its clock" in text for text in told)


@pytest.mark.parametrize("biases", [[(0.0, 0.0)] * 3, [(0.5, 0.0)] * 3])
def test_nothing_is_told_if_each_push_shows_its_bias(tmp_path, biases):
    dataset, told = imported(tmp_path, biases)
    assert pushing(dataset) == pytest.approx(np.tile([2.0, 0.0], (3, 1)), abs=0.01)
    assert not any("bias" in text for text in told)
