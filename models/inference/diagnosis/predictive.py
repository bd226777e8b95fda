"""Predictive score of a linearised model on pushes that it was not fitted to.

Around its optimum a model is linear in its coordinates z: push b has whitened residuals r_b + J_b z, and the
prior is z ~ N(0, 1/Λ). With N_b = J_bᵀJ_b, s_b = J_bᵀr_b, H = Λ + Σ N_b and s = Σ s_b, the density of push b
given all others needs no refit:

    log p(r_b | others) = log p(r) - log p(others)
        = ½ (log det(H - N_b) - log det H + sᵀ H⁻¹ s - (s - s_b)ᵀ (H - N_b)⁻¹ (s - s_b) - |r_b|²)

up to a constant. Its sum over pushes is the score. It depends only on N_b, s_b and |r_b|² of each push, so a
candidate costs one small factorisation per push, for the data and for many simulated datasets at once. Pushes
are left out as a whole, since repetition within a push is not evidence.
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
