"""The folder of a run of the robot cell: its pushes, written while it runs, and `run.json` about them.

A `RunFolder` keeps the pushes; `PregraspFolder` and `ExplorationFolder` add what their commands need. A
killed exploration loses nothing and can be continued (`resumed`). A `Recording` writes what a loop records.
Only the same command may replace the pushes of a finished run, and only of a simulated one
(`refuse_others_files`).
"""

import dataclasses
import hashlib
import io
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from pydrake.common.yaml import yaml_dump_typed
from pydrake.systems.framework import Context, Diagram

from slipmap.diagrams.loops.exploration_loop import (
    LoopOptions,
    RecordedRun,
    latest_watch,
    output_of,
    recorded_dataset,
)
from slipmap.diagrams.station.scenario import ObjectSettings, Scenario, ScenarioError, read_settings
from slipmap.diagrams.systems.diagnosis import Repair
from slipmap.diagrams.systems.model_monitor import Watch
from slipmap.models.files import BadInput, all_or_nothing, whole_file, write_json, writing
from slipmap.models.measurements import DatasetError, PushDataset, Trial, read_dataset
from slipmap.models.measurements.parsing import read_bytes
from slipmap.models.measurements.writing import PushRecorder, trial_text
from slipmap.models.perception.first_look import FirstPicture
from slipmap.planners.action_selection import Choice
from slipmap.planners.table_push import TablePush

RUN, PUSHES, UNDER_WAY = "run.json", "pushes", "under_way.json"
SCENARIO, PICTURE = "scenario.yaml", "first_picture.npz"
FORMAT = "slipmap-exploration/1"  # format of the `run.json` of `slipmap explore`
PREGRASP = "slipmap-pregrasp/1"  # format of the `run.json` of `slipmap pregrasp`
_NOTED = 20  # new rows of a push under way after which they are written, at 100 per second


def read_run(folder: Path, format_: str) -> dict[str, Any]:
    """Read the `run.json` of the run in a folder.

    Raises:
        BadInput: there is none, or it is from another command.
    """
    path = folder / RUN
    try:
        run = json.loads(read_bytes(path))
    except DatasetError as error:
        raise BadInput(f"{error}; start a new run") from error
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: cannot be read ({error}); start a new run") from error
    if not isinstance(run, dict) or run.get("format") != format_:
        raise BadInput(f"{path}: is not from a run that this version of slipmap knows ({format_})")
    return run


def refuse_others_files(folder: Path, format_: str, command: str, *files: str) -> int:
    """Refuse a folder in which a run would replace files other than those of an earlier simulated run of its
    command.

    Args:
        format_: of the `run.json` of such a run.
        command: such as `slipmap explore`.
        files: that a run replaces in addition to the pushes.

    Returns:
        The number of pushes of the earlier run there.

    Raises:
        BadInput: names the folder, and `--output`.
    """
    pushes = folder / PUSHES
    present = [pushes] if pushes.is_dir() and any(pushes.iterdir()) else []
    present += [folder / name for name in files if (folder / name).exists()]
    if not present:
        return 0
    try:
        run = read_run(folder, format_)
    except BadInput:
        run = {}
    ended = run.get("ended") is True and _holds(pushes, run.get("pushes"))
    # A run that was killed before it wrote its first push.
    own = run.get("digests")
    own = own if isinstance(own, dict) else {}
    begun = pushes not in present and all(own.get(path.name) == _digest_of(path) for path in present)
    if not (ended or begun):
        raise BadInput(
            f"{present[0]}: is not from a finished earlier run of `{command}` and would be lost; choose"
            " another folder with --output, or move it away"
        )
    count = len(run["pushes"]) if pushes in present else 0
    if count and not _simulated(run):
        raise BadInput(
            f"{folder}: holds an earlier run that may be of a real cell, and pushes recorded: {count}, which"
            " would be lost; choose another folder with --output, or move it away"
        )
    return count


def _simulated(run: dict[str, Any]) -> bool:
    """Whether a run was made in simulation, as its `run.json` tells."""
    return run.get("simulated") is True or all(push.get("place") is not None for push in run["pushes"])


def refuse_robots_pushes(folder: Path) -> None:
    """Raise BadInput for a folder with pushes of a robot cell, which cannot be repeated, for a command that
    makes none."""
    if (folder / RUN).exists() and (folder / PUSHES).exists():
        raise BadInput(
            f"{folder}: holds a run of the robot cell, whose pushes would be lost; choose another folder"
            " with --output"
        )


def _digests_of(trials: Sequence[Trial]) -> list[str]:
    """Digests of trials' files, by which `run.json` identifies them."""
    return [hashlib.sha256(trial_text(trial).encode()).hexdigest() for trial in trials]


