"""Parse a setup.yaml. Besides object, finger, table and noise, as in a dataset.yaml, it states where object
pose, finger and force are in a laboratory's files, and how they were measured.

The three channels are named as in a dataset: `object_pose`, `tip_pose` and `ft_wrench`. Keys that apply to
all of them may be given at the top level.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from slipmap.models.measurements import csv_files, parsing
from slipmap.models.measurements.parsing import Number
from slipmap.models.measurements.push_dataset import Setup
from slipmap.models.measurements.setup_description import SETUP_KEYS, parse_setup
from slipmap.models.measurements.trial import CHANNELS, DatasetError
from slipmap.models.physics.cell_grid import FloatArray

UPWARD = ("z", "y", "x", "-z", "-y", "-x")
"""Axes of a source that may point up."""

CONTACT = "contact"
"""Value of `clock` and of the force's `frame`: fit to the contact."""

UNITS: Mapping[str, Mapping[str, float]] = {
    "position": csv_files.LENGTHS,
    "angle": csv_files.ANGLES,
    "force": csv_files.FORCES,
    "torque": csv_files.TORQUES,
    "time": csv_files.TIMES,
}
"""Quantities with units, and the factors from each unit to SI."""

_SHARED = ("source", "time", "rate", "unit", "up", "frame", "push")
_RATE = Number("Hz", 1e-3, 1e6)


@dataclass(frozen=True)
class ChannelSetup:
    """Location of a channel in the files, and how it was measured."""

    source: str = "*"  # pattern of the file names
    part: str = ""  # topic, rigid body or path inside the file
    time: tuple[str, ...] = ()  # column of time, or those of seconds and nanoseconds
    rate: float | None = None  # rows per second if the file has frame numbers or no time at all, Hz
    push: str = ""  # column that numbers pushes
    # Columns of each quantity: one name each, or one name whose x, y, z they are; empty if the kind of file
    # determines them.
    position: tuple[str, ...] = ()
    angle: tuple[str, ...] = ()
    quaternion: tuple[str, ...] = ()  # x, y, z, w
    rotation_vector: tuple[str, ...] = ()
    force: tuple[str, ...] = ()
    torque: tuple[str, ...] = ()
    unit: Mapping[str, float] = field(default_factory=dict)  # factor to SI for each quantity
    up: str = ""  # axis that points up; by default that of the kind of file, else z
    frame: FloatArray | None = None  # (4, 4) pose of the source's frame in the table's; None if equal
    turned_by_contact: bool = False  # whether the force is rotated to fit the contact
    sign: float = 1.0  # of the angle, or of the force
    offset: FloatArray | None = None  # pose of outline or finger in the tracked frame; bias of the force
    clock: float | Literal["contact"] | None = None  # added to stamps, s; None if not stated
    named: bool = True  # whether the setup mentions it; otherwise it is used if its usual columns exist
    usual: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # columns under the key `csv`


@dataclass(frozen=True)
class ImportSetup:
    """A setup.yaml."""

    setup: Setup
    channels: Mapping[str, ChannelSetup]  # by name, in the order of CHANNELS
    heldout: tuple[str, ...] | None  # names of the pushes to hold out; None for the last quarter
    warnings: tuple[str, ...]

    @property
    def parts(self) -> tuple[str, ...]:
        """Topics wanted from bags; empty if any channel names none."""
        named = [channel.part for channel in self.channels.values() if channel.named]
        return tuple(named) if named and all(named) else ()


def parse_import_setup(
    document: dict[str, Any], where: str, default_name: str, described: dict[str, Any] | None = None
) -> ImportSetup:
    """Build an import setup from a parsed mapping.

    Args:
        document: keys of `SETUP_KEYS`, `csv`, `heldout`, the names of channels, and keys that channels share.
        where: the file, for error messages.
        default_name: of the dataset, if the document gives none.
        described: keys `object` and `finger`, if the document has none.

    Raises:
        DatasetError: a key that is missing, unknown or wrong. Unknown keys are refused because a typing error
            in a transform would make all numbers wrong.
    """
    known = {*SETUP_KEYS, *CHANNELS, *_SHARED, "csv", "heldout"}
    _refuse_unknown(document, known, where)
    told = {key: value for key, value in (described or {}).items() if key in (*SETUP_KEYS, "csv")}
    document = document | {key: _filled(document.get(key), value) for key, value in told.items()}
    setup, warnings = parse_setup(document, where, default_name)
    columns = csv_files.parse_columns(document.get("csv"), f"{where}: csv")
    shared = {key: document[key] for key in _SHARED if key in document}
    channels = {}
    for name in CHANNELS:
        if name in document and document[name] is None:
            continue  # null: not measured, whatever columns there are
        place = f"{where}: {name}"
        said = parsing.mapping(document.get(name, {}), place)
        found = _channel(name, shared | said, place)
        if "unit" in shared:
            of_all = _unit(shared["unit"], f"{where}: unit", name == "ft_wrench")
            found = replace(found, unit={**of_all, **found.unit})
        usual, unit = _usual(name, columns, f"{where}: csv")
        channels[name] = replace(found, unit={**unit, **found.unit}, usual=usual, named=name in document)
    if "object_pose" not in channels:
        raise DatasetError(
            f"{where}: `object_pose` is null; nothing can be learned without the object's pose"
        )
    heldout = document.get("heldout")
    if heldout is not None and not (isinstance(heldout, list) and all(isinstance(n, str) for n in heldout)):
        raise DatasetError(f"{where}: heldout must be a list of pushes' names, got {parsing.shown(heldout)}")
    return ImportSetup(setup, channels, None if heldout is None else tuple(heldout), tuple(warnings))


