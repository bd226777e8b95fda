"""Build trials from tables of rows; rows that cannot be used are refused or left out."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d

from slipmap.models.geometry import angle_between
from slipmap.models.measurements import parsing
from slipmap.models.measurements.bad_rows import sound_rows
from slipmap.models.measurements.motion import row_noise
from slipmap.models.measurements.trial import CHANNELS, Channel, DatasetError, Role, Trial
from slipmap.models.physics.cell_grid import FloatArray

COLUMNS = 4
"""Columns of every table: t, x, y, theta or t, fx, fy, tau."""

_LARGEST_VALUE = 1e6  # m, rad, N
_LARGEST_TIME = 1e11  # s; Unix time in ms or ns lies above
LONGEST_PUSH = 1000.0  # s
_SHORTEST_STEP = 1e-9  # s
_WHOLE_TURN = 2.0 * np.pi
_TURNS, _TIMES_NOISE = 0.05, 5.0  # rad, and times its noise, by which a finger must turn to count
_STRAY = 0.2  # rad off the median of five rows
_LARGEST_ANGLE = 5e3  # rad

IN_DEGREES = "Angles must be in rad; were these degrees?"


def json_tables(record: Mapping[str, Any], where: str) -> dict[str, FloatArray]:
    """The tables in a trial's JSON file, by channel."""
    return {
        channel: parsing.table(record[channel], COLUMNS, f"{where}, {channel}")
        for channel in CHANNELS
        if record.get(channel) is not None
    }


def trial_from_tables(
    name: str, role: Role, tables: Mapping[str, FloatArray], where: str, longest: float = LONGEST_PUSH
) -> tuple[Trial, list[str]]:
    """Build a trial from the tables `object_pose`, `tip_pose` and, if measured, `ft_wrench`.

    Rows with a NaN are dropped, as are tracker rows that cannot be true (see `sound_rows`); theta is
    unwrapped over the rest. A finger may lack its theta; the torque of `ft_wrench` counts as 0 where it is
    NaN. An empty `ft_wrench` counts as not measured.

    Args:
        tables: rows (T, 4) of t, x, y, theta or t, fx, fy, tau.
        where: the file, for error messages.
        longest: longest duration of the trial, s.

    Returns:
        The trial and warnings about it.

    Raises:
        DatasetError: missing or empty tables, infinite or absurd numbers, time that does not increase.
    """
    for required in ("object_pose", "tip_pose"):
        if required not in tables:
            raise DatasetError(f"{where}: `{required}` is missing; a trial needs object_pose and tip_pose")
    pose, rows = _channel(tables, "object_pose", where)
    placed, _, _ = sound_rows(pose.time, pose.values[:, :2])  # -9999 for an angle is none
    warnings = _degrees(pose.chosen(placed), where)
    if not warnings:  # of angles in degrees, an apparent half turn may be half a degree
        pose, warnings = _sound(pose, rows, f"{where}, object_pose")
    pose = Channel(pose.time, np.column_stack([pose.values[:, :2], unwrapped(pose.values[:, 2])]))
    tip, rows = _channel(tables, "tip_pose", where)
    tip, doubts = _sound(tip, rows, f"{where}, tip_pose")
    angle, of_angle = _tip_angle(tables["tip_pose"], f"{where}, tip_pose")
    warnings += doubts + of_angle
    refuse_long(pose, where, longest)
    wrench = _channel(tables, "ft_wrench", where)[0] if len(tables.get("ft_wrench", ())) else None
    if len(pose.time) < 2:
        raise DatasetError(f"{where}, object_pose: one usable row; a trial needs a first and a last pose")
    return Trial(name, role, pose, tip, wrench, tip_angle=angle), warnings


def refuse_long(pose: Channel, where: str, longest: float = LONGEST_PUSH) -> None:
    """Raise DatasetError if a push lasts longer than `longest` s."""
    lasts = float(pose.time[-1] - pose.time[0])
    if lasts > longest:
        step = float(np.median(np.diff(pose.time)))
        likely = "milliseconds" if step < 1e3 else "microseconds" if step < 1e6 else "nanoseconds"
        raise DatasetError(
            f"{where}, object_pose: lasts {lasts:.6g} s, but a push may last at most {longest:g} s;"
            f" times must be in s; were these {likely}? Cut a long recording into its pushes"
        )


def unwrapped(angle: FloatArray) -> FloatArray:
    """(T,) angle without jumps of whole turns; unwrapping twice changes nothing."""
    step = np.diff(angle)
    turns = np.where(np.abs(step) > np.pi + 1e-9, np.round(step / _WHOLE_TURN), 0.0)
    result = angle.copy()
    result[1:] -= _WHOLE_TURN * np.cumsum(turns)
    return result


def _sound(channel: Channel, rows: NDArray[np.int_], where: str) -> tuple[Channel, list[str]]:
    """A tracker's channel without the rows that cannot be true, and warnings about these."""
    kept, found, stays = sound_rows(channel.time, channel.values)
    warnings = [
        f"{where}, row{'s' if len(bad) > 1 else ''} {parsing.listed([str(rows[row]) for row in bad])}:"
        f" {fault}; left out"
        for fault, bad in found.items()
    ]
    if stays:
        warnings.append(f"{where}: {stays}; did it really move, or did the tracker's frame jump?")
    return channel.chosen(kept), warnings


