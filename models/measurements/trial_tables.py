"""Tables of rows, as files hold them, turned into the channels of a trial."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slipmap.models.measurements import parsing
from slipmap.models.measurements.push_dataset import CHANNELS, Channel, DatasetError, Role, Trial
from slipmap.models.physics.cell_grid import FloatArray

COLUMNS = 4
"""Of every table: t, x, y, theta or t, fx, fy, tau."""

_LARGEST_VALUE = 1e6  # m, rad, N
_LARGEST_TIME = 1e11  # s; Unix time in ms or ns lies above
_LONGEST_PUSH = 1000.0  # s
_SHORTEST_STEP = 1e-9  # s
_WHOLE_TURN = 2.0 * np.pi


def json_tables(record: Mapping[str, Any], where: str) -> dict[str, FloatArray]:
    """The tables in a trial's JSON file, by channel.

    Raises:
        DatasetError: a table that is none of numbers; names the row.
    """
    return {
        channel: parsing.table(record[channel], COLUMNS, f"{where}, {channel}")
        for channel in CHANNELS
        if record.get(channel) is not None
    }


def trial_from_tables(
    name: str, role: Role, tables: Mapping[str, FloatArray], where: str
) -> tuple[Trial, list[str]]:
    """Trial of the tables `object_pose`, `tip_pose` and, where measured, `ft_wrench`.

    Rows in which a used column is NaN are dropped; theta is unwrapped over the rest. An empty `ft_wrench`
    counts as not measured.

    Args:
        name: of the trial.
        role: of the trial.
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
    pose = _channel(tables, "object_pose", where)
    warnings = _degrees(pose, where)
    pose = Channel(pose.time, np.column_stack([pose.values[:, :2], unwrapped(pose.values[:, 2])]))
    tip = _channel(tables, "tip_pose", where)
    lasts = float(pose.time[-1] - pose.time[0])
    if lasts > _LONGEST_PUSH:
        raise DatasetError(
            f"{where}, object_pose: lasts {lasts:.6g} s, the longest push may last {_LONGEST_PUSH:g} s;"
            " times are in s, were these milliseconds? Cut a long recording into its pushes"
        )
    wrench = _channel(tables, "ft_wrench", where) if len(tables.get("ft_wrench", ())) else None
    if len(pose.time) < 2:
        raise DatasetError(f"{where}, object_pose: one usable row; a trial needs a first and a last pose")
    return Trial(name, role, pose, tip, wrench), warnings


def unwrapped(angle: FloatArray) -> FloatArray:
    """(T,) angle without jumps of whole turns; unwrapping twice changes nothing."""
    step = np.diff(angle)
    turns = np.where(np.abs(step) > np.pi + 1e-9, np.round(step / _WHOLE_TURN), 0.0)
    result = angle.copy()
    result[1:] -= _WHOLE_TURN * np.cumsum(turns)
    return result


def _channel(tables: Mapping[str, FloatArray], name: str, where: str) -> Channel:
    where = f"{where}, {name}"
    columns = len(CHANNELS[name])
    rows = tables[name][:, : columns + 1]
    if len(rows) == 0:
        raise DatasetError(f"{where}: has no rows; the trial is empty, take it out of the dataset")
    _refuse(np.isinf(rows), rows, where, "is infinite; write NaN where a sensor dropped out")
    largest = np.array([_LARGEST_TIME] + columns * [_LARGEST_VALUE])
    _refuse(np.abs(rows) > largest, rows, where, "is too large for s, m, rad, N; check the units")
    kept = np.flatnonzero(np.isfinite(rows).all(axis=1))
    if len(kept) == 0:
        raise DatasetError(
            f"{where}: every row holds NaN; nothing was measured, take the trial or channel out"
        )
    time = rows[kept, 0]
    late = np.flatnonzero(np.diff(time) < _SHORTEST_STEP)
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
    if np.max(np.abs(theta)) > 2.0 * _WHOLE_TURN or (swept > 1.05 * _WHOLE_TURN and path < 1.0):
        return [
            f"{where}, object_pose: theta runs from {theta.min():.3g} to {theta.max():.3g} while the object"
            f" moves {path:.2g} m; angles are in rad, were these degrees?"
        ]
    return []
