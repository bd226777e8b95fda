"""A first setup.yaml out of the files alone, with what was concluded from what, for its user to correct."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slipmap.models.measurements.importing.files import find_files, read_sources
from slipmap.models.measurements.importing.mapping import TIMES, seconds_and_nanoseconds
from slipmap.models.measurements.importing.source import Source
from slipmap.models.measurements.push_dataset import DatasetError
from slipmap.models.physics.cell_grid import FloatArray

_FINGER = ("tip", "finger", "tcp", "tool", "pusher", "effector", "ee_", "eef", "robot", "probe", "flange")
_OBJECT = ("object", "obj", "block", "body", "vicon", "marker", "tag", "slider", "box", "item")
_FORCE = ("force", "wrench", "ft", "netft", "load")
_MILLIMETRES = 5.0  # above which no position on a table is in m
_FULL_TURN = 6.6  # rad
_SLOWEST = 0.5  # s from row to row; no sensor is slower
_MOST_FILES = 3  # of each kind that are looked into
_PLANE = re.compile(r"(.*?)(x)([\])]?)$", re.IGNORECASE)


@dataclass(frozen=True)
class _Found:
    """Columns that may be a position or a force."""

    source: Source
    file: str  # its name for a setup.yaml
    columns: tuple[str, ...]  # x, y and, where it is there, z
    turn: tuple[str, tuple[str, ...]] | None  # kind and columns
    values: FloatArray  # (T, 2 or 3) as they stand

    @property
    def text(self) -> str:
        """What its names say."""
        return " ".join((self.file, self.source.part, *self.columns)).lower()

    def speaks_of(self, words: Sequence[str]) -> int:
        """How surely its names speak of something, by words of which the first says most."""
        return sum(len(words) - place for place, word in enumerate(words) if word in self.text)


def guess_setup(sources: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> str:
    """The text of a setup.yaml for files of a laboratory; comments say what was concluded from what.

    Outline and finger are left to be filled in. Nothing is certain: pictures and `slipmap check` tell whether
    it was right.

    Raises:
        DatasetError: a file cannot be read, or nothing in the files looks like the pose of an object.

    Example:
        >>> import pathlib, tempfile
        >>> import slipmap
        >>> file = pathlib.Path(tempfile.mkdtemp()) / "push.csv"
        >>> _ = file.write_text("t,block_x,block_y,block_yaw\\n0,0.1,0.2,0\\n0.01,0.1,0.2,0\\n")
        >>> print(slipmap.guess_setup(file).splitlines()[6])
          angle: block_yaw
    """
    paths = [Path(one) for one in ([sources] if isinstance(sources, str | os.PathLike) else sources)]
    files = find_files(paths)
    found: list[_Found] = []
    patterns = _patterns(list(files))
    for pattern, names in patterns.items():
        for source in read_sources(files[names[0]], str(files[names[0]])):
            found += list(_candidates(source, pattern))
    force = _best([one for one in found if _is_force(one)], _FORCE)
    places = [one for one in found if not _is_force(one)]
    poses = [one for one in places if one.turn is not None] or places
    finger = _best([one for one in places if one.speaks_of(_FINGER)], _FINGER)
    pose = _best([one for one in poses if one is not finger], _OBJECT)
    if pose is None:
        listed = "; ".join(one.source.listed for one in found[:3])
        raise DatasetError(
            f"{', '.join(files)}: nothing looks like the pose of an object, x and y with an angle or a"
            f" quaternion. {listed or 'Are there columns with names?'}"
        )
    if finger is None:
        finger = _farthest([one for one in places if one is not pose])
    lines = [
        "# Written by `slipmap import --guess`: correct it, then run `slipmap import` with it.",
        "# The corners of the footprint in the object's frame, m, or --object FILE of `slipmap object`:",
        "object: {outline: null}",
        "finger: {radius: null}  # m",
    ]
    for name, one in (("object_pose", pose), ("tip_pose", finger), ("ft_wrench", force)):
        lines += _entry(name, one, several=len(patterns) > 1)
    return "\n".join(lines) + "\n"


def _patterns(names: Sequence[str]) -> dict[str, list[str]]:
    """Files that differ only in numbers, under a pattern with `*` for these."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(re.sub(r"\d+", "*", name), []).append(name)
    return {pattern if len(group) > 1 else group[0]: group[:_MOST_FILES] for pattern, group in groups.items()}


def _candidates(source: Source, file: str) -> Iterator[_Found]:
    """All triples and pairs of columns of a table that differ in x, y and z."""
    names = list(source.columns)
    for name in names:
        match = _PLANE.match(name)
        if match is None or re.search(r"(orient|quat|rot|torque|moment|angular|^q|[._]q)", name, re.I):
            stem = re.fullmatch(r"(.*[._])0", name)
            if stem is None or not {f"{stem[1]}{k}" for k in range(3)} <= set(names):
                continue
            columns: tuple[str, ...] = tuple(f"{stem[1]}{k}" for k in range(3))
        else:
            axes = ("Y", "Z") if match[2] == "X" else ("y", "z")
            others = [f"{match[1]}{axis}{match[3]}" for axis in axes]
            if others[0] not in source.columns:
                continue
            columns = (name, *(other for other in others if other in source.columns))
        try:
            values = np.column_stack([source.numbers(column) for column in columns])
        except DatasetError:
            continue
        if np.isfinite(values).all(axis=1).any():
            yield _Found(source, file, columns, _turn(source, columns[0]), values)


