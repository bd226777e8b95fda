"""Where an object ends in a height picture, to a fraction of a pixel.

The border of the object's pixels is a staircase. The heights know more: along a line across an edge they
fall from the object's to the table's, and cross half of it where the edge is. Points found so are replaced
by the straight lines that fit them best. Two things that a picture does to an edge are undone:

- Blur cuts corners: a square one is passed at 0.8 standard deviations of it. A short edge between two long
  ones that meet just outside of it becomes their corner.
- An edge with a rounded top seems to lie too far inside, since there half the height is reached. A fall
  that is wider than blur and the sight of a flank make it tells of this: the fall of a quarter of a circle
  of radius r has a mean of 0.215 r inside its foot, and a standard deviation of 0.223 r.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d, median_filter
from scipy.spatial import cKDTree
from shapely.geometry import LinearRing, Polygon

from models.objects.tracing import border_middles, straightened, traced_outline
from models.perception.camera import View
from models.perception.object_mask import HeightPicture, Mask
from models.perception.table_plane import TablePlane
from models.physics.cell_grid import FloatArray

INSETS = np.array([1.0, 2.0, 3.0])
"""Pixels inside an edge; the highest of the heights there is that of the edge."""

_SPECK = 0.01  # of the object's area; smaller holes are noise
_ACROSS = np.arange(-5.0, 4.01, 0.25)  # pixels along a line across the edge, outwards
_FARTHEST = 1.5  # pixels by which a point is moved
_ROUNDS = 2
_TURNING = 1.5  # points over which the border's direction is averaged
_STRIP = 0.5  # pixels; the half width of the strip in which an edge is straight
_SHARPEST = 10.0  # percentile of the falls along a ring that is taken for the picture's blur,
_BLUR = 1.1**2, 1.2**2  # but no less and no more than this variance, pixels²
_DOUBT = 1.5e-3  # m pixels²; over the edge's height: by how much noise may widen the fall
_QUARTILES = 1.349  # distance between the quartiles of a normal distribution, in standard deviations
_INSIDE = 0.9  # standard deviations by which the middle of a rounded fall lies inside its foot
_MOST_ROUND = 1.0  # pixels²
_ALONG = 11  # points over which the width of the fall is a median
_CUT = 4.0  # pixels; a longer edge is no cut corner
_CORNER = 1.0  # pixels from where blur passes a corner to the corner
_SQUARE = np.sin(np.deg2rad(30.0))  # flatter corners are not cut visibly


class Ring(NamedTuple):
    """One ring of an object in the picture: corners (k, 2), column and row.

    Attributes:
        edge: where the picture has half the object's height, as trackers see it.
        foot: where the object ends, farther out where its edge is rounded.
    """

    edge: LinearRing
    foot: LinearRing


def contour(mask: Mask, heights: HeightPicture, plane: TablePlane, view: View) -> list[Ring]:
    """Rings of the object, the exterior first; openings below 1 % of the object's area are left out.

    Args:
        mask: (H, W) pixels of the object, in one piece.
        heights: smoothed heights.
        plane: the table.
        view: the camera.
    """
    rings = []
    for k, points in enumerate(border_middles(mask)[0]):
        if k and Polygon(points).area <= _SPECK * mask.sum():
            continue
        for _ in range(_ROUNDS):
            normals = _normals(points, outer=k == 0)
            shift = _crossings(points, normals, heights, (0.5,))[0]
            points = points + np.clip(np.nan_to_num(shift), -_FARTHEST, _FARTHEST)[:, None] * normals
        normals = _normals(points, outer=k == 0)
        inside = _INSIDE * np.sqrt(np.clip(_roundness(points, normals, heights, plane, view), 0, _MOST_ROUND))
        rings.append(Ring(_cornered(points), _cornered(points + inside[:, None] * normals)))
    if all(Polygon(side[0], side[1:]).is_valid for side in zip(*rings, strict=True)):
        return rings
    traced = traced_outline(mask)  # too small for lines, a few pixels wide
    large = [hole for hole in traced.interiors if Polygon(hole).area > _SPECK * mask.sum()]
    return [Ring(ring, ring) for ring in (traced.exterior, *large)]


def edge_heights(points: FloatArray, normals: FloatArray, heights: HeightPicture) -> FloatArray:
    """(m,) height of the object beside points (m, 2) of its border with outward normals, m."""
    return along_ring(heights.at(points[:, None, :] - INSETS[:, None] * normals[:, None, :]))


def along_ring(heights: FloatArray) -> FloatArray:
    """(m,) highest of heights (m, k) at each point of a ring, smoothed along it; missing ones count as 0."""
    highest = np.nanmax(np.column_stack([heights, np.zeros(len(heights))]), axis=1)
    return median_filter(highest, size=min(9, len(highest)), mode="wrap")


def _normals(points: FloatArray, *, outer: bool) -> FloatArray:
    """(m, 2) unit vectors out of the object at the points of a ring."""
    along = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    along = gaussian_filter1d(along, min(_TURNING, len(points) / 8), axis=0, mode="wrap")
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    sense = 1.0 if LinearRing(points).is_ccw == outer else -1.0
    return sense * np.column_stack([along[:, 1], -along[:, 0]])


def _crossings(
    points: FloatArray, normals: FloatArray, heights: HeightPicture, levels: tuple[float, ...]
) -> FloatArray:
    """(levels, m) pixels outwards from each point to where the height falls below a share of the edge's,
    nearest to the point; NaN where it does not."""
    edge = np.maximum(edge_heights(points, normals, heights), 1e-4)
    fall = heights.at(points[:, None, :] + _ACROSS[:, None] * normals[:, None, :]) / edge[:, None]
    found = np.empty((len(levels), len(points)))
    for row, level in zip(found, levels, strict=True):
        above, below = fall[:, :-1] - level, fall[:, 1:] - level
        crosses = (above >= 0) & (below < 0)
        share = np.divide(above, above - below, out=np.zeros_like(above), where=crosses)
        place = np.where(crosses, _ACROSS[:-1] + share * np.diff(_ACROSS), np.inf)
        nearest = np.abs(place).argmin(axis=1)
        row[:] = place[np.arange(len(points)), nearest]
    return np.where(np.isfinite(found), found, np.nan)


def _roundness(
    points: FloatArray, normals: FloatArray, heights: HeightPicture, plane: TablePlane, view: View
) -> FloatArray:
    """(m,) variance of the fall beyond what blur and an upright flank make, pixels²; 0 where unknown."""
    outside, inside = _crossings(points, normals, heights, (0.25, 0.75))
    foot = plane.meet(points, 0.0, view)
    beyond = plane.meet(points + normals, 0.0, view) - foot
    pixel = np.linalg.norm(beyond, axis=1)
    towards_camera = np.sum((view.p_WC[:2] - foot) * beyond, axis=1) / pixel
    top = edge_heights(points, normals, heights)
    flank = np.maximum(towards_camera, 0.0) * top / (view.p_WC[2] - top) / pixel
    variance = ((outside - inside) / _QUARTILES) ** 2 - flank**2 / 12
    known = np.isfinite(variance)
    blur = np.clip(np.percentile(variance[known], _SHARPEST), *_BLUR) if known.any() else _BLUR[0]
    excess = np.where(known, variance - blur - _DOUBT / np.maximum(top, 1e-3), 0.0)
    return median_filter(excess, size=min(_ALONG, len(points)), mode="wrap")


def _cornered(points: FloatArray) -> LinearRing:
    """The ring of straight lines that fit points (m, 2), with corners where blur has cut them."""
    polygon = Polygon(points)
    if not polygon.is_valid:
        return polygon.exterior
    kept = polygon.simplify(_STRIP)
    assert isinstance(kept, Polygon)
    corners = list(straightened(points, kept.exterior))
    passed = cKDTree(points)
    while len(corners) > 4:
        restored = _with_a_corner_more(np.array(corners), passed)
        if restored is None:
            break
        corners = restored
    return LinearRing(corners)


def _with_a_corner_more(corners: FloatArray, passed: cKDTree) -> list[FloatArray] | None:
    """Corners (k, 2) with the shortest cut replaced by one corner, or None where there is no cut.

    `passed` are the points to which the lines were fitted.
    """
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    for k in np.argsort(lengths):
        if lengths[k] > _CUT:
            return None
        before, after = (k - 1) % len(corners), (k + 1) % len(corners)
        a, b = sides[before] / lengths[before], sides[after] / lengths[after]
        turn = a[0] * b[1] - a[1] * b[0]
        if abs(turn) < _SQUARE:
            continue
        cut = sides[k]
        onwards = (cut[0] * b[1] - cut[1] * b[0]) / turn
        backwards = -(cut[0] * a[1] - cut[1] * a[0]) / turn
        if onwards < 0 or backwards < 0:
            continue
        corner = corners[k] + onwards * a
        if passed.query(corner)[0] < _CORNER:
            restored = list(corners)
            restored[k] = corner
            del restored[after]
            return restored
    return None
