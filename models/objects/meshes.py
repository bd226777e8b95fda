"""Triangle meshes: reading them, or a link of a URDF or SDF, upright and in metres; cell grids from
silhouettes, solids over an outline, and OBJ text with normals for renderers."""

import logging
import re
import warnings
from collections.abc import Sequence
from itertools import pairwise
from os import PathLike
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from slipmap.models.files import UnreadableFile, check_file, read_bounded, undisturbed
from slipmap.models.geometry import cross
from slipmap.models.objects.footprints import cells_from_polygon, rings_of, without_small_holes
from slipmap.models.physics.cell_grid import CellGrid, FloatArray

with undisturbed():  # it takes a Ctrl-C for a library that is missing, and goes on
    import trimesh

LARGEST_EXTENT = 5.0
"""A footprint wider than this (m) is refused: the mesh is probably in millimetres or inches."""

SMALLEST_EXTENT = 1e-3  # a footprint narrower than this (m) is refused: its unit is probably wrong too
DOUBTFUL_EXTENT = 1.0  # a footprint wider than this (m) raises doubt about the unit

DIRECTIONS = {
    f"{sign}{axis}": tuple(float(f"{sign}{int(axis == other)}") for other in "xyz")
    for sign in ("", "-")
    for axis in "xyz"
}
"""Unit vectors by name: x, y, z, -x, -y, -z."""

_UNITS = {"mm": 0.001, "cm": 0.01, "inch": 0.0254, "m": 1.0}

_LINKS = (".urdf", ".sdf")
_LARGEST_LINK = 16 * 2**20  # bytes of a URDF or SDF
_GAPS = (0.002, 0.005, 0.01, 0.02)  # of the silhouette's extent; wider gaps part two objects
_MOST_PARTS = 200  # of a convex decomposition; the time to close its gaps grows with the square
_BOXES = 5  # parts that an error lists
_LARGEST_FILE = 256 * 2**20  # bytes; five million triangles as STL
_SNAP = 1e-7  # of the silhouette's extent
_FINEST = 1e-5  # of the silhouette's extent; a point nearer to the line between corners is not a corner
_SPECK = 1e-5  # of the silhouette's area
_PARALLEL = 1.0 - 1e-6  # cosine between the normals of triangles in one plane,
_LEVEL = 3e-5  # of the mesh's size, the distance of their corners from it
_MOST_FOLDED = 100  # planes with triangles that lie on each other; a mesh with more is a scan,
_LARGEST_FOLDED = 200_000  # as is one with more triangles
_CREASE = np.deg2rad(35.0)  # faces that meet at a larger angle form a visible edge
_ROUND_STEPS = 6
_MOST_COLOURS = 16


def cells_from_mesh(
    mesh: trimesh.Trimesh | str | PathLike[str],
    *,
    count: int | None = None,
    width: float | None = None,
    up: ArrayLike | None = None,
    metres_per_unit: float | None = None,
) -> CellGrid:
    """Cell grid of a mesh's silhouette on the support plane (lines 1 and 2 of Algorithm 4).

    Triangles are projected along `up` and united, so overhanging parts belong to the footprint, as in a
    camera's view from above. With `up` = z the object frame has the mesh frame's x and y. Any other `up` is
    first turned to z by the smallest rotation (about x for -z); x and y are those of the turned mesh.

    Args:
        mesh: a mesh, or the path of a file that trimesh can load, or of a URDF or SDF with one link that has
            geometry; the parts of a scene or link are merged, and gaps of up to 2 % of its size closed,
            with slots that run into them.
        count: wanted number of cells, as in `cells_from_polygon`. Without it and `width`
            there are about 60.
        width: side of a cell, m.
        up: (3,) direction away from the table, in the mesh frame; by default that of the file's format.
        metres_per_unit: length of the mesh's unit; by default as stated in the file, else 1.

    Raises:
        ValueError: the file cannot be read; the mesh has no triangles, or vertices that are not finite; the
            silhouette has no area, is in separate parts, wider than 5 m or narrower than 1 mm; or up, unit,
            count or width is wrong.

    Example:
        >>> import slipmap
        >>> import trimesh
        >>> grid = slipmap.cells_from_mesh(trimesh.creation.box((0.1, 0.06, 0.04)), count=15)
        >>> len(grid), round(grid.width, 4)
        (15, 0.02)
    """
    loaded, source = _loaded(mesh)
    in_file = not isinstance(mesh, trimesh.Trimesh)
    vertices, extent, unit = _upright(loaded, source, up_axis(mesh) if in_file else "z", up, metres_per_unit)
    if in_file and extent > DOUBTFUL_EXTENT:
        advice = unit_advice(extent, unit)
        warnings.warn(f"{source}: is {extent:.3g} m wide; if that is wrong, {advice}", stacklevel=2)
    polygon = _silhouette(vertices[loaded.faces, :2], extent, bool(loaded.is_volume), source)
    rings = rings_of(without_small_holes(polygon, _SPECK * polygon.area))
    return cells_from_polygon(*rings, count=count, width=width)


