"""What makes the guard stop the arm."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from slipmap.diagrams.execution.finger_kinematics import FingerKinematics
from slipmap.diagrams.execution.requests import Health
from slipmap.diagrams.execution.settings import ExecutionConfig
from slipmap.diagrams.hardware.channels import ARM_PERIOD
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import ACCELERATION_LIMITS, ARM_JOINTS, POSITION_LIMITS, SPEED_LIMITS

# When the guard stops the arm.


# Annotations stay objects: Drake's YAML reader looks at them.


@dataclass
class GuardSettings:
    """When the guard stops the arm; the defaults let everything pass that the executor plans.

    Attributes:
        status_age: oldest status of the arm that is good enough to move by, s.
        image_age: oldest picture that is good enough to move by, s.
        transit_speed: largest speed of the finger on its way to a push and back, m/s; at 0.4 the arm rests
            50 ms after the last status wherever it is, from faster ways later.
        tip_speed: largest speed of the finger's end that a command may ask for, m/s.
        joint_margin: what must be left to a joint's limit when the arm has come to rest, rad.
        following: by which a joint may be off all that it was told within `lag`, rad.
        lag: time that the arm has to get to where it was told to be, s.
        torque: (7) largest torque that contact may put on each joint, N m.
        stopping: longest time from the last free command to rest, s; slow motions stop sooner.
        patience: time that the arm has to send its first status, s.

    Raises:
        ValueError: a value out of range.
    """

    status_age: float = 0.025
    image_age: float = 1.0
    transit_speed: float = 0.4
    tip_speed: float = 1.7
    joint_margin: float = 0.0175
    following: float = 0.05
    lag: float = 0.1
    torque: list[float] = field(default_factory=lambda: [40.0, 40.0, 30.0, 30.0, 20.0, 15.0, 15.0])
    stopping: float = 0.05
    patience: float = 10.0

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Raise ValueError where a field makes no sense."""
        for name, low, high in (
            ("status_age", 0.01, 0.5),
            ("image_age", 0.1, 60.0),
            ("transit_speed", 0.01, 2.0),
            ("tip_speed", 0.01, 2.5),
            ("joint_margin", 0.0, 0.3),
            ("following", 0.005, 0.5),
            ("lag", 0.02, 1.0),
            ("stopping", 0.02, 0.2),
            ("patience", 0.1, 600.0),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"guard.{name} must lie between {low} and {high}, got {value}")
        torque = np.array(self.torque, dtype=float)
        if torque.shape != (7,) or not ((torque > 0) & (torque <= 320.0)).all():
            raise ValueError(
                f"guard.torque must be seven torques above 0 and up to 320 N m, got {self.torque}"
            )

    def held_to(self, execution: ExecutionConfig) -> ExecutionConfig:
        """How the arm moves where this guard is to stop it in time."""
        return replace(execution, transit_speed=min(execution.transit_speed, self.transit_speed))


# How fast the arm is brought to rest when something is wrong.


_SOONEST = 2 * ARM_PERIOD

_SOON = 4 * ARM_PERIOD
"""s; in a push the finger brakes so long by the data sheet."""

_HARD = 4.5
"""Times the acceleration that the data sheet allows for motions, in an emergency."""


def braking(speed: FloatArray, longest: float) -> float:
    """Time for even braking, s, a whole number of commands.

    At the acceleration that the robot's data sheet allows for motions where the arm then rests within 20 ms;
    within 20 ms where that takes up to 4.5 times as much; else at 4.5 times as much, but within the longest
    time, whatever that asks of the joints.

    Args:
        speed: (7,) of the joints, rad/s.
        longest: s.
    """
    gentle = float((np.abs(speed) / ACCELERATION_LIMITS).max())
    needed = max(min(gentle, _SOON), gentle / _HARD)
    return min(max(ARM_PERIOD * np.ceil(needed / ARM_PERIOD - 1e-9), _SOONEST), longest)


PERIOD = 0.005
"""s between two commands."""

