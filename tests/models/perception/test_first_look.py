import re

import numpy as np
import pytest
import shapely

from slipmap.models.perception.first_look import ObjectNotSeen, first_look

ELL = ((-0.1, -0.06, 0.1, 0.0, 0.03), (-0.1, 0.0, -0.03, 0.08, 0.09))


def outline_in_world(boxes, pose):
    shape = shapely.union_all([shapely.box(*box[:4]) for box in boxes])
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return shapely.transform(shape, lambda xy: xy @ np.array([[c, s], [-s, c]]) + pose[:2])


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.4), (0.22, -0.15, 2.0)])
def test_footprint_heights_and_frame_of_a_tall_object_also_off_the_axis(look, pose):
    seen = look(ELL, pose, cells=50)
    truth = outline_in_world(ELL, pose)
    found = shapely.transform(seen.grid.polygon, lambda xy: xy + seen.first_pose[:2])
    assert truth.intersection(found).area / truth.union(found).area > 0.96
    assert np.hypot(*(seen.first_pose[:2] - truth.centroid.coords[0])) < 1e-3
    assert abs(seen.first_pose[2]) < np.deg2rad(0.5)
    assert 40 <= len(seen.grid) <= 62
    assert np.allclose(seen.grid.polygon.centroid.coords[0], 0, atol=1e-9)
    tall = outline_in_world(ELL[1:], pose)
    for k, cell in enumerate(seen.grid.centers + seen.first_pose[:2]):
        distance = tall.boundary.distance(shapely.Point(cell))
        if distance > seen.grid.width:
            expected = 0.09 if shapely.contains_xy(tall, *cell) else 0.03
            assert seen.cell_heights[k] == pytest.approx(expected, abs=1.5e-3)


@pytest.mark.parametrize("turn", np.deg2rad([0.0, 20.0, 45.0, 115.0, 250.0]))
def test_the_face_of_a_short_step_is_seen_upright(look, turn):
    """A finger that hooks behind it pulls the object along; from a slanted one it would slip off."""
    face = np.array([[-0.07, 0.02], [-0.07, 0.034]])
    pose = (0.03, -0.05, turn)
    seen = look(((-0.1, -0.02, 0.1, 0.02, 0.03), (-0.1, 0.02, -0.07, 0.034, 0.03)), pose)
    c, s = np.cos(turn), np.sin(turn)
    R_WO = np.array([[c, -s], [s, c]])
    exterior = seen.grid.polygon.exterior
    for share in (0.35, 0.5, 0.65):
        point = shapely.Point(R_WO @ (face[0] + share * (face[1] - face[0])) + pose[:2] - seen.first_pose[:2])
        assert exterior.distance(point) < 2.2e-3  # a pixel
        at = exterior.project(point)
        before, after = (np.array(exterior.interpolate(at + d).coords[0]) for d in (-2e-3, 2e-3))
        along = (after - before) / np.linalg.norm(after - before)
        assert abs(along @ R_WO @ [1.0, 0.0]) < np.sin(np.deg2rad(14.0))


def test_an_opening_is_seen(look):
    frame = ((-0.1, -0.1, 0.1, -0.05, 0.04), (-0.1, 0.05, 0.1, 0.1, 0.04))
    frame += ((-0.1, -0.1, -0.05, 0.1, 0.04), (0.05, -0.1, 0.1, 0.1, 0.04))
    seen = look(frame, (0.0, 0.0, 0.3))
    assert len(seen.grid.holes) == 1
    assert seen.grid.polygon.area == pytest.approx(0.03, rel=0.03)


def test_an_object_of_8_mm_is_seen_and_a_gap_in_it_is_bridged(scene):
    rng = np.random.default_rng(3)
    depth = scene.depth([(-0.12, -0.008, 0.12, 0.008, 0.008)], (0.03, 0.02, 0.0))
    frames = [scene.noisy(depth, rng) for _ in range(9)]
    for frame in frames:
        frame[220:240, 320:345] = 0.0  # shiny metal gives no reading
    seen = first_look(frames, scene.view, cells=30)
    x0, _, x1, _ = seen.grid.polygon.bounds
    assert x1 - x0 == pytest.approx(0.24, abs=3e-3)
    assert np.median(seen.cell_heights) == pytest.approx(0.008, abs=1e-3)


def test_an_object_that_reaches_beyond_the_picture_is_not_taken_for_a_shorter_one(scene):
    rng = np.random.default_rng(4)
    bar = ((-0.1, -0.03, 0.1, 0.03, 0.03),)
    inside, beyond = (
        scene.noisy(scene.depth(bar, (0.0, y, np.pi / 2), table_radius=0.9), rng) for y in (0.38, 0.48)
    )
    assert first_look([inside], scene.view).grid.polygon.area == pytest.approx(0.012, rel=0.05)
    with pytest.raises(ObjectNotSeen, match="reaches beyond the picture"):
        first_look([beyond], scene.view)


def test_an_object_that_is_too_high_is_not_taken_for_its_side(scene):
    rng = np.random.default_rng(5)
    low, high = (
        scene.noisy(scene.depth(((-0.05, -0.05, 0.05, 0.05, height),), (0.1, 0.05, 0.3)), rng)
        for height in (0.29, 0.32)
    )
    assert first_look([low], scene.view).grid.polygon.area == pytest.approx(0.01, rel=0.05)
    with pytest.raises(ObjectNotSeen, match="higher than 300 mm"):
        first_look([high], scene.view)


def test_an_empty_table_and_an_arm_beside_the_object_are_said(scene, look):
    with pytest.raises(ObjectNotSeen) as none:
        look((), (0, 0, 0))
    assert none.value.reason == "no object"
    assert re.search(r"higher than the [4-9] mm that this camera .* more than 4 cm²", str(none.value))
    arm = np.zeros((480, 640), bool)
    arm[200:280, 200:300] = True
    with pytest.raises(ObjectNotSeen) as hidden:
        look(ELL, (0, 0, 0), blocked=arm)
    assert hidden.value.reason == "occluded"
    with pytest.raises(ValueError, match="at least one"):
        first_look([], scene.view)
