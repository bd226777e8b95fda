"""The folder of a run of the robot's cell: its pushes, written while it goes on, and `run.json` about them.

A `RunFolder` keeps the pushes, `PregraspFolder` and `ExplorationFolder` what their commands need besides; a
killed exploration loses nothing and can be gone on with (`resumed`). A `Recording` has written down what a
loop records. Pushes of an ended run give way to the same command alone (`refuse_others_files`).
"""

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, cast
from zipfile import BadZipFile

import numpy as np
from pydrake.common.yaml import yaml_dump_typed
from pydrake.systems.framework import Context, Diagram

from slipmap.diagrams.loops.exploration_loop import LoopOptions, RecordedRun, output_of, recorded_dataset
from slipmap.diagrams.station.scenario import ObjectSettings, Scenario, ScenarioError, read_settings
from slipmap.diagrams.systems.diagnosis import Repair
from slipmap.diagrams.systems.model_monitor import Watch
from slipmap.models.files import BadInput, whole_file, write_json, write_text, writing
from slipmap.models.measurements import DatasetError, PushDataset, Trial, read_dataset
from slipmap.models.measurements.parsing import read_bytes
from slipmap.models.measurements.writing import PushRecorder, trial_text
from slipmap.models.perception.first_look import FirstPicture
from slipmap.planners.action_selection import Choice
from slipmap.planners.table_push import TablePush

RUN, PUSHES, UNDER_WAY = "run.json", "pushes", "under_way.json"
SCENARIO, PICTURE = "scenario.yaml", "first_picture.npz"
FORMAT = "slipmap-exploration/1"
"""Format of the `run.json` of `slipmap explore`."""

PREGRASP = "slipmap-pregrasp/1"
"""The same of `slipmap pregrasp`."""

_NOTED = 20  # rows of a push under way after which it is written down, at 100 a second


def read_run(folder: Path, format_: str) -> dict[str, Any]:
    """What `run.json` says of the run in a folder.

    Raises:
        BadInput: there is none, or that of another command.
    """
    path = folder / RUN
    try:
        run = json.loads(read_bytes(path))
    except DatasetError as error:
        raise BadInput(f"{error}; begin anew") from error
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: cannot be read ({error}); begin anew") from error
    if not isinstance(run, dict) or run.get("format") != format_:
        raise BadInput(f"{path}: is not the file of a run that this slipmap knows ({format_})")
    return run


def refuse_others_files(folder: Path, format_: str, command: str, *files: str) -> None:
    """Refuse a folder in which a run would replace what no earlier run of the same command left.

    Args:
        format_: that `run.json` has after such a run.
        command: such as `slipmap explore`.
        files: beside the pushes, that a run replaces.

    Raises:
        BadInput: names the folder, and `--out`.
    """
    pushes = folder / PUSHES
    present = [pushes] if pushes.is_dir() and any(pushes.iterdir()) else []
    present += [folder / name for name in files if (folder / name).exists()]
    if not present:
        return
    try:
        run = read_run(folder, format_)
    except BadInput:
        run = {}
    if run.get("ended") is not True or not _holds(pushes, run.get("pushes")):
        raise BadInput(
            f"{present[0]}: is not of an earlier run of `{command}` that ended, and would be lost; choose"
            " another folder with --out, or move it away"
        )


def refuse_robots_pushes(folder: Path, option: str) -> None:
    """Refuse a folder with pushes of a robot's cell, which cannot be made again, to a command that has none.

    Args:
        option: that names another.

    Raises:
        BadInput: names both.
    """
    if (folder / RUN).exists() and (folder / PUSHES).exists():
        raise BadInput(
            f"{folder}: holds a run of the robot's cell, whose pushes would be lost; choose another folder"
            f" with {option}"
        )


def _digests_of(trials: Sequence[Trial]) -> list[str]:
    """Digests of trials' files, by which `run.json` knows them."""
    return [hashlib.sha256(trial_text(trial).encode()).hexdigest() for trial in trials]


