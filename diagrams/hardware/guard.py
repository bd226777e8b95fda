"""The block between the executor and the arm: on a fault it stops the arm, holds it, and states the cause.

`GuardSettings` define the limits, `_Rules` detect faults, and `CommandGuard` brings the arm to rest.
"""

# Annotations stay objects, because Drake's YAML reader inspects them.
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from slipmap.diagrams.execution.arm_motion import FingerKinematics
from slipmap.diagrams.execution.requests import ExecutionConfig, Health
from slipmap.diagrams.hardware.command_stream import braking_time
from slipmap.diagrams.systems.python_system import PythonSystem, held, read
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import ARM_JOINTS, POSITION_LIMITS, SPEED_LIMITS
from slipmap.models.settings import CheckedSettings, within

PERIOD = 0.005  # s between two commands

# A measured angle that changes faster than this multiple of the joint's largest speed, and by more than this
# (rad), is wrong.
_LEAP_SPEED, _LEAP = 1.5, 0.01

_BLOW = 0.02  # s that a torque must last; an impact with an object at 0.3 m/s briefly has 98 N m

# s by which a message may seem to come from the future, because this process's clock is late after it was
# busy. Another clock then measures how long none has come.
_CLOCKS = 0.5

_BACK = 2.5  # times the fastest joint's time for moving back from something that it presses on

_START = "check the arm and its surroundings, then start again"
_LINK = (
    "check that the arm's driver is running, the cable is connected and this computer is not overloaded, then"
    " start again"
)


@dataclass
class GuardSettings(CheckedSettings):
    """When the guard stops the arm; the defaults allow everything that the executor plans."""

    _section = "guard."

    status_age: float = within(0.025, 0.01, 0.5)  # largest age of the arm's status for moving, s
    image_age: float = within(1.0, 0.1, 60.0)  # largest age of the picture for moving, s
    # largest speed of the finger on its way to a push and back, m/s; at 0.4 the arm always rests 50 ms after
    # the last status, at higher speeds later
    transit_speed: float = within(0.4, 0.01, 2.0)
    # largest speed of the finger's end that a command may ask for, m/s
    tip_speed: float = within(1.7, 0.01, 2.5)
    # smallest distance from a joint's limit after the arm has come to rest, rad
    joint_margin: float = within(0.0175, 0.0, 0.3)
    following: float = within(0.05, 0.005, 0.5)  # largest error of a joint from all commands in `lag`, rad
    lag: float = within(0.1, 0.02, 1.0)  # time in which the arm must follow a command, s
    # (7) largest torque that contact may put on each joint, N m
    torque: list[float] = field(default_factory=lambda: [40.0, 40.0, 30.0, 30.0, 20.0, 15.0, 15.0])
    # longest time from the last free command to rest, s; slow motions stop sooner
    stopping: float = within(0.05, 0.02, 0.2)
    patience: float = within(10.0, 0.1, 600.0)  # time that the arm has to send its first status, s

    def check(self) -> None:
        """Raise ValueError for an invalid field."""
        super().check()
        torque = np.array(self.torque, dtype=float)
        if torque.shape != (7,) or not ((torque > 0) & (torque <= 320.0)).all():
            raise ValueError(
                f"guard.torque must be seven torques above 0 and up to 320 N m, got {self.torque}"
            )

    def held_to(self, execution: ExecutionConfig) -> ExecutionConfig:
        """The execution settings, slowed down so that this guard can stop the arm in time."""
        return replace(execution, transit_speed=min(execution.transit_speed, self.transit_speed))


@dataclass(frozen=True, eq=False)
class _Inputs:
    """The guard's inputs; arrays are (7,)."""

    time: float
    wanted: FloatArray
    measured: FloatArray
    torque: FloatArray
    status_age: float
    silence: float
    image_age: float
    abort: bool


