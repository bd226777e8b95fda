"""What the guard does under each fault of arm, link and planner: how fast the arm rests, and what is said."""

from __future__ import annotations

import numpy as np
import pytest

from slipmap.diagrams.hardware.guard import PERIOD, CommandGuard, GuardSettings
from slipmap.diagrams.station.arm import HOME
from slipmap.diagrams.systems.python_system import PythonSystem
from slipmap.models.robots import ACCELERATION_LIMITS, POSITION_LIMITS, SPEED_LIMITS
from tests.diagrams.systems.driven_block import DrivenBlock
from tests.hardware.faults import MESSAGE, FollowingArm, StatusLink
from tests.hardware.guarded_arm import MODEL, NEAR, run

AT = 1.1
"""s; the finger then pushes, if the arm comes from near."""
FASTEST = 3.7
"""s; the finger then comes down to the push, if the arm comes from home: no joint ever turns faster."""
AFAR = (FASTEST, HOME)
REST = 0.02
"""s to brake, wherever the arm is."""


class Wish(PythonSystem):
    """Changes what the executor wants from a time on: the first joint leaps, creeps on, or is no number."""

    def __init__(self, at: float, leap: float = 0.0, creep: float = 0.0) -> None:
        super().__init__()
        self._at, self._leap, self._creep = at, leap, creep
        self.DeclareVectorInputPort("wanted", 7)
        self.DeclareVectorOutputPort("changed", 7, self._calc)

    def _calc(self, context, output) -> None:
        since = context.get_time() - self._at
        wanted = self.get_input_port().Eval(context).copy()
        if since >= -1e-9:
            wanted[0] += self._leap + self._creep * since
        output.SetFromVector(wanted)


class Signal(PythonSystem):
    """Numbers over time."""

    def __init__(self, of, size: int = 1) -> None:
        super().__init__()
        self.DeclareVectorOutputPort(
            "value", size, lambda context, out: out.SetFromVector(np.atleast_1d(of(context.get_time())))
        )


def held(log, after, within):
    """The arm is at rest so long after the fault, for good; the push has ended with the guard's words."""
    health = log.health[-1]
    assert health.mode == "stopped"
    assert log.moving[-1] <= min(after + within, health.rest + PERIOD) + 1e-9
    assert np.abs(log.commands[-1] - log.commands[-2]).max() == 0
    assert log.status.mode == "stopped"
    assert log.status.reason == health.text
    assert health.cause in health.text and health.remedy in health.text
    assert limited(log)
    return health


def limited(log):
    """No command of the whole log asks a joint or the finger for more speed than allowed."""
    fast = np.abs(log.speeds) <= SPEED_LIMITS * (1 + 1e-9)
    return bool(fast.all()) and bool((log.tip_speeds <= 1.01 * GuardSettings().tip_speed).all())


def smooth(log, stopped):
    """From the stop on speeds only fall, all joints alike."""
    speed = np.abs(log.speeds[log.times[1:] > stopped - PERIOD / 2])
    return bool((np.diff(speed, axis=0) <= 1e-9).all())


@pytest.fixture(scope="module")
def undisturbed():
    return run(11.0, home=HOME)


def test_without_a_fault_the_whole_push_passes_unchanged(undisturbed):
    """The guard changes no command, and a push with its ways there and back stays within all limits."""
    log = undisturbed
    assert all(health.ok for health in log.health)
    assert (log.status.mode, log.status.push_id) == ("home", 1)
    assert limited(log)
    turning = (np.abs(log.speeds) / SPEED_LIMITS).max(axis=1)
    assert turning[int(FASTEST / PERIOD)] > 0.98 * turning.max() > 0.45
    assert log.modes[int(FASTEST / PERIOD)] == "lowering"
    assert 0.35 < log.tip_speeds.max() <= GuardSettings().transit_speed + 1e-3
    assert run(AT).modes[-1] == "pushing"


@pytest.mark.parametrize(("at", "home"), [(AT, NEAR), AFAR])
def test_a_status_that_stops_is_noticed_when_it_is_too_old_and_the_arm_then_rests(at, home):
    log = run(at + 0.2, home=home, link=StatusLink("stop", at))
    health = held(log, at, GuardSettings().status_age + PERIOD + REST)
    assert "30 ms old, 25 ms are allowed" in health.cause
    assert "driver" in health.remedy
    assert smooth(log, health.time)


@pytest.mark.parametrize(("at", "home"), [(AT, NEAR), (1.5, HOME), AFAR, (5.0, HOME), (7.0, HOME)])
def test_wherever_the_arm_is_it_rests_50_ms_after_its_last_status(at, home):
    log = run(at + 0.2, home=home, link=StatusLink("stop", at))
    held(log, at - MESSAGE, 0.05)
    deceleration = np.abs(np.diff(log.speeds[log.times[1:] > at], axis=0)) / PERIOD
    gently = log.modes[int(at / PERIOD)] == "pushing"
    assert (deceleration <= (1.01 if gently else 4.5) * ACCELERATION_LIMITS).all()


