"""Where a push may end if the model is right: a joint region of x, y and θ at any level.

Of three 90 % intervals, one per coordinate, at least one is missed by up to 27 % of pushes even if the model
is right. So all three are tested together. The region of a level is an ellipsoid around the mean m of the
hypotheses, with the covariance of the hypotheses plus all other errors,

    (q - m)ᵀ C⁻¹ (q - m) ≤ c,    C = S (1 + 1/n) + diag(σ²) + diag(s²),

where S is the spread of n effective hypotheses, σ the error of the tracker, and s that of the model. n draws
determine their spread poorly, and a model is far off now and then: most pushes follow it, and those near
balance do not. So the spread counts as Hotelling's, and s as Student's with few degrees of freedom; c has the
degrees of freedom of the sum (Welch and Satterthwaite), which are almost unlimited where σ dominates. For a
single number this is the usual interval.

A few pushes say little about s: any of J values may be right. An end is then as rare as it is on average over
those, which hardly changes the regions of 50 % and widens those of 95 and 99 %.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import fdtrc, fdtri

from slipmap.models.physics.cell_grid import FloatArray

LEVEL = 0.95
"""Share of pushes that end inside if the model is right; those outside are called surprising."""

MODEL_FREEDOM = 3.0
"""Degrees of freedom of the model's error. With 3 or 4, the regions of recorded pushes hold as many ends as
they say; those of a normal error are too wide for 50 % and too narrow for 95 %."""

MOST_FREEDOM = 1e6  # degrees of freedom; practically unlimited
_LEAST_FREEDOM = 1.0
_MOST_DIGITS = 6  # after the point, of millimetres


def beyond_in_millimetres(error: float, allowed: float) -> tuple[str, str]:
    """An error and the largest that would not surprise, m, in mm, with enough digits to see which is larger.

    Hundredths of a millimetre below 1 mm, tenths from there; more where both would be written alike.
    """
    texts = [f"{1e3 * metres:.{2 if metres < 1e-3 else 1}f}" for metres in (error, allowed)]
    for digits in range(2, _MOST_DIGITS + 1):
        if (float(texts[0]) > float(texts[1])) == (error > allowed):
            break
        texts = [f"{1e3 * metres:.{digits}f}" for metres in (error, allowed)]
    return texts[0], texts[1]


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
    # (J, n, n) C for each size of the model's error, scaled so that the squared distance over n is
    # distributed as Fisher's F(n, freedom)
    covariances: FloatArray
    freedom: FloatArray  # (J,)

    @classmethod
    def of(
        cls, draws: FloatArray, probability: FloatArray, sigma: FloatArray, model: FloatArray | float = 0.0
    ) -> EndRegion:
        """The region that follows from hypotheses and further errors.

        Args:
            draws: (K, n) one for each hypothesis; angles do not wrap.
            probability: (K,) of the hypotheses.
            sigma: (n,) standard deviations of normal errors.
            model: (n,) or (J, n) standard deviations of the model's error; J equally likely ones.
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
        deviations = np.atleast_2d(np.broadcast_to(model, np.broadcast_shapes(np.shape(model), (n,))))
        off = deviations[:, :, None] ** 2 * np.eye(n)
        # Keep the covariance regular where a number has no error.
        covariances = spread + off + np.diag(np.maximum(sigma, 1e-9) ** 2)
        own = max(effective - n, _LEAST_FREEDOM)
        inverses = np.linalg.inv(covariances)
        of_hypotheses = (np.einsum("jab,ab->j", inverses, spread) / n) ** 2 / own
        of_model = (np.einsum("jab,jab->j", inverses, off) / n) ** 2 / MODEL_FREEDOM
        freedom = 1.0 / np.maximum(of_hypotheses + of_model, 1.0 / MOST_FREEDOM)
        # Hotelling's region is wider than its covariance; Student's core is narrower.
        scale = (1.0 + (n - 1.0) * of_hypotheses) * (1.0 - 2.0 * of_model)
        return cls(middle, covariances * scale[:, None, None], freedom)

    def interval(self, level: float) -> tuple[float, float]:
        """Lower and upper end of the region of a single number."""
        half = self._reach(1.0 / self.covariances[:, 0, 0], level)
        return float(self.middle[0]) - half, float(self.middle[0]) + half

    def rarity(self, point: FloatArray) -> float:
        """Share of pushes of a right model that end at least as far out as a point (n,); 1 at the centre."""
        return self._share_beyond(self._distances(point))

    def holds(self, point: FloatArray, level: float = LEVEL) -> bool:
        """Whether a point (n,) lies inside the region of a level."""
        return self.rarity(point) >= 1.0 - level

    def excess(self, point: FloatArray) -> float:
        """Distance of a point (n,) from the centre over that of the region's boundary in its direction."""
        distances = self._distances(point)
        return 1.0 / self._reach(distances, LEVEL) if distances.any() else 0.0

    def _distances(self, point: FloatArray) -> FloatArray:
        """(J,) squared distances of a point from the centre, over n."""
        off = np.asarray(point, dtype=float) - self.middle
        return np.linalg.solve(self.covariances, off[:, None])[..., 0] @ off / len(off)

    def _share_beyond(self, distances: FloatArray) -> float:
        return float(fdtrc(len(self.middle), self.freedom, distances).mean())

    def _reach(self, distances: FloatArray, level: float) -> float:
        """Factor by which a way from the centre, of squared distances (J,), reaches a level's boundary."""
        single = np.sqrt(fdtri(len(self.middle), self.freedom, level) / distances)
        low, high = float(single.min()), float(single.max())
        if not high - low > 1e-9 * high:  # also where ends are not known
            return high

        def excess_share(reach: float) -> float:
            return self._share_beyond(reach**2 * distances) - (1.0 - level)

        return float(brentq(excess_share, low, high, rtol=1e-9))
