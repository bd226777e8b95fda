"""Silhouettes of meshes cut into cells."""

import importlib.util
import re
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from shapely.geometry import Polygon

from slipmap.models.objects import cells_from_mesh
from slipmap.models.objects.meshes import (
    DIRECTIONS,
    coloured,
    lofted,
    plainly_coloured,
    unit_advice,
    up_axis,
    upright_mesh,
)
from slipmap.models.objects.true_object import object_from_mesh


def box(*size, at=(0, 0, 0)):
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(at)
    return mesh


def turned(mesh, degrees, axis):
    mesh = mesh.copy()
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(degrees), axis))
    return mesh


def hammer():
    """A handle along x with a head that reaches to +y at its end; the head stands higher than the handle."""
    parts = box(0.30, 0.02, 0.02), box(0.04, 0.10, 0.04, at=(0.15, 0.03, 0.03))
    return trimesh.util.concatenate(parts)


def test_box_stays_where_it_is():
    grid = cells_from_mesh(box(0.2, 0.1, 0.05, at=(0.3, -0.1, 1.0)), count=50)
    assert len(grid) == 50
    assert len(grid.exterior) == 4
    assert grid.width == pytest.approx(0.02)
    assert_allclose(grid.polygon.bounds, [0.2, -0.15, 0.4, -0.05])


def test_box_turned_about_the_vertical_axis():
    grid = cells_from_mesh(turned(box(0.2, 0.1, 0.05), 30, [0, 0, 1]), count=200)
    assert grid.polygon.area == pytest.approx(0.02)
    assert grid.polygon.bounds[2] == pytest.approx(0.1 * np.cos(np.pi / 6) + 0.05 * np.sin(np.pi / 6))
    assert len(grid) == pytest.approx(200, abs=2)


@pytest.mark.parametrize("degrees", [0, 20, 45, 90, 135])
def test_tilted_box_casts_its_analytic_silhouette(degrees):
    grid = cells_from_mesh(turned(box(0.2, 0.1, 0.05), degrees, [0, 1, 0]), count=100)
    a = np.deg2rad(degrees)
    assert grid.polygon.area == pytest.approx(0.1 * (0.2 * abs(np.cos(a)) + 0.05 * abs(np.sin(a))))


@pytest.mark.parametrize("orientation", ["as made", "lying on its rim"])
def test_annulus(orientation):
    mesh = trimesh.creation.annulus(r_min=0.03, r_max=0.05, height=0.02, sections=64)
    if orientation == "as made":
        grid = cells_from_mesh(mesh, count=150)
        corner_area = 64 / 2 * np.sin(2 * np.pi / 64)
        assert grid.polygon.area == pytest.approx(corner_area * (0.05**2 - 0.03**2))
        (hole,) = grid.holes
        assert_allclose(np.linalg.norm(hole, axis=1), 0.03)
        radius = np.linalg.norm(grid.centers, axis=1)
        assert np.all((radius > 0.0299) & (radius < 0.05))
    else:
        grid = cells_from_mesh(mesh, count=150, up=(1, 0, 0))
        assert grid.holes == ()
        assert grid.polygon.area == pytest.approx(0.1 * 0.02, rel=2e-3)


def test_overhanging_part_belongs_to_the_footprint():
    grid = cells_from_mesh(hammer(), width=0.01)
    assert grid.polygon.area == pytest.approx(0.30 * 0.02 + 0.04 * 0.10 - 0.02 * 0.02)
    assert_allclose(grid.polygon.bounds, [-0.15, -0.02, 0.17, 0.08])


@pytest.mark.parametrize(
    ("up", "x", "y"),
    [
        ((0, 0, 1), [1, 0, 0], [0, 1, 0]),
        ((0, 0, 3.5), [1, 0, 0], [0, 1, 0]),
        ((0, 0, -1), [1, 0, 0], [0, -1, 0]),
        ((0, 1, 0), [1, 0, 0], [0, 0, -1]),
        ((1, 0, 0), [0, 0, -1], [0, 1, 0]),
    ],
)
def test_direction_of_up(up, x, y):
    # The corner bounds of the silhouette are those of the vertices along the frame's x and y.
    mesh = hammer()
    grid = cells_from_mesh(mesh, count=60, up=up)
    u, v = mesh.vertices @ x, mesh.vertices @ y
    assert_allclose(grid.polygon.bounds, [u.min(), v.min(), u.max(), v.max()], atol=1e-12)


def test_up_is_not_a_letter():
    with pytest.raises(ValueError, match=r"up must be a direction of three finite numbers, .* got 'w'"):
        cells_from_mesh(hammer(), count=60, up="w")


