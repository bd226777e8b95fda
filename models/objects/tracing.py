"""The outline of a mask of pixels, to better than a pixel."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LinearRing, Polygon

from models.physics.cell_grid import FloatArray

# The borders' middles along a straight edge of any direction lie in a strip less than a pixel wide.
_STRIP = 1.0
_FARTHEST_CORNER = 1.5
_LEAST_TURN = np.sin(np.deg2rad(15.0))


def traced_outline(mask: NDArray[np.bool_]) -> Polygon:
    """Outline with holes of one connected piece of pixels (neighbours share a side).

    The outline runs between the pixels, through the middles of the borders between object and background.
    Stairs of oblique edges are replaced by the straight lines that fit them best in the least-squares sense,
    so that normals are those of the object's edges and not of the pixels; corners lie where these lines
    meet. Objects too small for that, a few pixels wide, keep the borders of their pixels.

    Args:
        mask: (H, W) pixels of the object.

    Returns:
        Polygon in pixel coordinates (column, row), in which whole numbers are the centres of pixels.
    """
    rings, borders = border_middles(mask)
    stairs = Polygon(rings[0], rings[1:])
    coarse = stairs.simplify(_STRIP)
    assert isinstance(coarse, Polygon)
    kept = (coarse.exterior, *coarse.interiors)
    straight = [straightened(points, corners) for points, corners in zip(rings, kept, strict=True)]
    polygon = Polygon(straight[0], straight[1:])
    # Lines that fit keep the area; otherwise edges are off by a tenth of a pixel on average.
    if polygon.is_valid and abs(polygon.area - mask.sum()) < 0.1 * stairs.length:
        return polygon
    exact = borders.simplify(0.0)
    assert isinstance(exact, Polygon)
    return exact


def border_middles(mask: NDArray[np.bool_]) -> tuple[list[FloatArray], Polygon]:
    """Middles of the borders between object and background, one pixel apart, and the borders themselves.

    Args:
        mask: (H, W) one connected piece of pixels.

    Returns:
        Rings of points (m, 2), the exterior first, (column, row); and the exact outline of the pixels.
    """
    step = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, first = np.nonzero(step == 1)
    last = np.nonzero(step == -1)[1]
    # The union of the rows' runs follows the borders exactly; cut into unit steps, it gives their middles.
    runs = shapely.box(first - 0.5, row - 0.5, last - 0.5, row + 0.5)
    borders = shapely.unary_union(runs).segmentize(1.0)
    assert isinstance(borders, Polygon)
    rings = []
    for ring in (borders.exterior, *borders.interiors):
        corners = np.asarray(ring.coords)
        rings.append((corners[:-1] + corners[1:]) / 2)
    return rings, borders


def straightened(points: FloatArray, kept: LinearRing) -> FloatArray:
    """Corners (k, 2) of the lines that best fit the stretches of a ring (m, 2) between points kept of it."""
    where = {tuple(point): k for k, point in enumerate(points)}
    corners = np.asarray(kept.coords)[:-1]
    index = [where[tuple(corner)] for corner in corners]
    if (np.diff(index) % len(points)).sum() > len(points):  # kept in the other sense
        corners, index = corners[::-1], index[::-1]
    lines = []
    for begin, end in zip(index, index[1:] + index[:1], strict=True):
        stretch = points[(begin + np.arange((end - begin) % len(points) + 1)) % len(points)]
        inner = stretch[1:-1] if len(stretch) > 5 else stretch[[0, -1]]
        middle = inner.mean(axis=0)
        direction = np.linalg.svd(inner - middle, full_matrices=False)[2][0]
        backwards = direction @ (stretch[-1] - stretch[0]) < 0
        lines.append((middle, -direction if backwards else direction))
    result = []
    for corner, (p, d), (q, e) in zip(corners, lines[-1:] + lines[:-1], lines, strict=True):
        turn = d[0] * e[1] - d[1] * e[0]
        projected = (p + d * (d @ (corner - p)) + q + e * (e @ (corner - q))) / 2
        if abs(turn) > _LEAST_TURN:
            meeting = p + d * (((q - p)[0] * e[1] - (q - p)[1] * e[0]) / turn)
            if np.linalg.norm(meeting - corner) <= _FARTHEST_CORNER:
                projected = meeting
        result.append(projected)
    return np.array(result)