def _refuse_unknown(entry: dict[str, Any], known: set[str], where: str) -> None:
    unknown = parsing.unknown_keys(entry, known, where)
    if unknown:
        raise DatasetError("; ".join(unknown).replace("unknown and ignored", "unknown"))


def _filled(said: object, described: object) -> object:
    """A setup's value with missing or null entries filled in from the object's description."""
    if isinstance(said, dict) and isinstance(described, dict):
        return described | {key: value for key, value in said.items() if value is not None}
    return described if said is None else said


def _usual(
    name: str, columns: csv_files.CsvColumns, where: str
) -> tuple[dict[str, tuple[str, ...]], dict[str, float]]:
    """The columns of a channel from the key `csv`, and their units where not SI."""
    names = [columns.names[ours] for ours in CHANNELS[name]]
    kinds = ("force", "force", "torque") if name == "ft_wrench" else ("position", "position", "angle")
    usual: dict[str, tuple[str, ...]] = {"time": (columns.names["t"],)}
    unit = {"time": columns.factors["t"]}
    for kind, ours, theirs in zip(kinds, CHANNELS[name], names, strict=False):
        usual[kind] = (*usual.get(kind, ()), theirs)
        if unit.setdefault(kind, columns.factors[ours]) != columns.factors[ours]:
            raise DatasetError(
                f"{where}: {CHANNELS[name][0]} and {ours} have different units; an import needs one for both;"
                " convert a column, or read the file as it is, without importing"
            )
    return usual, {kind: factor for kind, factor in unit.items() if factor != 1.0}


def _channel(name: str, entry: dict[str, Any], where: str) -> ChannelSetup:
    """A channel from its entry in the setup."""
    force = name == "ft_wrench"
    columns = ("force", "torque") if force else ("position", "angle", "quaternion", "rotation_vector")
    allowed = {*_SHARED, "part", "sign", "offset", "clock", *columns}
    _refuse_unknown(entry, allowed, where)
    turns = [key for key in columns[1:] if key in entry]
    if not force and len(turns) > 1:
        raise DatasetError(f"{where}: gives {' and '.join(turns)}; give the rotation only once")
    found: dict[str, Any] = {}
    for key, value in entry.items():
        place = f"{where}.{key}"
        if key in _COUNTS:
            found[key] = _names(value, _COUNTS[key], place)
        elif key == "frame" and value == CONTACT:
            found["turned_by_contact"] = True
        elif key == "clock" and value == CONTACT:
            found[key] = CONTACT
        elif key in ("unit", "offset"):
            found[key] = (_unit if key == "unit" else _offset)(value, place, force)
        else:
            found[key] = _OTHERS[key](value, place)
    if name == "object_pose" and found.get("clock") == CONTACT:
        raise DatasetError(f"{where}.clock: the object's clock is the reference for the others; leave it out")
    if "turned_by_contact" in found and not force:
        raise DatasetError(f"{where}.frame: only a force can be rotated to fit the contact; give a pose here")
    return ChannelSetup(**found)


_COUNTS = {
    "time": (1, 2), "position": (1, 2, 3), "angle": (1,), "quaternion": (1, 4), "rotation_vector": (1, 3),
    "force": (1, 2, 3), "torque": (1,),
}  # fmt: skip
"""Allowed numbers of columns for each quantity."""


def _name(value: object, where: str) -> str:
    """The name of a file, part or column; a column may be a number."""
    if isinstance(value, int) and not isinstance(value, bool) and value >= 0:
        return str(value)
    if value is None:
        raise DatasetError(f"{where}: fill in the column, by its name or its number from 0")
    return parsing.text(value, where)