def test_from_ways_faster_than_the_guards_own_the_arm_rests_a_little_later():
    fast = GuardSettings(transit_speed=1.5)
    log = run(0.9, home=HOME, settings=fast, link=StatusLink("stop", 0.7))
    held(log, 0.7 - MESSAGE, 0.065)
    assert log.tip_speeds.max() > 1.0


def test_a_status_that_stops_while_the_diagrams_clock_is_late_is_noticed_as_soon():
    """Ages are told by a clock that stands nearly still; silence by another."""
    stands = StatusLink("delay", AT, -0.4)
    log = run(AT + 0.2, link=stands, status_silence=Signal(lambda t: max(t - AT, 0.0)))
    assert "30 ms old, 25 ms are allowed" in held(log, AT, GuardSettings().status_age + PERIOD + REST).cause


def test_a_status_that_is_late_stops_the_arm_though_messages_keep_coming():
    log = run(AT + 0.2, link=StatusLink("delay", AT, 0.08))
    assert "ms old" in held(log, AT, GuardSettings().status_age + PERIOD + REST).cause


def test_a_status_that_is_a_little_late_stops_nothing():
    log = run(AT + 0.2, link=StatusLink("delay", AT, 0.02))
    assert log.health[-1].ok and log.status.mode == "pushing"


def test_a_status_that_repeats_itself_stops_the_arm_as_soon_as_it_should_have_moved_on():
    """Its stamps are new, so that only what it says gives it away."""
    log = run(AT + 1.2, link=StatusLink("repeat", AT))
    health = held(log, health_time(log), REST)
    assert "does not follow" in health.cause
    commands = log.commands[log.times >= AT]
    assert np.abs(commands - commands[0]).max() < GuardSettings().following + 0.03


def test_a_status_that_leaps_stops_the_arm_at_once():
    log = run(AT + 0.2, link=StatusLink("jump", AT, 0.2))
    assert "status jumps: iiwa_joint" in held(log, AT, 2 * PERIOD + REST).cause


def test_a_status_that_goes_back_in_time_is_dropped_and_counts_as_late():
    log = run(AT + 0.2, link=StatusLink("back", AT))
    assert "ms old" in held(log, AT, GuardSettings().status_age + PERIOD + REST).cause
    assert not any("leaps" in health.cause for health in log.health)


@pytest.mark.parametrize(
    ("at", "home", "leap"), [(AT, NEAR, -1.0), (AT, NEAR, np.nan), (*AFAR, 0.05), (*AFAR, np.inf)]
)
def test_a_wanted_position_that_leaps_or_is_no_number_becomes_a_hold(at, home, leap):
    """The arm does not go there, not by one step."""
    log = run(at + 0.3, home=home, before_guard=Wish(at, leap=leap))
    health = held(log, at, REST + PERIOD)
    assert ("jumps: iiwa_joint_1" if np.isfinite(leap) else "not a number") in health.cause
    assert smooth(log, health.time)


def test_a_wanted_position_that_creeps_to_a_joints_limit_stops_short_of_it():
    log = run(1.8, push=None, before_guard=Wish(0.1, creep=1.2))
    assert "iiwa_joint_1 comes too near its limit" in held(log, health_time(log), 0.05).cause
    margin = POSITION_LIMITS[0] - np.abs(log.commands[:, 0]).max()
    assert GuardSettings().joint_margin - 1e-9 <= margin < GuardSettings().joint_margin + 0.01


def test_a_finger_that_would_be_too_fast_stops_though_no_joint_is():
    settings = GuardSettings(transit_speed=1.0, tip_speed=0.5)
    log = run(1.5, home=HOME, settings=settings)
    assert "0.5 m/s are allowed" in held(log, health_time(log), REST + PERIOD).cause
    assert log.tip_speeds.max() <= 0.5


def test_an_arm_that_refuses_to_move_is_not_told_to_go_much_further():
    log = run(AT + 1.2, arm=FollowingArm(NEAR, "refuse", AT))
    health = held(log, health_time(log), REST)
    assert "does not follow" in health.cause and "braked" in health.remedy
    assert np.abs(log.commands[-1] - log.measured[-1]).max() < GuardSettings().following + 0.03


def test_a_force_that_lasts_stops_the_arm_within_50_ms_and_names_joint_and_torque():
    log = run(AT + 0.2, arm=FollowingArm(NEAR, "force", AT, 45.0))
    health = held(log, AT, 0.02 + 2 * PERIOD + REST)
    assert "45.0 N m at iiwa_joint_4, 30 N m are allowed" in health.cause
    assert health.time - AT < 0.05


