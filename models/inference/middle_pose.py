"""One pose for many that are believed: the one from which the true one is expected to be least far.

Hypotheses of a belief can part ways, where a push goes to one side of balance or to the other. Their mean
then lies where none of them is, and follows those that go farthest astray. What is judged is ADD, a distance,
and the expected distance is least at the geometric median.
"""

from __future__ import annotations

import numpy as np

from models.inference.centroid import at_centroid, from_centroid, radius_of_gyration
from models.physics.cell_grid import CellGrid, FloatArray

_CLOSE = 1e-4  # m; nearer than this, a hypothesis pulls ever less
_SETTLED = 1e-6  # m
_STEPS = 100


def middle_poses(poses: FloatArray, probability: FloatArray, grid: CellGrid) -> FloatArray:
    """Geometric median of planar poses, by the iteration of Weiszfeld (1937).

    Distances are those of (x, y, ρ θ) at the cells' centroid, ρ being their radius of gyration: nearly ADD.

    Args:
        poses: (K, …, 3) of the object frame, m and rad; angles of one place do not wrap.
        probability: (K,) sums to one.
        grid: cells of the object.

    Returns:
        (…, 3) poses.
    """
    scale = np.array([1.0, 1.0, radius_of_gyration(grid)])
    points = at_centroid(poses, grid) * scale
    weight = probability.reshape(-1, *[1] * (points.ndim - 1))
    middle = (weight * points).sum(axis=0)
    for _ in range(_STEPS):
        distance = np.linalg.norm(points - middle, axis=-1, keepdims=True)
        pull = weight / np.sqrt(distance**2 + _CLOSE**2)
        before, middle = middle, (pull * points).sum(axis=0) / pull.sum(axis=0)
        if np.abs(middle - before).max(initial=0.0) < _SETTLED:
            break
    return from_centroid(middle / scale, grid)
