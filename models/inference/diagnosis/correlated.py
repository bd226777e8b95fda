"""The strict likelihood: residuals and Jacobians of whole pushes, whitened by an `ErrorModel`.

In the forgiving one (`likelihood.py`) each pose counts separately, and little; here their correlation is
modelled, and all poses count.

A linearised model also predicts pushes that it was not fitted to. Around its optimum it is linear in its
coordinates z: push b has whitened residuals r_b + J_b z, and the prior is z ~ N(0, 1/Λ). With N_b = J_bᵀJ_b,
s_b = J_bᵀr_b, H = Λ + Σ N_b and s = Σ s_b, the density of push b given all others needs no refit:

    log p(r_b | others) = log p(r) - log p(others)
        = ½ (log det(H - N_b) - log det H + sᵀ H⁻¹ s - (s - s_b)ᵀ (H - N_b)⁻¹ (s - s_b) - |r_b|²)

up to a constant. Its sum over pushes is the predictive score. It depends only on N_b, s_b and |r_b|² of each
push, so a candidate costs one small factorisation per push, for the data and for many simulated datasets at
once. Pushes are left out as a whole, since repetition within a push is not evidence.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from slipmap.models.geometry import radius_of_gyration
from slipmap.models.inference.error_model import ErrorModel, SensorNoise, travelled
from slipmap.models.inference.likelihood import Alike, DrawnErrors, PushLikelihood, huber, overflowing
from slipmap.models.inference.observations import AVERAGED, Observation
from slipmap.models.inference.prior import MapPrior
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Push


@dataclass(frozen=True, eq=False)
class Whitener:
    """Inverse Cholesky factors of the covariances of one push, or of G pushes of one size."""

    pose: FloatArray  # (3, S, S) or (G, 3, S, S), of x, y and ρ θ
    force: FloatArray  # (T, T) or (G, T, T), of one component of the forces that count
    log_determinant: float  # log determinant of the Cholesky factors, which normalises densities

    def __call__(self, pose: FloatArray, force: FloatArray) -> FloatArray:
        """Whiten columns of residuals or derivatives: (…, S, 3, c) and (…, T, 2, c) to (…, 3 S + 2 T, c).

        Where there are several pushes, … ends with G.
        """
        parts = [self.pose[..., i, :, :] @ pose[..., i, :] for i in range(3)]
        if force.shape[-3]:
            parts += [self.force @ force[..., i, :] for i in range(2)]
        return np.concatenate(parts, axis=-2)


class FitData:
    """Data shared by all fits to the same pushes: which forces count, and how residuals are whitened.

    Args:
        observations: B pushes.

    Attributes:
        observations: the same.
        pushes: to roll out, with the times of all forces that count.
        radius: ρ of the object's cells, m.
    """

    def __init__(self, observations: Sequence[Observation], grid: CellGrid) -> None:
        self.observations: Sequence[Observation] = list(observations)
        self.pushes: list[Push] = [observation.counted for observation in self.observations]
        self.radius = radius_of_gyration(grid)
        self._travel = [travelled(o, grid.centers) for o in self.observations]
        self._kept: dict[tuple[str, SensorNoise, float], list[tuple[FloatArray, float]]] = {}

    @cached_property
    def with_long_steps(self) -> FitData:
        """The same pushes with steps twice as long. Whiteners are shared: they do not depend on the steps."""
        other = copy(self)
        other.observations = [observation.with_long_steps for observation in self.observations]
        other.pushes = [observation.counted for observation in other.observations]
        return other

    def whiteners(self, error: ErrorModel) -> list[Whitener]:
        """Whiteners of all pushes; results for an α or a β are cached."""
        poses = self._once(
            ("pose", error.noise, error.motion),
            lambda b: error.pose_covariance(self.observations[b], self._travel[b], self.radius),
        )
        forces = self._once(
            ("force", error.noise, error.force), lambda b: error.force_covariance(self.observations[b])[None]
        )
        return [
            Whitener(pose, force[0], own + 2.0 * other)
            for (pose, own), (force, other) in zip(poses, forces, strict=True)
        ]

    def _once(
        self, key: tuple[str, SensorNoise, float], covariance: Callable[[int], FloatArray]
    ) -> list[tuple[FloatArray, float]]:
        if key not in self._kept:
            self._kept[key] = [_inverse_factors(covariance(b)) for b in range(len(self.observations))]
        return self._kept[key]


def _inverse_factors(covariances: FloatArray) -> tuple[FloatArray, float]:
    """Inverse lower Cholesky factors (k, S, S) of covariances, and the log of the factors' determinants."""
    if covariances.size == 0:
        return covariances, 0.0
    factors = np.linalg.cholesky(covariances)
    unit = np.eye(covariances.shape[-1])
    inverses = np.array(
        [scipy.linalg.solve_triangular(factor, unit, lower=True, check_finite=False) for factor in factors]
    )
    return inverses, float(np.log(np.diagonal(factors, axis1=-2, axis2=-1)).sum())


