"""Solids over an outline whose edges are rounded, for pictures and cameras."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import shapely
import trimesh
from numpy.typing import ArrayLike, NDArray
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from models.physics.cell_grid import FloatArray

_ROUND_STEPS = 6


def lofted(outline: BaseGeometry, profile: Sequence[tuple[float, float]]) -> trimesh.Trimesh:
    """Solid that stands on an outline and draws in with height.

    Args:
        outline: footprint of one or more polygons, concave or with holes too, m.
        profile: rows (inset, z) from below to the top, neither falling: at height z the cross-section is the
            outline less a rim of the width `inset`. Rows at which nothing is left are passed over.
    """
    sections = [(_inset(outline, inset), inset, z) for inset, z in profile]
    sections = [section for section in sections if not section[0].is_empty]
    triangles = [_cap(sections[0][0], sections[0][2])[:, ::-1]]
    for (lower, a, z0), (upper, b, z1) in pairwise(sections):
        triangles.append(_wall(lower, z0, z1) if a == b else _slope(lower, upper, z0, z1))
    triangles.append(_cap(sections[-1][0], sections[-1][2]))
    soup = np.concatenate(triangles)
    mesh = trimesh.Trimesh(soup.reshape(-1, 3), np.arange(3 * len(soup)).reshape(-1, 3), process=False)
    mesh.merge_vertices()
    return mesh


def rounded(
    height: float, edge: float, rise: float | None = None, base: float = 0.0
) -> list[tuple[float, float]]:
    """Profile of a slab from `base` to `height` whose upper edge is a quarter of an ellipse.

    Args:
        height: of the top, m.
        edge: width of the rounding, m.
        rise: its height, m; as wide where missing.
        base: height of the underside, m.
    """
    rise = min(edge if rise is None else rise, height - base)
    angles = np.linspace(0.0, np.pi / 2, _ROUND_STEPS + 1)
    arc = [(float(edge * (1 - np.cos(a))), float(height - rise * (1 - np.sin(a)))) for a in angles]
    return [(0.0, base), *arc] if rise < height - base else arc


def coloured(parts: Sequence[tuple[trimesh.Trimesh, ArrayLike]]) -> trimesh.Trimesh:
    """One mesh of several, each with one colour (r, g, b, a from 0 to 1) on its faces."""
    vertices = np.concatenate([part.vertices for part, _ in parts])
    starts = np.cumsum([0, *(len(part.vertices) for part, _ in parts)])
    faces = np.concatenate([part.faces + start for (part, _), start in zip(parts, starts, strict=False)])
    colours = np.concatenate([np.tile(_bytes(colour), (len(part.faces), 1)) for part, colour in parts])
    return trimesh.Trimesh(vertices, faces, face_colors=colours, process=False)


def height_over(mesh: trimesh.Trimesh, points: FloatArray) -> FloatArray:
    """(k,) greatest z of a mesh on the vertical through each point (k, 2), m; NaN where there is no mesh."""
    corners = np.asarray(mesh.triangles)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    e, f = b - a, c - a
    area = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]
    flat = np.abs(area) > 1e-14
    a, e, f, area = a[flat], e[flat], f[flat], area[flat]
    offset = points[:, None, :] - a[None, :, :2]
    u = (offset[..., 0] * f[:, 1] - offset[..., 1] * f[:, 0]) / area
    v = (e[:, 0] * offset[..., 1] - e[:, 1] * offset[..., 0]) / area
    inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
    z = np.where(inside, a[:, 2] + u * e[:, 2] + v * f[:, 2], -np.inf).max(axis=1)
    return np.where(np.isfinite(z), z, np.nan)


def _inset(outline: BaseGeometry, inset: float) -> BaseGeometry:
    # Rounded at re-entrant corners, so that a rim of one width stays free everywhere.
    return outline if inset == 0 else outline.buffer(-inset, quad_segs=4)


def _cap(section: BaseGeometry, z: float) -> FloatArray:
    flat = _triangles(section)
    return np.concatenate([flat, np.full((*flat.shape[:2], 1), z)], axis=2)


def _wall(section: BaseGeometry, z0: float, z1: float) -> FloatArray:
    quads = []
    for polygon in _polygons(section):
        oriented = shapely.orient_polygons(polygon)
        for ring in (oriented.exterior, *oriented.interiors):
            points = np.asarray(ring.coords)
            low, high = (np.column_stack([points, np.full(len(points), z)]) for z in (z0, z1))
            quads.append(np.stack([low[:-1], low[1:], high[1:]], axis=1))
            quads.append(np.stack([low[:-1], high[1:], high[:-1]], axis=1))
    return np.concatenate(quads)


def _slope(lower: BaseGeometry, upper: BaseGeometry, z0: float, z1: float) -> FloatArray:
    flat = _triangles(shapely.difference(lower, upper))
    above = {tuple(point) for point in np.round(shapely.get_coordinates(upper), 9)}
    z = [z1 if tuple(point) in above else z0 for point in np.round(flat.reshape(-1, 2), 9)]
    return np.concatenate([flat, np.reshape(z, (*flat.shape[:2], 1))], axis=2)


def _triangles(section: BaseGeometry) -> FloatArray:
    """(t, 3, 2) triangles between a section's corners, counter-clockwise."""
    found = [shapely.constrained_delaunay_triangles(polygon) for polygon in _polygons(section)]
    corners = shapely.get_coordinates(shapely.get_parts(found)).reshape(-1, 4, 2)[:, :3]
    e, f = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    clockwise = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0] < 0
    corners[clockwise] = corners[clockwise][:, ::-1]
    return corners


def _polygons(section: BaseGeometry) -> list[Polygon]:
    return [p for p in shapely.get_parts(section) if isinstance(p, Polygon) and not p.is_empty]


def _bytes(colour: ArrayLike) -> NDArray[np.uint8]:
    return np.round(255 * np.asarray(colour, dtype=float)).astype(np.uint8)
