"""The block that makes the arm push and grasp at the table's edge, and the block that watches the object."""

from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from slipmap.diagrams.execution.arm_motion import FingerKinematics, MotionRefused, Phase, Plan, tip_force
from slipmap.diagrams.execution.clearance import ArmClearance, Obstacle, Surroundings
from slipmap.diagrams.execution.plans import ArmPlanner
from slipmap.diagrams.execution.requests import (
    ActiveGrasp,
    ActivePush,
    ExecutionConfig,
    ExecutionStatus,
    Health,
)
from slipmap.diagrams.systems.python_system import PythonSystem, held, read
from slipmap.models.geometry import angle_between
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.perception.seen_object import ObservedPose, SeenObject
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import GRIP_FORCE

PERIOD = 0.02  # s between two checks of the inputs
CLOSED = 0.005  # largest opening at which the gripper counts as one round finger, m
TIMES = 3  # consecutive pictures that must show that the object was moved
MOVED, TURNED = 0.01, 0.15  # m and rad by which the object must have moved; the tracker's errors are smaller


@dataclass(frozen=True, eq=False)
class _Execution:
    """State of the executor."""

    status: ExecutionStatus  # while the plan runs, its phases give the mode
    plan: Plan | None = None  # the present or last motion
    begin: float = 0.0  # its start time, s
    aborted: bool = False  # whether it is the way home after an abort
    stopped: float = np.inf  # time when a fault ended it, s; else infinite
    last: str = "home"  # mode after the plan, except for a grasp

    def running(self, time: float) -> bool:
        return self.plan is not None and time < self.begin + self.plan.duration

    def since(self, time: float) -> float:
        """Time since the start of the plan, up to any fault, s."""
        return min(time, self.stopped) - self.begin


