"""The exploration loop as one Diagram: see, choose, push, record, learn, and show the belief."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem, System

from slipmap.diagrams.execution.clearance import Obstacle
from slipmap.diagrams.execution.plans import ArmChecks
from slipmap.diagrams.execution.push_executor import ObjectWatch, PushExecutor
from slipmap.diagrams.hardware.guard import CommandGuard
from slipmap.diagrams.hardware.interface import HardwareInterface
from slipmap.diagrams.perception.cell_perception import FRAMES, CellPerception
from slipmap.diagrams.station.arm import HOME, arm_model
from slipmap.diagrams.station.placement import check_rest
from slipmap.diagrams.station.scenario import Scenario, ScenarioError, check_scenario
from slipmap.diagrams.station.station import Station
from slipmap.diagrams.systems.belief_visualizer import BeliefVisualizer
from slipmap.diagrams.systems.diagnosis import Diagnosis, Repair
from slipmap.diagrams.systems.exploration import Exploration
from slipmap.diagrams.systems.finger import FingerMotion
from slipmap.diagrams.systems.identification import Identification
from slipmap.diagrams.systems.measurement_logger import MeasurementLogger
from slipmap.diagrams.systems.model_monitor import ModelMonitor, Watch
from slipmap.diagrams.systems.multiverse_slider import MultiverseSlider
from slipmap.diagrams.systems.supervisors import PATIENCE, PATIENCE_REAL, PushSupervisor
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements import PushDataset, Trial
from slipmap.models.measurements.push_dataset import Noise, dataset_of
from slipmap.models.objects.footprints import rings_of, without_scan_noise
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.perception.first_look import FirstPicture
from slipmap.models.perception.seen_object import UNSEEN_ANGLE, angle_held
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.settings import check_choice, check_whole
from slipmap.planners.action_selection import Choice, choose_push
from slipmap.planners.exploration import NoReachablePush
from slipmap.planners.settings import STRATEGIES

LONGEST_STEP = 0.005
"""Longest time step of the hypotheses that run beside the real object, s; twice that moves the ends of taps
by 1 mm."""

SENSORS = Noise(position=0.4e-3, angle=float(np.radians(0.2)), tip=0.1e-3, force=0.3, outline=0.4e-3)
"""Noise of the camera's poses and outline, of the arm's joint sensors, and of the force from its torques."""


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """The recording of a run so far, from which another process can continue."""

    trials: tuple[Trial, ...]  # complete trials, one or more
    choices: tuple[Choice, ...]  # the choice behind each
    # pose of the simulated object after each, x and y in m, rotation in degrees; None for a real one
    places: tuple[list[float] | None, ...]
    grid: CellGrid  # the object as the camera detected it
    first: FirstPicture  # the picture in which it did so
    rests: tuple[FloatArray, ...]  # offsets of the outline seen at the places where it rested, see `Rests`
    watch: Watch | None = None  # state of the monitor
    repair: Repair | None = None  # how the model was repaired, if the run adapts

    @property
    def of_a_real_cell(self) -> bool:
        """Whether it was recorded in a real cell, not in a simulation."""
        return self.places[-1] is None

    def all_to_learn_from(self) -> RecordedRun:
        """Only its pushes, all of them to learn from, including those made to judge."""
        trials = tuple(replace(trial, role="fit") for trial in self.trials)
        return replace(self, trials=trials, watch=None, repair=None)


Wire = tuple[Any, ...]
"""A system, its output port, and the targets: systems with an input of the same name, or (system, input)."""

Block = TypeVar("Block", bound=System)


@dataclass(frozen=True)
class LoopOptions:
    """Options of the exploration loop.

    Attributes:
        pushes: number of pushes to learn from.
        checks: number of pushes after these that only judge the belief.
        strategy: one of `slipmap.planners.settings.STRATEGIES`.
        cells: wanted number of cells.
        hypotheses: K.
        seed: of every draw.
        effects: of the library, given to the model.
        adapt: whether the model is repaired during the run: when pushes surprise it, they are diagnosed, and
            the effects that are named are added to it. Then every push is learned from, and there are no
            `checks`.

    Raises:
        ValueError: an option out of range, an unknown strategy or effect.

    Example:
        >>> import slipmap
        >>> slipmap.LoopOptions(pushes=3, checks=1).strategy
        'most-distinctive'
    """

    pushes: int = 5
    checks: int = 0
    strategy: str = "most-distinctive"
    cells: int = 60
    hypotheses: int = 20
    seed: int = 0
    effects: Sequence[str] = ()
    adapt: bool = False

    def __post_init__(self) -> None:
        for name, least in (("pushes", 1), ("checks", 0), ("cells", 1), ("hypotheses", 2), ("seed", 0)):
            check_whole(f"LoopOptions: {name}", getattr(self, name), least)
        check_choice("LoopOptions: strategy", self.strategy, STRATEGIES)
        effects_named(self.effects)
        if self.adapt and self.checks:
            raise ValueError("with adapt every push is learned from: checks must be 0")

    @property
    def teaching(self) -> int:
        """Largest number of pushes to learn from."""
        return sys.maxsize if self.adapt else self.pushes


def exploration_loop(scenario: Scenario, options: LoopOptions, **parts: Any) -> Diagram:
    """Build the station with everything that explores the object on its table.

    Its systems are named `station`, `perception`, `supervisor`, `exploration`, `executor`, `object_watch`,
    `logger`, `identification`, `finger`, `multiverse`, `model_monitor`; with Meshcat also
    `belief_visualizer`, with `adapt` also `diagnosis`, and with a real cell also `guard`.

    Args:
        parts: keyword arguments of `add_exploration`.

    Raises:
        ScenarioError, ValueError, RendererUnavailable: see `add_exploration`.
    """
    builder = DiagramBuilder()
    blocks = add_exploration(builder, scenario, options, **parts)
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
    diagnosis: Diagnosis | None

    def wires(self, command: LeafSystem) -> list[Wire]:
        """All connections; `command` is the system whose `status` and `active_push` command the arm."""
        see, arm = self.perception, self.executor
        wires: list[Wire] = [
            (self.station, "camera.depth_image", (see, "depth_image")),
            (self.station, "camera.X_WC", (see, "X_WC")),
            (self.station, "camera.age", (see, "image_age")),
            (self.station, "iiwa.position_measured", (see, "arm_position"), arm),
            (self.station, "iiwa.torque_external", arm),
            (self.station, "iiwa.age", (self.logger, "tip_age")),
            (self.station, "gripper.state_measured", arm),
            (
                see, "object_pose", arm, self.watch, self.supervisor, self.exploration, self.logger,
                self.multiverse, self.monitor,
            ),
            (see, "seen_object", arm, self.exploration),
            (see, "cell_grid", self.supervisor, self.identification),
            (self.watch, "moved", arm),
            (
                arm, "status", (self.watch, "execution"), (self.supervisor, "execution"),
                (self.logger, "execution"), (self.finger, "execution"),
            ),
            (arm, "gripper.position", self.station),
            (arm, "gripper.force_limit", self.station),
            (arm, "tip_pose", self.logger, self.finger),
            (arm, "tip_force", self.logger),
            (self.exploration, "plan", self.supervisor),
            (self.supervisor, "status", self.exploration),
            (command, "status", self.logger),
            (command, "active_push", (arm, "push"), (self.multiverse, "push"), (self.finger, "push")),
            (self.logger, "trials", self.supervisor, self.identification, self.multiverse, self.monitor),
            (self.logger, "missed", self.supervisor),
            (self.identification, "learned", self.supervisor),
            (self.identification, "belief", self.exploration, self.multiverse),
            (self.finger, "finger", self.multiverse),
            (self.multiverse, "universes", self.monitor),
        ]  # fmt: skip
        if self.diagnosis is not None:
            wires += [
                (self.logger, "trials", self.diagnosis),
                (see, "cell_grid", self.diagnosis),
                (self.monitor, "watch", self.diagnosis),
                (self.diagnosis, "effects", self.identification),
                (self.diagnosis, "rival", self.identification),
                (self.diagnosis, "repair", self.supervisor, self.exploration),
            ]
            if self.visualizer is not None:
                wires.append((self.diagnosis, "repair", self.visualizer))
        if self.guard is None:
            wires.append((arm, "iiwa.position", self.station))
        else:
            wires += [
                (arm, "iiwa.position", self.guard),
                (self.station, "iiwa.position_measured", self.guard),
                (self.station, "iiwa.torque_external", self.guard),
                (self.station, "iiwa.age", (self.guard, "status_age")),
                (self.station, "iiwa.silence", (self.guard, "status_silence")),
                (self.station, "abort", self.guard),
                (self.station, "camera.age", (self.guard, "image_age")),
                (self.guard, "iiwa.position", self.station),
                (self.guard, "health", arm, self.station),
            ]
        if self.visualizer is not None:
            wires += [
                (self.identification, "belief", self.visualizer),
                (see, "object_pose", self.visualizer),
                (see, "seen_object", self.visualizer),
                (self.multiverse, "mean_pose", (self.visualizer, "predicted_pose")),
                (self.monitor, "watch", self.visualizer),
                (command, "active_push", (self.visualizer, "push")),
                (command, "status", self.visualizer),
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
    """Add everything that explores, not yet connected.

    Args:
        cell: the real cell, in place of the station; a guard stands between it and the executor.
        worker: processes pictures, learns and plans; if None, the diagram does so itself and waits.
        learned: called with each new belief and the number of pushes that it was learned from.
        before: recording of an earlier process to continue; the object must lie where that one left it.

    Raises:
        ScenarioError: an object, a surface or a hidden effect that cannot be made, or that moves the object
            by itself.
        RendererUnavailable: this machine cannot render pictures.
    """
    check_scenario(scenario)
    try:
        # Runs of one scenario with different seeds see different noise; seed 0 keeps the scenario's own.
        noise = replace(scenario.depth_noise, seed=scenario.depth_noise.seed + options.seed)
        simulated = replace(scenario, depth_noise=noise)
        station = builder.AddSystem(Station(simulated, meshcat) if cell is None else cell)
        if isinstance(station, Station) and before is None:
            check_rest(scenario, station.true_object)
    except ValueError as error:
        raise ScenarioError(str(error)) from error
    model = arm_model(models=scenario.arm.models)
    execution = scenario.execution if cell is None else scenario.guard.held_to(scenario.execution)
    checks = ArmChecks(scenario.arm.models, scenario.table.make(), execution)

    trials = () if before is None else before.trials
    patience = patience_for(scenario, worker)
    known = None if before is None else (before.first, trials[-1].object_pose.values[-1], before.rests)
    step = hypothesis_step(scenario.simulation.time_step)
    make_dataset = partial(recorded_dataset, scenario=scenario)
    repair = Repair(len(trials), tuple(options.effects))
    if before is not None and before.repair is not None:
        repair = before.repair

    def add(name: str, system: Block) -> Block:
        return builder.AddNamedSystem(name, system)

    return ExplorationBlocks(
        station=station,
        guard=None if cell is None else add("guard", CommandGuard(model, scenario.guard)),
        perception=add(
            "perception",
            # As many places as there are pushes to learn from, so that the last belief's outline stays.
            CellPerception(
                scenario.camera, options.cells, station.arm_hulls, worker, known, options.teaching + 1
            ),
        ),
        supervisor=add("supervisor", PushSupervisor(options.pushes, options.checks, len(trials), patience)),
        exploration=add(
            "exploration",
            Exploration(
                options.strategy, options.pushes, execution.finger_radius, scenario.pokes,
                checks.can_push, options.seed, worker, () if before is None else before.choices,
                scenario.table.make(),
            ),
        ),
        executor=add("executor", PushExecutor(model, HOME, execution, checks.table)),
        watch=add("object_watch", ObjectWatch()),
        logger=add("logger", MeasurementLogger(options.teaching, trials)),
        identification=add(
            "identification",
            Identification(
                make_dataset, hypotheses=options.hypotheses, seed=options.seed, effects=options.effects,
                friction_laws=False,  # a robot that waits for each belief has no time for more
                learned=learned, worker=worker,
            ),
        ),
        finger=add("finger", FingerMotion(step)),
        multiverse=add("multiverse", MultiverseSlider(step)),
        monitor=add(
            "model_monitor", ModelMonitor(SENSORS, before=None if before is None else before.watch)
        ),
        visualizer=None if meshcat is None else add("belief_visualizer", BeliefVisualizer(meshcat)),
        diagnosis=None if not options.adapt else add(
            "diagnosis",
            Diagnosis(
                make_dataset, scenario.repair, pushes=options.pushes, effects=options.effects,
                seed=options.seed, before=repair, worker=worker,
            ),
        ),
    )  # fmt: skip


def connect(builder: DiagramBuilder, wires: Sequence[Wire]) -> None:
    """Connect ports by their names, see `Wire`."""
    for source, output, *targets in wires:
        for target in targets:
            system, name = target if isinstance(target, tuple) else (target, output)
            builder.Connect(source.GetOutputPort(output), system.GetInputPort(name))


def output_of(loop: Diagram, system: str, port: str, root: Context) -> Any:
    """Value of an output port of one of a loop's systems; `root` is the Context of the loop."""
    block = loop.GetSubsystemByName(system)
    return block.GetOutputPort(port).Eval(block.GetMyContextFromRoot(root))