def unit_advice(extent: float, unit: float) -> str:
    """Advice on which unit would give a mesh a plausible size for an object on a table.

    Args:
        extent: m, with the present unit.
        unit: m.
    """
    sizes = {name: (metres, extent / unit * metres) for name, metres in _UNITS.items() if metres != unit}
    fitting = [
        f"metres_per_unit={metres:g} ({name}) gives {1e3 * size:.3g} mm"
        for name, (metres, size) in sizes.items()
        if 0.005 <= size <= DOUBTFUL_EXTENT
    ]
    if not fitting:
        return "no common unit gives it a size that suits a table; is it the right file?"
    return f"what is the mesh's unit? {', '.join(fitting)}"


def up_axis(path: str | PathLike[str]) -> str:
    """A key of `DIRECTIONS`: y for glTF, as its specification says, the file's own for COLLADA, else z.

    Raises:
        ValueError: the file cannot be read.
    """
    kind = Path(path).suffix.lower()
    if kind in (".glb", ".gltf"):
        return "y"
    if kind == ".dae":
        try:
            named = re.search(rb"<up_axis>\s*([XYZ])_UP", read_bounded(Path(path), _LARGEST_FILE))
        except UnreadableFile as error:
            raise ValueError(f"mesh {path}: {error}") from error
        return named[1].decode().lower() if named else "y"
    return "z"


def upright_mesh(
    path: str | PathLike[str], up: ArrayLike | None = None, metres_per_unit: float | None = None
) -> trimesh.Trimesh:
    """The mesh of a file in m, turned like its cells and resting on z = 0; arguments as in `cells_from_mesh`.

    Raises:
        ValueError: the file cannot be read, up or the unit is wrong, or the footprint is wider than 5 m or
            narrower than 1 mm.
    """
    loaded, source = _loaded(path)
    mesh = loaded.copy()
    vertices, _, _ = _upright(loaded, source, up_axis(path), up, metres_per_unit)
    mesh.vertices = vertices - [0.0, 0.0, vertices[:, 2].min()]
    mesh.units = "meters"
    return mesh


def _upright(
    mesh: trimesh.Trimesh, source: str, axis: str, up: ArrayLike | None, metres_per_unit: float | None
) -> tuple[FloatArray, float, float]:
    """Vertices (v, 3) with `up`, or else `axis`, turned to z, the footprint's larger side, and the unit, m.

    Raises:
        ValueError: up or the unit is wrong, or the side is out of range.
    """
    unit = _unit(mesh, metres_per_unit, source)
    turn = _turn_to_z(DIRECTIONS[axis] if up is None else up)
    vertices = np.asarray(mesh.vertices, dtype=float) * unit @ turn.T
    extent = float(np.ptp(vertices[:, :2], axis=0).max())
    if not SMALLEST_EXTENT <= extent <= LARGEST_EXTENT:
        limit = "more than 5 m" if extent > LARGEST_EXTENT else "less than 1 mm"
        raise ValueError(
            f"{source}: the footprint measures {extent:.4g} m, {limit}; {unit_advice(extent, unit)}"
        )
    return vertices, extent, unit


