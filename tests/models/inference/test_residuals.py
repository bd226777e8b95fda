"""Residual velocities, their conditions, delays: against pushes whose residuals are known."""

import numpy as np
import pytest

from slipmap.models.geometry import at_centroid, radius_of_gyration
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.prediction import Motion
from slipmap.models.inference.residual_structure import correlations, delay_pattern
from slipmap.models.inference.residuals import Phase, conditions, force_residuals, motion_residuals
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Push

RADIUS = 0.005
# Its centroid is not the origin, so that the two cannot be mixed up.
GRID = cells_from_polygon(np.array([[-2, -2], [4, -2], [4, 2], [-2, 2]]) * 0.01, width=0.01)
TIMES = np.linspace(0.0, 2.0, 31)


def push_of(poses, tip=None, times=TIMES, forces=None):
    """Observation of poses (31, 3) at `times`; the finger far away unless its track (31, 2) is given."""
    fine = np.linspace(times[0], times[-1], 401)
    track = np.full((401, 2), 10.0)
    if tip is not None:
        track = np.column_stack([np.interp(fine, times, column) for column in np.asarray(tip).T])
    forces = np.zeros((0, 2)) if forces is None else np.asarray(forces, dtype=float)
    push = Push(
        fine[1], track, poses[0], pose_times=times[1:], force_times=np.linspace(0.5, 1.5, len(forces))
    )
    return Observation(
        "t",
        "fit",
        push,
        poses[1:],
        np.ones(len(poses) - 1),
        1,
        forces,
        np.ones(len(forces)),
        np.ones(len(forces), dtype=bool),
    )


def told(poses, forces=None):
    forces = np.zeros((0, 2)) if forces is None else np.asarray(forces, dtype=float)
    return Motion(poses[None, 1:], forces[None], np.ones(1), GRID)


def straight(velocity, start=(0.0, 0.0, 0.0)):
    return np.array(start) + TIMES[:, None] * np.array(velocity)


def test_a_steady_drift_is_the_residual_velocity():
    predicted, measured = straight([0.05, 0, 0]), straight([0.05, 0.002, 0.1])
    found = motion_residuals([push_of(measured)], [told(predicted)], GRID, RADIUS)
    centroid = (at_centroid(measured, GRID) - at_centroid(predicted, GRID)) * [1, 1, radius_of_gyration(GRID)]
    np.testing.assert_allclose(found.values[:, 2], 0.1 * radius_of_gyration(GRID), rtol=1e-9)
    np.testing.assert_allclose(found.weights @ found.values, centroid[-1], atol=1e-12)
    assert found.relative[:, 0] == pytest.approx(found.values[:, 0] / found.scale[0])


def test_increments_telescope_so_that_noise_enters_once():
    rng = np.random.default_rng(0)
    predicted = straight([0.05, 0.0, 0.0])
    noise = 1e-4 * rng.normal(size=predicted.shape) * [1, 1, 0]
    noise[0] = 0
    found = motion_residuals([push_of(predicted + noise)], [told(predicted)], GRID, RADIUS)
    np.testing.assert_allclose((found.weights @ found.values)[:2], noise[-1, :2], atol=1e-12)


def test_only_pieces_in_which_the_object_moves_count():
    way = np.clip(TIMES - 1.0, 0.0, 0.5)[:, None] * [0.1, 0, 0]
    found = motion_residuals([push_of(way)], [told(way)], GRID, RADIUS)
    assert found.at.time.min() > 0.9 and found.at.time.max() < 1.6
    still = np.zeros((31, 3))
    assert motion_residuals([push_of(still)], [told(still)], GRID, RADIUS) is None


def test_conditions_come_from_the_prediction_and_not_from_the_measured_pose():
    predicted = straight([0.0, 0.05, 0.0], start=[0.1, 0.2, np.pi / 2])
    rng = np.random.default_rng(1)
    noise = 1e-3 * rng.normal(size=predicted.shape)
    noise[0] = 0.0
    measured = predicted + noise
    at = motion_residuals([push_of(measured)], [told(predicted)], GRID, RADIUS).at
    np.testing.assert_allclose(at.table_direction, np.pi / 2)
    np.testing.assert_allclose(at.object_direction, 0.0, atol=1e-12)
    np.testing.assert_allclose(at.speed, 0.05)
    np.testing.assert_allclose(at.place[:, 0], 0.1, atol=1e-9)  # the centroid lies ahead of the origin, in y
    assert at.place[:, 1].min() > 0.2


