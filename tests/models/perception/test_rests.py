"""Places where an object rests: which pictures count, and what they make of the outline."""

import numpy as np
import pytest
import shapely

from slipmap.models.geometry import placed
from slipmap.models.perception.pinhole_camera import pixel_size
from slipmap.models.perception.pose_tracking import outline_offsets, track
from slipmap.models.perception.seen_object import Rests, mean_offsets, sharpened

HERE, THERE = np.array([0.0, 0.0, 0.1]), np.array([0.004, 0.0, 0.1])
STEP = ((-0.1, -0.03, 0.1, 0.03, 0.03), (0.04, 0.03, 0.1, 0.05, 0.03))
FRAME = ((-0.1, -0.1, 0.1, -0.05, 0.04), (-0.1, 0.05, 0.1, 0.1, 0.04))
FRAME += ((-0.1, -0.1, -0.05, 0.1, 0.04), (0.05, -0.1, 0.1, 0.1, 0.04))


def with_looks(rests, pose, number, value=1e-3, hidden=0):
    for _ in range(number):
        offsets = np.full(20, value)
        offsets[:hidden] = np.nan
        rests = rests.with_look(pose, offsets)
    return rests


def test_six_looks_at_a_new_place_count_once():
    rests = Rests((np.zeros(20),), HERE)
    assert not rests.wants(HERE + np.array([0.001, -0.001, 0.01]))
    assert rests.wants(THERE) and rests.wants(HERE + np.array([0, 0, 0.02]))
    five = with_looks(rests, THERE, 5)
    assert len(five.offsets) == 1 and five.wants(THERE)
    six = with_looks(five, THERE, 1, value=4e-3)
    assert len(six.offsets) == 2 and not six.wants(THERE)
    assert six.offsets[1] == pytest.approx(1.5e-3, abs=1e-12)


def test_an_object_that_moves_or_is_hidden_is_not_at_rest():
    rests = Rests((np.zeros(20),), HERE)
    assert len(with_looks(rests, THERE, 30, hidden=3).offsets) == 1
    moving = rests
    for number in range(30):
        moving = with_looks(moving, HERE + np.array([0.0025 * number, 0, 0]), 1)
    assert len(moving.offsets) == 1
    for number in range(60):  # at 10 Hz, 3 mm/s
        moving = with_looks(moving, HERE + np.array([0.0003 * number, 0, 0]), 1)
    assert len(moving.offsets) == 1
    # What was seen of one place does not count for the next.
    later = with_looks(with_looks(rests, THERE, 5, value=9e-3), 2 * THERE, 6)
    assert later.offsets[1] == pytest.approx(1e-3, abs=1e-12)


def test_an_object_whose_pose_is_noisy_is_at_rest():
    """Two seconds at 10 Hz, with the noise of poses of the flattest of the six objects."""
    rng, complete = np.random.default_rng(0), 0
    for _ in range(200):
        rests = Rests((np.zeros(20),), HERE)
        for noise in rng.normal(0.0, [4e-4, 4e-4, np.deg2rad(0.15)], (20, 3)):
            if rests.wants(2 * THERE + noise):
                rests = with_looks(rests, 2 * THERE + noise, 1)
        complete += len(rests.offsets) == 2
    assert complete > 190


def test_points_that_are_never_seen_have_no_offset():
    nowhere = mean_offsets([np.array([np.nan, 1e-3, 2e-3]), np.array([np.nan, np.nan, 4e-3])])
    assert np.array_equal(nowhere, [np.nan, 1e-3, 3e-3], equal_nan=True)


def rests_of(scene, seen, boxes, poses):
    rng = np.random.default_rng(3)
    for pose in poses:
        pictures = [scene.noisy(scene.depth(boxes, pose), rng) for _ in range(6)]
        start = np.array([*placed(seen.first_pose[:2] - poses[0][:2], pose), pose[2]])
        looks = [(picture, track(picture, scene.view, seen, start).pose) for picture in pictures]
        yield mean_offsets([outline_offsets(picture, scene.view, seen, at) for picture, at in looks])


@pytest.mark.parametrize("boxes", [STEP, FRAME])
def test_an_outline_seen_at_five_places_halves_the_error_of_the_first_look(scene, look, boxes):
    poses = [[0.02, 0.01, 0.0], [0.05, -0.03, 0.3], [-0.04, 0.02, 0.9], [0.0, 0.06, -0.4], [0.07, 0.0, 0.6]]
    poses = np.array(poses)
    seen = look(boxes, poses[0])
    grid = sharpened(seen, list(rests_of(scene, seen, boxes, poses)), pixel_size(scene.view))
    true = shapely.union_all([shapely.box(*box[:4]) for box in boxes])

    def off(one):
        """Root mean square of the distances from the true outline, m, with the origin where it fits best."""
        line = shapely.segmentize(one.polygon.boundary, 1e-3)
        shifts = true.centroid.x - one.polygon.centroid.x, true.centroid.y - one.polygon.centroid.y
        points = shapely.points(shapely.get_coordinates(line) + shifts)
        return float(np.sqrt(np.mean(shapely.distance(true.boundary, points) ** 2)))

    before, after = off(seen.grid), off(grid)
    print(f"{1e3 * before:.2f} mm, then {1e3 * after:.2f} mm")
    assert len(grid.holes) == len(true.interiors)
    assert after < 0.25e-3
    assert after < 0.6 * before
    assert sharpened(seen, (), pixel_size(scene.view)) is seen.grid