def test_view_along_up_equals_the_turned_mesh():
    up = np.array([0.2, -0.3, 0.9])
    axis = np.cross(up, [0, 0, 1])
    angle = np.degrees(np.arccos(up[2] / np.linalg.norm(up)))
    a = cells_from_mesh(hammer(), count=100, up=up).polygon
    b = cells_from_mesh(turned(hammer(), angle, axis), count=100).polygon
    assert a.symmetric_difference(b).area < 1e-9


def test_open_surface_with_mixed_sides_gives_the_same_silhouette():
    mesh = trimesh.creation.icosphere(3, radius=0.05)
    closed = cells_from_mesh(mesh, count=80)
    upper = mesh.triangles_center[:, 2] > 0
    faces = mesh.faces[upper].copy()
    faces[::2] = faces[::2, ::-1]
    opened = cells_from_mesh(trimesh.Trimesh(mesh.vertices, faces, process=False), count=80)
    assert closed.polygon.area == pytest.approx(np.pi * 0.05**2, rel=0.01)
    assert opened.polygon.area == pytest.approx(closed.polygon.area, rel=0.02)
    assert opened.holes == ()


def exported_gltf(mesh: trimesh.Trimesh, folder: Path, name: str) -> Path:
    """A glTF file with its data in a file beside it."""
    for file, content in trimesh.exchange.gltf.export_gltf(trimesh.Scene(mesh)).items():
        (folder / file.replace("model.gltf", name)).write_bytes(content)
    return folder / name


DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>
<unit meter="0.001"/><up_axis>{up}_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="{numbers}">{vertices}</float_array><technique_common>
<accessor source="#a" count="{points}" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="{count}"><input semantic="VERTEX" source="#v" offset="0"/><p>{faces}</p></triangles>
</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node>
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def exported_dae(mesh: trimesh.Trimesh, path: Path, up: str) -> Path:
    """A COLLADA file in mm."""
    vertices, faces = 1e3 * mesh.vertices, mesh.faces
    path.write_text(
        DAE.format(
            up=up, numbers=vertices.size, points=len(vertices), count=len(faces),
            vertices=" ".join(map(str, vertices.ravel())), faces=" ".join(map(str, faces.ravel())),
        )
    )  # fmt: skip
    return path


@pytest.mark.parametrize("kind", ["stl", "ply", "obj", "glb", "gltf", "off", "dae"])
def test_file_round_trip(tmp_path, kind):
    path = tmp_path / f"hammer.{kind}"
    if kind == "gltf":
        exported_gltf(hammer(), tmp_path, "hammer.gltf")
    elif kind == "dae":
        pytest.importorskip("collada")
        exported_dae(hammer(), path, "Z")
    else:
        hammer().export(path)
    grid = cells_from_mesh(path, count=88, up=(0, 0, 1))
    expected = cells_from_mesh(hammer(), count=88)
    assert grid.polygon.symmetric_difference(expected.polygon).area < 1e-6 * expected.polygon.area
    assert_allclose(grid.centers, expected.centers, atol=1e-6)


def test_up_is_what_the_format_says(tmp_path):
    thing = box(0.2, 0.03, 0.1)  # 0.1 m high, or 0.03 m where y is up
    thing.export(tmp_path / "a.glb")
    thing.export(tmp_path / "a.stl")
    paths = {"y": [tmp_path / "a.glb", exported_gltf(thing, tmp_path, "b.gltf")], "z": [tmp_path / "a.stl"]}
    if importlib.util.find_spec("collada"):
        for axis in paths:
            paths[axis].append(exported_dae(thing, tmp_path / f"{axis}.dae", axis.upper()))
    for axis, files in paths.items():
        for path in files:
            sides = [0.2, 0.1 if axis == "y" else 0.03]
            assert_allclose(np.ptp(cells_from_mesh(path, count=20).exterior, axis=0), sides, atol=1e-6)
            assert up_axis(path) == axis
            assert upright_mesh(path).extents[2] == pytest.approx(0.03 if axis == "y" else 0.1)
            other = cells_from_mesh(path, count=20, up=DIRECTIONS["-x"]).exterior  # z along x
            assert sorted(np.ptp(other, axis=0)) == pytest.approx([0.03, 0.1], abs=1e-6)


def test_corners_that_lie_together_are_one(tmp_path):
    ring = [[0, 0], [0.08, 0], [0.08, 0.0125], [0.04, 0.0125], [0.04, 0.04], [0.02, 0.04 - 57e-9], [0, 0.04]]
    ring.insert(3, [0.08 - 4e-8, 0.0125 + 4e-8])
    path = tmp_path / "bracket.ply"
    lofted(Polygon(ring), [(0, 0), (0, 0.02)]).export(path)
    assert len(cells_from_mesh(path, count=20).exterior) == 6


