"""From the object's pixels to its footprint: an outline in the world, right also for tall objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from scipy.ndimage import gaussian_filter1d
from shapely.geometry import LinearRing, Polygon

from models.perception.camera import View, pixel_size
from models.perception.edge_contour import along_ring, contour, edge_heights
from models.perception.object_mask import HeightPicture, Heights, Mask
from models.perception.table_plane import TablePlane
from models.physics.cell_grid import FloatArray

_RIM = 0.75  # pixels inside the outline, where the edge's own height is read

_RIPPLE = 4.0  # points of the outline over which its direction is averaged
_SPACING = 1.5  # pixels between points of the outline
_STRAIGHT = 0.15  # pixels; corners that leave the outline by less are dropped


@dataclass(frozen=True, eq=False)
class Outline:
    """Points along the object's outline.

    Attributes:
        points: (m, 2) m.
        normals: (m, 2) unit vectors out of the object.
        heights: (m,) of the object's edge over the table there, m.
    """

    points: FloatArray
    normals: FloatArray
    heights: FloatArray


class Footprint(NamedTuple):
    """What an object covers of the table, in W, m.

    Attributes:
        polygon: where the object ends.
        edge: where the picture shows its edge, which is farther inside where that is rounded.
        outline: points along the rings of `edge`.
    """

    polygon: Polygon
    edge: Polygon
    outline: Outline


def footprint(mask: Mask, heights: Heights, raw: Heights, plane: TablePlane, view: View) -> Footprint:
    """Outline of the object in W and the height of its edges.

    The outline in the picture is that of `contour`. Each of its points is carried to the world at the height
    at which the object is seen there, not at the table's: a top 100 mm high seen 0.4 m off the axis would
    otherwise seem moved by 40 mm.

    Args:
        mask: (H, W) pixels of the object, in one piece.
        heights: (H, W) smoothed heights, m.
        raw: (H, W) heights before smoothing, m, with sharp edges.
        plane: the table.
        view: the camera.
    """
    pictures = HeightPicture(heights), HeightPicture(raw)
    rings = contour(mask, pictures[0], plane, view)
    feet, edges = (
        [_in_world(ring, k == 0, *pictures, plane, view) for k, ring in enumerate(side)]
        for side in ([ring.foot for ring in rings], [ring.edge for ring in rings])
    )
    outline = Outline(
        *(np.concatenate([getattr(e, n) for e in edges]) for n in ("points", "normals", "heights"))
    )
    return Footprint(_polygon(feet, view), _polygon(edges, view), outline)


def _polygon(rings: list[Outline], view: View) -> Polygon:
    shape = _simple(Polygon(rings[0].points, [ring.points for ring in rings[1:]]))
    return _simple(shape.simplify(_STRAIGHT * pixel_size(view)))


def _in_world(
    ring: LinearRing,
    outer: bool,
    smoothed: HeightPicture,
    sharp: HeightPicture,
    plane: TablePlane,
    view: View,
) -> Outline:
    pixels, normals = _points_along(ring, outer=outer, begin=0.0)
    # Which side an edge faces must not change with every ripple of the traced outline.
    normals = gaussian_filter1d(normals, min(_RIPPLE, len(normals) / 8), axis=0, mode="wrap")
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return _carried(pixels, normals, smoothed, sharp, plane, view)


def outline_of(polygon: Polygon, spacing: float) -> tuple[FloatArray, FloatArray]:
    """Points (m, 2) about `spacing` apart along all rings of a polygon, and normals (m, 2) out of it."""
    parts = [_points_along(polygon.exterior, outer=True, spacing=spacing)]
    parts += [_points_along(ring, outer=False, spacing=spacing) for ring in polygon.interiors]
    points, normals = zip(*parts, strict=True)
    return np.concatenate(points), np.concatenate(normals)


def _points_along(
    ring: LinearRing, *, outer: bool, spacing: float = _SPACING, begin: float = 0.5
) -> tuple[FloatArray, FloatArray]:
    """Points and their outward normals, on each side the first one `begin` spacings from its corner."""
    corners = np.asarray(ring.coords)[:-1, :2]
    if ring.is_ccw != outer:
        corners = corners[::-1]  # the object lies to the left
    points, normals = [], []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        length = float(np.hypot(*(b - a)))
        if length == 0:
            continue
        number = max(1, round(length / spacing))
        share = (np.arange(number) + begin) / number
        points.append(a + share[:, None] * (b - a))
        normals.append(np.tile(np.array([b[1] - a[1], a[0] - b[0]]) / length, (number, 1)))
    return np.concatenate(points), np.concatenate(normals)


def _carried(
    pixels: FloatArray,
    normals: FloatArray,
    smoothed: HeightPicture,
    sharp: HeightPicture,
    plane: TablePlane,
    view: View,
) -> Outline:
    """Points of one ring in pixels, with their normals, as an outline in W."""
    edge = edge_heights(pixels, normals, smoothed)
    rim = sharp.at(pixels - _RIM * normals)
    rim = along_ring(np.where(np.isfinite(rim), rim, edge)[:, None])  # upright, unless seen to be rounded
    foot = plane.meet(pixels, 0.0, view)
    beyond = plane.meet(pixels + normals, 0.0, view) - foot
    outward = beyond / np.linalg.norm(beyond, axis=1, keepdims=True)
    # On the far side the top hides the foot, and the edge lies on the ray past the rim. On the near side the
    # flank is seen, and the outline is where it is half as high as the object.
    far = np.sum((foot - view.p_WC[:2]) * outward, axis=1) > 0
    seen_at = np.where(far, np.maximum(rim, edge / 2), edge / 2)
    return Outline(plane.meet(pixels, seen_at, view), outward, edge)


def _simple(shape: shapely.Geometry) -> Polygon:
    """The largest part of a shape whose rings may have crossed themselves by a pixel."""
    valid = shapely.make_valid(shape, method="structure", keep_collapsed=False)
    parts = [part for part in shapely.get_parts(valid) if isinstance(part, Polygon)]
    return max(parts, key=lambda part: part.area)