@dataclass(frozen=True, eq=False)
class _Stop:
    """The motion to rest: from joint angles `q` (7) at speeds `v` (7) to `rest` (7), starting at `begin`, s;
    `back` if that is not ahead, but away from something that presses against the arm."""

    q: FloatArray
    v: FloatArray
    rest: FloatArray
    begin: float
    duration: float
    back: bool

    def at(self, time: float) -> FloatArray:
        """Joint angles on a cubic; constant deceleration if `rest` is half the path without braking."""
        s = min((time - self.begin) / self.duration, 1.0)
        way = self.rest - self.q
        return self.q + (s - 2 * s**2 + s**3) * self.duration * self.v + (3 * s**2 - 2 * s**3) * way


@dataclass(frozen=True, eq=False)
class _Guarded:
    """State: the commands sent, and the arm's last status."""

    health: Health
    commands: FloatArray  # (n, 7) of the last `lag`, newest last; empty before the first status
    speed: FloatArray  # (7,) of the newest command, rad/s
    stop: _Stop | None = None  # the motion to rest, once stopped
    last: _Inputs | None = None  # the previous inputs
    saw: bool = False  # whether a picture has come
    # time since which the contact torque has been too large, s; infinite while it is not
    pressed: float = np.inf


class _Rules:
    def __init__(self, settings: GuardSettings, kinematics: FingerKinematics) -> None:
        self._settings = settings
        self._kinematics = kinematics

    def faults(self, now: _Guarded, inputs: _Inputs) -> Iterator[tuple[str, str]]:
        for rule in (self._abort_fault, self._status_fault, self._arm_fault, self._wanted_fault):
            yield from rule(now, inputs)

    def _abort_fault(self, now: _Guarded, inputs: _Inputs) -> Iterator[tuple[str, str]]:
        if inputs.abort:
            yield "stopped by hand", "start again to continue"

    def _status_fault(self, now: _Guarded, inputs: _Inputs) -> Iterator[tuple[str, str]]:
        """Messages that are late or implausible."""
        settings = self._settings
        age = max(inputs.status_age, inputs.silence) if inputs.silence > 0.0 else inputs.status_age
        if not _is_age(age, settings.status_age) or not _is_age(inputs.status_age, settings.status_age):
            yield f"the arm's last status is {_late(age, settings.status_age)}", _LINK
        if now.saw and not _is_age(inputs.image_age, settings.image_age):
            late = _late(inputs.image_age, settings.image_age)
            yield (
                f"the camera's last picture is {late}",
                "check that the camera's driver is running, the cable is connected and no depth is NaN, then"
                " start again",
            )
        if not np.isfinite([inputs.measured, inputs.torque]).all():
            yield "the arm's status has a value that is not a number", _LINK
        last = now.last
        assert last is not None
        between = max(inputs.time - inputs.status_age - last.time + last.status_age, 0.0)
        moved = np.abs(inputs.measured - last.measured)
        k = np.argmax(moved - _LEAP_SPEED * SPEED_LIMITS * between)
        if moved[k] > _LEAP_SPEED * SPEED_LIMITS[k] * between + _LEAP:
            leap = f"{_degrees(moved[k])} within {1e3 * between:.0f} ms"
            yield (
                f"the arm's status jumps: {ARM_JOINTS[k]} by {leap}",
                "check whether two drivers send to one address, then start again",
            )

    def _arm_fault(self, now: _Guarded, inputs: _Inputs) -> Iterator[tuple[str, str]]:
        """An arm that does not follow its commands, or touches something that it should not."""
        settings, measured = self._settings, inputs.measured
        off = np.maximum(now.commands.min(axis=0) - measured, measured - now.commands.max(axis=0))
        k = np.argmax(off)
        if off[k] > settings.following:
            yield (
                f"the arm does not follow: {ARM_JOINTS[k]} is {_degrees(off[k])} off its commands, "
                f"{_degrees(settings.following)} are allowed",
                "check whether the arm is blocked, in another mode or braked, then start again",
            )
        if self.presses(now, inputs):
            torque, most = np.abs(inputs.torque), np.array(settings.torque)
            k = np.argmax(torque / most)
            yield (
                f"something pushes against the arm: {torque[k]:.1f} N m at {ARM_JOINTS[k]}, "
                f"{most[k]:g} N m are allowed",
                _START,
            )

    def presses(self, now: _Guarded, inputs: _Inputs) -> bool:
        """Whether something has pressed against the arm for too long."""
        return bool(
            inputs.time - now.pressed > _BLOW - 1e-9 and np.isfinite([inputs.measured, inputs.torque]).all()
        )

    def pressed(self, torque: FloatArray) -> bool:
        """Whether contact puts too large a torque (7,) on a joint, N m."""
        return bool((np.abs(torque) > self._settings.torque).any())

    def _wanted_fault(self, now: _Guarded, inputs: _Inputs) -> Iterator[tuple[str, str]]:
        """A commanded motion that must not be made."""
        settings, wanted = self._settings, inputs.wanted
        if not np.isfinite(wanted).all():
            yield "the commanded position is not a number", _START
            return
        speed = (wanted - now.commands[-1]) / PERIOD
        k = np.argmax(np.abs(speed) / SPEED_LIMITS)
        if abs(speed[k]) > SPEED_LIMITS[k]:
            yield (
                f"the commanded position jumps: {ARM_JOINTS[k]} would have to turn at"
                f" {_degrees(abs(speed[k]))} per second; {_degrees(SPEED_LIMITS[k])} are allowed",
                _START,
            )
        tip_speed = float(np.linalg.norm(self._kinematics.jacobian(wanted)[3:] @ speed))
        if tip_speed > settings.tip_speed:
            yield (
                f"the finger would have to move at {tip_speed:.2f} m/s; {settings.tip_speed:g} m/s are"
                " allowed",
                _START,
            )
        rest = np.abs(wanted + speed * braking_time(speed, settings.stopping) / 2.0)
        k = np.argmax(rest - POSITION_LIMITS)
        if rest[k] > POSITION_LIMITS[k] - settings.joint_margin:
            limit = f"{_degrees(rest[k])} of {_degrees(POSITION_LIMITS[k])}"
            yield (
                f"{ARM_JOINTS[k]} comes too near its limit: {limit}",
                "move the arm away from the limit by hand, then start again",
            )


