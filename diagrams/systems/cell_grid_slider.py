"""`CellGridSlider`: the differentiable model of a sliding object as a Drake system, effects included.

With some effects, a tracker reports the stepped model's pose late, offset or scaled: see `pose_then`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector_, LeafSystem_, NumericParameterIndex, ValueProducer
from pydrake.systems.scalar_conversion import TemplateSystem

from slipmap.diagrams.systems.python_system import HoldsOutputFunctions, WithoutOwnDict, weakly
from slipmap.models.effects.effect import Effect
from slipmap.models.effects.program import Report
from slipmap.models.geometry import placed
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.measurements.simulated import check_begins_clear
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.rollout import Smoothing
from slipmap.models.physics.stepper import NO_FINGER, NO_WRENCH, StepModels, Stepper

MASS, FRICTION, FINGER_FRICTION, EFFECTS, PUSH = range(5)  # indices of the numeric parameters in the Context


def history_length(stepper: Stepper) -> int:
    """Number of past poses that a report may need, given the largest possible latency."""
    if stepper.program.delay is None:
        return 0
    # The delay is the sum of its parameters, so their largest values give its largest.
    latest, _ = stepper.delay(np.concatenate([[p.high for p in e.parameters] for e in stepper.effects]))
    return int(np.ceil(latest / stepper.h)) + 1


def pose_then(stepper: Stepper, pose: Any, history: Any, effects: Any) -> Any:
    """The pose (3,) that the tracker reports now, of the same scalar type as `pose` (float or AutoDiffXd).

    A negative delay extrapolates at constant velocity, because the later drive is not yet known.

    Args:
        stepper: the model.
        pose: (3,) true pose.
        history: (L, 3) true poses one, two, … steps ago.
        effects: (P,) parameters of the effects.
    """
    derivatives = pose.dtype == object
    values = values_of(effects)
    if stepper.program.delay is not None:
        delay, slopes = stepper.delay(values)
        steps: Any = delay / stepper.h
        whole = min(max(int(steps), 0), len(history) - 1)
        if derivatives:
            steps = with_gradient(np.array([steps]), slopes[None] / stepper.h, effects)[0]
        then = np.vstack([pose, history])[whole : whole + 2]
        pose = then[0] + (steps - whole) * (then[1] - then[0])
    return _reported(stepper.program.measured, pose, effects)


def _reported(report: Report | None, true: Any, effects: Any) -> Any:
    """A sensor's report (n,) of true values (n,), with derivatives if those have them."""
    if report is None:
        return true
    reported, by_true, by_effects = report(*values_of(true), values_of(effects))
    if true.dtype != object:
        return reported
    return with_gradient(reported, np.hstack([by_true, by_effects]), np.concatenate([true, effects]))


def tip_of(finger: Any, h: float) -> Any:
    """(2, 2) centre before and after a step of h (s) of a finger (4,); `NO_FINGER` if all of it is NaN.

    Raises:
        ValueError: only some of its numbers are finite.
    """
    values = values_of(finger)
    if np.isnan(values).all():
        return NO_FINGER
    if not np.isfinite(values).all():
        raise ValueError(
            "finger: its centre and velocity must be four finite numbers, or four NaN where there is none;"
            f" got {values.tolist()}"
        )
    center, velocity = np.split(finger, 2)
    return np.vstack([center, center + h * velocity])


def check_wrench(wrench: Any) -> None:
    """Raise ValueError for a wrench (5,) of which some numbers are not finite."""
    if not np.isfinite(values := values_of(wrench)).all():
        raise ValueError(
            "wrench: force, point and torque must be five finite numbers, zeros where nothing acts;"
            f" got {values.tolist()}"
        )


def values_of(numbers: Any) -> FloatArray:
    """Values (N,) of numbers (N,) that may carry derivatives."""
    if numbers.dtype == object:
        return ExtractValue(numbers)[:, 0]
    return numbers


def with_gradient(values: FloatArray, jacobian: FloatArray, arguments: Any) -> Any:
    """AutoDiffXd (M,) of values with their `jacobian` (M, N) with respect to the arguments (N,)."""
    value: Any = values
    return InitializeAutoDiff(value, jacobian @ ExtractGradient(arguments))[:, 0]


