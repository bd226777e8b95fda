"""Finds pushes in a cell's signals when somebody else drives the arm."""

from dataclasses import dataclass, replace

import numpy as np
import shapely
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from slipmap.diagrams.execution.push_executor import CLOSED
from slipmap.diagrams.execution.requests import ExecutionStatus
from slipmap.diagrams.systems.loop_messages import LoopStatus
from slipmap.diagrams.systems.measurement_logger import PERIOD
from slipmap.diagrams.systems.python_system import PythonSystem, held, read
from slipmap.models.geometry import seen_from
from slipmap.models.perception.seen_object import ObservedPose, SeenObject
from slipmap.models.physics.cell_grid import FloatArray

TOUCH = 0.005
"""m between finger and outline within which they may have touched, given the errors of outline and pose."""

MOVED, TURNED = 0.002, 0.02
"""m and rad by which the object must have moved; two looks at an object at rest may differ by less."""

GAP = 0.1  # s without a message from the arm after which the finger's motion counts as unknown
LONGEST = 60.0  # s that the finger may stay down for a push
_UNSEEN = "the object was not seen at rest afterwards"


@dataclass(frozen=True)
class Descent:
    """A period during which the finger was down, and its outcome."""

    # begin, end: s of the diagram's time
    begin: float
    end: float
    reason: str = ""  # why it was not kept as a push; empty if it was

    @property
    def kept(self) -> bool:
        """Whether it is a recorded push."""
        return not self.reason


@dataclass(frozen=True, eq=False)
class _Found:
    """State."""

    phase: str = "up"  # `up`, `down`, or `after`: up again, waiting to see the object at rest
    # begin, end: of the present descent, s
    begin: float = 0.0
    end: float = 0.0
    reason: str = ""  # why the present descent is not a push, once known
    touched: bool = False  # whether the finger reached the object
    # pose (3,) at which the object was last seen with the arm aside, since the previous descent
    rest: FloatArray | None = None
    measured: float = -np.inf  # time of the arm's last measured position, s
    looked: float = -np.inf  # time of the newest picture that showed the object, s
    aside: tuple[bool, bool] = (False, False)  # whether the arm was aside when the last two pictures came
    descents: tuple[Descent, ...] = ()  # completed ones


