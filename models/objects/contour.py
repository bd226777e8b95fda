"""Cells on an object's outer contour, where a finger can touch them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from models.physics.cell_grid import CellGrid, FloatArray

_PIECES_PER_CELL = 32
_LEAST_SHARE = 0.1  # of a cell's width


def contour_cells(grid: CellGrid) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Cells that own a stretch of the exterior, each with a contact point and the normal there.

    A cell owns the part of the exterior to which it is the nearest cell. Its contact point is the point of
    this part that lies nearest to the cell's centre; for a cell with a side on the outline, the middle of
    that side. Cells that own less than a tenth of their width, such as the one behind a re-entrant corner,
    are left out, unless no cell owns more. Holes have no contact cells: a finger outside cannot reach them.

    Returns:
        indices: (c,) cells in counter-clockwise order along the exterior, each once.
        points: (c, 2) contact points on the exterior, never on a corner, object frame, m.
        normals: (c, 2) outward unit normals of the edges they lie on, object frame.
    """
    start, along, edge, limits = _pieces(grid)
    length = np.linalg.norm(along, axis=1)
    owner = np.asarray(cKDTree(grid.centers).query(start + along / 2)[1])
    share = np.bincount(owner, weights=length, minlength=len(grid))
    least = min(_LEAST_SHARE * grid.width, float(share.max()))

    # Nearest point of each piece to its owner, kept off the edge's ends.
    offset = grid.centers[owner] - start
    fraction = np.clip(np.sum(offset * along, axis=1) / length**2, *limits)
    points = start + fraction[:, None] * along
    distance = np.linalg.norm(points - grid.centers[owner], axis=1)

    # Rounded, so that of equally near points the first is taken whatever the rounding errors.
    key = np.round(distance / grid.width, 6)
    order = np.lexsort((np.arange(len(owner)), key, owner))
    cells, first = np.unique(owner[order], return_index=True)
    chosen = order[first][share[cells] >= least]
    chosen.sort()
    edges = grid.edges[edge[chosen]]
    tangent = edges[:, 2:] - edges[:, :2]
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    return owner[chosen], points[chosen], np.column_stack([tangent[:, 1], -tangent[:, 0]])


def _pieces(grid: CellGrid) -> tuple[FloatArray, FloatArray, NDArray[np.intp], FloatArray]:
    """Exterior cut into short pieces: start (p, 2), vector (p, 2), edge (p,), usable fractions (2, p)."""
    edges = grid.edges[: len(grid.exterior)]
    vectors = edges[:, 2:] - edges[:, :2]
    lengths = np.linalg.norm(vectors, axis=1)
    number = np.maximum(1, np.ceil(lengths * _PIECES_PER_CELL / grid.width)).astype(int)
    number[lengths == 0] = 0
    edge = np.repeat(np.arange(len(edges)), number)
    rank = np.arange(len(edge)) - np.repeat(np.cumsum(number) - number, number)
    along = vectors[edge] / number[edge, None]
    start = edges[edge, :2] + rank[:, None] * along
    limits = np.array([np.where(rank == 0, 0.01, 0.0), np.where(rank == number[edge] - 1, 0.99, 1.0)])
    return start, along, edge, limits
