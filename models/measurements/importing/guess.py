"""Guess a first setup.yaml from the files alone, with comments on how, for the user to correct."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from slipmap.models.measurements.importing.files import find_files, read_sources
from slipmap.models.measurements.importing.import_setup import UNITS
from slipmap.models.measurements.importing.mapping import TIMES, seconds_and_nanoseconds
from slipmap.models.measurements.importing.source import Source
from slipmap.models.measurements.trial import DatasetError
from slipmap.models.physics.cell_grid import FloatArray

_NO_NAMES = (
    "Do the columns have names? If not, write the setup by hand with columns numbered from 0, as"
    " docs/import.md shows"
)
_FINGER = ("tip", "finger", "tcp", "tool", "pusher", "effector", "ee_", "eef", "robot", "probe", "flange")
_OBJECT = ("object", "obj", "block", "body", "vicon", "marker", "tag", "slider", "box", "item")
_FORCE = ("force", "wrench", "ft", "netft", "load")
_ANGLES = ("theta", "yaw", "angle", "heading", "phi", "rz")
_MILLIMETRES = 5.0  # above which no position on a table is in m
_MANY_MILLIMETRES = 200.0  # over which pushes usually spread, so that less may be in cm
_FULL_TURN = 6.6  # rad
_FLAT = 0.2  # share of the range of other axes in which a height varies
_SLOWEST = 0.5  # s from row to row; no sensor is slower
_MOST_CHANGES = 0.1  # share of rows at which a column that numbers pushes changes
_MOST_FILES = 3  # files of each kind that are examined
_UNIT = re.compile(r"[ _.]?[\[(]?(?<=[ _.\[(])(ns|us|ms|s|um|mm|cm|m|deg|rad|mN|kN|N)[\])]?$")
_ODD_UNIT = re.compile(r"[ _.]?[\[(]([^\W\d][^\[\]()]*)[\])]$")  # in brackets, whether known or not
_PLANE = re.compile(r"(.*?)(x)([\])]?)$", re.IGNORECASE)
_AXIS_FIRST = re.compile(rf"()(x)([._]({'|'.join((*_FINGER, *_OBJECT))}).*)$", re.IGNORECASE)
_FORCE_NAME = re.compile(r"force|wrench|(^|[._])f_?x$")
_PUSH = re.compile(r"(push|trial)([_ ]?(id|no|nr|number|index|\d+))?$", re.IGNORECASE)


@dataclass(frozen=True)
class _Found:
    """Columns that may be a position or a force."""

    source: Source
    file: str  # its name for a setup.yaml
    columns: tuple[str, ...]  # x, y and, if present, z
    turn: tuple[str, tuple[str, ...]] | None  # kind and columns
    values: FloatArray  # (T, 2 or 3), unconverted

    @property
    def text(self) -> str:
        """All its names, in lower case."""
        return " ".join((self.file, self.source.part, *self.columns)).lower()

    def speaks_of(self, words: Sequence[str]) -> int:
        """How strongly its names suggest something, given words in order of weight."""
        return sum(len(words) - place for place, word in enumerate(words) if word in self.text)


def guess_setup(sources: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> str:
    """The text of a setup.yaml for a laboratory's files; comments give the reason for each guess.

    Outline and finger are left to be filled in. Nothing is certain: pictures and `slipmap check` show whether
    the guess is right.

    Raises:
        DatasetError: a file cannot be read, or nothing in the files looks like the pose of an object.

    Example:
        >>> import pathlib, tempfile
        >>> from slipmap.models.measurements.importing import guess_setup
        >>> file = pathlib.Path(tempfile.mkdtemp()) / "push.csv"
        >>> _ = file.write_text("t,block_x,block_y,block_yaw\\n0,0.1,0.2,0\\n0.01,0.1,0.2,0\\n")
        >>> print(guess_setup(file).splitlines()[6])
          angle: block_yaw
    """
    files = find_files(sources)
    found: list[_Found] = []
    odd: dict[str, str] = {}
    patterns = _patterns(list(files))
    for pattern, names in patterns.items():
        for source in read_sources(files[names[0]], str(files[names[0]])):
            found += list(_candidates(source, pattern))
            odd |= _odd_units(source)
    force = _best([one for one in found if _is_force(one)], _FORCE)
    places = [one for one in found if not _is_force(one)]
    finger = _best([one for one in places if one.speaks_of(_FINGER)], _FINGER)
    others = [one for one in places if one is not finger]
    pose = _best([one for one in others if one.turn is not None] or others, _OBJECT)
    if pose is None:
        listed = "; ".join([*odd.values(), *(one.source.listed for one in found[:3])])
        raise DatasetError(
            f"{', '.join(files)}: nothing looks like an object's pose, which is x and y with an angle or a"
            f" quaternion. {listed or _NO_NAMES}"
        )
    if finger is None:
        finger = _farthest([one for one in places if one is not pose])
    lines = [
        "# Written by `slipmap import --guess`: correct it, then run `slipmap import` with it.",
        "# The corners of the footprint in the object frame, m; or use --object FILE from `slipmap object`:",
        "object: {outline: null}",
        "finger: {radius: null}  # m",
    ]
    up = _up(pose)
    for name, one in (("object_pose", pose), ("tip_pose", finger), ("ft_wrench", force)):
        lines += _entry(
            name, one, several=len(patterns) > 1, missing=odd.get(name, "no columns look like it")
        )
        turned = up != "z" and one is not None and one.file == pose.file and len(one.columns) == 3
        if turned and name != "ft_wrench":
            lines.append(f"  up: {up}  # the object's {up} hardly changes")
    return "\n".join(lines) + "\n"


def _patterns(names: Sequence[str]) -> dict[str, list[str]]:
    """Groups of files that differ only in numbers, by a pattern with `*` for these."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(re.sub(r"\d+", "*", name), []).append(name)
    return {pattern if len(group) > 1 else group[0]: group[:_MOST_FILES] for pattern, group in groups.items()}


