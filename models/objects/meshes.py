"""Cell grids from triangle meshes: the silhouette from above, cut into cells."""

from __future__ import annotations

import logging
from os import PathLike
from pathlib import Path

import numpy as np
import shapely
import trimesh
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from shapely.geometry import Polygon

from models.bounded_files import UnreadableFile, check_file
from models.objects.footprints import cells_from_polygon
from models.physics.cell_grid import CellGrid, FloatArray

LARGEST_EXTENT = 5.0
"""A footprint wider than this (m) is taken for a mesh in millimetres or inches."""

SMALLEST_EXTENT = 1e-3
"""A footprint narrower than this (m) is taken for one in a wrong unit too."""

LARGEST_FILE = 256 * 2**20
"""Bytes of a mesh's file; five million triangles as STL."""

_SNAP = 1e-7  # of the silhouette's extent
_SPECK = 1e-5  # of the silhouette's area


def cells_from_mesh(
    mesh: trimesh.Trimesh | str | PathLike[str],
    *,
    count: int | None = None,
    width: float | None = None,
    up: ArrayLike = (0, 0, 1),
    metres_per_unit: float | None = None,
) -> CellGrid:
    """Cell grid of a mesh's silhouette on the support plane (lines 1 and 2 of Algorithm 4).

    Triangles are projected along `up` and united, so overhanging parts belong to the footprint, as they do
    when a camera looks from above. With `up` = z the object frame is the mesh frame's x and y. Any other
    `up` is first turned to z by the smallest rotation (about x for -z), and the frame is the x and y after
    that.

    Args:
        mesh: a mesh, or the path of a file that trimesh can load; the parts of a scene are taken together.
        count: wanted number of cells, as in `cells_from_polygon`; or else
        width: side of a cell, m.
        up: (3,) direction away from the table, in the mesh frame.
        metres_per_unit: length of the mesh's unit; as stated in the file where missing, else 1.

    Raises:
        ValueError: a file that cannot be read, a mesh without triangles or with vertices that are not finite,
            a silhouette without area, in separate parts, wider than 5 m or narrower than 1 mm, or a wrong up,
            unit, count or width.
    """
    loaded, source = _loaded(mesh)
    vertices = np.asarray(loaded.vertices, dtype=float) * _unit(loaded, metres_per_unit, source)
    flat = (vertices @ _turn_to_z(up).T)[:, :2]
    extent = float(np.ptp(flat, axis=0).max())
    if extent > LARGEST_EXTENT:
        raise ValueError(
            f"{source}: the footprint measures {extent:.4g} m, more than {LARGEST_EXTENT:.4g} m; if the mesh "
            f"is in millimetres, give metres_per_unit=0.001"
        )
    if extent < SMALLEST_EXTENT:
        raise ValueError(
            f"{source}: the footprint measures {extent:.4g} m, less than {SMALLEST_EXTENT:.4g} m; "
            f"metres_per_unit is the length of the mesh's unit in m, 0.001 for millimetres"
        )
    polygon = _silhouette(flat[np.asarray(loaded.faces)], extent, bool(loaded.is_volume), source)
    area = polygon.area
    holes = [ring for ring in polygon.interiors if Polygon(ring).area > _SPECK * area]
    rings = [np.asarray(ring.coords)[:-1] for ring in (polygon.exterior, *holes)]
    return cells_from_polygon(rings[0], rings[1:], count=count, width=width)


def upright_mesh(
    path: str | PathLike[str], up: ArrayLike = (0, 0, 1), metres_per_unit: float | None = None
) -> trimesh.Trimesh:
    """The mesh of a file in m, turned like its cells and set down on z = 0; arguments as `cells_from_mesh`.

    Raises:
        ValueError: a file that cannot be read, or a wrong up or unit.
    """
    loaded, source = _loaded(path)
    mesh = loaded.copy()
    vertices = mesh.vertices * _unit(loaded, metres_per_unit, source) @ _turn_to_z(up).T
    mesh.vertices = vertices - [0.0, 0.0, vertices[:, 2].min()]
    mesh.units = "meters"
    return mesh


