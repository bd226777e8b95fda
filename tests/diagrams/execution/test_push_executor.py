"""The arm pushes a box: where the finger goes, with what force, and what it says of it."""

import itertools

import numpy as np
import pytest
from arm_rig import BOX_MASS, SAMPLE, done

from slipmap.diagrams.execution.requests import ExecutionConfig
from slipmap.diagrams.station.arm import HOME
from slipmap.models.robots import POSITION_LIMITS, SPEED_LIMITS
from slipmap.planners.table_push import TablePush

HEIGHT = ExecutionConfig().tip_height
SPEEDS = (0.05, 0.1)
PUSHES = {speed: TablePush([-0.08, 0.0], [0.02, 0.0], speed) for speed in SPEEDS}


@pytest.fixture(scope="module", params=SPEEDS)
def pushed(rig, request):
    """Push of 10 cm, half of it with the box, and its log."""
    push = PUSHES[request.param]
    return push, rig.run(rig.start(push), done())


def while_pushing(log):
    return [sample for sample in log if sample.status.mode == "pushing"]


def touching(log):
    """Samples from 150 ms after first touch: its blow is over."""
    samples = while_pushing(log)
    first = next(sample.time for sample in samples if np.linalg.norm(sample.contact_force) > 0.1)
    return [sample for sample in samples if sample.time > first + 0.15]


def test_tip_error_is_below_a_millimetre(rig, pushed):
    push, log = pushed
    wanted = np.array([rig.kinematics.pose(s.command).translation() for s in while_pushing(log)])
    tip = np.array([s.tip for s in while_pushing(log)])
    assert np.linalg.norm(tip - wanted, axis=1).max() < 0.5e-3
    across = (tip[:, :2] - push.begin) @ [-push.direction[1], push.direction[0]]
    assert np.abs(across).max() < 0.2e-3
    assert np.abs(tip[:, 2] - HEIGHT).max() < 0.3e-3
    np.testing.assert_allclose(tip[-1], [*push.end, HEIGHT], atol=0.1e-3)


def test_finger_moves_at_the_speed_asked_for(pushed):
    push, log = pushed
    tip = np.array([s.tip for s in while_pushing(log)])
    speed = np.diff(tip[:, :2] @ push.direction) / SAMPLE
    assert np.median(speed[speed > 0.5 * push.speed]) == pytest.approx(push.speed, rel=0.01)
    assert speed.max() < 1.1 * push.speed  # it swings a little after the blow of first touch


def test_finger_points_down_while_pushing(pushed):
    _, log = pushed
    for sample in while_pushing(log):
        assert sample.tip_pose.rotation().matrix()[2, 2] < -np.cos(np.deg2rad(0.1))


def test_box_goes_along(pushed):
    push, log = pushed
    way = log[-1].box - log[0].box
    # Finger radius and half the box lie between the finger's centre and the box's.
    expected = push.end[0] - (-0.05 - 0.008)
    assert way[:2] @ push.direction == pytest.approx(expected, abs=2e-3)


def test_the_box_rests_while_the_finger_goes_away(pushed):
    _, log = pushed
    after = [sample.box for sample in log if sample.status.mode == "retreating"]
    assert np.abs(np.array(after) - after[0]).max() < 0.1e-3


def test_modes_follow_one_another(pushed):
    _, log = pushed
    modes = [mode for mode, _ in itertools.groupby(log, key=lambda sample: sample.status.mode)]
    assert modes == ["home", "approaching", "lowering", "pushing", "retreating", "home"]
    assert log[-1].status.reason == ""
    np.testing.assert_allclose(log[-1].measured, HOME, atol=1e-3)


def test_limits_hold_over_the_whole_push(rig, pushed):
    _, log = pushed
    command = np.array([sample.command for sample in log])
    assert np.all(np.abs(command) <= POSITION_LIMITS)
    speed = np.abs(np.diff(command, axis=0)) / SAMPLE
    assert np.all(speed <= SPEED_LIMITS)
    assert (speed.max(axis=0) / SPEED_LIMITS).max() > 0.3
    tip = np.array([rig.kinematics.pose(q).translation() for q in command])
    assert np.linalg.norm(np.diff(tip, axis=0), axis=1).max() / SAMPLE <= ExecutionConfig().transit_speed


def test_finger_is_high_unless_it_pushes(pushed):
    _, log = pushed
    lowest = min(s.tip[2] for s in log if s.status.mode in ("home", "approaching"))
    assert lowest > 0.075


