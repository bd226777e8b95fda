"""Trials out of tables of rows, as files hold them, and checks of them against geometry and units: what
cannot be used is refused, what looks wrong is said."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from slipmap.models.geometry import placed, seen_from
from slipmap.models.measurements import parsing
from slipmap.models.measurements.bad_rows import sound_rows
from slipmap.models.measurements.push_dataset import CHANNELS, Channel, DatasetError, Role, Setup, Trial
from slipmap.models.physics.cell_grid import FloatArray

COLUMNS = 4
"""Of every table: t, x, y, theta or t, fx, fy, tau."""

_LARGEST_VALUE = 1e6  # m, rad, N
_LARGEST_TIME = 1e11  # s; Unix time in ms or ns lies above
_LONGEST_PUSH = 1000.0  # s
_SHORTEST_STEP = 1e-9  # s
_WHOLE_TURN = 2.0 * np.pi

_CALIBRATION_ERROR = 3e-3  # m; good laboratories have 2 mm
_LARGEST_SPEED = 10.0  # m/s
_SPEED_WINDOW = 0.1  # s; time stamps jitter too much for row by row speeds
_SLOWEST_RATE = 2.0  # s between rows
_NOTABLE_MOTION = 5e-3  # m
_TOUCH_RADII = 3.0  # finger radii of air beyond which a finger never touched
_EARLY_END = 0.1  # s
_SLOW_TIP = 5e-3  # m/s
_THROUGH = 0.01  # m
_MOST_ROWS = 500  # of a track that are compared with the outline


def json_tables(record: Mapping[str, Any], where: str) -> dict[str, FloatArray]:
    """The tables in a trial's JSON file, by channel."""
    return {
        channel: parsing.table(record[channel], COLUMNS, f"{where}, {channel}")
        for channel in CHANNELS
        if record.get(channel) is not None
    }


def trial_from_tables(
    name: str, role: Role, tables: Mapping[str, FloatArray], where: str
) -> tuple[Trial, list[str]]:
    """Trial of the tables `object_pose`, `tip_pose` and, where measured, `ft_wrench`.

    Rows in which a used column is NaN are dropped, and so are rows of a tracker that cannot be true, see
    `sound_rows`; theta is unwrapped over the rest. The torque of `ft_wrench` counts as 0 where it is NaN. An
    empty `ft_wrench` counts as not measured.

    Args:
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
    pose, rows = _channel(tables, "object_pose", where)
    warnings = _degrees(pose, where)
    if warnings:  # then what looks like half a turn is half a degree
        pose = Channel(pose.time, np.column_stack([pose.values[:, :2], unwrapped(pose.values[:, 2])]))
    else:
        pose, warnings = _sound(pose, rows, f"{where}, object_pose")
        pose = Channel(pose.time, np.column_stack([pose.values[:, :2], unwrapped(pose.values[:, 2])]))
    tip, rows = _channel(tables, "tip_pose", where)
    tip, doubts = _sound(tip, rows, f"{where}, tip_pose")
    warnings += doubts
    lasts = float(pose.time[-1] - pose.time[0])
    if lasts > _LONGEST_PUSH:
        raise DatasetError(
            f"{where}, object_pose: lasts {lasts:.6g} s, the longest push may last {_LONGEST_PUSH:g} s;"
            " times are in s, were these milliseconds? Cut a long recording into its pushes"
        )
    wrench = _channel(tables, "ft_wrench", where)[0] if len(tables.get("ft_wrench", ())) else None
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


def check_trials(setup: Setup, trials: Sequence[Trial], where: str) -> list[str]:
    """Warnings of a dataset's trials, one a kind of fault, each naming its trials.

    Raises:
        DatasetError: two equal trials, channels without a common time, or a finger that starts inside the
            object by more than 3 mm and three standard deviations of the sensors.
    """
    _refuse_copies(trials, where)
    found: dict[str, list[str]] = {}
    for trial in trials:
        for fault in _faults(setup, trial, where):
            found.setdefault(fault, []).append(trial.name)
    warnings = [f"{_listed(names)}: {fault}" for fault, names in found.items()]
    if not any(trial.role == "fit" for trial in trials):
        warnings.append(f"{where}: every trial is heldout; there is nothing to learn from")
    return warnings


def _sound(channel: Channel, rows: NDArray[np.int_], where: str) -> tuple[Channel, list[str]]:
    """A tracker's channel without the rows that cannot be true, and what was wrong with them."""
    kept, found, stays = sound_rows(channel.time, channel.values)
    warnings = [
        f"{where}, row{'s' if len(bad) > 1 else ''} {_listed([str(rows[row]) for row in bad])}:"
        f" {fault}; left out"
        for fault, bad in found.items()
    ]
    if stays:
        warnings.append(f"{where}: {stays}; is that true, or does the tracker's frame jump?")
    return Channel(channel.time[kept], channel.values[kept]), warnings


