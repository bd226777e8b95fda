"""A polygon cut into convex pieces, which is what collision engines understand."""

from __future__ import annotations

import shapely
from shapely.geometry import Polygon

BULGE = 1e-4  # m; by how much a piece may stand out of the polygon


def convex_pieces(polygon: Polygon) -> list[Polygon]:
    """Convex polygons that cover a polygon with corners and holes, and stand out by no more than `BULGE`.

    Triangles that share a side are joined, the longest common side first, as long as the result stays convex
    (the algorithm of Hertel and Mehlhorn, which finds at most four times as many pieces as needed).
    """
    allowed = polygon.buffer(BULGE)
    pieces = list(shapely.get_parts(shapely.constrained_delaunay_triangles(polygon)))
    joined = True
    while joined:
        joined = False
        for _, first, second in sorted(_neighbours(pieces), reverse=True):
            hull = shapely.union(pieces[first], pieces[second]).convex_hull
            if allowed.covers(hull):
                pieces[first] = hull
                del pieces[second]
                joined = True
                break
    return pieces


def _neighbours(pieces: list[Polygon]) -> list[tuple[float, int, int]]:
    """Pairs of pieces with a common side: its length, first, second."""
    found = []
    for first, piece in enumerate(pieces):
        for second in range(first + 1, len(pieces)):
            length = shapely.length(shapely.intersection(piece.boundary, pieces[second].boundary))
            if length > 0:
                found.append((float(length), first, second))
    return found
