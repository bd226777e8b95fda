"""Distances of the arm from table, stand and object, held against Drake's own of the same shapes."""

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.execution.arm_motion import FingerKinematics
from slipmap.diagrams.execution.clearance import ArmClearance, Obstacle
from slipmap.diagrams.station.arm import HOME, add_arm, arm_model
from slipmap.diagrams.station.table import ROUND_TABLE, add_table
from slipmap.models.objects.footprints import cells_from_polygon
from slipmap.models.robots import GRIPPER_OPENING, POSITION_LIMITS


@pytest.fixture(scope="module")
def clearance():
    return ArmClearance(ROUND_TABLE)


@pytest.fixture(scope="module")
def kinematics():
    return FingerKinematics(arm_model())


class DrakesDistances:
    """Of the arm from the table top, by Drake."""

    def __init__(self):
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
        add_table(self.plant)
        self.arm = add_arm(self.plant)
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.context = self.diagram.CreateDefaultContext()

    def __call__(self, q, opening):
        context = self.plant.GetMyMutableContextFromRoot(self.context)
        self.plant.SetPositions(context, self.arm.iiwa, q)
        self.plant.SetPositions(context, self.arm.gripper, [-opening / 2, opening / 2])
        scene = self.scene_graph.GetMyContextFromRoot(self.context)
        query = self.scene_graph.get_query_output_port().Eval(scene)
        inspector = query.inspector()
        return min(
            (
                pair.distance
                for pair in query.ComputeSignedDistancePairwiseClosestPoints(0.5)
                if "table::top" in (inspector.GetName(pair.id_A), inspector.GetName(pair.id_B))
            ),
            default=0.5,
        )


def test_distance_from_the_table_is_drakes(clearance, kinematics):
    """Balls cover neither the corners of flat ends, by 4 mm, nor do they end with a pin, by 2 mm."""
    drakes = DrakesDistances()
    postures = [kinematics.inverse(np.array([x, 0.1, 0.02])) for x in (-0.2, 0.1)]
    beside = np.array([-0.48, 1.27, 2.28, 1.36, 2.62, -1.56, -1.45])
    postures.append(kinematics.level(np.array([-0.36, -0.38, 0.01]), np.deg2rad(46), beside))
    for q in postures:
        for opening in (0.0, GRIPPER_OPENING):
            exact = drakes(q, opening)
            assert exact < 0.1
            assert exact - 2.1e-3 <= clearance.of(q, opening) <= exact + 4e-3


def test_distance_from_the_object_counts_what_is_asked_for(clearance, kinematics):
    grid = cells_from_polygon([(-0.05, -0.05), (0.05, -0.05), (0.05, 0.05), (-0.05, 0.05)], count=25)
    pose = np.array([0.1, -0.1, np.deg2rad(30)])
    obstacle = Obstacle(grid, np.full(len(grid), 0.06), pose)
    side = np.array([np.cos(pose[2]), np.sin(pose[2])])
    beside = kinematics.inverse(np.array([*(pose[:2] + 0.088 * side), 0.04]))
    assert clearance.of(beside, 0.0, obstacle) == pytest.approx(0.03, abs=1.5e-3)
    assert clearance.of(beside, 0.0) > 0.015
    over = kinematics.inverse(np.array([*pose[:2], 0.05]))
    assert clearance.of(over, 0.0, obstacle) < -0.005
    assert clearance.of(over, 0.0, obstacle, holding=True) > 0.0


def test_while_pushing_the_object_may_be_where_it_was_or_where_it_was_moved(clearance, kinematics):
    grid = cells_from_polygon([(-0.05, -0.05), (0.05, -0.05), (0.05, 0.05), (-0.05, 0.05)], count=25)
    heights, pose, moved = np.full(len(grid), 0.07), np.array([0.1, -0.1, 0.5]), np.array([0.03, 0.02])
    places = [np.array([x, y, 0.06]) for x, y in ((0.19, -0.1), (0.03, -0.12), (0.14, -0.01))]
    postures = np.array([kinematics.inverse(place) for place in places])
    for q in postures:
        both = [
            clearance.of(q, 0.0, Obstacle(grid, heights, pose + share * np.append(moved, 0.0)))
            for share in (0.0, 1.0)
        ]
        assert abs(both[0] - both[1]) > 1e-3
        found = clearance.of_pushing(q[None], Obstacle(grid, heights, pose), moved[None], low=False)
        assert found == pytest.approx(min(both), abs=1e-12)


def test_obstacle_is_boxes_turned_with_the_object():
    grid = cells_from_polygon([(-0.1, -0.02), (0.1, -0.02), (0.1, 0.02), (-0.1, 0.02)], count=20)
    obstacle = Obstacle(grid, np.full(len(grid), 0.05), np.array([0.2, 0.1, np.pi / 2]))
    points = np.array([[0.2, 0.23, 0.02], [0.2, 0.1, 0.09], [0.25, 0.1, 0.09], [0.19, 0.11, 0.045]])
    expected = [0.03, 0.04, np.hypot(0.03, 0.04), -0.005]
    np.testing.assert_allclose(obstacle.distance(points), expected, atol=1e-9)


def test_arm_folded_into_its_own_stand_is_too_close(clearance):
    assert clearance.of(HOME, GRIPPER_OPENING) > 0.05
    folded = np.array([0.0, np.deg2rad(115), 0.0, np.deg2rad(-118), 0.0, np.deg2rad(-60), 0.0])
    turns = [folded + np.array([turn, 0, 0, 0, 0, 0, 0]) for turn in np.linspace(-2.9, 2.9, 9)]
    assert min(clearance.of(np.clip(q, -POSITION_LIMITS, POSITION_LIMITS), 0.0) for q in turns) < 0.0


def test_the_balls_at_the_fingers_end_do_not_stick_out_of_it(clearance, kinematics):
    centers = kinematics.pose(HOME).inverse() @ clearance.centers(HOME, 0.0).T
    assert (centers[2] + clearance._radii).max() == pytest.approx(0.0, abs=1e-6)
