import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from straight_pushes import RADIUS, straight_pushes

import slipmap
from slipmap.models.measurements import (
    Channel,
    DatasetError,
    Noise,
    Table,
    Trial,
    read_dataset,
    write_dataset,
)
from slipmap.models.measurements.trial_checks import check_trials
from slipmap.models.physics.cell_grid import CellGrid


def channel(rows: int, columns: int, first: float = 0.0) -> Channel:
    time = first + 0.1 * np.arange(rows)
    return Channel(time, np.outer(time, np.arange(1.0, columns + 1)))


def test_channel_is_linear_between_rows_and_held_beyond_the_ends():
    slope = channel(11, 2)
    np.testing.assert_allclose(slope.at(0.55), [0.55, 1.1])
    np.testing.assert_allclose(slope.at([-3.0, 0.25, 9.0]), [[0.0, 0.0], [0.25, 0.5], [1.0, 2.0]])
    assert slope.at(np.zeros((4, 3))).shape == (4, 3, 2)


@pytest.mark.parametrize(
    ("time", "values", "complaint"),
    [
        ([0.0, 1.0], [[1.0]], "T rows"),
        ([], np.empty((0, 2)), "T >= 1"),
        ([0.0, 0.0], [[1.0], [1.0]], "row 1: time must increase"),
        ([0.0, 2.0, 1.0], [[1.0], [1.0], [1.0]], "row 2: time must increase"),
        ([0.0, 1.0], [[1.0], [np.nan]], "row 1: every number must be finite"),
        ([0.0, np.inf], [[1.0], [1.0]], "row 1: every number must be finite"),
    ],
)
def test_channel_refuses(time, values, complaint):
    with pytest.raises(DatasetError, match=complaint):
        Channel(np.array(time), np.array(values))


def test_trial_refuses_wrong_columns_roles_and_single_poses():
    with pytest.raises(DatasetError, match=r"a\.json: tip_pose needs 2 columns besides time, has 3"):
        Trial("a.json", "fit", channel(5, 3), channel(5, 3))
    with pytest.raises(DatasetError, match=r"a\.json: role must be fit or heldout, got 'test'"):
        Trial("a.json", "test", channel(5, 3), channel(5, 2))
    with pytest.raises(DatasetError, match="object_pose needs at least two rows"):
        Trial("a.json", "fit", channel(1, 3), channel(5, 2))


def test_an_order_is_a_place():
    for order in (-1, 1.5, 1_000_001):
        said = rf"a\.json: order must be a whole number from 0 to 1000000, got {order}"
        with pytest.raises(DatasetError, match=said):
            Trial("a.json", "fit", channel(5, 3), channel(5, 2), order=order)


def test_two_poses_are_ends_only_and_rest():
    ends = Trial("a.json", "fit", channel(2, 3, first=7.0), channel(9, 2))
    assert ends.ends_only and ends.start == 7.0
    assert not ends.initial_velocity().any()
    assert not Trial("a.json", "fit", channel(3, 3), channel(9, 2)).ends_only


def test_a_finger_far_from_the_moving_object_is_none():
    time = np.arange(5.0)
    pose = Channel(time, np.column_stack([time, 0 * time, 0 * time]))  # moves from x = 0 to 4
    beside = Trial("a", "fit", pose, Channel(time, np.tile([0.0, 1.1], (5, 1))))
    assert not beside.finger_near() and not beside.finger_near(0.09) and beside.finger_near(0.11)
    assert Trial("a", "fit", pose, Channel(time, np.tile([4.0, 0.9], (5, 1)))).finger_near()
    assert not Trial("a", "fit", pose, Channel(time[:3], np.tile([4.0, 0.9], (3, 1)))).finger_near()


def test_names_of_trials_differ(example):
    dataset = read_dataset(example.write())
    with pytest.raises(DatasetError, match="dataset example: 2 trials are called trials/000"):
        replace(
            dataset, trials=(*dataset.trials[:2], replace(dataset.trials[1], name=dataset.trials[0].name))
        )
    with pytest.raises(DatasetError, match="there are no trials"):
        replace(dataset, trials=())


