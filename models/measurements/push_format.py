"""Reading a folder of the format push-dataset/1: a dataset.yaml and one JSON file a push."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

from slipmap.models.measurements import parsing
from slipmap.models.measurements.parsing import Fingerprint
from slipmap.models.measurements.push_dataset import CHANNELS, DatasetError, PushDataset, Role, Setup, Trial
from slipmap.models.measurements.setup_description import SETUP_KEYS, parse_setup
from slipmap.models.measurements.trial_checks import check_trials
from slipmap.models.measurements.trial_tables import json_tables, trial_from_tables

FORMAT = "push-dataset/1"
DESCRIPTION_FILE = "dataset.yaml"
Progress = Callable[[int, int], None]


def read_push_format(description: Path, progress: Progress | None = None) -> PushDataset:
    """Dataset of a description file and the trials that it lists.

    Args:
        description: the dataset.yaml; trial files are looked up beside it and never outside its folder.
        progress: called with the number of trials read and the number of all trials.

    Raises:
        DatasetError: see `parse_setup`, `trial_from_tables` and `check_trials` for what is refused.
    """
    where = str(description)
    content, document = parsing.read_yaml(description, where)
    check_format(document, where)
    setup, warnings = parse_setup(document, where, default_name=description.resolve().parent.name)
    warnings += parsing.unknown_keys(document, ("format", "trials", *SETUP_KEYS), where)
    fingerprint = Fingerprint()
    fingerprint.add(DESCRIPTION_FILE, content)
    entries = _entries(document, description.parent, where, warnings)
    trials = []
    for index, (name, role) in enumerate(entries):
        path = description.parent / name
        record = parsing.read_bytes(path)
        fingerprint.add(name, record)
        arrays = parsing.mapping(parsing.parse_json(record, str(path)), str(path))
        trial, doubts = trial_from_tables(name, role, json_tables(arrays, str(path)), str(path))
        trials.append(trial)
        warnings += [*parsing.unknown_keys(arrays, CHANNELS, str(path)), *doubts]
        if progress is not None:
            progress(index + 1, len(entries))
    return assembled(setup, trials, fingerprint, warnings, where)


def check_format(document: dict[str, Any], where: str) -> None:
    """Refuse a description whose `format` is missing or of another kind.

    Raises:
        DatasetError: with the format that this project reads.
    """
    found = parsing.required(document, "format", where, f"a push dataset says `format: {FORMAT}`")
    if found != FORMAT:
        raise DatasetError(f"{where}: format is {parsing.shown(found)}; only {FORMAT} can be read")


def assembled(
    setup: Setup, trials: list[Trial], fingerprint: Fingerprint, warnings: list[str], where: str
) -> PushDataset:
    """Dataset of its parts, after the checks that need all of them.

    Raises:
        DatasetError: see `check_trials`.
    """
    warnings = warnings + check_trials(setup, trials, where)
    return PushDataset(
        **vars(setup), trials=tuple(trials), fingerprint=fingerprint.hexdigest(), warnings=tuple(warnings)
    )


def _entries(
    document: dict[str, Any], folder: Path, where: str, warnings: list[str]
) -> list[tuple[str, Role]]:
    listed = parsing.required(
        document, "trials", where, "list the trials, [{file: trials/000.json, role: fit}]"
    )
    if not isinstance(listed, list) or not listed:
        raise DatasetError(
            f"{where}: trials must be a list of one or more entries, got {parsing.shown(listed)}"
        )
    entries: list[tuple[str, Role]] = []
    files: dict[Path, int] = {}
    for row, value in enumerate(listed):
        place = f"{where}: trials, row {row}"
        entry = parsing.section(value, ("file", "role"), place, warnings)
        name = parsing.text(parsing.required(entry, "file", place, "name the trial's file"), f"{place}: file")
        role = entry.get("role", "fit")
        if role not in get_args(Role):
            raise DatasetError(f"{place}: role must be fit or heldout, got {parsing.shown(role)}")
        file = _inside(folder, name, place)
        if file in files:
            raise DatasetError(f"{place}: {name} is listed twice (first in row {files[file]}); list it once")
        files[file] = row
        entries.append((name, role))
    return entries


def _inside(folder: Path, name: str, where: str) -> Path:
    """The resolved path of a file named relative to a folder; it must not lie outside, by a link either."""
    try:
        path = (folder / name).resolve()
        root = folder.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise DatasetError(f"{where}: {parsing.shown(name)} is no usable file name ({error})") from None
    if Path(name).is_absolute() or not path.is_relative_to(root):
        raise DatasetError(
            f"{where}: {parsing.shown(name)} lies outside the dataset's folder; trial files belong inside it"
        )
    return path