def _loaded(mesh: trimesh.Trimesh | str | PathLike[str]) -> tuple[trimesh.Trimesh, str]:
    source = "mesh"
    if isinstance(mesh, str | PathLike):
        path = Path(mesh)
        source = f"mesh {path}"
        if path.suffix.lower() in _LINKS:
            try:
                return _linked(path), source
            except (UnreadableFile, ValueError) as error:
                raise ValueError(f"{source}: {error}") from error
        try:
            check_file(path, _LARGEST_FILE)
            logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # the error below says what is wrong
            # A texture does not affect how the object slides, and may be large.
            mesh = trimesh.load_mesh(str(path), skip_materials=True, process=False)
            if isinstance(mesh, trimesh.Trimesh) and np.isfinite(mesh.vertices).all():
                mesh.process()  # of a mesh with NaN, it would leave out triangles without a word
                mesh = _unfolded(mesh)
        except UnreadableFile as error:
            raise ValueError(f"{source}: {error}") from error
        except Exception as error:  # trimesh's readers raise whatever their parsers raise
            raise ValueError(f"{source}: cannot be read as a mesh: {_told(error, path)}") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise ValueError(
            f"{source}: has no triangles, or is cut short; export the object's surface as .stl, .obj or .ply"
        )
    if not np.all(np.isfinite(mesh.vertices)):
        row = int(np.flatnonzero(~np.isfinite(mesh.vertices).all(axis=1))[0])
        raise ValueError(f"{source}: vertex {row} is not finite; export the mesh again")
    return mesh, source