def test_tip_pose_is_that_of_the_plant(pushed):
    _, log = pushed
    for sample in log[::20]:
        np.testing.assert_allclose(sample.tip_pose.translation(), sample.tip, atol=1e-9)


def test_tip_force_is_the_contact_force(pushed):
    _, log = pushed
    samples = touching(log)
    error = np.array([s.tip_force - s.contact_force for s in samples])
    force = np.array([s.contact_force for s in samples])
    moving = np.linalg.norm(force, axis=1) > 0.5 * 0.5 * BOX_MASS * 9.81
    assert moving.sum() > 20
    # Friction of the box on the table is 4.9 N; the driver smooths the torques over 10 ms.
    assert np.abs(error.mean(axis=0)).max() < 0.1
    assert np.sqrt((error**2).mean(axis=0)).max() < 0.6


def test_no_force_in_the_air(pushed):
    _, log = pushed
    for sample in log:
        if sample.status.mode == "approaching":
            np.testing.assert_allclose(sample.tip_force, 0, atol=1e-6)


def test_same_push_same_motion_to_the_bit(rig, pushed):
    push, log = pushed
    again = rig.run(rig.start(push), lambda sample: sample.time >= log[len(log) // 2].time - SAMPLE / 2)
    for one, other in zip(log, again, strict=False):
        assert one.time == other.time
        np.testing.assert_array_equal(one.command, other.command)
        np.testing.assert_array_equal(one.tip, other.tip)
        np.testing.assert_array_equal(one.box, other.box)


def test_unreachable_push_is_refused_and_the_arm_stays(rig):
    log = rig.run(rig.start(TablePush([0.2, 0.0], [0.8, 0.0], 0.1), push_id=7), done(7))
    assert log[-1].status.mode == "refused"
    assert "out of the arm's reach" in log[-1].status.reason
    assert log[-1].time < 0.1
    np.testing.assert_allclose(log[-1].command, HOME)


def test_after_a_refusal_the_next_push_is_made(rig):
    simulator = rig.start(TablePush([0.2, 0.0], [0.8, 0.0], 0.1), push_id=0)
    rig.run(simulator, done(0))
    rig.request(simulator, TablePush([-0.2, 0.2], [-0.15, 0.2], 0.1), 1)
    log = rig.run(simulator, lambda sample: sample.status.mode == "pushing")
    assert log[-1].status.push_id == 1
    assert log[-1].status.reason == ""


def test_a_push_is_made_once(rig):
    simulator = rig.start(TablePush([-0.2, 0.2], [-0.15, 0.2], 0.1))
    rig.run(simulator, done())
    now = simulator.get_context().get_time()
    log = rig.run(simulator, lambda sample: sample.time > now + 0.5)
    assert {sample.status.mode for sample in log} == {"home"}


def test_abort_lifts_the_finger_and_brings_the_arm_home(rig):
    simulator = rig.start(PUSHES[0.1])
    rig.run(simulator, lambda sample: sample.status.mode == "pushing")
    at = simulator.get_context().get_time()
    rig.run(simulator, lambda sample: sample.time > at + 0.3)
    rig.abort(simulator, True)
    log = rig.run(simulator, done())
    assert log[-1].status.reason == "aborted while pushing"
    assert {sample.status.mode for sample in log[5:]} == {"retreating", "home"}
    assert log[-1].box[0] < 0.015  # the whole push would take it to 0.078 m
    command = np.array([sample.command for sample in log])
    assert np.all(np.abs(np.diff(command, axis=0)) / SAMPLE <= SPEED_LIMITS)
    np.testing.assert_allclose(log[-1].measured, HOME, atol=1e-3)
    low = [s.tip for s in log if s.tip[2] < 0.05]
    assert np.ptp(np.array(low)[:, :2], axis=0).max() < 0.02


def test_arm_goes_home_from_wherever_it_starts(rig):
    start = HOME + np.array([0.1, -0.2, 0.1, 0.1, 0.1, 0.2, 0.0])
    simulator = rig.start(at=start)
    log = rig.run(simulator, lambda sample: sample.time > 2.0)
    np.testing.assert_allclose(log[0].command, start)
    assert np.abs(log[1].command - start).max() < 1e-3
    np.testing.assert_allclose(log[-1].measured, HOME, atol=1e-4)
    assert log[-1].status.mode == "home"
