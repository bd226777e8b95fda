"""Runs the exploration loop to its end and returns what it learned."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.math import RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, EventStatus

from slipmap.diagrams.execution.requests import Health
from slipmap.diagrams.hardware.control import real_cell, stopped_by_ctrl_c
from slipmap.diagrams.hardware.interface import HardwareInterface
from slipmap.diagrams.hardware.network import ARM_PERIOD
from slipmap.diagrams.loops.exploration_loop import (
    LoopOptions,
    RecordedRun,
    exploration_loop,
    latest_watch,
    output_of,
    recorded_dataset,
)
from slipmap.diagrams.loops.run_folder import Recording, RunFolder
from slipmap.diagrams.perception.cell_perception import FRAMES
from slipmap.diagrams.station.scenario import Scenario
from slipmap.diagrams.station.station import Station, take_fixed_steps
from slipmap.diagrams.systems.diagnosis import Repair
from slipmap.diagrams.systems.identification import learning
from slipmap.diagrams.systems.loop_messages import CHOOSING, LoopStatus
from slipmap.diagrams.systems.model_monitor import Watch
from slipmap.diagrams.systems.workers import time_in_place
from slipmap.models.geometry import turn
from slipmap.models.inference.results import Identification
from slipmap.models.measurements import PushDataset
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.perception.seen_object import angle_held
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.progress import Progress, silent
from slipmap.models.settings import check_kind

_LONGEST = 60.0  # s of simulated time per push, in addition to moving, after which the loop is given up
_LONGEST_REAL = 300.0  # s; the same in a real cell, where learning and planning take time
_WATCHED = 0.05  # s between two looks at a loop; nothing learns from a recording before it was looked at
_WAY, _DOWN, _PUSHED = (
    4.0,
    0.8,
    0.3,
)  # m, longest distances of the finger for a push: above the table, down and up, on the table

DOING = {
    "looking": "looking at the object",
    "choosing": "choosing a push",
    "telling apart": "choosing the most informative push",
    "pushing": "pushing",
    "recording": "recording",
    "learning": "learning",
    "diagnosing": "diagnosing the pushes",
}


ROUND = "the object looks round, so its angle is held fixed"  # remark on an object whose angle cannot be seen


class ExplorationFailed(RuntimeError):
    """The loop gave up; the text says why. `run` is the recording until then, or None."""

    def __init__(self, text: str, run: ExplorationRun | None = None) -> None:
        super().__init__(text)
        self.run = run


class ExplorationStopped(ExplorationFailed):
    """Ctrl-C ended the loop."""


@dataclass(frozen=True, eq=False)
class ExplorationRun:
    """The result of an exploration."""

    dataset: PushDataset  # recorded pushes; those made to judge have the role `heldout`
    identification: Identification  # learned from the others
    watch: Watch  # the monitor's judgement of pushes that earlier beliefs had predicted
    true_object: TrueObject | None  # on the station's table; None in a real cell
    # (3,) pose of the true object's frame in the frame S of the cells that the camera detected; None in a
    # real cell
    X_SO: FloatArray | None
    simulated: float  # s of simulated time, or of the real cell's time
    seconds: float  # s of computing time
    thinking: float  # s of it for learning and for choosing pushes, as far as it was not done beside the run
    repair: Repair | None = None  # how the model was repaired during the run, if the run adapts

    @property
    def angle_seen(self) -> bool:
        """Whether the camera saw the object turn."""
        return not all(map(angle_held, self.dataset.trials))

    @property
    def true_center_of_mass(self) -> FloatArray:
        """(2,) true centre of mass in the frame of the cells, m; known only in a simulation."""
        assert self.true_object is not None and self.X_SO is not None
        return turn(self.X_SO[2]) @ self.true_object.center_of_mass[:2] + self.X_SO[:2]

    def truth(self) -> dict[str, Any] | None:
        """True values of the learned quantities, and the belief's error; None in a real cell and its twin."""
        if self.true_object is None or self.X_SO is None:
            return None
        belief, true = self.identification.belief, self.true_center_of_mass
        named = {quantity.name: quantity.value for quantity in self.identification.quantities}
        believed = np.array([named[f"centre of mass, {axis}"] for axis in "xy"])
        return {
            "total_mass": self.true_object.total_mass,
            "friction_force": float((self.true_object.mass * self.true_object.mu).sum() * belief.gravity),
            "center_of_mass": [float(value) for value in true],
            "center_of_mass_believed": [float(value) for value in believed],
            "center_of_mass_error": float(np.hypot(*(true - believed))),
        }


