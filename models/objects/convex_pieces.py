"""Convex pieces of an outline, for collision engines, which know no others."""

import heapq
from collections import defaultdict
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon

_BULGE = 1e-4  # m; by how much a convex piece may stand out of the polygon

_Borders = dict[int, dict[int, float]]
"""Of each piece, those beside it and the length of the common border, m; NaN where it cannot be removed."""


def convex_pieces(polygon: Polygon) -> list[Polygon]:
    """Convex polygons that cover a polygon with corners and holes, and stand out by no more than 0.1 mm.

    Triangles that share a side are joined, the longest common border first, as long as the result stays
    convex (the algorithm of Hertel and Mehlhorn, which finds at most four times as many pieces as needed).
    Two pieces that cannot be joined never can, however they grow: each pair is tried once.
    """
    allowed = polygon.buffer(_BULGE, quad_segs=2)
    shapely.prepare(allowed)
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    pieces: dict[int, Polygon] = dict(enumerate(triangles))
    borders = _common_sides(triangles)
    waiting = [(-length, i, j) for i, beside in borders.items() for j, length in beside.items() if i < j]
    heapq.heapify(waiting)
    following = len(pieces)
    while waiting:
        _, i, j = heapq.heappop(waiting)
        if i not in pieces or j not in pieces:
            continue  # one of them is part of a larger piece by now
        hull = shapely.union(pieces[i], pieces[j]).convex_hull
        if not allowed.covers(hull):
            borders[i][j] = borders[j][i] = np.nan
            continue
        del pieces[i], pieces[j]
        pieces[following] = hull
        one, other = borders.pop(i), borders.pop(j)
        borders[following] = {}
        for k in sorted((one.keys() | other.keys()) - {i, j}):
            length = one.get(k, 0.0) + other.get(k, 0.0)
            borders[k].pop(i, None)
            borders[k].pop(j, None)
            borders[k][following] = borders[following][k] = length
            if not np.isnan(length):
                heapq.heappush(waiting, (-length, k, following))
        following += 1
    return list(pieces.values())


def _common_sides(triangles: NDArray[np.object_]) -> _Borders:
    owners: dict[frozenset[tuple[float, float]], list[int]] = defaultdict(list)
    borders: _Borders = {number: {} for number in range(len(triangles))}
    for number, corners in enumerate(shapely.get_coordinates(triangles).reshape(-1, 4, 2).tolist()):
        ring = [tuple(corner) for corner in corners]
        for a, b in pairwise(ring):
            for other in owners[frozenset((a, b))]:
                borders[number][other] = borders[other][number] = float(np.hypot(a[0] - b[0], a[1] - b[1]))
            owners[frozenset((a, b))].append(number)
    return borders