def test_units():
    mesh = hammer()
    mesh.apply_scale(1000)
    expected = cells_from_mesh(hammer(), count=88)
    assert_allclose(
        cells_from_mesh(mesh, count=88, metres_per_unit=0.001).centers, expected.centers, atol=1e-12
    )
    with pytest.raises(ValueError, match=r"metres_per_unit=0\.001 \(mm\) gives 320 mm$"):
        cells_from_mesh(mesh, count=88)
    mesh.units = "mm"
    assert_allclose(cells_from_mesh(mesh, count=88).centers, expected.centers, atol=1e-12)
    assert mesh.units == "mm", "the caller's mesh was changed"
    assert mesh.extents[0] == pytest.approx(320)


@pytest.mark.parametrize(
    ("metres", "fitting"),
    [(20.0, [20, 200, 508]), (7874.0 * 0.0254, [200]), (10.0, [10, 100, 254]), (1e9, [])],
)
def test_units_that_fit_are_offered(metres, fitting):
    assert [float(size) for size in re.findall(r"gives (\d+) mm", unit_advice(metres, 1.0))] == fitting


def test_large_mesh():
    mesh = trimesh.creation.torus(0.1, 0.03, major_sections=160, minor_sections=80)
    grid = cells_from_mesh(mesh, count=2000)
    assert len(grid.holes) == 1
    assert grid.polygon.area == pytest.approx(np.pi * (0.13**2 - 0.07**2), rel=2e-3)


@pytest.mark.parametrize(
    ("mesh", "options", "message"),
    [
        (trimesh.Trimesh(), {}, "has no triangles"),
        (box(0.1, 0.1, 0.1), {"up": (0, 0, 0)}, "up must be a direction"),
        (box(0.1, 0.1, 0.1), {"up": (0, 1)}, "up must be a direction"),
        (
            box(0.1, 0.1, 0.1),
            {"metres_per_unit": 1e-9},
            r"measures 1e-10 m, less than 1 mm; .*=0\.01 \(cm\) gives 1 mm|\(m\) gives 100 mm",
        ),
        (box(0.1, 0.1, 0.1), {"metres_per_unit": 0}, "metres_per_unit must be a positive length, got 0"),
        (
            trimesh.util.concatenate([box(0.1, 0.1, 0.1), box(0.1, 0.1, 0.1, at=(0.3, 0, 0))]),
            {},
            "is in 2 separate parts",
        ),
        (trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 0, 1]], [[0, 1, 2]]), {}, "has no area"),
        (
            trimesh.Trimesh([[0, 0, 0], [np.nan, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False),
            {},
            "vertex 1 is not finite",
        ),
    ],
)
def test_wrong_meshes_are_refused(mesh, options, message):
    with pytest.raises(ValueError, match=message):
        cells_from_mesh(mesh, count=4, **options)


def test_wrong_files_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"missing\.stl: there is no such file"):
        cells_from_mesh(tmp_path / "missing.stl", count=4)
    for name, content in [("text.stl", "hello"), ("empty.obj", ""), ("what.xyzzy", "1 2 3")]:
        path = tmp_path / name
        path.write_text(content)
        with pytest.raises(ValueError, match=name):
            cells_from_mesh(path, count=4)


def bracket_of_faces(path, first, turn):
    """A C of 90 by 100 mm, 30 mm high, whose top and bottom are one face each; some corners in a line."""
    ring = np.roll(
        [[30, 30], [90, 30], [90, 0], [40, 0], [0, 0], [0, 100], [90, 100], [90, 70], [30, 70]], first, axis=0
    )
    n = len(ring)
    points = np.column_stack([np.tile(1e-3 * ring, (2, 1)), np.repeat([0.0, 0.03], n)]) @ turn.T
    faces = [range(n)[::-1], range(n, 2 * n), *((k, (k + 1) % n, (k + 1) % n + n, k + n) for k in range(n))]
    if path.suffix == ".obj":
        lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points]
        lines += ["f " + " ".join(str(k + 1) for k in face) for face in faces]
    else:
        lines = [
            "ply",
            "format ascii 1.0",
            f"element vertex {2 * n}",
            *(f"property float {a}" for a in "xyz"),
        ]
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
        lines += [f"{x} {y} {z}" for x, y, z in points]
        lines += [f"{len(face)} " + " ".join(map(str, face)) for face in faces]
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("kind", ["obj", "ply"])
@pytest.mark.parametrize("first", range(9))
def test_concave_faces_of_many_corners(tmp_path, kind, first):
    """Readers cut them into triangles that lie outside them."""
    path, turn = tmp_path / f"bracket.{kind}", Rotation.from_euler("xyz", [0.3, -0.2, 0.5]).as_matrix()
    for turned_by in (np.eye(3), turn):
        bracket_of_faces(path, first, turned_by)
        polygon = cells_from_mesh(path, count=60, up=turned_by[:, 2]).polygon
        assert polygon.area == pytest.approx(0.09 * 0.1 - 0.06 * 0.04, rel=2e-4)
        assert polygon.convex_hull.area == pytest.approx(0.09 * 0.1, rel=2e-4) and not polygon.interiors
    assert object_from_mesh(path, 1.0, 0.3, up=turn[:, 2]).height.min() == pytest.approx(0.03, rel=1e-3)