def _digest_of(path: Path) -> str:
    """Digest of a file, which may raise DatasetError."""
    return hashlib.sha256(read_bytes(path)).hexdigest()


def _holds(pushes: Path, stored: Any) -> bool:
    """Whether a dataset's trials are all among those that `run.json` lists."""
    try:
        listed = Counter(str(push["digest"]) for push in stored)
        return Counter(_digest_of(path) for path in pushes.rglob("*.json")) <= listed
    except (DatasetError, KeyError, TypeError):
        return False


def keep_trials(recorder: PushRecorder, dataset: PushDataset) -> None:
    """Write the trials of a dataset that are not there yet.

    Raises:
        BadInput: the disk is full or the place not writable; names the file and the remedy.
    """
    try:
        recorder.keep(dataset)
    except OSError as error:
        with writing(Path(error.filename)):
            raise


class RunFolder:
    """Keeps the pushes of a run as a dataset in its folder, and the measurements of the push under way.

    The latter are not a trial, because it is unknown where the object comes to rest. They stay in
    `under_way.json` if the run ends in the middle of a push, unless `leave_none` is called.

    Args:
        kept: number of this run's pushes already in the folder.

    Attributes:
        replaces: number of pushes of an earlier run there, which are removed once this run has recorded one.

    Raises:
        BadInput: the dataset's place holds files that are not part of one.
    """

    def __init__(self, folder: Path, scenario: Scenario, kept: int = 0) -> None:
        self._folder, self._scenario = folder, scenario
        self.replaces = 0
        self._run: dict[str, Any] | None = None
        try:
            self._pushes = PushRecorder(folder / PUSHES, kept)
        except DatasetError as error:
            raise BadInput(str(error)) from error

    def clear(self, *files: str) -> None:
        """Remove what an earlier run left, so that no file of it is taken for one of this run.

        Args:
            files: names of its files, in addition to the pushes.

        Raises:
            BadInput: like `keep`.
        """
        with writing(self._folder / PUSHES):
            self._pushes.clear()
            for name in files:
                (self._folder / name).unlink(missing_ok=True)

    def keep(self, recorded: RecordedRun) -> None:
        """Write the pushes that are not there yet. Raises BadInput like `keep_trials`."""
        keep_trials(self._pushes, recorded_dataset(recorded.trials, recorded.grid, self._scenario))
        (self._folder / UNDER_WAY).unlink(missing_ok=True)

    def note(self, push: int, rows: dict[str, Any]) -> None:
        """Write the measurements so far of the push under way.

        Args:
            push: its number, from 0.
            rows: of each channel, as in a trial's file but in the run's time.

        Raises:
            BadInput: like `keep`.
        """
        write_json(self._folder / UNDER_WAY, {"push": push, **rows})

    def leave_none(self) -> None:
        """Remove the measurements of the push under way, for a run that is stopped before any is recorded.

        Raises:
            BadInput: like `keep`.
        """
        with writing(self._folder / UNDER_WAY):
            (self._folder / UNDER_WAY).unlink(missing_ok=True)

    def end(self, complete: bool = True) -> None:
        """Mark the run as ended, successfully or not, so that another may replace it if it was simulated.

        Args:
            complete: whether nothing is left to do.

        Raises:
            BadInput: like `keep`.
        """
        if self._run is not None:
            self._run |= {"ended": True, "complete": complete}
            write_json(self._folder / RUN, self._run)


class PregraspFolder(RunFolder):
    """The folder of `slipmap pregrasp`, whose run cannot be continued.

    Args:
        repeatable: whether the run, a simulation, may be replaced by another, even if it is killed.

    Raises:
        BadInput: the folder has pushes that are not from a repeatable earlier run of the command.
    """

    def __init__(self, folder: Path, scenario: Scenario, *, repeatable: bool = False) -> None:
        super().__init__(folder, scenario)
        self._repeatable = repeatable
        self.replaces = refuse_others_files(folder, PREGRASP, "slipmap pregrasp")

    def keep(self, recorded: RecordedRun) -> None:
        """See `RunFolder.keep`."""
        if self._run is None:
            self.clear()
        pushes = [{"digest": digest} for digest in _digests_of(recorded.trials)]
        simulated = self._repeatable
        self._run = {"format": PREGRASP, "ended": simulated, "simulated": simulated, "pushes": pushes}
        write_json(self._folder / RUN, self._run)
        super().keep(recorded)


