"""How many pushes would follow: a look ahead by lookup instead of more rollouts.

Pushing works alike everywhere on the table: a push that moves the object by δ from one pose moves it by δ,
as seen from the object, from any other. So the pushes imagined for one pose tell what pushes from every other
pose would do, pairs of them what two would do, and the best next push is a search for the nearest point.
Where effects depend on the place this holds only roughly, which is enough to look ahead with.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from models.physics.cell_grid import FloatArray
from planners.foresight import Foresight
from planners.pose_metric import PoseMetric, compose, relative
from planners.pregrasp_settings import PushSettings

PAIRS = 100_000
"""Pairs of pushes that are looked up."""


class Lookahead:
    """Expected number of pushes from a pose to a target.

    Args:
        foresight: pushes imagined from one pose.
        pose: (3,) this pose.
        metric: of gaps.
        settings: what pushes are like.
        rng: draws the pairs.
    """

    def __init__(
        self,
        foresight: Foresight,
        pose: FloatArray,
        metric: PoseMetric,
        settings: PushSettings,
        rng: np.random.Generator,
    ) -> None:
        self._metric = metric
        self._settings = settings
        p = foresight.probability
        moves = relative(pose, foresight.poses).reshape(-1, len(p), 3)
        moves = moves[np.isfinite(moves).all(axis=(1, 2))]
        points = metric.embedding(moves)
        mean = np.einsum("s,msc->mc", p, points)
        spread = np.sqrt(np.einsum("s,msc->m", p, (points - mean[:, None]) ** 2))
        self._one = cKDTree(np.column_stack([mean, spread]))
        likely = np.einsum("s,msc->mc", p, moves)
        first, second = rng.integers(len(moves), size=(2, PAIRS))
        pairs = metric.embedding(compose(likely[first], likely[second]))
        self._two = cKDTree(np.column_stack([pairs, spread[second]]))

    def after(self, poses: FloatArray, targets: FloatArray, *, pairs: bool) -> FloatArray:
        """(…, G) expected pushes from poses (…, 3) to targets (G, 3), with one push or, if wanted, a pair."""
        seen = self._metric.embedding(relative(poses[..., None, :], targets))
        wanted = np.concatenate([seen, np.zeros((*seen.shape[:-1], 1))], axis=-1)
        left = 1.0 + further_pushes(self._one.query(wanted, workers=2)[0], self._settings)
        if pairs:
            two = 2.0 + further_pushes(self._two.query(wanted, eps=0.2, workers=2)[0], self._settings)
            left = np.minimum(left, two)
        return left


def further_pushes(gap: FloatArray, settings: PushSettings) -> FloatArray:
    """Expected pushes to close gaps (m) that are left: none within the tolerance, beyond it one and more.

    The gap is one of all cells, the tolerance one of place and of angle; a gap as large as the tolerance is
    taken to miss half of the time.
    """
    misses = gap**4 / (gap**4 + settings.tolerance**4)
    return misses * (1.0 + gap / settings.longest)
