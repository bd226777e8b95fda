"""Reading a folder of the format push-dataset/1: a dataset.yaml and one JSON file a push."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from slipmap.models.measurements import fields
from slipmap.models.measurements.files import LARGEST_YAML, Fingerprint, parse_json, parse_yaml, read_bytes
from slipmap.models.measurements.push_dataset import Channel, DatasetError, PushDataset, Role, Trial
from slipmap.models.measurements.setup_description import SETUP_KEYS, Setup, parse_setup
from slipmap.models.measurements.trial_checks import check_trials
from slipmap.models.physics.cell_grid import FloatArray

# Tables of rows, as files hold them, turned into the channels of a trial.


COLUMNS: Mapping[str, int] = {"object_pose": 4, "tip_pose": 4, "ft_wrench": 4}
LARGEST_VALUE = 1e6  # m, rad, N
LARGEST_TIME = 1e11  # s; Unix time in ms or ns lies above
LONGEST_PUSH = 1000.0  # s
SHORTEST_STEP = 1e-9  # s
WHOLE_TURN = 2.0 * np.pi


def trial_from_tables(
    name: str, role: Role, tables: Mapping[str, FloatArray], where: str
) -> tuple[Trial, list[str]]:
    """Trial of the tables `object_pose`, `tip_pose` and, where measured, `ft_wrench`.

    Rows in which a used column is NaN are dropped; theta is unwrapped over the rest. An empty `ft_wrench`
    counts as not measured.

    Args:
        name: of the trial.
        role: 'fit' or 'heldout'.
        tables: rows (T, 4) of t, x, y, theta or t, fx, fy, tau; the theta of the tip is not used.
        where: the file, for error texts.

    Returns:
        The trial and what looks wrong about it.

    Raises:
        DatasetError: missing or empty tables, infinite or absurd numbers, time that does not increase.
    """
    for required in ("object_pose", "tip_pose"):
        if required not in tables:
            raise DatasetError(f"{where}: `{required}` is missing; a trial needs object_pose and tip_pose")
    pose = _channel(tables["object_pose"], 3, f"{where}, object_pose")
    warnings = _degrees(pose, where)
    pose = Channel(pose.time, np.column_stack([pose.values[:, :2], unwrapped(pose.values[:, 2])]))
    tip = _channel(tables["tip_pose"], 2, f"{where}, tip_pose")
    lasts = float(pose.time[-1] - pose.time[0])
    if lasts > LONGEST_PUSH:
        raise DatasetError(
            f"{where}, object_pose: lasts {lasts:.6g} s, the longest push may last {LONGEST_PUSH:g} s;"
            " times are in s, were these milliseconds? Cut a long recording into its pushes"
        )
    wrench = None
    if len(tables.get("ft_wrench", ())):
        wrench = _channel(tables["ft_wrench"], 3, f"{where}, ft_wrench")
    if len(pose.time) < 2:
        raise DatasetError(f"{where}, object_pose: one usable row; a trial needs a first and a last pose")
    return Trial(name, role, pose, tip, wrench), warnings


def unwrapped(angle: FloatArray) -> FloatArray:
    """(T,) angle without jumps of whole turns; unwrapping twice changes nothing."""
    step = np.diff(angle)
    turns = np.where(np.abs(step) > np.pi + 1e-9, np.round(step / WHOLE_TURN), 0.0)
    result = angle.copy()
    result[1:] -= WHOLE_TURN * np.cumsum(turns)
    return result


def _channel(rows: FloatArray, columns: int, where: str) -> Channel:
    rows = rows[:, : columns + 1]
    if len(rows) == 0:
        raise DatasetError(f"{where}: has no rows; the trial is empty, take it out of the dataset")
    _refuse(np.isinf(rows), rows, where, "is infinite; write NaN where a sensor dropped out")
    largest = np.array([LARGEST_TIME] + columns * [LARGEST_VALUE])
    _refuse(np.abs(rows) > largest, rows, where, "is too large for s, m, rad, N; check the units")
    kept = np.flatnonzero(np.isfinite(rows).all(axis=1))
    if len(kept) == 0:
        raise DatasetError(
            f"{where}: every row holds NaN; nothing was measured, take the trial or channel out"
        )
    time = rows[kept, 0]
    late = np.flatnonzero(np.diff(time) < SHORTEST_STEP)
    if len(late):
        before, row = kept[late[0]], kept[late[0] + 1]
        what = "goes back behind" if time[late[0] + 1] < time[late[0]] else "repeats"
        raise DatasetError(
            f"{where}, row {row}: time {time[late[0] + 1]} s {what} that of row {before}, {time[late[0]]} s;"
            " sort the rows and leave repeated ones out"
        )
    return Channel(time, rows[kept, 1:])


def _refuse(bad: NDArray[np.bool_], rows: FloatArray, where: str, complaint: str) -> None:
    found = np.flatnonzero(bad.any(axis=1))
    if len(found):
        values = ", ".join(f"{value:g}" for value in rows[found[0]])
        raise DatasetError(f"{where}, row {found[0]}: a number in [{values}] {complaint}")


def _degrees(pose: Channel, where: str) -> list[str]:
    """Raw theta beyond two turns, or turning by more than one where the object hardly moves."""
    theta = pose.values[:, 2]
    path = float(np.sum(np.hypot(*np.diff(pose.values[:, :2], axis=0).T)))
    swept = float(np.ptp(theta))
    if np.max(np.abs(theta)) > 2.0 * WHOLE_TURN or (swept > 1.05 * WHOLE_TURN and path < 1.0):
        return [
            f"{where}, object_pose: theta runs from {theta.min():.3g} to {theta.max():.3g} while the object"
            f" moves {path:.2g} m; angles are in rad, were these degrees?"
        ]
    return []


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
