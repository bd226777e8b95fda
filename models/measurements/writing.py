"""Write a dataset as a folder of the format push-dataset/1, at once or push by push, always atomically."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
import yaml

from slipmap.models.files import part_of, remove_part, replaced_file, replaced_folder
from slipmap.models.measurements.parsing import read_yaml
from slipmap.models.measurements.push_dataset import PushDataset
from slipmap.models.measurements.reading import DESCRIPTION_FILE, FORMAT, check_format, was_imported
from slipmap.models.measurements.setup_description import parse_setup, setup_document
from slipmap.models.measurements.trial import Channel, DatasetError, Trial
from slipmap.models.physics.cell_grid import CellGrid


def write_dataset(dataset: PushDataset, folder: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write `dataset` so that reading it gives the same numbers to the last bit.

    All files are written to a folder beside the target, which is then renamed: a reader finds the old
    dataset, the new one or none, never half of one. Trials keep their names if those are relative JSON files;
    otherwise all are numbered trials/000.json and so on.

    Args:
        folder: the target; its parents are created.
        overwrite: replace an existing push dataset. The folder may contain only the files of that dataset,
            since everything in it is deleted.

    Returns:
        The folder.

    Raises:
        DatasetError: the target is a file, a dataset while `overwrite` is not set, or another folder; or the
            description is one that a file must not contain, such as a gravity of 9810 m/s².
        OSError: the disk is full or not writable; nothing is left behind.

    Example:
        >>> import slipmap, tempfile
        >>> place = tempfile.TemporaryDirectory()
        >>> path = slipmap.write_dataset(slipmap.simulated_hammer(fit=2)[0], place.name + "/pushes")
        >>> sorted(file.name for file in path.iterdir())
        ['dataset.yaml', 'trials']
    """
    target = Path(folder).resolve()
    is_replaced(target, overwrite)
    parse_setup(setup_document(dataset), f"dataset {dataset.name}", dataset.name)
    with replaced_folder(target) as fresh:
        _write_files(dataset, fresh)
    return target


def is_replaced(target: Path, overwrite: bool) -> bool:
    """Whether there is a dataset at the target that may be replaced. Raises DatasetError as
    `write_dataset`."""
    if not target.exists():
        return False
    if not target.is_dir():
        raise DatasetError(
            f"{target}: this is a file, not a folder; choose another name for the dataset's folder"
        )
    present = {path.relative_to(target).as_posix() for path in target.rglob("*") if not path.is_dir()}
    if not present:
        return any(target.iterdir())
    if DESCRIPTION_FILE not in present:
        raise DatasetError(
            f"{target}: the folder contains other files and is not a push dataset; choose another one"
        )
    where = str(target / DESCRIPTION_FILE)
    _, document = read_yaml(target / DESCRIPTION_FILE, where)
    check_format(document, where)
    if not overwrite:
        raise DatasetError(
            f"{target}: there is already a push dataset here; choose another folder or allow overwriting"
        )
    listed = document.get("trials")
    entries = [entry for entry in listed if isinstance(entry, dict)] if isinstance(listed, list) else []
    own = {DESCRIPTION_FILE} | {str(PurePosixPath(str(entry.get("file")))) for entry in entries}
    foreign = sorted(present - own)
    if foreign:
        raise DatasetError(
            f"{target}: {foreign[0]} is not part of the dataset there and would be lost; move it away first"
        )
    return True


def is_imported(folder: Path) -> bool:
    """Whether the dataset in a folder says that it was imported, so that importing again restores it."""
    where = folder / DESCRIPTION_FILE
    told = read_yaml(where, str(where))[1].get("provenance")
    return isinstance(told, list) and was_imported(map(str, told))


def _write_files(dataset: PushDataset, folder: Path) -> None:
    names = _file_names(dataset.trials)
    folder.mkdir()
    for name, trial in zip(names, dataset.trials, strict=True):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(trial_text(trial), encoding="utf-8")
    (folder / DESCRIPTION_FILE).write_text(_description_text(dataset, names), encoding="utf-8")


def trial_text(trial: Trial) -> str:
    """The content of a trial's file."""
    record = {name: _rows(channel, trial.tip_angle) for name, channel in trial.channels.items()}
    return json.dumps(record, separators=(",", ":"), allow_nan=False)


def _rows(channel: Channel, tip_angle: Channel | None) -> list[list[float]]:
    """Rows of four columns; the angle of a tip that does not turn is 0."""
    missing = np.zeros((len(channel.time), 3 - channel.values.shape[1]))
    if missing.size and tip_angle is not None:
        missing = tip_angle.at(channel.time)
    return np.column_stack([channel.time, channel.values, missing]).tolist()