class CommandGuard(PythonSystem):
    """Passes joint angles on to the arm while there is no fault; on a fault it brings the arm to rest and
    holds it.

    Input ports:

    - `iiwa.position` (7,) commanded, rad; `iiwa.position_measured` (7,) rad; `iiwa.torque_external` (7,) N m,
      from contact with the arm.
    - `status_age` (1,) s, of the newest valid status; infinite before the first.
    - `status_silence` (optional, (1,) s) since a status was found, by this computer's clock, which runs on
      while the diagram's, and with it all ages, is late.
    - `image_age` (optional, (1,) s) of the newest valid picture; infinite before the first.
    - `abort` (optional, (1,)): above 0.5 stops the arm.

    Output ports: `iiwa.position` (7,) rad, new every `PERIOD`; `health`: `Health`.

    Until the first status it waits, and commands the arm to stay at its reported position. The following stop
    the arm: a late or impossible status; an arm that does not follow its commands; a late picture, once there
    was one; contact torque; a commanded position that is not a number, jumps, demands too much speed of a
    joint or the finger, or comes near a joint's limit; `abort`. The command is then brought to rest at
    constant deceleration, as fast as the joints' data sheet allows and within `GuardSettings.stopping`,
    whatever is commanded, and stays there. If something presses against the arm, it stops at the measured
    position instead, which relieves the contact.

    It stays stopped until the process is restarted, even if the cause disappears or `abort` returns to 0: an
    arm must not start to move because a cable was plugged in or a button released, and plans made before the
    fault may no longer be valid. `slipmap explore --resume` continues from the recording.

    Args:
        model: the arm, as built by `arm_model`.

    Raises:
        ValueError: settings out of range.
    """

    def __init__(self, model: MultibodyPlant, settings: GuardSettings | None = None) -> None:
        super().__init__()
        self._settings = settings or GuardSettings()
        self._settings.check()
        self._rules = _Rules(self._settings, FingerKinematics(model))
        self._wanted = self.DeclareVectorInputPort("iiwa.position", 7)
        self._measured = self.DeclareVectorInputPort("iiwa.position_measured", 7)
        self._torque = self.DeclareVectorInputPort("iiwa.torque_external", 7)
        self._status_age = self.DeclareVectorInputPort("status_age", 1)
        self._silence = self.DeclareVectorInputPort("status_silence", 1)
        self._image_age = self.DeclareVectorInputPort("image_age", 1)
        self._abort = self.DeclareVectorInputPort("abort", 1)
        start = _Guarded(Health("waiting"), np.zeros((0, 7)), np.zeros(7))
        self._guarded = self.DeclareAbstractState(held(start))
        self.declare_steps(PERIOD, self._guarded, lambda context, now: self._next(now, self._inputs(context)))
        own = self.abstract_state_ticket(self._guarded)
        self.declare_vector_output("iiwa.position", 7, self._position, {own, self._measured.ticket()})
        self.declare_output_of("health", self._guarded, lambda guarded: guarded.health)

    def _inputs(self, context: Context) -> _Inputs:
        image_age = self._image_age.Eval(context)[0] if self._image_age.HasValue(context) else np.inf
        abort = self._abort.HasValue(context) and not self._abort.Eval(context)[0] <= 0.5
        return _Inputs(
            time=context.get_time(),
            wanted=self._wanted.Eval(context).copy(),
            measured=self._measured.Eval(context).copy(),
            torque=self._torque.Eval(context).copy(),
            status_age=float(self._status_age.Eval(context)[0]),
            silence=float(self._silence.Eval(context)[0]) if self._silence.HasValue(context) else 0.0,
            image_age=float(image_age),
            abort=bool(abort),
        )

    def _next(self, now: _Guarded, inputs: _Inputs) -> _Guarded:
        now = replace(
            now,
            saw=now.saw or _is_age(inputs.image_age, self._settings.image_age),
            pressed=min(now.pressed, inputs.time) if self._rules.pressed(inputs.torque) else np.inf,
        )
        health = now.health
        if health.mode == "waiting":
            if _is_age(inputs.status_age, self._settings.status_age) and np.isfinite(inputs.measured).all():
                now = replace(now, health=Health("ok"), commands=inputs.measured[None], last=inputs)
            elif inputs.time < self._settings.patience:
                return now
            else:
                cause = f"no status of the arm has come within {self._settings.patience:g} s"
                return replace(now, health=Health("stopped", cause, _LINK, inputs.time))
        if now.health.ok:
            fault = next(self._rules.faults(now, inputs), None)
            if fault is not None:
                stop = self._stop(now, inputs)
                health = Health("stopped", *fault, inputs.time, stop.back, stop.begin + stop.duration)
                now = replace(now, health=health, stop=stop)
        if len(now.commands) == 0:
            return now  # without any status there is nothing to hold
        before = now.commands[-1]
        command = inputs.wanted if now.stop is None else now.stop.at(inputs.time)
        kept = round(self._settings.lag / PERIOD)
        return replace(
            now,
            commands=np.vstack([now.commands, command])[-kept:],
            speed=(command - before) / PERIOD,
            last=inputs,
        )

    def _stop(self, now: _Guarded, inputs: _Inputs) -> _Stop:
        """The motion to rest. An arm that presses on something stops at its measured position, because it
        would go on pressing at the commanded one."""
        q, v = now.commands[-1], now.speed
        duration = braking_time(v, self._settings.stopping)
        rest = q + v * duration / 2.0
        near = bool((np.abs(inputs.measured - q) <= self._settings.following).all())
        back = near and self._rules.presses(now, inputs)
        if back:
            rest = inputs.measured
            duration = max(duration, float((_BACK * np.abs(rest - q) / SPEED_LIMITS).max()))
        return _Stop(q, v, rest, inputs.time - PERIOD, duration, back)

    def _position(self, context: Context) -> FloatArray:
        commands = read(context, self._guarded).commands
        return commands[-1] if len(commands) else self._measured.Eval(context)


def _is_age(age: float, most: float) -> bool:
    return -_CLOCKS <= age <= most + 1e-9


def _late(age: float, most: float) -> str:
    if not -_CLOCKS <= age < np.inf:
        return f"of no possible age ({age:g} s)"
    return f"{1e3 * age:.0f} ms old, {1e3 * most:.0f} ms are allowed"


def _degrees(angle: float) -> str:
    return f"{np.rad2deg(angle):.1f}°"
