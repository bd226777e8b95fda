"""The paper's six objects, and a user's own."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import shapely
import trimesh
from scipy.spatial import cKDTree

from slipmap.models.objects.benchmark_objects import BENCHMARK_OBJECTS, benchmark_object
from slipmap.models.objects.footprints import convex_pieces
from slipmap.models.objects.meshes import height_over, lofted, rounded
from slipmap.models.objects.true_object import TrueObject, object_from_labels, object_from_mesh

METRES_PER_PIXEL = 0.53 / 640
# kg a cell in the authors' simulation
CELL_MASSES = {
    "book": (0.370, 4.043),
    "box": (4.871, 1.508),
    "hammer": (3.320, 0.744),
    "wrench": (3.901, 0.005, 1.611),
    "snack": (0.938, 4.390),
    "spray_gun": (0.125, 4.234),
}


@pytest.fixture(scope="module", params=BENCHMARK_OBJECTS)
def thing(request: pytest.FixtureRequest) -> TrueObject:
    return benchmark_object(request.param)


def test_sizes_are_those_of_a_kitchen(thing: TrueObject) -> None:
    assert 28 <= len(thing.grid) <= 88
    assert 0.2 <= thing.total_mass <= 2.0
    assert thing.mu.min() >= 0.2 and thing.mu.max() <= 0.6
    assert thing.maps.mass.sum() == pytest.approx(thing.total_mass)
    assert len(thing.colors) == thing.labels.max() + 1 == len(CELL_MASSES[thing.name])


def test_masses_keep_the_ratios_of_the_paper(thing: TrueObject) -> None:
    wanted = np.array(CELL_MASSES[thing.name])[thing.labels]
    np.testing.assert_allclose(thing.mass / thing.total_mass, wanted / wanted.sum())


def test_regions_differ_in_friction(thing: TrueObject) -> None:
    frictions = [np.unique(thing.mu[thing.labels == label]) for label in range(len(thing.colors))]
    assert all(len(values) == 1 for values in frictions)
    assert len(np.unique(np.concatenate(frictions))) == len(frictions)


def test_mesh_stands_on_the_outline(thing: TrueObject) -> None:
    low, high = thing.mesh.bounds
    assert low[2] == pytest.approx(0.0, abs=1e-9)
    corners = np.array(thing.grid.polygon.bounds).reshape(2, 2)
    np.testing.assert_allclose([low[:2], high[:2]], corners, atol=5e-4)
    seen = np.isfinite(height_over(thing.mesh, thing.grid.centers))
    assert seen.all()
    assert thing.height.max() == pytest.approx(high[2], abs=1e-3)


def test_blocks_cover_the_outline_once(thing: TrueObject) -> None:
    union = shapely.union_all([block.outline for block in thing.blocks])
    assert shapely.symmetric_difference(union, thing.grid.polygon).area < 2e-3 * union.area
    assert sum(block.outline.area for block in thing.blocks) == pytest.approx(union.area, rel=1e-3)


def test_footprint_and_regions_match_the_pictures(thing: TrueObject, shared_data: Path) -> None:
    labels = cv2.imread(str(shared_data / "paper_objects" / f"{thing.name}_label.png"), cv2.IMREAD_UNCHANGED)
    rows, columns = np.nonzero(labels)
    low = np.array([columns.min() - 0.5, rows.max() + 0.5])
    pixels = (np.column_stack([columns, rows]) - low) * [METRES_PER_PIXEL, -METRES_PER_PIXEL]
    pixels += thing.grid.exterior.min(axis=0)

    covered = int(shapely.contains_xy(thing.grid.polygon, pixels).sum())
    area = thing.grid.polygon.area / METRES_PER_PIXEL**2
    assert covered / (len(pixels) + area - covered) > 0.85

    segment = labels[rows, columns][cKDTree(pixels).query(thing.grid.centers)[1]]
    assert np.mean(segment == thing.labels + 1) > 0.9


def test_heights_of_a_scan_take_little_memory() -> None:
    ball = trimesh.creation.icosphere(5, radius=0.05)
    points = np.random.default_rng(0).uniform(-0.03, 0.03, (100, 2))
    tracemalloc.start()
    heights = height_over(ball, points)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert heights == pytest.approx(np.sqrt(0.05**2 - (points**2).sum(axis=1)), abs=1e-4)
    assert peak < 1000 * len(ball.faces)
    assert np.isnan(height_over(ball, np.array([[0.06, 0.0]]))).all()


def test_unknown_object_names_the_known_and_the_nearest() -> None:
    with pytest.raises(ValueError, match=r"'spray gan' is unknown.*book.*wrench.*did you mean spray_gun\?"):
        benchmark_object("spray gan")
    with pytest.raises(ValueError, match=r"spray_gun$"):
        benchmark_object("zzz")


def test_a_wrong_map_names_the_cell(thing: TrueObject) -> None:
    mass = thing.mass.copy()
    mass[3] = -1.0
    with pytest.raises(ValueError, match=f"{thing.name}: mass of cell 3"):
        replace(thing, mass=mass)
    with pytest.raises(ValueError, match="labels"):
        replace(thing, labels=thing.labels + 5)


def test_center_of_mass_of_a_step(tmp_path: Path) -> None:
    low, high = trimesh.creation.box((0.1, 0.1, 0.02)), trimesh.creation.box((0.1, 0.1, 0.06))
    low.apply_translation([-0.05, 0, 0.01])
    high.apply_translation([0.05, 0, 0.03])
    path = tmp_path / "step.stl"
    trimesh.util.concatenate([low, high]).export(path)
    step = object_from_mesh(path, 0.8, 0.3, count=50)
    # A quarter of a solid's volume is in the low half.
    assert step.mass[step.grid.centers[:, 0] < 0].sum() == pytest.approx(0.2)
    np.testing.assert_allclose(step.center_of_mass, [0.025, 0.0, 0.25 * 0.01 + 0.75 * 0.03], atol=1e-6)
    assert step.name == "step"


def test_mesh_is_turned_and_set_down_like_its_cells(tmp_path: Path) -> None:
    path = tmp_path / "tower.stl"
    bar, tower = trimesh.creation.box((200.0, 30.0, 80.0)), trimesh.creation.box((40.0, 40.0, 80.0))
    bar.apply_translation([0, 500.0, 0])
    tower.apply_translation([80.0, 535.0, 0])
    trimesh.util.concatenate([bar, tower]).export(path)
    thing = object_from_mesh(path, 1.0, 0.3, up=(0, 1, 0), metres_per_unit=1e-3)
    np.testing.assert_allclose(thing.mesh.bounds[:, 2], [0.0, 0.07], atol=1e-6)
    np.testing.assert_allclose(thing.mesh.bounds[:, :2].ravel(), thing.grid.polygon.bounds, atol=1e-6)
    np.testing.assert_allclose(thing.height, np.where(thing.grid.centers[:, 0] > 0.06, 0.07, 0.03), atol=1e-6)


def test_mesh_that_cannot_be_used_names_its_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"absent\.stl"):
        object_from_mesh(tmp_path / "absent.stl", 1.0, 0.3)
    with pytest.raises(ValueError, match=r"absent\.stl: mass must be positive"):
        object_from_mesh(tmp_path / "absent.stl", 0.0, 0.3)


def test_a_mesh_without_height_names_its_file(tmp_path: Path) -> None:
    corners = [[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]).export(tmp_path / "flat.stl")
    with pytest.raises(ValueError, match=r"mesh .*flat\.stl: it is flat over 49 of 49 cells"):
        object_from_mesh(tmp_path / "flat.stl", 1.0, 0.3, count=49)
    trimesh.creation.box((100.0, 50.0, 30.0)).export(tmp_path / "box.stl")
    with pytest.raises(ValueError, match=r"mesh .*box\.stl: .* metres_per_unit=0\.001"):
        object_from_mesh(tmp_path / "box.stl", 1.0, 0.3)


def test_object_from_a_picture(tmp_path: Path) -> None:
    path = tmp_path / "two.png"
    labels = np.zeros((60, 120), np.uint8)
    labels[10:50, 10:50], labels[10:50, 50:110] = 2, 7
    cv2.imwrite(str(path), labels)
    thing = object_from_labels(path, 1e-3, {2: 0.3, 7: 0.5}, {2: 0.2, 7: 0.4}, height=0.02, count=40)
    left = thing.grid.centers[:, 0] < thing.grid.exterior[:, 0].min() + 0.04
    assert thing.mass[left].sum() == pytest.approx(0.3) and thing.total_mass == pytest.approx(0.8)
    assert set(thing.mu[left]) == {0.2} and set(thing.mu[~left]) == {0.4}
    assert thing.mesh.volume == pytest.approx(0.04 * 0.1 * 0.02, rel=0.1)
    with pytest.raises(ValueError, match=r"two\.png: mass must be given for the labels 2, 7.*got 2"):
        object_from_labels(path, 1e-3, {2: 0.3}, {2: 0.2, 7: 0.4})


def test_lofted_slab_has_the_volume_of_its_profile() -> None:
    square = shapely.box(0, 0, 1, 1).difference(shapely.box(0.4, 0.4, 0.6, 0.6))
    straight = lofted(square, [(0, 0.5), (0, 1)])
    assert (
        straight.is_winding_consistent and straight.is_watertight and straight.volume == pytest.approx(0.48)
    )
    # A frustum of a pyramid.
    pyramid = lofted(shapely.box(0, 0, 2, 2), [(0, 0), (0.5, 1)])
    assert pyramid.is_watertight and pyramid.volume == pytest.approx((4 + 1 + 2) / 3)
    profile = rounded(0.5, 0.2)
    assert profile[-1] == pytest.approx((0.2, 0.5)) and profile[1] == pytest.approx((0.0, 0.3))


def test_convex_pieces_cover_a_concave_outline() -> None:
    outline = shapely.box(0, 0, 1, 1).difference(shapely.box(0.3, 0.3, 0.6, 1.2))
    pieces = convex_pieces(outline)
    assert len(pieces) == 3
    union = shapely.union_all(pieces)
    assert shapely.symmetric_difference(union, outline).area < 1e-3
    assert all(piece.area == pytest.approx(piece.convex_hull.area) for piece in pieces)


def test_many_corners_become_convex_pieces() -> None:
    """A lobed outline with an opening, as a scan has it: twice the corners, about twice the pieces."""
    angles = np.linspace(0, 2 * np.pi, 600, endpoint=False)
    radius = 0.06 + 0.008 * np.sin(7 * angles)
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    outline = shapely.Polygon(radius[:, None] * circle, [0.02 * circle])
    pieces = convex_pieces(outline)
    assert len(pieces) < 300
    assert all(piece.area == pytest.approx(piece.convex_hull.area) for piece in pieces)
    union = shapely.union_all(pieces)
    assert outline.buffer(1.1e-4).covers(union) and union.buffer(1e-9).covers(outline)