def _tip_angle(tip: FloatArray, where: str) -> tuple[Channel | None, list[str]]:
    """The angle of a finger, rows (T, 3) or (T, 4) of t, x, y, theta, if it turns, and doubts about it."""
    known = tip[np.isfinite(tip).all(axis=1) & (np.abs(tip[:, -1]) < _LARGEST_ANGLE)]  # -9999 is no angle
    if tip.shape[1] < COLUMNS or not len(known):
        return None, []
    angle = if_turning(Channel(known[:, 0], unwrapped(known[:, 3])[:, None]))
    turn = 0.0 if angle is None else float(np.ptp(angle.values))
    if turn > _WHOLE_TURN or (turn and (turn := float(np.ptp(known[:, 3]))) > 2.0 * _WHOLE_TURN):
        return None, [f"{where}: theta turns by {turn:.3g}, so it is not used. {IN_DEGREES}"]
    return angle, []


def if_turning(angle: Channel) -> Channel | None:
    """A finger's unwrapped angle without stray rows; None if it turns by no more than its noise."""
    values = angle.values[:, 0]
    x, y = (median_filter(part, 5, mode="nearest") for part in (np.cos(values), np.sin(values)))
    off = angle_between(values, np.arctan2(y, x))
    values = unwrapped(np.where(np.abs(off) > _STRAY, values - off, values))
    turn = np.ptp(smoothed_angle(angle.time, values))
    if not turn > max(_TURNS, _TIMES_NOISE * float(row_noise(angle.time, values[:, None])[0])):
        return None
    return Channel(angle.time, values[:, None])


def smoothed_angle(time: FloatArray, angle: FloatArray) -> FloatArray:
    """(T,) means of an angle over 0.1 s."""
    rows = 1 + 2 * round(0.05 / float(np.median(np.diff(time)))) if len(time) > 1 else 1
    return np.asarray(uniform_filter1d(angle, rows, mode="nearest"))


def _channel(tables: Mapping[str, FloatArray], name: str, where: str) -> tuple[Channel, NDArray[np.int_]]:
    """A channel, and the indices of its rows in the table."""
    where = f"{where}, {name}"
    columns = len(CHANNELS[name])
    rows = tables[name][:, : columns + 1]
    if name == "ft_wrench":  # the torque may be missing, since nothing is learned from it
        measured = np.isfinite(rows[:, :3]).all(axis=1)
        rows = np.column_stack([rows[:, :3], np.where(measured & np.isnan(rows[:, 3]), 0.0, rows[:, 3])])
    if len(rows) == 0:
        raise DatasetError(f"{where}: has no rows; remove this empty trial from the dataset")
    _refuse(np.isinf(rows), rows, where, "is infinite; write NaN where a sensor dropped out")
    largest = np.array([_LARGEST_TIME] + columns * [_LARGEST_VALUE])
    _refuse(np.abs(rows) > largest, rows, where, "is too large for s, m, rad, N; check the units")
    kept = np.flatnonzero(np.isfinite(rows).all(axis=1))
    if len(kept) == 0:
        raise DatasetError(
            f"{where}: every row contains NaN, so nothing was measured; remove the trial or the channel"
        )
    time = rows[kept, 0]
    late = np.flatnonzero(np.diff(time) < _SHORTEST_STEP)
    if len(late):
        before, row = kept[late[0]], kept[late[0] + 1]
        what = "is earlier than" if time[late[0] + 1] < time[late[0]] else "repeats"
        raise DatasetError(
            f"{where}, row {row}: time {time[late[0] + 1]} s {what} that of row {before}, {time[late[0]]} s;"
            " sort the rows and remove repeated ones"
        )
    return Channel(time, rows[kept, 1:]), kept


def _refuse(bad: NDArray[np.bool_], rows: FloatArray, where: str, complaint: str) -> None:
    found = np.flatnonzero(bad.any(axis=1))
    if len(found):
        values = ", ".join(f"{value:g}" for value in rows[found[0]])
        raise DatasetError(f"{where}, row {found[0]}: a number in [{values}] {complaint}")


def _degrees(pose: Channel, where: str) -> list[str]:
    """Warning if raw theta seems to be in degrees."""
    said = seems_degrees(pose.values)
    return [f"{where}, object_pose: {said}. {IN_DEGREES}"] if said else []


def seems_degrees(values: FloatArray) -> str:
    """What is odd about poses (T, 3) whose theta exceeds two turns, or turns like degrees; else empty."""
    theta = values[:, 2]
    if np.max(np.abs(theta)) <= 2.0 * _WHOLE_TURN:
        return turns_like_degrees(values)
    return turns_like_degrees(values) or f"theta runs from {theta.min():.3g} to {theta.max():.3g}"


def turns_like_degrees(values: FloatArray) -> str:
    """What is odd about poses (T, 3) that turn by more than a turn while they hardly move; else empty."""
    theta = values[:, 2]
    path = float(np.sum(np.hypot(*np.diff(values[:, :2], axis=0).T)))
    if np.ptp(theta) < 1.05 * _WHOLE_TURN or path > 1.0:
        return ""
    return f"theta runs from {theta.min():.3g} to {theta.max():.3g} while the object moves {path:.2g} m"
