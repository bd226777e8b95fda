"""Inverse kinematics of the finger."""

import numpy as np
import pytest

from slipmap.diagrams.execution.arm_motion import (
    LIMIT_MARGIN,
    WORKING_POSTURE,
    FingerKinematics,
    OutOfReach,
)
from slipmap.diagrams.station.arm import arm_model
from slipmap.models.robots import POSITION_LIMITS


@pytest.fixture(scope="module")
def kinematics():
    return FingerKinematics(arm_model())


@pytest.mark.parametrize("point", [(0, 0, 0.004), (-0.3, 0.2, 0.004), (0.2, -0.2, 0.1), (0, 0.45, 0.05)])
def test_finger_is_there_and_points_down(kinematics, point):
    q = kinematics.inverse(np.array(point))
    X_WT = kinematics.pose(q)
    np.testing.assert_allclose(X_WT.translation(), point, atol=1e-5)
    np.testing.assert_allclose(X_WT.rotation().matrix()[:, 2], [0, 0, -1], atol=1e-4)
    assert np.all(np.abs(q) <= POSITION_LIMITS - LIMIT_MARGIN + 1e-9)


@pytest.mark.parametrize("turn", [-0.5, -0.25, 0.25])
def test_the_hand_has_the_direction_that_is_asked_for(kinematics, turn):
    point = np.array([0.1, -0.05, 0.004])
    yaw = kinematics.yaw(kinematics.inverse(point)) + turn
    assert kinematics.yaw(kinematics.inverse(point, yaw=yaw)) == pytest.approx(yaw, abs=np.deg2rad(0.5))


def test_no_way_to_hold_the_finger_there_is_nearer_to_the_working_posture(kinematics):
    """Turning the elbow about the line from shoulder to wrist keeps the finger in place and leads away."""
    q = kinematics.inverse(np.array([0.05, 0.2, 0.02]))
    jacobian = kinematics.jacobian(q)[:, :6]  # the last joint only turns the finger about its own axis
    elbow = np.linalg.svd(np.vstack([jacobian[3:], jacobian[:2]]))[2][5]
    assert abs(elbow @ (q - WORKING_POSTURE)[:6]) < 1e-2 < np.abs(q - WORKING_POSTURE).max()


def test_reach_is_the_documented_one(kinematics):
    """All of the table, of radius 0.5 m."""
    steps = np.arange(-0.45, 0.46, 0.15)
    points = [(x, y) for x in steps for y in steps if np.hypot(x, y) < 0.5]
    assert len(points) == 37
    for x, y in points:
        kinematics.inverse(np.array([x, y, 0.004]))


def test_jacobian_is_the_derivative_of_the_pose(kinematics):
    q, step = WORKING_POSTURE + 0.1, 1e-6
    jacobian = kinematics.jacobian(q)
    for k in range(7):
        change = step * np.eye(7)[k]
        difference = kinematics.pose(q + change).translation() - kinematics.pose(q - change).translation()
        np.testing.assert_allclose(jacobian[3:, k], difference / (2 * step), atol=1e-8)


def test_neighbouring_points_have_neighbouring_postures(kinematics):
    q = kinematics.inverse(np.array([-0.1, 0.3, 0.004]))
    for x in np.arange(-0.1, 0.2, 0.01):
        following = kinematics.inverse(np.array([x, 0.3, 0.004]), near=q)
        assert np.abs(following - q).max() < 0.15
        q = following


def test_a_point_too_far_is_named(kinematics):
    with pytest.raises(
        OutOfReach, match=r"\(0\.900, 0\.000\) m, 0\.004 m high: this is out of the arm's reach"
    ):
        kinematics.inverse(np.array([0.9, 0.0, 0.004]))


def test_the_joint_in_the_way_is_named(kinematics):
    """Close under the shoulder the elbow cannot bend enough."""
    with pytest.raises(OutOfReach, match=r"iiwa_joint_\d would have to turn to -?\d+ degrees; \d+ are"):
        kinematics.inverse(np.array([-0.25, 0.0, 0.3]))


def test_same_point_same_posture_to_the_bit(kinematics):
    point = np.array([0.1, 0.1, 0.004])
    first = kinematics.inverse(point)
    kinematics.inverse(np.array([-0.2, 0.3, 0.1]))
    np.testing.assert_array_equal(kinematics.inverse(point), first)
