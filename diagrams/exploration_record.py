"""The folder of an exploration, written push by push: a killed run loses nothing and can be gone on with."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, cast
from zipfile import BadZipFile

import numpy as np
from pydrake.common.yaml import yaml_dump_typed

from diagrams.console import BadInput
from diagrams.exploration_loop import LoopOptions
from diagrams.outputs import whole_file, write_text
from diagrams.push_record import PushRecord
from diagrams.recorded import Recorded
from diagrams.run_folder import (
    PUSHES,
    RUN,
    digest_of,
    digests_of,
    read_run,
    refuse_others_files,
    write_run,
)
from diagrams.station.scenario import ObjectSettings, Scenario
from diagrams.station.scenario_file import ScenarioError, read_settings
from models.measurements import DatasetError, read_dataset
from models.perception.first_picture import FirstPicture
from planners.action_selection import Poke
from planners.table_push import TablePush

FORMAT = "slipmap-exploration/1"
SCENARIO, PICTURE = "scenario.yaml", "first_picture.npz"


class ExplorationRecord(PushRecord):
    """Keeps a run's folder in step with it.

    Beside the pushes it holds what another process needs to go on: scenario, options, the picture from which
    the object was cut into cells, and for each push how it was asked for. All of it names each other by
    digests, so that files of two runs are never mixed.

    Args:
        folder: of the run.
        scenario, options: of the run.
        before: what is in the folder already, of a run that is gone on with.

    Raises:
        BadInput: a run that was cut off is there, files that are no part of one, or pushes that no earlier
            run of the command left.
    """

    def __init__(
        self, folder: Path, scenario: Scenario, options: LoopOptions, before: Recorded | None = None
    ) -> None:
        if before is None:
            _refuse_cut_off(folder)
        super().__init__(folder, scenario, 0 if before is None else len(before.trials))
        if before is None:
            refuse_others_files(folder, FORMAT, "slipmap explore", SCENARIO)
        self._options = options
        self._run: dict[str, Any] | None = None if before is None else read_run(folder, FORMAT)

    def keep(self, recorded: Recorded) -> None:
        """Write what is not there yet.

        Raises:
            BadInput: the disk is full or the place not writable; names the file, and what to do.
        """
        if self._run is None:
            self._run = self._begin(recorded)
        self._run["pushes"] = [
            {"digest": digest, "poke": _poke(poke), "place": place}
            for digest, poke, place in zip(
                digests_of(recorded.trials), recorded.pokes, recorded.places, strict=True
            )
        ]
        with self._going_on(len(recorded.trials) - 1):
            write_run(self._folder, self._run)
            super().keep(recorded)

    def note(self, push: int, rows: dict[str, Any]) -> None:
        """See `PushRecord.note`."""
        with self._going_on(push):
            super().note(push, rows)

    def end(self) -> None:
        """Say that the run came to its end, for better or worse: it may be replaced by another."""
        if self._run is not None:
            self._run["ended"] = True
            write_run(self._folder, self._run)

    def _begin(self, recorded: Recorded) -> dict[str, Any]:
        scenario = dataclasses.replace(self._scenario, object=_found_from_anywhere(self._scenario.object))
        write_text(self._folder / SCENARIO, yaml_dump_typed(scenario))
        with whole_file(self._folder / PICTURE) as part, open(part, "wb") as file:
            recorded.first.save(cast(BinaryIO, file))
        return {
            "format": FORMAT,
            "ended": False,
            "options": dataclasses.asdict(self._options),
            "digests": {name: digest_of(self._folder / name) for name in (SCENARIO, PICTURE)},
        }

    @contextmanager
    def _going_on(self, kept: int) -> Iterator[None]:
        """Add to what could not be written what is kept, and how to go on."""
        try:
            yield
        except BadInput as error:
            if not kept:
                raise
            pushes = f"the {kept} pushes before are" if kept > 1 else "the push before is"
            raise BadInput(
                f"{error.message}; {pushes} kept, go on with `slipmap explore --resume {self._folder}`"
            ) from error


def resumed(folder: Path) -> tuple[Scenario, LoopOptions, Recorded]:
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
            if digest_of(folder / name) != digest:
                raise BadInput(f"{folder / name}: is not that of the run in {folder / RUN}; begin anew")
        scenario = read_settings(folder / SCENARIO, Scenario)
        told = run["options"]
        options = LoopOptions(**{**told, "effects": tuple(told.get("effects", ()))})
        first = FirstPicture.load(folder / PICTURE)
        grid = first.seen(scenario.camera.intrinsics).grid
        dataset = read_dataset(folder / PUSHES)
        pushes = run["pushes"][: len(dataset.trials)]
        pokes = tuple(_poke_of(push["poke"]) for push in pushes)
        digests = [push["digest"] for push in pushes]
        places = tuple(push["place"] for push in pushes)
    except (ScenarioError, DatasetError) as error:
        raise BadInput(str(error)) from error
    except (OSError, ValueError, KeyError, TypeError, BadZipFile) as error:
        raise BadInput(f"{folder}: the run in it cannot be gone on with ({error}); begin anew") from error
    if digests != [digest_of(folder / PUSHES / trial.name) for trial in dataset.trials]:
        raise BadInput(f"{folder / PUSHES}: holds pushes that are not those of {folder / RUN}; begin anew")
    if not np.array_equal(grid.centers, dataset.grid.centers):
        raise BadInput(f"{folder}: this slipmap cuts the object into other cells than were recorded")
    if places[-1] is not None:
        scenario.object.pose = places[-1]
    return scenario, options, Recorded(dataset.trials, pokes, places, grid, first)


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


def _poke(poke: Poke) -> dict[str, Any]:
    push = {
        "begin": poke.push.begin,
        "end": poke.push.end,
        "speed": poke.push.speed,
        "creep": poke.push.creep,
    }
    return {"push": push, "contact": poke.contact, "direction": poke.direction}


def _poke_of(told: dict[str, Any]) -> Poke:
    return Poke(TablePush(**told["push"]), np.array(told["contact"]), np.array(told["direction"]))
