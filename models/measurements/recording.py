"""Writing a dataset push by push, while it is recorded."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

from models.measurements.push_dataset import PushDataset
from models.measurements.push_format import DESCRIPTION_FILE
from models.measurements.writing import description_text, is_replaced, trial_text, write_dataset


class PushRecorder:
    """Keeps a folder in step with a recording that grows.

    At every moment, also when the process is killed in the midst of it, the folder is a dataset that opens
    and holds every push that `keep` has returned from. A trial's file is written to a temporary name, synced
    to the disk and renamed; the dataset's description, which names the trials, follows in the same way.

    Args:
        folder: of the dataset; its parent exists. A push dataset of an earlier run that is there already
            goes when the first push is kept, and stays until then.
        kept: trials of this recording that are in the folder already.

    Raises:
        DatasetError: anything else stands there.
    """

    def __init__(self, folder: Path, kept: int = 0) -> None:
        self._folder = Path(folder).resolve()
        self._replaces = kept == 0 and is_replaced(self._folder, overwrite=True)
        self._kept = kept

    def keep(self, dataset: PushDataset) -> None:
        """Write the trials that are not in the folder yet.

        Args:
            dataset: with all trials so far, named trials/000.json and on.

        Raises:
            OSError: the disk is full or the place not writable; `filename` is the file's. What was kept
                before is still there and opens.
        """
        if self._kept == 0 and dataset.trials:
            self._begin(dataset)
        for number in range(self._kept, len(dataset.trials)):
            trial = dataset.trials[number]
            self._write(self._folder / trial.name, trial_text(trial))
            whole = replace(dataset, trials=dataset.trials[: number + 1])
            text = description_text(whole, [trial.name for trial in whole.trials])
            self._write(self._folder / DESCRIPTION_FILE, text)
            self._kept = number + 1

    def _begin(self, dataset: PushDataset) -> None:
        """The folder with the first trial, in one step; one of an earlier run is gone after it."""
        first = replace(dataset, trials=dataset.trials[:1])
        old = self._folder.with_name(f".{self._folder.name}.old")
        if self._replaces:
            shutil.rmtree(old, ignore_errors=True)
            os.replace(self._folder, old)
        try:
            write_dataset(first, self._folder)
        except OSError as error:
            if self._replaces:
                os.replace(old, self._folder)
            raise OSError(error.errno, error.strerror, str(self._folder / first.trials[0].name)) from error
        shutil.rmtree(old, ignore_errors=True)
        self._kept = 1

    def _write(self, path: Path, text: str) -> None:
        # Beside the folder, not in it: what a killed process leaves there would be no part of the dataset.
        part = self._folder.with_name(f".{self._folder.name}.part")
        try:
            with open(part, "w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            path.parent.mkdir(exist_ok=True)
            os.replace(part, path)
        except OSError as error:
            part.unlink(missing_ok=True)
            raise OSError(error.errno, error.strerror, str(path)) from error
