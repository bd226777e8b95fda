"""The order after exploring: plan, push, record, and again; at the edge grasp, lift and hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, State

from diagrams.collectable import PythonSystem
from diagrams.execution import ActivePush, ExecutionStatus
from diagrams.execution.messages import ActiveGrasp
from diagrams.systems.held import held, read, replace_held
from diagrams.systems.messages import MOST_ATTEMPTS, LoopStatus, PregraspPlan
from diagrams.systems.push_supervisor import PATIENCE, PERIOD, unseen
from models.perception.observed_pose import ObservedPose
from models.robots import FINGER_RADIUS

HOLD = 1.0
"""s that the object is held in the air before it counts as held."""

HELD_LESS = 0.5
"""Share of the height between the pins by which they may come closer than that while they hold."""

HELD_MORE = 0.01
"""m by which they may be further apart than that: the camera may be wrong by less."""


@dataclass(frozen=True, eq=False)
class _Bringing:
    """What is going on since exploring ended.

    Attributes:
        status: where the loop is.
        since: when that began, or, while it is planned, when the object was last seen, s.
        push, grasp: what the arm is to do.
    """

    status: LoopStatus
    since: float
    push: ActivePush | None = None
    grasp: ActiveGrasp | None = None


class PregraspSupervisor(PythonSystem):
    """Takes over from the supervisor of exploration, and brings the object into the gripper.

    .. pydrake_system::

        name: PregraspSupervisor
        input_ports:
        - exploration
        - exploring_push
        - object_pose
        - plan
        - execution
        - records
        - gripper.state_measured
        output_ports:
        - status
        - active_push
        - active_grasp

    - `exploration`: `LoopStatus`, and `exploring_push`: `ActivePush | None`, of the `PushSupervisor`. Until
      exploring is finished, `status` and `active_push` are these; then come the modes `messages.BRINGING`.
    - `object_pose`: `ObservedPose`; `plan`: `PregraspPlan | None`; `execution`: `ExecutionStatus` of the arm.
    - `records`: tuple of recorded `Trial`s; `gripper.state_measured`: (2,) opening and its rate, m and m/s.
    - `status`: `LoopStatus`; pushes are counted on from those that explored.
    - `active_push`: `ActivePush | None`, `active_grasp`: `ActiveGrasp | None`: what the arm is to do.

    The object counts as held when, a second after lifting, the pins are still about as far apart as the
    object is high between them.

    Args:
        patience: s that the object may stay out of sight.
    """

    def __init__(self, patience: float = PATIENCE) -> None:
        super().__init__()
        self._patience = patience
        for name in ("exploration", "exploring_push", "object_pose", "plan", "execution", "records"):
            self.DeclareAbstractInputPort(name, Value[object](None))
        self.DeclareVectorInputPort("gripper.state_measured", 2)
        self._bringing = self.DeclareAbstractState(held(None))
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._decide)
        own = self.abstract_state_ticket(self._bringing)

        def port(name: str, before: str | None, part: Callable[[_Bringing], object]) -> None:
            def calc(context: Context, output: Any) -> None:
                now: _Bringing | None = read(context, self._bringing)
                if now is not None:
                    output.set_value(part(now))
                else:
                    output.set_value(None if before is None else self._input(context, before))

            tickets = {own} if before is None else {own, self.GetInputPort(before).ticket()}
            self.DeclareAbstractOutputPort(name, lambda: Value[object](None), calc, tickets)

        port("status", "exploration", lambda now: now.status)
        port("active_push", "exploring_push", lambda now: now.push)
        port("active_grasp", None, lambda now: now.grasp)

    def _decide(self, context: Context, state: State) -> EventStatus:
        now: _Bringing | None = read(context, self._bringing)
        time = context.get_time()
        if now is None:
            explored: LoopStatus = self._input(context, "exploration")
            if explored.mode == "finished":
                now = _Bringing(LoopStatus("planning", explored.push), time)
            elif explored.mode == "failed":
                now = _Bringing(explored, time)
            else:
                return EventStatus.DidNothing()
            replace_held(state, self._bringing, now)
            return EventStatus.Succeeded()
        following = self._next(context, now)
        if following is now:
            return EventStatus.DidNothing()
        replace_held(state, self._bringing, following)
        return EventStatus.Succeeded()

    def _next(self, context: Context, now: _Bringing) -> _Bringing:
        status, time = now.status, context.get_time()
        execution: ExecutionStatus = self._input(context, "execution")
        answered = execution.push_id == status.number

        def to(mode: str, reason: str = "") -> _Bringing:
            return _Bringing(LoopStatus(mode, status.push, status.attempt, reason), time, grasp=now.grasp)

        def patient(reason: str) -> _Bringing:
            return now if time - now.since < self._patience else to("failed", reason)

        if execution.mode == "stopped" and status.mode not in ("held", "failed"):
            return to("failed", execution.reason)
        if status.mode == "planning":
            plan: PregraspPlan | None = self._input(context, "plan")
            if plan is None or plan.number != status.number:
                pose: ObservedPose | None = self._input(context, "object_pose")
                if pose is not None and pose.valid:
                    return replace(now, since=time)  # planning takes its time, and the object is there
                return patient(unseen(pose))
            return _started(plan, status, time)
        if status.mode in ("pushing", "grasping") and answered and execution.mode == "refused":
            if status.attempt + 1 == MOST_ATTEMPTS:
                return to("failed", execution.reason)
            return _Bringing(LoopStatus("planning", status.push, status.attempt + 1, execution.reason), time)
        if status.mode == "pushing":
            return to("recording") if answered and execution.mode == "home" else now
        if status.mode == "recording":
            if len(self._input(context, "records")) > status.push:
                return _Bringing(LoopStatus("planning", status.push + 1), time)
            return patient(f"after the push {unseen(self._input(context, 'object_pose'))}")
        if status.mode == "grasping":
            return to("lifting") if answered and execution.mode == "lifting" else now
        if status.mode == "lifting":
            return to("holding") if execution.mode == "holding" else now
        if status.mode == "holding" and time - now.since >= HOLD:
            reason = self._empty(context, now)
            return to("failed", reason) if reason else to("held")
        return now

    def _empty(self, context: Context, now: _Bringing) -> str:
        """Why the gripper holds nothing; empty if it holds the object."""
        assert now.grasp is not None
        between = self._input(context, "gripper.state_measured")[0] - 2 * FINGER_RADIUS
        height = now.grasp.grasp.height
        if not between > (1.0 - HELD_LESS) * height:
            return "the pins closed on nothing"
        if between > height + HELD_MORE:
            return (
                f"the gripper did not close: there are {1e3 * between:.0f} mm between its pins, and the"
                f" object is {1e3 * height:.0f} mm high; see whether it is stuck or switched off"
            )
        return ""

    def _input(self, context: Context, name: str) -> Any:
        return self.GetInputPort(name).Eval(context)


def _started(plan: PregraspPlan, status: LoopStatus, time: float) -> _Bringing:
    """The begin of what a plan says."""
    if plan.push is not None:
        push = ActivePush(status.number, plan.push.push)
        return _Bringing(LoopStatus("pushing", status.push, status.attempt), time, push=push)
    if plan.grasp is not None:
        return _Bringing(LoopStatus("grasping", status.push, status.attempt), time, grasp=plan.grasp)
    return _Bringing(LoopStatus("failed", status.push, status.attempt, plan.reason), time)
