"""The whole loop as one Diagram: see, choose, push, record, learn, and show what is believed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Diagram, DiagramBuilder

from diagrams.execution.config import ExecutionConfig
from diagrams.execution.finger_kinematics import FingerKinematics
from diagrams.execution.motion import MotionRefused
from diagrams.execution.push_executor import PushExecutor
from diagrams.execution.push_plan import plan_push
from diagrams.perception.cell_perception import CellPerception
from diagrams.station.arm import HOME, arm_model
from diagrams.station.scenario import Scenario
from diagrams.station.scenario_file import ScenarioError
from diagrams.station.station import Station
from diagrams.systems.belief_visualizer import BeliefVisualizer
from diagrams.systems.exploration import Exploration
from diagrams.systems.finger_motion import FingerMotion
from diagrams.systems.identification import Identification
from diagrams.systems.measurement_logger import MeasurementLogger, dataset_of
from diagrams.systems.multiverse_slider import MultiverseSlider
from diagrams.systems.push_supervisor import PushSupervisor
from models.inference.belief import Belief
from models.measurements import PushDataset, Trial
from models.measurements.push_dataset import Noise
from models.physics.cell_grid import CellGrid
from models.robots import FINGER_RADIUS
from planners.table_push import TablePush

STEP = 0.01
"""s, of the hypotheses that run beside the real object."""

SENSORS = Noise(position=0.4e-3, angle=float(np.radians(0.2)), tip=0.1e-3, force=0.3)
"""Of the camera's poses, the arm's joint sensors and the force taken from its torques."""


@dataclass(frozen=True)
class LoopOptions:
    """What the loop is to do.

    Attributes:
        pushes: to learn from.
        checks: pushes after these that only judge the belief.
        strategy: one of `planners.strategies.STRATEGIES`.
        cells: wanted number of cells.
        hypotheses: K.
        seed: of every draw.
    """

    pushes: int = 5
    checks: int = 0
    strategy: str = "most-distinctive"
    cells: int = 60
    hypotheses: int = 20
    seed: int = 0


def exploration_loop(
    scenario: Scenario,
    options: LoopOptions,
    *,
    meshcat: Meshcat | None = None,
    learned: Callable[[Belief, int], None] | None = None,
) -> Diagram:
    """The station with everything that explores the object on its table.

    Its systems are named `station`, `perception`, `supervisor`, `exploration`, `executor`, `logger`,
    `identification`, `multiverse`, and with Meshcat `belief_visualizer`.

    Args:
        scenario: what the cell is like.
        options: what to do.
        meshcat: where to show it, if anywhere.
        learned: called with every belief as it forms and the number of pushes that it comes from.

    Raises:
        ScenarioError: an object, a surface or a hidden effect that cannot be had.
        ValueError: an unknown strategy.
        RendererUnavailable: this machine cannot render pictures.
    """
    builder = DiagramBuilder()
    try:
        station = builder.AddSystem(Station(scenario, meshcat))
    except ValueError as error:
        raise ScenarioError(str(error)) from error
    config = scenario.execution
    model = arm_model(models=scenario.arm.models)
    perception = builder.AddNamedSystem(
        "perception", CellPerception(scenario.camera, options.cells, station.arm_hulls)
    )
    supervisor = builder.AddNamedSystem("supervisor", PushSupervisor(options.pushes, options.checks))
    executor = builder.AddNamedSystem("executor", PushExecutor(model, HOME, config))
    exploration = builder.AddNamedSystem(
        "exploration",
        Exploration(
            options.strategy, options.pushes, FINGER_RADIUS, scenario.pokes,
            _makes(FingerKinematics(model), config), options.seed,
        ),
    )  # fmt: skip
    logger = builder.AddNamedSystem("logger", MeasurementLogger(options.pushes))
    identification = builder.AddNamedSystem(
        "identification",
        Identification(
            lambda trials, grid: recorded_dataset(trials, grid, scenario),
            hypotheses=options.hypotheses, seed=options.seed, learned=learned,
        ),
    )  # fmt: skip
    finger = builder.AddNamedSystem("finger", FingerMotion(STEP))
    multiverse = builder.AddNamedSystem("multiverse", MultiverseSlider(STEP))
    wires = [
        (station, "camera.depth_image", perception, "depth_image"),
        (station, "camera.X_WC", perception, "X_WC"),
        (station, "iiwa.position_measured", perception, "arm_position"),
        (station, "iiwa.position_measured", executor, "iiwa.position_measured"),
        (station, "iiwa.torque_external", executor, "iiwa.torque_external"),
        (executor, "iiwa.position", station, "iiwa.position"),
        (executor, "gripper.position", station, "gripper.position"),
        (perception, "object_pose", supervisor, "object_pose"),
        (perception, "cell_grid", supervisor, "cell_grid"),
        (exploration, "poke", supervisor, "poke"),
        (executor, "status", supervisor, "execution"),
        (logger, "records", supervisor, "records"),
        (identification, "learned", supervisor, "learned"),
        (supervisor, "active_push", executor, "push"),
        (identification, "belief", exploration, "belief"),
        (perception, "object_pose", exploration, "object_pose"),
        (perception, "cell_grid", exploration, "cell_grid"),
        (supervisor, "status", exploration, "status"),
        (perception, "object_pose", logger, "object_pose"),
        (executor, "tip_pose", logger, "tip_pose"),
        (executor, "tip_force", logger, "tip_force"),
        (executor, "status", logger, "execution"),
        (supervisor, "status", logger, "status"),
        (logger, "records", identification, "records"),
        (perception, "cell_grid", identification, "cell_grid"),
        (executor, "tip_pose", finger, "tip_pose"),
        (executor, "status", finger, "execution"),
        (finger, "finger", multiverse, "finger"),
        (identification, "belief", multiverse, "belief"),
        (perception, "object_pose", multiverse, "object_pose"),
        (supervisor, "active_push", multiverse, "push"),
    ]
    if meshcat is not None:
        visualizer = builder.AddSystem(BeliefVisualizer(meshcat))
        wires += [
            (identification, "belief", visualizer, "belief"),
            (perception, "object_pose", visualizer, "object_pose"),
            (perception, "seen_object", visualizer, "seen_object"),
            (multiverse, "mean_pose", visualizer, "predicted_pose"),
            (supervisor, "active_push", visualizer, "push"),
        ]
    for source, output, target, target_input in wires:
        builder.Connect(source.GetOutputPort(output), target.GetInputPort(target_input))
    loop = builder.Build()
    loop.set_name("exploration_loop")
    return loop


def recorded_dataset(trials: Sequence[Trial], grid: CellGrid, scenario: Scenario) -> PushDataset:
    """What the loop recorded, as a push dataset."""
    return dataset_of(
        trials,
        grid,
        name=scenario.object.called,
        finger_radius=FINGER_RADIUS,
        noise=SENSORS,
        table=scenario.table.make(),
        description="Recorded by the station's arm and depth camera.",
    )


def _makes(kinematics: FingerKinematics, config: ExecutionConfig) -> Callable[[TablePush], bool]:
    """Whether the arm can make a push from home."""

    def allowed(push: TablePush) -> bool:
        try:
            plan_push(kinematics, push, HOME, HOME, config)
        except MotionRefused:
            return False
        return True

    return allowed
