"""Geometry of the plane: angles, and poses x, y, theta (m, m, rad) of frames with points in them."""

import numpy as np

from slipmap.models.physics.cell_grid import CellGrid, FloatArray


def angle_between(one: FloatArray | float, other: FloatArray | float) -> FloatArray:
    """(…) the angle one - other, wrapped to [-π, π), rad."""
    return np.remainder(np.asarray(one, dtype=float) - other + np.pi, 2 * np.pi) - np.pi


def cross(one: FloatArray, other: FloatArray) -> FloatArray:
    """(…) cross products of vectors (…, 2): one_x other_y - one_y other_x."""
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]


def turn(angle: float) -> FloatArray:
    """(2, 2) rotation by an angle, rad."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def rotated(vectors: FloatArray, angle: FloatArray | float) -> FloatArray:
    """(…, 2) vectors turned by angles (…) in rad; leading axes broadcast."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def placed(points: FloatArray, pose: FloatArray) -> FloatArray:
    """(…, 2) world coordinates of points (…, 2) given in the frame at `pose` (…, 3)."""
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x, y = points[..., 0], points[..., 1]
    return np.stack([pose[..., 0] + c * x - s * y, pose[..., 1] + s * x + c * y], axis=-1)


def seen_from(points: FloatArray, pose: FloatArray) -> FloatArray:
    """Inverse of `placed`: (…, 2) world points in the frame at `pose` (…, 3)."""
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x, y = points[..., 0] - pose[..., 0], points[..., 1] - pose[..., 1]
    return np.stack([c * x + s * y, c * y - s * x], axis=-1)


def compose(first: FloatArray, second: FloatArray) -> FloatArray:
    """(…, 3) world pose of `second`, which is given in the frame `first`."""
    return np.concatenate([placed(second, first), first[..., 2:] + second[..., 2:]], axis=-1)


def relative(frame: FloatArray, pose: FloatArray) -> FloatArray:
    """(…, 3) the pose as seen from `frame`, so that compose(frame, relative(frame, pose)) is the pose."""
    return np.concatenate([seen_from(pose, frame), pose[..., 2:] - frame[..., 2:]], axis=-1)


def turned_to(pose: FloatArray, angle: float) -> FloatArray:
    """(…, 3) the same poses, with angles within half a turn of `angle`, rad."""
    result = np.array(pose, dtype=float)
    result[..., 2] = angle + angle_between(result[..., 2], angle)
    return result


def at_centroid(poses: FloatArray, grid: CellGrid) -> FloatArray:
    """Poses (…, 3) of the object frame, moved to the cells' centroid."""
    return compose(poses, np.append(grid.centers.mean(axis=0), 0.0))


def from_centroid(poses: FloatArray, grid: CellGrid) -> FloatArray:
    """Inverse of `at_centroid`."""
    return compose(poses, np.append(-grid.centers.mean(axis=0), 0.0))


def radius_of_gyration(grid: CellGrid) -> float:
    """Radius of gyration of the cells about their centroid, m; times an angle, about how far cells move.

    A single cell turns about its own centre; its radius is that of a square of side w, w / √6.
    """
    if len(grid.centers) == 1:
        return float(grid.width / np.sqrt(6.0))
    return float(np.sqrt(((grid.centers - grid.centers.mean(axis=0)) ** 2).sum(axis=1).mean()))
