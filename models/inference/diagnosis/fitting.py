"""Fits of the model, with or without effects, and of its error model to the open pushes of a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import cache

import numpy as np

from slipmap.models.effects.effect import Effect, Scene
from slipmap.models.inference.diagnosis.correlated import (
    CorrelatedLikelihood,
    FitData,
    PushEquations,
    log_determinant,
    whitened_rows,
)
from slipmap.models.inference.error_model import ErrorModel, SensorNoise
from slipmap.models.inference.gauss_newton import fit, of_dataset
from slipmap.models.inference.likelihood import Likelihood, LikelihoodSettings
from slipmap.models.inference.observations import Observation, scene_of
from slipmap.models.inference.prior import MapPrior, PriorSettings, slider_for
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps, RolloutError
from slipmap.models.progress import StageProgress, part_of

_STEPS_TO_CHOOSE, _FOLLOWED = 2, 6
"""Iterations after which some of several starts are followed, and how many; the one that leads farthest at
first often ends in another valley."""

MODES = 20
"""Coordinates per map; finer ones cannot be distinguished from noise and cost time."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """One fitted model."""

    effects: tuple[Effect, ...]  # effects in the model
    likelihood: CorrelatedLikelihood  # with its prior and error model
    z: FloatArray  # (d,) coordinates
    prior_mean: FloatArray  # (d,) centre of the prior
    offsets: FloatArray  # (B, 3) start offsets of the pushes
    cost: float  # cost of the fit

    @property
    def hessian(self) -> FloatArray:
        """(d, d) of the data's cost, without the prior."""
        weights = np.ones((1, len(self.offsets)))
        return self.likelihood.linearise(self.z[None], self.offsets[None], np.ones(1), weights).hessian[0]

    @property
    def standard_deviations(self) -> FloatArray:
        """(P,) standard deviations of the parameters, marginal over everything else."""
        return self.likelihood.prior.effect_deviations(self.hessian)

    @property
    def scales(self) -> FloatArray:
        """(P,) standard deviations of the parameters in the prior."""
        return self.likelihood.prior.effect_scales

    @property
    def maps(self) -> Maps:
        """One hypothesis."""
        return self.likelihood.prior.maps(self.z[None])

    @property
    def values(self) -> FloatArray:
        """(P,) parameters of the effects."""
        return self.maps.effects[0]