def test_an_object_that_turns_about_its_centroid_goes_nowhere():
    angle = 0.5 * TIMES
    centroid = at_centroid(np.zeros(3), GRID)[:2]
    c, s = np.cos(angle), np.sin(angle)
    back = np.column_stack([c * centroid[0] - s * centroid[1], s * centroid[0] + c * centroid[1]])
    poses = np.column_stack([centroid - back, angle])
    at = motion_residuals([push_of(poses)], [told(poses)], GRID, RADIUS).at
    np.testing.assert_allclose(at.speed, 0.5 * radius_of_gyration(GRID))
    np.testing.assert_allclose(at.translating, 0.0, atol=1e-9)
    np.testing.assert_allclose(at.place, np.tile(centroid, (len(at), 1)), atol=1e-9)


def phases(poses, tip):
    observation = push_of(poses, tip)
    return conditions(0, observation, poses[1:], TIMES[:-1], TIMES[1:], GRID, RADIUS)


def test_a_finger_that_arrives_pushes_and_stops_gives_three_phases():
    arrives, leaves = 0.5, 1.5
    finger = -0.02 - RADIUS + 0.05 * (np.minimum(TIMES, leaves) - arrives)
    way = 0.05 * np.clip(TIMES - arrives, 0, None)  # the object goes on when the finger has stopped
    at = phases(np.column_stack([way, 0 * way, 0 * way]), np.column_stack([finger, 0 * finger]))
    assert at.phase[TIMES[:-1] < arrives - 0.07].tolist() == [Phase.COASTING] * 7  # nothing touches yet
    touch = np.searchsorted(TIMES, arrives) - 1
    assert at.phase[touch] == Phase.FIRST_TOUCH
    assert set(at.phase[(TIMES[:-1] > arrives + 0.1) & (TIMES[1:] < leaves)]) == {Phase.STICKING}
    assert set(at.phase[TIMES[:-1] > leaves + 0.05]) == {Phase.COASTING}
    touched = at.contact[at.phase == Phase.STICKING]
    np.testing.assert_allclose(touched, np.tile([-0.02, 0.0], (len(touched), 1)), atol=1e-9)


def test_a_finger_that_moves_along_the_side_slides():
    way = 0.05 * TIMES
    finger = np.column_stack([way - 0.02 - RADIUS, -0.01 + 0.02 * TIMES / 2])
    at = phases(np.column_stack([way, 0 * way, 0 * way]), finger)
    assert set(at.phase[2:]) == {Phase.SLIDING}
    assert np.all(np.diff(at.contact[:, 1]) > 0)


def test_a_finger_that_an_object_turns_about_without_slip_sticks():
    """The contact point stays the same on the object while finger and object turn about it."""
    spin = 0.6 * TIMES
    corner = np.array([-0.02, 0.0])
    c, s = np.cos(spin), np.sin(spin)
    contact = np.column_stack([0.006 * TIMES, 0 * TIMES])
    place = contact - np.column_stack([c * corner[0] - s * corner[1], s * corner[0] + c * corner[1]])
    # The finger's surface rolls on the side: its centre lies along the normal, shifted by the rolled length.
    rolled = RADIUS * spin
    normal, tangent = np.column_stack([-c, -s]), np.column_stack([-s, c])
    touched = contact + rolled[:, None] * tangent
    at = phases(np.column_stack([place, spin]), touched + RADIUS * normal)
    assert set(at.phase[2:]) == {Phase.STICKING}


def test_residual_forces_are_measured_less_predicted_over_the_typical_force():
    poses = straight([0.05, 0, 0])
    measured, predicted = np.tile([3.0, 4.0], (6, 1)), np.tile([2.0, 4.0], (6, 1))
    observation = push_of(poses, np.column_stack([poses[:, 0] - 0.025, poses[:, 1]]), forces=measured)
    found = force_residuals([observation], [told(poses, predicted)], GRID, RADIUS)
    np.testing.assert_allclose(found.relative, [[0.2, 0.0]] * 6)
    assert force_residuals([push_of(poses)], [told(poses)], GRID, RADIUS) is None


