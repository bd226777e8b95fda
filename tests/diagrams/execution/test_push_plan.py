"""Plans of pushes: their geometry, limits and refusals, without simulation."""

from itertools import islice

import numpy as np
import pytest

from slipmap.diagrams.execution.arm_motion import FingerKinematics, MotionRefused
from slipmap.diagrams.execution.plans import ArmPlanner
from slipmap.diagrams.execution.requests import ExecutionConfig
from slipmap.diagrams.station.arm import HOME, arm_model
from slipmap.models.robots import ACCELERATION_LIMITS, POSITION_LIMITS, SPEED_LIMITS
from slipmap.planners.table_push import TablePush

CONFIG = ExecutionConfig()


@pytest.fixture(scope="module")
def kinematics():
    return FingerKinematics(arm_model())


def plan(kinematics, begin, end, speed=0.1, config=CONFIG):
    return ArmPlanner(kinematics, config, HOME).push(TablePush(begin, end, speed), HOME)


def phase_of(a_plan, mode):
    return next(phase for phase in a_plan.phases if phase.mode == mode)


def random_pushes(number):
    rng = np.random.default_rng(4)
    for _ in range(number):
        begin = rng.uniform(-0.2, 0.2, 2)
        angle = rng.uniform(-np.pi, np.pi)
        length = rng.uniform(0.05, 0.15)
        yield TablePush(begin, begin + length * np.array([np.cos(angle), np.sin(angle)]), 0.1)


@pytest.mark.parametrize("push", list(random_pushes(12)))
def test_pushes_in_the_middle_of_the_table_can_be_made(kinematics, push):
    made = ArmPlanner(kinematics, CONFIG, HOME).push(push, HOME)
    q = np.array([made.at(time)[1] for time in np.arange(0, made.duration, 0.005)])
    assert np.all(np.abs(q) <= POSITION_LIMITS)
    speed = np.diff(q, axis=0) / 0.005
    assert np.all(np.abs(speed) <= SPEED_LIMITS)
    pushing = phase_of(made, "pushing").trajectory
    times = np.linspace(0, pushing.end_time(), 200)
    tip = np.array([kinematics.pose(pushing.value(time)[:, 0]).translation() for time in times])
    across = (tip[:, :2] - push.begin) @ [-push.direction[1], push.direction[0]]
    assert np.abs(across).max() < 0.1e-3
    np.testing.assert_allclose(tip[:, 2], CONFIG.tip_height, atol=0.1e-3)


def turn_of_hand(kinematics, made):
    """Range of the hand's directions while it pushes, degrees."""
    pushing = phase_of(made, "pushing").trajectory
    times = np.linspace(0, pushing.end_time(), 50)
    return np.degrees(np.ptp(np.unwrap([kinematics.yaw(pushing.value(time)[:, 0]) for time in times])))


@pytest.mark.parametrize("begin", [[0.12, 0.17], [-0.2, -0.1], [0.1, -0.28]])
@pytest.mark.parametrize("angle", [0.5, 2.1, 3.6, 5.2])
def test_the_hand_does_not_turn_while_it_pushes(kinematics, begin, angle):
    """It would roll the round finger along the object."""
    end = begin + 0.2 * np.array([np.cos(angle), np.sin(angle)])
    assert turn_of_hand(kinematics, plan(kinematics, begin, end)) < 1.0


@pytest.mark.parametrize("any_will_do", [False, True])
def test_of_the_first_directions_the_easiest_on_the_joints_is_taken(kinematics, any_will_do):
    """On this line all four of them are possible, and the third is the easiest."""
    planner = ArmPlanner(kinematics, CONFIG, HOME)
    push = TablePush([-0.22, -0.21], [-0.17, -0.3], 0.1)
    four = [planner._push_held(posture, push, HOME) for posture in islice(planner._steady(push), 4)]
    speeds = [np.abs(joint_speeds(phase_of(made, "pushing"))).max(axis=1) for made in four]
    easiest = int(np.argmin([(each / ACCELERATION_LIMITS).max() for each in speeds]))
    assert easiest == 2
    made = planner.push(push, HOME, any_will_do=any_will_do)
    wanted = four[0 if any_will_do else easiest]
    np.testing.assert_array_equal(
        made.at(made.phases[0].duration)[1], wanted.at(wanted.phases[0].duration)[1]
    )


def joint_speeds(phase):
    """(7, 50) rad/s."""
    motion = phase.trajectory
    return motion.MakeDerivative().vector_values(np.linspace(0.0, motion.end_time(), 50))


def test_the_hand_turns_where_it_could_not_push_otherwise(kinematics):
    """On this line across the table, no direction of the hand is possible at both ends."""
    made = plan(kinematics, [0.25, -0.26], [-0.07, 0.3])
    assert turn_of_hand(kinematics, made) > 10.0


def test_plan_has_no_leaps_and_begins_and_ends_at_home(kinematics):
    made = plan(kinematics, [0, -0.1], [0, 0.05])
    np.testing.assert_allclose(made.at(0.0)[1], HOME, atol=1e-12)
    np.testing.assert_allclose(made.at(made.duration + 1.0)[1], HOME, atol=1e-9)
    step = 1e-3
    q = np.array([made.at(time)[1] for time in np.arange(0, made.duration + 0.1, step)])
    assert np.abs(np.diff(q, axis=0)).max() < step * SPEED_LIMITS.max()
    acceleration = np.diff(q, 2, axis=0) / step**2
    assert np.all(np.abs(acceleration) <= ACCELERATION_LIMITS)