def explore(
    scenario: Scenario,
    options: LoopOptions,
    *,
    hardware: str | HardwareInterface | None = None,
    meshcat: Meshcat | None = None,
    progress: Progress | None = None,
    record: RunFolder | None = None,
    before: RecordedRun | None = None,
    learn_when_stopped: bool = True,
) -> ExplorationRun:
    """Explore the object of a scenario.

    Args:
        scenario: the cell: object, table, arm, camera and simulation; lengths in m, times in s.
        options: numbers of pushes, cells and hypotheses, effects, and the seed of every draw.
        hardware: LCM address of a real cell that contains the object, or see `control.real_cell`; simulated
            if None.
        meshcat: where to show it, if anywhere.
        progress: called with (stage, done, total).
        record: where pushes go as soon as they are recorded; an error that it raises ends the run.
        before: recording of an earlier process to continue.
        learn_when_stopped: whether Ctrl-C still learns from the pushes made so far, which takes time, or ends
            the run at once.

    Returns:
        The pushes, what was learned from them, and the monitor's judgement.

    Raises:
        ExplorationFailed: the object was lost, or the arm cannot make any push.
        ExplorationStopped: Ctrl-C; contains the run until then if `learn_when_stopped`.
        ValueError, RendererUnavailable: see `exploration_loop`.
        HardwareError: the real cell cannot be reached.

    Example:
        >>> import slipmap
        >>> scenario = slipmap.Scenario()
        >>> scenario.simulation.time_step = 0.005
        >>> run = slipmap.explore(scenario, slipmap.LoopOptions(pushes=1, cells=30, hypotheses=4))
        >>> len(run.dataset.trials), len(run.identification.belief)
        (1, 4)
    """
    check_kind("explore: scenario", scenario, Scenario, "such as slipmap.Scenario()")
    check_kind("explore: options", options, LoopOptions, "such as slipmap.LoopOptions(pushes=3)")
    report = progress or silent
    pushes = options.pushes + options.checks

    def watch(status: LoopStatus, context: Context) -> None:
        if recording is not None:
            recording.look(context)
        if status.mode not in DOING:
            return
        doing = DOING[status.mode]
        seen = output_of(loop, "perception", "seen_object", context)
        if seen is not None and not seen.angle_seen:
            doing = f"{doing}; {ROUND}"
        report(f"exploring: {doing}", status.push, max(pushes, status.push + 1))

    with real_cell(scenario, hardware, options.effects) as (cell, worker):
        loop = exploration_loop(scenario, options, cell=cell, worker=worker, meshcat=meshcat, before=before)
        recording = None if record is None else Recording(loop, record, before)
        longest = longest_push(scenario, real=cell is not None)
        most = pushes + (scenario.repair.pushes if options.adapt else 0)
        ended = run_loop(loop, "supervisor", ("finished", "failed"), longest * most, watch)
        planned = max(pushes, ended.status.of)  # a repair may have asked for more
        if ended.interrupted and not learn_when_stopped:
            raise ExplorationStopped(f"stopped at push {ended.status.push + 1} of {planned}")
        run = explored(loop, ended, scenario, options, report)
    if ended.status.mode != "finished" or run is None:
        recorded = 0 if run is None else len(run.dataset.trials)
        if ended.interrupted:
            raise ExplorationStopped(f"stopped after {recorded} of {planned} pushes", run)
        raise ExplorationFailed(
            f"exploration stopped at push {ended.status.push + 1} of {planned}: {ended.reason}", run
        )
    return run


def longest_push(scenario: Scenario, *, real: bool) -> float:
    """Time per push after which a loop is given up, s; longer for a slow arm or a slow camera."""
    moving = scenario.execution
    way = _WAY / moving.transit_speed + _DOWN / moving.lowering_speed + _PUSHED / moving.push_speed_limit
    pictures = 2.0 * FRAMES / scenario.camera.rate
    return (_LONGEST_REAL if real else _LONGEST) + moving.settle + way + pictures


@dataclass(frozen=True, eq=False)
class LoopEnd:
    """A loop that has ended."""

    status: LoopStatus  # last of the supervisor
    context: Context  # of the whole loop
    X_SO: FloatArray | None  # (3,) see `ExplorationRun`; None also if the object was never seen
    interrupted: bool  # whether Ctrl-C ended it
    seconds: float  # duration, s
    thinking: float  # duration of what it had to wait for: learning and choosing pushes, s

    @property
    def simulated(self) -> float:
        """s of simulated time."""
        return float(self.context.get_time())

    @property
    def reason(self) -> str:
        """Why it ended, if it failed."""
        return self.status.reason or f"not finished after {self.simulated:.0f} s of simulated time"


