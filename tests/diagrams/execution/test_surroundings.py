"""The arm keeps away from what it pushes, as Drake's own distances between the shapes show."""

from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.geometry import Box
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.execution.arm_motion import FingerKinematics, MotionRefused
from slipmap.diagrams.execution.clearance import APART, ArmClearance, Obstacle, Surroundings
from slipmap.diagrams.execution.plans import ArmPlanner
from slipmap.diagrams.execution.push_executor import PERIOD, PushExecutor
from slipmap.diagrams.execution.requests import ActivePush, ExecutionConfig
from slipmap.diagrams.station.arm import HOME, add_arm, arm_model
from slipmap.diagrams.station.table import ROUND_TABLE
from slipmap.models.geometry import seen_from
from slipmap.models.objects.footprints import cells_from_polygon
from slipmap.models.perception.seen_object import ObservedPose
from slipmap.planners.exploration import candidate_pushes
from slipmap.planners.table_push import TablePush
from tests.diagrams.systems.driven_block import DrivenBlock, seen_at
from tests.models.physics.sliding_objects import signed_distances

LENGTH, WIDTH, HEIGHT = 0.361, 0.129, 0.07
GRID = cells_from_polygon(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [LENGTH / 2, WIDTH / 2], count=60)
POSE = np.array([0.0623, -0.0193, np.deg2rad(-63.3)])
LEANT = np.array([-0.1401, 0.147, -1.6013])
ACROSS = np.array([-np.sin(LEANT[2]), np.cos(LEANT[2])])
BEHIND = TablePush([-0.2201, 0.2965], np.array([-0.2201, 0.2965]) + 0.07 * ACROSS, 0.06)
"""From where the forearm leans over the box, if that lies at `LEANT`."""


def surroundings(height=HEIGHT, pose=POSE):
    return Surroundings(ArmClearance(ROUND_TABLE), Obstacle(GRID, np.full(len(GRID), height), pose))


@pytest.fixture(scope="module")
def kinematics():
    return FingerKinematics(arm_model())


def distance_in_drake(plan, pose):
    """Of arm and hand, but for the finger, from a box during a plan's first three phases."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    arm = add_arm(plant)
    X_WB = RigidTransform(RotationMatrix.MakeZRotation(pose[2]), [*pose[:2], HEIGHT / 2])
    plant.RegisterCollisionGeometry(
        plant.world_body(), X_WB, Box(LENGTH, WIDTH, HEIGHT), "box", CoulombFriction(0.5, 0.5)
    )
    plant.Finalize()
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    fingers = {
        geometry
        for name in ("left_finger", "right_finger")
        for geometry in plant.GetCollisionGeometriesForBody(plant.GetBodyByName(name))
    }
    (box,) = [g for g in plant.GetCollisionGeometriesForBody(plant.world_body())]
    least = np.inf
    for phase in plan.phases[:3]:
        for time in np.linspace(0.0, phase.duration, 25):
            plant.SetPositions(context, arm.iiwa, phase.trajectory.value(time)[:, 0])
            query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(root))
            for pair in query.ComputeSignedDistancePairwiseClosestPoints(0.1):
                ends = {pair.id_A, pair.id_B}
                if box in ends and not ends & fingers:
                    least = min(least, pair.distance)
    return least


def test_the_hand_is_turned_where_the_forearm_would_meet_the_object(kinematics):
    careless = ArmPlanner(kinematics, ExecutionConfig(), HOME).push(BEHIND, HOME)
    assert distance_in_drake(careless, LEANT) < -0.002
    careful = ArmPlanner(kinematics, ExecutionConfig(), HOME).push(BEHIND, HOME, surroundings(pose=LEANT))
    assert distance_in_drake(careful, LEANT) > APART - 0.002
    for plan in (careless, careful):
        ends = [plan.phases[2].trajectory.value(time)[:, 0] for time in (0.0, plan.phases[2].duration)]
        places = [kinematics.pose(q).translation()[:2] for q in ends]
        np.testing.assert_allclose(places, [BEHIND.begin, BEHIND.end], atol=1e-4)


def test_a_push_with_nothing_in_the_way_is_the_same(kinematics):
    away = LEANT + np.array([-0.3, 0.2, 0.0])
    plans = [
        ArmPlanner(kinematics, ExecutionConfig(), HOME).push(BEHIND, HOME, around)
        for around in (None, surroundings(pose=away))
    ]
    times = np.linspace(0.0, plans[0].duration, 20)
    np.testing.assert_array_equal(*[[plan.at(time)[1] for time in times] for plan in plans])


def test_the_finger_is_lowered_into_an_opening_and_leaves_it_upwards(kinematics):
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    frame, radius, height = cells_from_polygon(0.13 * square, [0.09 * square], count=40), 0.008, 0.03
    around = Surroundings(ArmClearance(ROUND_TABLE), Obstacle(frame, np.full(len(frame), height), POSE))
    drawn = candidate_pushes(frame, radius, np.random.default_rng(0), 60, length=(0.05, 0.05))
    inside = [candidate for candidate in drawn if candidate.contact @ candidate.direction > 0.0]
    assert len(inside) > 10
    for candidate in inside[:4]:
        push = TablePush(*candidate.way_at(POSE, candidate.length), 0.06)
        plan = ArmPlanner(kinematics, ExecutionConfig(), HOME).push(push, HOME, around)
        pushing = [phase.mode for phase in plan.phases].index("pushing")
        for number, phase in enumerate(plan.phases):
            moved = candidate.length * push.direction * (number > pushing)
            for time in np.linspace(0.0, phase.duration, 20):
                tip = kinematics.pose(phase.trajectory.value(time)[:, 0]).translation()
                away = signed_distances(frame, seen_from(tip[None, :2] - moved, POSE))[0] - radius
                assert tip[2] > height or number == pushing or away > (0.007 if number < pushing else -1e-4)


def test_what_is_too_high_for_the_arm_is_not_pushed(kinematics):
    with pytest.raises(MotionRefused, match="to the object, the table or itself; it must keep 5 mm"):
        ArmPlanner(kinematics, ExecutionConfig(), HOME).push(BEHIND, HOME, surroundings(height=0.4))


@pytest.mark.parametrize(
    ("height", "pose", "mode", "reason"),
    [
        (HEIGHT, seen_at(*POSE), "approaching", ""),
        (0.4, seen_at(*POSE), "refused", "as near as"),
        (HEIGHT, ObservedPose.unseen("occluded"), "refused", "the arm might hit it: occluded"),
    ],
)
def test_the_executor_heeds_what_is_seen(height, pose, mode, reason):
    seen = SimpleNamespace(grid=GRID, cell_heights=np.full(len(GRID), height))
    block = DrivenBlock(
        PushExecutor(arm_model(), HOME, table=ROUND_TABLE),
        **{
            "push": ActivePush(1, BEHIND),
            "object_pose": pose,
            "seen_object": seen,
            "gripper.state_measured": np.zeros(2),
            "iiwa.position_measured": HOME,
            "iiwa.torque_external": np.zeros(7),
        },
    )
    for _ in range(20):
        block.advance(PERIOD)
    status = block.read("status")
    assert status.mode == mode and status.push_id == 1 and reason in status.reason, status


def test_an_obstacle_of_unknown_height_is_none():
    heights = np.full(len(GRID), HEIGHT)
    heights[3] = np.nan
    with pytest.raises(ValueError, match="finite"):
        Obstacle(GRID, heights, POSE)