_LEAP_SPEED, _LEAP = 1.5, 0.01
"""A measured angle that moves by more than this many times the joint's largest speed and this angle (rad)
did not move, but is wrong."""

_BLOW = 0.02
"""s that a torque must last: the blow when the finger meets an object at 0.3 m/s has 98 N m, but briefly."""

_CLOCKS = 0.5
"""s by which a message may seem to come from the future: this process's clock is late when it was busy. How
long none has come is told by another clock then."""

_START = "check the arm and its surroundings, then start again"
LINK = (
    "see whether the arm's driver runs, the cable holds and this computer is not too busy, then start again"
)


@dataclass(frozen=True, eq=False)
class Told:
    """What the guard is told; arrays are (7,)."""

    time: float
    wanted: FloatArray
    measured: FloatArray
    torque: FloatArray
    status_age: float
    silence: float
    image_age: float
    abort: bool


@dataclass(frozen=True, eq=False)
class Stop:
    """The way to rest: from joint angles `q` (7) at speeds `v` (7) to `rest` (7), from `begin` on, s; `back`
    where that is not ahead, but away from what presses against the arm."""

    q: FloatArray
    v: FloatArray
    rest: FloatArray
    begin: float
    duration: float
    back: bool

    def at(self, time: float) -> FloatArray:
        """Cubic; straight braking with an even deceleration where `rest` is half the way of no braking."""
        s = min((time - self.begin) / self.duration, 1.0)
        way = self.rest - self.q
        return self.q + (s - 2 * s**2 + s**3) * self.duration * self.v + (3 * s**2 - 2 * s**3) * way


@dataclass(frozen=True, eq=False)
class Guarded:
    """State: what the arm was told, and what it said.

    Attributes:
        health: see there.
        commands: (n, 7) of the last `lag`, newest last; empty while there was no status.
        speed: (7,) of the newest command, rad/s.
        stop: the way to rest, once it is stopped.
        last: the inputs before.
        saw: whether a picture has come.
        pressed: time since which the torque of contact is too large, s; infinite while it is not.
    """

    health: Health
    commands: FloatArray
    speed: FloatArray
    stop: Stop | None = None
    last: Told | None = None
    saw: bool = False
    pressed: float = np.inf


