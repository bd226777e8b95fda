"""Planar poses as elements of SE(2), and how far apart they put an object's cells.

The paper measures gaps between poses by the distance of their 3n vectors. Without the angles, and per cell,
that is the root mean square distance between the cells. It is the Euclidean distance of

    e(q) = (c_x, c_y, ρ cos θ, ρ sin θ),

with c the place of the cells' centroid and ρ² the mean square of the cells' distances from it, since
mean |p^i - p'^i|² = |c - c'|² + 2 ρ² (1 - cos(θ - θ')). So nearest poses are found by any search for nearest
points, and the mean square gap over uncertain poses is the gap of the mean plus the variance.
"""

from __future__ import annotations

import numpy as np

from models.angles import angle_between
from models.inference.centroid import radius_of_gyration
from models.physics.cell_grid import CellGrid, FloatArray


def compose(first: FloatArray, second: FloatArray) -> FloatArray:
    """(…, 3) pose in the world of `second`, which is given in the frame `first`."""
    c, s = np.cos(first[..., 2]), np.sin(first[..., 2])
    x, y = second[..., 0], second[..., 1]
    moved = [first[..., 0] + c * x - s * y, first[..., 1] + s * x + c * y, first[..., 2] + second[..., 2]]
    return np.stack(np.broadcast_arrays(*moved), axis=-1)


def relative(frame: FloatArray, pose: FloatArray) -> FloatArray:
    """(…, 3) the pose as seen from `frame`, so that compose(frame, relative(frame, pose)) is the pose."""
    c, s = np.cos(frame[..., 2]), np.sin(frame[..., 2])
    x, y = pose[..., 0] - frame[..., 0], pose[..., 1] - frame[..., 1]
    seen = [c * x + s * y, c * y - s * x, pose[..., 2] - frame[..., 2]]
    return np.stack(np.broadcast_arrays(*seen), axis=-1)


def turned_to(pose: FloatArray, angle: float) -> FloatArray:
    """(…, 3) the same poses with angles within half a turn of `angle`, rad."""
    result = np.array(pose, dtype=float)
    result[..., 2] = angle + angle_between(result[..., 2], angle)
    return result


class PoseMetric:
    """Root mean square distance between the cells of an object in two poses, m.

    Args:
        grid: the object's cells.
    """

    def __init__(self, grid: CellGrid) -> None:
        self._centroid = np.append(grid.centers.mean(axis=0), 0.0)
        self.radius = radius_of_gyration(grid)

    def embedding(self, poses: FloatArray) -> FloatArray:
        """(…, 4) e(q) of poses (…, 3); distances between these are gaps."""
        place = compose(poses, self._centroid)
        angle = poses[..., 2, None]
        turned = self.radius * np.concatenate([np.cos(angle), np.sin(angle)], axis=-1)
        return np.concatenate([place[..., :2], turned], axis=-1)

    def gap(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """(…) gap between poses (…, 3), m; leading axes broadcast."""
        return np.linalg.norm(self.embedding(one) - self.embedding(other), axis=-1)

    def gaps(self, poses: FloatArray, targets: FloatArray) -> FloatArray:
        """(…, G) gap between each pose (…, 3) and each target (G, 3), m; right to a tenth of a micrometre."""
        points, goals = self.embedding(poses), self.embedding(targets)
        square = (points**2).sum(axis=-1)[..., None] + (goals**2).sum(axis=-1) - 2.0 * points @ goals.T
        return np.sqrt(np.maximum(square, 0.0))
