"""Runs the pre-grasp loop to its end and takes out what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, Diagram

from diagrams.exploration_run import (
    DOING,
    LONGEST,
    LONGEST_REAL,
    ExplorationFailed,
    ExplorationRun,
    ExplorationStopped,
    Progress,
    explored,
    output_of,
    run_loop,
)
from diagrams.hardware.control import real_cell
from diagrams.hardware.interface import HardwareInterface
from diagrams.pregrasp_loop import PregraspOptions, pregrasp_loop
from diagrams.push_record import PushRecord, Recording
from diagrams.station.scenario import Scenario
from diagrams.station.station import Station
from diagrams.systems.messages import LoopStatus, PregraspPlan
from models.physics.cell_grid import FloatArray

BRINGS = {
    "planning": "planning",
    "pushing": "pushing",
    "recording": "recording",
    "grasping": "grasping at the edge",
    "lifting": "lifting",
    "holding": "holding",
}

IN_THE_AIR = 0.05
"""Height of the object's lowest point over the table from which it is truly lifted, m."""

FALLEN = -0.05
"""The same below which it truly fell, m."""


@dataclass(frozen=True, eq=False)
class PregraspRun:
    """What the whole procedure brought.

    Attributes:
        exploration: what was recorded and learned; pushes towards the edge are in it too, to judge with.
        options: what was to be done.
        held: whether the gripper holds the object, as the robot knows.
        reason: why it does not, else empty.
        plans: of pushes that were made towards the edge, and of the grasp where it came to that, in order.
        true_height: of the object's frame over the table at the end, m; None in a real cell.
        interrupted: whether Ctrl-C ended it.
    """

    exploration: ExplorationRun
    options: PregraspOptions
    held: bool
    reason: str
    plans: tuple[PregraspPlan, ...]
    true_height: float | None
    interrupted: bool = False

    @property
    def pushes(self) -> tuple[PregraspPlan, ...]:
        """Plans of the pushes towards the edge."""
        return tuple(plan for plan in self.plans if plan.push is not None)

    @property
    def fate(self) -> str:
        """What truly became of the object: held, fell, dropped (the robot was wrong about it), or gave up.

        In a real cell it is what the robot knows, held or gave up.
        """
        if self.true_height is None:
            return "held" if self.held else "gave up"
        if self.true_height < FALLEN:
            return "fell"
        if self.held:
            return "held" if self.true_height > IN_THE_AIR else "dropped"
        return "gave up"

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        first = self.options.exploration.pushes + self.options.exploration.checks
        trials = self.exploration.dataset.trials[first:]
        rows = []
        for plan, trial in zip(self.pushes, trials, strict=False):
            assert plan.push is not None and plan.goal is not None
            before, after = trial.object_pose.values[0], trial.object_pose.values[-1]
            rows.append(
                {
                    "begin": _plain(plan.push.push.begin),
                    "end": _plain(plan.push.push.end),
                    "before": _plain(before),
                    "after": _plain(after),
                    "goal": _plain(plan.goal.pose),
                    "fall_probability": plan.push.fall_probability,
                    "success_probability": plan.success_probability,
                    "margin": plan.margin,
                }
            )
        grasps = [plan.grasp for plan in self.plans if plan.grasp is not None]
        return {
            "method": self.options.method,
            "seed": self.options.exploration.seed,
            "held": self.held,
            "fate": self.fate,
            "reason": self.reason,
            "explorations": self.options.exploration.pushes,
            "pushes": rows,
            "grasp": None if not grasps else _plain(grasps[-1].grasp.at(grasps[-1].pose)),
            "true_height": self.true_height,
            "simulated": self.exploration.simulated,
            "seconds": self.exploration.seconds,
        }


def run_pregrasp(
    scenario: Scenario,
    options: PregraspOptions,
    *,
    hardware: str | HardwareInterface | None = None,
    meshcat: Meshcat | None = None,
    progress: Progress | None = None,
    record: PushRecord | None = None,
) -> PregraspRun:
    """Explore the object of a scenario, bring it to the table's edge, grasp and lift it.

    Args:
        scenario: what the cell is like.
        options: what to do.
        hardware: LCM address of a real cell, or see `control.real_cell`; simulated if None.
        meshcat: where to show it, if anywhere.
        progress: called with (stage, done, total) pushes; the total is 0 where it is not known.
        record: where pushes go as soon as they are recorded; what it raises ends the run.

    Raises:
        ExplorationFailed: before there was anything to learn from; `ExplorationStopped` where by Ctrl-C.
        ValueError, ScenarioError, RendererUnavailable: see `exploration_loop`.
        HardwareError: the real cell cannot be reached.
    """
    with real_cell(scenario, hardware, options.exploration.effects) as (cell, worker):
        loop = pregrasp_loop(scenario, options, cell=cell, worker=worker, meshcat=meshcat)
        patience = LONGEST if cell is None else LONGEST_REAL
        return _run(loop, scenario, options, patience, progress, record)


def _run(
    loop: Diagram,
    scenario: Scenario,
    options: PregraspOptions,
    patience: float,
    progress: Progress | None,
    record: PushRecord | None,
) -> PregraspRun:
    """Run a loop to its end; it may take some time (s) for each push."""
    report = progress or (lambda stage, done, total: None)
    first = options.exploration.pushes + options.exploration.checks
    plans: dict[int, PregraspPlan] = {}
    recording = None if record is None else Recording(loop, record)

    def watch(status: LoopStatus, context: Context) -> None:
        if recording is not None:
            recording.look(context)
        if status.push < first and status.mode in DOING:
            report(f"exploring: {DOING[status.mode]}", status.push, first)
        if status.push < first or status.mode not in BRINGS:
            return
        doing = BRINGS[status.mode]
        if status.mode in ("pushing", "recording"):
            doing = f"push {status.push - first + 1}, {doing}"
        report(f"to the edge: {doing}", status.push - first, 0)  # nobody knows how many it takes
        if status.mode in ("pushing", "grasping"):
            plans[status.push] = output_of(loop, "planner", "plan", context)

    longest = patience * (first + options.pushes + 2)
    ended = run_loop(loop, "pregrasp_supervisor", ("held", "failed"), longest, watch)
    exploration = explored(loop, ended, scenario, options.exploration, report)
    if exploration is None:
        if ended.interrupted:
            raise ExplorationStopped("stopped before anything was recorded")
        raise ExplorationFailed(f"nothing was recorded: {ended.reason}")
    held = ended.status.mode == "held"
    reason = "" if held else ("stopped" if ended.interrupted else ended.reason)
    height = None
    if isinstance(loop.GetSubsystemByName("station"), Station):
        height = float(output_of(loop, "station", "truth.object_pose", ended.context).translation()[2])
    made = [plans[number] for number in sorted(plans)]
    return PregraspRun(exploration, options, held, reason, tuple(made), height, ended.interrupted)


def _plain(values: FloatArray) -> list[float]:
    return [float(value) for value in np.asarray(values)]
