"""The pushes of a run of the robot's cell, written to its folder while it goes on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, Diagram

from diagrams.console import BadInput
from diagrams.exploration_loop import recorded_dataset
from diagrams.outputs import write_json, writing
from diagrams.recorded import Recorded
from diagrams.run_folder import PUSHES, digests_of, refuse_others_files, write_run
from diagrams.station.scenario import Scenario
from models.measurements import DatasetError
from models.measurements.recording import PushRecorder

UNDER_WAY = "under_way.json"

PREGRASP = "slipmap-pregrasp/1"
"""Format of the `run.json` of `slipmap pregrasp`."""

NOTED = 20
"""Rows of a push under way after which it is written down, at 100 a second."""


class PushRecord:
    """Keeps the pushes of a run as a dataset in its folder, and what is measured of the push under way.

    The latter is no trial, as nobody knows where the object comes to rest; it stays in `under_way.json` where
    the run ends in the midst of a push.

    Args:
        folder: of the run.
        scenario: of the run.
        kept: pushes of this run that are in the folder already.

    Raises:
        BadInput: files that are no part of a dataset stand where it should be.
    """

    def __init__(self, folder: Path, scenario: Scenario, kept: int = 0) -> None:
        self._folder, self._scenario = folder, scenario
        try:
            self._pushes = PushRecorder(folder / PUSHES, kept)
        except DatasetError as error:
            raise BadInput(str(error)) from error

    def keep(self, recorded: Recorded) -> None:
        """Write the pushes that are not there yet.

        Raises:
            BadInput: the disk is full or the place not writable; names the file, and what to do.
        """
        try:
            self._pushes.keep(recorded_dataset(recorded.trials, recorded.grid, self._scenario))
        except OSError as error:
            with writing(Path(error.filename)):
                raise
        (self._folder / UNDER_WAY).unlink(missing_ok=True)

    def note(self, push: int, rows: dict[str, Any]) -> None:
        """Write down what is measured so far of the push under way.

        Args:
            push: its number.
            rows: of each channel, as in a trial's file but with the run's time.

        Raises:
            BadInput: as `keep`.
        """
        write_json(self._folder / UNDER_WAY, {"push": push, **rows})


class PregraspRecord(PushRecord):
    """Keeps a folder of `slipmap pregrasp` in step with the run, which cannot be gone on with.

    Args:
        folder, scenario: as in `PushRecord`.

    Raises:
        BadInput: pushes are there that no earlier run of the command left, or of one that was cut off.
    """

    def __init__(self, folder: Path, scenario: Scenario) -> None:
        super().__init__(folder, scenario)
        refuse_others_files(folder, PREGRASP, "slipmap pregrasp")
        self._run: dict[str, Any] | None = None

    def keep(self, recorded: Recorded) -> None:
        """See `PushRecord.keep`."""
        pushes = [{"digest": digest} for digest in digests_of(recorded.trials)]
        self._run = {"format": PREGRASP, "ended": False, "pushes": pushes}
        write_run(self._folder, self._run)
        super().keep(recorded)

    def end(self) -> None:
        """Say that the run came to its end, for better or worse: it may be replaced by another."""
        if self._run is not None:
            self._run["ended"] = True
            write_run(self._folder, self._run)


class Recording:
    """Has what a loop records written down, as soon as it is there.

    Args:
        loop: that runs.
        record: where it goes.
        before: pushes that are kept already.
    """

    def __init__(self, loop: Diagram, record: PushRecord, before: Recorded | None = None) -> None:
        self._loop, self._record = loop, record
        self._pokes = () if before is None else before.pokes
        self._places = () if before is None else before.places
        self._noted = 0

    def look(self, root: Context) -> None:
        """Write down what is new; to be called often.

        Raises:
            BadInput: see `PushRecord.keep`.
        """
        trials = self._said("logger", "records", root)
        if len(trials) > len(self._pokes):
            request = self._said("exploration", "poke", root)
            self._pokes = (*self._pokes, request.poke)
            self._places = (*self._places, self._place(root))
            grid, first = (self._said("perception", name, root) for name in ("cell_grid", "first_picture"))
            self._record.keep(Recorded(trials, self._pokes, self._places, grid, first))
            self._noted = 0
            return
        rows = self._said("logger", "under_way", root)
        measured = len(rows["tip_pose"])
        if measured < self._noted:
            self._noted = 0
        if measured >= self._noted + NOTED:
            self._noted = measured
            self._record.note(len(trials), rows)

    def _place(self, root: Context) -> list[float] | None:
        """x and y (m) and turn (degrees) of the simulated object."""
        if not self._loop.GetSubsystemByName("station").HasOutputPort("truth.object_pose"):
            return None
        X_WO = self._said("station", "truth.object_pose", root)
        x_axis = X_WO.rotation().matrix()[:, 0]
        turn = np.degrees(np.arctan2(x_axis[1], x_axis[0]))
        return [float(value) for value in (*X_WO.translation()[:2], turn)]

    def _said(self, system: str, port: str, root: Context) -> Any:
        block = self._loop.GetSubsystemByName(system)
        return block.GetOutputPort(port).Eval(block.GetMyContextFromRoot(root))