def uneven(rng):
    """A push that starts, changes speed and stops."""
    speed = 0.05 * np.interp(TIMES, [0, 0.3, 0.5, 1.0, 1.2, 1.6, 2.0], [0, 0, 1, 1, rng.uniform(1, 3), 0, 0])
    way = np.concatenate([[0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(TIMES))])
    heading = rng.uniform(-np.pi, np.pi)
    return np.column_stack([way * np.cos(heading), way * np.sin(heading), 0 * way])


@pytest.mark.parametrize("delay", [0.0, 0.05])
def test_a_delay_is_found_and_none_is_not(delay):
    rng = np.random.default_rng(2)
    pushes, motions = [], []
    for _ in range(12):
        predicted = uneven(rng)
        late = np.column_stack([np.interp(TIMES - delay, TIMES, column) for column in predicted.T])
        late[1:] += 2e-4 * rng.normal(size=(30, 3)) * [1, 1, 0]
        pushes.append(push_of(late, predicted[:, :2] - 0.5))
        motions.append(told(predicted))
    pattern = delay_pattern(pushes, motions, GRID, rng)
    assert pattern.size == pytest.approx(delay, abs=0.004)
    assert (pattern.p < 0.001) == (delay > 0)
    found = correlations(pushes, motions, GRID, rng)
    at_zero = len(found.finger_along.lags) // 2
    assert found.finger_along.lags[at_zero] == 0.0
    assert (found.finger_along.values[at_zero] < -0.5) == (delay > 0)
    assert (found.finger_along.p < 0.01) == (delay > 0)
    assert found.finger_left.p > 0.01


def correlated(rng, residual, count=16):
    """Correlations of pushes by an accelerating finger with residuals (31, 3) drawn by `residual`."""
    poses = straight([0.05, 0.0, 0.0])
    tip = np.column_stack([0.03 * TIMES**1.5, 0 * TIMES])
    return correlations(
        [push_of(poses + residual(), tip) for _ in range(count)], [told(poses)] * count, GRID, rng
    )


def test_memory_is_told_from_noise_without_memory():
    rng = np.random.default_rng(3)
    white = correlated(rng, lambda: 1e-3 * rng.normal(size=(31, 3)) * [1, 1, 0])
    drifting = correlated(rng, lambda: np.linspace(0, 1, 31)[:, None] * rng.normal(size=3) * [1e-3, 1e-3, 0])
    assert white.memory_time <= 0.1 and white.independent > 8
    assert drifting.memory.values[10] > drifting.memory.bounds[10]
    assert np.isnan(drifting.memory_time) or drifting.memory_time > 0.4


def test_bounds_hold_as_often_as_they_say():
    rng = np.random.default_rng(5)
    memory = finger = 0
    for _ in range(40):
        white = correlated(rng, lambda: 1e-3 * rng.normal(size=(31, 3)) * [1, 1, 0])
        # Neighbouring times share a sample, so the first lags have memory by themselves.
        memory += (np.abs(white.memory.values[3:]) > white.memory.bounds[3:]).any()
        wandering = correlated(rng, lambda: 1e-4 * rng.normal(size=(31, 3)).cumsum(axis=0) * [1, 1, 0])
        finger += wandering.finger_along.p <= 0.05
    # 2 of 40 are expected; 7 or more have a chance of 0.3 %.
    assert memory <= 6
    assert finger <= 6


def test_too_few_pushes_give_no_correlations():
    poses = straight([0.05, 0.0, 0.0])
    rng = np.random.default_rng(4)
    pushes = [push_of(poses + 1e-3 * rng.normal(size=(31, 3)), poses[:, :2]) for _ in range(3)]
    assert correlations(pushes, [told(poses)] * 3, GRID, rng) is None
    assert delay_pattern(pushes, [told(poses)] * 3, GRID, rng) is None