def _candidates(source: Source, file: str) -> Iterator[_Found]:
    """All triples and pairs of columns of a table whose names differ in x, y and z."""
    names = list(source.columns)
    for name in names:
        end = name[len(_bare(name)) :]  # its unit
        match = _AXIS_FIRST.match(_bare(name)) or _PLANE.match(_bare(name))
        if match is None or re.search(r"(orient|quat|rot|torque|moment|angular|^q|[._]q)", name, re.I):
            stem = re.fullmatch(r"(.*[._])0", name)
            if stem is None or not {f"{stem[1]}{k}" for k in range(3)} <= set(names):
                continue
            columns: tuple[str, ...] = tuple(f"{stem[1]}{k}" for k in range(3))
        else:
            axes = ("Y", "Z") if match[2] == "X" else ("y", "z")
            others = [f"{match[1]}{axis}{match[3]}{end}" for axis in axes]
            if others[0] not in source.columns or _is_rotation(source, match[1], match[2] + match[3] + end):
                continue
            columns = (name, *(other for other in others if other in source.columns))
        try:
            values = np.column_stack([source.numbers(column) for column in columns])
        except DatasetError:
            if not source.decimal:  # its commas may be decimal or separate thousands
                raise
            continue
        if np.isfinite(values).all(axis=1).any():
            yield _Found(source, file, columns, _turn(source, columns[0]), values)


def _is_rotation(source: Source, stem: str, rest: str) -> bool:
    """Whether columns such as rx, ry, rz are a rotation, since there are x, y, z as well."""
    return stem[-1:] in ("r", "R") and {f"{stem[:-1]}{rest}", f"{stem}{rest}"} <= set(source.columns)