def _digest_of(path: Path) -> str:
    """Digest of a file, which may raise DatasetError."""
    return hashlib.sha256(read_bytes(path)).hexdigest()


def _holds(pushes: Path, stored: Any) -> bool:
    """Whether a dataset's trials are those that `run.json` lists."""
    try:
        expected = sorted(str(push["digest"]) for push in stored)
        return sorted(_digest_of(path) for path in pushes.rglob("*.json")) in (expected, [])
    except (DatasetError, KeyError, TypeError):
        return False


def keep_trials(recorder: PushRecorder, dataset: PushDataset) -> None:
    """Write the trials of a dataset that are not there yet.

    Raises:
        BadInput: the disk is full or the place not writable; names the file, and what to do.
    """
    try:
        recorder.keep(dataset)
    except OSError as error:
        with writing(Path(error.filename)):
            raise


class RunFolder:
    """Keeps the pushes of a run as a dataset in its folder, and what is measured of the push under way.

    The latter is no trial, as nobody knows where the object comes to rest; it stays in `under_way.json` where
    the run ends in the midst of a push.

    Args:
        kept: pushes of this run that are in the folder already.

    Raises:
        BadInput: files that are no part of a dataset stand where it should be.
    """

    def __init__(self, folder: Path, scenario: Scenario, kept: int = 0) -> None:
        self._folder, self._scenario = folder, scenario
        self._run: dict[str, Any] | None = None
        try:
            self._pushes = PushRecorder(folder / PUSHES, kept)
        except DatasetError as error:
            raise BadInput(str(error)) from error

    def keep(self, recorded: RecordedRun) -> None:
        """Write the pushes that are not there yet. Raises BadInput as `keep_trials`."""
        keep_trials(self._pushes, recorded_dataset(recorded.trials, recorded.grid, self._scenario))
        (self._folder / UNDER_WAY).unlink(missing_ok=True)

    def note(self, push: int, rows: dict[str, Any]) -> None:
        """Write down what is measured so far of the push under way.

        Args:
            rows: of each channel, as in a trial's file but with the run's time.

        Raises:
            BadInput: as `keep`.
        """
        write_json(self._folder / UNDER_WAY, {"push": push, **rows})

    def end(self) -> None:
        """Say that the run came to its end, for better or worse: it may be replaced by another.

        Raises:
            BadInput: as `keep`.
        """
        if self._run is not None:
            self._run["ended"] = True
            write_json(self._folder / RUN, self._run)


class PregraspFolder(RunFolder):
    """The folder of `slipmap pregrasp`: its run cannot be gone on with.

    Raises:
        BadInput: pushes are there that no earlier run of the command left, or of one that was cut off.
    """

    def __init__(self, folder: Path, scenario: Scenario) -> None:
        super().__init__(folder, scenario)
        refuse_others_files(folder, PREGRASP, "slipmap pregrasp")

    def keep(self, recorded: RecordedRun) -> None:
        """See `RunFolder.keep`."""
        pushes = [{"digest": digest} for digest in _digests_of(recorded.trials)]
        self._run = {"format": PREGRASP, "ended": False, "pushes": pushes}
        write_json(self._folder / RUN, self._run)
        super().keep(recorded)