class Recording:
    """A run that is being written: its loop's recording goes to a folder as soon as it is there.

    Args:
        before: pushes that are already kept.
    """

    def __init__(self, loop: Diagram, record: RunFolder, before: RecordedRun | None = None) -> None:
        self._loop, self._record = loop, record
        self._choices = () if before is None else before.choices
        self._places = () if before is None else before.places
        self._noted = 0
        self._found: tuple[Any, ...] | None = None  # judged pushes, repair and grid, as last kept

    def look(self, root: Context) -> None:
        """Write whatever is new; call it often. Raises BadInput like `RunFolder.keep`."""
        trials = output_of(self._loop, "logger", "trials", root)
        new = len(trials) > len(self._choices)
        watch = (
            output_of(self._loop, "model_monitor", "watch", root) if new else latest_watch(self._loop, root)
        )
        adapts = self._loop.HasSubsystemNamed("diagnosis")
        repair = output_of(self._loop, "diagnosis", "repair", root) if adapts else None
        grid = output_of(self._loop, "perception", "cell_grid", root)
        found = (watch.judged, repair, grid)
        if new:
            plan = output_of(self._loop, "exploration", "plan", root)
            self._choices = (*self._choices, plan.choice)
            self._places = (*self._places, self._place(root))
            self._found = None
            self._noted = 0
        if trials and found != self._found:
            self._found = found
            first = output_of(self._loop, "perception", "first_picture", root)
            rests = output_of(self._loop, "perception", "rests", root)
            seen = () if rests is None else rests.offsets
            self._record.keep(
                RecordedRun(trials, self._choices, self._places, grid, first, seen, watch, repair)
            )
            if new:
                self.look(root)  # adds its judgement, before anything learns from it
            return
        rows = output_of(self._loop, "logger", "under_way", root)
        measured = len(rows["tip_pose"])
        if measured < self._noted:
            self._noted = 0
        if measured >= self._noted + _NOTED:
            self._noted = measured
            self._record.note(len(trials), rows)

    def _place(self, root: Context) -> list[float] | None:
        """x and y (m) and rotation (degrees) of the simulated object; None in a real cell."""
        if not self._loop.GetSubsystemByName("station").HasOutputPort("truth.object_pose"):
            return None
        X_WO = output_of(self._loop, "station", "truth.object_pose", root)
        x_axis = X_WO.rotation().matrix()[:, 0]
        turn = np.degrees(np.arctan2(x_axis[1], x_axis[0]))
        return [float(value) for value in (*X_WO.translation()[:2], turn)]


class ExplorationFolder(RunFolder):
    """The folder of `slipmap explore`, kept up to date with the run.

    In addition to the pushes it holds what another process needs to continue: the scenario, the options, the
    picture from which the object was divided into cells, what was seen of its outline since, and the choice
    behind each push. `run.json` identifies the files by digests, so that files of two runs are never mixed.

    Args:
        before: content of the folder, if its run is continued.

    Raises:
        BadInput: the folder has an interrupted run, a run of a real cell, files that are not part of a run,
            or pushes that are not from an earlier run of the command.
    """

    def __init__(
        self, folder: Path, scenario: Scenario, options: LoopOptions, before: RecordedRun | None = None
    ) -> None:
        if before is None:
            _refuse_cut_off(folder)
        super().__init__(folder, scenario, 0 if before is None else len(before.trials))
        self._options = options
        if before is None:
            self.replaces = refuse_others_files(folder, FORMAT, "slipmap explore", SCENARIO)
        else:
            self._run = read_run(folder, FORMAT) | {"ended": False, "complete": False}

    def keep(self, recorded: RecordedRun) -> None:
        """See `RunFolder.keep`; an error also says what is kept and how to continue."""
        settings = self._settings(recorded) if self._run is None else {}
        if self._run is None:
            self.clear(*settings)
            self._run = {
                "format": FORMAT,
                "ended": False,
                "options": dataclasses.asdict(self._options),
                "digests": {name: hashlib.sha256(data).hexdigest() for name, data in settings.items()},
            }
        self._run["pushes"] = [
            {"digest": digest, "poke": vars(choice) | {"push": vars(choice.push)}, "place": place}
            for digest, choice, place in zip(
                _digests_of(recorded.trials), recorded.choices, recorded.places, strict=True
            )
        ]
        # In whole micrometres, None where a point was never seen.
        self._run["rests"] = [
            [None if np.isnan(offset) else round(1e6 * offset) for offset in rest] for rest in recorded.rests
        ]
        if recorded.watch is not None:
            self._run["watch"] = recorded.watch.to_run()
        if recorded.repair is not None:
            self._run["repair"] = recorded.repair.to_run()
        with self.going_on(len(recorded.trials) - 1):
            with all_or_nothing():
                write_json(self._folder / RUN, self._run)  # first, since it identifies the others
                for name, data in settings.items():
                    with whole_file(self._folder / name) as part:
                        part.write_bytes(data)
            super().keep(recorded)

    def note(self, push: int, rows: dict[str, Any]) -> None:
        """See `RunFolder.note`."""
        with self.going_on(push):
            super().note(push, rows)

    def _settings(self, recorded: RecordedRun) -> dict[str, bytes]:
        """Content of the files that a run writes once, by name."""
        scenario = dataclasses.replace(self._scenario, object=_found_from_anywhere(self._scenario.object))
        picture = io.BytesIO()
        recorded.first.save(picture)
        return {SCENARIO: yaml_dump_typed(scenario).encode(), PICTURE: picture.getvalue()}

    @contextmanager
    def going_on(self, kept: int) -> Iterator[None]:
        """Add to a write error how many pushes are kept and how to continue."""
        try:
            yield
        except BadInput as error:
            if not kept:
                raise
            pushes = f"the {kept} earlier pushes are" if kept > 1 else "the earlier push is"
            raise BadInput(
                f"{error}; {pushes} kept, continue with `slipmap explore --resume {self._folder}`"
            ) from error


