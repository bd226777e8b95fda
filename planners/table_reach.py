"""Where straight lines fixed to an object meet the table, for many poses of the object at once."""

from __future__ import annotations

import numpy as np

from models.measurements.push_dataset import Table
from models.physics.balance import corners_of
from models.physics.cell_grid import FloatArray


def first_on_table(
    direction: FloatArray, offset: FloatArray, poses: FloatArray, table: Table, half_width: float
) -> FloatArray:
    """Where strips that come from far away first meet the table's top.

    Args:
        direction: (L, 2) unit vectors in which they come, object frame.
        offset: (L,) of the strips' middle lines to the left of the object's origin, m.
        poses: (P, 3) of the object in the world, m and rad.
        table: round or rectangular.
        half_width: of the strips, m.

    Returns:
        (P, L) coordinate along each line, from the point nearest to the object's origin, m; inf where it
        passes by.
    """
    corners = corners_of(table)
    if len(corners) > 0:
        return _first_in_strip(*_on_lines(direction, offset, poses, corners), half_width)
    assert table.radius is not None  # see corners_of
    along, left = _on_lines(direction, offset, poses, np.array([table.center]))
    beside = np.maximum(np.abs(left[..., 0]) - half_width, 0.0)
    square = table.radius**2 - beside**2
    return np.asarray(np.where(square > 0, along[..., 0] - np.sqrt(np.maximum(square, 0.0)), np.inf))


def towards_table(
    direction: FloatArray, offset: FloatArray, at: FloatArray, poses: FloatArray, table: Table
) -> FloatArray:
    """Cosine between lines and the shortest way from one point of each, outside the table, to the table.

    Args:
        direction: (L, 2) unit vectors along the lines, object frame.
        offset: (L,) of the lines to the left of the object's origin, m.
        at: (L,) coordinate of the point along its line, m.
        poses: (P, 3) of the object in the world, m and rad.
        table: round or rectangular.

    Returns:
        (P, L).
    """
    if table.shape == "round":
        along, left = _on_lines(direction, offset, poses, np.array([table.center]))
        ahead = along[..., 0] - at
        return np.asarray(ahead / np.maximum(np.hypot(ahead, left[..., 0]), 1e-9))
    x, y = (at[:, None] * direction + offset[:, None] * direction[:, ::-1] * [-1, 1]).T
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    away = np.stack([c * x - s * y, s * x + c * y], axis=-1) + poses[:, None, :2] - np.asarray(table.center)
    half = np.asarray(table.size) / 2
    to_table = np.clip(away, -half, half) - away
    ux, uy = direction.T
    ahead = to_table[..., 0] * (c * ux - s * uy) + to_table[..., 1] * (s * ux + c * uy)
    return np.asarray(ahead / np.maximum(np.hypot(to_table[..., 0], to_table[..., 1]), 1e-9))


def _on_lines(
    direction: FloatArray, offset: FloatArray, poses: FloatArray, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """World points (c, 2) along (P, L, c) and to the left of (P, L, c) each line."""
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    dx, dy = points[:, 0] - poses[:, :1], points[:, 1] - poses[:, 1:2]
    x, y = (c * dx + s * dy)[:, None], (c * dy - s * dx)[:, None]
    ux, uy = direction[:, :1], direction[:, 1:]
    return x * ux + y * uy, y * ux - x * uy - offset[:, None]


def _first_in_strip(along: FloatArray, left: FloatArray, half_width: float) -> FloatArray:
    """Least coordinate of a polygon (..., c) within |left| <= half_width; inf where it is beside."""
    next_along, next_left = np.roll(along, -1, axis=-1), np.roll(left, -1, axis=-1)
    found = np.where(np.abs(left) <= half_width, along, np.inf).min(axis=-1)
    for side in (-half_width, half_width):
        crosses = (left > side) != (next_left > side)
        share = np.where(crosses, (side - left) / np.where(crosses, next_left - left, 1.0), 0.0)
        there = np.where(crosses, along + share * (next_along - along), np.inf)
        found = np.minimum(found, there.min(axis=-1))
    return np.asarray(found)