def _description_text(dataset: PushDataset, names: list[str]) -> str:
    """The dataset.yaml of a dataset whose trials have these names."""
    trials = [
        {"file": name, "role": trial.role}
        | ({"keep": True} if trial.kept else {})
        | ({} if trial.order == place else {"order": trial.order})
        for place, (name, trial) in enumerate(zip(names, dataset.trials, strict=True))
    ]
    told = {"provenance": list(dataset.provenance)} if dataset.provenance else {}
    return yaml.dump(
        {"format": FORMAT, **setup_document(dataset), **told, "trials": trials}, Dumper=_Dumper,
        sort_keys=False, allow_unicode=True, default_flow_style=None, width=110,
    )  # fmt: skip


class _Dumper(yaml.SafeDumper):
    """Dumper that escapes the line breaks that YAML knows besides those of ASCII; quoted, they read as
    blanks."""

    def represent_text(self, text: str) -> yaml.ScalarNode:
        style = '"' if any(sign in text for sign in "\x85\u2028\u2029") else None
        return self.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _Dumper.represent_text)


def _file_names(trials: tuple[Trial, ...]) -> list[str]:
    names = [trial.name for trial in trials]
    usable = all(
        name == str(PurePosixPath(name)) and name.endswith(".json") and name.isprintable()
        and not PurePosixPath(name).is_absolute() and ".." not in PurePosixPath(name).parts
        and "\\" not in name and all(len(part.encode()) <= 255 for part in PurePosixPath(name).parts)
        for name in names
    )  # fmt: skip
    return names if usable else [f"trials/{index:03d}.json" for index in range(len(trials))]


class PushRecorder:
    """Keep a folder in step with a growing recording.

    At any moment, even if the process is killed while writing, the folder is a readable dataset with every
    push for which `keep` has returned. A trial's file is written under a temporary name, synced to the disk
    and renamed; the dataset's description, which names the trials, follows in the same way.

    Args:
        folder: of the dataset; its parent exists. An existing push dataset of an earlier run stays until
            `clear`, or until the first push is kept, which replaces it.
        kept: number of trials of this recording that are already in the folder.

    Raises:
        DatasetError: the folder contains anything else.
    """

    def __init__(self, folder: Path, kept: int = 0) -> None:
        self._folder = Path(folder).resolve()
        self._replaces = kept == 0 and is_replaced(self._folder, overwrite=True)
        self._kept = kept
        self._grid: CellGrid | None = None  # as described in the folder

    def clear(self) -> None:
        """Remove the pushes of an earlier run, in one step, before anything else tells of this recording.

        Raises:
            OSError: the folder is not writable.
        """
        if self._replaces:
            old = part_of(self._folder)
            os.replace(self._folder, old)
            remove_part(old)
            self._replaces = False

    def keep(self, dataset: PushDataset) -> None:
        """Write the trials that are not yet in the folder, and the description if the object has changed.

        Args:
            dataset: with all trials so far, named trials/000.json and so on.

        Raises:
            OSError: the disk is full or not writable; `filename` is the file's. What was kept before is still
                there and readable.
        """
        if self._kept == 0 and dataset.trials:
            self._begin(replace(dataset, trials=dataset.trials[:1]))
        for number in range(self._kept, len(dataset.trials)):
            trial = dataset.trials[number]
            self._write(self._folder / trial.name, trial_text(trial))
            self._describe(replace(dataset, trials=dataset.trials[: number + 1]))
            self._kept = number + 1
        if dataset.grid is not self._grid:
            self._describe(dataset)

    def _begin(self, first: PushDataset) -> None:
        """Create the folder with the first trial in one step, replacing that of an earlier run."""
        if not self._replaces:
            is_replaced(self._folder, overwrite=False)
        path = self._folder / first.trials[0].name
        with _naming(path), replaced_folder(self._folder) as fresh:
            _write_files(first, fresh)
        self._kept, self._grid = 1, first.grid

    def _describe(self, dataset: PushDataset) -> None:
        text = _description_text(dataset, [trial.name for trial in dataset.trials])
        self._write(self._folder / DESCRIPTION_FILE, text)
        self._grid = dataset.grid

    def _write(self, path: Path, text: str) -> None:
        # Beside the folder, not in it: leftovers of a killed process would not belong to the dataset.
        part = part_of(self._folder)
        with _naming(path), replaced_file(path, part):
            with open(part, "w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            path.parent.mkdir(exist_ok=True)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Make a system error name this file."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