def latest_watch(loop: Diagram, root: Context) -> Watch:
    """The monitor's judgement of all recorded pushes, see `ModelMonitor.latest`."""
    monitor: ModelMonitor = loop.GetSubsystemByName("model_monitor")
    return monitor.latest(monitor.GetMyContextFromRoot(root))


def patience_for(scenario: Scenario, worker: Executor | None) -> float:
    """Time that the object may stay out of sight, s: at least twice the time of a first look's pictures."""
    return max(PATIENCE if worker is None else PATIENCE_REAL, 2.0 * FRAMES / scenario.camera.rate)


def hypothesis_step(time_step: float) -> float:
    """Time step of the hypotheses, s: a multiple of the plant's, so that no event splits a step."""
    return min(time_step * max(1, int(LONGEST_STEP / time_step + 1e-9)), LONGEST_STEP)


def check_reach(scenario: Scenario, thing: TrueObject) -> None:
    """Refuse an object that the arm cannot push where it lies.

    Raises:
        ScenarioError: with the number of pushes tried.
    """
    x, y, degrees = scenario.object.pose
    pose = np.array([x, y, np.radians(degrees)])
    execution = scenario.execution
    checks = ArmChecks(scenario.arm.models, scenario.table.make(), execution)
    exterior, holes = rings_of(without_scan_noise(thing.grid.polygon))  # the camera does not see it either
    grid = replace(thing.grid, exterior=exterior, holes=holes)
    try:
        choose_push(
            grid, pose, execution.finger_radius, strategy="random", settings=scenario.pokes, tap=False,
            table=scenario.table.make(),
            allowed=partial(checks.can_push, Obstacle(thing.grid, thing.height, pose)),
            rng=np.random.default_rng(0),
        )  # fmt: skip
    except NoReachablePush as error:
        raise ScenarioError(
            f"object.pose: the arm cannot push {thing.name} at x = {x:g} m, y = {y:g} m; move it towards the"
            f" centre of the table ({error})"
        ) from error


def recorded_dataset(trials: Sequence[Trial], grid: CellGrid, scenario: Scenario) -> PushDataset:
    """The loop's recording as a push dataset."""
    noise = replace(SENSORS, angle=UNSEEN_ANGLE) if all(map(angle_held, trials)) else SENSORS
    return dataset_of(
        trials,
        grid,
        name=scenario.object.called,
        finger_radius=scenario.execution.finger_radius,
        finger_height=scenario.execution.tip_height,
        gravity=scenario.gravity,
        noise=noise,
        table=scenario.table.make(),
        description="Recorded by the station's arm and depth camera.",
    )