def test_a_vertex_without_a_number_is_told(tmp_path):
    text = box(0.1, 0.1, 0.1).export(file_type="stl_ascii")
    lines = text.splitlines()
    row = [k for k, line in enumerate(lines) if "vertex" in line][5]
    (tmp_path / "box.stl").write_text("\n".join([*lines[:row], "vertex nan 0.05 0.05", *lines[row + 1 :]]))
    with pytest.raises(ValueError, match=r"box\.stl: vertex 5 is not finite"):
        cells_from_mesh(tmp_path / "box.stl", count=4)


def test_a_file_that_a_mesh_needs_is_named(tmp_path):
    (tmp_path / "box.gltf").write_bytes(
        trimesh.Scene(box(0.1, 0.1, 0.1)).export(file_type="gltf")["model.gltf"]
    )
    with pytest.raises(
        ValueError, match=r"box\.gltf: .* needs the file gltf_buffer_0\.bin, which is missing"
    ):
        cells_from_mesh(tmp_path / "box.gltf", count=4)


def test_advice_is_for_the_unit_in_the_file(tmp_path):
    """Whoever reads the mesh: 1000 units of 0.02 m would be 1 m as mm and 20 m as they are."""
    box(1000, 500, 100).export(tmp_path / "box.stl")
    for use in (partial(cells_from_mesh, count=4), upright_mesh, partial(object_from_mesh, mass=1.0, mu=0.3)):
        with pytest.raises(
            ValueError, match=r"box\.stl: the footprint measures 20 m, .*=0\.001 \(mm\) gives 1e"
        ):
            use(tmp_path / "box.stl", metres_per_unit=0.02)


def test_a_wide_mesh_raises_doubt(tmp_path):
    box(150, 50, 10).export(tmp_path / "box.stl")
    with pytest.warns(UserWarning, match=r"box\.stl: is 1\.5 m wide; .*=0\.001 \(mm\) gives 150 mm"):
        cells_from_mesh(tmp_path / "box.stl", count=4, metres_per_unit=0.01)


def test_what_a_surface_looks_like_becomes_a_few_colours(tmp_path):
    blue = np.array([0.0, 0.0, 1.0, 1.0])
    textured = box(0.1, 0.1, 0.1)
    textured.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)))
    scanned = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    reds = np.linspace(0, 254, len(scanned.faces)).astype(np.uint8)
    scanned.visual.face_colors = np.column_stack([reds, 0 * reds, 0 * reds, 0 * reds + 255])
    for mesh, expected in ((textured, [0, 0, 255, 255]), (scanned, [127, 0, 0, 255])):
        colours = np.unique(plainly_coloured(mesh, blue).visual.face_colors, axis=0)
        assert_allclose(colours, [expected], atol=2)
    two = coloured([(box(0.1, 0.1, 0.1), blue), (box(0.1, 0.1, 0.1), blue[::-1])])
    assert plainly_coloured(two, blue) is two


def test_a_damaged_mesh_is_told_as_such(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "charset_normalizer", None)  # as where it is not installed
    box(0.1, 0.1, 0.1).export(tmp_path / "box.stl")
    cut = tmp_path / "cut.stl"
    cut.write_bytes((tmp_path / "box.stl").read_bytes()[:200] + b"\xff")
    with pytest.raises(ValueError, match=r"cut\.stl: cannot be read as a mesh: it is damaged or cut short"):
        cells_from_mesh(cut, count=4)


def test_a_format_that_needs_another_library_is_told(tmp_path, monkeypatch):
    path = tmp_path / "shoe.dae"
    path.write_text("<COLLADA/>")

    def reader_without_its_library(name: str, **options: object) -> None:
        raise ImportError("missing `pip install pycollada`")

    monkeypatch.setattr(trimesh, "load_mesh", reader_without_its_library)
    with pytest.raises(ValueError, match=r"shoe\.dae: .* that end in \.dae need .*collada.*; .*\.stl"):
        cells_from_mesh(path, count=4)
