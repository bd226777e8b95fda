"""The pre-grasp procedure as one Diagram, and its run: explore, push to the edge, grasp and lift."""

from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from slipmap.diagrams.execution.plans import ArmChecks
from slipmap.diagrams.hardware.control import real_cell
from slipmap.diagrams.hardware.interface import HardwareInterface
from slipmap.diagrams.loops import exploration_run
from slipmap.diagrams.loops.exploration_loop import (
    LoopOptions,
    Wire,
    add_exploration,
    connect,
    output_of,
    patience_for,
)
from slipmap.diagrams.loops.run_folder import Recording, RunFolder
from slipmap.diagrams.perception.sight import Sight
from slipmap.diagrams.station.arm import HOME
from slipmap.diagrams.station.scenario import Scenario, ScenarioError
from slipmap.diagrams.station.sliding_object import GRAVITY
from slipmap.diagrams.station.station import Station
from slipmap.diagrams.systems.goal_and_push_planner import GoalAndPushPlanner
from slipmap.diagrams.systems.loop_messages import LoopStatus, PregraspPlan
from slipmap.diagrams.systems.supervisors import PregraspSupervisor
from slipmap.models.files import plain
from slipmap.models.geometry import placed, relative
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.perception.pinhole_camera import View
from slipmap.models.perception.seen_object import SeenObject
from slipmap.models.physics.maps import Maps
from slipmap.models.progress import silent
from slipmap.models.robots import FINGER_RADIUS
from slipmap.models.settings import check_choice, check_kind, check_whole
from slipmap.planners.settings import METHODS, PregraspSettings

BRINGS = {
    "planning": "planning",
    "pushing": "pushing",
    "recording": "recording",
    "diagnosing": "diagnosing the pushes",
    "grasping": "grasping at the edge",
    "lifting": "lifting",
    "holding": "holding",
}

_ENOUGH_SEEN = 0.85  # share of the cells that the camera must see past the arm at a goal
_IN_THE_AIR = 0.05  # m, height of the object's frame above the table from which it has truly been lifted
_FALLEN = -0.05  # m, the same height below which it has truly fallen


@dataclass(frozen=True)
class PregraspOptions:
    """Options of the pre-grasp loop.

    Attributes:
        exploration: how the object is explored; its seed is used for every draw.
        method: of planning, one of `slipmap.planners.settings.METHODS`.
        pushes: most pushes towards the edge.

    Raises:
        ValueError: an unknown method, or no push.

    Example:
        >>> import slipmap
        >>> slipmap.PregraspOptions(slipmap.LoopOptions(pushes=3), method="probabilistic").method
        'probabilistic'
    """

    exploration: LoopOptions = field(default_factory=LoopOptions)
    method: str = "probabilistic"
    pushes: int = 20

    def __post_init__(self) -> None:
        check_choice("PregraspOptions: method", self.method, METHODS)
        check_whole("PregraspOptions: pushes", self.pushes, 1)


def pregrasp_loop(
    scenario: Scenario,
    options: PregraspOptions,
    *,
    cell: HardwareInterface | None = None,
    worker: Executor | None = None,
    meshcat: Meshcat | None = None,
) -> Diagram:
    """Build the exploration loop with everything that brings the object to the edge and lifts it.

    It adds `planner` and `pregrasp_supervisor`, which commands the arm, to the systems of `exploration_loop`.

    Args:
        cell, worker: see `exploration_loop`; a real cell has no truth to plan with.

    Raises:
        ScenarioError: also for a finger or a stronger gravity than grasps are planned for.
        ValueError, RendererUnavailable: see `exploration_loop`.
    """
    if scenario.execution.finger_radius != FINGER_RADIUS or scenario.gravity > GRAVITY:
        raise ScenarioError(
            f"pregrasp: grasps are planned for pins with a radius of {FINGER_RADIUS:g} m and a gravity of at"
            f" most {GRAVITY:g} m/s²; leave out execution.finger_radius and gravity, or only explore"
        )
    builder = DiagramBuilder()
    blocks = add_exploration(
        builder, scenario, options.exploration, cell=cell, worker=worker, meshcat=meshcat
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
            can_see=lambda seen, pose: sight.share(seen, pose) > _ENOUGH_SEEN,
            seed=options.exploration.seed,
            truth=truth,
            worker=worker,
        ),
    )
    patience = patience_for(scenario, worker)
    commander = builder.AddNamedSystem("pregrasp_supervisor", PregraspSupervisor(patience))
    repaired: list[Wire] = []
    if blocks.diagnosis is not None:
        repaired = [
            (blocks.diagnosis, "repair", commander),
            (blocks.identification, "learned", commander),
        ]
    connect(
        builder,
        [
            *blocks.wires(commander),
            (blocks.supervisor, "status", (commander, "exploration")),
            (blocks.supervisor, "active_push", (commander, "exploring_push")),
            (blocks.perception, "object_pose", commander, planner),
            (blocks.perception, "seen_object", planner),
            (blocks.identification, "belief", planner),
            (planner, "plan", commander),
            (blocks.executor, "status", (commander, "execution")),
            (blocks.logger, "trials", commander),
            (blocks.logger, "missed", commander),
            (blocks.station, "gripper.state_measured", commander),
            (commander, "active_grasp", (blocks.executor, "grasp")),
            (commander, "status", planner),
            *repaired,
        ],
    )
    loop = builder.Build()
    loop.set_name("pregrasp_loop")
    return loop