def _unfolded(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with its concave faces cut anew.

    Readers cut a face of many corners into a fan of triangles. If it is concave, some of these lie outside
    it, folded over others, and would widen the silhouette.
    """
    if len(mesh.faces) > _LARGEST_FOLDED:
        return mesh
    normals, vertices, faces = mesh.face_normals, mesh.vertices, mesh.faces
    whole, added = np.ones(len(faces), dtype=bool), list[FloatArray]()
    for face in _folds(mesh):
        if not whole[face]:
            continue
        if len(added) == _MOST_FOLDED:  # the creases of a scan
            return mesh
        basis = _turn_to_z(normals[face])
        flat = (vertices - vertices[faces[face, 0]]) @ basis.T
        level = (np.abs(flat[:, 2]) < _LEVEL * mesh.scale)[faces].all(axis=1) & whole
        whole &= ~level
        cut = _net_area(faces[level], flat[:, :2])
        added.append(np.insert(cut, 2, 0.0, axis=2) @ basis + vertices[faces[face, 0]])
    if sum(map(len, added)) == 0:
        return mesh
    corners = np.concatenate([vertices[faces[whole]], *added]).reshape(-1, 3)
    result = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3))
    if mesh.units is not None:
        result.units = mesh.units
    return result


def _folds(mesh: trimesh.Trimesh) -> list[int]:
    """Faces that lie in the plane of another with the opposite normal, to which flat or thin ones lead."""
    normals, near = mesh.face_normals, _LEVEL * mesh.scale
    offsets = np.sum(normals * mesh.vertices[mesh.faces[:, 0]], axis=1)
    one, other = mesh.face_adjacency.T
    flat = np.abs(np.sum(normals[one] * normals[other], axis=1)) > _PARALLEL
    longest = mesh.edges_unique_length[mesh.faces_unique_edges].max(axis=1)
    thin = ~normals.any(axis=1) | (2 * mesh.area_faces < near * longest)
    leads = flat | thin[one] | thin[other]
    graph = csr_array((np.ones(leads.sum()), (one[leads], other[leads])), shape=(len(normals),) * 2)
    planes = np.column_stack([connected_components(graph, directed=False)[1], normals, offsets / mesh.scale])
    _, first = np.unique(np.round(planes[~thin], 6), axis=0, return_index=True)
    first = np.flatnonzero(~thin)[first]
    found = []
    for group in np.split(first, np.flatnonzero(np.diff(planes[first, 0])) + 1):
        if len(group) > 10 * _MOST_FOLDED:
            continue
        opposite = normals[group] @ normals[group].T < -_PARALLEL
        level = np.abs(offsets[group][:, None] + offsets[group]) < near
        found += group[(opposite & level).any(axis=1)].tolist()
    return found


def _net_area(faces: NDArray[np.integer], points: FloatArray) -> FloatArray:
    """(t, 3, 2) triangles of what faces (f, 3) in a plane cover more often one way than the other."""
    directed = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges, place = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    net = np.bincount(place.ravel(), np.where(directed[:, 0] < directed[:, 1], 1.0, -1.0))
    lines = shapely.union_all(shapely.linestrings(points[edges[net != 0]]))
    corners = points[faces]
    sides = np.roll(corners, -1, axis=1) - corners
    found = [np.zeros((0, 3, 2))]
    for region in shapely.get_parts(shapely.polygonize(shapely.get_parts(lines))):
        inside = cross(sides, shapely.get_coordinates(region.representative_point()) - corners)
        times = (inside > 0).all(axis=1).sum() - (inside < 0).all(axis=1).sum()
        if times != 0:
            found.append(_triangles(region)[:, :: 1 if times > 0 else -1])
    return np.concatenate(found)


def _linked(path: Path) -> trimesh.Trimesh:
    """The only link with geometry of a URDF or SDF, in its own frame, m: its visuals, else its collisions.

    Raises:
        UnreadableFile: the file cannot be read.
        ValueError: it is no XML, has several such links or none, or a geometry that cannot be read.
    """
    text = read_bounded(path, _LARGEST_LINK)
    plain = text.replace(b"\0", b"")  # such as UTF-16 as ASCII
    if b"<!ENTITY" in plain or b"<!DOCTYPE" in plain:
        raise ValueError("declares XML entities, which are never expanded; remove them")
    try:
        root = Xml.fromstring(text)
    except (Xml.ParseError, ValueError, LookupError) as error:
        raise ValueError(f"is not XML: {error}") from error
    links = [link for link in root.iter("link") if link.find("*/geometry") is not None]
    if len(links) != 1:
        names = ", ".join(str(link.get("name")) for link in links) or "none"
        raise ValueError(f"needs one link with geometry, the object; found {names}; leave the others out")
    shapes = links[0].findall("visual") or links[0].findall("collision")
    merged = trimesh.util.concatenate([_shape(shape, path) for shape in shapes])
    merged.units = "meters"
    return merged


def _shape(shape: Xml.Element, path: Path) -> trimesh.Trimesh:
    """The mesh of a visual or collision in the link's frame, m."""
    found = shape.find("geometry/*")
    kind, made = ("nothing", shape) if found is None else (found.tag, found)
    if kind == "mesh":
        if made.find("submesh") is not None:
            raise ValueError("a submesh is not read; export it as its own file")
        name = made.get("filename") or made.findtext("uri") or ""
        file = _beside(path, name.strip())
        if file.suffix.lower() in _LINKS:
            raise ValueError(f"{name}: is no mesh")
        loaded, source = _loaded(file)
        turn = _turn_to_z(DIRECTIONS["y"]) if file.suffix.lower() in (".glb", ".gltf") else np.eye(3)
        scale = _unit(loaded, None, source) * _numbers(made, "scale", 3, "1 1 1")
        mesh = trimesh.Trimesh(scale * (loaded.vertices @ turn.T), loaded.faces, process=False)
    elif kind == "box":
        mesh = trimesh.creation.box(_numbers(made, "size", 3))
    elif kind == "cylinder":
        mesh = trimesh.creation.cylinder(*_numbers(made, "radius", 1), *_numbers(made, "length", 1))
    elif kind == "sphere":
        mesh = trimesh.creation.icosphere(4, *_numbers(made, "radius", 1))
    else:
        raise ValueError(f"a geometry is {kind}; mesh, box, cylinder and sphere are read")
    origin, pose = shape.find("origin"), shape.find("pose")
    if origin is not None:
        place, angles = _numbers(origin, "xyz", 3, "0 0 0"), _numbers(origin, "rpy", 3, "0 0 0")
    elif pose is not None:
        if pose.get("relative_to") or pose.get("degrees", "false") != "false":
            raise ValueError("a pose is relative_to another frame or in degrees; give it in the link's, rad")
        place, angles = np.split(_numbers(shape, "pose", 6, "0 0 0 0 0 0"), 2)
    else:
        place = angles = np.zeros(3)
    mesh.vertices = Rotation.from_euler("xyz", angles).apply(mesh.vertices) + place
    return mesh


def _numbers(element: Xml.Element, name: str, count: int, default: str = "") -> FloatArray:
    """(count,) finite numbers of an attribute (URDF) or an element (SDF)."""
    text = (element.get(name) or element.findtext(name) or "").strip() or default
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise ValueError(f"{element.tag}: {name} needs {count} numbers, got {text[:80]!r}")
    return numbers


def _beside(path: Path, name: str) -> Path:
    """The file that a URDF or SDF names, in its folder or package.

    Raises:
        ValueError: it lies elsewhere, or its links lead in a circle.
    """
    scheme, split, rest = name.partition("://")
    folders = path.resolve().parents
    if split and scheme in ("package", "model"):
        package, _, rest = rest.partition("/")
        inside = next((folder for folder in folders if package and folder.name == package), None)
        base = inside
    else:
        marks = ("package.xml", "model.config")
        inside = next((f for f in folders if any((f / mark).is_file() for mark in marks)), folders[0])
        base, rest = folders[0], name
    try:
        file = None if base is None or "\0" in name or not rest else (base / rest).resolve()
    except (OSError, RuntimeError) as error:
        raise ValueError(f"{name[:200]!r}: there is no such file; check the name") from error
    if (split and scheme not in ("package", "model")) or file is None or not file.is_relative_to(str(inside)):
        raise ValueError(f"{name[:200]!r} is not in the file's folder or package; put the mesh there")
    return file


def _told(error: Exception, path: Path) -> str:
    """Readable text for the error of a failed reader."""
    if isinstance(error, FileNotFoundError):
        return f"it needs the file {error}, which is missing; put it into the same folder, or export as .glb"
    if not isinstance(error, ImportError):
        said = " ".join(str(error).split())
        said = said if len(said) <= 200 else f"{said[:197]}..."
        return f"{said}; export it again as .stl, .obj or .ply"
    if "charset_normalizer" in str(error):  # imported if a file is neither binary nor plain text
        return "it is damaged or cut short, or not a mesh; export it again"
    bring = "`pip install 'slipmap[collada]'`" if path.suffix.lower() == ".dae" else "a further library"
    return f"files that end in {path.suffix} need {bring}; or export the mesh as .stl or .obj"


def _unit(mesh: trimesh.Trimesh, metres_per_unit: float | None, source: str) -> float:
    if metres_per_unit is None:
        return 1.0 if mesh.units is None else float(trimesh.units.unit_conversion(mesh.units, "meters"))
    if not (np.isfinite(metres_per_unit) and metres_per_unit > 0):
        raise ValueError(f"{source}: metres_per_unit must be a positive length, got {metres_per_unit}")
    return float(metres_per_unit)


def _turn_to_z(up: ArrayLike) -> FloatArray:
    """(3, 3) smallest rotation that takes `up` to z."""
    direction = np.zeros(0) if isinstance(up, str) else np.asarray(up, dtype=float)
    if direction.shape != (3,) or not np.all(np.isfinite(direction)) or np.linalg.norm(direction) == 0:
        raise ValueError(f"mesh: up must be a direction of three finite numbers, not all zero, got {up!r}")
    direction = direction / np.linalg.norm(direction)
    axis = np.cross(direction, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    axis = axis / sine if sine > 1e-12 else np.array([1.0, 0.0, 0.0])
    return Rotation.from_rotvec(np.arctan2(sine, direction[2]) * axis).as_matrix()


def _silhouette(triangles: FloatArray, extent: float, closed: bool, source: str) -> Polygon:
    """Union of projected triangles (t, 3, 2)."""
    twice_area = cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    # The upper side of a closed mesh covers its silhouette; the faces of an open one may point anywhere.
    seen = twice_area if closed else np.abs(twice_area)
    union = shapely.union_all(shapely.polygons(triangles[seen > (_SNAP * extent) ** 2]))
    parts = [p for p in getattr(union, "geoms", [union]) if p.area > _SPECK * union.area]
    if len(parts) == 0:
        raise ValueError(f"{source}: the silhouette along `up` has no area")
    if 1 < len(parts) <= _MOST_PARTS and (joined := _joined(parts, extent)) is not None:
        outline, width = joined
        gaps = f"gaps of up to {1e3 * width:.2g} mm between {len(parts)} parts closed"
        warnings.warn(f"{source}: {gaps}, with slots as narrow that run into them", stacklevel=3)
        parts = [outline]
    if len(parts) > 1:
        boxes = ", ".join(str(np.round(p.bounds, 4).tolist()) for p in parts[:_BOXES])
        boxes += ", …" if len(parts) > _BOXES else ""
        raise ValueError(
            f"{source}: the silhouette is in {len(parts)} separate parts (x_min, y_min, x_max, y_max in "
            f"m: {boxes}); an object must be one connected piece"
        )
    outline = parts[0].simplify(_FINEST * extent)
    assert isinstance(outline, Polygon)
    return outline


def _joined(parts: Sequence[Polygon], extent: float) -> tuple[Polygon, float] | None:
    """The parts of a convex decomposition in one piece, and the gaps closed, m; None if they are wider.

    Slots that are as narrow and run into such a gap close with it.
    """
    whole = shapely.union_all(parts)
    for width in extent * np.array(_GAPS):
        closed = whole.buffer(0.5 * width, join_style="mitre").buffer(-0.5 * width, join_style="mitre")
        added = [piece.buffer(_SNAP * extent) for piece in shapely.get_parts(closed.difference(whole))]
        bridges = [piece for piece in added if sum(piece.intersects(part) for part in parts) > 1]
        joined = shapely.union_all([whole, *bridges])
        if isinstance(joined, Polygon):
            return joined, float(width)
    return None


def shaded_obj(mesh: trimesh.Trimesh) -> str:
    """Wavefront OBJ text with a normal at every corner of a face: smooth on curves, sharp at edges."""
    normals, index = np.unique(np.round(_corner_normals(mesh), 4), axis=0, return_inverse=True)
    corners = np.stack([mesh.faces, index.reshape(-1, 3)], axis=2) + 1
    lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in mesh.vertices]
    lines += [f"vn {x:.4g} {y:.4g} {z:.4g}" for x, y, z in normals]
    lines += ["f " + " ".join(f"{vertex}//{normal}" for vertex, normal in face) for face in corners]
    return "\n".join(lines) + "\n"


def _corner_normals(mesh: trimesh.Trimesh) -> FloatArray:
    """(3 f, 3) unit normals at the corners of faces, for smooth shading.

    Each is the mean, weighted by area, over the faces around the corner within 35 degrees of its own face.
    """
    corners = mesh.faces.reshape(-1)
    count = len(corners)
    at_vertex = csr_array((np.ones(count), (np.arange(count), corners)), shape=(count, len(mesh.vertices)))
    first, second = (at_vertex @ at_vertex.T).nonzero()
    face_normals = np.repeat(mesh.face_normals, 3, axis=0)
    smooth = np.sum(face_normals[first] * face_normals[second], axis=1) > np.cos(_CREASE)
    first, second = first[smooth], second[smooth]
    total = np.zeros((count, 3))
    np.add.at(total, first, face_normals[second] * np.repeat(mesh.area_faces, 3)[second, None])
    return total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None]