@pytest.mark.parametrize("field", ["height", "mass", "finger_radius", "gravity"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_sizes_are_positive(example, field, value):
    with pytest.raises(DatasetError, match=f"{field.replace('_', ' ')} must be positive and finite"):
        replace(read_dataset(example.write()), **{field: value})


def test_roles_and_the_first_fit_pushes(example):
    dataset = read_dataset(example.write())
    assert [t.name[-8:] for t in dataset.fit_trials] == ["000.json", "001.json"]
    assert [t.name[-8:] for t in dataset.heldout_trials] == ["002.json"]
    one = dataset.with_fit_pushes(1)
    assert [t.name[-8:] for t in one.trials] == ["000.json", "002.json"]
    assert one.fingerprint == dataset.fingerprint
    assert dataset.with_fit_pushes(2).trials == dataset.trials


@pytest.mark.parametrize("count", [0, -1, 3, 1.5, "2", None])
def test_more_fit_pushes_than_there_are(example, count):
    with pytest.raises(ValueError, match=f"cannot take {count!r} of 2 fit trials; take 1 to 2"):
        read_dataset(example.write()).with_fit_pushes(count)


@given(st.text(max_size=60))
def test_an_error_text_is_one_paragraph(text):
    assert len(str(DatasetError(text)).splitlines()) <= 1


def arrays_of(trial: Trial) -> dict[str, np.ndarray]:
    return {name: np.column_stack([one.time, one.values]) for name, one in trial.channels.items()}


def of_arrays(change=lambda arrays: arrays, **settings):
    bar = straight_pushes(4)
    pushes = [change(arrays_of(trial)) for trial in bar.trials]
    return slipmap.dataset_from_arrays(pushes, bar.grid, finger_radius=RADIUS, **settings)


def test_arrays_make_the_dataset_that_files_would_make(tmp_path):
    made, told = of_arrays(tell=print, mass=0.7), []
    read = read_dataset(write_dataset(made, tmp_path / "pushes"), tell=told.append)
    assert made.warnings == read.warnings == tuple(told) and made.mass == read.mass == 0.7
    assert [trial.role for trial in made.trials] == ["fit", "fit", "fit", "heldout"]
    for one, same, pushed in zip(made.trials, read.trials, straight_pushes(4).trials, strict=True):
        assert (one.name, one.order) == (same.name, same.order) == (pushed.name, same.order)
        for name, channel in pushed.channels.items():
            for other in (one.channels[name], same.channels[name]):
                np.testing.assert_array_equal(other.time, channel.time)
                np.testing.assert_array_equal(other.values, channel.values)
    assert made.fingerprint != of_arrays(lambda push: push | {"ft_wrench": None}).fingerprint
    assert [trial.role for trial in of_arrays(heldout=0).trials] == 4 * ["fit"]


def test_a_torque_may_be_missing():
    without = of_arrays(lambda push: push | {"ft_wrench": push["ft_wrench"][:, :3]})
    assert not without.trials[0].ft_wrench.values[:, 2].any()


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (
            lambda push: push | {"object_pose": push["object_pose"][:, 1:]},
            r"push 0, object_pose: .*theta rad",
        ),
        (lambda push: push | {"object_pose": push["object_pose"].T}, "transpose"),
        (lambda push: push | {"tip_pose": push["tip_pose"][:, 0]}, r"push 0, tip_pose: .*shape \(120,\)"),
        (
            lambda push: push | {"force": push["ft_wrench"]},
            "push 0: unknown array 'force'; a push has object",
        ),
        (lambda push: {"object_pose": push["object_pose"]}, "push 0: `tip_pose` is missing"),
        (lambda push: push | {"tip_pose": "left"}, "push 0, tip_pose: needs an array of numbers"),
        (lambda push: push | {"object_pose": push["object_pose"][::-1]}, "row 1: time .* is earlier"),
        (lambda push: {name: rows * [1e6, 1, 1, 1][: rows.shape[1]] for name, rows in push.items()}, "in s"),
    ],
)
def test_what_is_wrong_with_an_array_is_told(change, complaint):
    with pytest.raises(DatasetError, match=complaint):
        of_arrays(change)


def test_arrays_in_millimetres_are_told():
    told = []
    of_arrays(lambda push: push | {"object_pose": push["object_pose"] * [1, 1e3, 1e3, 1]}, tell=told.append)
    assert any("are positions in m" in text for text in told)


@pytest.mark.parametrize(
    ("mass", "factor", "words"),
    [
        (1.0, 1.0, []),
        (
            1.0,
            1e3,
            [r"pushes: ft_wrench is \d+ N while pushing, \d+ times the weight of 1 kg; is the force in N"],
        ),
        (1e3, 1.0, ["pushes: object.mass is 1000 kg on .*; is it in kg"]),
        (1e-4, 1.0, ["pushes: object.mass is 0.0001 kg on .*; is it in kg"]),
    ],
)
def test_forces_and_masses_in_other_units_are_told(mass, factor, words):
    factors = [1, factor, factor, factor]
    made = of_arrays(lambda push: push | {"ft_wrench": push["ft_wrench"] * factors}, mass=mass)
    assert len(made.warnings) == len(words)
    for told, word in zip(made.warnings, words, strict=True):
        assert re.match(word, told)


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"noise": Noise(position=0.25)}, "noise.position"),
        ({"gravity": 9810.0}, "gravity"),
        ({"finger_height": 10.0}, "finger.height"),
        ({"mass": 1e-7}, "object.mass"),
        ({"name": 5}, "name must be a str"),
        ({"noise": 0.001}, "noise must be a Noise"),
        ({"table": {"shape": "round"}}, "table must be a Table"),
    ],
)
def test_what_files_may_not_say_arrays_may_not_either(tmp_path, settings, complaint):
    with pytest.raises((DatasetError, TypeError), match=complaint):
        of_arrays(**settings)
    if complaint == "gravity":
        with pytest.raises(DatasetError, match=complaint):
            write_dataset(replace(of_arrays(), **settings), tmp_path / "pushes")
        assert not (tmp_path / "pushes").exists()