def true_maps(true_object: TrueObject, pose: list[float], seen: SeenObject) -> Maps:
    """The true maps on the cells that the camera detected, each taken from the nearest true cell.

    Args:
        pose: x, y (m) and rotation (degrees) of the object at the first look.
        seen: the object as the camera saw it then.

    Returns:
        One hypothesis with the true total mass.
    """
    X_WO = np.array([pose[0], pose[1], np.radians(pose[2])])
    centers = placed(seen.grid.centers, relative(X_WO, seen.first_pose))
    away = np.linalg.norm(centers[:, None] - true_object.grid.centers, axis=-1)
    cell = away.argmin(axis=1)
    mass = true_object.mass[cell]
    mass = mass * (true_object.total_mass / mass.sum())
    return Maps(mass[None], true_object.mu[cell][None], np.array([true_object.mu_finger]))


@dataclass(frozen=True, eq=False)
class PregraspRun:
    """The result of the whole procedure."""

    # recording and belief; includes the pushes towards the edge, for judging
    exploration: exploration_run.ExplorationRun
    options: PregraspOptions
    held: bool  # whether the gripper holds the object, as far as the robot knows
    reason: str  # why it does not, else empty
    # of the pushes made towards the edge, and of the grasp if there was one, in order
    plans: tuple[PregraspPlan, ...]
    true_height: float | None  # final height of the object's frame above the table, m; None in a real cell
    explorations: int  # number of exploration pushes, before those towards the edge
    interrupted: bool = False  # whether Ctrl-C ended it

    @property
    def pushes(self) -> tuple[PregraspPlan, ...]:
        """Plans of the pushes towards the edge."""
        return tuple(plan for plan in self.plans if plan.push is not None)

    @property
    def fate(self) -> str:
        """The true outcome: held, fell, dropped (though the robot believed it held it), or gave up.

        In a real cell it is what the robot believes, held or gave up.
        """
        if self.true_height is None:
            return "held" if self.held else "gave up"
        if self.true_height < _FALLEN:
            return "fell"
        if self.held:
            return "held" if self.true_height > _IN_THE_AIR else "dropped"
        return "gave up"

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        trials = self.exploration.dataset.trials[self.explorations :]
        true_pose = self.exploration.identification.belief.true_pose
        rows = []
        for plan, trial in zip(self.pushes, trials, strict=False):
            assert plan.push is not None and plan.goal is not None
            before, after = (true_pose(trial.object_pose.values[row]) for row in (0, -1))
            rows.append(
                {
                    "begin": plain(plan.push.push.begin),
                    "end": plain(plan.push.push.end),
                    "before": plain(before),
                    "after": plain(after),
                    "goal": plain(plan.goal.pose),
                    "fall_probability": plan.push.fall_probability,
                    "success_probability": plan.success_probability,
                    "margin": plan.margin,
                }
            )
        grasps = [plan.grasp for plan in self.plans if plan.grasp is not None]
        wanted = self.options.exploration
        return {
            "method": self.options.method,
            "seed": self.options.exploration.seed,
            "held": self.held,
            "fate": self.fate,
            "reason": self.reason,
            "explorations": max(self.explorations - wanted.checks, min(self.explorations, wanted.pushes)),
            "pushes": rows,
            "grasp": None if not grasps else plain(grasps[-1].grasp.at(grasps[-1].pose)),
            "true_height": self.true_height,
            "simulated": self.exploration.simulated,
            "seconds": self.exploration.seconds,
        }