class Fitter:
    """Fits models to the same open pushes of a dataset."""

    def __init__(self, dataset: PushDataset, observations: Sequence[Observation], noise: SensorNoise) -> None:
        self.dataset = dataset
        self.measured = FitData(observations, dataset.grid)
        self.observations = self.measured.observations
        self.noise = noise
        self.settings = PriorSettings(modes=MODES)
        self.weight: float | None = None
        self.forgiving_start: tuple[FloatArray, FloatArray]

    @property
    def with_long_steps(self) -> Fitter:
        """The same with steps twice as long, to choose what is then fitted with the usual ones."""
        coarse = copy(self)
        coarse.measured = self.measured.with_long_steps
        coarse.observations = coarse.measured.observations
        return coarse

    def prior(self, effects: Sequence[Effect]) -> MapPrior:
        """Coordinates of the model with some effects."""
        d = self.dataset
        return MapPrior(slider_for(d, effects), self.settings, d.mass, self.weight, known=d.known)

    def base(self, error: ErrorModel, start: Fitted, progress: StageProgress | None = None) -> Fitted:
        """Fit the model without effects, starting from the maps of another fit."""
        prior = self.prior(())
        likelihood = CorrelatedLikelihood(prior, self.measured, error)
        # Gains are counted from here: an unfinished search would be mistaken for an effect.
        return _fitted(
            (), likelihood, [(start.z[: prior.size], start.offsets)], np.zeros(prior.size),
            iterations=80, tolerance=1e-5, progress=progress,
        )  # fmt: skip

    def from_scratch(self, progress: StageProgress) -> Fitted:
        """Fit the model without effects together with the error model; this also sets the object's weight.

        The forgiving likelihood of the identification comes first: it finds the right minimum, where the
        strict one, with its many correlated rows, gets stuck on the way.

        Raises:
            DatasetError: the pushes cannot be computed from there.
        """
        prior = self.prior(())
        own = part_of(progress, 0, 3)
        with of_dataset(self.dataset.name):
            first = fit(self._forgiving(prior), prior.starts(), worth=np.inf, progress=own).best()
        self.forgiving_start = first.z[0], first.offsets[0]
        likelihood = CorrelatedLikelihood(prior, self.measured, ErrorModel(self.noise, 0.02, 0.08))
        fitted = Fitted((), likelihood, first.z[0], np.zeros(prior.size), first.offsets[0], np.inf)
        for place in (1, 2):
            with of_dataset(self.dataset.name):
                fitted = self.base(estimate_errors(fitted, self.noise), fitted, part_of(progress, place, 3))
        self.weight = self._weight_of(fitted)
        return fitted

    def _forgiving(self, prior: MapPrior) -> Likelihood:
        return Likelihood(prior, self.observations, self.dataset.noise, LikelihoodSettings())

    def start_of(self, effect: Effect, values: FloatArray, error: ErrorModel, near: Fitted) -> FloatArray:
        """(P,) starting parameters of an effect: those given (P,), or the one of its distant starts that
        explains the pushes best with the maps of a fit."""
        tried = effect.with_far_starts(values)
        if len(tried) == 1:
            return values
        prior = self.prior((effect,))
        likelihood = CorrelatedLikelihood(prior, self.measured, error)
        z = np.concatenate(
            [np.tile(near.z[: prior.plain], (len(tried), 1)), prior.effect_coordinates(tried)], axis=1
        )
        offsets = np.repeat(near.offsets[None], len(tried), axis=0)
        weights = np.ones((len(tried), len(near.offsets)))
        cost = likelihood.linearise(z, offsets, np.ones(len(tried)), weights).cost.sum(axis=1)
        return tried[int(np.argmin(np.where(np.isnan(cost), np.inf, cost)))]

    def with_effects(
        self,
        effects: Sequence[Effect],
        error: ErrorModel,
        near: Fitted | None,
        values: FloatArray,
        *,
        afresh: bool = False,
        worth: float = np.inf,
        iterations: int = 30,
        forgiving: int = 25,
    ) -> Fitted | None:
        """Fit the model with some effects.

        Args:
            near: fit to start from; None to start only afresh.
            values: (P,) parameters to start from.
            afresh: start a second time from where the forgiving likelihood leads: without the effect, the
                maps of `near` may be bent too far to find back.
            worth: cost above which a fit is useless, and may be given up before its end.
            iterations: most iterations of each search.
            forgiving: most iterations under the forgiving likelihood.

        Returns:
            The better fit, or None where none can be computed.
        """
        effects = tuple(effects)
        prior = self.prior(effects)
        likelihood = CorrelatedLikelihood(prior, self.measured, error)
        plain = prior.plain
        shaping = np.concatenate([np.zeros(plain, dtype=bool), *(~effect.amplitudes for effect in effects)])
        parameters = prior.effect_coordinates(values)
        maps, offsets = self.forgiving_start if near is None else (near.z, near.offsets)
        start = np.concatenate([maps[:plain], parameters])
        mean = np.where(shaping, start, 0.0)
        starts = [] if near is None else [(start, offsets)]
        if afresh:
            maps, offsets = self.forgiving_start
            start = np.concatenate([maps, parameters])
            with suppress(RolloutError, np.linalg.LinAlgError):
                first = fit(
                    self._forgiving(prior), start[None], prior_mean=mean[None], offsets=offsets[None],
                    iterations=forgiving,
                )  # fmt: skip
                starts.append((first.z[0], first.offsets[0]))
        if len(starts) > 1:
            with suppress(RolloutError, np.linalg.LinAlgError):
                return _fitted(effects, likelihood, starts, mean, iterations, worth=worth)
        # One of them cannot be computed, but perhaps the other.
        found: list[Fitted] = []
        for one in starts:
            with suppress(RolloutError, np.linalg.LinAlgError):
                found.append(_fitted(effects, likelihood, [one], mean, iterations, worth=worth))
        return min(found, key=lambda fitted: fitted.cost, default=None)

    def from_maps_of(self, near: Fitted, effect: Effect, starts: FloatArray, worth: float) -> Fitted:
        """Fit the model with one effect, starting from the maps of a fit with another one.

        Args:
            starts: (G, P) parameters to start from; those that lead farthest in a few steps are followed.
            worth: cost above which a fit is useless, and may be given up before its end.

        Raises:
            RolloutError: no start can be computed.
        """
        prior = self.prior((effect,))
        likelihood = CorrelatedLikelihood(prior, self.measured, near.likelihood.error)
        tried = np.concatenate([effect.with_far_starts(values) for values in starts])
        z = np.concatenate(
            [np.tile(near.z[: prior.plain], (len(tried), 1)), prior.effect_coordinates(tried)], axis=1
        )
        shaping = np.concatenate([np.zeros(prior.plain, dtype=bool), ~effect.amplitudes])
        mean = np.where(shaping, z, 0.0)
        offsets = np.repeat(near.offsets[None], len(z), axis=0)
        first = fit(likelihood, z, prior_mean=mean, offsets=offsets, iterations=_STEPS_TO_CHOOSE)
        ahead = np.argsort(first.cost, kind="stable")[:_FOLLOWED]
        return _fitted(
            (effect,), likelihood, [(first.z[k], first.offsets[k]) for k in ahead], mean[ahead],
            iterations=30, worth=worth,
        )  # fmt: skip

    def scene(self, base: Fitted) -> Scene:
        """The scene from which effects derive their starting values, given a fit without effects."""
        return scene_of(self.observations, [self.dataset.grid], self._weight_of(base))

    def _weight_of(self, base: Fitted) -> float:
        """Weight of the object in a fit, N."""
        return float(base.likelihood.prior.maps(base.z[None]).mass.sum()) * self.dataset.gravity