def _channel(tables: Mapping[str, FloatArray], name: str, where: str) -> tuple[Channel, NDArray[np.int_]]:
    """A channel, and which rows of the table it has."""
    where = f"{where}, {name}"
    columns = len(CHANNELS[name])
    rows = tables[name][:, : columns + 1]
    if name == "ft_wrench":  # the torque may be missing: nothing that is learnt goes by it
        torque = np.where(
            np.isnan(rows[:, 3:]) & ~np.isnan(rows[:, :3]).any(axis=1)[:, None], 0.0, rows[:, 3:]
        )
        rows = np.column_stack([rows[:, :3], torque])
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
    return Channel(time, rows[kept, 1:]), kept


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


def _faults(setup: Setup, trial: Trial, where: str) -> Iterator[str]:
    moved = _moved(setup, trial)
    if _fastest(trial.object_pose) > _LARGEST_SPEED:
        yield f"the object moves faster than {_LARGEST_SPEED:g} m/s; are positions in m and times in s?"
    if len(trial.object_pose.time) > 10 and np.median(np.diff(trial.object_pose.time)) > _SLOWEST_RATE:
        yield f"object poses are more than {_SLOWEST_RATE:g} s apart; are times in s?"
    stays = len(trial.tip_pose.time) == 1 or not trial.has_finger
    if moved and stays and not trial.initial_velocity().any():
        yield "a resting object begins to move, but " + (
            "tip_pose has one row; a finger that stays pushes nothing"
            if trial.has_finger
            else "no finger is within 1 m; is the tip given in m?"
        )
    if not trial.has_finger:
        return
    if _stands_still(setup, trial):
        yield "the object's pose never changes though the finger goes through it; was the tracker frozen?"
    if moved and _pulls(setup, trial):
        yield (
            "the force points against the finger's way, as if it pulled; ft_wrench is the force of the finger"
            " on the object, is it given the other way round?"
        )
    _refuse_foreign_clocks(trial, where)
    _refuse_finger_inside(setup, trial, where)
    if _fastest(trial.tip_pose) > _LARGEST_SPEED:
        yield f"the tip moves faster than {_LARGEST_SPEED:g} m/s; are positions in m and times in s?"
    if moved and _clearance(setup, trial) > _TOUCH_RADII * setup.finger_radius + _CALIBRATION_ERROR:
        yield "the object moves, but the tip never touches its outline; is one of them in a wrong frame?"
    if _ends_early(trial):
        yield "the tip's rows end while it still moves; it is held at its last position from there on"


def _stands_still(setup: Setup, trial: Trial) -> bool:
    """Whether not a digit of the pose changes, and the finger's rim goes 10 mm and more into the object."""
    if len(trial.object_pose.time) < 3 or np.ptp(trial.object_pose.values, axis=0).any():
        return False
    deepest = float(np.min(_signed_distance(setup, trial.tip_pose.values, trial, trial.start)))
    return deepest < setup.finger_radius - _THROUGH


def _pulls(setup: Setup, trial: Trial) -> bool:
    """Whether the force that goes along with the finger works against it over most of its way."""
    if trial.ft_wrench is None or len(trial.tip_pose.time) < 2:
        return False
    times, force = trial.ft_wrench.time, trial.ft_wrench.values[:, :2]
    size = np.hypot(*force.T)
    step = np.diff(trial.tip_pose.at(times), axis=0)
    pushing = size[1:] > max(0.3 * float(size.max(initial=0.0)), 3.0 * (setup.noise.force or 0.0))
    work = (force[1:] * step).sum(axis=1)[pushing]
    return bool(work.sum() < -0.5 * (size[1:] * np.hypot(*step.T))[pushing].sum()) if len(work) else False


def _refuse_copies(trials: Sequence[Trial], where: str) -> None:
    seen: dict[bytes, str] = {}
    for trial in trials:
        digest = hashlib.sha256()
        for channel in trial.channels.values():
            digest.update(np.round(channel.time - trial.start, 6).tobytes())
            digest.update(channel.values.tobytes())
        first = seen.setdefault(digest.digest(), trial.name)
        if first != trial.name:
            raise DatasetError(
                f"{where}: {trial.name} holds the same measurement as {first}; a push counts once, remove one"
            )


