"""Silhouettes of meshes cut into cells."""

import sys
import time

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from slipmap.models.objects import cells_from_mesh


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


@pytest.mark.parametrize("kind", ["stl", "ply", "obj", "glb", "off"])
def test_file_round_trip(tmp_path, kind):
    path = tmp_path / f"hammer.{kind}"
    hammer().export(path)
    grid = cells_from_mesh(path, count=88)
    expected = cells_from_mesh(hammer(), count=88)
    assert grid.polygon.symmetric_difference(expected.polygon).area < 1e-6 * expected.polygon.area
    assert_allclose(grid.centers, expected.centers, atol=1e-6)


def test_units():
    mesh = hammer()
    mesh.apply_scale(1000)
    expected = cells_from_mesh(hammer(), count=88)
    assert_allclose(
        cells_from_mesh(mesh, count=88, metres_per_unit=0.001).centers, expected.centers, atol=1e-12
    )
    with pytest.raises(ValueError, match=r"give metres_per_unit=0\.001"):
        cells_from_mesh(mesh, count=88)
    mesh.units = "mm"
    assert_allclose(cells_from_mesh(mesh, count=88).centers, expected.centers, atol=1e-12)
    assert mesh.units == "mm", "the caller's mesh was changed"
    assert mesh.extents[0] == pytest.approx(320)


def test_large_mesh_is_quick():
    mesh = trimesh.creation.torus(0.1, 0.03, major_sections=160, minor_sections=80)
    start = time.process_time()
    grid = cells_from_mesh(mesh, count=2000)
    assert time.process_time() - start < 2.0
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
            r"footprint measures 1e-10 m, less than 0\.001 m; metres_per_unit",
        ),
        (box(0.1, 0.1, 0.1), {"metres_per_unit": 0}, "metres_per_unit must be a positive length, got 0"),
        (
            trimesh.util.concatenate([box(0.1, 0.1, 0.1), box(0.1, 0.1, 0.1, at=(0.3, 0, 0))]),
            {},
            "falls into 2 separate parts",
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

    def reader_without_its_library(name: str) -> None:
        raise ImportError("missing `pip install pycollada`")

    monkeypatch.setattr(trimesh, "load_mesh", reader_without_its_library)
    with pytest.raises(ValueError, match=r"shoe\.dae: .* that end in \.dae need a further library; .*\.stl"):
        cells_from_mesh(path, count=4)
