"""`slipmap object`: a mesh or a picture becomes what --object takes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh
from refusals import assert_refused, files_in
from shapely.geometry import Polygon

from slipmap.models.measurements import read_dataset
from slipmap.models.objects.meshes import lofted

ROWS = "t,object_x,object_y,object_theta,tip_x,tip_y\n0,0,0,0,-0.2,0\n1,0,0,0,-0.1,0\n"


@pytest.fixture
def bracket(tmp_path):
    """Two bars of 120 by 30 and 30 by 80 mm, in millimetres, as high as 20 mm."""
    legs = [trimesh.creation.box(bounds=[[0, 0, 0], corner]) for corner in ([120, 30, 20], [30, 80, 20])]
    trimesh.util.concatenate(legs).export(tmp_path / "bracket.stl")
    return tmp_path / "bracket.stl"


def described(slipmap, tmp_path, *arguments):
    """The dataset of a push of what the command describes, and what it said."""
    said = slipmap("object", *arguments, "-o", tmp_path / "thing.yaml", "--finger", 0.006)
    assert said.code == 0, said.err
    (tmp_path / "push.csv").write_text(ROWS)
    return read_dataset(tmp_path / "push.csv", object_name=str(tmp_path / "thing.yaml")), said


def test_a_mesh_becomes_an_object(slipmap, tmp_path, bracket):
    more = ("--metres-per-unit", 0.001, "--mass", 0.8, "--cells", 40)
    dataset, said = described(slipmap, tmp_path, bracket, *more)
    assert (dataset.name, dataset.mass, dataset.finger_radius) == ("bracket", 0.8, 0.006)
    assert dataset.grid.polygon.area == pytest.approx(0.12 * 0.03 + 0.03 * 0.05)
    assert dataset.grid.centers.min() > 0.0 and dataset.height == pytest.approx(0.02)
    assert 32 <= len(dataset.grid) <= 50
    assert said.out.startswith(f"bracket: 120 mm by 80 mm, 20 mm high with z up, {len(dataset.grid)} cells")
    assert dataset.warnings == ()


def test_gaps_that_are_closed_are_told(slipmap, tmp_path):
    parts = [trimesh.creation.box((0.1, 0.02, 0.02)) for _ in range(2)]
    parts[1].apply_translation((0.1 + 5e-5, 0.0, 0.0))
    trimesh.util.concatenate(parts).export(tmp_path / "bar.stl")
    dataset, said = described(slipmap, tmp_path, tmp_path / "bar.stl")
    assert len(dataset.grid.exterior) == 4
    assert "between 2 parts closed" in said.err


def test_a_picture_becomes_an_object(slipmap, tmp_path):
    labels = np.zeros((60, 100), np.uint8)
    labels[10:40, 20:80] = 1
    labels[10:20, 20:40] = 2
    cv2.imwrite(str(tmp_path / "photo.png"), labels)
    dataset, _ = described(slipmap, tmp_path, tmp_path / "photo.png", "--metres-per-pixel", 0.001)
    np.testing.assert_allclose(np.abs(dataset.grid.exterior), [[0.03, 0.015]] * 4, atol=1e-6)
    assert dataset.mass is None and dataset.height is None


def test_openings_and_near_corners_are_written(slipmap, tmp_path):
    ring = trimesh.creation.annulus(r_min=0.03, r_max=0.05, height=0.02)
    ring.export(tmp_path / "ring.stl")
    dataset, said = described(slipmap, tmp_path, tmp_path / "ring.stl")
    (hole,) = dataset.grid.holes
    np.testing.assert_allclose(np.hypot(*hole.T), 0.03, atol=1e-6)
    assert " with an opening" not in said.out and "with 1 opening, 20 mm high" in said.out
    assert np.hypot(*dataset.grid.centers.T).min() > 0.03
    scan = Polygon([[0, 0], [80, 0], [80, 12.5], [80 - 4e-5, 12.5 + 4e-5], [40, 40], [0, 40]])
    lofted(scan, [(0, 0), (0, 20)]).export(tmp_path / "scan.ply")
    dataset, _ = described(slipmap, tmp_path, tmp_path / "scan.ply", "--metres-per-unit", 0.001)
    assert len(dataset.grid.exterior) == 5 and dataset.warnings == ()


def test_a_small_opening_is_not_closed_without_a_word(slipmap, tmp_path):
    labels = np.zeros((60, 100), np.uint8)
    labels[10:50, 10:90] = 1
    labels[20:40, 20:40] = labels[30:33, 60:63] = 0
    cv2.imwrite(str(tmp_path / "plate.png"), labels)
    dataset, said = described(slipmap, tmp_path, tmp_path / "plate.png", "--metres-per-pixel", 0.001)
    assert len(dataset.grid.holes) == 1 and "80 mm by 40 mm with 1 opening" in said.out
    assert "openings closed as noise, each of less than 1 % of the object's area: 1\n" in said.err


def test_an_axis_and_a_large_object_are_asked_about(slipmap, tmp_path, bracket):
    _, said = described(slipmap, tmp_path, bracket, "--metres-per-unit", 0.01, "--up", "y")
    assert said.out.startswith("bracket: 1200 mm by 200 mm, 800 mm high with y up")
    assert "is 1.2 m wide; if that is wrong" in said.err
    assert "--metres-per-unit 0.001 (mm) gives 120 mm" in said.err
    trimesh.creation.box((0.15, 0.0055, 0.02)).export(tmp_path / "rod.stl")
    assert "rod: 150 mm by 5.5 mm, 20 mm high" in described(slipmap, tmp_path, tmp_path / "rod.stl")[1].out


def test_wrong_use_is_told_and_leaves_nothing(slipmap, tmp_path, bracket):
    output = ("-o", tmp_path / "thing.yaml", "--finger", 0.006)
    assert_refused(
        slipmap("object", bracket, *output), "bracket.stl", "--metres-per-unit 0.001 (mm) gives 120 mm"
    )
    assert_refused(
        slipmap("object", bracket, "--metres-per-pixel", 1e-3, *output), "is not a picture", ".png"
    )
    (tmp_path / "a.png").write_bytes(b"")
    assert_refused(slipmap("object", tmp_path / "a.png", *output), "a.png", "give --metres-per-pixel")
    assert_refused(slipmap("object", tmp_path / "no.stl", *output), "no.stl", "no such file")
    assert_refused(slipmap("object", tmp_path / "a.jpg", *output), "a.jpg: pictures are read as .png")
    assert files_in(tmp_path) == ["a.png", "bracket.stl"]
