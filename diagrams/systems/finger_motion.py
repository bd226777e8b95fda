"""The finger as the sliding model wants it: where it is and how fast while it is down, else nowhere."""

from __future__ import annotations

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, EventStatus, State

from diagrams.collectable import PythonSystem


class FingerMotion(PythonSystem):
    """Turns the finger's measured pose into the `finger` input of `CellGridSlider`.

    .. pydrake_system::

        name: FingerMotion
        input_ports:
        - tip_pose
        - execution
        output_ports:
        - finger

    - `tip_pose`: X_WT; `execution`: `ExecutionStatus`.
    - `finger`: (4,) centre (m) and velocity (m/s) in the world; NaN unless the finger pushes, because above
      the table it may pass over the object.

    Args:
        period: s over which the velocity is taken; the step of the model that it drives.
    """

    def __init__(self, period: float) -> None:
        super().__init__()
        self._period = period
        self.DeclareAbstractInputPort("tip_pose", Value(RigidTransform()))
        self.DeclareAbstractInputPort("execution", Value[object](None))
        last = self.DeclareDiscreteState(np.full(4, np.nan))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._look)
        self.DeclareVectorOutputPort("finger", 4, self._calc, {self.discrete_state_ticket(last)})

    def _look(self, context: Context, state: State) -> EventStatus:
        before = context.get_discrete_state(0).value()
        now = np.full(4, np.nan)
        if self.GetInputPort("execution").Eval(context).mode == "pushing":
            place = self.GetInputPort("tip_pose").Eval(context).translation()[:2]
            velocity = (place - before[:2]) / self._period if np.isfinite(before[0]) else np.zeros(2)
            now = np.concatenate([place, velocity])
        state.set_value(now)
        return EventStatus.Succeeded()

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(0).value())