class PushExecutor(PythonSystem):
    """Plans and executes pushes and grasps one at a time, and outputs the finger's pose and force.

    Input ports:

    - `push`: `ActivePush | None`; a new number starts a push once the arm is home.
    - `iiwa.position_measured` (7,) rad; `iiwa.torque_external` (7,) N m, from contact forces on the arm.

    Optional input ports:

    - `grasp`: `ActiveGrasp | None`; a new number starts a grasp once the arm is home. It ends in `holding`:
      the object is not put down, and nothing is done after it.
    - `abort`: bool; True stops a push, lifts the finger and brings the arm home. A grasp continues.
    - `moved`: str from an `ObjectWatch`; if it is not empty on the way to a push, the arm goes home and the
      push counts as refused for that reason.
    - `health`: `Health` from a `CommandGuard`. Nothing is planned while the guard waits for the arm. When it
      has stopped the arm, the push or grasp ends in `stopped` with the guard's reason; arm and gripper stay
      in place, and nothing is done after it.
    - `gripper.state_measured` (2,) opening and its rate, m and m/s; if the gripper does not close for a push,
      it also ends in `stopped`.
    - `object_pose`: `ObservedPose`, `seen_object`: `SeenObject | None`: during a push the arm, except the
      finger, keeps away from the object as it does from the table. If they are connected, a push of an object
      that is not seen is refused.

    Output ports:

    - `iiwa.position` (7,) rad; `gripper.position` (1,) m, closed unless a grasp is under way;
      `gripper.force_limit` (1,) N.
    - `tip_pose`: `RigidTransform` X_WT at the measured joint angles; `tip_force` (3,) N, of the finger on the
      object, in the world; `status`: `ExecutionStatus`.

    With the drivers of `add_arm_drivers` the finger stays within 0.5 mm of its commanded position while it
    pushes a box of up to 3 kg (15 N) at up to 0.1 m/s, at simulation steps of 1 to 5 ms.

    An impossible push or grasp is refused with the reason, and the arm stays in place. At the start the arm
    goes home from wherever it is.

    Args:
        model: the arm, as built by `arm_model`.
        home: (7,) joint angles between pushes, rad.
        table: that the arm keeps away from; if None, it ignores table and object and cannot grasp.
    """

    def __init__(
        self,
        model: MultibodyPlant,
        home: FloatArray,
        config: ExecutionConfig | None = None,
        table: Table | None = None,
    ) -> None:
        super().__init__()
        self._clearance = None if table is None else ArmClearance(table)
        self._kinematics = FingerKinematics(model)
        self._config = config or ExecutionConfig()
        self._planner = ArmPlanner(self._kinematics, self._config, np.asarray(home, dtype=float))
        self.declare_inputs("push", "grasp")
        self._measured = self.DeclareVectorInputPort("iiwa.position_measured", 7)
        self._torque = self.DeclareVectorInputPort("iiwa.torque_external", 7)
        self.declare_inputs("abort", "moved", "health")
        self._gripper = self.DeclareVectorInputPort("gripper.state_measured", 2)
        self.declare_inputs("object_pose", "seen_object")
        self._execution = self.DeclareAbstractState(held(_Execution(ExecutionStatus("home"))))
        self.declare_steps(PERIOD, self._execution, self._next)

        motion = {self.time_ticket(), self.abstract_state_ticket(self._execution)}
        measured, torque = self._measured.ticket(), self._torque.ticket()
        # Before the first plan it is the measured position; depending on that would double each step's work.
        self.declare_vector_output("iiwa.position", 7, self._position, motion)
        self.declare_vector_output("gripper.position", 1, self._opening, motion)
        self.declare_vector_output("gripper.force_limit", 1, self._force, motion)
        self.declare_output("tip_pose", self._tip_pose, {measured}, Value(RigidTransform()))
        self.declare_vector_output("tip_force", 3, self._tip_force, {measured, torque})
        self.declare_output("status", self._status, motion)

    def _next(self, context: Context, now: _Execution) -> _Execution:
        time = context.get_time()
        health: Health | None = self.optional_input(context, "health")
        if now.status.mode == "stopped" or (health is not None and health.mode == "waiting"):
            return now
        if health is not None and not health.ok:
            return replace(
                now, status=ExecutionStatus("stopped", now.status.push_id, health.text), stopped=time
            )
        if now.plan is None:
            plan = self._planner.retreat(self._measured.Eval(context), np.zeros(7))
            return replace(now, plan=plan, begin=time)
        abort = self.optional_input(context, "abort")
        if now.running(time):
            if abort and not now.aborted and now.status.mode != "home":
                return self._aborted(now, time)
            moved = self.optional_input(context, "moved")
            if moved and now.plan.at(time - now.begin)[0] in ("approaching", "lowering"):
                back = self._planner.retreat(*now.plan.motion(time - now.begin))
                return _Execution(replace(now.status, reason=moved), back, time, True, last="refused")
            return now
        request: ActivePush | ActiveGrasp | None
        request = self.optional_input(context, "grasp") or self.input(context, "push")
        if abort or request is None or request.push_id == now.status.push_id:
            return now
        if now.plan.phases[-1].mode == "holding":
            return now
        if isinstance(request, ActivePush) and self._gripper.HasValue(context):
            opening = self._gripper.Eval(context)[0]
            if not opening <= CLOSED:
                return self._not_closed(now, time, request.push_id, opening)
        try:
            plan = self._plan(context, request, now.plan.at(time - now.begin)[1])
        except MotionRefused as refusal:
            return replace(now, status=ExecutionStatus("refused", request.push_id, str(refusal)))
        return _Execution(ExecutionStatus(plan.phases[0].mode, request.push_id), plan, time)

    def _plan(self, context: Context, request: ActivePush | ActiveGrasp, q: FloatArray) -> Plan:
        if isinstance(request, ActivePush):
            around = None
            if self._clearance is not None:
                around = Surroundings(self._clearance, self._obstacle(context))
            return self._planner.push(request.push, q, around)
        if self._clearance is None:
            raise MotionRefused("the executor was built without a table, so it cannot grasp at its edge")
        return self._planner.grasp(self._clearance, request, q)

    def _obstacle(self, context: Context) -> Obstacle | None:
        if not all(self.GetInputPort(name).HasValue(context) for name in ("object_pose", "seen_object")):
            return None
        pose: ObservedPose = self.input(context, "object_pose")
        seen: SeenObject | None = self.input(context, "seen_object")
        if seen is None or not pose.valid:
            raise MotionRefused(f"the object's pose is not known, so the arm might hit it: {pose.reason}")
        return Obstacle(seen.grid, seen.cell_heights, pose.pose)

    def _aborted(self, now: _Execution, time: float) -> _Execution:
        plan, since = now.plan, time - now.begin
        assert plan is not None
        mode = plan.at(since)[0]
        if mode == "retreating" or plan.phases[-1].mode == "holding":
            return replace(now, aborted=True)
        status = replace(now.status, reason=f"aborted while {mode}")
        return _Execution(status, self._planner.retreat(*plan.motion(since)), time, aborted=True)

    def _not_closed(self, now: _Execution, time: float, push_id: int, opening: float) -> _Execution:
        assert now.plan is not None
        if time < now.begin + now.plan.duration + self._config.closing:
            return now  # it may still be closing
        reason = (
            f"the gripper does not close: it is open by {1e3 * opening:.0f} mm; check whether it is stuck or "
            "switched off, then start again"
        )
        return replace(now, status=ExecutionStatus("stopped", push_id, reason), stopped=time)

    def _position(self, context: Context) -> FloatArray:
        now: _Execution = read(context, self._execution)
        if now.plan is None:
            return self._measured.Eval(context)
        return now.plan.at(now.since(context.get_time()))[1]

    def _opening(self, context: Context) -> list[float]:
        phase, since = self._phase(context)
        return [0.0 if phase is None else phase.opening_at(since)]

    def _force(self, context: Context) -> list[float]:
        phase, _ = self._phase(context)
        return [GRIP_FORCE / 2 if phase is None else phase.force]

    def _phase(self, context: Context) -> tuple[Phase | None, float]:
        now: _Execution = read(context, self._execution)
        return (None, 0.0) if now.plan is None else now.plan.phase(now.since(context.get_time()))

    def _tip_pose(self, context: Context) -> RigidTransform:
        return self._kinematics.pose(self._measured.Eval(context))

    def _tip_force(self, context: Context) -> FloatArray:
        jacobian = self._kinematics.jacobian(self._measured.Eval(context))
        return tip_force(jacobian, self._torque.Eval(context))

    def _status(self, context: Context) -> ExecutionStatus:
        now: _Execution = read(context, self._execution)
        status, time = now.status, context.get_time()
        if status.mode not in ("home", "refused", "stopped"):
            assert now.plan is not None
            mode = now.plan.phase(time - now.begin)[0].mode
            if not now.running(time) and mode != "holding":
                mode = now.last
            status = replace(status, mode=mode)
        return status


