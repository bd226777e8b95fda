"""Plans of grasps at the table's edge: where the gripper goes, and what it stays clear of."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from slipmap.diagrams.execution.arm_motion import FingerKinematics, MotionRefused
from slipmap.diagrams.execution.clearance import ArmClearance, Obstacle
from slipmap.diagrams.execution.plans import CLEAR, CLOSE, LIFT, ArmPlanner
from slipmap.diagrams.execution.requests import ActiveGrasp, ExecutionConfig
from slipmap.diagrams.station.arm import HOME, arm_model
from slipmap.diagrams.station.table import ROUND_TABLE
from slipmap.models.objects.footprints import cells_from_polygon
from slipmap.models.robots import (
    ACCELERATION_LIMITS,
    GRIP_FORCE,
    GRIPPER_OPENING,
    POSITION_LIMITS,
    SPEED_LIMITS,
)
from slipmap.planners.grasps import Grasp

GRID = cells_from_polygon([(-0.15, -0.04), (0.15, -0.04), (0.15, 0.04), (-0.15, 0.04)], count=40)
HEIGHT = 0.03
GRASP = Grasp(
    patch=np.array([0.13, 0.0]), approach=np.pi, opening=GRIPPER_OPENING, tip=np.array([0.1, 0.0]),
    height=HEIGHT, length=0.05, force=10.0,
)  # fmt: skip


def at_rim(degrees, out=0.43):
    """A plank that points outward and sticks out by 8 cm."""
    angle = np.deg2rad(degrees)
    pose = np.array([out * np.cos(angle), out * np.sin(angle), angle])
    return ActiveGrasp(3, GRASP, pose, GRID, np.full(len(GRID), HEIGHT))


@pytest.fixture(scope="module")
def kinematics():
    return FingerKinematics(arm_model())


@pytest.fixture(scope="module")
def clearance():
    return ArmClearance(ROUND_TABLE)


@pytest.fixture(scope="module")
def planned(kinematics, clearance):
    request = at_rim(130)
    return request, ArmPlanner(kinematics, ExecutionConfig(), HOME).grasp(clearance, request, HOME)


def phase_of(plan, mode):
    return [phase for phase in plan.phases if phase.mode == mode]


def test_gripper_opens_then_closes_with_its_force_and_stays_so(planned):
    _, plan = planned
    for phase in plan.phases:
        expected = GRIPPER_OPENING if phase.mode == "reaching" else 0.0
        assert phase.opening == phase.opening_at(phase.duration) == expected
        assert phase.force == GRIP_FORCE or phase.mode == "reaching"
    for phase, following in pairwise(plan.phases):
        assert following.opening_at(0.0) == phase.opening
    order = [phase.mode for phase in plan.phases]
    assert order[-4:] == ["reaching", "closing", "lifting", "holding"]
    assert set(order[:-4]) == {"reaching"}


def test_pins_come_in_level_along_the_approach_one_above_the_other(planned, kinematics):
    request, plan = planned
    x, y, z, yaw = request.grasp.at(request.pose)
    ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    coming = phase_of(plan, "reaching")[-1].trajectory
    for time in np.linspace(0, coming.end_time(), 40):
        X_WT = kinematics.pose(coming.value(time)[:, 0])
        np.testing.assert_allclose(X_WT.rotation().matrix()[:, 2], ahead, atol=2e-3)
        np.testing.assert_allclose(X_WT.rotation().matrix()[:, 1], [0, 0, -1], atol=2e-3)
        beside = X_WT.translation() - [x, y, z]
        assert np.linalg.norm(beside - (beside @ ahead) * ahead) < 0.5e-3
    np.testing.assert_allclose(X_WT.translation(), [x, y, z], atol=1e-4)
    first = kinematics.pose(coming.value(0.0)[:, 0]).translation()
    assert (first - [x, y, z]) @ ahead < -0.05


def test_object_is_lifted_straight_up(planned, kinematics):
    _, plan = planned
    lifting = phase_of(plan, "lifting")[0].trajectory
    tip = np.array(
        [
            kinematics.pose(lifting.value(t)[:, 0]).translation()
            for t in np.linspace(0, lifting.end_time(), 40)
        ]
    )
    np.testing.assert_allclose(tip[-1] - tip[0], [0, 0, LIFT], atol=1e-4)
    assert np.abs(tip[:, :2] - tip[0, :2]).max() < 0.5e-3


def test_limits_hold_and_there_are_no_leaps(planned):
    _, plan = planned
    step = 2e-3
    q = np.array([plan.at(time)[1] for time in np.arange(0, plan.duration, step)])
    np.testing.assert_allclose(q[0], HOME, atol=1e-9)
    assert np.all(np.abs(q) <= POSITION_LIMITS)
    assert np.all(np.abs(np.diff(q, axis=0)) / step <= SPEED_LIMITS)
    assert np.all(np.abs(np.diff(q, 2, axis=0)) / step**2 <= 1.01 * ACCELERATION_LIMITS)


def test_nothing_is_touched_on_the_way(planned, clearance):
    request, plan = planned
    obstacle = Obstacle(request.grid, request.heights, request.pose)
    *way, coming = phase_of(plan, "reaching")
    for phase in way:
        for time in np.linspace(0, phase.duration, 40):
            q = phase.trajectory.value(time)[:, 0]
            assert clearance.of(q, phase.opening, obstacle) > CLEAR - 4e-3
    for time in np.linspace(0, coming.duration, 20):
        q = coming.trajectory.value(time)[:, 0]
        assert clearance.of(q, coming.opening, obstacle, holding=True) > CLOSE - 1e-3


@pytest.mark.parametrize("degrees", [110, 155, -120])
def test_the_near_half_of_the_rim_is_served(kinematics, clearance, degrees):
    ArmPlanner(kinematics, ExecutionConfig(), HOME).grasp(clearance, at_rim(degrees), HOME)


def test_the_far_side_is_out_of_reach(kinematics, clearance):
    with pytest.raises(MotionRefused, match=r"pointing to 200 degrees: this is out of the arm's reach"):
        ArmPlanner(kinematics, ExecutionConfig(), HOME).grasp(clearance, at_rim(20), HOME)


def test_a_gripper_that_would_touch_the_table_is_refused(kinematics, clearance):
    request = at_rim(130)
    deep = replace(request, grasp=replace(GRASP, tip=np.array([0.06, 0.0])))
    with pytest.raises(MotionRefused, match=r"while coming in the arm would be -?\d+ mm from something"):
        ArmPlanner(kinematics, ExecutionConfig(), HOME).grasp(clearance, deep, HOME)


def test_same_grasp_same_plan_to_the_bit(planned, kinematics, clearance):
    request, plan = planned
    again = ArmPlanner(kinematics, ExecutionConfig(), HOME).grasp(clearance, request, HOME)
    assert again.duration == plan.duration
    for time in np.linspace(0, plan.duration, 10):
        np.testing.assert_array_equal(again.at(time)[1], plan.at(time)[1])