def _refuse_foreign_clocks(trial: Trial, where: str) -> None:
    first, last = trial.object_pose.time[[0, -1]]
    for what, channel in trial.channels.items():
        apart = channel.time[-1] < first or channel.time[0] > last
        if apart and len(channel.time) > 1:
            raise DatasetError(
                f"{where}: {trial.name}, {what}, row 0: its times run from {channel.time[0]:.3f} to"
                f" {channel.time[-1]:.3f} s, those of object_pose from {first:.3f} to {last:.3f} s; stamp all"
                " channels with one clock"
            )


def _refuse_finger_inside(setup: Setup, trial: Trial, where: str) -> None:
    depth = setup.finger_radius - float(
        _signed_distance(setup, trial.tip_pose.at([trial.start]), trial, trial.start)[0]
    )
    noise = np.hypot(setup.noise.position or 0.0, setup.noise.tip or 0.0)
    if depth > _CALIBRATION_ERROR + 3.0 * noise:
        raise DatasetError(
            f"{where}: {trial.name}, row 0: the finger starts {1e3 * depth:.1f} mm inside the object; check"
            " finger.radius, the outline, the frames of object_pose and tip_pose, and that theta is in rad"
        )


def _moved(setup: Setup, trial: Trial) -> bool:
    """Whether a point of the outline ends or passes 5 mm and five standard deviations from where it began."""
    pose = trial.object_pose.values
    reach = float(np.max(np.hypot(*setup.grid.exterior.T)))
    shift = np.hypot(*(pose[:, :2] - pose[0, :2]).T) + reach * np.abs(pose[:, 2] - pose[0, 2])
    noise = np.hypot(setup.noise.position or 0.0, reach * (setup.noise.angle or 0.0))
    return bool(np.max(shift) > max(_NOTABLE_MOTION, 5.0 * noise))


def _clearance(setup: Setup, trial: Trial) -> float:
    """Least distance between the finger's rim and the outline over a trial, m; negative where it overlaps."""
    if trial.ends_only:  # the finger went straight, the object is anywhere between
        track = shapely.LineString(trial.tip_pose.values[[0, *range(len(trial.tip_pose.time))]])
        outlines = [shapely.Polygon(placed(setup.grid.exterior, pose)) for pose in trial.object_pose.values]
        return float(min(track.distance(outline) for outline in outlines)) - setup.finger_radius
    chosen = np.unique(np.linspace(0, len(trial.tip_pose.time) - 1, _MOST_ROWS).astype(int))
    tips = trial.tip_pose.values[chosen]
    distance = _signed_distance(setup, tips, trial, trial.tip_pose.time[chosen])
    return float(np.min(distance)) - setup.finger_radius


def _signed_distance(setup: Setup, tips: FloatArray, trial: Trial, times: FloatArray | float) -> FloatArray:
    """(k,) distance of world points (k, 2) to the object's rim at the given times, negative inside, m."""
    poses = np.broadcast_to(trial.object_pose.at(times), (len(tips), 3))
    points = shapely.points(seen_from(tips, poses))
    rim = shapely.distance(setup.grid.polygon.boundary, points)
    return np.where(shapely.contains(setup.grid.polygon, points), -rim, rim)


def _fastest(channel: Channel) -> float:
    """Greatest speed over windows of 0.1 s or, in shorter tracks, over the whole, m/s."""
    span = float(channel.time[-1] - channel.time[0])
    if span <= 0.0:
        return 0.0
    window = min(_SPEED_WINDOW, span)
    starts = channel.time[channel.time <= channel.time[-1] - window]
    step = channel.at(starts + window) - channel.at(starts)
    return float(np.max(np.hypot(step[:, 0], step[:, 1]), initial=0.0)) / window


def _ends_early(trial: Trial) -> bool:
    end = float(trial.tip_pose.time[-1])
    if end > trial.object_pose.time[-1] - _EARLY_END or len(trial.tip_pose.time) < 2:
        return False
    step = trial.tip_pose.values[-1] - trial.tip_pose.at(end - _EARLY_END)
    return bool(np.hypot(*step) > _SLOW_TIP * _EARLY_END)


def _listed(names: list[str]) -> str:
    shown = ", ".join(names[:5])
    return shown if len(names) <= 5 else f"{shown} and {len(names) - 5} more"
