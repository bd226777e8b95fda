"""Balance at the table's edge in closed form: how far the centre of mass lies inside the support polygon.

A rigid body on a level table stays in place as long as its centre of mass lies over the support polygon, the
convex hull of the footprint's part on the table (Song and Boularias, 2020, section on goal poses).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.compiled import compiled

_SAGITTA = 1e-5  # m; the polygon for the rim of a round table cuts it short by this much


def balance_margins(grid: CellGrid, centers_of_mass: ArrayLike, poses: ArrayLike, table: Table) -> FloatArray:
    """Balance margins of several hypotheses at several poses.

    The margin is the distance from the centre of mass to the boundary of the support polygon, the convex hull
    of the outline's part on the table: positive if the object stays, negative if it falls, -inf if no part of
    it is over the table. The whole underside is assumed to touch the table. The margin is exact except on a
    round table, whose rim is cut short by up to 0.01 mm.

    Args:
        grid: only its outline counts, which may be concave and have holes.
        centers_of_mass: (K, 2) of the hypotheses, object frame, m.
        poses: (G, 3) of the object in the world, m and rad.
        table: round or rectangular.

    Returns:
        (G, K) margins, m.

    Raises:
        ValueError: shapes do not match, numbers are not finite, or the table lacks its dimension.
    """
    centers = _points(centers_of_mass, "centres of mass", 2)
    return _margins(grid, centers[None], _points(poses, "poses", 3), table)


def own_balance_margins(
    grid: CellGrid, centers_of_mass: ArrayLike, poses: ArrayLike, table: Table
) -> FloatArray:
    """Balance margins as in `balance_margins`, for one centre of mass per pose.

    Args:
        grid: only its outline counts.
        centers_of_mass: (..., 2), one per pose or broadcast to that, object frame, m.
        poses: (..., 3) of the object in the world, m and rad.
        table: round or rectangular.

    Returns:
        (...) margins, m.

    Raises:
        ValueError: as in `balance_margins`.
    """
    all_poses = np.asarray(poses, dtype=float)
    shape = all_poses.shape[:-1]
    rows = _points(all_poses.reshape(-1, all_poses.shape[-1]), "poses", 3)
    centers = np.broadcast_to(np.asarray(centers_of_mass, dtype=float), (*shape, 2))
    own = _points(centers.reshape(-1, 2), "centres of mass", 2)
    return _margins(grid, own[:, None], rows, table).reshape(shape)


def fall_probability(margins: FloatArray, probability: FloatArray, margin: float = 0.0) -> FloatArray:
    """Probability that an object falls, summed over hypotheses with a balance margin below a safety margin.

    Args:
        margins: (..., K) from `balance_margins`, m.
        probability: (K,) of the hypotheses.
        margin: safety margin, m; 0 for bare balance.

    Returns:
        (...) probabilities.
    """
    falls = (np.asarray(margins) < margin) @ np.asarray(probability, dtype=float)
    return np.asarray(np.minimum(falls, 1.0))  # a sum of probabilities may exceed 1 by a rounding error


def corners_of(table: Table) -> FloatArray:
    """(4, 2) corners of a rectangular table, counter-clockwise, world, m; (0, 2) for a round one."""
    if table.shape == "round":
        return np.zeros((0, 2))
    half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    return np.asarray(table.center) + half * np.asarray(table.size)


def _margins(grid: CellGrid, centers: FloatArray, poses: FloatArray, table: Table) -> FloatArray:
    corners = corners_of(table)
    return _margins_kernel(
        grid.edges, centers, poses, np.asarray(table.center, dtype=float), float(table.radius or 0.0), corners
    )


def _points(values: ArrayLike, what: str, columns: int) -> FloatArray:
    points = np.ascontiguousarray(values, dtype=float)
    if points.ndim != 2 or points.shape[1] != columns:
        raise ValueError(f"balance: {what} must have {columns} columns, got shape {points.shape}")
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise ValueError(f"balance: {what}, row {row} is not finite: {points[row].tolist()}")
    return points


@compiled()
def _margins_kernel(edges, centers, poses, middle, radius, corners):  # type: ignore[no-untyped-def]
    """(G, K) margins; centers (1 or G, K, 2), corners (0, 2) for a round table; all in the object frame."""
    result = np.empty((len(poses), centers.shape[1]))
    arc = 2 * math.sqrt(2 * _SAGITTA / radius) if radius > 0 else 1.0
    points = np.empty((5 * len(edges) + 8 + int(2 * math.pi / arc), 2))
    angles = np.empty(2 * len(edges) + 1)
    own = np.empty((len(corners), 2))
    for g in range(len(poses)):
        x, y, angle = poses[g]
        c, s = math.cos(angle), math.sin(angle)
        if len(corners) == 0:
            dx, dy = middle[0] - x, middle[1] - y
            count = _on_disc(edges, c * dx + s * dy, c * dy - s * dx, radius, arc, points, angles)
        else:
            for j in range(len(corners)):
                dx, dy = corners[j, 0] - x, corners[j, 1] - y
                own[j, 0], own[j, 1] = c * dx + s * dy, c * dy - s * dx
            count = _on_polygon(edges, own, points)
        hull = _convex_hull(points[:count])
        for k in range(centers.shape[1]):
            center = centers[g if len(centers) > 1 else 0, k]
            result[g, k] = _signed_distance(hull, center[0], center[1])
    return result


@compiled()
def _on_disc(edges, mx, my, radius, arc, points, angles):  # type: ignore[no-untyped-def]
    """Write points whose hull is that of the intersection of outline and disc; returns their number."""
    count = crossings = 0
    for i in range(len(edges)):
        ax, ay = edges[i, 0] - mx, edges[i, 1] - my
        dx, dy = edges[i, 2] - edges[i, 0], edges[i, 3] - edges[i, 1]
        if ax * ax + ay * ay <= radius * radius:
            points[count, 0], points[count, 1] = edges[i, 0], edges[i, 1]
            count += 1
        square, half, rest = dx * dx + dy * dy, ax * dx + ay * dy, ax * ax + ay * ay - radius * radius
        inside = half * half - square * rest
        if inside < 0:
            continue
        root = math.sqrt(inside)
        for sign in (-1, 1):
            t = (-half + sign * root) / square
            if 0 <= t <= 1:
                angles[crossings] = math.atan2(ay + t * dy, ax + t * dx)
                crossings += 1
    if crossings == 0:
        # The whole circle lies inside the outline, or none of it.
        angles[0] = 0.0
        crossings = 1
    found = np.sort(angles[:crossings])
    for i in range(crossings):
        begin = found[i]
        end = found[i + 1] if i + 1 < crossings else found[0] + 2 * math.pi
        middle = (begin + end) / 2
        if _in_outline(edges, mx + radius * math.cos(middle), my + radius * math.sin(middle)):
            pieces = max(1, math.ceil((end - begin) / arc))
            for j in range(pieces + 1):
                angle = begin + (end - begin) * j / pieces
                points[count, 0] = mx + radius * math.cos(angle)
                points[count, 1] = my + radius * math.sin(angle)
                count += 1
    return count


@compiled()
def _on_polygon(edges, corners, points):  # type: ignore[no-untyped-def]
    """Like `_on_disc`, for a convex polygon with counter-clockwise corners."""
    count = 0
    for corner in corners:
        if _in_outline(edges, corner[0], corner[1]):
            points[count, 0], points[count, 1] = corner[0], corner[1]
            count += 1
    for i in range(len(edges)):
        # Part of the edge on the inner side of all sides of the polygon.
        begin, end = 0.0, 1.0
        dx, dy = edges[i, 2] - edges[i, 0], edges[i, 3] - edges[i, 1]
        for j in range(len(corners)):
            after = corners[(j + 1) % len(corners)]
            sx, sy = after[0] - corners[j, 0], after[1] - corners[j, 1]
            at = sx * (edges[i, 1] - corners[j, 1]) - sy * (edges[i, 0] - corners[j, 0])
            rate = sx * dy - sy * dx
            if rate > 0:
                begin = max(begin, -at / rate)
            elif rate < 0:
                end = min(end, -at / rate)
            elif at < 0:
                end = -1.0
        if begin <= end:
            for t in (begin, end):
                points[count, 0], points[count, 1] = edges[i, 0] + t * dx, edges[i, 1] + t * dy
                count += 1
    return count


@compiled()
def _in_outline(edges, x, y):  # type: ignore[no-untyped-def]
    inside = False
    for i in range(len(edges)):
        x0, y0, x1, y1 = edges[i]
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
            inside = not inside
    return inside


@compiled()
def _convex_hull(points):  # type: ignore[no-untyped-def]
    """Corners of the hull, counter-clockwise (Andrew's monotone chain, 1979)."""
    n = len(points)
    hull = np.empty((2 * n + 1, 2))
    if n == 0:
        return hull[:0]
    order = np.argsort(points[:, 0])
    # Points of equal x are sorted by y with insertion sort: such runs are short.
    for i in range(1, n):
        j = i
        while (
            j > 0
            and points[order[j], 0] == points[order[j - 1], 0]
            and points[order[j], 1] < points[order[j - 1], 1]
        ):
            order[j], order[j - 1] = order[j - 1], order[j]
            j -= 1
    size = 0
    for sweep in range(2):
        floor = size + 1
        for i in range(n):
            px, py = points[order[i if sweep == 0 else n - 1 - i]]
            while size > floor and _left(hull[size - 2], hull[size - 1], px, py) <= 0:
                size -= 1
            hull[size, 0], hull[size, 1] = px, py
            size += 1
        size -= 1
    return hull[: max(size, 1)]


@compiled()
def _left(a, b, px, py):  # type: ignore[no-untyped-def]
    """Positive if p lies to the left of the line from a to b."""
    return (b[0] - a[0]) * (py - a[1]) - (b[1] - a[1]) * (px - a[0])


@compiled()
def _signed_distance(hull, px, py):  # type: ignore[no-untyped-def]
    """Distance to a convex polygon's boundary: positive inside, negative outside, -inf without corners."""
    n = len(hull)
    if n == 0:
        return -np.inf
    inside = n > 2
    nearest = np.inf
    for i in range(n):
        a, b = hull[i], hull[(i + 1) % n]
        dx, dy = b[0] - a[0], b[1] - a[1]
        square = dx * dx + dy * dy
        t = ((px - a[0]) * dx + (py - a[1]) * dy) / square if square > 0 else 0.0
        t = min(max(t, 0.0), 1.0)
        nearest = min(nearest, math.hypot(px - a[0] - t * dx, py - a[1] - t * dy))
        inside = inside and _left(a, b, px, py) >= 0
    return nearest if inside else -nearest
