"""Blocks for the finger: measured motion, motion along given pushes, and pose and force from the arm."""

from collections.abc import Sequence

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, EventStatus, State

from slipmap.diagrams.execution.arm_motion import FingerKinematics, tip_force
from slipmap.diagrams.execution.requests import ActivePush
from slipmap.diagrams.systems.measurement_logger import PERIOD
from slipmap.diagrams.systems.python_system import PythonSystem
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.settings import check_kind, check_not_negative, check_positive, check_several
from slipmap.planners.table_push import TablePush

# Times the speed of a push at which a finger that was not measured for a while catches up; the arm itself is
# up to 1.05 times as fast as asked.
_CATCHES_UP = 1.25


class FingerMotion(PythonSystem):
    """Turns the finger's measured pose into the `finger` input of `CellGridSlider`.

    Inputs:
    - `tip_pose`: X_WT; `execution`: `ExecutionStatus`; optionally `push`: `ActivePush | None` under way.
    Outputs:
    - `finger`: (4,) centre (m) and velocity (m/s) in the world; NaN unless the finger is pushing, because a
      raised finger may pass over the object.

    If the program that drives a real cell was held up, the measured place jumps, and a model would take that
    for a blow. The output then follows at no more than 1.25 times the speed of `push`.

    Args:
        period: s over which the velocity is computed; the step of the model that it drives.

    Example:
        >>> from slipmap.diagrams.systems.finger import FingerMotion
        >>> motion = FingerMotion(0.005)
        >>> [motion.get_output_port(i).get_name() for i in range(motion.num_output_ports())]
        ['finger']
    """

    def __init__(self, period: float) -> None:
        super().__init__()
        check_positive("FingerMotion: period", period, "s")
        self._period = period
        self.DeclareAbstractInputPort("tip_pose", Value(RigidTransform()))
        self.declare_inputs("execution", "push")
        last = self.DeclareDiscreteState(np.full(4, np.nan))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._look)
        after = {self.discrete_state_ticket(last)}
        self.declare_vector_output("finger", 4, lambda context: context.get_discrete_state(0).value(), after)

    def _look(self, context: Context, state: State) -> EventStatus:
        before = context.get_discrete_state(0).value()
        absent = bool(np.isnan(before[0]))
        if self.input(context, "execution").mode == "pushing":
            place = self.input(context, "tip_pose").translation()[:2]
            way = np.zeros(2) if absent else place - before[:2]
            push: ActivePush | None = self.optional_input(context, "push")
            longest = np.inf if push is None else _CATCHES_UP * push.push.speed * self._period
            if (length := float(np.hypot(*way))) > longest:
                way *= longest / length
                place = before[:2] + way
            state.set_value(np.concatenate([place, way / self._period]))
        elif absent:
            return EventStatus.DidNothing()
        else:
            state.set_value(np.full(4, np.nan))
        return EventStatus.Succeeded()


class FingerPath(PythonSystem):
    """A finger without an arm: makes pushes one after another, and is absent between them.

    Outputs:
    - `finger`: (4,) centre (m) and velocity (m/s) in the world, as `CellGridSlider` takes it; NaN between
      pushes.
    - `push`: `ActivePush | None`, the push under way with its number from 1, as `MultiverseSlider` and
      `BeliefVisualizer` take it.

    Args:
        pushes: in the world, in order.
        h: time over which the velocity is constant, s; forces are smoothest if it is the step of the model
            that it drives.
        pause: between two pushes and before the first, s.
        rest: time for which the finger is down and at rest before and after it moves, s.

    Raises:
        TypeError: something else than a list of `TablePush`es.
        ValueError: a step that is not positive, a negative rest, a pause that is negative or not finite, or
            too short for a `TrialLogger` to see that the finger is up between two pushes.

    Example:
        >>> import slipmap
        >>> push = slipmap.TablePush([-0.06, 0.0], [0.04, 0.0], 0.05)
        >>> slipmap.FingerPath([push], h=0.005).GetOutputPort("finger").get_name()
        'finger'
    """

    def __init__(self, pushes: Sequence[TablePush], h: float, pause: float = 1.0, rest: float = 0.4) -> None:
        super().__init__()
        self._h = h
        check_several("FingerPath: pushes", pushes, "such as [push]")
        for push in pushes:
            check_kind(
                "FingerPath: a push", push, TablePush, "such as TablePush([-0.06, 0], [0.04, 0], 0.05)"
            )
        paths = [push.path(h, rest=rest) for push in pushes]
        check_not_negative("FingerPath: pause", pause, "s")
        steps = round(pause / h)
        up = h * (steps + 1)  # a path's last point is a time step without a finger
        if len(pushes) > 1 and up < PERIOD - 1e-9:
            raise ValueError(
                f"FingerPath: pause must be at least {PERIOD:g} s, the time between two rows of a"
                f" `TrialLogger`, which would record two pushes as one; got {pause:g} s"
            )
        begins = steps + np.cumsum([0, *(len(path) + steps for path in paths)])[:-1]
        numbered = [ActivePush(number, push) for number, push in enumerate(pushes, 1)]
        self._made = list(zip(begins, numbered, paths, strict=True))
        self.end = h * float(begins[-1] + len(paths[-1]) + steps) if paths else 0.0
        """Time at which the last push and the pause after it are over, s."""
        time = {self.time_ticket()}
        self.declare_vector_output("finger", 4, lambda context: self._now(context)[1], time)
        self.declare_output("push", lambda context: self._now(context)[0], time)

    def _now(self, context: Context) -> tuple[ActivePush | None, FloatArray]:
        """The push under way and the state (4,) of the finger."""
        steps = context.get_time() / self._h
        step = int(steps + 1e-6)
        for begin, push, path in self._made:
            if begin <= step < begin + len(path) - 1:
                here, there = path[step - begin : step - begin + 2]
                since = steps - step
                # Exactly the path's point at the finger's own steps; between them, where it is by then.
                center = here if since < 1e-6 else here + since * (there - here)
                return push, np.concatenate([center, (there - here) / self._h])
        return None, np.full(4, np.nan)


class FingerSense(PythonSystem):
    """Computes the finger's pose and force from joint angles and torques.

    Inputs:
    - `iiwa.position_measured` (7,) rad; `iiwa.torque_external` (7,) N m, from contact with the arm.
    Outputs:
    - `tip_pose`: X_WT; `tip_force` (3,) N, of the finger on the object, in the world.

    Args:
        model: the arm, as built by `slipmap.diagrams.station.arm.arm_model`.
    """

    def __init__(self, model: MultibodyPlant) -> None:
        super().__init__()
        self._kinematics = FingerKinematics(model)
        self._position = self.DeclareVectorInputPort("iiwa.position_measured", 7)
        self._torque = self.DeclareVectorInputPort("iiwa.torque_external", 7)
        position, torque = self._position.ticket(), self._torque.ticket()
        self.declare_output("tip_pose", self._pose, {position}, Value(RigidTransform()))
        self.declare_vector_output("tip_force", 3, self._force, {position, torque})

    def _pose(self, context: Context) -> RigidTransform:
        return self._kinematics.pose(self._position.Eval(context))

    def _force(self, context: Context) -> FloatArray:
        jacobian = self._kinematics.jacobian(self._position.Eval(context))
        return tip_force(jacobian, self._torque.Eval(context))
