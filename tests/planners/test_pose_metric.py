"""Poses in SE(2) against matrices, and gaps against the distances of all cells."""

import numpy as np
import pytest

from slipmap.models.geometry import compose, relative, turned_to
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.paper_notation import cell_poses
from slipmap.planners.waypoints import PoseMetric


def matrix(pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0, 0, 1]])


def test_composing_and_relative_poses_are_products_of_matrices():
    one, other = np.array([0.3, -0.2, 2.5]), np.array([[-0.1, 0.4, 1.5], [0.2, 0.0, -3.0]])
    for row, result in zip(other, compose(one, other), strict=True):
        assert matrix(result) == pytest.approx(matrix(one) @ matrix(row))
    for row, result in zip(other, relative(one, other), strict=True):
        assert matrix(result) == pytest.approx(np.linalg.inv(matrix(one)) @ matrix(row))


def test_the_gap_is_the_root_mean_square_distance_of_the_cells():
    grid = benchmark_object("hammer").grid
    rng = np.random.default_rng(0)
    one, other = rng.standard_normal((2, 4, 3))
    metric = PoseMetric(grid)
    cells = [cell_poses(poses, grid.centers).reshape(4, -1, 3)[..., :2] for poses in (one, other)]
    expected = np.sqrt(((cells[0][:, None] - cells[1]) ** 2).sum(axis=-1).mean(axis=-1))
    assert metric.gaps(one, other) == pytest.approx(expected, rel=1e-9)
    assert metric.gap(one, other) == pytest.approx(np.diagonal(expected), rel=1e-12)


def test_a_single_cell_counts_as_the_square_that_it_is():
    """Its gap to itself, turned by a small angle, is that of many points spread over it."""
    corners = np.array([[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03], [-0.03, 0.03]])
    single, pose = (
        CellGrid(np.array([[0.01, 0.0]]), 0.06, corners + np.array([0.01, 0.0])),
        np.array([0.1, 0.2, 0.3]),
    )
    turned = compose(pose, np.array([0.01 - 0.01 * np.cos(0.02), -0.01 * np.sin(0.02), 0.02]))
    fine = (np.arange(200) + 0.5) / 200 * 0.06 - 0.03
    distance = 2 * np.sin(0.01) * np.hypot(*np.meshgrid(fine, fine))
    assert PoseMetric(single).gap(turned, pose) == pytest.approx(np.sqrt((distance**2).mean()), rel=1e-4)


def test_angles_wrap_to_half_a_turn():
    assert turned_to(np.array([0.0, 0.0, -3.0]), 9.0)[2] == pytest.approx(4 * np.pi - 3.0)