def _turn(source: Source, first: str) -> tuple[str, tuple[str, ...]] | None:
    """Quaternion, rotation vector or angle that goes with a position whose first column this is."""
    names = set(source.columns)
    stem = re.sub(r"(position|translation|pos|trans)?[._]?[xX0]$", "", first)
    for quaternion in ("orientation.", "rotation.", "quat_", "quat.", "q", "_q", ".q", "_quat_"):
        columns = tuple(f"{stem}{quaternion}{axis}" for axis in "xyzw")
        if set(columns) <= names:
            return "quaternion", columns
    if first.endswith("_0") and {f"{stem}_{k}" for k in (3, 4, 5)} <= names:
        return "rotation_vector", tuple(f"{stem}_{k}" for k in (3, 4, 5))
    for angle in ("theta", "yaw", "angle", "heading", "phi", "rz"):
        for column in (f"{stem}{angle}", f"{stem}_{angle}", f"{stem}.{angle}"):
            if column in names:
                return "angle", (column,)
    alone = [name for name in names if re.search(r"(^|[._])[qQ]w$|[qQ]uat\w*[._]w$", name)]
    if len(alone) == 1:  # of the whole table, whatever it is called
        columns = tuple(alone[0][:-1] + axis for axis in "xyzw")
        if set(columns) <= names:
            return "quaternion", columns
    return None


def _is_force(one: _Found) -> bool:
    last = one.columns[0].lower()
    return bool(re.search(r"force|wrench|(^|[._])f_?x$", last))


def _best(found: Sequence[_Found], words: Sequence[str]) -> _Found | None:
    """The one whose names speak most of what is sought; that with a turn of two equal ones."""
    return max(found, key=lambda one: (one.speaks_of(words), one.turn is not None), default=None)


def _farthest(found: Sequence[_Found]) -> _Found | None:
    """The one that goes the longest way: a finger goes back and forth."""
    return max(found, key=lambda one: float(np.nansum(np.abs(np.diff(one.values, axis=0)))), default=None)


def _entry(name: str, one: _Found | None, several: bool) -> list[str]:
    """The lines of a channel."""
    if one is None:
        return [f"{name}: null  # nothing looks like it"]
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
    if time:
        lines.append(f"  time: {time}")
    lines += _units(one, force)
    return lines


def _time(source: Source) -> str:
    if source.time is not None:
        return ""
    names = list(source.columns)
    for whole, part in seconds_and_nanoseconds(source):
        return f"[{_quoted(whole)}, {_quoted(part)}]"
    if any(name in source.columns for name in TIMES):
        return next(_quoted(name) for name in TIMES if name in source.columns)
    likely = [name for name in names if re.search(r"time|stamp|^t$|\bt_", name, re.I)]
    if likely:
        return _quoted(likely[0])
    return "null  # which column is it? Or say `rate: 100`, Hz"


def _units(one: _Found, force: bool) -> list[str]:
    """What sizes tell: mm, degrees, milliseconds, and the axis that points up."""
    known = one.values[np.isfinite(one.values).all(axis=1)]
    units = {}
    lines = []
    time = next((name for name in TIMES if name in one.source.columns), "")
    if one.source.time is None and time:
        try:
            step = float(np.nanmedian(np.diff(one.source.numbers(time))))
        except DatasetError:  # words, such as ISO times
            step = 0.0
        if _SLOWEST < step < 1e3 * _SLOWEST:
            units["time"] = "ms"
    if not force and one.source.length == "m" and np.ptp(known, axis=0).max(initial=0.0) > _MILLIMETRES:
        units["position"] = "mm"
    if not force and one.turn is not None and one.turn[0] == "angle":
        angle = one.source.numbers(one.turn[1][0])
        if np.nanmax(np.abs(angle), initial=0.0) > _FULL_TURN:
            units["angle"] = "deg"
    if units:
        said = ", ".join(f"{kind}: {unit}" for kind, unit in units.items())
        lines.append(f"  unit: {{{said}}}  # by the size of the numbers")
    if force:
        return lines
    if known.shape[1] == 3:
        spread = np.percentile(known, 95, axis=0) - np.percentile(known, 5, axis=0)
        flattest = "xyz"[int(np.argmin(spread))]
        sure = spread.min() < 0.2 * np.median(spread)
        if sure and flattest != "z":
            lines.append(f"  up: {flattest}  # its {flattest} hardly changes")
    return lines


def _quoted(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z_][\w./ -]*", name) and name == name.strip() else f'"{name}"'