def lofted(outline: BaseGeometry, profile: Sequence[tuple[float, float]]) -> trimesh.Trimesh:
    """Solid on an outline that narrows with height.

    Args:
        outline: footprint of one or more polygons, possibly concave or with holes, m.
        profile: rows (inset, z) from bottom to top, neither decreasing: at height z the cross-section is the
            outline without a rim of width `inset`. Rows with an empty cross-section are skipped.
    """
    # Rounded at re-entrant corners, so that the rim has the same width everywhere.
    sections = [
        (outline if inset == 0 else outline.buffer(-inset, quad_segs=4), inset, z) for inset, z in profile
    ]
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
        height: height of the top, m.
        edge: width of the rounding, m.
        rise: height of the rounding, m; by default `edge`.
        base: height of the underside, m.
    """
    rise = min(edge if rise is None else rise, height - base)
    angles = np.linspace(0.0, np.pi / 2, _ROUND_STEPS + 1)
    arc = [(float(edge * (1 - np.cos(a))), float(height - rise * (1 - np.sin(a)))) for a in angles]
    return [(0.0, base), *arc] if rise < height - base else arc


def coloured(parts: Sequence[tuple[trimesh.Trimesh, ArrayLike]]) -> trimesh.Trimesh:
    """Merge meshes, each with one colour (r, g, b, a from 0 to 1) on its faces."""
    vertices = np.concatenate([part.vertices for part, _ in parts])
    starts = np.cumsum([0, *(len(part.vertices) for part, _ in parts[:-1])])
    faces = np.concatenate([part.faces + start for (part, _), start in zip(parts, starts, strict=True)])
    colours = np.repeat(
        np.round(255 * np.array([colour for _, colour in parts], dtype=float)).astype(np.uint8),
        [len(part.faces) for part, _ in parts],
        axis=0,
    )
    return trimesh.Trimesh(vertices, faces, face_colors=colours, process=False)


def plainly_coloured(mesh: trimesh.Trimesh, colour: ArrayLike) -> trimesh.Trimesh:
    """The mesh with few colours on its faces.

    It keeps its own if they are few, takes their mean if they are many, as in a scan, and the given one
    (r, g, b, a from 0 to 1) if it has none or a texture.
    """
    if isinstance(mesh.visual, trimesh.visual.ColorVisuals) and mesh.visual.defined:
        own = np.asarray(mesh.visual.face_colors, dtype=float)
        if len(np.unique(own, axis=0)) <= _MOST_COLOURS:
            return mesh
        colour = np.average(own, axis=0, weights=np.maximum(mesh.area_faces, 1e-12)) / 255
    return coloured([(mesh, colour)])


def height_over(mesh: trimesh.Trimesh, points: FloatArray) -> FloatArray:
    """(k,) largest z of a mesh over each point (k, 2), m; NaN where there is no mesh."""
    a, b, c = np.asarray(mesh.triangles).transpose(1, 0, 2)
    e, f = b - a, c - a
    area = cross(e, f)
    flat = np.abs(area) > 1e-14
    a, e, f, area = a[flat], e[flat], f[flat], area[flat]
    heights = np.full(len(points), np.nan)
    for k, point in enumerate(points):  # all at once would take gigabytes for a scan
        offset = point - a[:, :2]
        u, v = cross(offset, f) / area, cross(e, offset) / area
        inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
        if inside.any():
            heights[k] = (a[:, 2] + u * e[:, 2] + v * f[:, 2])[inside].max()
    return heights


def _cap(section: BaseGeometry, z: float) -> FloatArray:
    return np.insert(_triangles(section), 2, z, axis=2)


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
    clockwise = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) < 0
    corners[clockwise] = corners[clockwise][:, ::-1]
    return corners


def _polygons(section: BaseGeometry) -> list[Polygon]:
    return [p for p in shapely.get_parts(section) if isinstance(p, Polygon) and not p.is_empty]