def test_a_knock_as_when_the_finger_meets_an_object_stops_nothing():
    log = run(AT + 0.2, arm=FollowingArm(NEAR, "knock", AT, 45.0))
    assert log.health[-1].ok and log.status.mode == "pushing"


def test_abort_stops_at_once_and_letting_go_starts_nothing():
    """The stop lasts until the process is started anew."""
    log = run(AT + 0.5, abort=Signal(lambda t: float(AT <= t < AT + 0.3)))
    assert held(log, AT, PERIOD + REST).cause == "stopped by hand"


def test_a_fault_that_passes_stops_for_good_and_the_first_cause_stands():
    """The link comes back after 0.2 s, by then something else is wrong too."""
    log = run(AT + 0.5, abort=Signal(lambda t: float(AT <= t < AT + 0.1)), link=StatusLink("stop", AT + 0.2))
    assert held(log, AT, PERIOD + REST).cause == "stopped by hand"
    assert len({health for health in log.health if not health.ok}) == 1


def test_a_camera_that_stops_stops_the_arm_once_it_has_sent_a_picture():
    age = 0.2
    late = Signal(lambda t: max(t - AT, 0.05))
    log = run(AT + age + 0.1, settings=GuardSettings(image_age=age), image_age=late)
    assert "camera's last picture" in held(log, AT + age, PERIOD + REST).cause


def test_without_a_first_picture_the_arm_may_move():
    """Nothing is pushed before the object was seen; the supervisor waits for that, not the guard."""
    assert run(1.0, image_age=Signal(lambda t: np.inf)).health[-1].ok


def test_the_gripper_stays_as_it_was_after_a_stop():
    """The executor does not go on in time, neither with the arm nor with the gripper."""
    log = run(AT + 0.6, abort=Signal(lambda t: float(t >= AT)))
    assert {mode for mode in log.modes[int((AT + 0.1) / PERIOD) :]} == {"stopped"}


def test_a_gripper_that_does_not_close_ends_the_push_before_it_begins():
    """It has the time to close that a grasp has; a push with open pins would be of another finger."""
    stuck = run(1.8, gripper=Signal(lambda t: [0.094, 0.0], size=2))
    assert stuck.status.mode == "stopped" and stuck.health[-1].ok
    assert "does not close: it is open by 94 mm" in stuck.status.reason
    assert set(stuck.modes) == {"home", "stopped"}
    late = run(1.0, gripper=Signal(lambda t: [0.094 if t < 0.5 else 0.004, 0.0], size=2))
    assert late.status.mode in ("approaching", "lowering")


def test_an_arm_that_never_says_anything_is_an_error_after_a_while_and_moves_nowhere():
    block = Driven(status_age=[np.inf])
    assert block.health(1.0).mode == "waiting"
    health = block.health(GuardSettings().patience)
    assert health.mode == "stopped" and "no status of the arm" in health.cause
    assert np.array_equal(block.block.read("iiwa.position"), HOME)


@pytest.mark.parametrize("name", ["iiwa.position_measured", "iiwa.torque_external"])
def test_a_status_that_is_no_number_stops_the_arm(name):
    block = Driven()
    assert block.health(0.1).ok
    health = block.health(0.01, **{name: np.full(7, np.nan)})
    assert "not a number" in health.cause
    assert np.isfinite(block.block.read("iiwa.position")).all()


@pytest.mark.parametrize("age", [np.nan, -1.0, np.inf])
def test_an_age_that_cannot_be_stops_the_arm(age):
    block = Driven()
    assert block.health(0.1).ok
    assert "no possible age" in block.health(0.01, status_age=[age]).cause


@pytest.mark.parametrize(
    ("field", "value"),
    [("status_age", 0.0), ("tip_speed", np.nan), ("torque", [1.0]), ("torque", [0.0] * 7), ("stopping", 1.0)],
)
def test_settings_out_of_range_are_named(field, value):
    settings = GuardSettings()
    setattr(settings, field, value)
    with pytest.raises(ValueError, match=f"guard.{field} must"):
        CommandGuard(MODEL, settings)


class Driven:
    """The guard alone, at rest at home."""

    def __init__(self, **inputs) -> None:
        rest = {"iiwa.position": HOME, "iiwa.position_measured": HOME, "iiwa.torque_external": np.zeros(7)}
        self.block = DrivenBlock(CommandGuard(MODEL), **{**rest, "status_age": [0.0], **inputs})

    def health(self, duration, **inputs):
        self.block.set(**inputs)
        self.block.advance(duration)
        return self.block.read("health")


def health_time(log):
    return next(health.time for health in log.health if not health.ok)
