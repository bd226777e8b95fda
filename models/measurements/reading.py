"""One entrance to every kind of push measurements."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

from slipmap.models.measurements import parsing
from slipmap.models.measurements.csv_files import (
    CSV_ENDINGS,
    STANDARD,
    CsvColumns,
    parse_columns,
    read_csv_trial,
)
from slipmap.models.measurements.mit_files import (
    FINGER_RADIUS,
    HDF5_ENDINGS,
    JSON_ENDINGS,
    MIT_SHAPES,
    THICKNESS,
    mit_shape,
    named_shape,
    read_mit_trial,
    surface_warnings,
)
from slipmap.models.measurements.parsing import Fingerprint
from slipmap.models.measurements.push_dataset import DatasetError, PushDataset, Role, Setup, Trial
from slipmap.models.measurements.push_format import DESCRIPTION_FILE, Progress, assembled, read_push_format
from slipmap.models.measurements.setup_description import SETUP_KEYS, parse_setup

_YAML_ENDINGS = (".yaml", ".yml")
_MIT_ENDINGS = JSON_ENDINGS + HDF5_ENDINGS
_HELDOUT_SHARE = 4
_KINDS = (
    "a push dataset (a folder with a dataset.yaml), MIT push files (.json, .h5, .hdf5) or CSV files (.csv)"
)


def read_dataset(
    path: str | os.PathLike[str], *, object_name: str | None = None, progress: Progress | None = None
) -> PushDataset:
    """Read push measurements.

    Three kinds are told apart by what lies at `path`:

    - a folder with a `dataset.yaml`, or that file: format push-dataset/1;
    - JSON or HDF5 files of the MIT push dataset, one or a folder of them. They store the force of the object
      on the finger, so all three columns are negated. The object is taken from `shape=...` in the file names;
    - CSV files, one or a folder of them; see `csv_files` for the columns. The force is that of the finger on
      the object already.

    MIT and CSV files say nothing of roles: in sorted order the last quarter (rounded down) is heldout.

    Args:
        path: folder or file.
        object_name: what was pushed, for MIT and CSV files: a shape of the MIT dataset (rect1, hex, ...; with
            its mass and the 4.75 mm finger) or a YAML file with the keys object, finger and, if wanted, name,
            description, table, gravity, noise of a dataset.yaml, and csv, see `parse_columns`.
        progress: called after each trial with the number read and the number of all.

    Raises:
        DatasetError: for every fault in the files, naming file, trial and row.
    """
    try:
        return _read(Path(path), object_name, progress)
    except OSError as error:
        raise DatasetError(f"{str(path)!r} cannot be read ({error})") from None


def _read(source: Path, object_name: str | None, progress: Progress | None) -> PushDataset:
    if not source.exists():
        raise DatasetError(f"{str(source)!r}: there is no such file or folder; wanted is {_KINDS}")
    is_folder = source.is_dir()
    description = source / DESCRIPTION_FILE if is_folder else source
    if (is_folder and description.exists()) or (not is_folder and _is(source, _YAML_ENDINGS)):
        if object_name is not None:
            raise DatasetError(
                f"{description}: a push dataset describes its object itself; name none beside it"
            )
        return read_push_format(description, progress)
    files = _record_files(source) if is_folder else [source]
    fingerprint = Fingerprint()
    read_trial: Callable[[Path, Role, Fingerprint], tuple[Trial, list[str]]]
    if _is(files[0], CSV_ENDINGS):
        setup, warnings, columns = _setup(object_name, None, source, fingerprint)
        read_trial = partial(read_csv_trial, columns=columns)
    elif _is(files[0], _MIT_ENDINGS):
        _refuse_part_of_a_dataset(files[0])
        setup, warnings, _ = _setup(object_name, named_shape(files), source, fingerprint)
        warnings += surface_warnings(files)
        read_trial = read_mit_trial
    else:
        raise DatasetError(f"{source}: a file of another kind; wanted is {_KINDS}")
    trials = []
    for index, (file, role) in enumerate(zip(files, _roles(len(files)), strict=True)):
        trial, doubts = read_trial(file, role, fingerprint)
        trials.append(trial)
        warnings += doubts
        if progress is not None:
            progress(index + 1, len(files))
    return assembled(setup, trials, fingerprint, warnings, str(source))


def _is(file: Path, endings: tuple[str, ...]) -> bool:
    return file.suffix.lower() in endings


def _record_files(folder: Path) -> list[Path]:
    files = sorted(
        file
        for file in folder.iterdir()
        if _is(file, _MIT_ENDINGS + CSV_ENDINGS) and not file.name.startswith(".")
    )
    if not files:
        raise DatasetError(f"{folder}: holds no measurements; wanted is {_KINDS}")
    if len({_is(file, CSV_ENDINGS) for file in files}) > 1:
        raise DatasetError(
            f"{folder}: holds both CSV and MIT push files; put each kind into a folder of its own"
        )
    return files


def _refuse_part_of_a_dataset(file: Path) -> None:
    for folder in file.resolve().parents[:2]:
        if (folder / DESCRIPTION_FILE).exists():
            raise DatasetError(
                f"{file}: belongs to the push dataset {folder}, where forces have the opposite sign of MIT"
                " files; read that folder instead"
            )


def _roles(count: int) -> list[Role]:
    heldout = count // _HELDOUT_SHARE
    fit: list[Role] = ["fit"] * (count - heldout)
    return fit + ["heldout"] * heldout


def _setup(
    object_name: str | None, named: str | None, source: Path, fingerprint: Fingerprint
) -> tuple[Setup, list[str], CsvColumns]:
    """Setup of a named shape or of a YAML file, warnings, and columns of CSV files.

    `named` is what the measurements' own names say.
    """
    chosen = object_name or named
    if chosen is None:
        raise DatasetError(
            f"{source}: says nothing of the object that was pushed; name with --object (in Python"
            f" object_name) a shape of the MIT dataset ({', '.join(sorted(MIT_SHAPES))}) or a YAML file with"
            f" the keys object and finger of a {DESCRIPTION_FILE}"
        )
    file = Path(chosen)
    if chosen not in MIT_SHAPES and _is(file, _YAML_ENDINGS):
        content, document = parsing.read_yaml(file, chosen)
        fingerprint.add("object", content)
        setup, warnings = parse_setup(document, chosen, default_name=source.stem)
        warnings += parsing.unknown_keys(document, ("format", "trials", "csv", *SETUP_KEYS), chosen)
        return setup, warnings, parse_columns(document.get("csv"), f"{chosen}: csv")
    shape = mit_shape(chosen, str(source))
    if named is not None and named != chosen:
        raise DatasetError(
            f"{source}: the file names say shape={named}, not {chosen}; leave the object's name out"
        )
    fingerprint.add("object", chosen.encode())
    document = {
        "description": f"Pushes of {chosen} of the MIT push dataset (Yu et al. 2016)",
        "object": {"outline": shape.outline.tolist(), "height": THICKNESS, "mass": shape.mass},
        "finger": {"radius": FINGER_RADIUS},
    }
    return *parse_setup(document, str(source), default_name=source.stem), STANDARD