def _fitted(
    effects: tuple[Effect, ...],
    likelihood: CorrelatedLikelihood,
    starts: Sequence[tuple[FloatArray, FloatArray]],
    mean: FloatArray,
    iterations: int,
    tolerance: float = 2e-4,
    worth: float = np.inf,
    progress: StageProgress | None = None,
) -> Fitted:
    """The best fit from several starts, each coordinates (d,) and start offsets (B, 3).

    Args:
        mean: centre of the prior, (d,), or (K, d) one for each start.

    Raises:
        IndexError: there is no start.
    """
    z, offsets = (np.array(parts) for parts in zip(*starts, strict=True))
    means = np.broadcast_to(mean, z.shape)
    found = fit(
        likelihood, z, prior_mean=means, offsets=offsets,
        iterations=iterations, tolerance=tolerance, worth=worth, progress=progress,
    )  # fmt: skip
    k = int(np.argmin(found.cost))
    return Fitted(effects, likelihood, found.z[k], means[k], found.offsets[k], float(found.cost[k]))


MOTION_ERRORS = (0.006, 0.01, 0.016, 0.025, 0.04, 0.06, 0.1, 0.16, 0.25)
"""Values of α to choose from; no cell grid is better than the first, however good the sensors."""

_FORCE_ERRORS = (0.02, 0.04, 0.08, 0.16, 0.32)
"""Values of β to choose from."""


def estimate_errors(fitted: Fitted, noise: SensorNoise) -> ErrorModel:
    """The error model under which left-out pushes are most probable, with α and β from a grid."""
    data = fitted.likelihood.measured
    rows = fitted.likelihood.rows(fitted.z, fitted.offsets)
    prior = fitted.likelihood.prior
    columns, precision = np.arange(prior.size), np.ones(prior.size)
    pull = fitted.z - fitted.prior_mean

    @cache
    def score(motion: float, force: float) -> float:
        likelihood = CorrelatedLikelihood(prior, data, ErrorModel(noise, motion, force))
        jacobians, residuals = whitened_rows(likelihood, rows, fitted.offsets)
        equations = PushEquations.of(jacobians, [r[:, None] for r in residuals])
        own = equations.scores(columns, precision, pull)[0][:, 0]
        return float(own.sum()) - log_determinant(likelihood, rows)

    motion, force = fitted.likelihood.error.motion, fitted.likelihood.error.force
    for _ in range(2):
        motion = max(MOTION_ERRORS, key=lambda value: score(value, force))
        if any(o.sliding.any() for o in data.observations):
            force = max(_FORCE_ERRORS, key=lambda value: score(motion, value))
    return ErrorModel(noise, motion, force)