class PushFinder(PythonSystem):
    """Detects the pushes of an arm that somebody else drives, in place of a loop's executor and supervisor.

    Inputs:
    - `object_pose`: `ObservedPose`; `seen_object`: `SeenObject | None`; `aside`: bool, whether the arm hides
      nothing of the object.
    - `tip_pose`: X_WT of the finger's end; `tip_age` (1,): s since it was measured.
    - `gripper.state_measured` (2,): opening and its rate, m and m/s.
    - `trials`: tuple of `Trial` from the `MeasurementLogger` that this block drives.
    Outputs:
    - `execution`: `ExecutionStatus` in `home` (the arm is aside), `pushing` (the finger is down),
      `approaching` (it is down, but this is not a push) or `retreating`; `status`: `LoopStatus` in `looking`,
      `pushing` or `recording`.
    - `descents`: tuple of `Descent`.

    The finger is down while its end is lower than the object's top. A descent is a push if the object was
    seen at rest before and after it and has moved, the gripper was closed, the finger came near the object,
    and the arm reported its position throughout. A look counts if the arm was aside before and after
    the picture was taken.

    Args:
        finger_radius: m.
    """

    def __init__(self, finger_radius: float) -> None:
        super().__init__()
        self._reach = finger_radius + TOUCH
        self.declare_inputs("object_pose", "seen_object", "aside")
        self.DeclareAbstractInputPort("tip_pose", Value(RigidTransform()))
        self.DeclareVectorInputPort("tip_age", 1)
        self.DeclareVectorInputPort("gripper.state_measured", 2)
        self.declare_inputs("trials")
        self._found = self.DeclareAbstractState(held(_Found()))
        self.declare_steps(PERIOD, self._found, self._next)
        after = {self.abstract_state_ticket(self._found), self.GetInputPort("trials").ticket()}
        self.declare_output("execution", lambda context: _execution(*self._now(context)), after)
        self.declare_output("status", lambda context: _status(*self._now(context)), after)
        self.declare_output_of("descents", self._found, lambda found: found.descents)

    def _now(self, context: Context) -> tuple[_Found, int]:
        """The state, and the number of recorded trials."""
        return read(context, self._found), len(self.input(context, "trials"))

    def given_up(self, context: Context) -> str:
        """Why the descent under way is not a push yet; empty if there is none."""
        found: _Found = read(context, self._found)
        if found.phase == "up":
            return ""
        return found.reason or ("the finger was still down" if found.phase == "down" else _UNSEEN)

    def _next(self, context: Context, now: _Found) -> _Found:
        pose: ObservedPose = self.input(context, "object_pose")
        seen: SeenObject | None = self.input(context, "seen_object")
        tip = self.input(context, "tip_pose").translation()
        measured = context.get_time() - float(self.input(context, "tip_age")[0])
        down = seen is not None and tip[2] < seen.cell_heights.max()
        silent = measured - now.measured if np.isfinite(now.measured) else 0.0
        now = replace(now, measured=measured)
        if now.phase == "after" and len(self.input(context, "trials")) > sum(
            descent.kept for descent in now.descents
        ):
            now = replace(_over(now, ""), rest=pose.pose if pose.valid else None)
        if not pose.valid:
            now = replace(now, aside=(False, False))
        if not down:
            if now.phase == "down":
                now = self._lifted(replace(now, end=measured))
            return self._looked(context, now, pose) if pose.valid else now
        assert seen is not None
        if now.phase == "after":
            now = _over(now, f"{_UNSEEN}, before the finger came down again")
        if now.phase == "up":
            reason = self._unfit(context, now)
            return replace(now, phase="down", begin=measured, end=measured, touched=False, reason=reason)
        reason = now.reason
        if silent > GAP:
            reason = reason or f"the arm sent nothing for {silent:.2f} s"
        if measured - now.begin > LONGEST:
            reason = reason or f"the finger was down for more than {LONGEST:.0f} s"
        lies = pose.pose if pose.valid else now.rest
        touched = now.touched or (lies is not None and self._near(seen, lies, tip))
        return replace(now, touched=touched, reason=reason)

    def _unfit(self, context: Context, now: _Found) -> str:
        """Why no push can start now; empty if one can."""
        if now.rest is None:
            return "the object was not seen at rest before"
        opening = float(self.input(context, "gripper.state_measured")[0])
        if not opening <= CLOSED:
            return f"the gripper was open by {1e3 * opening:.0f} mm"
        return ""

    def _near(self, seen: SeenObject, lies: FloatArray, tip: FloatArray) -> bool:
        point = shapely.Point(seen_from(tip[:2], lies))
        return bool(seen.grid.polygon.distance(point) <= self._reach)

    def _lifted(self, now: _Found) -> _Found:
        reason = now.reason or ("" if now.touched else "the finger did not come near the object")
        if reason:
            return _over(now, reason)
        return replace(now, phase="after", aside=(False, False))

    def _looked(self, context: Context, now: _Found, pose: ObservedPose) -> _Found:
        """The state after a new picture, which counts if the arm was aside before and after it was taken."""
        if pose.time <= now.looked:
            return now
        aside = (now.aside[1], bool(self.input(context, "aside")))
        now = replace(now, looked=pose.time, aside=aside)
        if not all(aside):
            return now
        if now.phase == "after":
            assert now.rest is not None
            off = np.abs(pose.pose - now.rest)
            if np.hypot(*off[:2]) < MOVED and off[2] < TURNED:
                return _over(now, "the object did not move")
            return now
        return replace(now, rest=pose.pose)


def _over(now: _Found, reason: str) -> _Found:
    """The state with the present descent completed."""
    return replace(
        now,
        phase="up",
        reason="",
        rest=None,  # the logger, too, may have used up its looks
        descents=(*now.descents, Descent(now.begin, now.end, reason)),
    )


def _execution(now: _Found, trials: int) -> ExecutionStatus:
    if now.phase == "down":
        return ExecutionStatus("approaching" if now.reason else "pushing", trials)
    return ExecutionStatus("home" if all(now.aside) else "retreating", trials)


def _status(now: _Found, trials: int) -> LoopStatus:
    if now.phase == "down" and not now.reason:
        return LoopStatus("pushing", trials)
    return LoopStatus("recording" if now.phase == "after" else "looking", trials)
