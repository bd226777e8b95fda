"""How well a linearised model predicts pushes that it was not fitted to.

Around its optimum a model is linear in its coordinates z: whitened residuals r_b + J_b z of push b, prior z
~ N(0, 1/Λ). With N_b = J_bᵀJ_b, H = Λ + Σ N_b, the best z and the residuals ê_b there, the density of push
b given all the others needs no refit:

    log p(r_b | others) = ½ log det(1 - J_b H⁻¹ J_bᵀ) - ½ (|ê_b|² + (J_bᵀê_b)ᵀ (H - N_b)⁻¹ (J_bᵀê_b)) + const.

Its sum over pushes is the score. All of it follows from N_b, J_bᵀr_b and |r_b|² of each push, so that a
candidate costs one small factorisation a push, for the data and for many simulated data at once. A push is
left out as a whole: what repeats within it is no evidence. A push of few rows is cheaper by these rows:

    log p(r_b | others) = ½ log det(1 - G_b) - ½ ê_bᵀ (1 - G_b)⁻¹ ê_b + const.,   G_b = J_b H⁻¹ J_bᵀ.

Several datasets that share some coordinates tell each other, as a normal equation for these, what is left
when each has eliminated its own (`told`): to the pushes of one, the others are a richer prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from slipmap.models.inference.diagnosis.correlated import CorrelatedLikelihood, Linearised
from slipmap.models.physics.cell_grid import FloatArray


def whitened_rows(
    likelihood: CorrelatedLikelihood, rows: Sequence[Linearised]
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Whitened Jacobians (R_b, d) and residuals (R_b,) of each push, its unknown start counted as noise."""
    jacobians, residuals = [], []
    for b, push in enumerate(rows):
        white = push.whitened(likelihood.whiteners[b])
        start = white[:, -4:-1] * likelihood.start_sigma[b]
        factor = np.linalg.cholesky(np.eye(len(white)) + start @ start.T)
        rest = np.concatenate([white[:, :-4], white[:, -1:]], axis=1)
        rest = scipy.linalg.solve_triangular(factor, rest, lower=True, check_finite=False)
        jacobians.append(rest[:, :-1])
        residuals.append(rest[:, -1])
    return jacobians, residuals


def log_determinant(likelihood: CorrelatedLikelihood, rows: Sequence[Linearised]) -> float:
    """Log of the determinant of all that residuals were whitened with: to compare scores of two error
    models."""
    total = 0.0
    for whitener, sigma, push in zip(likelihood.whiteners, likelihood.start_sigma, rows, strict=True):
        start = whitener(push.pose_slopes[..., -3:], push.force_slopes[..., -3:]) * sigma
        total += whitener.log_determinant + 0.5 * np.linalg.slogdet(np.eye(3) + start.T @ start)[1]
    return total


Told = tuple[FloatArray, FloatArray]
"""Normal matrix (s, s) and right-hand sides (s, D) for coordinates that datasets share."""

_FEW_ROWS = 12
"""A push with fewer rows is left out by its rows."""


@dataclass(frozen=True, eq=False)
class _Push:
    """One push for D sets of residuals."""

    jacobian: FloatArray  # (R, d) J_b
    residuals: FloatArray  # (R, D) r_b
    normal: FloatArray  # (d, d) N_b
    slope: FloatArray  # (d, D) J_bᵀ r_b
    square: FloatArray  # (D,) |r_b|²


@dataclass(frozen=True, eq=False)
class PushEquations:
    """Normal equations of each push for D sets of residuals."""

    pushes: list[_Push]  # without normal equations where rows are few
    normal: FloatArray  # (d, d) Σ N_b
    slope: FloatArray  # (d, D) Σ J_bᵀ r_b

    @classmethod
    def of(cls, jacobians: Sequence[FloatArray], residuals: Sequence[FloatArray]) -> PushEquations:
        """From whitened Jacobians (R_b, d) and residuals (R_b, D)."""
        d, D = jacobians[0].shape[1], residuals[0].shape[1]
        normal, slope = np.zeros((d, d)), np.zeros((d, D))
        pushes, none = [], np.zeros((0, 0))
        for J, r in zip(jacobians, residuals, strict=True):
            own, down = J.T @ J, J.T @ r
            normal += own
            slope += down
            few = len(J) < _FEW_ROWS
            pushes.append(_Push(J, r, none if few else own, none if few else down, (r**2).sum(axis=0)))
        return cls(pushes, normal, slope)

    def told(
        self, columns: NDArray[np.int64], precision: FloatArray, pull: FloatArray, shared: NDArray[np.bool_]
    ) -> Told:
        """What these pushes say of the shared ones among the columns, their own refitted.

        Args:
            columns, precision, pull: as of `scores`; those of shared columns do not count here.
            shared: (c,) which columns are shared.
        """
        normal, slope = self.normal[columns[:, None], columns], self.slope[columns].copy()
        slope[:, 0] += np.where(shared, 0.0, pull)
        own = ~shared
        factor = scipy.linalg.cho_factor(
            normal[np.ix_(own, own)] + np.diag(precision[own]), check_finite=False
        )
        across = normal[np.ix_(own, shared)]
        found = scipy.linalg.cho_solve(
            factor, np.concatenate([across, slope[own]], axis=1), check_finite=False
        )
        s = across.shape[1]
        return normal[np.ix_(shared, shared)] - across.T @ found[:, :s], slope[shared] - across.T @ found[
            :, s:
        ]

    def scores(
        self,
        columns: NDArray[np.int64],
        precision: FloatArray,
        pull: FloatArray | float = 0.0,
        others: tuple[NDArray[np.bool_], Told] | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Score (B, D) of each push for a model with some of the columns, and its best coordinates (c, D).

        Args:
            columns: (c,) which.
            precision: (c,) diagonal of Λ.
            pull: (c,) gradient of the prior at the optimum, added for the first set of residuals alone:
                there the data and the prior hold each other.
            others: which columns (c,) are shared with other datasets, and what those say of them.
        """
        total = self.slope[columns]
        total[:, 0] += pull
        hessian = np.diag(precision) + self.normal[columns[:, None], columns]
        if others is not None:
            shared, (normal, slope) = others
            hessian[np.ix_(shared, shared)] += normal
            total[shared] += slope
        factor = scipy.linalg.cho_factor(hessian, check_finite=False)
        whole = float(np.log(np.diagonal(factor[0])).sum())
        best = -scipy.linalg.cho_solve(factor, total, check_finite=False)
        result = np.empty((len(self.pushes), best.shape[1]))
        for b, push in enumerate(self.pushes):
            if len(push.jacobian) < _FEW_ROWS:
                J = push.jacobian[:, columns]
                kept = np.eye(len(J)) - J @ scipy.linalg.cho_solve(factor, J.T, check_finite=False)
                lower = np.linalg.cholesky(kept)
                miss = push.residuals + J @ best
                error = scipy.linalg.solve_triangular(lower, miss, lower=True, check_finite=False)
                result[b] = np.log(np.diagonal(lower)).sum() - 0.5 * (error**2).sum(axis=0)
                continue
            own, slope = push.normal[columns[:, None], columns], push.slope[columns]
            error_slope = slope + own @ best
            square = push.square + (best * (slope + error_slope)).sum(axis=0)
            rest = np.linalg.cholesky(hessian - own)
            extra = scipy.linalg.solve_triangular(rest, error_slope, lower=True, check_finite=False)
            left = float(np.log(np.diagonal(rest)).sum())
            result[b] = left - whole - 0.5 * (square + (extra**2).sum(axis=0))
        return result, best
