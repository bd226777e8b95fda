"""Errors of one push, against numbers worked out by hand."""

import numpy as np
import pytest

from slipmap.models.geometry import radius_of_gyration
from slipmap.models.inference.error_model import SensorNoise
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.push_errors import (
    errors,
    noise_floor,
    nrmse_fit,
    repeated_pushes,
    resting_errors,
)
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.rollout import Push

GRID = cells_from_polygon(np.array([[-3, -2], [3, -2], [3, 2], [-3, 2]]) * 0.01, width=0.01)
NOISE = SensorNoise(1e-3, 1e-2, 0.1, True)


def observed(poses, start=(0.0, 0.0, 0.0), tip=None, forces=(), name="trials/000.json", duration=1.0):
    poses = np.array(poses, dtype=float)
    steps = 100
    path = np.zeros((steps + 1, 2)) if tip is None else np.asarray(tip)
    forces = np.array(forces, dtype=float).reshape(-1, 2)
    push = Push(
        duration / steps,
        path,
        np.array(start, dtype=float),
        pose_times=np.linspace(0, duration, len(poses) + 1)[1:],
        force_times=np.linspace(0.1, 0.9, len(forces)) * duration,
    )
    return Observation(
        name,
        "fit",
        push,
        poses,
        np.ones(len(poses)),
        1,
        forces,
        np.ones(len(forces)),
        np.ones(len(forces), dtype=bool),
    )


def test_a_shift_is_its_own_length():
    measured = [[0.01, 0, 0], [0.02, 0, 0], [0.03, 0, 0]]
    told = np.add(measured, [[0.001, 0, 0], [0.002, 0, 0], [0.003, 0.004, 0]])
    found = errors(observed(measured), told, None, GRID, NOISE)
    assert found.final_add == pytest.approx(0.005)
    assert found.mean_add == pytest.approx((0.001 + 0.002 + 0.005) / 3)
    assert found.position == pytest.approx(0.005)
    assert found.angle == 0.0
    assert np.isnan(found.force) and np.isnan(found.force_share)


def test_nrmse_is_matlabs():
    measured = np.array([[1.0], [2.0], [3.0], [6.0]])
    assert nrmse_fit(measured, measured) == 100.0
    assert nrmse_fit(measured, np.full((4, 1), 3.0)) == pytest.approx(0.0)
    # ‖y - ŷ‖ = 2, ‖y - mean‖ = √(4 + 1 + 0 + 9).
    assert nrmse_fit(measured, measured + 1.0) == pytest.approx(100 * (1 - 2 / np.sqrt(14)))
    assert np.isnan(nrmse_fit(measured[:1], measured[:1]))


def test_a_push_known_by_its_end_has_no_fit_but_an_error():
    found = errors(observed([[0.02, 0, 0.1]]), np.array([[0.02, 0, 0.3]]), None, GRID, NOISE)
    assert found.final_add == found.mean_add > 0
    assert found.angle == pytest.approx(0.2)
    assert np.isnan(found.fit)


def test_the_angle_counts_in_the_fit_with_the_radius_of_gyration():
    turns = np.array([[0, 0, 0.1], [0, 0, 0.2], [0, 0, 0.6]])
    slides = turns[:, [2, 0, 0]] * radius_of_gyration(GRID)
    shift = np.array([0.0, 0.0, 0.05])
    by_turning = errors(observed(turns), turns + shift, None, GRID, NOISE).fit
    by_sliding = errors(
        observed(slides), slides + shift[[2, 0, 0]] * radius_of_gyration(GRID), None, GRID, NOISE
    ).fit
    assert by_turning == pytest.approx(by_sliding)


def test_forces_are_compared_where_they_count():
    observation = observed([[0, 0, 0]], forces=[[3, 4], [3, 4], [50, 0]])
    observation.sliding[2] = False
    told = np.array([[3, 5], [3, 3], [0, 0]], dtype=float)
    found = errors(observation, observation.poses, told, GRID, NOISE)
    assert found.force == pytest.approx(1.0)
    assert found.force_share == pytest.approx(0.2)


def test_where_no_force_was_measured_though_the_object_moved_its_share_is_open():
    """A cable pulls it away from the finger."""
    observation = observed([[0, 0, 0]], forces=[[0, 0], [0, 0]])
    found = errors(observation, observation.poses, np.array([[3.0, 4.0], [0.0, 0.0]]), GRID, NOISE)
    assert found.force == pytest.approx(np.sqrt(12.5)) and np.isnan(found.force_share)


def test_an_object_at_rest_errs_by_the_whole_way():
    found = resting_errors(observed([[0.03, 0.04, 0.0]]), GRID, NOISE)
    assert found.final_add == pytest.approx(0.05)


def moved(points, pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]


def placed(pose, end, tip, name, duration=1.0):
    """A push that ends at `end` (seen from its start), anywhere on the table."""
    last = np.array([*moved(np.array(end[:2]), pose), pose[2] + end[2]])
    return observed([last], start=pose, tip=moved(tip, pose), name=name, duration=duration)


def test_repeats_are_found_wherever_they_lie_on_the_table_and_others_are_not():
    tip = np.column_stack([np.linspace(-0.05, 0.05, 101), np.full(101, 0.01)])
    here, there = np.array([0.1, 0.2, 0.3]), np.array([-0.3, 0.1, 2.5])
    end = [0.05, 0.0, 0.2]
    pushes = [
        placed(here, end, tip, "a"),
        placed(there, end, np.add(tip, [0, 1e-3]), "b"),
        placed(there, end, np.add(tip, [0, 4e-3]), "another contact"),
        placed(here, end, tip, "faster", duration=0.5),
        placed(here, end, tip[::-1], "back"),
    ]
    assert repeated_pushes(pushes) == [[0, 1]]


def test_scatter_of_repeats_is_the_floor():
    rng = np.random.default_rng(0)
    tip = np.column_stack([np.linspace(-0.05, 0.05, 101), np.zeros(101)])
    scatter = 2e-3
    floors = []
    for _ in range(60):
        ends = [0.05, 0.0, 0.0] + rng.normal(size=(3, 3)) * [scatter, scatter, 0.0]
        pushes = [placed(rng.normal(size=3), end, tip, str(k)) for k, end in enumerate(ends)]
        floor = noise_floor(pushes, NOISE, GRID)
        assert floor is not None and floor.source == "repeats" and floor.repeats == 3
        floors.append(floor.add)
    # The mean length of a planar normal vector is σ √(π/2), whatever the size of the group.
    assert np.mean(floors) == pytest.approx(scatter * np.sqrt(np.pi / 2), rel=0.12)


@pytest.mark.parametrize(("declared", "source"), [(True, "declared noise"), (False, "estimated noise")])
@pytest.mark.parametrize(("position", "angle"), [(1e-3, 0.0), (1e-3, 0.02), (0.0, 0.02)])
def test_noise_of_a_pose_is_the_floor_without_repeats(declared, source, position, angle):
    noise = SensorNoise(position, angle, 0.1, declared)
    floor = noise_floor([observed([[0, 0, 0]])], noise, GRID)
    assert floor is not None and floor.source == source
    drawn = np.random.default_rng(1).normal(size=(40_000, 3)) * noise.of_poses
    assert floor.add == pytest.approx(add(drawn, np.zeros(3), GRID.centers).mean(), rel=0.01)


def test_assumed_noise_is_no_floor():
    noise = SensorNoise(1e-4, 1e-3, 0.1, declared=False, assumed=True)
    assert noise_floor([observed([[0, 0, 0]])], noise, GRID) is None