def _turn(source: Source, first: str) -> tuple[str, tuple[str, ...]] | None:
    """Quaternion, rotation vector or angle that belongs to a position, given its first column."""
    names = set(source.columns)
    bare = {_bare(name): name for name in source.columns}
    stem = re.sub(r"(position|translation|pos|trans)?[._]?[xX0]$", "", _bare(first))
    for quaternion in ("orientation.", "rotation.", "quat_", "quat.", "q", "_q", ".q", "_quat_"):
        columns = tuple(f"{stem}{quaternion}{axis}" for axis in "xyzw")
        if set(columns) <= names:
            return "quaternion", columns
    if {f"{stem}r{axis}" for axis in "xyz"} <= names:
        return "rotation_vector", tuple(f"{stem}r{axis}" for axis in "xyz")
    if first.endswith("_0") and {f"{stem}_{k}" for k in (3, 4, 5)} <= names:
        return "rotation_vector", tuple(f"{stem}_{k}" for k in (3, 4, 5))
    axis_first = _AXIS_FIRST.match(_bare(first))
    for angle in _ANGLES:
        after = (f"{angle}{axis_first[3]}",) if axis_first else ()
        for column in (*after, f"{stem}{angle}", f"{stem}_{angle}", f"{stem}.{angle}"):
            if column in bare:
                return "angle", (bare[column],)
    plain = bare.get(stem.rstrip("._"), "")  # such as block_deg beside block_x_mm
    if _unit(plain, "angle"):
        return "angle", (plain,)
    alone = [name for name in names if re.search(r"(^|[._])[qQ]w$|[qQ]uat\w*[._]w$", name)]
    if len(alone) == 1:  # the only one in the table, whatever its name
        columns = tuple(alone[0][:-1] + axis for axis in "xyzw")
        if set(columns) <= names:
            return "quaternion", columns
    angles = [name for name in names if _bare(name).lower() in _ANGLES]
    return ("angle", (angles[0],)) if len(angles) == 1 else None


def _bare(name: str) -> str:
    """The name of a column without its unit."""
    return _UNIT.sub("", name) or name


def _unit(name: str, kind: str) -> str:
    """The unit of a quantity of this kind at the end of a column's name; empty if there is none."""
    found = _UNIT.search(name)
    return found[1] if found and found[1] in UNITS[kind] else ""


def _is_force(one: _Found) -> bool:
    last = _bare(one.columns[0]).lower()
    return bool(_FORCE_NAME.search(last))


def _best(found: Sequence[_Found], words: Sequence[str]) -> _Found | None:
    """The one whose names match the words best; of two equal ones, the one with a rotation."""
    return max(found, key=lambda one: (one.speaks_of(words), one.turn is not None), default=None)


def _farthest(found: Sequence[_Found]) -> _Found | None:
    """The one with the longest path, since a finger moves back and forth."""
    return max(found, key=lambda one: float(np.nansum(np.abs(np.diff(one.values, axis=0)))), default=None)


def _odd_units(source: Source) -> dict[str, str]:
    """What is said of columns that would be a channel, by its name, if their unit were known."""
    said: dict[str, str] = {}
    for column in source.columns:
        unit = _ODD_UNIT.search(column)
        if unit is None or any(unit[1] in known for known in UNITS.values()):
            continue
        stem = column[: unit.start()]
        axis = _PLANE.match(stem)
        if (
            axis is None
            or f"{axis[1]}{'Y' if axis[2] == 'X' else 'y'}{axis[3]}{unit[0]}" not in source.columns
        ):
            continue
        force = bool(_FORCE_NAME.search(stem.lower()))
        finger = any(word in stem.lower() for word in _FINGER)
        name = "ft_wrench" if force else "tip_pose" if finger else "object_pose"
        known = ", ".join(UNITS["force" if force else "position"])
        said.setdefault(
            name, f"the unit of {_quoted(column)} is unknown, so convert it; known units are {known}"
        )
    return said


def _entry(name: str, one: _Found | None, several: bool, missing: str) -> list[str]:
    """The lines of a channel in a setup.yaml; `missing` is why there are no columns for it."""
    if one is None:
        return [f"{name}: null  # {missing}"]
    force = name == "ft_wrench"
    lines = [f"{name}:  # by its names{'' if force or one.turn else ', without an angle'}"]
    if several:
        lines.append(f"  source: {_quoted(one.file)}")
    if one.source.part:
        lines.append(f"  part: {_quoted(one.source.part)}")
    lines.append(f"  {'force' if force else 'position'}: [{', '.join(map(_quoted, one.columns))}]")
    if one.turn is not None and name == "object_pose":
        kind, columns = one.turn
        said = ", ".join(map(_quoted, columns))
        lines.append(f"  {kind}: {said if len(columns) == 1 else f'[{said}]'}")
    elif name == "object_pose":
        lines.append("  angle: null  # which column is it?")
    time = _time(one.source)
    if one.source.time is None:
        said = ", ".join(map(_quoted, time))
        unknown = "null  # which column is it? Or give `rate: 100`, Hz"
        lines.append(f"  time: {(said if len(time) == 1 else f'[{said}]') if time else unknown}")
    lines += [
        f"  push: {_quoted(column)}  # it is constant in runs of rows"
        for column in one.source.columns
        if _numbers_pushes(one.source, column)
    ][:1]
    lines += _units(one, name, time)
    return lines


