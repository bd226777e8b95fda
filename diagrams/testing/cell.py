"""A cell for tests: its table, the robot's actions there, and injected faults."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from slipmap.diagrams.hardware.control import only_controller
from slipmap.diagrams.hardware.guard import GuardSettings
from slipmap.diagrams.hardware.interface import HardwareInterface
from slipmap.diagrams.hardware.network import LCM_URL, open_lcm
from slipmap.diagrams.loops.exploration_loop import LoopOptions
from slipmap.diagrams.loops.exploration_run import DOING, ExplorationRun, explore
from slipmap.diagrams.loops.pregrasp_loop import BRINGS, PregraspOptions, PregraspRun, pregrasp
from slipmap.diagrams.loops.run_folder import ExplorationFolder, RunFolder, resumed
from slipmap.diagrams.station.scenario import Scenario, check_scenario
from slipmap.diagrams.testing.assertions import CommandLog, CommandRecorder
from slipmap.diagrams.testing.faults import Fault, RelayProcess
from slipmap.diagrams.testing.twins import LockstepCell, TwinProcess, free_url
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.settings import check_whole

TWIN, LOCKSTEP = "twin", "lockstep"
"""The twin in a separate process, and the one that steps in lockstep with its driver."""

# Guards for an arm that can do no harm and so may always move fast, and the same on a busy computer.
_UNHURT = GuardSettings(transit_speed=2.0)
_BUSY = replace(_UNHURT, status_age=0.5, image_age=5.0, following=0.2, lag=1.0)


def small_scenario(where: str = TWIN) -> Scenario:
    """A scenario whose twin keeps up with real time on two cores; its guard allows for a busy `TWIN`."""
    scenario = Scenario()
    scenario.simulation.time_step = 0.005
    # With 320 by 240 pixels, hammer and wrench are not detected in one pose out of twenty.
    scenario.camera = replace(scenario.camera, width=480, height_pixels=360, rate=5.0)
    scenario.guard = replace(_BUSY if where == TWIN else _UNHURT)
    return scenario


@dataclass
class Faults:
    """Faults to inject while the robot works."""

    happened: list[Fault] = field(default_factory=list)  # faults ordered so far, in order
    _planned: list[tuple[str, int, Fault]] = field(default_factory=list)
    _ordered: list[tuple[str, int, Fault]] = field(
        default_factory=list
    )  # planned, and not known to have begun
    _way: RelayProcess | LockstepCell | None = None
    _possible: bool = True  # whether messages pass through something that can spoil them

    def now(self, fault: Fault) -> None:
        """Start a fault now.

        Raises:
            RuntimeError: the cell was not opened for faults, or the robot is idle in a cell that steps only
                with it.
        """
        self._require_possible()
        if self._way is None:
            raise RuntimeError("faults: nothing is running; plan them with `when` before the robot starts")
        self.happened.append(fault)
        self._way.order(fault)

    def when(self, doing: str, fault: Fault, *, push: int = 1) -> None:
        """Start a fault as soon as the robot enters a mode. One that has spoilt no message when the cell is
        closed fails the test.

        Args:
            doing: `looking`, `choosing`, `pushing`, `recording`, `learning`; with adapt also `diagnosing` and
                `telling apart`, in a pre-grasp `planning`, `grasping`, `lifting`, `holding`.
            fault: to inject.
            push: number of the push during which it starts, from 1; towards the edge, numbering restarts.

        Raises:
            RuntimeError: the cell was not opened for faults.
            ValueError: the robot has no such mode, or `push` is no whole number of at least 1.
        """
        self._require_possible()
        check_whole("faults: push", push, 1)
        if doing not in (known := {**DOING, **BRINGS}):
            raise ValueError(f"faults: the robot has no mode {doing!r}; choose one of {', '.join(known)}")
        self._planned.append((doing, push, fault))

    def require_started(self) -> None:
        """Raise AssertionError if a planned fault has spoilt no message: nothing was tested with it."""
        self.leave()
        left = [
            f"{fault} while {doing}, push {push}{f', {fault.after:g} s later' if fault.after else ''}"
            for doing, push, fault in (*self._ordered, *self._planned)
        ]
        assert not left, f"faults that were planned did not start: {'; '.join(left)}; let the robot get there"

    def leave(self) -> None:
        """Take down which planned faults have begun, before the messages' way through them ends."""
        if self._way is None or not self._ordered:
            return
        begun = list(self._way.begun)
        for planned in list(self._ordered):
            if planned[2] in begun:
                begun.remove(planned[2])
                self._ordered.remove(planned)

    def _require_possible(self) -> None:
        if not self._possible:
            raise RuntimeError(
                "faults: nothing can spoil the messages of this cell; open it with faulty=True, or let the"
                " test use the fixture faults"
            )

    def look(self, stage: str, done: int) -> None:
        """Start the faults planned for a stage of the run, as named by `explore`."""
        for planned in list(self._planned):
            doing, push, fault = planned
            words = {DOING.get(doing), BRINGS.get(doing)} - {None}
            # A remark may follow what the robot does.
            if done + 1 >= push and stage.partition(";")[0].endswith(tuple(map(str, words))):
                self._planned.remove(planned)
                self._ordered.append(planned)
                self.now(fault)


