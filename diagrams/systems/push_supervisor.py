"""The order of the exploration loop: look, choose, push, record, learn, and again."""

from __future__ import annotations

from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, State

from diagrams.collectable import PythonSystem
from diagrams.execution import ActivePush
from diagrams.systems.held import held, read, replace_held
from diagrams.systems.messages import MOST_ATTEMPTS, LoopStatus
from models.perception.observed_pose import ObservedPose

PERIOD = 0.05
"""s between two decisions."""

PATIENCE = 20.0
"""s that the object may stay out of sight before the loop gives up."""

PATIENCE_REAL = 100.0
"""The same where others look at the pictures, who may be late on a busy computer, s."""


class PushSupervisor(PythonSystem):
    """Decides what the loop does next.

    .. pydrake_system::

        name: PushSupervisor
        input_ports:
        - object_pose
        - cell_grid
        - poke
        - execution
        - records
        - learned
        output_ports:
        - status
        - active_push

    - `object_pose`: `ObservedPose`; `cell_grid`: `CellGrid | None`, the object as first seen.
    - `poke`: `PokeRequest | None` from the exploration.
    - `execution`: `ExecutionStatus` of the arm.
    - `records`: tuple of recorded `Trial`s; `learned`: how many of them the belief comes from.
    - `status`: `LoopStatus`; `active_push`: `ActivePush | None`, what the arm is to do.

    Args:
        fit: pushes to learn from.
        heldout: pushes after these, made to judge the belief and not learned from.
        made: pushes that were recorded before; it begins with learning from them.
        patience: s that the object may stay out of sight.
    """

    def __init__(self, fit: int, heldout: int = 0, made: int = 0, patience: float = PATIENCE) -> None:
        super().__init__()
        self._patience = patience
        self._fit = fit
        self._pushes = fit + heldout
        for name in ("object_pose", "cell_grid", "poke", "execution", "records", "learned"):
            self.DeclareAbstractInputPort(name, Value[object](None))
        start = LoopStatus("learning", made - 1) if made else LoopStatus("looking", 0)
        self._status = self.DeclareAbstractState(held(start))
        self._active = self.DeclareAbstractState(held(None))
        self.DeclareDiscreteState(1)  # since when it waits, s
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._decide)
        for name, index in (("status", self._status), ("active_push", self._active)):
            self.DeclareAbstractOutputPort(
                name,
                lambda: Value[object](None),
                lambda context, output, index=index: output.set_value(read(context, index)),
                {self.abstract_state_ticket(index)},
            )

    def _decide(self, context: Context, state: State) -> EventStatus:
        now: LoopStatus = read(context, self._status)
        following = self._next(context, now)
        if following != now:
            replace_held(state, self._status, following)
            state.get_mutable_discrete_state(0)[0] = context.get_time()
            active = None
            if following.mode == "pushing":
                request = self._input(context, "poke")
                active = ActivePush(following.number, request.poke.push)
            replace_held(state, self._active, active)
        elif now.mode == "choosing" and self._input(context, "object_pose").valid:
            # Choosing takes its time; patience is for an object that is out of sight.
            state.get_mutable_discrete_state(0)[0] = context.get_time()
        return EventStatus.Succeeded()

    def _next(self, context: Context, now: LoopStatus) -> LoopStatus:
        if now.mode in ("finished", "failed"):
            return now
        execution = self._input(context, "execution")
        if execution.mode == "stopped":
            return LoopStatus("failed", now.push, now.attempt, execution.reason)
        if now.mode == "looking":
            return self._look(context, now)
        if now.mode == "choosing":
            request = self._input(context, "poke")
            if request is None or request.number != now.number:
                if self._input(context, "object_pose").valid:
                    return now  # choosing takes its time
                return self._patient(context, now, self._unseen(context))
            if request.poke is None:
                return LoopStatus("failed", now.push, now.attempt, request.reason)
            return LoopStatus("pushing", now.push, now.attempt)
        if now.mode == "pushing":
            if execution.push_id != now.number:
                return now
            if execution.mode == "refused":
                if now.attempt + 1 == MOST_ATTEMPTS:
                    return LoopStatus("failed", now.push, now.attempt, execution.reason)
                return LoopStatus("choosing", now.push, now.attempt + 1)
            return LoopStatus("recording", now.push) if execution.mode == "home" else now
        if now.mode == "recording":
            if len(self._input(context, "records")) > now.push:
                return LoopStatus("learning", now.push)
            return self._patient(context, now, "the object was not seen after the push")
        if self._input(context, "learned") < min(now.push + 1, self._fit):
            return now
        done = now.push + 1
        return LoopStatus("finished" if done >= self._pushes else "looking", done)

    def _look(self, context: Context, now: LoopStatus) -> LoopStatus:
        pose = self._input(context, "object_pose")
        if self._input(context, "cell_grid") is not None and pose is not None and pose.valid:
            return LoopStatus("choosing", now.push)
        return self._patient(context, now, self._unseen(context))

    def _unseen(self, context: Context) -> str:
        return unseen(self._input(context, "object_pose"))

    def _patient(self, context: Context, now: LoopStatus, reason: str) -> LoopStatus:
        waited = context.get_time() - context.get_discrete_state(0)[0]
        return now if waited < self._patience else LoopStatus("failed", now.push, now.attempt, reason)

    def _input(self, context: Context, name: str):  # type: ignore[no-untyped-def]
        return self.GetInputPort(name).Eval(context)


def unseen(pose: ObservedPose | None) -> str:
    """Why the camera does not see the object, in words."""
    why = "no picture" if pose is None or not pose.reason else pose.reason
    return f"the camera does not see the object: {why}"
