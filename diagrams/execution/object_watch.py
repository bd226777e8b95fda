"""Notices that an object was moved by something else while the arm was on its way to push it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, State

from diagrams.collectable import PythonSystem
from diagrams.execution.messages import ExecutionStatus
from diagrams.systems.held import held, read, replace_held
from models.angles import angle_between
from models.perception.observed_pose import ObservedPose
from models.physics.cell_grid import FloatArray

PERIOD = 0.02
"""s between two looks at the inputs."""

MOVED, TURNED = 0.01, 0.15
"""m and rad beyond which it is not the tracker that errs."""

TIMES = 3
"""Pictures in a row that have to say so."""


@dataclass(frozen=True, eq=False)
class _Aim:
    """State: where the object lay when the arm set out, and what was seen since."""

    pose: FloatArray | None = None
    strayed: int = 0
    last: float = -np.inf
    moved: str = ""


class ObjectWatch(PythonSystem):
    """Tells the executor to give up a push whose object is no longer where it was.

    .. pydrake_system::

        name: ObjectWatch
        input_ports:
        - object_pose
        - execution
        output_ports:
        - moved

    - `object_pose`: `ObservedPose`; `execution`: `ExecutionStatus`.
    - `moved`: str, how far, from when `TIMES` pictures in a row show the object elsewhere than before the arm
      set out, until the arm is home; else empty. Only the way to the push counts: then the finger pushes.
    """

    def __init__(self) -> None:
        super().__init__()
        self._pose = self.DeclareAbstractInputPort("object_pose", Value[object](None))
        self._execution = self.DeclareAbstractInputPort("execution", Value[object](None))
        self._aim = self.DeclareAbstractState(held(_Aim()))
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._update)
        self.DeclareAbstractOutputPort(
            "moved",
            lambda: Value[object](""),
            lambda context, output: output.set_value(read(context, self._aim).moved),
            {self.abstract_state_ticket(self._aim)},
        )

    def _update(self, context: Context, state: State) -> EventStatus:
        aim: _Aim = read(context, self._aim)
        execution: ExecutionStatus = self._execution.Eval(context)
        observed: ObservedPose | None = self._pose.Eval(context)
        following = aim
        if observed is not None and observed.valid:
            if execution.mode in ("home", "refused"):
                following = _Aim(observed.pose, last=observed.time)
            elif execution.mode in ("approaching", "lowering") and observed.time > aim.last:
                following = _with(aim, observed)
        if following is not aim:
            replace_held(state, self._aim, following)
        return EventStatus.Succeeded()


def _with(aim: _Aim, observed: ObservedPose) -> _Aim:
    """What another picture adds."""
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
