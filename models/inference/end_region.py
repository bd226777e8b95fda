"""Where a push may end if the model is right: a region of x, y and θ together, of any level.

Three intervals of 90 %, one for each coordinate, are missed in one of the three by up to 27 % of pushes of a
right model. So what is asked is one question about all three: the region of a level is an ellipsoid around
the hypotheses' mean, its covariance that of the hypotheses and of everything else a push is off by together,

    (q - m)ᵀ C⁻¹ (q - m) ≤ c,    C = S (1 + 1/n) + diag(σ²),

with S the spread of n effective hypotheses and σ what model and tracker are off by. n draws know their spread
badly; c is Hotelling's, with the degrees of freedom of the sum (Welch and Satterthwaite): those of S where
hypotheses differ most, none short where σ does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, fdtri

from slipmap.models.physics.cell_grid import FloatArray

LEVEL = 0.95
"""Share of the pushes of a right model that end inside; of those outside it is said that they surprise."""

_MOST_FREEDOM = 1e6  # degrees, as good as none short
_LEAST_FREEDOM = 1.0


@dataclass(frozen=True, eq=False)
class EndRegion:
    """Where n numbers may lie together, of a right model; of an end they are x, y (m) and θ (rad).

    Example:
        >>> import numpy as np
        >>> from slipmap.models.inference.end_region import EndRegion
        >>> region = EndRegion.of(np.zeros((1, 3)), np.ones(1), np.array([1e-3, 1e-3, 0.01]))
        >>> region.holds(np.array([1e-3, 0.0, 0.0])), region.holds(np.array([5e-3, 0.0, 0.0]))
        (True, False)
    """

    middle: FloatArray  # (n,) the hypotheses' mean
    covariance: FloatArray  # (n, n) of all that a push is off by
    freedom: float  # degrees of freedom with which that is known

    @classmethod
    def of(cls, draws: FloatArray, probability: FloatArray, sigma: FloatArray) -> EndRegion:
        """The region that hypotheses suggest.

        Args:
            draws: (K, n) one of each hypothesis; angles do not wrap.
            probability: (K,) of the hypotheses.
            sigma: (n,) standard deviations of what comes on top.
        """
        n = draws.shape[1]
        effective = 1.0 / float(probability @ probability)
        middle = probability @ draws
        around = draws - middle
        spread = np.zeros((n, n))
        if effective > 1.0 + 1e-6:
            spread = around.T @ (around * probability[:, None])
            # With hardly more than one that counts, the spread is no better known than that of two.
            few = max(2.0, effective)
            spread *= few / (few - 1.0) * (1.0 + 1.0 / effective)
        # A number that nothing is off by is known to a billionth.
        covariance = spread + np.diag(np.maximum(sigma, 1e-9) ** 2)
        of_hypotheses = float(np.trace(np.linalg.solve(covariance, spread))) / n
        own = max(effective - n, _LEAST_FREEDOM)
        freedom = own / max(of_hypotheses, 1e-9) ** 2
        return cls(middle, covariance, min(freedom, _MOST_FREEDOM))

    def rarity(self, point: FloatArray) -> float:
        """How often a push of a right model ends at least as far out as a point (n,): 1 in the middle."""
        n, freedom = len(self.middle), self.freedom
        return float(fdtrc(n, freedom, self._square(point) * freedom / (n * (freedom + n - 1.0))))

    def holds(self, point: FloatArray, level: float = LEVEL) -> bool:
        """Whether a point (n,) lies in the region of a level."""
        return self.rarity(point) >= 1.0 - level

    def excess(self, point: FloatArray, level: float = LEVEL) -> float:
        """How many times as far out a point (n,) is as the region of a level reaches in its direction."""
        n, freedom = len(self.middle), self.freedom
        limit = float(fdtri(n, freedom, level)) * n * (freedom + n - 1.0) / freedom
        return float(np.sqrt(self._square(point) / limit))

    def _square(self, point: FloatArray) -> float:
        off = np.asarray(point, dtype=float) - self.middle
        return float(off @ np.linalg.solve(self.covariance, off))