@dataclass(frozen=True, eq=False)
class Linearised:
    """Residuals of one push under one model, and their derivatives, not whitened."""

    pose: FloatArray  # (S, 3) predicted minus measured, (dx, dy, ρ dθ) at the cells' centroid, m
    pose_slopes: FloatArray  # (S, 3, d + 3) derivatives with respect to coordinates and start
    force: FloatArray  # (T, 2) predicted minus measured force where it counts, N
    force_slopes: FloatArray  # (T, 2, d + 3)

    def by(self, columns: NDArray[np.int64]) -> Linearised:
        """The same with derivatives with respect to some coordinates (c,) and the start only."""
        chosen = np.append(columns, np.arange(-3, 0))
        return Linearised(
            self.pose, self.pose_slopes[..., chosen], self.force, self.force_slopes[..., chosen]
        )

    def whitened(self, whitener: Whitener) -> FloatArray:
        """(3 S + 2 T, d + 4) whitened derivatives and, in the last column, residuals."""
        return whitener(
            np.concatenate([self.pose_slopes, self.pose[..., None]], axis=-1),
            np.concatenate([self.force_slopes, self.force[..., None]], axis=-1),
        )


class CorrelatedLikelihood(PushLikelihood):
    """Costs of K hypotheses, in the prior's coordinates of maps and effects, against B pushes under an
    `ErrorModel`."""

    def __init__(self, prior: MapPrior, measured: FitData, error: ErrorModel) -> None:
        noise = error.noise
        # Where the object rests at first, the start is a mean of many rows; limit these, as it may settle.
        start_rows = np.minimum([o.start_rows for o in measured.observations], AVERAGED)
        super().__init__(
            prior, measured.observations, measured.pushes, noise.of_means(start_rows), noise.outline
        )
        self.measured = measured
        self.error = error
        self.whiteners = measured.whiteners(error)

    def rows(self, z: FloatArray, offsets: FloatArray) -> list[Linearised]:
        """Residuals and derivatives of one hypothesis z (d,) with start offsets (B, 3), for all pushes."""
        maps = self.prior.maps(z[None])
        columns = self.prior.columns(maps)
        found: dict[int, Linearised] = {}
        for alike in self._rolled_out(maps, offsets[None], columns, convert=True):
            (pose, pose_slopes), force = self._pose_errors(alike), self._force_errors(alike)
            for place, b in enumerate(alike.pushes.tolist()):
                T = len(self._pushes[b].force_times)
                found[b] = Linearised(
                    pose[0, place], pose_slopes[0, place], force[0, place, :T], alike.d_forces[0, place, :T]
                )
        return [found[b] for b in range(len(self.observations))]

    def _whitened(
        self, alike: Alike, errors: DrawnErrors | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        assert errors is None  # hypotheses assume errors under the forgiving likelihood alone
        (pose, pose_slopes), force = self._pose_errors(alike), self._force_errors(alike)
        own = [self.whiteners[b] for b in alike.pushes]
        T = force.shape[2]
        of_force = np.zeros((len(own), T, T))
        for place, one in enumerate(own):
            of_force[place, : len(one.force), : len(one.force)] = one.force
        whitener = Whitener(np.stack([one.pose for one in own]), of_force, 0.0)
        J = whitener(pose_slopes, alike.d_forces)
        r = whitener(pose[..., None], force[..., None])[..., 0]
        rows = 3 * pose.shape[2] + 2 * np.array([len(one.force) for one in own])
        square = (r**2).sum(axis=-1)
        weight, cost = huber(np.sqrt(square), square, _OUTLIER * np.sqrt(rows))
        root = np.sqrt(weight)[..., None]
        return J * root[..., None], r * root, cost


_OUTLIER = 2.5
"""Pushes whose whitened residuals exceed this root mean square count linearly (Huber)."""


# The predictive score.


@overflowing()
def whitened_rows(
    likelihood: CorrelatedLikelihood, rows: Sequence[Linearised], offsets: FloatArray
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Whitened Jacobians (R_b, d) and residuals (R_b,) of each push, with its unknown start as noise.

    Args:
        rows: of each push, at its start offset.
        offsets: (B, 3) these offsets. As noise, a start has mean zero, so they are taken out of the residuals
            to first order.
    """
    jacobians, residuals = [], []
    for b, push in enumerate(rows):
        white = push.whitened(likelihood.whiteners[b])
        start = white[:, -4:-1] * likelihood.start_sigma[b]
        factor = np.linalg.cholesky(np.eye(len(white)) + start @ start.T)
        at_zero = white[:, -1] - white[:, -4:-1] @ offsets[b]
        rest = np.concatenate([white[:, :-4], at_zero[:, None]], axis=1)
        rest = scipy.linalg.solve_triangular(factor, rest, lower=True, check_finite=False)
        jacobians.append(rest[:, :-1])
        residuals.append(rest[:, -1])
    return jacobians, residuals


def log_determinant(likelihood: CorrelatedLikelihood, rows: Sequence[Linearised]) -> float:
    """Log determinant of the whitening of all residuals, needed to compare scores of two error models."""
    total = 0.0
    for whitener, sigma, push in zip(likelihood.whiteners, likelihood.start_sigma, rows, strict=True):
        start = whitener(push.pose_slopes[..., -3:], push.force_slopes[..., -3:]) * sigma
        total += whitener.log_determinant + 0.5 * np.linalg.slogdet(np.eye(3) + start.T @ start)[1]
    return total


@dataclass(frozen=True, eq=False)
class PushEquations:
    """Normal equations of each push for D sets of residuals."""

    normal: FloatArray  # (B, d, d) N_b
    slope: FloatArray  # (B, d, D) J_bᵀ r_b
    square: FloatArray  # (B, D) |r_b|²

    @classmethod
    @overflowing()
    def of(cls, jacobians: Sequence[FloatArray], residuals: Sequence[FloatArray]) -> PushEquations:
        """Form the equations from whitened Jacobians (R_b, d) and residuals (R_b, D)."""
        return cls(
            np.array([J.T @ J for J in jacobians]),
            np.array([J.T @ r for J, r in zip(jacobians, residuals, strict=True)]),
            np.array([(r**2).sum(axis=0) for r in residuals]),
        )

    @overflowing()
    def scores(
        self, columns: NDArray[np.int64], precision: FloatArray, pull: FloatArray | float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Score (B, D) of each push for a model with some of the columns, and its best coordinates (c, D).

        Args:
            columns: (c,) indices of the columns.
            precision: (c,) diagonal of Λ.
            pull: (c,) gradient of the prior at the optimum, added only for the first set of residuals, where
                it balances the data.
        """
        normal = self.normal[:, columns[:, None], columns]
        slope = self.slope[:, columns]
        total = slope.sum(axis=0)
        total[:, 0] += pull
        hessian = np.diag(precision) + normal.sum(axis=0)
        explained, whole, factor = _explained(hessian, total)
        best = -scipy.linalg.cho_solve((factor, True), total, check_finite=False)
        result = explained - whole - 0.5 * self.square
        for b, own in enumerate(normal):
            by_others, left, _ = _explained(hessian - own, total - slope[b])
            result[b] += left - by_others
        return result, best


def _explained(hessian: FloatArray, slope: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """½ sᵀ H⁻¹ s for each column of slopes (c, D), ½ log det H, and the lower Cholesky factor of H (c, c)."""
    factor = np.asarray(np.linalg.cholesky(hessian), dtype=np.float64)
    white: FloatArray = scipy.linalg.solve_triangular(factor, slope, lower=True, check_finite=False)
    return 0.5 * (white**2).sum(axis=0), float(np.log(np.diagonal(factor)).sum()), factor
