"""Grasps that planning finds, held against the gripper's own model and the object in Drake's scene graph."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.station.sliding_object import BODY, add_sliding_object, plant_config, resting_pose
from slipmap.diagrams.station.table import ROUND_TABLE, TABLE_FRICTION, add_table
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.robots import GRIPPER_MODEL
from slipmap.planners.goals import Graspable
from slipmap.planners.settings import GoalSettings

NEAR = 0.05  # m, beyond which distances do not matter


@pytest.mark.parametrize("name", ["box", "wrench", "snack"])
def test_open_gripper_touches_nothing_and_the_closed_one_the_object(name: str) -> None:
    thing = benchmark_object(name)
    goals = Graspable.of(
        thing.grid, thing.height, thing.center_of_mass[None, :2], [1.0],
        GoalSettings(samples=400), [thing.total_mass],
    ).sample_goals(ROUND_TABLE, np.random.default_rng(0))  # fmt: skip
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(plant_config(2e-3), builder)
    add_table(plant, ROUND_TABLE)
    add_sliding_object(plant, thing, TABLE_FRICTION)
    (gripper,) = Parser(plant).AddModels(str(GRIPPER_MODEL))
    plant.Finalize()
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyContextFromRoot(root)
    tip = plant.GetFrameByName("tip", gripper)
    hand = plant.GetBodyByName("hand", gripper)
    X_TH = tip.CalcPose(context, hand.body_frame()).inverse()
    gripper_bodies = {body: plant.get_body(body).name() for body in plant.GetBodyIndices(gripper)}
    inspector = scene_graph.model_inspector()

    def distances(x: float, y: float, z: float, yaw: float, opening: float) -> dict[str, float]:
        """Least distance of a body of the gripper from table and object."""
        along = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        upward = np.array([0.0, 0.0, 1.0])
        X_WT = RigidTransform(
            RotationMatrix(np.column_stack([np.cross(upward, along), upward, along])), np.array([x, y, z])
        )
        plant.SetFreeBodyPose(context, hand, X_WT @ X_TH)
        for side, sign in (("left", -1), ("right", 1)):
            plant.GetJointByName(f"{side}_finger_joint", gripper).set_translation(context, sign * opening / 2)
        query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(root))
        least = {}
        for pair in query.ComputeSignedDistancePairwiseClosestPoints(NEAR):
            names = [
                plant.GetBodyFromFrameId(inspector.GetFrameId(part)).name() for part in (pair.id_A, pair.id_B)
            ]
            mine = [part for part in names if part in gripper_bodies.values()]
            if len(mine) == 1:
                (other,) = (part for part in names if part not in mine)
                key = f"{mine[0]}-{other}"
                least[key] = min(pair.distance, least.get(key, NEAR))
        return least

    for goal in [goals[k] for k in np.linspace(0, len(goals) - 1, 12).astype(int)]:
        plant.SetFreeBodyPose(context, plant.GetBodyByName(BODY), resting_pose(*goal.pose))
        x, y, z, yaw = goal.grasp.at(goal.pose)
        for back in (0.0, 0.02, 0.05, 0.1, 0.2):
            found = distances(x - back * np.cos(yaw), y - back * np.sin(yaw), z, yaw, goal.grasp.opening)
            assert min(found.values(), default=NEAR) > 2.5e-3, f"{back} m before {goal.pose}: {found}"
        # Closed on the height that planning expects, both pins touch the object, and nothing the table.
        found = distances(x, y, z, yaw, goal.grasp.height + 2 * 0.008)
        assert min((d for key, d in found.items() if key.endswith("table")), default=NEAR) > 2.5e-3
        for side in ("left", "right"):
            assert abs(found[f"{side}_finger-{BODY}"]) < 1.5e-3
