"""`ModelMonitor`: is the object still doing what the model says? Residual, misfit, and an alarm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem, State

from diagrams.systems.held import held, read, replace_held
from models.inference.diagnosis.error_model import ErrorModel
from models.inference.observations import SAMPLES, Observation
from models.inference.push_misfit import bet, observed_push, pose_noise, push_misfit, rank_p
from models.physics.cell_grid import CellGrid, FloatArray
from models.physics.rollout import Push

LEVEL = 0.01
"""At least 1/LEVEL pushes pass on average before a false alarm."""

LEAST_SAMPLES = 3
"""A push seen less often tells nothing."""


@dataclass(frozen=True, eq=False)
class Sample:
    """One look during a push.

    Attributes:
        time: s.
        predicted: (3,) pose.
        observed: (3,) pose.
        covariance: (3, 3) of the observed pose.
    """

    time: float
    predicted: FloatArray
    observed: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class Watch:
    """What the monitor has seen.

    Attributes:
        push: number of the push under way, or None.
        samples: of that push, or of the last one.
        misfits: of all finished pushes, in order.
        evidence: E, see `models.inference.push_misfit`.
        alarm: whether it is given.
    """

    push: int | None = None
    samples: tuple[Sample, ...] = ()
    misfits: tuple[float, ...] = ()
    evidence: float = 1.0
    alarm: bool = False


class ModelMonitor(LeafSystem):
    """Holds the predicted pose against the observed one while pushes are made.

    .. pydrake_system::

        name: ModelMonitor
        input_ports:
        - predicted_pose
        - object_pose
        - push
        output_ports:
        - residual
        - misfit
        - evidence
        - alarm

    Inputs:
        predicted_pose: (3,) x, y, θ in the world, predicted from where the push began, such as `mean_pose` of
            a `MultiverseSlider`; NaN where there is none.
        object_pose: abstract, with `pose` (3,), `covariance` (3, 3) and `valid`, such as an `ObservedPose`.
        push: abstract, None or something with a `push_id`, such as an `ActivePush`.

    Outputs:
        residual: (3,) observed minus predicted pose when last seen during a push (m, m, rad); NaN before.
        misfit: (1,) `push_misfit` of the push under way so far, or of the last one; NaN before.
        evidence: (1,) E of `models.inference.push_misfit`, renewed when a push ends.
        alarm: abstract bool. It is given when the evidence reaches 1/LEVEL, and taken back only when the
            evidence is down at 1 again, that is when pushes have been predicted as well as usual for a while.
            If nothing is missing, at least 1/LEVEL pushes pass on average before a (false) alarm.

    Poses are compared every `period`; a push counts when it ends, that is when `push` changes its number or
    becomes None. The unit of evidence is the push.

    Args:
        grid: cells and outline.
        calibration: (m,) misfits of pushes without a missing effect, in the same setting: simulated
            (`simulated_misfits`) or measured. Evidence of one push is limited by their number; have 200.
        period: of comparing, s.
        model_error: α, by which share of the way the model is off anyway; the same for the calibration.

    Raises:
        ValueError: fewer than 20 calibration misfits, or some that are not finite.
    """

    def __init__(
        self, grid: CellGrid, calibration: FloatArray, period: float = 1 / 15, model_error: float = 0.03
    ) -> None:
        super().__init__()
        self.set_name("model_monitor")
        calibration = np.asarray(calibration, dtype=float)
        if calibration.ndim != 1 or len(calibration) < 20 or not np.isfinite(calibration).all():
            raise ValueError(
                "ModelMonitor: calibration must be at least 20 finite misfits, got shape"
                f" {calibration.shape}; `simulated_misfits` makes them"
            )
        self._grid = grid
        self._calibration = calibration
        self._model_error = model_error
        self._predicted = self.DeclareVectorInputPort("predicted_pose", 3)
        self._observed = self.DeclareAbstractInputPort("object_pose", Value[object](None))
        self._push = self.DeclareAbstractInputPort("push", Value[object](None))
        self._watch = self.DeclareAbstractState(held(Watch()))
        after = {self.abstract_state_ticket(self._watch)}
        self.DeclareVectorOutputPort("residual", 3, self._output_residual, after)
        self.DeclareVectorOutputPort("misfit", 1, self._output_misfit, after)
        self.DeclareVectorOutputPort("evidence", 1, self._output_evidence, after)
        self.DeclareAbstractOutputPort("alarm", lambda: Value[bool](False), self._output_alarm, after)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._look)

    def watch(self, context: Context) -> Watch:
        """What has been seen so far."""
        return read(context, self._watch)

    def _look(self, context: Context, state: State) -> None:
        watch = self.watch(context)
        push: Any = self._push.Eval(context)
        number = None if push is None else int(push.push_id)
        if number != watch.push:
            watch = self._ended(watch)
            samples = watch.samples if number is None else ()
            watch = replace(watch, push=number, samples=samples)
        predicted: Any = self._predicted.Eval(context)
        seen: Any = self._observed.Eval(context)
        if number is not None and seen is not None and seen.valid and np.isfinite(predicted).all():
            sample = Sample(context.get_time(), predicted.copy(), seen.pose, seen.covariance)
            watch = replace(watch, samples=(*watch.samples, sample))
        replace_held(state, self._watch, watch)

    def _ended(self, watch: Watch) -> Watch:
        """Count the push that was under way, if there was one."""
        if watch.push is None or len(watch.samples) < LEAST_SAMPLES:
            return watch
        misfit = self._misfit(watch.samples)
        p = rank_p(misfit, np.concatenate([self._calibration, watch.misfits]))
        evidence = max(watch.evidence, 1.0) * bet(p)
        alarm = evidence >= 1.0 / LEVEL or (watch.alarm and evidence > 1.0)
        return replace(watch, misfits=(*watch.misfits, misfit), evidence=evidence, alarm=alarm)

    def _misfit(self, samples: tuple[Sample, ...]) -> float:
        """`push_misfit` of one push, as many of its samples as a push is compared at."""
        rows = np.unique(np.linspace(0, len(samples) - 1, SAMPLES + 1).astype(int))
        used = [samples[row] for row in rows]
        variances = np.mean([np.diagonal(sample.covariance) for sample in used], axis=0)
        noise = pose_noise(float(np.sqrt(variances[:2].mean())), float(np.sqrt(variances[2])))
        error = ErrorModel(noise, self._model_error, 0.0)
        predicted = np.array([sample.predicted for sample in used[1:]])
        return push_misfit(_observation(used), predicted, error, self._grid)

    def _output_residual(self, context: Context, output: Any) -> None:
        samples = self.watch(context).samples
        last = samples[-1].observed - samples[-1].predicted if samples else np.full(3, np.nan)
        output.SetFromVector(last)

    def _output_misfit(self, context: Context, output: Any) -> None:
        samples = self.watch(context).samples
        output.SetFromVector([self._misfit(samples) if len(samples) >= LEAST_SAMPLES else np.nan])

    def _output_evidence(self, context: Context, output: Any) -> None:
        output.SetFromVector([self.watch(context).evidence])

    def _output_alarm(self, context: Any, output: Any) -> None:
        output.set_value(self.watch(context).alarm)


def _observation(samples: list[Sample]) -> Observation:
    """A push as it was seen, from its first look on."""
    times = np.array([sample.time for sample in samples])
    nowhere = np.full((2, 2), np.nan)
    push = Push(times[-1] - times[0], nowhere, samples[0].observed, pose_times=(times - times[0])[1:])
    return observed_push(push, np.array([sample.observed for sample in samples[1:]]))
