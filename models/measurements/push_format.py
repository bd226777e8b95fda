"""Reading a folder of the format push-dataset/1: a dataset.yaml and one JSON file a push."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

from models.measurements import fields
from models.measurements.checks import check_trials
from models.measurements.files import LARGEST_YAML, Fingerprint, parse_json, parse_yaml, read_bytes
from models.measurements.push_dataset import DatasetError, PushDataset, Role, Trial
from models.measurements.setup_description import SETUP_KEYS, Setup, parse_setup
from models.measurements.trial_channels import COLUMNS, trial_from_tables

FORMAT = "push-dataset/1"
DESCRIPTION_FILE = "dataset.yaml"
Progress = Callable[[int, int], None]


def read_push_format(description: Path, progress: Progress | None = None) -> PushDataset:
    """Dataset of a description file and the trials that it lists.

    Args:
        description: the dataset.yaml; trial files are looked up beside it and never outside its folder.
        progress: called with the number of trials read and the number of all trials.

    Raises:
        DatasetError: see `checks`, `setup_description` and `trial_channels` for what is refused.
    """
    where = str(description)
    content = read_bytes(description, LARGEST_YAML)
    document = fields.mapping(parse_yaml(content, where), where)
    check_format(document, where)
    setup = parse_setup(document, where, default_name=description.resolve().parent.name)
    warnings = fields.unknown_keys(document, ("format", "trials", *SETUP_KEYS), where)
    fingerprint = Fingerprint()
    fingerprint.add(DESCRIPTION_FILE, content)
    entries = _entries(document, description.parent, where, warnings)
    trials = []
    for index, (name, role) in enumerate(entries):
        path = description.parent / name
        record = read_bytes(path)
        fingerprint.add(name, record)
        trial, doubts = _trial(name, role, parse_json(record, str(path)), str(path))
        trials.append(trial)
        warnings += doubts
        if progress is not None:
            progress(index + 1, len(entries))
    return assembled(setup, trials, fingerprint, warnings, where)


def check_format(document: dict[str, Any], where: str) -> None:
    """Refuse a description whose `format` is missing or of another kind.

    Raises:
        DatasetError: with the format that this project reads.
    """
    found = fields.required(document, "format", where, f"a push dataset says `format: {FORMAT}`")
    if found != FORMAT:
        raise DatasetError(f"{where}: format is {fields.shown(found)}; only {FORMAT} can be read")


def assembled(
    setup: Setup, trials: list[Trial], fingerprint: Fingerprint, warnings: list[str], where: str
) -> PushDataset:
    """Dataset of its parts, after the checks that need all of them.

    Raises:
        DatasetError: see `checks.check_trials`.
    """
    found = check_trials(setup, trials, where)
    return PushDataset(
        name=setup.name,
        description=setup.description,
        grid=setup.grid,
        height=setup.height,
        mass=setup.mass,
        finger_radius=setup.finger_radius,
        table=setup.table,
        gravity=setup.gravity,
        noise=setup.noise,
        trials=tuple(trials),
        fingerprint=fingerprint.hexdigest(),
        warnings=(*setup.warnings, *warnings, *found),
    )


def _entries(
    document: dict[str, Any], folder: Path, where: str, warnings: list[str]
) -> list[tuple[str, Role]]:
    listed = fields.required(
        document, "trials", where, "list the trials, [{file: trials/000.json, role: fit}]"
    )
    if not isinstance(listed, list) or not listed:
        raise DatasetError(
            f"{where}: trials must be a list of one or more entries, got {fields.shown(listed)}"
        )
    entries: list[tuple[str, Role]] = []
    files: dict[Path, int] = {}
    for row, value in enumerate(listed):
        place = f"{where}: trials, row {row}"
        entry = fields.mapping(value, place)
        warnings += fields.unknown_keys(entry, ("file", "role"), place)
        name = fields.text(fields.required(entry, "file", place, "name the trial's file"), f"{place}: file")
        role = entry.get("role", "fit")
        if role not in get_args(Role):
            raise DatasetError(f"{place}: role must be fit or heldout, got {fields.shown(role)}")
        file = inside(folder, name, place)
        if file in files:
            raise DatasetError(f"{place}: {name} is listed twice (first in row {files[file]}); list it once")
        files[file] = row
        entries.append((name, role))
    return entries


def inside(folder: Path, name: str, where: str) -> Path:
    """The resolved path of a file named relative to a folder that it must not leave.

    Raises:
        DatasetError: an absolute name, one that climbs out of the folder, or a link that leads out.
    """
    try:
        path = (folder / name).resolve()
        root = folder.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise DatasetError(f"{where}: {fields.shown(name)} is no usable file name ({error})") from None
    if Path(name).is_absolute() or not path.is_relative_to(root):
        raise DatasetError(
            f"{where}: {fields.shown(name)} lies outside the dataset's folder; trial files belong inside it"
        )
    return path


def _trial(name: str, role: Role, record: object, where: str) -> tuple[Trial, list[str]]:
    arrays = fields.mapping(record, where)
    tables = {
        key: fields.table(arrays[key], columns, f"{where}, {key}")
        for key, columns in COLUMNS.items()
        if arrays.get(key) is not None
    }
    trial, warnings = trial_from_tables(name, role, tables, where)
    return trial, fields.unknown_keys(arrays, COLUMNS, where) + warnings