def run_loop(
    loop: Diagram,
    supervisor: str,
    last: Sequence[str],
    longest: float,
    watch: Callable[[LoopStatus, Context], None],
) -> LoopEnd:
    """Run a loop until its supervisor reaches a final mode and a stopped arm is at rest, or until Ctrl-C.

    A loop can be run only once.

    Args:
        loop: with the systems of `exploration_loop`.
        supervisor: name of the system whose status counts.
        last: final modes.
        longest: simulated time after which the loop is given up, s.
        watch: called with the status and the loop's Context whenever the status changes and every 50 ms, so
            before anything learns from a new recording; and at the end of a run that Ctrl-C ends, then also
            with a final status.

    Raises:
        HardwareError: the real cell does not answer.
        KeyboardInterrupt: a second Ctrl-C in a real cell.
    """
    gc.collect()  # the loop of an earlier run, which is large and has reference cycles
    simulator = Simulator(loop)
    take_fixed_steps(simulator)
    context = simulator.get_mutable_context()
    station = loop.GetSubsystemByName("station")
    simulated = isinstance(station, Station)
    if not simulated:
        station.connect(context)
        simulator.set_target_realtime_rate(station.realtime_rate)
    started, thought = time.perf_counter(), time_in_place()
    X_SO: FloatArray | None = None

    block = loop.GetSubsystemByName(supervisor)
    port, context_of_port = block.GetOutputPort("status"), block.GetMyContextFromRoot(context)
    seen: tuple[LoopStatus | None, int] = None, -1

    def monitor(root: Context) -> EventStatus:
        nonlocal seen, X_SO
        status: LoopStatus = port.Eval(context_of_port)
        if status.mode in last:
            if _at_rest(loop, root):
                return EventStatus.ReachedTermination(block, status.mode)
            return EventStatus.DidNothing()
        now = status, int(root.get_time() / _WATCHED + 1e-6)
        if now != seen:
            seen = now
            if simulated and X_SO is None and status.mode in CHOOSING:
                X_SO = _frames(loop, root, output_of(loop, "perception", "object_pose", root).pose)
            watch(status, root)
        if simulated:
            station.after_step(context)
        return EventStatus.DidNothing()

    simulator.set_monitor(monitor)
    interrupted = False
    gc.freeze()  # all present objects outlive this run, so the collector need not check them
    try:
        with nullcontext(lambda: False) if simulated else stopped_by_ctrl_c(station) as pressed:
            simulator.AdvanceTo(longest)
            interrupted = pressed()
    except KeyboardInterrupt:
        if not simulated:  # the second one: the first stopped the arm
            raise
        interrupted = True
    finally:
        gc.unfreeze()
    ended: LoopStatus = port.Eval(context_of_port)
    if interrupted:
        watch(ended, context)
    if simulated and X_SO is None and (trials := output_of(loop, "logger", "trials", context)):
        # No push was chosen after those recorded earlier, so the object lies where the last one left it.
        X_SO = _frames(loop, context, trials[-1].object_pose.values[-1])
    return LoopEnd(
        ended,
        context,
        X_SO,
        interrupted,
        time.perf_counter() - started,
        time_in_place() - thought,
    )


def explored(
    loop: Diagram, ended: LoopEnd, scenario: Scenario, options: LoopOptions, report: Progress
) -> ExplorationRun | None:
    """The result of a loop that has ended; None if nothing was recorded to learn from."""
    started = time.perf_counter()
    station = loop.GetSubsystemByName("station")
    trials = output_of(loop, "logger", "trials", ended.context)
    if not any(trial.role == "fit" for trial in trials):
        return None
    dataset = recorded_dataset(trials, output_of(loop, "perception", "cell_grid", ended.context), scenario)
    repair = output_of(loop, "diagnosis", "repair", ended.context) if options.adapt else None
    learn = learning(options.effects) if repair is None else learning(repair.effects, rival=repair.rival)
    identification = learn(dataset, hypotheses=options.hypotheses, seed=options.seed, progress=report)
    return ExplorationRun(
        dataset,
        identification,
        latest_watch(loop, ended.context),
        station.true_object if isinstance(station, Station) else None,
        ended.X_SO,
        ended.simulated,
        ended.seconds + time.perf_counter() - started,
        ended.thinking + time.perf_counter() - started,
        repair,
    )


def _at_rest(loop: Diagram, root: Context) -> bool:
    """Whether the motion to rest after a fault has been sent to the arm; True without a guard or a fault."""
    if not loop.HasSubsystemNamed("guard"):
        return True
    health: Health = output_of(loop, "guard", "health", root)
    return bool(root.get_time() > health.rest + ARM_PERIOD)  # a command is sent a period after it was made


def _frames(loop: Diagram, root: Context, seen: FloatArray) -> FloatArray:
    """(3,) pose X_SO of the true object's frame in the frame of the cells, given (3,) X_WS as seen now."""
    X_WO = output_of(loop, "station", "truth.object_pose", root)
    place = turn(-seen[2]) @ (X_WO.translation()[:2] - seen[:2])
    return np.array([*place, RollPitchYaw(X_WO.rotation()).yaw_angle() - seen[2]])
