"""From a table of a file to a channel: object poses, finger positions or forces on the object, in the table's
frame and SI units, in order of time."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slipmap.models.geometry import compose
from slipmap.models.measurements import parsing
from slipmap.models.measurements.csv_files import ANGLES, LENGTHS
from slipmap.models.measurements.importing.clocks import coarse_text, wild_rows
from slipmap.models.measurements.importing.import_setup import ChannelSetup
from slipmap.models.measurements.importing.source import Source, names_in
from slipmap.models.measurements.importing.text_tables import seconds
from slipmap.models.measurements.trial import DatasetError
from slipmap.models.physics.cell_grid import FloatArray

_SUFFIXES: dict[str, tuple[tuple[str, ...], ...]] = {
    "position": ((".x", ".y", ".z"), ("_x", "_y", "_z"), ("_0", "_1", "_2"), (".0", ".1", ".2")),
    "force": ((".x", ".y", ".z"), ("_x", "_y", "_z"), ("_0", "_1", "_2"), (".0", ".1", ".2")),
    "rotation_vector": ((".x", ".y", ".z"), ("_x", "_y", "_z"), ("_3", "_4", "_5"), (".3", ".4", ".5"),
                        ("_0", "_1", "_2"), (".0", ".1", ".2")),
    "quaternion": ((".x", ".y", ".z", ".w"), ("_x", "_y", "_z", "_w"), ("_0", "_1", "_2", "_3"),
                   (".0", ".1", ".2", ".3")),
}  # fmt: skip
"""Suffixes after a name that stands for several columns."""

_OWN: dict[str, tuple[tuple[str, ...], ...]] = {
    "position": (("x", "y", "z"), ("x", "y")),
    "quaternion": (("qx", "qy", "qz", "qw"),),
    "rotation_vector": (("rx", "ry", "rz"),),
    "angle": (("theta",), ("yaw",)),
    "force": (("fx", "fy", "fz"), ("fx", "fy")),
    "torque": (),
}
"""Column names that identify a quantity by themselves."""

_MESSAGES: dict[str, tuple[str, ...]] = {
    "position": ("position", "translation", "point"),
    "quaternion": ("orientation", "rotation"),
    "force": ("force",),
}
"""Fields of messages whose x, y, z (and w) they are."""

TIMES = ("t", "time", "timestamp", "stamp", "Time", "Timestamp", "time_s", "Time (Seconds)")

_LEVEL = np.radians(15.0)  # tilt beyond which a rotation about the vertical is unreliable
_UPRIGHT = 0.9  # cosine of the angle by which a finger may lean
_STEEP = 30.0  # degrees from the vertical, beyond which an angle about an axis is none on the table
_FLAT = 5e-3  # m by which a height may vary
_COMES_BACK = 1e-6  # s
_APART, _JUMPING, _FEWEST_ROWS = 0.01, 0.2, 50  # m, share of the rows, and rows, that jump to and fro
_RETURNS = 0.1  # of the jump, by which a body is elsewhere when its next row comes
_LIFTED = 0.01  # m above the finger's pushing height

_TO_TABLE = {
    "z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "y": np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]),
    "-y": np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]),
    "x": np.array([[0, 1.0, 0], [0, 0, 1.0], [1.0, 0, 0]]),
    "-x": np.array([[0, 1.0, 0], [0, 0, -1.0], [-1.0, 0, 0]]),
}
"""Rotations that turn the upward axis into z: for y, (X, Y, Z) becomes (X, -Z, Y)."""


@dataclass(frozen=True, eq=False)
class Mapped:
    """A channel of a recording."""

    table: FloatArray  # (T, 4) t, x, y, theta or t, fx, fy, tau
    done: list[str] = field(default_factory=list)  # processing steps, for the provenance
    doubts: list[str] = field(default_factory=list)
    lifted: FloatArray = field(default_factory=lambda: np.zeros(0))  # times at which the finger is lifted


def is_there(source: Source, name: str, channel: ChannelSetup) -> bool:
    """Whether a table has the columns of a channel that the setup does not mention."""
    return _columns(source, "force" if name == "ft_wrench" else "position", channel, usual_only=True) != ()


def mapped(source: Source, name: str, channel: ChannelSetup, own: bool = True) -> Mapped:
    """The rows of a channel.

    Args:
        own: whether the table holds no other channel's pose, so that a rotation in it is this one's, even if
            the setup does not name its columns.

    Raises:
        DatasetError: missing or non-numeric columns, no clock, or no rows.
    """
    time, concluded, wild = _stamps(source, channel)
    done = [concluded] if concluded else []
    height = np.zeros(0)
    doubts: list[str] = []
    if len(wild):
        rows = parsing.listed([str(row + source.first_row) for row in wild])
        doubts.append(
            f"{source.where}: the stamps of {len(wild)} of {len(time)} rows are far from those before and"
            f" after them; left out: rows {rows}"
        )
    up = channel.up or source.up
    if name == "ft_wrench":
        values = _force(source, channel, up)
        if channel.sign < 0:
            values = -values
            done.append("sign reversed")
    else:
        values, height, more = _pose(source, name, channel, up, own)
        doubts += more
    table = np.column_stack([time, values])
    lifted = np.zeros(0)
    if name == "tip_pose" and np.isfinite(height).any():
        lifted = time[height > np.nanpercentile(height, 1) + _LIFTED]
        if len(lifted):
            done.append(f"while {1e3 * _LIFTED:.0f} mm above its lowest, the finger counts as not touching")
    if name != "ft_wrench":
        _refuse_several_bodies(table, source, name)
    table, order = _in_order(table, name)
    doubts += [f"{source.where}: {text}" for text in order]
    if not np.isfinite(table).all(axis=1).any() and not np.isfinite(table[:, :3]).all(axis=1).any():
        raise DatasetError(f"{source.where}: no row of {name} has numbers in all its columns")
    done += _said(channel, up, source)
    return Mapped(table, done, doubts, lifted)


def _said(channel: ChannelSetup, up: str, source: Source) -> Iterator[str]:
    if up != "z":
        yield f"{up} is up" + ("" if channel.up else ", as usual in such files unless `up` says otherwise")
    if not channel.unit.get("position") and source.length != "m":
        yield f"lengths are in {source.length}, as stated in the file"
    if channel.frame is not None:
        yield "moved into the table's frame"
    if channel.offset is not None:
        yield f"offset {np.round(channel.offset, 5).tolist()} taken off"


# Columns.


def _columns(source: Source, kind: str, channel: ChannelSetup, usual_only: bool = False) -> tuple[str, ...]:
    """The columns of a quantity; () if there are none."""
    said = getattr(channel, kind)
    if said:
        return _expanded(source, kind, said)
    usual = channel.usual.get(kind, ())
    if usual and all(name in source.columns for name in usual):
        return usual
    if usual_only:
        return ()
    for own in _OWN[kind]:
        if all(name in source.columns for name in own):
            return own
    for message in _MESSAGES.get(kind, ()):
        suffix = _SUFFIXES[kind][0]
        ends = [name for name in source.columns if re.fullmatch(rf"(.*\.)?{message}\{suffix[0]}", name)]
        if len(ends) == 1:
            columns = tuple(ends[0][: -len(suffix[0])] + end for end in suffix)
            return columns if kind == "quaternion" else tuple(c for c in columns if c in source.columns)
    return ()


def _expanded(source: Source, kind: str, said: Sequence[str]) -> tuple[str, ...]:
    """Columns by name; one name given for several columns stands for those that begin with it."""
    if kind in _SUFFIXES and len(said) == 1:
        (stem,) = said
        for suffix in _SUFFIXES[kind]:
            columns = tuple(stem + end for end in suffix)
            present = [column in source.columns for column in columns]
            if all(present):
                return columns
            if kind in ("position", "force") and all(present[:2]):
                return columns[:2]
        raise DatasetError(
            f"{source.where}: there are no columns {stem}.x, {stem}.y or {stem}_0, {stem}_1; {source.listed}"
        )
    return tuple(source.name_of(column) for column in said)


def _needed(source: Source, kind: str, channel: ChannelSetup, name: str) -> tuple[str, ...]:
    columns = _columns(source, kind, channel)
    if not columns:
        raise DatasetError(f"{source.where}: which columns hold the {kind} of {name}? {source.listed}")
    return columns


def times(source: Source, channel: ChannelSetup) -> FloatArray:
    """(T,) stamps of the rows, s, NaN where missing or wrong. Raises DatasetError without a clock."""
    return _stamps(source, channel)[0]


def _stamps(source: Source, channel: ChannelSetup) -> tuple[FloatArray, str, NDArray[np.int_]]:
    """(T,) stamps of the rows, s, a remark on how they were read, and the rows whose stamps are wrong."""
    time, concluded = _read_stamps(source, channel)
    if len(wild := wild_rows(time)):
        time = time.copy()
        time[wild] = np.nan
    return time, concluded, wild


def _read_stamps(source: Source, channel: ChannelSetup) -> tuple[FloatArray, str]:
    """(T,) stamps of the rows, s, as recorded, and a remark on how they were read."""
    unit = channel.unit.get("time")
    if channel.rate is not None:
        frames = source.numbers(channel.time[0]) if channel.time else np.arange(float(len(source)))
        return frames / channel.rate, f"frames counted as {channel.rate:g} Hz"
    if channel.time:
        return seconds(source, [source.name_of(column) for column in channel.time], unit)
    if source.time is not None:
        return source.time, ""
    for name in (*channel.usual.get("time", ()), *TIMES):
        if name in source.columns:
            return seconds(source, [name], unit)
    pairs = seconds_and_nanoseconds(source)
    if len(pairs) == 1:
        return seconds(source, pairs[0], None)
    raise DatasetError(
        f"{source.where}: which column is the time? Give `time`, or `rate` in Hz if rows are evenly spaced;"
        f" {source.listed}"
    )


def seconds_and_nanoseconds(source: Source) -> list[tuple[str, str]]:
    """Pairs of columns that form a ROS stamp."""
    found = []
    for name in source.columns:
        stem = re.fullmatch(r"(.*?)secs?", name)
        for end in ("nanosec", "nsec", "nsecs", "nanosecs", "nanoseconds"):
            if stem and f"{stem[1]}{end}" in source.columns:
                found.append((name, f"{stem[1]}{end}"))
    return found


# Poses.


def _pose(
    source: Source, name: str, channel: ChannelSetup, up: str, own: bool
) -> tuple[FloatArray, FloatArray, list[str]]:
    """(T, 3) x, y, theta on the table, (T,) height above it, NaN where unknown, and warnings."""
    columns = _needed(source, "position", channel, name)
    scale = channel.unit.get("position", LENGTHS[source.length])
    position = scale * np.column_stack([source.numbers(column) for column in columns])
    doubts = []
    turn = _turns(source, channel, name, own)
    known_height = position.shape[1] == 3
    if not known_height:
        position = np.column_stack([position, np.zeros(len(position))])
        if up not in ("z", "-z"):
            raise DatasetError(
                f"{source.where}: {name}: with up: {up} the position needs x, y and z, not two columns"
            )
    else:
        doubts += _wrong_axis(position, up, source, name)
    to_table = _TO_TABLE[up]
    frame = np.eye(4) if channel.frame is None else channel.frame
    whole = frame[:3, :3] @ to_table
    place = position @ whole.T + frame[:3, 3]
    heading = np.arctan2(frame[1, 0], frame[0, 0])
    axes: FloatArray | None = None  # (T, 3, 3) columns: axes of the tracked frame, seen from the table
    if isinstance(turn, tuple):
        turns, known = turn
        axes = whole @ turns
        matrices = axes @ to_table.T
        theta = np.where(known, np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0]), np.nan)
        if name == "tip_pose":
            theta = np.where(known, _about_the_vertical(axes), np.nan)
        theta = heading + channel.sign * (theta - heading)
        tilt = np.arccos(np.clip(matrices[known][:, 2, 2], -1.0, 1.0))
        if name == "object_pose" and len(tilt) and np.median(tilt) > _LEVEL:
            asked = "is `up` right, and does the tracked frame lie flat?"
            if _lies_flat_with_w_first(turns[known], whole, to_table):
                asked = (
                    "it would lie flat if the quaternion were w, x, y, z; list its columns in the"
                    " order x, y, z, w"
                )
            doubts.append(
                f"{source.where}: the object's frame is tilted by {np.degrees(np.median(tilt)):.0f}° relative"
                f" to the table; {asked}"
            )
    elif turn is not None:
        down = _looks_down(frame, f"{source.where}: {name}") != up.startswith("-")
        # An angle about a downward axis has the opposite sign on the table.
        theta = heading + channel.sign * (-turn if down else turn)
        axes = whole @ _about(up[-1], channel.sign * turn)
    else:
        theta = np.full(len(place), heading)
    values = np.column_stack([place[:, :2], theta])
    height = place[:, 2] if known_height else np.full(len(place), np.nan)
    return _offset_taken_off(values, channel, name, axes), height, doubts


def _about_the_vertical(axes: FloatArray) -> FloatArray:
    """(T,) angle of a finger about the vertical, NaN where it leans; its own axis is the most upright of the
    tracked axes (T, 3, 3), columns seen from the table."""
    upright = np.abs(axes[:, 2])
    own = int(np.argmax(np.nan_to_num(upright).mean(axis=0)))
    x, y = axes[:, :2, (own + 1) % 3].T
    return np.where(upright[:, own] > _UPRIGHT, np.arctan2(y, x), np.nan)


def _lies_flat_with_w_first(turns: FloatArray, whole: FloatArray, to_table: FloatArray) -> bool:
    """Whether rotations (T, 3, 3) leave the object flat if w of their quaternions was read as x."""
    from scipy.spatial.transform import Rotation

    read = Rotation.from_matrix(turns).as_quat()
    matrices = whole @ Rotation.from_quat(read[:, [1, 2, 3, 0]]).as_matrix() @ to_table.T
    return bool(np.median(matrices[:, 2, 2]) > np.cos(_LEVEL))


def _turns(
    source: Source, channel: ChannelSetup, name: str, own: bool
) -> FloatArray | tuple[FloatArray, NDArray[np.bool_]] | None:
    """(T,) angles, or (T, 3, 3) rotations with (T,) whether they are known; None if there are none."""
    from scipy.spatial.transform import Rotation

    kinds = ("quaternion", "rotation_vector", "angle")
    said = [kind for kind in kinds if getattr(channel, kind)]
    usual = channel.usual.get("angle", ())
    if not said and usual and all(column in source.columns for column in usual):
        said = ["angle"]
    for kind in said or (kinds if own else ()):
        columns = _columns(source, kind, channel)
        if not columns:
            continue
        scale = 1.0 if kind == "quaternion" else channel.unit.get("angle", ANGLES[source.angle])
        cells = scale * np.column_stack([source.numbers(column) for column in columns])
        if kind == "angle":
            return np.asarray(cells[:, 0])
        known = np.asarray(np.isfinite(cells).all(axis=1))
        if kind == "quaternion":
            known = known & (np.linalg.norm(cells, axis=1) > 0.5)
        turns = np.full((len(cells), 3, 3), np.nan)
        if known.any():
            make = Rotation.from_quat if kind == "quaternion" else Rotation.from_rotvec
            turns[known] = make(cells[known]).as_matrix()
        return turns, known
    if name == "object_pose":
        raise DatasetError(
            f"{source.where}: which column is the object's angle, or its quaternion? {source.listed}"
        )
    return None


def _looks_down(frame: FloatArray, where: str) -> bool:
    """Whether the upward axis of a source points down on the table, given the (4, 4) pose of its frame.

    Raises:
        DatasetError: it is far from vertical, so that an angle about it is none on the table.
    """
    tilt = float(np.degrees(np.arccos(min(abs(frame[2, 2]), 1.0))))
    if tilt > _STEEP:
        raise DatasetError(
            f"{where}: the z axis of `frame` is {tilt:.0f}° from the vertical, so the `angle` does not turn"
            " about it; correct `frame` or `up`, or give the rotation as a `quaternion` or `rotation_vector`"
        )
    return bool(frame[2, 2] < 0.0)


def _about(axis: str, angles: FloatArray) -> FloatArray:
    """(T, 3, 3) rotations about x, y or z; NaN where the angle, in rad, is."""
    from scipy.spatial.transform import Rotation

    known = np.isfinite(angles)
    turns = np.full((len(angles), 3, 3), np.nan)
    if known.any():
        turns[known] = Rotation.from_euler(axis, angles[known, None]).as_matrix()
    return turns


def _offset_taken_off(
    values: FloatArray, channel: ChannelSetup, name: str, axes: FloatArray | None
) -> FloatArray:
    """Poses of the outline's frame, or positions of the finger's centre, from the tracked ones.

    Args:
        axes: (T, 3, 3) axes of the tracked frame, with which the finger's offset turns, as columns; None if
            its rotation is unknown, and the offset is along those of the table.
    """
    if channel.offset is None:
        return values
    offset = np.append(channel.offset, np.zeros(3 - len(channel.offset)))
    if name == "object_pose":
        return compose(values, offset)
    shift = offset[:2] if axes is None else (axes @ offset)[:, :2]
    return np.column_stack([values[:, :2] + shift, values[:, 2]])


def _wrong_axis(position: FloatArray, up: str, source: Source, name: str) -> list[str]:
    """Warning if the axis of constant height is not the one stated to point up."""
    known = position[np.isfinite(position).all(axis=1)]
    if name != "object_pose" or len(known) < 10:
        return []
    spread = np.percentile(known, 95, axis=0) - np.percentile(known, 5, axis=0)
    axis = "xyz".index(up[-1])
    flattest = int(np.argmin(spread))
    if flattest == axis or spread[axis] < _FLAT or spread[flattest] > 0.2 * spread[axis]:
        return []
    return [
        f"{source.where}: the object's {up[-1]} varies by {1e3 * spread[axis]:.0f} mm and its"
        f" {'xyz'[flattest]} by {1e3 * spread[flattest]:.1f} mm; is `up: {'xyz'[flattest]}` right?"
    ]


def _force(source: Source, channel: ChannelSetup, up: str) -> FloatArray:
    """(T, 3) force in the table's plane and torque; NaN where the torque was not measured."""
    columns = _needed(source, "force", channel, "ft_wrench")
    force = channel.unit.get("force", 1.0) * np.column_stack([source.numbers(name) for name in columns])
    whole = _TO_TABLE[up]
    if channel.frame is not None:
        whole = channel.frame[:3, :3] @ whole
    if force.shape[1] == 2:
        if up not in ("z", "-z"):
            raise DatasetError(f"{source.where}: ft_wrench: with up: {up} the force needs three columns")
        force = np.column_stack([force, np.zeros(len(force))])
    if channel.offset is not None:
        force = force - np.append(channel.offset, np.zeros(3 - len(channel.offset)))
    torque = np.full(len(force), np.nan)
    if columns := _columns(source, "torque", channel):
        torque = channel.unit.get("torque", 1.0) * source.numbers(columns[0])
    return np.column_stack([(force @ whole.T)[:, :2], torque])