@dataclass(frozen=True, eq=False)
class _Aim:
    """State: the object's pose when the arm set out, and observations since."""

    pose: FloatArray | None = None
    strayed: int = 0
    last: float = -np.inf
    moved: str = ""


class ObjectWatch(PythonSystem):
    """Detects that something else moved the object while the arm was on its way to a push.

    Inputs are `object_pose`, an `ObservedPose`, and `execution`, an `ExecutionStatus`. The output `moved`, a
    str, is for the executor, which then gives up the push. It states how far the object moved, from when
    `TIMES` consecutive pictures show it elsewhere than before the arm set out until the arm is home;
    otherwise it is empty. Only the approach counts, because later the finger itself moves the object.
    """

    def __init__(self) -> None:
        super().__init__()
        self.declare_inputs("object_pose", "execution")
        self._aim = self.DeclareAbstractState(held(_Aim()))
        self.declare_steps(PERIOD, self._aim, self._next)
        self.declare_output_of("moved", self._aim, lambda aim: aim.moved)

    def _next(self, context: Context, aim: _Aim) -> _Aim:
        execution: ExecutionStatus = self.input(context, "execution")
        observed: ObservedPose | None = self.input(context, "object_pose")
        if observed is not None and observed.valid:
            if execution.mode in ("home", "refused"):
                return _Aim(observed.pose, last=observed.time)
            if execution.mode in ("approaching", "lowering") and observed.time > aim.last:
                return _looked_again(aim, observed)
        return aim


def _looked_again(aim: _Aim, observed: ObservedPose) -> _Aim:
    if aim.pose is None or aim.moved:
        return aim
    way = float(np.hypot(*(observed.pose - aim.pose)[:2]))
    turned = abs(float(angle_between(observed.pose[2], aim.pose[2])))
    strayed = aim.strayed + 1 if way > MOVED or turned > TURNED else 0
    moved = ""
    if strayed == TIMES:
        far = f"{1e3 * way:.0f} mm and {np.rad2deg(turned):.0f}°"
        moved = f"something else moved the object by {far} while the arm was on its way"
    return replace(aim, strayed=strayed, last=observed.time, moved=moved)