class GuardRules:
    """Looks for faults.

    Args:
        settings: when to stop.
        kinematics: of the arm.
    """

    def __init__(self, settings: GuardSettings, kinematics: FingerKinematics) -> None:
        self._settings = settings
        self._kinematics = kinematics

    def faults(self, now: Guarded, inputs: Told) -> Iterator[tuple[str, str]]:
        """What is wrong, and what to do."""
        for rule in (self._abort_fault, self._status_fault, self._arm_fault, self._wanted_fault):
            yield from rule(now, inputs)

    def _abort_fault(self, now: Guarded, inputs: Told) -> Iterator[tuple[str, str]]:
        if inputs.abort:
            yield "stopped by hand", "start again to go on"

    def _status_fault(self, now: Guarded, inputs: Told) -> Iterator[tuple[str, str]]:
        """Messages that are late or make no sense."""
        settings = self._settings
        age = max(inputs.status_age, inputs.silence) if inputs.silence > 0.0 else inputs.status_age
        if not is_age(age, settings.status_age) or not is_age(inputs.status_age, settings.status_age):
            yield f"the arm's last status is {_late(age, settings.status_age)}", LINK
        if now.saw and not is_age(inputs.image_age, settings.image_age):
            late = _late(inputs.image_age, settings.image_age)
            yield (
                f"the camera's last picture is {late}",
                "see whether the camera's driver runs and the cable holds, then start again",
            )
        if not np.isfinite([inputs.measured, inputs.torque]).all():
            yield "the arm's status holds something that is no number", LINK
        last = now.last
        assert last is not None
        between = max(inputs.time - inputs.status_age - last.time + last.status_age, 0.0)
        moved = np.abs(inputs.measured - last.measured)
        k = _worst(moved - _LEAP_SPEED * SPEED_LIMITS * between)
        if moved[k] > _LEAP_SPEED * SPEED_LIMITS[k] * between + _LEAP:
            leap = f"{_degrees(moved[k])} within {1e3 * between:.0f} ms"
            yield (
                f"the arm's status leaps: {ARM_JOINTS[k]} by {leap}",
                "see whether two drivers send to one address, then start again",
            )

    def _arm_fault(self, now: Guarded, inputs: Told) -> Iterator[tuple[str, str]]:
        """An arm that does not go where it shall, or touches what it shall not."""
        settings, measured = self._settings, inputs.measured
        off = np.maximum(now.commands.min(axis=0) - measured, measured - now.commands.max(axis=0))
        k = _worst(off)
        if off[k] > settings.following:
            yield (
                f"the arm does not follow: {ARM_JOINTS[k]} is {_degrees(off[k])} off what it was told, "
                f"{_degrees(settings.following)} are allowed",
                "see whether the arm is blocked, in another mode or braked, then start again",
            )
        if self.presses(now, inputs):
            torque, most = np.abs(inputs.torque), np.array(settings.torque)
            k = _worst(torque / most)
            yield (
                f"something pushes against the arm: {torque[k]:.1f} N m at {ARM_JOINTS[k]}, "
                f"{most[k]:g} N m are allowed",
                _START,
            )

    def presses(self, now: Guarded, inputs: Told) -> bool:
        """Whether something has pressed against the arm for too long."""
        lasts = inputs.time - now.pressed > _BLOW - 1e-9
        return bool(lasts and np.isfinite([inputs.measured, inputs.torque]).all())

    def pressed(self, torque: FloatArray) -> bool:
        """Whether contact puts too large a torque (7,) on a joint, N m."""
        return bool((np.abs(torque) > self._settings.torque).any())

    def _wanted_fault(self, now: Guarded, inputs: Told) -> Iterator[tuple[str, str]]:
        """A motion that is asked for and must not be made."""
        settings, wanted = self._settings, inputs.wanted
        if not np.isfinite(wanted).all():
            yield "the wanted position is no number", _START
            return
        speed = (wanted - now.commands[-1]) / PERIOD
        k = _worst(np.abs(speed) / SPEED_LIMITS)
        if abs(speed[k]) > SPEED_LIMITS[k]:
            yield (
                f"the wanted position leaps: {ARM_JOINTS[k]} would have to turn at {_degrees(abs(speed[k]))} "
                f"a second, of which {_degrees(SPEED_LIMITS[k])} are allowed",
                _START,
            )
        tip_speed = float(np.linalg.norm(self._kinematics.jacobian(wanted)[3:] @ speed))
        if tip_speed > settings.tip_speed:
            yield (
                f"the finger would have to move at {tip_speed:.2f} m/s, of which {settings.tip_speed:g} m/s "
                "are allowed",
                _START,
            )
        rest = np.abs(wanted + speed * braking(speed, settings.stopping) / 2.0)
        k = _worst(rest - POSITION_LIMITS)
        if rest[k] > POSITION_LIMITS[k] - settings.joint_margin:
            limit = f"{_degrees(rest[k])} of {_degrees(POSITION_LIMITS[k])}"
            yield (
                f"{ARM_JOINTS[k]} comes near its limit: {limit}",
                "move the arm away from the limit by hand, then start again",
            )


def is_age(age: float, most: float) -> bool:
    """Whether an age is possible and not too large, s."""
    return -_CLOCKS <= age <= most + 1e-9


def _late(age: float, most: float) -> str:
    if not -_CLOCKS <= age < np.inf:
        return f"of no possible age ({age:g} s)"
    return f"{1e3 * age:.0f} ms old, {1e3 * most:.0f} ms are allowed"


def _worst(values: FloatArray) -> int:
    return int(np.argmax(values))


def _degrees(angle: float) -> str:
    return f"{np.rad2deg(angle):.1f}°"
