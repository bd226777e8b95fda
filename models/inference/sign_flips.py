"""Tests whose unit of evidence is the push: sign flips of whole pushes, and Holm's correction.

Residuals along a push are correlated, so samples are not independent evidence. A test sums, for each push b,
the scores g_b = Σ_i φ(x_i) y_i of residuals y_i on features φ of their conditions x_i. If there is only
chance, the residuals of a whole push could equally well have had the opposite sign, whatever their
correlation within the push. Hence the distribution of

    max_j |Σ_b g_bj| / √(Σ_b g_bj²)

under random signs of whole pushes gives its p-value, without any assumption about correlation or variance
within pushes (sign-flipping score test; Hemerik, Goeman and Finos, 2020). The maximum over coordinates j
accounts for their number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.cell_grid import FloatArray

_FLIPS = 9999
_EXHAUSTIVE = 12
"""Up to this many pushes, all patterns of signs are tried."""


@dataclass(frozen=True, eq=False)
class SignFlipTest:
    """Result of one test."""

    z: FloatArray  # (d,) standardised sum of each coordinate
    p: float  # probability of a maximum as large by chance alone

    @property
    def strongest(self) -> int:
        """Index of the coordinate that deviates most."""
        return int(np.argmax(np.abs(self.z)))


def sign_flip_test(scores: FloatArray, rng: np.random.Generator, flips: int = _FLIPS) -> SignFlipTest:
    """Test scores (B, d) of B pushes against sign flips of whole pushes."""
    scores = scores[(scores != 0).any(axis=1)]
    B, d = scores.shape
    scale = np.sqrt((scores**2).sum(axis=0))
    if B == 0 or not (scale > 0).any():
        return SignFlipTest(np.zeros(d), 1.0)
    scores = scores / np.where(scale > 0, scale, 1.0)
    z = scores.sum(axis=0)
    largest = np.abs(z).max()
    signs = all_signs(B) if B <= _EXHAUSTIVE else random_signs(flips, B, rng)
    beyond = int((np.abs(signs @ scores).max(axis=1) >= largest * (1 - 1e-9)).sum())
    # All patterns include the observed one; to random ones it has to be added for the test to be exact.
    p = beyond / len(signs) if B <= _EXHAUSTIVE else (1 + beyond) / (1 + len(signs))
    return SignFlipTest(z, float(p))


def all_signs(count: int) -> FloatArray:
    """(2^count, count) all patterns of signs."""
    bits = (np.arange(2**count)[:, None] >> np.arange(count)) & 1
    return np.where(bits == 1, -1.0, 1.0)


def random_signs(draws: int, count: int, rng: np.random.Generator) -> FloatArray:
    """(draws, count) random signs."""
    return np.where(rng.integers(0, 2, size=(draws, count)) == 1, -1.0, 1.0)


def smallest_p(pushes: int) -> float:
    """The smallest p-value that this many pushes can give: all signs equal, or all flipped."""
    if pushes == 0:
        return 1.0
    return 2.0 ** (1 - pushes) if pushes <= _EXHAUSTIVE else 1.0 / (_FLIPS + 1)


def holm(p: FloatArray) -> FloatArray:
    """(m,) p-values of m tests, corrected so that 5 % bounds the rate of any false alarm (Holm, 1979)."""
    p = np.asarray(p, dtype=float)
    order = np.argsort(p)
    steps = p[order] * np.arange(len(p), 0, -1)
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(steps))
    return corrected


def push_sums(rows: FloatArray, push: NDArray[np.int64], count: int) -> FloatArray:
    """(count, d) sums of rows (N, d) over each push."""
    sums = np.zeros((count, rows.shape[1]))
    np.add.at(sums, push, rows)
    return sums


def beyond(scores: FloatArray, power: FloatArray, slope: float) -> FloatArray:
    """Scores (B, d) minus those of a pattern of negligible size, so that a test finds only larger ones.

    Args:
        scores: (B, d) sums of feature times residual.
        power: (B, d) sums of squared features.
        slope: negligible slope. Coordinates with a smaller slope become 0.
    """
    total = scores.sum(axis=0)
    larger = np.abs(total) > slope * power.sum(axis=0)
    return np.where(larger, scores - np.sign(total) * slope * power, 0.0)