def _names(value: object, counts: Sequence[int], where: str) -> tuple[str, ...]:
    listed = value if isinstance(value, list) else [value]
    if len(listed) not in counts:
        wanted = " or ".join(map(str, counts))
        raise DatasetError(f"{where}: needs {wanted} columns, got {parsing.shown(value)}")
    return tuple(_name(one, where) for one in listed)


def _unit(value: object, where: str, force: bool) -> dict[str, float]:
    """Units by quantity; a single unit is that of the position or of the force."""
    if isinstance(value, str):
        said = {"force" if force and value in UNITS["force"] else "position": value}
    else:
        said = parsing.mapping(value, where)
    result = {}
    for kind, unit in said.items():
        if kind not in UNITS:
            raise DatasetError(f"{where}: {parsing.shown(kind)} has no unit; choose from {', '.join(UNITS)}")
        if not isinstance(unit, str) or unit not in UNITS[kind]:
            place = where if isinstance(value, str) else f"{where}.{kind}"
            raise DatasetError(f"{place}: must be one of {', '.join(UNITS[kind])}, got {parsing.shown(unit)}")
        result[kind] = UNITS[kind][unit]
    return result


def _up(value: object, where: str) -> object:
    if value not in UPWARD:
        raise DatasetError(f"{where}: must be one of {', '.join(UPWARD)}, got {parsing.shown(value)}")
    return value


def _frame(value: object, where: str) -> FloatArray:
    """A frame from x, y and an angle; from x, y, z and a quaternion; or from a matrix of four rows."""
    if not isinstance(value, list):
        raise DatasetError(
            f"{where}: give the pose of the source's frame in the table's as [x, y, theta], m and rad (or"
            f" 45 deg), [x, y, z, qx, qy, qz, qw] or a matrix of four rows, got {parsing.shown(value)}"
        )
    pose = np.eye(4)
    if len(value) == 4:
        pose = parsing.table(value, 4, where)
    elif len(value) == 3:
        x, y = parsing.number(value[0], where), parsing.number(value[1], where)
        c, s = math.cos(angle := _angle(value[2], where)), math.sin(angle)
        pose[:3] = [[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.0]]
    elif len(value) == 7:
        from scipy.spatial.transform import Rotation

        numbers = np.array([parsing.number(one, where) for one in value])
        if abs(np.linalg.norm(numbers[3:]) - 1.0) > 0.01:
            raise DatasetError(f"{where}: qx, qy, qz, qw must have length 1")
        pose[:3, :3], pose[:3, 3] = Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3]
    else:
        raise DatasetError(f"{where}: needs 3, 7 or 4 by 4 numbers, got {parsing.shown(value)}")
    turn = pose[:3, :3]
    if not (np.isfinite(pose).all() and np.allclose(turn @ turn.T, np.eye(3), atol=1e-3)
            and np.linalg.det(turn) > 0.0 and np.allclose(pose[3], [0, 0, 0, 1])):  # fmt: skip
        raise DatasetError(
            f"{where}: is not a pose; its rotation needs orthogonal rows of length 1, right-handed"
        )
    return pose


def _angle(value: object, where: str) -> float:
    """An angle in rad from a number or a text such as `45 deg`."""
    match = re.fullmatch(r"\s*([-+\d.]+)\s*(deg|rad)\s*", value) if isinstance(value, str) else None
    if match is None:
        return parsing.number(value, where)
    try:
        return float(match[1]) * csv_files.ANGLES[match[2]]
    except ValueError:
        raise DatasetError(f"{where}: {parsing.shown(value)} is not an angle") from None


def _sign(value: object, where: str) -> float:
    if value not in (1, -1) or isinstance(value, bool):
        raise DatasetError(f"{where}: must be 1 or -1, got {parsing.shown(value)}")
    return float(value)


def _offset(value: object, where: str, force: bool) -> FloatArray:
    if not isinstance(value, list) or len(value) not in (2, 3):
        said = "[fx, fy], N" if force else "[x, y], [x, y, theta] of the object or [x, y, z] of the finger, m"
        raise DatasetError(f"{where}: must be {said}, got {parsing.shown(value)}")
    numbers = [parsing.number(one, where) for one in value[:2]]
    return np.array([*numbers, *(_angle(one, where) for one in value[2:])])


def _clock(value: object, where: str) -> float:
    return parsing.number(value, f"{where} (s to add to the stamps, or contact)")


_OTHERS: Mapping[str, Callable[[object, str], object]] = {
    "source": _name, "part": _name, "push": _name, "rate": _RATE.read, "up": _up, "frame": _frame,
    "sign": _sign, "clock": _clock,
}  # fmt: skip
"""Readers of the keys that all channels read alike, given value and place."""