class Recording:
    """A run that is being written: what its loop records goes to a folder as soon as it is there.

    Args:
        before: pushes that are kept already.
    """

    def __init__(self, loop: Diagram, record: RunFolder, before: RecordedRun | None = None) -> None:
        self._loop, self._record = loop, record
        self._choices = () if before is None else before.choices
        self._places = () if before is None else before.places
        self._noted = 0
        self._found: tuple[Any, ...] | None = None  # pushes that were judged and the repair, as kept last

    def look(self, root: Context) -> None:
        """Write down what is new; to be called often. Raises BadInput as `RunFolder.keep`."""
        trials = output_of(self._loop, "logger", "trials", root)
        watch = output_of(self._loop, "model_monitor", "watch", root)
        adapts = self._loop.HasSubsystemNamed("diagnosis")
        repair = output_of(self._loop, "diagnosis", "repair", root) if adapts else None
        found = (watch.judged, repair)
        if len(trials) > len(self._choices):
            plan = output_of(self._loop, "exploration", "plan", root)
            self._choices = (*self._choices, plan.choice)
            self._places = (*self._places, self._place(root))
            self._found = None
            self._noted = 0
        if trials and found != self._found:
            grid = output_of(self._loop, "perception", "cell_grid", root)
            first = output_of(self._loop, "perception", "first_picture", root)
            self._found = found
            self._record.keep(RecordedRun(trials, self._choices, self._places, grid, first, watch, repair))
            return
        rows = output_of(self._loop, "logger", "under_way", root)
        measured = len(rows["tip_pose"])
        if measured < self._noted:
            self._noted = 0
        if measured >= self._noted + _NOTED:
            self._noted = measured
            self._record.note(len(trials), rows)

    def _place(self, root: Context) -> list[float] | None:
        """x and y (m) and turn (degrees) of the simulated object."""
        if not self._loop.GetSubsystemByName("station").HasOutputPort("truth.object_pose"):
            return None
        X_WO = output_of(self._loop, "station", "truth.object_pose", root)
        x_axis = X_WO.rotation().matrix()[:, 0]
        turn = np.degrees(np.arctan2(x_axis[1], x_axis[0]))
        return [float(value) for value in (*X_WO.translation()[:2], turn)]


class ExplorationFolder(RunFolder):
    """The folder of `slipmap explore`, in step with the run.

    Beside the pushes it holds what another process needs to go on: scenario, options, the picture from which
    the object was cut into cells, and for each push how it was asked for. All of it names each other by
    digests, so that files of two runs are never mixed.

    Args:
        before: what is in the folder already, of a run that is gone on with.

    Raises:
        BadInput: a run that was cut off is there, files that are no part of one, or pushes that no earlier
            run of the command left.
    """

    def __init__(
        self, folder: Path, scenario: Scenario, options: LoopOptions, before: RecordedRun | None = None
    ) -> None:
        if before is None:
            _refuse_cut_off(folder)
        super().__init__(folder, scenario, 0 if before is None else len(before.trials))
        self._options = options
        if before is None:
            refuse_others_files(folder, FORMAT, "slipmap explore", SCENARIO)
        else:
            self._run = read_run(folder, FORMAT)

    def keep(self, recorded: RecordedRun) -> None:
        """See `RunFolder.keep`; an error also says what is kept, and how to go on."""
        if self._run is None:
            self._run = self._begin(recorded)
        self._run["pushes"] = [
            {"digest": digest, "poke": vars(choice) | {"push": vars(choice.push)}, "place": place}
            for digest, choice, place in zip(
                _digests_of(recorded.trials), recorded.choices, recorded.places, strict=True
            )
        ]
        if recorded.watch is not None:
            self._run["watch"] = recorded.watch.to_run()
        if recorded.repair is not None:
            self._run["repair"] = recorded.repair.to_run()
        with self.going_on(len(recorded.trials) - 1):
            write_json(self._folder / RUN, self._run)
            super().keep(recorded)

    def note(self, push: int, rows: dict[str, Any]) -> None:
        """See `RunFolder.note`."""
        with self.going_on(push):
            super().note(push, rows)

    def _begin(self, recorded: RecordedRun) -> dict[str, Any]:
        scenario = dataclasses.replace(self._scenario, object=_found_from_anywhere(self._scenario.object))
        write_text(self._folder / SCENARIO, yaml_dump_typed(scenario))
        with whole_file(self._folder / PICTURE) as part, open(part, "wb") as file:
            recorded.first.save(cast(BinaryIO, file))
        return {
            "format": FORMAT,
            "ended": False,
            "options": dataclasses.asdict(self._options),
            "digests": {name: _digest_of(self._folder / name) for name in (SCENARIO, PICTURE)},
        }

    @contextmanager
    def going_on(self, kept: int) -> Iterator[None]:
        """Add to the error of what could not be written how many pushes are kept, and how to go on."""
        try:
            yield
        except BadInput as error:
            if not kept:
                raise
            pushes = f"the {kept} pushes before are" if kept > 1 else "the push before is"
            raise BadInput(
                f"{error}; {pushes} kept, go on with `slipmap explore --resume {self._folder}`"
            ) from error