def is_complete(folder: Path) -> bool:
    """Whether nothing is left to do for the exploration in a folder. Raises BadInput like `read_run`."""
    return read_run(folder, FORMAT).get("complete") is True


def resumed(folder: Path) -> tuple[Scenario, LoopOptions, RecordedRun]:
    """Load a run to continue: the scenario with the simulated object where it was left, options, and pushes.

    Raises:
        BadInput: the folder has no run, or a file of it is missing or belongs to another run.
    """
    if not ((folder / RUN).is_file() and (folder / PUSHES).is_dir()):
        raise BadInput(
            f"{folder}: holds no run of `slipmap explore` with pushes; start one with --output {folder}"
        )
    run = read_run(folder, FORMAT)
    try:
        for name, digest in run["digests"].items():
            if _digest_of(folder / name) != digest:
                raise BadInput(
                    f"{folder / name}: is not the file of the run in {folder / RUN}; start a new run"
                )
        scenario = read_settings(folder / SCENARIO, Scenario)
        stored = run["options"]
        options = LoopOptions(**{**stored, "effects": tuple(stored.get("effects", ()))})
        first = FirstPicture.load(folder / PICTURE)
        rests = tuple(1e-6 * np.array(rest, dtype=float) for rest in run.get("rests", ()))
        grid = first.grid(scenario.camera.intrinsics, rests)
        dataset = read_dataset(folder / PUSHES, keep_all=True)
        pushes = run["pushes"][: len(dataset.trials)]
        choices = tuple(_choice_of(push["poke"]) for push in pushes)
        digests = [push["digest"] for push in pushes]
        places = tuple(push["place"] for push in pushes)
        watch = Watch.of_run(run["watch"]).up_to(len(dataset.trials)) if "watch" in run else None
        repair = Repair.of_run(run["repair"]) if "repair" in run else None
    except (ScenarioError, DatasetError) as error:
        raise BadInput(str(error)) from error
    except (OSError, ValueError, KeyError, TypeError, BadZipFile) as error:
        raise BadInput(f"{folder}: its run cannot be continued ({error}); start a new run") from error
    if digests != [_digest_of(folder / PUSHES / trial.name) for trial in dataset.trials]:
        raise BadInput(f"{folder / PUSHES}: its pushes are not those of {folder / RUN}; start a new run")
    if not np.array_equal(grid.centers, dataset.grid.centers):
        raise BadInput(
            f"{folder}: this version of slipmap divides the object into other cells than the recorded ones;"
            " start a new run"
        )
    if places[-1] is not None:
        scenario.object.pose = places[-1]
    return scenario, options, RecordedRun(dataset.trials, choices, places, grid, first, rests, watch, repair)


def _refuse_cut_off(folder: Path) -> None:
    try:
        run = read_run(folder, FORMAT)
    except BadInput:
        return  # none, or none that could be continued
    if not run.get("ended") and run.get("pushes") and (folder / PUSHES).exists():
        raise BadInput(
            f"{folder}: holds an interrupted run with pushes recorded: {len(run['pushes'])}; continue with"
            f" `slipmap explore --resume {folder}`, or choose another folder with --output"
        )


def _found_from_anywhere(thing: ObjectSettings) -> ObjectSettings:
    """The object with absolute paths."""

    def absolute(path: str | None) -> str | None:
        return None if path is None else str(Path(path).resolve())

    return dataclasses.replace(thing, mesh=absolute(thing.mesh), labels=absolute(thing.labels))


def _choice_of(stored: dict[str, Any]) -> Choice:
    push, contact, direction = TablePush(**stored["push"]), stored["contact"], stored["direction"]
    return Choice(push, np.array(contact), np.array(direction), stored.get("why", ""))