def test_no_radius_is_refused_by_name():
    with pytest.raises(DatasetError, match="finger radius must be positive"):
        replace(of_arrays(), finger_radius=None)


def test_doubts_about_the_setup_are_told_of_arrays_too():
    bar = straight_pushes(4)
    aside = CellGrid(bar.grid.centers + np.array([0.03, 0.0]), bar.grid.width, bar.grid.exterior)
    pushes = [arrays_of(trial) for trial in bar.trials]
    made = slipmap.dataset_from_arrays(pushes, aside, finger_radius=RADIUS, finger_height=0.05, height=0.03)
    assert any("centres lie outside the outline" in text for text in made.warnings)
    assert any("passes over" in text for text in made.warnings)


def test_masked_rows_are_left_out():
    def masked(push):
        poses = np.ma.masked_array(push["object_pose"])
        poses[10:20] = np.ma.masked
        return push | {"object_pose": poses}

    first = of_arrays(masked).trials[0]
    assert len(first.object_pose.time) == len(straight_pushes(1).trials[0].object_pose.time) - 10


def test_a_push_that_is_kept_stays_in_the_files(tmp_path):
    def reversed_finger(push):
        return push | {"tip_pose": push["tip_pose"] * [1.0, -1.0, 1.0]}

    bar = straight_pushes(9)
    pushes = [arrays_of(trial) for trial in bar.trials]
    pushes[3] = reversed_finger(pushes[3])
    settings = {"finger_radius": RADIUS, "tell": lambda text: None}
    assert len(slipmap.dataset_from_arrays(pushes, bar.grid, **settings).trials) == 8
    made = slipmap.dataset_from_arrays(pushes, bar.grid, keep_all=True, **settings)
    read = read_dataset(write_dataset(made, tmp_path / "pushes"), tell=lambda text: None)
    assert len(made.trials) == len(read.trials) == 9


@pytest.mark.parametrize(
    ("noise", "words"),
    [
        (Noise(position=0.05), "noise.position says 50 mm, but rows scatter by 0.0.* mm"),
        (Noise(angle=0.15), "noise.angle says 8.59°, but rows scatter by .*; is it in rad"),
        (Noise(tip=0.05), "noise.tip says 50 mm"),
        (Noise(position=2e-3, angle=0.03, tip=2e-3), None),
    ],
)
def test_a_noise_in_a_wrong_unit_is_told(noise, words):
    def turned(push):
        poses = push["object_pose"]
        return push | {"object_pose": poses + 0.02 * np.outer(poses[:, 1] - poses[0, 1], [0, 0, 0, 1])}

    warnings = of_arrays(turned, noise=noise).warnings
    assert warnings == () if words is None else re.search(words, warnings[0])


@pytest.mark.parametrize("finger", [1.0, 0.1])
def test_stamps_that_count_frames_are_told(finger):
    """Unless the finger's show the unit, as beside a camera of one picture a second."""

    def counted(push):
        steps = {name: finger if name == "tip_pose" else 1.0 for name in push}
        return {
            name: np.column_stack([steps[name] * np.arange(len(rows)), rows[:, 1:]])
            for name, rows in push.items()
        }

    told = [text for text in of_arrays(counted, tell=lambda text: None).warnings if "count frames" in text]
    assert bool(told) == (finger == 1.0)


def test_the_noise_of_an_angle_that_is_held_is_not_doubted():
    bar = straight_pushes(4)
    held = replace(bar, noise=Noise(angle=1.0))
    assert not any("noise.angle" in text for text in check_trials(held, held.trials, "held")[1])


@pytest.mark.parametrize("center", [(0, 0), [0.0, 0.0], np.zeros(2)])
def test_a_table_is_the_same_however_its_numbers_are_given(center):
    assert Table("round", center, radius=0.5) == Table("round", (0.0, 0.0), radius=0.5)
    size = np.array([0.4, 0.3])
    assert Table("rectangle", center, size=size) == Table("rectangle", (0.0, 0.0), size=(0.4, 0.3))


@pytest.mark.parametrize("mass", ["500 g", -1.0, float("nan"), [1.0, 2.0]])
def test_a_mass_that_is_none_is_refused_by_name(mass):
    with pytest.raises(DatasetError, match=re.escape(f"mass must be positive and finite, got {mass!r}")):
        of_arrays(mass=mass)


@pytest.mark.parametrize("mass", [1, np.float32(1.0), np.array(1.0)])
def test_a_mass_may_be_any_kind_of_number(mass):
    assert of_arrays(mass=mass).mass == 1.0


def test_an_array_is_no_channel():
    with pytest.raises(TypeError, match=r"a: object_pose must be a Channel, which slipmap\.dataset_from_arr"):
        Trial("a", "fit", np.zeros((10, 4)), np.zeros((10, 3)))
    for heldout, complaint in ((5, "4 pushes, so 5"), (0.5, "whole number")):
        with pytest.raises(ValueError, match=complaint):
            of_arrays(heldout=heldout)