@TemplateSystem.define("CellGridSlider_", T_list=[float, AutoDiffXd])
def CellGridSlider_(T: type) -> type:
    """`CellGridSlider` for the scalar T, `float` or `AutoDiffXd`."""

    class Impl(HoldsOutputFunctions, LeafSystem_[T], metaclass=WithoutOwnDict):
        """The cell-grid model of one object, in steps of h, pushed by a finger, a wrench, or both.

        Inputs, both optional:
            wrench: (5,) force on the object (world, N), the point at which it acts (object frame, m) and a
                torque (N m), constant over a step, as in `Push.wrench`.
            finger: (4,) centre of the finger (world, m) and its velocity (m/s), constant over the step, in
                which it does not turn;
                NaN where there is no finger.

        Outputs:
            object_pose: (3,) x, y, θ in the world as a tracker reports it: the true pose, unless effects
                change the report (latency, offset, scale).
            object_twist: (3,) v_x, v_y (m/s), omega (rad/s) in the object frame, at its origin.
            cell_positions: (2 n,) x_1, y_1, x_2, … of the cells' centres in the world at `object_pose`, m.
            finger_force: (2,) mean force of the finger on the object in the last step, world, N, as a force
                sensor reports it; a latency of that sensor is ignored here.

        The state is one discrete vector: true pose (3), twist (3), the finger's last force (2), the effects'
        memory, and, if the tracker may be late, the last true poses.

        The numeric parameters in the Context are the mass map (n,) kg, the friction map (n,), the friction
        with the finger (1,), the effects' parameters (P,), and, for effects that need them, the start time
        of the push (s) and its place in the experiment (2,).

        With AutoDiffXd, a step has the kernel's exact derivatives with respect to state, inputs and
        parameters.

        Args:
            grid: cells and outline.
            maps: one model, the default of the parameters. Without effects' parameters, effects vanish.
            finger_radius: m.
            h: step, s.
            effects: of the model, in the order of the columns of `Maps.effects`; those of the library may be
                given by name.
            gravity: m/s².
            smoothing: see `Smoothing`.
            table: see `Slider`; cells beyond its rim carry nothing.

        Raises:
            ValueError: maps of another grid, of other effects, or of more than one model; a finger over half
                a metre thick, or a step over 0.1 s; in a simulation, a wrench that is not finite, or a
                finger of which only some numbers are finite, or that appears deep inside the object.

        Example:
            >>> import slipmap
            >>> grid, truth = slipmap.hammer()
            >>> slider = slipmap.CellGridSlider(grid, truth, finger_radius=0.008, h=0.005)
            >>> [slider.get_output_port(i).get_name() for i in range(slider.num_output_ports())]
            ['object_pose', 'object_twist', 'cell_positions', 'finger_force']
        """

        def _construct(
            self,
            grid: CellGrid,
            maps: Maps,
            finger_radius: float,
            h: float,
            effects: Sequence[Effect | str] = (),
            gravity: float = 9.81,
            smoothing: Smoothing | None = None,
            table: Table | None = None,
            converter: Any = None,
        ) -> None:
            LeafSystem_[T].__init__(self, converter=converter)
            if len(maps) != 1:
                raise ValueError(f"CellGridSlider holds one model, the maps are of {len(maps)}")
            self.stepper = Stepper(grid, finger_radius, h, effects, gravity, smoothing, table)
            models = self.stepper.models(maps)
            effects = self.stepper.effects
            self._arguments = (grid, models.maps, finger_radius, h, effects, gravity, smoothing, table)
            self._history = history_length(self.stepper)
            vector = BasicVector_[T]
            state = vector(self.stepper.size + 3 * self._history)
            state.SetFromVector(np.zeros(state.size()))
            self.DeclareDiscreteState(state)
            for values in (*_rows(models.maps), np.zeros(2)):
                self.DeclareNumericParameter(vector(values))
            entry = self.DeclareCacheEntry(
                "models as the kernel takes them",
                ValueProducer(lambda: AbstractValue.Make(models), weakly(self._prepare)),
                {self.numeric_parameter_ticket(NumericParameterIndex(i)) for i in range(PUSH)},
            )
            self._models_entry = entry.cache_index()
            self._wrench = self.DeclareVectorInputPort("wrench", 5).get_index()
            self._finger = self.DeclareVectorInputPort("finger", 4).get_index()
            of_sensors = {self.xd_ticket(), self.numeric_parameter_ticket(NumericParameterIndex(EFFECTS))}
            self.DeclareVectorOutputPort("object_pose", 3, self._output_pose, of_sensors)
            self.DeclareVectorOutputPort("object_twist", 3, self._output_twist, {self.xd_ticket()})
            self.DeclareVectorOutputPort("cell_positions", 2 * len(grid), self._output_cells, of_sensors)
            self.DeclareVectorOutputPort("finger_force", 2, self._output_force, of_sensors)
            self.DeclarePeriodicDiscreteUpdateEvent(h, 0.0, self._step)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            grid, maps, radius, h, effects, gravity, smoothing, table = other._arguments
            Impl._construct(self, grid, maps, radius, h, effects, gravity, smoothing, table, converter)

        def set_maps(self, context: Any, maps: Maps) -> None:
            """Set the maps and effects' parameters of one model in a Context.

            Raises:
                ValueError: maps of another grid, of other effects, or of more than one model.
            """
            if len(maps) != 1:
                raise ValueError(f"CellGridSlider holds one model, the maps are of {len(maps)}")
            for index, values in enumerate(_rows(self.stepper.models(maps).maps)):
                context.get_mutable_numeric_parameter(index).SetFromVector(values)

        def set_motion(self, context: Any, pose: FloatArray, twist: FloatArray | None = None) -> None:
            """Place the object where a tracker reports `pose` (3,), at rest or with a twist (3,), without
            contact and with the effects' memory cleared.

            Raises:
                ValueError: not three finite numbers.
            """
            for what, values in (("pose", pose), ("twist", np.zeros(3) if twist is None else twist)):
                if np.shape(values) != (3,) or not np.isfinite(np.asarray(values, dtype=float)).all():
                    raise ValueError(f"set_motion: {what} must be three finite numbers, got {values}")
            models = self._models(context)
            start = self.stepper.start(models, pose, None if twist is None else np.asarray(twist)[None])[0]
            context.SetDiscreteState(np.concatenate([start, np.tile(start[:3], self._history)]))

        def set_push(self, context: Any, begin: float, order: float = 0.0) -> None:
            """Set the start time of the push (s) and its number in the experiment, from 0."""
            context.get_mutable_numeric_parameter(PUSH).SetFromVector([begin, order])

        def _prepare(self, context: Any, value: Any) -> None:
            mass, mu, mu_finger, effects = (values_of(row) for row in _parameters(context)[:PUSH])
            maps = Maps(mass[None], mu[None], mu_finger, effects[None])
            value.set_value(self.stepper.models(maps))

        def _models(self, context: Any) -> StepModels:
            return self.get_cache_entry(self._models_entry).Eval(context)

        def _step(self, context: Any, discrete: Any) -> None:
            state = context.get_discrete_state_vector().CopyToVector()
            size = self.stepper.size
            wrench, finger = (self.get_input_port(i) for i in (self._wrench, self._finger))
            wrench = wrench.Eval(context) if wrench.HasValue(context) else NO_WRENCH
            check_wrench(wrench)
            tip = tip_of(finger.Eval(context), self.stepper.h) if finger.HasValue(context) else NO_FINGER
            if not values_of(state[6:8]).any():  # it was not there, or felt nothing
                pose, center = values_of(state[:3]), values_of(tip.ravel())[:2]
                check_begins_clear("CellGridSlider: contact", self.stepper, pose, center)
            parameters = _parameters(context)
            begin, order = values_of(parameters[PUSH])
            derive = T is AutoDiffXd
            time = context.get_time().value() if derive else context.get_time()
            after, jacobian = self.stepper.step(
                self._models(context),
                values_of(state[:size])[None],
                wrench=values_of(wrench),
                tip=values_of(tip.ravel()).reshape(2, 2),
                time=time - begin,
                order=order,
                derive=derive,
            )
            result = after[0]
            if derive:
                # In the order of the Jacobian's columns.
                mass, mu, mu_finger, effects, _ = parameters
                state_by = (state[:6], effects, state[6:size])
                arguments = np.concatenate([mass, mu, mu_finger, *state_by, wrench, tip.ravel()])
                result = with_gradient(after[0], jacobian[0], arguments)
            if self._history:
                result = np.concatenate([result, state[:3], state[size:-3]])
            discrete.set_value(result)

        def _pose(self, context: Any) -> Any:
            state = context.get_discrete_state_vector().CopyToVector()
            effects = _parameters(context)[EFFECTS]
            history = state[self.stepper.size :].reshape(-1, 3)
            return pose_then(self.stepper, state[:3], history, effects)

        def _output_pose(self, context: Any, output: Any) -> None:
            output.SetFromVector(self._pose(context))

        def _output_cells(self, context: Any, output: Any) -> None:
            output.SetFromVector(placed(self.stepper.grid.centers, self._pose(context)).ravel())

        def _output_twist(self, context: Any, output: Any) -> None:
            output.SetFromVector(context.get_discrete_state_vector().CopyToVector()[3:6])

        def _output_force(self, context: Any, output: Any) -> None:
            force = context.get_discrete_state_vector().CopyToVector()[6:8]
            output.SetFromVector(_reported(self.stepper.program.felt, force, _parameters(context)[EFFECTS]))

    return Impl


CellGridSlider = CellGridSlider_[float]


def slider_of_hypothesis(belief: Belief, hypothesis: int, h: float) -> Any:
    """`CellGridSlider` of one hypothesis of a belief, with its effects, in steps of h (s).

    Raises:
        ValueError: the belief has no hypothesis of this number.
    """
    if not 0 <= hypothesis < len(belief):
        raise ValueError(f"the belief has hypotheses 0 to {len(belief) - 1}, got hypothesis {hypothesis}")
    return CellGridSlider(
        belief.grid,
        belief.maps[hypothesis : hypothesis + 1],
        belief.finger_radius,
        h,
        belief.effects,
        belief.gravity,
        belief.smoothing,
        belief.table,
    )


def _rows(maps: Maps) -> tuple[FloatArray, ...]:
    """The numeric parameters of one model, without those of the push."""
    return maps.mass[0], maps.mu[0], maps.mu_finger, maps.effects[0]


def _parameters(context: Any) -> list[Any]:
    """Values of all numeric parameters, in the Context's scalar type."""
    return [context.get_numeric_parameter(i).CopyToVector() for i in range(PUSH + 1)]
