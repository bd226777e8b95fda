"""Recorded simulated pushes: noise, forces and torques of known size, and a way through the file format."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slipmap.models.measurements import Noise, Table, read_dataset, write_dataset
from slipmap.models.measurements.dataset_check import check_dataset
from slipmap.models.measurements.simulated import GOOD_SENSORS, record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Push, Slider

RADIUS = 0.01
MASS, MU = 0.6, 0.25
SILENT = Noise()


def square() -> Slider:
    return Slider(
        cells_from_polygon(0.03 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), width=0.01), RADIUS
    )


def maps(slider: Slider, mu_finger: float = 0.4) -> Maps:
    n = len(slider.grid)
    return Maps(np.full(n, MASS / n), np.full(n, MU), np.array([mu_finger]))


def push_along_x(offset: float = 0.0, angle: float = 0.0) -> Push:
    """From the left at 0.04 m/s; the finger starts 5 mm before the square; all turned by `angle`."""
    h = 1e-3
    x = -0.045 + 0.04 * np.maximum(h * np.arange(1501) - 0.1, 0.0)
    c, s = np.cos(angle), np.sin(angle)
    tip = np.column_stack([x, np.full(len(x), offset)]) @ np.array([[c, s], [-s, c]])
    return Push(h, tip, np.array([0.0, 0.0, angle]))


def test_noise_has_the_declared_size_and_no_bias():
    slider, pushes = square(), [push_along_x(0.004 * k) for k in range(-3, 4)]
    noisy = record_pushes(slider, maps(slider), pushes, np.random.default_rng(0), noise=GOOD_SENSORS)
    clean = record_pushes(slider, maps(slider), pushes, np.random.default_rng(0), noise=SILENT)
    sizes = {
        "object_pose": [GOOD_SENSORS.position, GOOD_SENSORS.position, GOOD_SENSORS.angle],
        "tip_pose": [GOOD_SENSORS.tip, GOOD_SENSORS.tip],
        "ft_wrench": [GOOD_SENSORS.force, GOOD_SENSORS.force, GOOD_SENSORS.force * RADIUS],
    }
    for channel, expected in sizes.items():
        pairs = zip(noisy.trials, clean.trials, strict=True)
        error = np.concatenate([getattr(a, channel).values - getattr(b, channel).values for a, b in pairs])
        np.testing.assert_allclose(error.std(axis=0), expected, rtol=0.08)
        assert (np.abs(error.mean(axis=0)) < 4 * np.array(expected) / np.sqrt(len(error))).all()
        assert abs(np.corrcoef(error[1:, 0], error[:-1, 0])[0, 1]) < 0.1


def test_force_in_steady_sliding_is_friction_times_weight_in_the_finger_direction():
    slider, angle = square(), 0.6
    (trial,) = record_pushes(
        slider, maps(slider), [push_along_x(0.0, angle)], np.random.default_rng(0), noise=SILENT
    ).trials
    steady = trial.ft_wrench.values[-20:]
    expected = MU * MASS * 9.81 * np.array([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(steady[:, :2], np.tile(expected, (20, 1)), rtol=1e-3, atol=1e-3)
    before = trial.ft_wrench.values[trial.ft_wrench.time < 0.2]
    assert len(before) > 10 and not before.any()


@pytest.mark.parametrize("angle", [0.0, 2.1])
def test_torque_about_the_finger_comes_from_the_tangential_force_alone(angle):
    """The contact lies one radius ahead, so the torque is the radius times the tangential force."""
    slider = square()
    rng = np.random.default_rng(0)
    (trial,) = record_pushes(slider, maps(slider), [push_along_x(0.02, angle)], rng, noise=SILENT).trials
    pressing = np.hypot(*trial.ft_wrench.values[:, :2].T) > 0.1
    time = trial.ft_wrench.time[pressing]
    fx, fy, torque = trial.ft_wrench.values[pressing].T
    turn = trial.object_pose.at(time)[:, 2]
    tangential = -np.sin(turn) * fx + np.cos(turn) * fy
    assert np.abs(tangential).max() > 0.1
    np.testing.assert_allclose(torque, RADIUS * tangential, rtol=0.01, atol=2e-5)
    (smooth,) = record_pushes(
        slider, maps(slider, 0.0), [push_along_x(0.02, angle)], rng, noise=SILENT
    ).trials
    assert np.abs(smooth.ft_wrench.values[:, 2]).max() < 0.01 * np.abs(torque).max()


def test_rows_are_the_simulation_at_the_rate():
    slider, push = square(), push_along_x(0.01)
    (trial,) = record_pushes(
        slider, maps(slider), [push], np.random.default_rng(0), noise=SILENT, rate=50.0
    ).trials
    poses = slider.rollout(maps(slider), [push]).poses[0]
    np.testing.assert_allclose(np.diff(trial.object_pose.time), 0.02)
    np.testing.assert_allclose(trial.object_pose.values[1:], poses[19::20], atol=1e-12)
    np.testing.assert_array_equal(trial.object_pose.values[0], push.start_pose)
    np.testing.assert_allclose(trial.tip_pose.values, push.tip[::20], atol=1e-12)


def test_the_angle_of_a_finger_is_recorded_if_it_turns():
    slider, push = square(), push_along_x(0.01)
    turning = replace(push, tip_angle=2.0 * push.h * np.arange(len(push.tip)))
    dataset = record_pushes(slider, maps(slider), [push, turning], np.random.default_rng(0), noise=SILENT)
    still, turned = dataset.trials
    assert still.tip_angle is None
    np.testing.assert_allclose(turned.tip_angle.values[:, 0], 2.0 * turned.tip_angle.time, atol=1e-12)
    assert not np.allclose(still.object_pose.values[-1], turned.object_pose.values[-1], atol=1e-4)
    (found,) = [one for one in check_dataset(dataset).findings if one.what == "finger"]
    assert "in 1 of 2 pushes" in found.found


def test_dataset_survives_the_file_format(tmp_path):
    slider = square()
    dataset = record_pushes(
        slider, maps(slider), [push_along_x(0.005 * k) for k in range(4)], np.random.default_rng(3),
        heldout=1, name="square", height=0.02, mass=MASS,
    )  # fmt: skip
    back = read_dataset(write_dataset(dataset, tmp_path / "square"))
    assert [trial.role for trial in back.trials] == ["fit", "fit", "fit", "heldout"]
    assert (back.name, back.mass, back.height, back.noise) == ("square", MASS, 0.02, GOOD_SENSORS)
    assert back.warnings == ()
    for ours, theirs in zip(dataset.trials, back.trials, strict=True):
        np.testing.assert_array_equal(theirs.object_pose.values, ours.object_pose.values)
        np.testing.assert_array_equal(theirs.ft_wrench.values, ours.ft_wrench.values)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"heldout": 2}, "2 of 1 pushes"),
        ({"rate": 0.0}, "rate"),
        ({"rate": 1e4}, "a step for each"),
        ({"rate": 0.9}, "three rows"),
        ({"pushes": []}, "pushes"),
        ({"pushes": [Push(0.01, np.full((50, 2), np.nan), np.zeros(3))]}, "no finger"),
        ({"maps": Maps(np.ones((2, 36)), np.ones((2, 36)), np.ones(2))}, "got 2"),
    ],
)
def test_wrong_arguments_are_named(change, complaint):
    slider = square()
    arguments = {
        "slider": slider,
        "maps": maps(slider),
        "pushes": [push_along_x()],
        "rng": np.random.default_rng(0),
    }
    with pytest.raises(ValueError, match=complaint):
        record_pushes(**arguments | change)


def test_the_table_is_recorded_and_a_fall_refused():
    table = Table("rectangle", (0.0, 0.0), size=(0.12, 0.4))
    slider = Slider(square().grid, RADIUS, table=table)
    rng = np.random.default_rng(0)
    assert record_pushes(slider, maps(slider), [push_along_x()], rng).table == table
    push, way = push_along_x(), np.array([0.02, 0.0, 0.0])
    beyond = replace(push, tip=push.tip + way[:2], start_pose=way)
    with pytest.raises(ValueError, match=r"in push 1 the object tips over the table's rim 1\.\d\d s after"):
        record_pushes(slider, maps(slider), [push, beyond], rng)


@pytest.mark.parametrize(
    ("orders", "expected"),
    [((0, 0, 0), (0, 1, 2)), ((2, 2, 0), (0, 1, 2)), ((0, 0.5, 1), (0, 1, 2)), ((5, 2, 9), (5, 2, 9))],
)
def test_pushes_are_simulated_in_the_order_that_is_recorded(orders, expected):
    slider = Slider(square().grid, RADIUS, effects=["friction_drift"])
    truth = replace(maps(slider), effects=np.array([[0.2]]))
    pushes = [replace(push_along_x(), order=order) for order in orders]
    trials = record_pushes(slider, truth, pushes, np.random.default_rng(0), noise=SILENT).trials
    assert tuple(trial.order for trial in trials) == expected
    forces = [np.hypot(*trial.ft_wrench.values[-60:-30, :2].T).mean() for trial in trials]
    np.testing.assert_allclose(forces, [MASS * 9.81 * MU * np.exp(0.2 * k) for k in expected], rtol=0.02)


def test_a_push_that_begins_inside_the_object_is_refused():
    slider, push = square(), push_along_x()
    inside = replace(push, tip=push.tip + np.array([0.03, 0.0]))
    with pytest.raises(ValueError, match="push 1 begins with the finger 25 mm inside the object"):
        record_pushes(slider, maps(slider), [push, inside], np.random.default_rng(0))
