"""The whole pre-grasp procedure as one Diagram: explore, push to the table's edge, grasp and lift."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Diagram, DiagramBuilder

from diagrams.execution.arm_checks import ArmChecks
from diagrams.exploration_loop import LoopOptions, add_exploration, connect
from diagrams.hardware.interface import HardwareInterface
from diagrams.perception.sight import Sight
from diagrams.station.arm import HOME
from diagrams.station.scenario import Scenario
from diagrams.station.station import Station
from diagrams.systems.goal_and_push_planner import GoalAndPushPlanner
from diagrams.systems.pregrasp_supervisor import PregraspSupervisor
from diagrams.systems.push_supervisor import PATIENCE, PATIENCE_REAL
from models.inference.belief import Belief
from models.objects.true_object import TrueObject
from models.perception.camera import View
from models.perception.seen_object import SeenObject
from models.physics.maps import Maps
from planners.pose_metric import compose, relative
from planners.pregrasp_settings import PregraspSettings

ENOUGH_SEEN = 0.85
"""Share of the cells that the camera has to see at a goal, past the arm and inside the picture."""


@dataclass(frozen=True)
class PregraspOptions:
    """What the loop is to do.

    Attributes:
        exploration: how the object is explored; its seed is that of every draw.
        method: of planning, one of `planners.methods.METHODS`.
        pushes: most pushes towards the edge.
    """

    exploration: LoopOptions = field(default_factory=LoopOptions)
    method: str = "probabilistic"
    pushes: int = 20


def pregrasp_loop(
    scenario: Scenario,
    options: PregraspOptions,
    *,
    cell: HardwareInterface | None = None,
    worker: Executor | None = None,
    meshcat: Meshcat | None = None,
    learned: Callable[[Belief, int], None] | None = None,
) -> Diagram:
    """The exploration loop with everything that brings the object to the edge and lifts it.

    To the systems of `exploration_loop` come `planner` and `pregrasp_supervisor`, which commands the arm.

    Args:
        scenario: what the cell is like.
        options: what to do.
        cell, worker: see `exploration_loop`; a real cell knows no truth to plan with.
        meshcat: where to show it, if anywhere.
        learned: called with every belief as it forms and the number of pushes that it comes from.

    Raises:
        ScenarioError, ValueError, RendererUnavailable: see `exploration_loop`.
    """
    builder = DiagramBuilder()
    blocks = add_exploration(
        builder, scenario, options.exploration, cell=cell, worker=worker, meshcat=meshcat, learned=learned
    )
    table = scenario.table.make()
    checks = ArmChecks(scenario.arm.models, table, scenario.execution)
    camera = View(scenario.camera.intrinsics, scenario.camera.X_WC.GetAsMatrix4())
    sight = Sight(camera, blocks.station.arm_hulls(HOME))
    truth = None
    if isinstance(blocks.station, Station):
        truth = partial(true_maps, blocks.station.true_object, scenario.object.pose)
    planner = builder.AddNamedSystem(
        "planner",
        GoalAndPushPlanner(
            PregraspSettings(
                poke=scenario.pokes, goals=scenario.goals, push=scenario.pushes, pushes=options.pushes
            ),
            table,
            method=options.method,
            can_push=checks.can_push,
            can_grasp=checks.can_grasp,
            can_see=lambda seen, pose: sight.share(seen, pose) > ENOUGH_SEEN,
            seed=options.exploration.seed,
            truth=truth,
            worker=worker,
        ),
    )
    patience = PATIENCE if worker is None else PATIENCE_REAL
    commander = builder.AddNamedSystem("pregrasp_supervisor", PregraspSupervisor(patience))
    connect(
        builder,
        [
            *blocks.wires(commander),
            (blocks.supervisor, "status", commander, "exploration"),
            (blocks.supervisor, "active_push", commander, "exploring_push"),
            (blocks.perception, "object_pose", commander, "object_pose"),
            (planner, "plan", commander, "plan"),
            (blocks.executor, "status", commander, "execution"),
            (blocks.logger, "records", commander, "records"),
            (blocks.station, "gripper.state_measured", commander, "gripper.state_measured"),
            (commander, "active_grasp", blocks.executor, "grasp"),
            (blocks.identification, "belief", planner, "belief"),
            (blocks.perception, "object_pose", planner, "object_pose"),
            (blocks.perception, "seen_object", planner, "seen_object"),
            (commander, "status", planner, "status"),
        ],
    )
    loop = builder.Build()
    loop.set_name("pregrasp_loop")
    return loop


def true_maps(true_object: TrueObject, pose: list[float], seen: SeenObject) -> Maps:
    """The truth over the cells that the camera made out: each takes from the true cell that is nearest.

    Args:
        true_object: the object.
        pose: x, y (m) and turn (degrees) at which it lay at the first look.
        seen: what the camera made of it then.

    Returns:
        One hypothesis with the true total mass.
    """
    X_WO = np.array([pose[0], pose[1], np.radians(pose[2])])
    X_OS = relative(X_WO, seen.first_pose)
    centers = compose(X_OS, np.pad(seen.grid.centers, ((0, 0), (0, 1))))[:, :2]
    away = np.linalg.norm(centers[:, None] - true_object.grid.centers, axis=-1)
    cell = away.argmin(axis=1)
    mass = true_object.mass[cell]
    mass = mass * (true_object.total_mass / mass.sum())
    return Maps(mass[None], true_object.mu[cell][None], np.array([true_object.mu_finger]))
