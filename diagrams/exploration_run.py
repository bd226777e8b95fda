"""Runs the exploration loop to its end and takes out what it learned."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.math import RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, EventStatus

from diagrams.exploration_loop import LoopOptions, exploration_loop, recorded_dataset
from diagrams.station.scenario import Scenario
from diagrams.systems.messages import LoopStatus
from models.inference.identification import identify
from models.inference.results import Identification
from models.measurements import PushDataset
from models.objects.true_object import TrueObject
from models.physics.cell_grid import FloatArray
from planners.proposals import turn

LONGEST = 60.0
"""s of simulated time for each push, after which the loop is given up."""

DOING = {
    "looking": "looking at the object",
    "choosing": "choosing a push",
    "pushing": "pushing",
    "recording": "recording",
    "learning": "learning",
}

Progress = Callable[[str, int, int], None]


class ExplorationFailed(RuntimeError):
    """The loop gave up; the text says why. `run` is what was recorded until then, or None."""

    def __init__(self, text: str, run: ExplorationRun | None = None) -> None:
        super().__init__(text)
        self.run = run


class ExplorationStopped(ExplorationFailed):
    """Ctrl-C ended the loop."""


@dataclass(frozen=True, eq=False)
class ExplorationRun:
    """What an exploration brought.

    Attributes:
        dataset: recorded pushes; those made to judge have the role `heldout`.
        identification: what was learned from the others.
        true_object: what the station put on the table.
        X_SO: (3,) pose of the true object's frame in the frame S of the cells that the camera made out.
        simulated: s of simulated time.
        seconds: s that it took.
    """

    dataset: PushDataset
    identification: Identification
    true_object: TrueObject
    X_SO: FloatArray
    simulated: float
    seconds: float

    @property
    def true_center_of_mass(self) -> FloatArray:
        """(2,) of the object in the frame of the cells, m."""
        return turn(self.X_SO[2]) @ self.true_object.center_of_mass[:2] + self.X_SO[:2]

    def truth(self) -> dict[str, Any]:
        """The true values of what was learned, and how far off the belief is."""
        belief = self.identification.belief
        centers, p = belief.centers_of_mass, belief.probability
        mean = p @ centers
        off = self.true_center_of_mass - mean
        return {
            "total_mass": self.true_object.total_mass,
            "friction_force": float((self.true_object.mass * self.true_object.mu).sum() * belief.gravity),
            "center_of_mass": [float(value) for value in self.true_center_of_mass],
            "center_of_mass_believed": [float(value) for value in mean],
            "center_of_mass_error": float(np.hypot(*off)),
        }


def explore(
    scenario: Scenario,
    options: LoopOptions,
    *,
    meshcat: Meshcat | None = None,
    progress: Progress | None = None,
) -> ExplorationRun:
    """Explore the object of a scenario.

    Args:
        scenario: what the cell is like.
        options: what to do.
        meshcat: where to show it, if anywhere.
        progress: called with (stage, done, total) pushes.

    Raises:
        ExplorationFailed: the object was lost, or the arm cannot make any push.
        ExplorationStopped: Ctrl-C; it has what was recorded until then.
        ValueError, RendererUnavailable: see `exploration_loop`.
    """
    started = time.perf_counter()
    report = progress or (lambda stage, done, total: None)
    loop = exploration_loop(scenario, options, meshcat=meshcat)
    simulator = Simulator(loop)
    context = simulator.get_mutable_context()
    pushes = options.pushes + options.checks
    first_look: list[FloatArray] = []

    def watch(root: Context) -> EventStatus:
        status: LoopStatus = _output(loop, "supervisor", "status", root)
        if status.mode in ("finished", "failed"):
            return EventStatus.ReachedTermination(loop.GetSubsystemByName("supervisor"), status.mode)
        if not first_look and status.mode == "choosing":
            first_look.append(_frames(loop, root))
        report(f"exploring: {DOING[status.mode]}", status.push, pushes)
        return EventStatus.DidNothing()

    simulator.set_monitor(watch)
    interrupted = False
    try:
        simulator.AdvanceTo(LONGEST * pushes)
    except KeyboardInterrupt:
        interrupted = True
    status: LoopStatus = _output(loop, "supervisor", "status", context)
    trials = _output(loop, "logger", "records", context)
    run = None
    if trials:
        grid = _output(loop, "perception", "cell_grid", context)
        dataset = recorded_dataset(trials, grid, scenario)
        if dataset.fit_trials:
            run = ExplorationRun(
                dataset,
                identify(dataset, hypotheses=options.hypotheses, seed=options.seed, progress=report),
                loop.GetSubsystemByName("station").true_object,
                first_look[0],
                float(context.get_time()),
                time.perf_counter() - started,
            )
    if status.mode != "finished" or run is None:
        reason = status.reason or f"not done after {context.get_time():.0f} s of simulated time"
        if interrupted:
            raise ExplorationStopped(f"stopped after {len(trials)} of {pushes} pushes", run)
        raise ExplorationFailed(f"exploration stopped at push {status.push + 1} of {pushes}: {reason}", run)
    return run


def _output(loop: Diagram, system: str, port: str, root: Context) -> Any:
    block = loop.GetSubsystemByName(system)
    return block.GetOutputPort(port).Eval(block.GetMyContextFromRoot(root))


def _frames(loop: Diagram, root: Context) -> FloatArray:
    """(3,) pose of the true object's frame in that of the cells, as seen now."""
    X_WO = _output(loop, "station", "truth.object_pose", root)
    seen = _output(loop, "perception", "object_pose", root).pose
    place = turn(-seen[2]) @ (X_WO.translation()[:2] - seen[:2])
    return np.array([*place, RollPitchYaw(X_WO.rotation()).yaw_angle() - seen[2]])
