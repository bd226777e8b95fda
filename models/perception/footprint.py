"""From the object's pixels to its footprint: an outline in the world, right also for tall objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from scipy.ndimage import gaussian_filter1d, median_filter
from shapely.geometry import LinearRing, Polygon

from models.objects.tracing import traced_outline
from models.perception.camera import View, pixel_size
from models.perception.object_mask import HeightPicture, Heights, Mask
from models.perception.table_plane import TablePlane
from models.physics.cell_grid import FloatArray

_INSETS = np.array([1.0, 2.0, 3.0])  # pixels; the highest of the heights this far inside is that of the edge
_RIM = 0.75  # pixels inside the outline, where the edge's own height is read

_SPECK = 0.01  # of the object's area; smaller holes are noise
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


def footprint(
    mask: Mask, heights: Heights, raw: Heights, plane: TablePlane, view: View
) -> tuple[Polygon, Outline]:
    """Outline of the object in W and the height of its edges.

    The pixels' outline is that of `traced_outline`. Each of its points is carried to the world at the height
    at which the object is seen there, not at the table's: a top 100 mm high seen 0.4 m off the axis would
    otherwise seem moved by 40 mm.

    Args:
        mask: (H, W) pixels of the object, in one piece.
        heights: (H, W) smoothed heights, m.
        raw: (H, W) heights before smoothing, m, with sharp edges.
        plane: the table.
        view: the camera.

    Returns:
        Polygon in W, m, holes below 1 % of the area left out, and points along its rings.
    """
    polygon = traced_outline(mask)
    pictures = HeightPicture(heights), HeightPicture(raw)
    rings = [polygon.exterior, *(h for h in polygon.interiors if Polygon(h).area > _SPECK * mask.sum())]
    traced = []
    for k, ring in enumerate(rings):
        pixels, normals = _points_along(ring, outer=k == 0)
        # Which side an edge faces must not change with every ripple of the traced outline.
        normals = gaussian_filter1d(normals, min(_RIPPLE, len(normals) / 8), axis=0, mode="wrap")
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        traced.append(_carried(pixels, normals, *pictures, plane, view))
    outline = Outline(
        *(np.concatenate([getattr(t, n) for t in traced]) for n in ("points", "normals", "heights"))
    )
    shape = _simple(Polygon(traced[0].points, [t.points for t in traced[1:]]))
    return _simple(shape.simplify(_STRAIGHT * pixel_size(view))), outline


def outline_of(polygon: Polygon, spacing: float) -> tuple[FloatArray, FloatArray]:
    """Points (m, 2) about `spacing` apart along all rings of a polygon, and normals (m, 2) out of it."""
    parts = [_points_along(polygon.exterior, outer=True, spacing=spacing)]
    parts += [_points_along(ring, outer=False, spacing=spacing) for ring in polygon.interiors]
    points, normals = zip(*parts, strict=True)
    return np.concatenate(points), np.concatenate(normals)


def _points_along(
    ring: LinearRing, *, outer: bool, spacing: float = _SPACING
) -> tuple[FloatArray, FloatArray]:
    corners = np.asarray(ring.coords)[:-1, :2]
    if ring.is_ccw != outer:
        corners = corners[::-1]  # the object lies to the left
    points, normals = [], []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        length = float(np.hypot(*(b - a)))
        if length == 0:
            continue
        number = max(1, round(length / spacing))
        share = (np.arange(number) + 0.5) / number
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
    edge = _filtered(smoothed.at(pixels[:, None, :] - _INSETS[:, None] * normals[:, None, :]))
    rim = sharp.at(pixels - _RIM * normals)
    rim = _filtered(np.where(np.isfinite(rim), rim, edge)[:, None])  # upright, unless seen to be rounded
    foot = plane.meet(pixels, 0.0, view)
    beyond = plane.meet(pixels + normals, 0.0, view) - foot
    outward = beyond / np.linalg.norm(beyond, axis=1, keepdims=True)
    # On the far side the top hides the foot, and the edge lies on the ray past the rim. On the near side the
    # flank is seen, and the outline is where it is half as high as the object.
    far = np.sum((foot - view.p_WC[:2]) * outward, axis=1) > 0
    seen_at = np.where(far, np.maximum(rim, edge / 2), edge / 2)
    return Outline(plane.meet(pixels, seen_at, view), outward, edge)


def _filtered(heights: FloatArray) -> FloatArray:
    """(m,) highest of heights (m, k) at each point of a ring, smoothed along it; missing ones count as 0."""
    highest = np.nanmax(np.column_stack([heights, np.zeros(len(heights))]), axis=1)
    return median_filter(highest, size=min(9, len(highest)), mode="wrap")


def _simple(shape: shapely.Geometry) -> Polygon:
    """The largest part of a shape whose rings may have crossed themselves by a pixel."""
    valid = shapely.make_valid(shape, method="structure", keep_collapsed=False)
    parts = [part for part in shapely.get_parts(valid) if isinstance(part, Polygon)]
    return max(parts, key=lambda part: part.area)
