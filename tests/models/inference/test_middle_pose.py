"""The pose from which the believed ones are least far."""

import numpy as np
import pytest
from scipy.optimize import minimize

from slipmap.models.inference.summaries import middle_poses
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.paper_notation import add

GRID = cells_from_polygon(np.array([(-0.02, 0.01), (0.2, 0.01), (0.2, 0.06), (-0.02, 0.06)]), count=60)


def test_nothing_else_has_a_smaller_expected_add():
    rng = np.random.default_rng(1)
    poses = np.array([0.1, -0.2, 0.5]) + rng.normal(size=(9, 3)) * [0.01, 0.01, 0.1]
    probability = rng.dirichlet(np.ones(9))

    def expected(pose: np.ndarray) -> float:
        return float(probability @ add(poses, pose, GRID.centers))

    middle = middle_poses(poses, probability, GRID)
    best = minimize(expected, middle, method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-9})
    assert expected(middle) < 1.02 * best.fun
    assert expected(middle) < expected(probability @ poses)


def test_one_that_goes_astray_does_not_carry_the_others_along():
    poses = np.zeros((5, 1, 3))
    poses[:, 0, 0] = [0.0, 0.001, 0.002, 0.003, 0.5]
    middle = middle_poses(poses, np.full(5, 0.2), GRID)
    assert middle.shape == (1, 3)
    assert middle[0] == pytest.approx([0.002, 0.0, 0.0], abs=2e-4)


def test_of_one_pose_it_is_that_pose():
    pose = np.array([[0.3, -0.1, 2.0]])
    assert middle_poses(pose, np.ones(1), GRID) == pytest.approx(pose[0])
