"""Predictive score of a linearised model on pushes that it was not fitted to.

Around its optimum a model is linear in its coordinates z: push b has whitened residuals r_b + J_b z, and the
prior is z ~ N(0, 1/Λ). With N_b = J_bᵀJ_b, H = Λ + Σ N_b, the best z and the residuals ê_b there, the density
of push b given all others needs no refit:

    log p(r_b | others) = ½ log det(1 - J_b H⁻¹ J_bᵀ) - ½ (|ê_b|² + (J_bᵀê_b)ᵀ (H - N_b)⁻¹ (J_bᵀê_b)) + const.

Its sum over pushes is the score. It depends only on N_b, J_bᵀr_b and |r_b|² of each push, so a candidate
costs one small factorisation per push, for the data and for many simulated datasets at once. Pushes are left
out as a whole, since repetition within a push is not evidence.
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
    """Whitened Jacobians (R_b, d) and residuals (R_b,) of each push, with its unknown start as noise."""
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
    def of(cls, jacobians: Sequence[FloatArray], residuals: Sequence[FloatArray]) -> PushEquations:
        """Form the equations from whitened Jacobians (R_b, d) and residuals (R_b, D)."""
        return cls(
            np.array([J.T @ J for J in jacobians]),
            np.array([J.T @ r for J, r in zip(jacobians, residuals, strict=True)]),
            np.array([(r**2).sum(axis=0) for r in residuals]),
        )

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
        factor = scipy.linalg.cho_factor(hessian, check_finite=False)
        whole = float(np.log(np.diagonal(factor[0])).sum())
        best = -scipy.linalg.cho_solve(factor, total, check_finite=False)
        result = np.empty(self.square.shape)
        for b in range(len(result)):
            error_slope = slope[b] + normal[b] @ best
            square = self.square[b] + (best * (slope[b] + error_slope)).sum(axis=0)
            others = np.linalg.cholesky(hessian - normal[b])
            extra = scipy.linalg.solve_triangular(others, error_slope, lower=True, check_finite=False)
            left = float(np.log(np.diagonal(others)).sum())
            result[b] = left - whole - 0.5 * (square + (extra**2).sum(axis=0))
        return result, best