class Cell:
    """A cell with an object on its table. Use `open_cell` to get one.

    Attributes:
        scenario: of the cell; for a twin including its hidden effects.
        folder: where recordings go, one folder per run.
        faults: to inject.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: Path,
        url: str | None = None,
        recorder: CommandRecorder | None = None,
    ) -> None:
        self.scenario, self.folder = scenario, folder
        self.faults = Faults()
        self._url, self._recorder = url, recorder
        self._positions: FloatArray | None = None
        self._logs: list[CommandLog] = []
        self._explored: Path | None = None

    @property
    def commands(self) -> list[CommandLog]:
        """All commands sent to the arm so far, one log for each period with one clock."""
        return [self._recorder.log()] if self._recorder is not None else list(self._logs)

    def explore(
        self, pushes: int = 3, checks: int = 1, *, go_on: bool = False, **options: Any
    ) -> ExplorationRun:
        """Let the robot explore the object on the table, like `slipmap explore`.

        Args:
            pushes, checks, options: see `LoopOptions`.
            go_on: continue from the previous exploration, as with `--after`: all its pushes are learned from,
                in addition to `pushes` new ones, and the model has the effects given now.

        Raises:
            ExplorationFailed, HardwareError: see `slipmap.diagrams.loops.exploration_run.explore`.
            ValueError: there is no previous exploration.
        """
        before = None
        if go_on:
            if self._explored is None:
                raise ValueError("go_on: this cell has no recorded exploration to continue from")
            before = resumed(self._explored)[2].all_to_learn_from()
            pushes += len(before.trials)
        asked = LoopOptions(pushes=pushes, checks=checks, **options)
        self._explored = folder = self._next_folder("exploration")
        record = ExplorationFolder(folder, self.scenario, asked)
        if before is not None:
            record.keep(before)
        with self._driven() as where:
            run = explore(
                self.scenario, asked, hardware=where, progress=self._watch, record=record, before=before
            )
        record.end()
        return run

    def pregrasp(
        self, pushes: int = 3, *, most: int = 20, method: str = "probabilistic", **options: Any
    ) -> PregraspRun:
        """Let the robot explore, push to the edge, grasp and lift, like `slipmap pregrasp`.

        Args:
            pushes, options: of the exploration, see `LoopOptions`.
            most: largest number of pushes towards the edge.
            method: see `PregraspOptions`.

        Raises:
            ExplorationFailed, HardwareError: see `slipmap.diagrams.loops.pregrasp_loop.pregrasp`.
        """
        asked = PregraspOptions(LoopOptions(pushes=pushes, **options), method, most)
        record = RunFolder(self._next_folder("pregrasp"), self.scenario)
        with self._driven() as where:
            return pregrasp(self.scenario, asked, hardware=where, progress=self._watch, record=record)

    def _next_folder(self, what: str) -> Path:
        names = (path.name.partition("-")[0] for path in self.folder.iterdir())
        last = max((int(number) for number in names if number.isdecimal()), default=0)
        folder = self.folder / f"{last + 1}-{what}"
        folder.mkdir(parents=True)
        return folder

    def _watch(self, stage: str, done: int, total: int) -> None:
        self.faults.look(stage, done)

    @contextmanager
    def _driven(self) -> Iterator[str | HardwareInterface]:
        if self._url is not None:
            yield self._url
            return
        cell = LockstepCell(self.scenario, self._positions)
        self.faults._way = cell
        try:
            yield cell
        finally:
            self.faults.leave()
            self.faults._way = None
            self._logs.append(cell.log())
            self._positions = cell.positions


@contextmanager
def open_cell(
    where: str, folder: str | Path, scenario: Scenario | None = None, *, faulty: bool = False
) -> Iterator[Cell]:
    """Open a cell until the block ends.

    Args:
        where: `twin`, `lockstep`, or the LCM address of a cell that runs on its own.
        folder: where recordings go, after those that are there; made if missing.
        scenario: of the cell; `small_scenario(where)` if None.
        faulty: whether faults will be injected; messages then pass through one more process.

    Raises:
        AssertionError: at the end of the block, if a planned fault has not started.
        HardwareError: a process could not be started, or a malformed address.
        BadInput: with `faulty`, another process controls the cell.
        ScenarioError, TypeError: a scenario with a field or value that a file is refused for, or none.
        ValueError: neither a twin nor an address.
        ValueError, RendererUnavailable: as for `Station`.

    Example:
        >>> import pathlib
        >>> import tempfile
        >>> import slipmap
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with slipmap.open_cell("lockstep", pathlib.Path(folder)) as cell:
        ...         cell.scenario.object.name
        'hammer'
    """
    check_where(where)
    scenario, folder = scenario or small_scenario(where), Path(folder)
    check_scenario(scenario)
    folder.mkdir(parents=True, exist_ok=True)
    if where == LOCKSTEP:
        cell = Cell(scenario, folder)
        yield cell
        cell.faults.require_started()
        return
    with ExitStack() as processes:
        url = where
        if where == TWIN:
            twin = TwinProcess(scenario, folder)
            processes.callback(twin.close)
            url = twin.url
        else:
            open_lcm(url)  # refuses a malformed address
        relay = None
        if faulty:
            beyond, url = url, free_url()
            processes.enter_context(only_controller(beyond))  # the driver locks only this side of the relay
            relay = RelayProcess(beyond, url)
            processes.callback(relay.close)
        recorder = CommandRecorder(url, folder / "commands.bin")
        processes.callback(recorder.close)
        cell = Cell(scenario, folder, url, recorder)
        cell.faults._way, cell.faults._possible = relay, relay is not None
        yield cell
        cell.faults.require_started()


def check_where(where: str) -> None:
    """Raise ValueError for a cell that is neither a twin nor an address."""
    if where not in (TWIN, LOCKSTEP) and not where.startswith("udpm://"):
        raise ValueError(
            f"the cell must be {TWIN}, {LOCKSTEP}, or an LCM address such as {LCM_URL}, got {where!r}"
        )
