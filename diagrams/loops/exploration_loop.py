"""The whole loop as one Diagram: see, choose, push, record, learn, and show what is believed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem, System

from slipmap.diagrams.execution.plans import ArmChecks
from slipmap.diagrams.execution.push_executor import ObjectWatch, PushExecutor
from slipmap.diagrams.hardware.guard import CommandGuard
from slipmap.diagrams.hardware.interface import HardwareInterface
from slipmap.diagrams.perception.cell_perception import CellPerception
from slipmap.diagrams.station.arm import HOME, arm_model
from slipmap.diagrams.station.scenario import Scenario, ScenarioError
from slipmap.diagrams.station.station import Station
from slipmap.diagrams.systems.belief_visualizer import BeliefVisualizer
from slipmap.diagrams.systems.exploration import Exploration
from slipmap.diagrams.systems.finger import FingerMotion
from slipmap.diagrams.systems.identification import Identification
from slipmap.diagrams.systems.measurement_logger import MeasurementLogger, dataset_of
from slipmap.diagrams.systems.model_monitor import ModelMonitor
from slipmap.diagrams.systems.multiverse_slider import MultiverseSlider
from slipmap.diagrams.systems.supervisors import PATIENCE, PATIENCE_REAL, PushSupervisor
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements import PushDataset, Trial
from slipmap.models.measurements.push_dataset import Noise
from slipmap.models.perception.first_look import FirstPicture
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.robots import FINGER_RADIUS
from slipmap.planners.action_selection import Choice

# What a run of the robot's cell has recorded so far: enough for another process to go on from.


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """Pushes that were made, and what is known besides.

    Attributes:
        trials: that are complete, one or more.
        choices: how they were asked for; as many.
        places: where the simulated object lay after each, x and y in m, turn in degrees; None of a real one.
        grid: the object as the camera made it out.
        first: the picture from which.
    """

    trials: tuple[Trial, ...]
    choices: tuple[Choice, ...]
    places: tuple[list[float] | None, ...]
    grid: CellGrid
    first: FirstPicture

    @property
    def of_a_real_cell(self) -> bool:
        """Whether it was recorded there, not in a simulation."""
        return self.places[-1] is None

    def all_to_learn_from(self) -> RecordedRun:
        """The same, of which every push is learned from, also those that were made to judge."""
        return replace(self, trials=tuple(replace(trial, role="fit") for trial in self.trials))


LONGEST_STEP = 0.005
"""s, of the hypotheses that run beside the real object; with twice that, taps end 1 mm elsewhere."""

SENSORS = Noise(position=0.4e-3, angle=float(np.radians(0.2)), tip=0.1e-3, force=0.3)
"""Of the camera's poses, the arm's joint sensors and the force taken from its torques."""


Wire = tuple[System, str, System, str]
"""A system, its output port, another system, its input port."""

Block = TypeVar("Block", bound=System)


@dataclass(frozen=True)
class LoopOptions:
    """What the loop is to do.

    Attributes:
        pushes: to learn from.
        checks: pushes after these that only judge the belief.
        strategy: one of `slipmap.planners.settings.STRATEGIES`.
        cells: wanted number of cells.
        hypotheses: K.
        seed: of every draw.
        effects: of the library, which the model is given.
    """

    pushes: int = 5
    checks: int = 0
    strategy: str = "most-distinctive"
    cells: int = 60
    hypotheses: int = 20
    seed: int = 0
    effects: Sequence[str] = ()


def exploration_loop(
    scenario: Scenario,
    options: LoopOptions,
    *,
    cell: HardwareInterface | None = None,
    worker: Executor | None = None,
    meshcat: Meshcat | None = None,
    learned: Callable[[Belief, int], None] | None = None,
    before: RecordedRun | None = None,
) -> Diagram:
    """The station with everything that explores the object on its table.

    Its systems are named `station`, `perception`, `supervisor`, `exploration`, `executor`, `object_watch`,
    `logger`, `identification`, `multiverse`, `model_monitor`, with Meshcat `belief_visualizer`, and with a
    real cell `guard`.

    Args:
        scenario: what the cell is like.
        options: what to do.
        cell: the real cell, which takes the station's place; a guard stands between it and the executor.
        worker: who looks at pictures, learns and plans; the diagram itself if None, which then waits.
        meshcat: where to show it, if anywhere.
        learned: called with every belief as it forms and the number of pushes that it comes from.
        before: what an earlier process recorded, to go on from; the object lies where that one left it.

    Raises:
        ScenarioError: an object, a surface or a hidden effect that cannot be had.
        ValueError: an unknown strategy.
        RendererUnavailable: this machine cannot render pictures.
    """
    builder = DiagramBuilder()
    blocks = add_exploration(
        builder, scenario, options,
        cell=cell, worker=worker, meshcat=meshcat, learned=learned, before=before,
    )  # fmt: skip
    connect(builder, blocks.wires(blocks.supervisor))
    loop = builder.Build()
    loop.set_name("exploration_loop")
    return loop


@dataclass(frozen=True, eq=False)
class ExplorationBlocks:
    """The systems of the loop, in a diagram that is being built."""

    station: Station | HardwareInterface
    guard: CommandGuard | None
    perception: CellPerception
    supervisor: PushSupervisor
    exploration: Exploration
    executor: PushExecutor
    watch: ObjectWatch
    logger: MeasurementLogger
    identification: Identification
    finger: FingerMotion
    multiverse: MultiverseSlider
    monitor: ModelMonitor
    visualizer: BeliefVisualizer | None

    def wires(self, command: LeafSystem) -> list[Wire]:
        """All connections, with the ports `status` and `active_push` of the system that commands the arm."""
        wires: list[Wire] = [
            (self.station, "camera.depth_image", self.perception, "depth_image"),
            (self.station, "camera.X_WC", self.perception, "X_WC"),
            (self.station, "camera.age", self.perception, "image_age"),
            (self.station, "iiwa.position_measured", self.perception, "arm_position"),
            (self.station, "iiwa.position_measured", self.executor, "iiwa.position_measured"),
            (self.station, "iiwa.torque_external", self.executor, "iiwa.torque_external"),
            (self.station, "gripper.state_measured", self.executor, "gripper.state_measured"),
            (self.perception, "object_pose", self.executor, "object_pose"),
            (self.perception, "seen_object", self.executor, "seen_object"),
            (self.perception, "object_pose", self.watch, "object_pose"),
            (self.executor, "status", self.watch, "execution"),
            (self.watch, "moved", self.executor, "moved"),
            (self.executor, "gripper.position", self.station, "gripper.position"),
            (self.executor, "gripper.force_limit", self.station, "gripper.force_limit"),
            (self.perception, "object_pose", self.supervisor, "object_pose"),
            (self.perception, "cell_grid", self.supervisor, "cell_grid"),
            (self.exploration, "plan", self.supervisor, "plan"),
            (self.executor, "status", self.supervisor, "execution"),
            (self.logger, "trials", self.supervisor, "trials"),
            (self.identification, "learned", self.supervisor, "learned"),
            (command, "active_push", self.executor, "push"),
            (self.identification, "belief", self.exploration, "belief"),
            (self.perception, "object_pose", self.exploration, "object_pose"),
            (self.perception, "seen_object", self.exploration, "seen_object"),
            (self.supervisor, "status", self.exploration, "status"),
            (self.perception, "object_pose", self.logger, "object_pose"),
            (self.executor, "tip_pose", self.logger, "tip_pose"),
            (self.executor, "tip_force", self.logger, "tip_force"),
            (self.station, "iiwa.age", self.logger, "tip_age"),
            (self.executor, "status", self.logger, "execution"),
            (command, "status", self.logger, "status"),
            (self.logger, "trials", self.identification, "trials"),
            (self.perception, "cell_grid", self.identification, "cell_grid"),
            (self.executor, "tip_pose", self.finger, "tip_pose"),
            (self.executor, "status", self.finger, "execution"),
            (self.finger, "finger", self.multiverse, "finger"),
            (self.identification, "belief", self.multiverse, "belief"),
            (self.perception, "object_pose", self.multiverse, "object_pose"),
            (command, "active_push", self.multiverse, "push"),
            (self.multiverse, "universes", self.monitor, "universes"),
            (self.perception, "object_pose", self.monitor, "object_pose"),
            (self.logger, "trials", self.monitor, "trials"),
        ]
        if self.guard is None:
            wires.append((self.executor, "iiwa.position", self.station, "iiwa.position"))
        else:
            wires += [
                (self.executor, "iiwa.position", self.guard, "iiwa.position"),
                (self.station, "iiwa.position_measured", self.guard, "iiwa.position_measured"),
                (self.station, "iiwa.torque_external", self.guard, "iiwa.torque_external"),
                (self.station, "iiwa.age", self.guard, "status_age"),
                (self.station, "iiwa.silence", self.guard, "status_silence"),
                (self.station, "abort", self.guard, "abort"),
                (self.station, "camera.age", self.guard, "image_age"),
                (self.guard, "iiwa.position", self.station, "iiwa.position"),
                (self.guard, "health", self.executor, "health"),
                (self.guard, "health", self.station, "health"),
            ]
        if self.visualizer is not None:
            wires += [
                (self.identification, "belief", self.visualizer, "belief"),
                (self.perception, "object_pose", self.visualizer, "object_pose"),
                (self.perception, "seen_object", self.visualizer, "seen_object"),
                (self.multiverse, "mean_pose", self.visualizer, "predicted_pose"),
                (command, "active_push", self.visualizer, "push"),
            ]
        return wires


def add_exploration(
    builder: DiagramBuilder,
    scenario: Scenario,
    options: LoopOptions,
    *,
    cell: HardwareInterface | None = None,
    worker: Executor | None = None,
    meshcat: Meshcat | None = None,
    learned: Callable[[Belief, int], None] | None = None,
    before: RecordedRun | None = None,
) -> ExplorationBlocks:
    """Add everything that explores, not yet connected; arguments and errors as of `exploration_loop`."""
    try:
        # Two runs of one scenario see other noise; the run of seed 0 sees the scenario's own.
        noise = replace(scenario.depth_noise, seed=scenario.depth_noise.seed + options.seed)
        simulated = replace(scenario, depth_noise=noise)
        station = builder.AddSystem(Station(simulated, meshcat) if cell is None else cell)
    except ValueError as error:
        raise ScenarioError(str(error)) from error
    model = arm_model(models=scenario.arm.models)
    execution = scenario.execution if cell is None else scenario.guard.held_to(scenario.execution)
    checks = ArmChecks(scenario.arm.models, scenario.table.make(), execution)

    trials = () if before is None else before.trials
    patience = PATIENCE if worker is None else PATIENCE_REAL
    known = None if before is None else (before.first, trials[-1].object_pose.values[-1])
    step = hypothesis_step(scenario.simulation.time_step)

    def add(name: str, system: Block) -> Block:
        return builder.AddNamedSystem(name, system)

    return ExplorationBlocks(
        station=station,
        guard=None if cell is None else add("guard", CommandGuard(model, scenario.guard)),
        perception=add(
            "perception",
            CellPerception(scenario.camera, options.cells, station.arm_hulls, worker, known),
        ),
        supervisor=add("supervisor", PushSupervisor(options.pushes, options.checks, len(trials), patience)),
        exploration=add(
            "exploration",
            Exploration(
                options.strategy, options.pushes, FINGER_RADIUS, scenario.pokes,
                checks.can_push, options.seed, worker, () if before is None else before.choices,
            ),
        ),
        executor=add("executor", PushExecutor(model, HOME, execution, checks.table)),
        watch=add("object_watch", ObjectWatch()),
        logger=add("logger", MeasurementLogger(options.pushes, trials)),
        identification=add(
            "identification",
            Identification(
                lambda trials, grid: recorded_dataset(trials, grid, scenario),
                hypotheses=options.hypotheses, seed=options.seed, effects=options.effects,
                learned=learned, worker=worker,
            ),
        ),
        finger=add("finger", FingerMotion(step)),
        multiverse=add("multiverse", MultiverseSlider(step)),
        monitor=add("model_monitor", ModelMonitor(SENSORS)),
        visualizer=None if meshcat is None else builder.AddSystem(BeliefVisualizer(meshcat)),
    )  # fmt: skip


def connect(builder: DiagramBuilder, wires: Sequence[Wire]) -> None:
    """Connect ports by their names."""
    for source, output, target, target_input in wires:
        builder.Connect(source.GetOutputPort(output), target.GetInputPort(target_input))


def hypothesis_step(time_step: float) -> float:
    """s: whole steps of the plant, as events between two of them would cut a step in two."""
    return min(time_step * max(1, int(LONGEST_STEP / time_step + 1e-9)), LONGEST_STEP)


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