@pytest.mark.parametrize(("length", "speed"), [(0.1, 0.05), (0.1, 0.2), (0.01, 0.2)])
def test_finger_speeds_up_and_slows_down_as_configured(kinematics, length, speed):
    made = plan(kinematics, [0, 0], [length, 0], speed)
    pushing = phase_of(made, "pushing").trajectory
    step = 0.002
    times = np.arange(0, pushing.end_time(), step)
    x = np.array([kinematics.pose(pushing.value(time)[:, 0]).translation()[0] for time in times])
    v, a = np.diff(x) / step, np.diff(x, 2) / step**2
    top = min(speed, np.sqrt(2 * length / (1 / CONFIG.speeding_up + 1 / CONFIG.slowing_down)))
    assert v.max() == pytest.approx(top, rel=0.02)
    assert a.max() == pytest.approx(CONFIG.speeding_up, rel=0.05)
    assert a.min() == pytest.approx(-CONFIG.slowing_down, rel=0.05)
    assert x[-1] == pytest.approx(length, abs=1e-5)
    resting = times[:-1][v > 1e-4].max()
    assert pushing.end_time() - resting == pytest.approx(CONFIG.settle, abs=0.02)


@pytest.mark.parametrize(
    ("begin", "end", "reason"),
    [
        ([0.2, 0.0], [0.8, 0.0], r"cannot point down at \(0\.\d+, 0\.000\) m.* out of the arm's reach"),
        ([0.8, 0.0], [0.2, 0.0], r"cannot point down at \(0\.800, 0\.000\) m"),
    ],
)
def test_a_push_out_of_reach_is_refused_with_the_point(kinematics, begin, end, reason):
    with pytest.raises(MotionRefused, match=reason):
        plan(kinematics, begin, end)


def test_a_push_too_fast_for_the_finger_is_refused(kinematics):
    with pytest.raises(
        MotionRefused, match=r"0\.31 m/s is faster than the finger may push, at most 0\.3 m/s"
    ):
        plan(kinematics, [0, 0], [0.1, 0], speed=0.31)


def test_a_push_too_fast_for_a_joint_is_refused_with_the_joint(kinematics):
    fast = ExecutionConfig(push_speed_limit=1.0, speeding_up=5.0, slowing_down=5.0)
    with pytest.raises(MotionRefused, match=r"iiwa_joint_\d would have to (turn at|speed up by) \d+ degrees"):
        plan(kinematics, [0.4, -0.25], [0.4, 0.25], speed=1.0, config=fast)


def test_a_way_that_would_sweep_the_table_is_refused(kinematics):
    low = kinematics.inverse(np.array([0.2, -0.2, 0.03]))
    with pytest.raises(
        MotionRefused, match=r"the gripper would come down to 0\.03\d m, at least 0\.080 m are safe"
    ):
        ArmPlanner(kinematics, CONFIG, low).push(TablePush([0.2, 0.1], [0.25, 0.1], 0.1), HOME)


def test_a_push_past_a_change_of_the_nearest_posture_can_be_made(kinematics):
    """Another posture becomes the nearest to the working posture here; the joints must not leap to it."""
    made = plan(kinematics, [0.023, 0.207], [0.083, 0.028])
    pushing = phase_of(made, "pushing").trajectory
    q = pushing.vector_values(np.linspace(0, pushing.end_time(), 200))
    assert np.abs(np.diff(q, axis=1)).max() < 0.02


def test_finger_stays_high_on_its_ways(kinematics):
    for begin in ([-0.3, 0.0], [0.25, 0.1], [0.0, -0.3], [0.0, 0.35]):
        made = plan(kinematics, begin, [begin[0], begin[1] + 0.05])
        for phase in (made.phases[0], made.phases[-1]):
            for time in np.linspace(0, phase.duration, 50):
                assert kinematics.pose(phase.trajectory.value(time)[:, 0]).translation()[2] > 0.075


def test_retreat_stops_within_the_limits_lifts_and_goes_home(kinematics):
    made = plan(kinematics, [0, -0.1], [0, 0.05])
    begin = sum(phase.duration for phase in made.phases[:2])
    q, speed = made.motion(begin + 0.6)
    assert np.linalg.norm(kinematics.jacobian(q)[3:] @ speed) == pytest.approx(0.1, rel=0.02)
    retreat = ArmPlanner(kinematics, CONFIG, HOME).retreat(q, speed)
    step = 1e-3
    log = np.array([retreat.at(time)[1] for time in np.arange(0, retreat.duration + 0.1, step)])
    np.testing.assert_allclose((log[1] - log[0]) / step, speed, atol=0.02)
    assert np.all(np.abs(np.diff(log, 2, axis=0)) / step**2 <= 1.01 * ACCELERATION_LIMITS)
    np.testing.assert_allclose(log[-1], HOME, atol=1e-9)
    tip = np.array([kinematics.pose(row).translation() for row in log])
    low = tip[tip[:, 2] < 0.5 * CONFIG.safe_height]
    assert np.ptp(low[:, :2], axis=0).max() < 0.02
    assert low[:, 2].min() > CONFIG.tip_height - 1e-3
    assert tip[np.argmax(tip[:, 2] > 0.09) :, 2].min() > 0.075


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"tip_height": 0.0}, "tip_height must lie between 0.001 and 0.05, got 0.0"),
        ({"settle": float("nan")}, "settle must lie between"),
        ({"tip_height": 0.03, "safe_height": 0.02}, "safe_height 0.02 must exceed tip_height 0.03"),
    ],
)
def test_config_out_of_range_is_named(values, reason):
    with pytest.raises(ValueError, match=reason):
        ExecutionConfig(**values)