def _loaded(mesh: trimesh.Trimesh | str | PathLike[str]) -> tuple[trimesh.Trimesh, str]:
    source = "mesh"
    if isinstance(mesh, str | PathLike):
        source = f"mesh {Path(mesh)}"
        try:
            check_file(Path(mesh), LARGEST_FILE)
            logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # what is wrong is told below
            mesh = trimesh.load_mesh(str(mesh))
        except UnreadableFile as error:
            raise ValueError(f"{source}: {error}") from error
        except Exception as error:  # trimesh's readers raise whatever their parsers do
            raise ValueError(f"{source}: cannot be read as a mesh: {_told(error, Path(mesh))}") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise ValueError(f"{source}: has no triangles; export the object's surface, as .stl, .obj or .ply")
    if not np.all(np.isfinite(mesh.vertices)):
        row = int(np.flatnonzero(~np.isfinite(mesh.vertices).all(axis=1))[0])
        raise ValueError(f"{source}: vertex {row} is not finite")
    return mesh, source


def _told(error: Exception, path: Path) -> str:
    """What a reader that failed means."""
    if not isinstance(error, ImportError):
        said = " ".join(str(error).split())
        said = said if len(said) <= 200 else f"{said[:197]}..."
        return f"{said}; export it once more, as .stl, .obj or .ply"
    if "charset_normalizer" in str(error):  # asked for where a file is neither binary nor plain text
        return "it is damaged or cut short, or no mesh; export it once more"
    return f"files that end in {path.suffix} need a further library; export it as .stl, .obj or .ply"


def _unit(mesh: trimesh.Trimesh, metres_per_unit: float | None, source: str) -> float:
    if metres_per_unit is None:
        return 1.0 if mesh.units is None else float(trimesh.units.unit_conversion(mesh.units, "meters"))
    if not (np.isfinite(metres_per_unit) and metres_per_unit > 0):
        raise ValueError(f"{source}: metres_per_unit must be a positive length, got {metres_per_unit}")
    return float(metres_per_unit)


def _turn_to_z(up: ArrayLike) -> FloatArray:
    """(3, 3) smallest rotation that takes `up` to z."""
    direction = np.asarray(up, dtype=float)
    if direction.shape != (3,) or not np.all(np.isfinite(direction)) or np.linalg.norm(direction) == 0:
        raise ValueError(f"mesh: up must be a direction of three finite numbers, not all zero, got {up!r}")
    direction = direction / np.linalg.norm(direction)
    axis = np.cross(direction, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    axis = axis / sine if sine > 1e-12 else np.array([1.0, 0.0, 0.0])
    return Rotation.from_rotvec(np.arctan2(sine, direction[2]) * axis).as_matrix()


def _silhouette(triangles: FloatArray, extent: float, closed: bool, source: str) -> Polygon:
    """Union of projected triangles (t, 3, 2)."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    twice_area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    # The upper side of a closed mesh covers its silhouette; of an open one the sides may face anywhere.
    seen = twice_area if closed else np.abs(twice_area)
    union = shapely.union_all(shapely.polygons(triangles[seen > (_SNAP * extent) ** 2]))
    parts = [p for p in getattr(union, "geoms", [union]) if p.area > _SPECK * union.area]
    if len(parts) == 0:
        raise ValueError(f"{source}: the silhouette along `up` has no area")
    if len(parts) > 1:
        boxes = ", ".join(str(np.round(p.bounds, 4).tolist()) for p in parts)
        raise ValueError(
            f"{source}: the silhouette falls into {len(parts)} separate parts (x_min, y_min, x_max, y_max in "
            f"m: {boxes}); an object is one connected piece"
        )
    outline = parts[0].simplify(_SNAP * extent)
    assert isinstance(outline, Polygon)
    return outline
