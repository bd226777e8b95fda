"""State machines of the robot's loops: what to do next, and when to give up.

`PushSupervisor` explores: look, choose, push, record, learn, repeat. `PregraspSupervisor` takes over from it:
plan, push, record, repeat; at the table's edge grasp, lift and hold.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from pydrake.systems.framework import Context, EventStatus, State

from slipmap.diagrams.execution.requests import ActiveGrasp, ActivePush, ExecutionStatus
from slipmap.diagrams.systems.diagnosis import Repair
from slipmap.diagrams.systems.loop_messages import CHOOSING, MOST_ATTEMPTS, LoopStatus, PregraspPlan
from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held
from slipmap.models.perception.seen_object import ObservedPose
from slipmap.models.robots import PIN_RADIUS

PERIOD = 0.05  # s between two decisions
PATIENCE = 20.0  # s that the object may stay out of sight before the loop gives up

PATIENCE_REAL = 100.0
"""The same when another process handles the pictures, which may be late on a busy computer, s."""


MOST_MISSED = 3  # candidates for one push that may miss the object before the loop gives up


class PushSupervisor(PythonSystem):
    """Decides what the exploration loop does next.

    Inputs:
    - `object_pose`: `ObservedPose`; `cell_grid`: `CellGrid | None`, the object as first seen.
    - `plan`: `ExplorationPlan | None` from `Exploration`.
    - `execution`: `ExecutionStatus` of the arm.
    - `trials`: tuple of recorded `Trial`s; `learned`: how many of them the belief was learned from; `missed`
      (optional): numbers of candidates that touched nothing, for which others are chosen.
    - `repair` (optional): `Repair` from a `Diagnosis`; the loop waits for it after each push, and it may ask
      for more pushes.
    Outputs:
    - `status`: `LoopStatus`; `active_push`: `ActivePush | None`, the push for the arm to make.

    Args:
        fit: number of pushes to learn from.
        heldout: number of pushes after these that only judge the belief.
        made: number of pushes recorded earlier; the loop starts by learning from them.
        patience: s that the object may stay out of sight.
    """

    def __init__(self, fit: int, heldout: int = 0, made: int = 0, patience: float = PATIENCE) -> None:
        super().__init__()
        self._patience = patience
        self._fit = fit
        self._pushes = fit + heldout
        self.declare_inputs("object_pose", "cell_grid", "plan", "execution", "trials", "learned", "missed")
        self.declare_inputs("repair")
        mode, push = ("learning", made - 1) if made else ("looking", 0)
        start = LoopStatus(mode, push, of=self._pushes)
        self._status = self.DeclareAbstractState(held(start))
        self._active = self.DeclareAbstractState(held(None))
        self.DeclareDiscreteState(1)  # since when it waits, s
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._decide)
        self.declare_output_of("status", self._status)
        self.declare_output_of("active_push", self._active)

    def _decide(self, context: Context, state: State) -> EventStatus:
        now: LoopStatus = read(context, self._status)
        following = self._next(context, now)
        if following != now:
            following = replace(following, of=self._planned(context))
            replace_held(state, self._status, following)
            state.get_mutable_discrete_state(0)[0] = context.get_time()
            active = None
            if following.mode == "pushing":
                plan = self.input(context, "plan")
                active = ActivePush(following.number, plan.choice.push)
            replace_held(state, self._active, active)
        elif now.mode in CHOOSING and self.input(context, "object_pose").valid:
            # Choosing may take long; only time during which the object is out of sight counts.
            state.get_mutable_discrete_state(0)[0] = context.get_time()
        return EventStatus.Succeeded()

    def _next(self, context: Context, now: LoopStatus) -> LoopStatus:
        if now.mode in ("finished", "failed"):
            return now
        execution = self.input(context, "execution")
        if execution.mode == "stopped":
            return LoopStatus("failed", now.push, now.attempt, execution.reason)
        if now.mode == "looking":
            return self._look(context, now)
        if now.mode in CHOOSING:
            plan = self.input(context, "plan")
            if plan is None or plan.number != now.number:
                if self.input(context, "object_pose").valid:
                    return now  # choosing may take long
                return self._patient(context, now, _unseen(self.input(context, "object_pose")))
            if plan.choice is None:
                return LoopStatus("failed", now.push, now.attempt, plan.reason)
            return LoopStatus("pushing", now.push, now.attempt)
        if now.mode == "pushing":
            if execution.push_id != now.number:
                return now
            if execution.mode == "refused":
                if now.attempt + 1 == MOST_ATTEMPTS:
                    return LoopStatus("failed", now.push, now.attempt, execution.reason)
                return self._choosing(context, now.push, now.attempt + 1)
            return LoopStatus("recording", now.push, now.attempt) if execution.mode == "home" else now
        if now.mode == "recording":
            missed = self.optional_input(context, "missed") or ()
            if now.number in missed:
                if _too_often(missed, now):
                    return LoopStatus("failed", now.push, now.attempt, _MISSED)
                return self._choosing(context, now.push, now.attempt + 1)
            if len(self.input(context, "trials")) > now.push:
                return LoopStatus("learning", now.push)
            return self._patient(context, now, _unrecorded(self.input(context, "object_pose")))
        done = now.push + 1
        repair: Repair | None = self.optional_input(context, "repair")
        settled = repair is None or repair.trials >= done
        if not settled and now.mode == "learning":
            return LoopStatus("diagnosing", now.push)
        pushes = self._planned(context)
        fit = pushes - (self._pushes - self._fit)
        if not settled or self.input(context, "learned") < min(done, fit):
            return now
        return LoopStatus("finished" if done >= pushes else "looking", done)

    def _planned(self, context: Context) -> int:
        """Number of pushes to make, with those that the repair asked for."""
        repair: Repair | None = self.optional_input(context, "repair")
        return self._pushes + (0 if repair is None else max(repair.wanted - self._fit, 0))

    def _look(self, context: Context, now: LoopStatus) -> LoopStatus:
        pose = self.input(context, "object_pose")
        if self.input(context, "cell_grid") is not None and pose is not None and pose.valid:
            return self._choosing(context, now.push)
        return self._patient(context, now, _unseen(pose))

    def _choosing(self, context: Context, push: int, attempt: int = 0) -> LoopStatus:
        repair: Repair | None = self.optional_input(context, "repair")
        asked = repair is not None and repair.question is not None
        return LoopStatus("telling apart" if asked else "choosing", push, attempt)

    def _patient(self, context: Context, now: LoopStatus, reason: str) -> LoopStatus:
        waited = context.get_time() - context.get_discrete_state(0)[0]
        return now if waited < self._patience else LoopStatus("failed", now.push, now.attempt, reason)


_TOUCHED_NOTHING = "the finger touched nothing"
_MISSED = (
    f"{_TOUCHED_NOTHING} in {MOST_MISSED} pushes: the object did not move, and no force was felt;"
    " check that execution.tip_height is below the object's height, and check the camera's pose"
)


def _too_often(missed: tuple[int, ...], now: LoopStatus) -> bool:
    """Whether too many candidates for the present push missed, or none is left."""
    of_push = [number for number in missed if number // MOST_ATTEMPTS == now.push]
    return len(of_push) >= MOST_MISSED or now.attempt + 1 == MOST_ATTEMPTS


def _unseen(pose: ObservedPose | None) -> str:
    """The reason why the camera does not see the object, in words."""
    return f"the camera does not see the object: {'no picture' if pose is None else pose.why}"


def _unrecorded(pose: ObservedPose | None) -> str:
    """The reason why a push could not be recorded, in words."""
    if pose is not None and pose.valid:
        return "the object was not seen at rest after the push"
    return f"the object was not seen after the push; {_unseen(pose)}"


HOLD = 1.0  # s that the object stays in the air before it counts as held
_HELD_LESS = 0.5  # share of the height by which the pins may be closer together while they hold
_HELD_MORE = 0.01  # m by which they may be further apart than that height; the camera's error is smaller


@dataclass(frozen=True, eq=False)
class _Bringing:
    """State of the supervisor after exploration has ended."""

    status: LoopStatus  # present step of the loop
    since: float  # when it began, or, while planning, when the object was last seen, s
    # push, grasp: for the arm to make
    push: ActivePush | None = None
    grasp: ActiveGrasp | None = None


class PregraspSupervisor(PythonSystem):
    """Takes over from the supervisor of exploration and brings the object into the gripper.

    Inputs:
    - `exploration`: `LoopStatus`, and `exploring_push`: `ActivePush | None`, from the `PushSupervisor`. They
      are passed on as `status` and `active_push` until exploration ends; the modes `BRINGING` follow.
    - `object_pose`: `ObservedPose`; `plan`: `PregraspPlan | None`; `execution`: `ExecutionStatus` of the arm.
    - `trials`: tuple of recorded `Trial`s, `missed` (optional): as for `PushSupervisor`;
      `gripper.state_measured`: (2,) opening and its rate, m and m/s.
    - `repair`: `Repair`, and `learned`: number of pushes that the belief was learned from; connected only if
      the model is repaired. Then each push is diagnosed and learned from before the next is planned.
    Outputs:
    - `status`: `LoopStatus`; the numbering of pushes continues from exploration.
    - `active_push`: `ActivePush | None`, `active_grasp`: `ActiveGrasp | None`: for the arm to make.

    The object counts as held if, a second after lifting, the distance between the pins is still about the
    object's height at the grasp.

    Args:
        patience: s that the object may stay out of sight.
    """

    def __init__(self, patience: float = PATIENCE) -> None:
        super().__init__()
        self._patience = patience
        self.declare_inputs("exploration", "exploring_push", "object_pose", "plan", "execution", "trials")
        self.declare_inputs("missed", "repair", "learned")
        self.DeclareVectorInputPort("gripper.state_measured", 2)
        self._bringing = self.DeclareAbstractState(held(None))
        self.declare_steps(PERIOD, self._bringing, self._decided)
        own = self.abstract_state_ticket(self._bringing)

        def port(name: str, before: str | None, part: Callable[[_Bringing], object]) -> None:
            def value(context: Context) -> Any:
                now: _Bringing | None = read(context, self._bringing)
                if now is not None:
                    return part(now)
                return None if before is None else self.input(context, before)

            tickets = {own} if before is None else {own, self.GetInputPort(before).ticket()}
            self.declare_output(name, value, tickets)

        port("status", "exploration", lambda now: now.status)
        port("active_push", "exploring_push", lambda now: now.push)
        port("active_grasp", None, lambda now: now.grasp)

    def _decided(self, context: Context, now: _Bringing | None) -> _Bringing | None:
        if now is not None:
            return self._next(context, now)
        explored: LoopStatus = self.input(context, "exploration")
        if explored.mode == "finished":
            return _Bringing(LoopStatus("planning", explored.push), context.get_time())
        return _Bringing(explored, context.get_time()) if explored.mode == "failed" else None

    def _next(self, context: Context, now: _Bringing) -> _Bringing:
        status, time = now.status, context.get_time()
        execution: ExecutionStatus = self.input(context, "execution")
        answered = execution.push_id == status.number

        def to(mode: str, reason: str = "") -> _Bringing:
            return _Bringing(LoopStatus(mode, status.push, status.attempt, reason), time, grasp=now.grasp)

        def patient(reason: str) -> _Bringing:
            return now if time - now.since < self._patience else to("failed", reason)

        if execution.mode == "stopped" and status.mode not in ("held", "failed"):
            return to("failed", execution.reason)
        if status.mode == "planning":
            plan: PregraspPlan | None = self.input(context, "plan")
            if plan is None or plan.number != status.number:
                pose: ObservedPose | None = self.input(context, "object_pose")
                if pose is not None and pose.valid:
                    return replace(now, since=time)  # planning may take long, and the object is in view
                return patient(_unseen(pose))
            return _started(plan, status, time)
        if status.mode in ("pushing", "grasping") and answered and execution.mode == "refused":
            if status.attempt + 1 == MOST_ATTEMPTS:
                return to("failed", execution.reason)
            return _Bringing(LoopStatus("planning", status.push, status.attempt + 1, execution.reason), time)
        if status.mode == "pushing":
            return to("recording") if answered and execution.mode == "home" else now
        if status.mode == "recording":
            missed = self.optional_input(context, "missed") or ()
            if status.number in missed:
                if _too_often(missed, status):
                    return to("failed", _MISSED)
                again = LoopStatus("planning", status.push, status.attempt + 1, _TOUCHED_NOTHING)
                return _Bringing(again, time)
            if len(self.input(context, "trials")) > status.push:
                if self.optional_input(context, "repair") is not None:
                    return to("diagnosing")
                return _Bringing(LoopStatus("planning", status.push + 1), time)
            return patient(_unrecorded(self.input(context, "object_pose")))
        if status.mode == "diagnosing":
            done = status.push + 1
            if self.input(context, "repair").trials < done or self.input(context, "learned") < done:
                return now
            return _Bringing(LoopStatus("planning", done), time)
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
        between = self.input(context, "gripper.state_measured")[0] - 2 * PIN_RADIUS
        height = now.grasp.grasp.height
        if not between > (1.0 - _HELD_LESS) * height:
            return "the pins closed on nothing"
        if between > height + _HELD_MORE:
            return (
                f"the gripper did not close: its pins are {1e3 * between:.0f} mm apart, but the object is"
                f" {1e3 * height:.0f} mm high; check whether the gripper is stuck or switched off"
            )
        return ""


def _started(plan: PregraspPlan, status: LoopStatus, time: float) -> _Bringing:
    """The state at the start of a plan's action."""
    if plan.push is not None:
        push = ActivePush(status.number, plan.push.push)
        return _Bringing(LoopStatus("pushing", status.push, status.attempt), time, push=push)
    if plan.grasp is not None:
        return _Bringing(LoopStatus("grasping", status.push, status.attempt), time, grasp=plan.grasp)
    return _Bringing(LoopStatus("failed", status.push, status.attempt, plan.reason), time)