def resumed(folder: Path) -> tuple[Scenario, LoopOptions, RecordedRun]:
    """What to go on with: the scenario with the simulated object where it was left, options, and pushes.

    Raises:
        BadInput: there is no run in the folder, or a file of it is missing or of another run.
    """
    if not (folder / RUN).is_file():
        raise BadInput(
            f"{folder}: holds no run of `slipmap explore` that recorded a push; begin one with --out {folder}"
        )
    run = read_run(folder, FORMAT)
    try:
        for name, digest in run["digests"].items():
            if _digest_of(folder / name) != digest:
                raise BadInput(f"{folder / name}: is not that of the run in {folder / RUN}; begin anew")
        scenario = read_settings(folder / SCENARIO, Scenario)
        stored = run["options"]
        options = LoopOptions(**{**stored, "effects": tuple(stored.get("effects", ()))})
        first = FirstPicture.load(folder / PICTURE)
        grid = first.seen(scenario.camera.intrinsics).grid
        dataset = read_dataset(folder / PUSHES, keep_all=True)
        pushes = run["pushes"][: len(dataset.trials)]
        choices = tuple(_choice_of(push["poke"]) for push in pushes)
        digests = [push["digest"] for push in pushes]
        places = tuple(push["place"] for push in pushes)
        watch = Watch.of_run(run["watch"]) if "watch" in run else None
        repair = Repair.of_run(run["repair"]) if "repair" in run else None
    except (ScenarioError, DatasetError) as error:
        raise BadInput(str(error)) from error
    except (OSError, ValueError, KeyError, TypeError, BadZipFile) as error:
        raise BadInput(f"{folder}: the run in it cannot be continued ({error}); begin anew") from error
    if digests != [_digest_of(folder / PUSHES / trial.name) for trial in dataset.trials]:
        raise BadInput(f"{folder / PUSHES}: holds pushes that are not those of {folder / RUN}; begin anew")
    if not np.array_equal(grid.centers, dataset.grid.centers):
        raise BadInput(f"{folder}: this slipmap cuts the object into other cells than were recorded")
    if places[-1] is not None:
        scenario.object.pose = places[-1]
    return scenario, options, RecordedRun(dataset.trials, choices, places, grid, first, watch, repair)


def _refuse_cut_off(folder: Path) -> None:
    try:
        run = read_run(folder, FORMAT)
    except BadInput:
        return  # none, or none that could be gone on with
    if not run.get("ended") and run.get("pushes"):
        raise BadInput(
            f"{folder}: holds a run that was cut off, with pushes recorded: {len(run['pushes'])}; go on with"
            f" `slipmap explore --resume {folder}`, or choose another folder with --out"
        )


def _found_from_anywhere(thing: ObjectSettings) -> ObjectSettings:
    """The object with paths that do not depend on the working folder."""

    def absolute(path: str | None) -> str | None:
        return None if path is None else str(Path(path).resolve())

    return dataclasses.replace(thing, mesh=absolute(thing.mesh), labels=absolute(thing.labels))


def _choice_of(stored: dict[str, Any]) -> Choice:
    push, contact, direction = TablePush(**stored["push"]), stored["contact"], stored["direction"]
    return Choice(push, np.array(contact), np.array(direction), stored.get("why", ""))
