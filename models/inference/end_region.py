"""Where a push may end if the model is right: a joint region of x, y and θ at any level.

Of three 90 % intervals, one per coordinate, at least one is missed by up to 27 % of pushes even if the model
is right. So all three are tested together. The region of a level is an ellipsoid around the mean m of the
hypotheses, with the covariance of the hypotheses plus all other errors,

    (q - m)ᵀ C⁻¹ (q - m) ≤ c,    C = S (1 + 1/n) + diag(σ²),

where S is the spread of n effective hypotheses and σ the error of model and tracker. n draws determine their
spread poorly; c is Hotelling's, with the degrees of freedom of the sum (Welch and Satterthwaite): those of S
where the spread of the hypotheses dominates, almost unlimited where σ does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, fdtri

from slipmap.models.physics.cell_grid import FloatArray

LEVEL = 0.95
"""Share of pushes that end inside if the model is right; those outside are called surprising."""

_MOST_FREEDOM = 1e6  # degrees of freedom; practically unlimited
_LEAST_FREEDOM = 1.0


@dataclass(frozen=True, eq=False)
class EndRegion:
    """Joint region of n numbers if the model is right; for the end of a push, x, y (m) and θ (rad).

    Example:
        >>> import numpy as np
        >>> from slipmap.models.inference.end_region import EndRegion
        >>> region = EndRegion.of(np.zeros((1, 3)), np.ones(1), np.array([1e-3, 1e-3, 0.01]))
        >>> region.holds(np.array([1e-3, 0.0, 0.0])), region.holds(np.array([5e-3, 0.0, 0.0]))
        (True, False)
    """

    middle: FloatArray  # (n,) the hypotheses' mean
    covariance: FloatArray  # (n, n) of all errors together
    freedom: float  # degrees of freedom of the covariance

    @classmethod
    def of(cls, draws: FloatArray, probability: FloatArray, sigma: FloatArray) -> EndRegion:
        """The region that follows from hypotheses and further errors.

        Args:
            draws: (K, n) one for each hypothesis; angles do not wrap.
            probability: (K,) of the hypotheses.
            sigma: (n,) standard deviations of all other errors.
        """
        n = draws.shape[1]
        effective = 1.0 / float(probability @ probability)
        middle = probability @ draws
        around = draws - middle
        spread = np.zeros((n, n))
        if effective > 1.0 + 1e-6:
            spread = around.T @ (around * probability[:, None])
            # With hardly more than one effective hypothesis, the spread is known no better than that of two.
            few = max(2.0, effective)
            spread *= few / (few - 1.0) * (1.0 + 1.0 / effective)
        # Keep the covariance regular where a number has no error.
        covariance = spread + np.diag(np.maximum(sigma, 1e-9) ** 2)
        of_hypotheses = float(np.trace(np.linalg.solve(covariance, spread))) / n
        own = max(effective - n, _LEAST_FREEDOM)
        freedom = own / max(of_hypotheses, 1e-9) ** 2
        return cls(middle, covariance, min(freedom, _MOST_FREEDOM))

    def rarity(self, point: FloatArray) -> float:
        """Share of pushes of a right model that end at least as far out as a point (n,); 1 at the centre."""
        n, freedom = len(self.middle), self.freedom
        return float(fdtrc(n, freedom, self._square(point) * freedom / (n * (freedom + n - 1.0))))

    def holds(self, point: FloatArray, level: float = LEVEL) -> bool:
        """Whether a point (n,) lies inside the region of a level."""
        return self.rarity(point) >= 1.0 - level

    def excess(self, point: FloatArray, level: float = LEVEL) -> float:
        """Distance of a point (n,) from the centre over that of the region's boundary in its direction."""
        n, freedom = len(self.middle), self.freedom
        limit = float(fdtri(n, freedom, level)) * n * (freedom + n - 1.0) / freedom
        return float(np.sqrt(self._square(point) / limit))

    def _square(self, point: FloatArray) -> float:
        off = np.asarray(point, dtype=float) - self.middle
        return float(off @ np.linalg.solve(self.covariance, off))
