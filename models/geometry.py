"""Angles, which come round again after a whole turn."""

from __future__ import annotations

import numpy as np

from slipmap.models.physics.cell_grid import CellGrid, FloatArray


def angle_between(one: FloatArray | float, other: FloatArray | float) -> FloatArray:
    """(…) the angle one - other, wrapped to half a turn on both sides, rad: -π to below π."""
    return np.remainder(np.asarray(one, dtype=float) - other + np.pi, 2 * np.pi) - np.pi


# Planar poses as seen from the cells' centroid, about which an object turns without moving.


def at_centroid(poses: FloatArray, grid: CellGrid) -> FloatArray:
    """Poses (…, 3) of the object frame as positions of the cells' centroid, with the angle."""
    x, y = grid.centers.mean(axis=0)
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    return np.stack([poses[..., 0] + c * x - s * y, poses[..., 1] + s * x + c * y, poses[..., 2]], axis=-1)


def radius_of_gyration(grid: CellGrid) -> float:
    """Of the cells about their centroid, m; an angle times it is about as far as the cells move."""
    return float(np.sqrt(((grid.centers - grid.centers.mean(axis=0)) ** 2).sum(axis=1).mean()))


def from_centroid(poses: FloatArray, grid: CellGrid) -> FloatArray:
    """Inverse of `at_centroid`."""
    x, y = grid.centers.mean(axis=0)
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    return np.stack([poses[..., 0] - c * x + s * y, poses[..., 1] - s * x - c * y, poses[..., 2]], axis=-1)