def pregrasp(
    scenario: Scenario,
    options: PregraspOptions,
    *,
    hardware: str | HardwareInterface | None = None,
    meshcat: Meshcat | None = None,
    progress: exploration_run.Progress | None = None,
    record: RunFolder | None = None,
) -> PregraspRun:
    """Explore the object of a scenario, bring it to the table's edge, grasp and lift it.

    Args:
        hardware: LCM address of a real cell, or see `control.real_cell`; simulated if None.
        meshcat: where to show it, if anywhere.
        progress: called with (stage, done, total) pushes; the total is 0 if unknown.
        record: where pushes go as soon as they are recorded; an error that it raises ends the run.

    Raises:
        ExplorationFailed: nothing was recorded to learn from; `ExplorationStopped` if because of Ctrl-C.
        ValueError, ScenarioError, RendererUnavailable: see `exploration_loop`.
        HardwareError: the real cell cannot be reached.

    Example, which takes a minute and is not run by the tests:
        >>> import slipmap
        >>> options = slipmap.PregraspOptions(slipmap.LoopOptions(pushes=3))
        >>> run = slipmap.pregrasp(slipmap.Scenario(), options)  # doctest: +SKIP
        >>> run.held  # doctest: +SKIP
        True
    """
    check_kind("pregrasp: scenario", scenario, Scenario, "such as slipmap.Scenario()")
    check_kind("pregrasp: options", options, PregraspOptions, "such as slipmap.PregraspOptions()")
    with real_cell(scenario, hardware, options.exploration.effects) as (cell, worker):
        loop = pregrasp_loop(scenario, options, cell=cell, worker=worker, meshcat=meshcat)
        patience = exploration_run.longest_push(scenario, real=cell is not None)
        return _run(loop, scenario, options, patience, progress, record)


def _run(
    loop: Diagram,
    scenario: Scenario,
    options: PregraspOptions,
    patience: float,
    progress: exploration_run.Progress | None,
    record: RunFolder | None,
) -> PregraspRun:
    """Run a loop to its end, allowing `patience` (s) for each push."""
    report = progress or silent
    wanted = options.exploration.pushes + options.exploration.checks
    plans: dict[int, PregraspPlan] = {}
    recording = None if record is None else Recording(loop, record)

    def watch(status: LoopStatus, context: Context) -> None:
        if recording is not None:
            recording.look(context)
        exploring: LoopStatus = output_of(loop, "supervisor", "status", context)
        first = exploring.push
        if exploring.mode != "finished":
            if status.mode in exploration_run.DOING:
                doing = exploration_run.DOING[status.mode]
                report(f"exploring: {doing}", status.push, max(wanted, status.push + 1))
            return
        if status.mode not in BRINGS:
            return
        doing = BRINGS[status.mode]
        if status.mode in ("pushing", "recording"):
            doing = f"push {status.push - first + 1}, {doing}"
        report(f"to the edge: {doing}", status.push - first, 0)  # the total is unknown
        if status.mode in ("pushing", "grasping"):
            plans[status.push] = output_of(loop, "planner", "plan", context)

    more = scenario.repair.pushes if options.exploration.adapt else 0
    longest = patience * (wanted + more + options.pushes + 2)
    ended = exploration_run.run_loop(loop, "pregrasp_supervisor", ("held", "failed"), longest, watch)
    exploration = exploration_run.explored(loop, ended, scenario, options.exploration, report)
    if exploration is None:
        if ended.interrupted:
            raise exploration_run.ExplorationStopped("stopped before anything was recorded")
        raise exploration_run.ExplorationFailed(f"nothing was recorded: {ended.reason}")
    held = ended.status.mode == "held"
    reason = "" if held else ("stopped" if ended.interrupted else ended.reason)
    height = None
    if isinstance(loop.GetSubsystemByName("station"), Station):
        height = float(output_of(loop, "station", "truth.object_pose", ended.context).translation()[2])
    made = [plans[number] for number in sorted(plans)]
    first = output_of(loop, "supervisor", "status", ended.context).push
    return PregraspRun(exploration, options, held, reason, tuple(made), height, first, ended.interrupted)
