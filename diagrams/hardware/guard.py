"""The block between the executor and the arm: under faults the arm stops, holds, and says why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, EventStatus, State

from slipmap.diagrams.execution.finger_kinematics import FingerKinematics
from slipmap.diagrams.execution.requests import Health
from slipmap.diagrams.hardware.guard_rules import (
    LINK,
    PERIOD,
    Guarded,
    GuardRules,
    GuardSettings,
    Stop,
    Told,
    braking,
    is_age,
)
from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held
from slipmap.models.robots import SPEED_LIMITS

_BACK = 2.5
"""Times the time that the fastest joint would need for the way back of an arm that presses on something."""


class CommandGuard(PythonSystem):
    """Passes joint angles on to the arm while all is well; else brings the arm to rest and holds it.

    .. pydrake_system::

        name: CommandGuard
        input_ports:
        - iiwa.position
        - iiwa.position_measured
        - iiwa.torque_external
        - status_age
        - status_silence (optional)
        - image_age (optional)
        - abort (optional)
        output_ports:
        - iiwa.position
        - health

    - `iiwa.position` (7,) wanted, rad; `iiwa.position_measured` (7,) rad; `iiwa.torque_external` (7,) N m, of
      contact on the arm.
    - `status_age`, `image_age` (1,) s, of the newest valid status and picture; infinite before the first.
    - `status_silence` (1,) s since a status was found, by this computer's clock: it goes on where the
      diagram's is late, and with it all ages.
    - `abort` (1,): above 0.5 stops the arm.
    - Output `iiwa.position` (7,) rad, new every `PERIOD`.
    - `health`: `Health`.

    Until the first status it waits and asks the arm to stay where it is said to be. What stops the arm:
    a late or impossible status; an arm that is not where it was told to be; a picture that is late, once
    there was one; torque of contact; a wanted position that is no number, leaps, asks a joint or the finger
    for too much speed, or comes near a joint's limit; `abort`. The command is then brought to rest evenly, as
    fast as the joints' data sheet allows and within `GuardSettings.stopping`, whatever is wanted, and stays
    there; where something presses against the arm, at the measured position, so that it no longer does.

    It stays stopped until the process is started anew, also when the cause is gone or `abort` goes back to
    0: an arm must not begin to move because a cable was put in or somebody let go of a button, and what was
    planned before the fault need no longer fit. `slipmap explore --resume` goes on from what was recorded.

    Args:
        model: the arm as `slipmap.diagrams.station.arm.arm_model` makes it.
        settings: when to stop.

    Raises:
        ValueError: settings out of range.
    """

    def __init__(self, model: MultibodyPlant, settings: GuardSettings | None = None) -> None:
        super().__init__()
        self._settings = settings or GuardSettings()
        self._settings.check()
        self._rules = GuardRules(self._settings, FingerKinematics(model))
        self._wanted = self.DeclareVectorInputPort("iiwa.position", 7)
        self._measured = self.DeclareVectorInputPort("iiwa.position_measured", 7)
        self._torque = self.DeclareVectorInputPort("iiwa.torque_external", 7)
        self._status_age = self.DeclareVectorInputPort("status_age", 1)
        self._silence = self.DeclareVectorInputPort("status_silence", 1)
        self._image_age = self.DeclareVectorInputPort("image_age", 1)
        self._abort = self.DeclareVectorInputPort("abort", 1)
        start = Guarded(Health("waiting"), np.zeros((0, 7)), np.zeros(7))
        self._guarded = self.DeclareAbstractState(held(start))
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._update)
        own = self.abstract_state_ticket(self._guarded)
        self.DeclareVectorOutputPort("iiwa.position", 7, self._calc_position, {own, self._measured.ticket()})
        self.DeclareAbstractOutputPort("health", lambda: Value[object](None), self._calc_health, {own})

    def _update(self, context: Context, state: State) -> EventStatus:
        replace_held(state, self._guarded, self._next(read(context, self._guarded), self._inputs(context)))
        return EventStatus.Succeeded()

    def _inputs(self, context: Context) -> Told:
        image_age = self._image_age.Eval(context)[0] if self._image_age.HasValue(context) else np.inf
        abort = self._abort.HasValue(context) and not self._abort.Eval(context)[0] <= 0.5
        return Told(
            time=context.get_time(),
            wanted=self._wanted.Eval(context).copy(),
            measured=self._measured.Eval(context).copy(),
            torque=self._torque.Eval(context).copy(),
            status_age=float(self._status_age.Eval(context)[0]),
            silence=float(self._silence.Eval(context)[0]) if self._silence.HasValue(context) else 0.0,
            image_age=float(image_age),
            abort=bool(abort),
        )

    def _next(self, now: Guarded, inputs: Told) -> Guarded:
        now = replace(
            now,
            saw=now.saw or is_age(inputs.image_age, self._settings.image_age),
            pressed=min(now.pressed, inputs.time) if self._rules.pressed(inputs.torque) else np.inf,
        )
        health = now.health
        if health.mode == "waiting":
            if is_age(inputs.status_age, self._settings.status_age) and np.isfinite(inputs.measured).all():
                now = replace(now, health=Health("ok"), commands=inputs.measured[None], last=inputs)
            elif inputs.time < self._settings.patience:
                return now
            else:
                cause = f"no status of the arm has come within {self._settings.patience:g} s"
                return replace(now, health=Health("stopped", cause, LINK, inputs.time))
        if now.health.ok:
            fault = next(self._rules.faults(now, inputs), None)
            if fault is not None:
                stop = self._stop(now, inputs)
                now = replace(now, health=Health("stopped", *fault, inputs.time, stop.back), stop=stop)
        if len(now.commands) == 0:
            return now  # there was never a status: nothing to hold
        before = now.commands[-1]
        command = inputs.wanted if now.stop is None else now.stop.at(inputs.time)
        kept = round(self._settings.lag / PERIOD)
        return replace(
            now,
            commands=np.vstack([now.commands, command])[-kept:],
            speed=(command - before) / PERIOD,
            last=inputs,
        )

    def _stop(self, now: Guarded, inputs: Told) -> Stop:
        """The way to rest. An arm that presses on something stops where it is, not where it was told to go:
        it would go on pressing."""
        q, v = now.commands[-1], now.speed
        duration = braking(v, self._settings.stopping)
        rest = q + v * duration / 2.0
        near = bool((np.abs(inputs.measured - q) <= self._settings.following).all())
        back = near and self._rules.presses(now, inputs)
        if back:
            rest = inputs.measured
            duration = max(duration, float((_BACK * np.abs(rest - q) / SPEED_LIMITS).max()))
        return Stop(q, v, rest, inputs.time - PERIOD, duration, back)

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        commands = read(context, self._guarded).commands
        output.SetFromVector(commands[-1] if len(commands) else self._measured.Eval(context))

    def _calc_health(self, context: Context, output: Value) -> None:
        output.set_value(read(context, self._guarded).health)
