"""`MultiverseSlider`: all hypotheses of a belief, pushed by one finger, stepped together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.systems.framework import Context

from slipmap.diagrams.systems.cell_grid_slider import (
    check_wrench,
    history_length,
    pose_then,
    tip_of,
)
from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held
from slipmap.models.inference.belief import Belief
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.stepper import NO_FINGER, NO_WRENCH, StepModels, Stepper
from slipmap.models.settings import check_kind, check_positive, finite_array


@dataclass(frozen=True, eq=False)
class Universes:
    """K hypotheses in motion."""

    belief: Belief  # their source
    stepper: Stepper  # the model
    models: StepModels  # maps as the kernel takes them
    states: FloatArray  # (K, Z) see `Stepper`
    history: FloatArray  # (K, L, 3) true poses one, two, … steps ago, back to the tracker's largest latency
    push: int | None  # number of the push that set them in motion, or None
    begin: float  # time at which they were placed, s
    order: int  # place of the push among all recorded ones, from 0, as `identify` counts them
    before: Universes | None = None  # those of the push before, as this one found them

    @property
    def poses(self) -> FloatArray:
        """(K, 3) poses as the tracker would report them."""
        program = self.stepper.program
        if program.delay is None and program.measured is None:
            return self.states[:, :3]
        effects = self.models.maps.effects
        rows = zip(self.states[:, :3], self.history, effects, strict=True)
        return np.array([pose_then(self.stepper, pose, past, values) for pose, past, values in rows])

    @property
    def mean_pose(self) -> FloatArray:
        """(3,) probability-weighted mean of the poses."""
        return self.belief.probability @ self.poses

    @property
    def spread(self) -> float:
        """Probability-weighted mean ADD of the hypotheses from their mean, m."""
        return float(self.belief.probability @ add(self.poses, self.mean_pose, self.belief.grid.centers))

    def of_trial(self, number: int) -> Universes | None:
        """The hypotheses that were pushed in a trial, by its number from 0; None if they are gone."""
        rows = (self, self.before)
        return next((row for row in rows if row is not None and row.order == number), None)


def placed(
    belief: Belief,
    h: float,
    pose: FloatArray,
    *,
    push: int | None = None,
    begin: float = 0.0,
    order: int = 0,
    before: Universes | None = None,
) -> Universes:
    """All hypotheses at rest where the tracker reports `pose` (3,), in steps of h (s)."""
    stepper = Stepper(
        belief.grid, belief.finger_radius, h, belief.effects, belief.gravity, belief.smoothing, belief.table
    )  # fmt: skip
    models = stepper.models(belief.maps)
    states = stepper.start(models, pose)
    history = np.repeat(states[:, None, :3], history_length(stepper), axis=1)
    before = None if before is None else replace(before, before=None)
    return Universes(belief, stepper, models, states, history, push, begin, order, before)


class MultiverseSlider(PythonSystem):
    """K hypotheses of a belief under one finger, in steps of h, with one kernel call per step.

    Inputs, all optional except that `push` requires `trials`:
        wrench: (5,), and
        finger: (4,), as for `CellGridSlider`.
        belief: abstract, `Belief` or None.
        object_pose: abstract, `ObservedPose`.
        push: abstract, None or something with a `push_id`, such as the `push` of a
            `FingerPath`.
        trials: abstract, tuple of the `Trial`s recorded so far. Their number is the place of the present push
            in the experiment, on which effects such as `friction_drift` depend, and by which a `ModelMonitor`
            knows which trial these hypotheses predict. So a push must begin after the trial of the one before
            is recorded.

    When the number of `push` changes, all hypotheses of the `belief` are placed at rest at the object's
    observed pose; they then evolve separately until the next push.

    Outputs:
        poses: abstract, (K, 3) x, y, θ in the world as a tracker reports them; (0, 3) without a belief.
        mean_pose: (3,) probability-weighted mean; NaN without a belief.
        spread: (1,) probability-weighted mean ADD of the hypotheses from their mean, m; NaN without a belief.
        universes: abstract, `Universes` or None without a belief.

    Args:
        h: step, s.

    Raises:
        ValueError: the step is not positive; in a simulation, a wrench or finger that `CellGridSlider` would
            refuse.
        TypeError: in a simulation, an input of another kind.

    Example:
        A `ModelMonitor` judges a push of a simulated hammer by what was learned from another push.

        >>> import slipmap
        >>> from pydrake.all import ConstantValueSource, DiagramBuilder, Simulator, Value
        >>> dataset, truth = slipmap.simulated_hammer(seed=1, fit=1, heldout=0)
        >>> belief = slipmap.identify(dataset, hypotheses=4, friction_laws=False).belief
        >>> push = slipmap.TablePush([0.04, 0.0], [-0.04, 0.0], speed=0.05)
        >>> builder = DiagramBuilder()
        >>> finger = builder.AddSystem(slipmap.FingerPath([push], h=0.005))
        >>> slider = builder.AddSystem(slipmap.CellGridSlider(dataset.grid, truth, 0.008, h=0.005))
        >>> logger = builder.AddSystem(slipmap.TrialLogger())
        >>> known = builder.AddSystem(ConstantValueSource(Value[object](belief)))
        >>> universes = builder.AddSystem(slipmap.MultiverseSlider(h=0.005))
        >>> monitor = builder.AddSystem(slipmap.ModelMonitor(dataset.noise))
        >>> for block, port, others in [
        ...     (finger, "finger", {slider: "finger", logger: "finger", universes: "finger"}),
        ...     (finger, "push", {universes: "push"}),
        ...     (slider, "object_pose", {logger: "object_pose"}),
        ...     (slider, "finger_force", {logger: "finger_force"}),
        ...     (logger, "observed_pose", {universes: "object_pose", monitor: "object_pose"}),
        ...     (logger, "trials", {universes: "trials", monitor: "trials"}),
        ...     (known, "y0", {universes: "belief"}),
        ...     (universes, "universes", {monitor: "universes"}),
        ... ]:
        ...     for other, own in others.items():
        ...         builder.Connect(block.GetOutputPort(port), other.GetInputPort(own))
        >>> simulator = Simulator(builder.Build())
        >>> _ = simulator.AdvanceTo(finger.end)
        >>> watch = monitor.watch(monitor.GetMyContextFromRoot(simulator.get_context()))
        >>> len(watch.judged), watch.alarm
        (1, False)
    """

    def __init__(self, h: float) -> None:
        super().__init__()
        check_positive("MultiverseSlider: h", h, "s")
        self._h = h
        self.DeclareVectorInputPort("wrench", 5)
        self.DeclareVectorInputPort("finger", 4)
        self.declare_inputs("belief", "object_pose", "push", "trials", belief=Belief, trials=Sequence)
        self._universes = self.DeclareAbstractState(held(None))
        after = {self.abstract_state_ticket(self._universes)}
        self.declare_output_of(
            "poses", self._universes, lambda now: np.zeros((0, 3)) if now is None else now.poses
        )
        self.declare_vector_output("mean_pose", 3, self._mean_pose, after)
        self.declare_vector_output("spread", 1, self._spread, after)
        self.declare_output_of("universes", self._universes)
        self.declare_steps(h, self._universes, self._step)

    def set_belief(self, context: Context, belief: Belief, pose: FloatArray) -> None:
        """Place all hypotheses of a belief at rest where a tracker reports `pose` (3,).

        Raises:
            TypeError: no belief.
            ValueError: not three finite numbers.
        """
        check_kind("set_belief: belief", belief, Belief, "such as slipmap.identify(dataset).belief")
        pose = finite_array("set_belief: pose", pose, (3,))
        order = len(self.optional_input(context, "trials") or ())
        universes = placed(belief, self._h, pose, begin=context.get_time(), order=order)
        replace_held(context.get_mutable_state(), self._universes, universes)

    def universes(self, context: Context) -> Universes | None:
        """The hypotheses in motion."""
        return read(context, self._universes)

    def _step(self, context: Context, now: Universes | None) -> Universes | None:
        universes = self._restarted(context) or now
        if universes is None:
            return None
        wrench, finger = self.optional_input(context, "wrench"), self.optional_input(context, "finger")
        if wrench is not None:
            check_wrench(wrench)
        states, _ = universes.stepper.step(
            universes.models,
            universes.states,
            wrench=NO_WRENCH if wrench is None else wrench,
            tip=NO_FINGER if finger is None else tip_of(finger, self._h),
            time=context.get_time() - universes.begin,
            order=universes.order,
        )
        history = universes.history
        if history.shape[1]:
            history = np.concatenate([universes.states[:, None, :3], history[:, :-1]], axis=1)
        return replace(universes, states=states, history=history)

    def _restarted(self, context: Context) -> Universes | None:
        """The hypotheses, placed again if a new push has begun and the object is seen; else None."""
        before = self.universes(context)
        push = self.optional_input(context, "push")
        if push is None or (before is not None and before.push == push.push_id):
            return None
        belief = self.optional_input(context, "belief")
        belief = belief if belief is not None or before is None else before.belief
        if belief is None:
            return None
        seen = self.optional_input(context, "object_pose")  # last, because it may have to wait for a picture
        if seen is None or not seen.valid:
            return None
        # Candidates that were refused or touched nothing left no trial, so they do not count.
        order = len(self.input(context, "trials"))
        return placed(
            belief, self._h, seen.pose,
            push=push.push_id, begin=context.get_time(), order=order, before=before,
        )  # fmt: skip

    def _mean_pose(self, context: Context) -> FloatArray:
        universes = self.universes(context)
        return np.full(3, np.nan) if universes is None else universes.mean_pose

    def _spread(self, context: Context) -> list[float]:
        universes = self.universes(context)
        return [np.nan if universes is None else universes.spread]