# Rows.


def _refuse_several_bodies(table: FloatArray, source: Source, name: str) -> None:
    """Raise DatasetError if the rows (T, 4) of a table with names jump to and fro between places to which
    they return, as poses of different bodies do. Noise, in whatever unit, does not return so exactly."""
    place = table[np.isfinite(table[:, 1:3]).all(axis=1), 1:3]
    words = names_in(source)
    if len(place) < _FEWEST_ROWS or not words:
        return
    step = np.hypot(*np.diff(place, axis=0).T)
    jumps = step > _APART
    apart = float(np.median(step[jumps])) if jumps.any() else 0.0
    later = range(2, 2 * len(words) + 1)
    returns = [
        np.hypot(*(place[lag : len(place) - later[-1] + lag] - place[: -later[-1]]).T) for lag in later
    ]
    left = float(np.median(np.min(returns, axis=0)))
    if jumps.sum() > _JUMPING * len(place) and left < _RETURNS * apart:
        raise DatasetError(
            f"{source.where}: {name} jumps to and fro by {parsing.rounded(apart, 2)} m from row to row; if"
            f" the rows are of several bodies, give `part`, one of {parsing.listed(words)}"
        )


def _in_order(table: FloatArray, name: str) -> tuple[FloatArray, list[str]]:
    """Rows with a time, sorted and without repeated stamps, and warnings about these."""
    rows = table[np.isfinite(table[:, 0]) & np.isfinite(table[:, 1:3]).all(axis=1)]
    found = []
    step = np.diff(rows[:, 0])
    back = step < -_COMES_BACK
    if back.any():
        found.append(
            f"stamps of {name} go back {int(back.sum())} times, by up to {-1e3 * step.min():.3g} ms; the rows"
            " were sorted"
        )
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
    again = np.diff(rows[:, 0]) <= 1e-9
    if again.any():
        coarse = coarse_text(rows[:, 0], rows[:, 1:])
        found.append(
            f"{int(again.sum())} of {len(rows)} rows of {name} have the stamp of the row before; left out"
            + (f". {coarse[0].upper()}{coarse[1:]}" if coarse else "")
        )
        rows = rows[np.append(True, ~again)]
    return rows, found