def _time(source: Source) -> tuple[str, ...]:
    """The column of time, or those of seconds and nanoseconds; none if not found, or if known anyway."""
    if source.time is not None:
        return ()
    for pair in seconds_and_nanoseconds(source):
        return pair
    usual = [name for name in TIMES if name in source.columns]
    likely = [name for name in source.columns if re.search(r"time|stamp|^t$|\bt_", name, re.I)]
    return tuple((usual or likely)[:1])


def _numbers_pushes(source: Source, column: str) -> bool:
    """Whether a column that numbers pushes by its name also does by its values: constant in runs."""
    if not _PUSH.match(column):
        return False
    cells = source.texts(column)
    changes = sum(one != other for one, other in pairwise(cells))
    return 0 < changes < _MOST_CHANGES * len(cells) and changes == len(set(cells)) - 1


def _units(one: _Found, name: str, time: Sequence[str]) -> list[str]:
    """A line for units (mm, degrees, milliseconds), from names or sizes of numbers."""
    force = name == "ft_wrench"
    known = one.values[np.isfinite(one.values).all(axis=1)]
    named = {"force" if force else "position": _unit(one.columns[0], "force" if force else "position")}
    sizes, or_cm = {}, ""
    if len(time) == 1:
        named["time"] = _unit(time[0], "time")
        try:
            steps = np.diff(one.source.numbers(time[0]))
            step = float(np.median(steps[np.isfinite(steps)])) if np.isfinite(steps).any() else 0.0
        except DatasetError:  # words, such as ISO times
            step = 0.0
        if _SLOWEST < step < 1e3 * _SLOWEST:
            sizes["time"] = "ms"
    if not force and one.source.length == "m" and np.ptp(known, axis=0).max(initial=0.0) > _MILLIMETRES:
        sizes["position"] = "mm"
        # No travel tells cm from mm without the outline; small numbers leave both open.
        if np.ptp(known, axis=0).max() < _MANY_MILLIMETRES:
            or_cm = " (or cm?)"
    if name == "object_pose" and one.turn is not None and one.turn[0] == "angle":
        named["angle"] = _unit(one.turn[1][0], "angle")
        angle = one.source.numbers(one.turn[1][0])
        if one.source.angle == "rad" and np.nanmax(np.abs(angle), initial=0.0) > _FULL_TURN:
            sizes["angle"] = "deg"
    named = {kind: unit for kind, unit in named.items() if unit}
    units = {
        kind: (sizes | named)[kind]
        for kind in ("time", "position", "angle", "force")
        if kind in sizes or UNITS[kind].get(named.get(kind, ""), 1.0) != 1.0
    }
    lines = []
    if units:
        said = ", ".join(f"{kind}: {unit}" for kind, unit in units.items())
        of_size = f"the size of the numbers{or_cm * ('position' not in named)}"
        by = [words for words, group in (("names", named), (of_size, sizes.keys() - named))
              if units.keys() & group]  # fmt: skip
        lines.append(f"  unit: {{{said}}}  # by {' and '.join(by)}")
    return lines


def _up(pose: _Found) -> str:
    """The axis of the object's position that points up: z unless another one hardly changes."""
    known = pose.values[np.isfinite(pose.values).all(axis=1)]
    if known.shape[1] < 3:
        return "z"
    spread = np.percentile(known, 95, axis=0) - np.percentile(known, 5, axis=0)
    flattest = int(np.argmin(spread))
    sure = spread[flattest] < _FLAT * spread[2] and spread[2] > _FLAT * spread.max()
    return "xyz"[flattest] if sure else "z"


def _quoted(name: str) -> str:
    plain = re.fullmatch(r"[A-Za-z_][\w./ -]*", name) and name == name.strip()
    return name if plain else json.dumps(name, ensure_ascii=False)
