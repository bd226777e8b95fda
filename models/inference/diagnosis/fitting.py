"""Fits of the model with some effects to the open pushes of a dataset.

Around its optimum a model is linear in its coordinates z: whitened residuals r_b + J_b z of push b, prior z
~ N(0, 1/Λ). With N_b = J_bᵀJ_b, H = Λ + Σ N_b, the best z and the residuals ê_b there, the density of push
b given all the others needs no refit:

    log p(r_b | others) = ½ log det(1 - J_b H⁻¹ J_bᵀ) - ½ (|ê_b|² + (J_bᵀê_b)ᵀ (H - N_b)⁻¹ (J_bᵀê_b)) + const.

Its sum over pushes is the score. All of it follows from N_b, J_bᵀr_b and |r_b|² of each push, so that a
candidate costs one small factorisation a push, for the data and for many simulated data at once. A push is
left out as a whole: what repeats within it is no evidence.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from slipmap.models.effects.effect import Effect, Scene
from slipmap.models.effects.slider import EffectSlider
from slipmap.models.inference.diagnosis.correlated import (
    CorrelatedLikelihood,
    ErrorModel,
    MeasuredPushes,
    PushRows,
    SensorNoise,
)
from slipmap.models.inference.gauss_newton import fit
from slipmap.models.inference.likelihood import Likelihood, LikelihoodSettings
from slipmap.models.inference.observations import MEASURED_CONTACT, Observation
from slipmap.models.inference.prior import MapPrior, PriorSettings
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import RolloutError, Slider

# How well a linearised model predicts pushes that it was not fitted to, and by how much candidates help.


def whitened_rows(
    likelihood: CorrelatedLikelihood, rows: Sequence[PushRows]
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Whitened Jacobians (R_b, d) and residuals (R_b,) of each push, its unknown start counted as noise."""
    jacobians, residuals = [], []
    for b, push in enumerate(rows):
        columns = np.concatenate([push.pose_slopes, push.pose[..., None]], axis=-1)
        forces = np.concatenate([push.force_slopes, push.force[..., None]], axis=-1)
        white = likelihood.whiteners[b](columns, forces)
        start = white[:, -4:-1] * likelihood.start_sigma[b]
        factor = np.linalg.cholesky(np.eye(len(white)) + start @ start.T)
        rest = np.concatenate([white[:, :-4], white[:, -1:]], axis=1)
        rest = scipy.linalg.solve_triangular(factor, rest, lower=True, check_finite=False)
        jacobians.append(rest[:, :-1])
        residuals.append(rest[:, -1])
    return jacobians, residuals


def log_determinant(likelihood: CorrelatedLikelihood, rows: Sequence[PushRows]) -> float:
    """Log of the determinant of all that residuals were whitened with: to compare scores of two error
    models."""
    total = 0.0
    for b, push in enumerate(rows):
        start = likelihood.whiteners[b](push.pose_slopes[..., -3:], push.force_slopes[..., -3:])
        start = start * likelihood.start_sigma[b]
        total += (
            likelihood.whiteners[b].log_determinant + 0.5 * np.linalg.slogdet(np.eye(3) + start.T @ start)[1]
        )
    return total


