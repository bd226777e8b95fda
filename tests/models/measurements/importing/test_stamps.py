"""Faulty stamps are named and left out; stamps that start anew, and pauses, are not faulty."""

import numpy as np
import pytest
from tables import POSE, SETUP, TIME, TIP, written

from slipmap.models.measurements.importing import import_dataset
from slipmap.models.measurements.importing.clocks import coarse_text, wild_rows

NAMES = ["t", "x", "y", "theta", "a", "b"]


def imported(tmp_path, columns):
    file = written(tmp_path / "push.csv", NAMES, columns)
    (tmp_path / "setup.yaml").write_text(SETUP + "tip_pose: {position: [a, b]}\n")
    told: list[str] = []
    return import_dataset(file, tmp_path / "setup.yaml", tell=told.append).trials, told


def test_single_wrong_stamps_are_left_out_and_named(tmp_path):
    """Neither a zero among them nor a later day cuts the push in pieces."""
    time = TIME.copy()
    time[[40, 60, 61]] = 500.0, 0.0, 0.0
    (trial,), told = imported(tmp_path, [time, POSE, TIP])
    kept = np.delete(TIME, [40, 60, 61])
    assert trial.object_pose.time == pytest.approx(kept)
    assert trial.tip_pose.values == pytest.approx(np.delete(TIP, [40, 60, 61], axis=0), abs=1e-6)
    assert any("the stamps of 3 of 150 rows" in text and "rows 40, 60, 61" in text for text in told)


def test_an_unset_clock_at_the_start_is_left_out(tmp_path):
    time = TIME + 1.7e9
    time[:2] = 0.0
    (trial,), told = imported(tmp_path, [time, POSE, TIP])
    assert len(trial.object_pose.time) == len(TIME) - 2
    assert any("rows 0, 1" in text for text in told)


@pytest.mark.parametrize(
    "time",
    [
        TIME,
        np.concatenate([TIME, TIME, TIME]),  # starts anew
        np.concatenate([TIME[:2], TIME[2:] + 30.0]),  # pauses
        np.concatenate([TIME[:70], TIME[70:73] + 9.0, TIME[73:] + 20.0]),
        np.concatenate([TIME[:100], TIME[100:] + 1e3]),
        TIME - 0.012 * (np.arange(len(TIME)) % 25 == 20),  # comes late, by a row
        np.where(np.arange(len(TIME)) % 9 == 0, np.nan, TIME),
        TIME[:9],
    ],
)
def test_stamps_in_order_are_right(time):
    assert len(wild_rows(time)) == 0


def test_a_coarse_clock_is_named(tmp_path):
    _, told = imported(tmp_path, [np.floor(10.0 * TIME) / 10.0, POSE + 0.001 * TIME[:, None], TIP])
    assert any("steps of 0.1 s" in text and "`rate`" in text for text in told)


def test_values_that_are_held_do_not_make_a_clock_coarse():
    held = np.floor(10.0 * TIME) / 10.0
    assert coarse_text(held, np.column_stack([held, held])) == ""
    assert coarse_text(TIME, POSE) == ""
