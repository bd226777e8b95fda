"""Cells at given centres: with an outline of their own if none is given."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from shapely.geometry import MultiPolygon, Polygon

from slipmap.models.objects.footprints import check_width, checked_holes, rings_of
from slipmap.models.physics.cell_grid import CellGrid, FloatArray, checked_points

_LATTICE_TOLERANCE = 0.1  # of a cell's width; measured centres are often rounded
_BRIDGE = 0.05  # half the side of the bridge between diagonal neighbours, in cell widths


def cells_from_centres(
    centers: ArrayLike, width: float, outline: ArrayLike | None = None, holes: Sequence[ArrayLike] = ()
) -> CellGrid:
    """Cells at given centres, for instance those listed in a dataset.

    Without an outline it is the border of the union of the squares. Gaps and overlaps up to a tenth of a cell
    (rounded centres) close up. Two cells that touch in a corner only are joined by a square bridge with sides
    of a tenth of a cell, so that the outline stays one simple ring.

    Args:
        centers: (n, 2) cell centres in the object frame, m.
        width: side of a cell, m.
        outline: (k, 2) outline in the object frame, m.
        holes: rings (k_j, 2) of openings, m; only together with `outline`.

    Raises:
        ValueError: cells that overlap, that lie more than a cell outside the given outline, or, without an
            outline, that do not lie on one square grid or fall into separate parts.
    """
    points = checked_points(centers, "cell centres")
    check_width(width)
    if len(points) == 0:
        raise ValueError("cell grid: there are no cells")
    _require_apart(points, width)
    if outline is not None:
        grid = CellGrid(points, float(width), checked_points(outline, "outline"), checked_holes(holes))
        distance = np.asarray(shapely.distance(grid.polygon, shapely.points(points)))
        far = int(np.argmax(distance))
        if distance[far] > width:
            raise ValueError(
                f"cell grid: cell {far} at {points[far].tolist()} lies {distance[far]:.4g} m outside the "
                f"outline, more than a cell ({width:.4g} m); check that both use the same frame and unit"
            )
        return grid
    if len(holes) > 0:
        raise ValueError("cell grid: holes were given without an outline")
    border = _union_of_squares(points, float(width))
    return CellGrid(points, float(width), *rings_of(border))


def _union_of_squares(centers: FloatArray, width: float) -> Polygon:
    relative = (centers - centers[0]) / width
    index = np.round(relative)
    # The grid's origin is free: measure the residual about its own middle.
    residual = relative - index
    residual -= (residual.max(axis=0) + residual.min(axis=0)) / 2
    worst = int(np.argmax(np.abs(residual).max(axis=1)))
    if np.abs(residual[worst]).max() > _LATTICE_TOLERANCE:
        raise ValueError(
            f"cell grid: cell {worst} at {centers[worst].tolist()} is {np.abs(residual[worst]).max():.2f} "
            f"cells off the square grid of width {width:.4g} m along x and y; correct the width or give the "
            f"outline"
        )
    squares = shapely.box(*(2 * index - 1).T, *(2 * index + 1).T)  # whole numbers: their union is exact
    union = shapely.unary_union([*squares, *_bridges(index)])
    if isinstance(union, MultiPolygon):
        part = min(union.geoms, key=lambda p: p.area)
        inside = np.flatnonzero(shapely.intersects_xy(part, 2 * index[:, 0], 2 * index[:, 1]))
        raise ValueError(
            f"cell grid: the cells fall into {len(union.geoms)} separate parts; the smallest has "
            f"{len(inside)} of {len(centers)} cells, among them cell {inside[0]} at "
            f"{centers[inside[0]].tolist()}; an object is one connected piece: add the missing cells or give "
            f"the outline"
        )
    origin = np.mean(centers - index * width, axis=0)
    outline = union.simplify(0.0)
    assert isinstance(outline, Polygon)
    return shapely.transform(outline, lambda xy: xy * (width / 2) + origin)


def _bridges(index: FloatArray) -> list[Polygon]:
    """Squares over the corners at which two diagonal neighbours meet alone, in half cells."""
    occupied = {(int(i), int(j)) for i, j in index}
    bridges = []
    for i, j in sorted(occupied):
        for dj in (1, -1):
            if (i + 1, j + dj) in occupied and not {(i + 1, j), (i, j + dj)} & occupied:
                x, y, half = 2 * i + 1, 2 * j + dj, 2 * _BRIDGE
                bridges.append(shapely.box(x - half, y - half, x + half, y + half))
    return bridges


def _require_apart(centers: FloatArray, width: float) -> None:
    if len(centers) < 2:
        return
    distance, neighbour = (np.asarray(a) for a in cKDTree(centers).query(centers, k=2))
    close = int(np.argmin(distance[:, 1]))
    if distance[close, 1] < width / 2:
        other = int(neighbour[close][neighbour[close] != close][0])
        raise ValueError(
            f"cell grid: cells {close} and {other} overlap; their centres are {distance[close, 1]:.4g} m "
            f"apart, the cell width is {width:.4g} m"
        )