@dataclass(frozen=True, eq=False)
class PushEquations:
    """Normal equations of each push for D sets of residuals.

    Attributes:
        normal: (B, d, d) N_b.
        slope: (B, d, D) J_bᵀ r_b.
        square: (B, D) |r_b|².
    """

    normal: FloatArray
    slope: FloatArray
    square: FloatArray

    @classmethod
    def of(cls, jacobians: Sequence[FloatArray], residuals: Sequence[FloatArray]) -> PushEquations:
        """From whitened Jacobians (R_b, d) and residuals (R_b, D)."""
        return cls(
            np.array([J.T @ J for J in jacobians]),
            np.array([J.T @ r for J, r in zip(jacobians, residuals, strict=True)]),
            np.array([(r**2).sum(axis=0) for r in residuals]),
        )

    def scores(
        self, columns: NDArray[np.int64], precision: FloatArray, pull: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Score of each push for a model with some of the columns.

        Args:
            columns: (c,) which.
            precision: (c,) diagonal of Λ.
            pull: (c,) gradient of the prior at the optimum, added for the first set of residuals alone:
                there the data and the prior hold each other.
        """
        normal = self.normal[:, columns[:, None], columns]
        slope = self.slope[:, columns]
        total = slope.sum(axis=0)
        if pull is not None:
            total = total.copy()
            total[:, 0] += pull
        hessian = np.diag(precision) + normal.sum(axis=0)
        factor = scipy.linalg.cho_factor(hessian, check_finite=False)
        whole = float(np.log(np.diagonal(factor[0])).sum())
        best = -scipy.linalg.cho_solve(factor, total, check_finite=False)
        result = np.empty(self.square.shape)
        for b in range(len(result)):
            moved = normal[b] @ best
            error_slope = slope[b] + moved
            square = self.square[b] + (best * (slope[b] + error_slope)).sum(axis=0)
            others = np.linalg.cholesky(hessian - normal[b])
            extra = scipy.linalg.solve_triangular(others, error_slope, lower=True, check_finite=False)
            left = float(np.log(np.diagonal(others)).sum())
            result[b] = left - whole - 0.5 * (square + (extra**2).sum(axis=0))
        return result, best


MODES = 20
"""Coordinates of each map; the finest ones cannot be told from noise and cost time."""

FINGER_STARTS = (0.12, 0.35, 1.0)

FIRST_ERRORS = (0.02, 0.08)

MOTION_ERRORS = (0.006, 0.01, 0.016, 0.025, 0.04, 0.06, 0.1, 0.16, 0.25)
"""α to choose from; no cell grid is better than the first, however good the sensors are."""

FORCE_ERRORS = (0.02, 0.04, 0.08, 0.16, 0.32)
"""β to choose from."""

Progress = Callable[[int, int], None]
"""Called with (done, total)."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """One fitted model.

    Attributes:
        effects: that it has.
        likelihood: that was fitted, with its prior and error model.
        z: (d,) coordinates.
        prior_mean: (d,) where the prior was centred.
        offsets: (B, 3) starts of the pushes.
        cost: that was reached.
    """

    effects: tuple[Effect, ...]
    likelihood: CorrelatedLikelihood
    z: FloatArray
    prior_mean: FloatArray
    offsets: FloatArray
    cost: float

    @property
    def standard_deviations(self) -> FloatArray:
        """(P,) of the parameters, everything else being refitted with them."""
        prior = self.likelihood.prior
        if not self.effects:
            return np.zeros(0)
        equations = self.likelihood.linearise(
            self.z[None], self.offsets[None], np.ones(1), np.ones((1, len(self.offsets)))
        )
        covariance = np.linalg.inv(equations.hessian[0] + np.eye(prior.size))
        return np.sqrt(np.diagonal(covariance)[prior.plain :]) * prior.effect_scales

    @property
    def values(self) -> FloatArray:
        """(P,) parameters of the effects."""
        return self.likelihood.prior.maps(self.z[None]).effects[0]


class Fitter:
    """Fits models to the same open pushes.

    Args:
        dataset: what was measured.
        observations: the open pushes.
        noise: of the sensors.
    """

    def __init__(self, dataset: PushDataset, observations: Sequence[Observation], noise: SensorNoise) -> None:
        self.dataset = dataset
        self.measured = MeasuredPushes(observations, dataset.grid)
        self.observations = self.measured.observations
        self.noise = noise
        self.settings = PriorSettings(modes=MODES)
        self.weight: float | None = None
        self.forgiving_start: tuple[FloatArray, FloatArray]

    def prior(self, effects: Sequence[Effect]) -> MapPrior:
        """Coordinates of the model with some effects."""
        d = self.dataset
        slider = (
            EffectSlider(d.grid, d.finger_radius, effects, d.gravity, MEASURED_CONTACT)
            if effects
            else Slider(d.grid, d.finger_radius, d.gravity, MEASURED_CONTACT)
        )
        return MapPrior(slider, self.settings, d.mass, self.weight)

    def base(self, error: ErrorModel, start: Fitted, progress: Progress | None = None) -> Fitted:
        """Fit the model without effects, from the maps of another fit."""
        prior = self.prior(())
        likelihood = CorrelatedLikelihood(prior, self.measured, error)
        # Gains are counted from here: what the search leaves undone would be taken for an effect.
        return _best(
            (), likelihood, start.z[None, : prior.size], np.zeros((1, prior.size)), start.offsets,
            iterations=80, tolerance=1e-5, progress=progress,
        )  # fmt: skip

    def from_scratch(self, progress: Progress | None = None) -> Fitted:
        """Fit the model without effects, and the error model with it; tells what the object weighs.

        `progress` is called with (done, total).

        The forgiving likelihood of the identification comes first: it finds the valley, where the strict one,
        with its many correlated rows, gets stuck on the way. What it leaves sets the first error model.
        """
        prior = self.prior(())
        starts = np.array([prior.start(friction) for friction in FINGER_STARTS])
        report = progress or (lambda done, total: None)

        def part(number: int) -> Progress:
            return lambda done, total: report(number * total + done, 3 * total)

        first = fit(self._forgiving(prior), starts, progress=part(0)).best()
        self.forgiving_start = first.z[0], first.offsets[0]
        likelihood = CorrelatedLikelihood(prior, self.measured, ErrorModel(self.noise, *FIRST_ERRORS))
        fitted = Fitted((), likelihood, first.z[0], np.zeros(prior.size), first.offsets[0], np.inf)
        for number in (1, 2):
            fitted = self.base(estimate_errors(fitted, self.noise), fitted, part(number))
        self.weight = self._weight_of(fitted)
        return fitted

    def _forgiving(self, prior: MapPrior) -> Likelihood:
        return Likelihood(prior, self.observations, self.dataset.noise, LikelihoodSettings())

    def with_effects(
        self,
        effects: Sequence[Effect],
        error: ErrorModel,
        near: Fitted | None,
        values: FloatArray,
        *,
        afresh: bool = False,
        iterations: int = 30,
        forgiving: int = 25,
    ) -> Fitted | None:
        """Fit the model with some effects.

        Args:
            effects: that it has.
            error: error model.
            near: fit to start from; None to start afresh alone.
            values: (P,) parameters to start from.
            afresh: start a second time from where the forgiving likelihood leads: a model that lacks the
                effect may have bent its maps too far to find back.
            iterations: most that each search may take.
            forgiving: most that the search under the forgiving likelihood may take.

        Returns:
            The better fit, or None where none can be computed.
        """
        prior = self.prior(effects)
        likelihood = CorrelatedLikelihood(prior, self.measured, error)
        plain = prior.plain
        shaping = np.concatenate([np.zeros(plain, dtype=bool), *(~effect.amplitudes for effect in effects)])
        maps, offsets = self.forgiving_start if near is None else (near.z, near.offsets)
        start = np.concatenate([maps[:plain], prior.effect_coordinates(values)])
        mean = np.where(shaping, start, 0.0)
        found: list[Fitted] = []
        with suppress(RolloutError, np.linalg.LinAlgError):
            if near is not None:
                found.append(
                    _best(tuple(effects), likelihood, start[None], mean[None], near.offsets, iterations)
                )
        if afresh:
            maps, offsets = self.forgiving_start
            start = np.concatenate([maps, prior.effect_coordinates(values)])
            with suppress(RolloutError, np.linalg.LinAlgError):
                first = fit(
                    self._forgiving(prior), start[None], prior_mean=mean[None], offsets=offsets[None],
                    iterations=forgiving,
                )  # fmt: skip
                found.append(
                    _best(tuple(effects), likelihood, first.z, mean[None], first.offsets[0], iterations)
                )
        return min(found, key=lambda fitted: fitted.cost, default=None)

    def scene(self, base: Fitted) -> Scene:
        """What effects have to know to begin their search, from a fit of the model without effects."""
        poses = np.concatenate([o.poses for o in self.observations])[:, :2]
        center = 0.5 * (poses.min(axis=0) + poses.max(axis=0))
        return Scene(
            (float(center[0]), float(center[1])),
            float(np.abs(poses - center).max()),
            float(np.linalg.norm(self.dataset.grid.exterior, axis=1).max()),
            _typical_speed(self.observations),
            len(self.observations),
            self._weight_of(base),
        )

    def _weight_of(self, base: Fitted) -> float:
        """N."""
        return float(base.likelihood.prior.maps(base.z[None]).mass.sum()) * self.dataset.gravity


def _typical_speed(observations: Sequence[Observation]) -> float:
    """Median over pushes of the finger's mean speed while it moves, m/s."""
    speeds = []
    for o in observations:
        speed = np.hypot(*np.diff(o.push.tip, axis=0).T) / o.push.h
        moving = speed[np.isfinite(speed) & (speed > 1e-3)]
        if len(moving):
            speeds.append(float(moving.mean()))
    return float(np.median(speeds)) if speeds else 0.05


def _best(
    effects: tuple[Effect, ...],
    likelihood: CorrelatedLikelihood,
    starts: FloatArray,
    mean: FloatArray,
    offsets: FloatArray | None,
    iterations: int = 30,
    tolerance: float = 2e-4,
    progress: Progress | None = None,
) -> Fitted:
    shifts = None if offsets is None else np.repeat(offsets[None], len(starts), axis=0)
    fits = fit(
        likelihood, starts, prior_mean=mean, offsets=shifts, iterations=iterations, tolerance=tolerance,
        progress=progress,
    )  # fmt: skip
    k = int(np.argmin(fits.cost))
    return Fitted(effects, likelihood, fits.z[k], mean[k], fits.offsets[k], float(fits.cost[k]))


def estimate_errors(fitted: Fitted, noise: SensorNoise) -> ErrorModel:
    """The error model under which pushes left out are most probable, α and β on a grid."""
    rows = fitted.likelihood.rows(fitted.z, fitted.offsets)
    prior = fitted.likelihood.prior
    columns = np.arange(prior.size)
    pull = fitted.z - fitted.prior_mean

    @cache
    def score(motion: float, force: float) -> float:
        likelihood = CorrelatedLikelihood(prior, fitted.likelihood.measured, ErrorModel(noise, motion, force))
        jacobians, residuals = whitened_rows(likelihood, rows)
        # A push that the model misses badly should not set the scale for all others.
        equations = PushEquations.of(jacobians, [r[:, None] for r in residuals])
        own = equations.scores(columns, np.ones(prior.size), pull)[0][:, 0]
        return float(own.sum()) - log_determinant(likelihood, rows)

    old = fitted.likelihood.error
    has_force = any(o.sliding.any() for o in fitted.likelihood.observations)
    motion, force = old.motion, old.force
    for _ in range(2):
        motion = max(MOTION_ERRORS, key=lambda value: score(value, force))
        if has_force:
            force = max(FORCE_ERRORS, key=lambda value: score(motion, value))
    return ErrorModel(noise, motion, force)
