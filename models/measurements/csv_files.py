"""Pushes as CSV: one file per push, a header line of column names, empty cells where a sensor has no row."""

import csv
import io
import math
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slipmap.models.measurements import parsing
from slipmap.models.measurements.trial import CHANNELS, DatasetError, Role, Trial
from slipmap.models.measurements.trial_tables import IN_DEGREES, trial_from_tables
from slipmap.models.physics.cell_grid import FloatArray

CSV_ENDINGS = (".csv",)

LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
ANGLES = {"rad": 1.0, "deg": 0.017453292519943295}
FORCES = {"N": 1.0, "mN": 1e-3, "kN": 1e3}
TORQUES = {"N m": 1.0, "N mm": 1e-3, "mN m": 1e-3}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_UNITS: Mapping[str, Mapping[str, float]] = {
    "t": TIMES,
    "object_x": LENGTHS,
    "object_y": LENGTHS,
    "object_theta": ANGLES,
    "tip_x": LENGTHS,
    "tip_y": LENGTHS,
    "tip_theta": ANGLES,
    "force_x": FORCES,
    "force_y": FORCES,
    "force_tau": TORQUES,
}
"""Our column names, and the factors from the units that a column may have to SI."""

_DEGREES = " If so, write `csv: {object_theta: {unit: deg}}` into the YAML file of --object"

PUSH_COLUMN = "push_id"
"""Optional column that divides a file into its pushes."""

_OPTIONAL = CHANNELS["ft_wrench"]
_FORCE, _TORQUE = _OPTIONAL[:2], _OPTIONAL[2]
_ANGLE = "tip_theta"  # optional too
_REQUIRED = tuple(name for name in _UNITS if name not in (*_OPTIONAL, _ANGLE))


class CsvColumns(NamedTuple):
    """Columns of CSV files."""

    names: Mapping[str, str]  # from our name to the name in the files
    # from our name to the factor that converts its numbers to s, m, rad, N or N·m
    factors: Mapping[str, float]

    @property
    def expected(self) -> str:
        """The expected columns, for error messages."""
        required, optional = (
            ", ".join(self.names[name] for name in group) for group in (_REQUIRED, _OPTIONAL)
        )
        turning = f"if the finger turns, {self.names[_ANGLE]} too"
        return f"expected columns are {required} and, if force was measured, {optional}; {turning}"


STANDARD = CsvColumns({name: name for name in _UNITS}, dict.fromkeys(_UNITS, 1.0))
"""Our own names, in s, m, rad, N and N·m."""


def parse_columns(value: object, where: str) -> CsvColumns:
    """Columns from the key `csv`, which maps our names to those in the files, or to `{column: ..., unit:
    ...}`.

    Args:
        value: as parsed; None for the standard names.
        where: the file and key, for error messages.

    Raises:
        DatasetError: an unknown name or unit, or one column for two quantities.
    """
    if value is None:
        return STANDARD
    names, factors = dict(STANDARD.names), dict(STANDARD.factors)
    for name, entry in parsing.mapping(value, where).items():
        place = f"{where}.{name}"
        if name not in _UNITS:
            raise DatasetError(f"{place}: unknown quantity; choose from {', '.join(_UNITS)}")
        told = {"column": entry} if isinstance(entry, str) else parsing.mapping(entry, place)
        for key in told:
            if key not in ("column", "unit"):
                raise DatasetError(f"{place}: unknown key {parsing.shown(key)}; the keys are column and unit")
        names[name] = parsing.text(told.get("column", name), f"{place}.column")
        unit = told.get("unit", next(iter(_UNITS[name])))
        if not isinstance(unit, str) or unit not in _UNITS[name]:
            raise DatasetError(
                f"{place}.unit: must be one of {', '.join(_UNITS[name])}, got {parsing.shown(unit)}"
            )
        factors[name] = _UNITS[name][unit]
    for name, column in names.items():
        others = [other for other, same in names.items() if same == column and other != name]
        if others:
            raise DatasetError(
                f"{where}: the column {parsing.shown(column)} cannot be both {name} and {others[0]}"
            )
    return CsvColumns(names, factors)


def read_csv_trials(
    name: str, role: Role, content: bytes, where: str, columns: CsvColumns = STANDARD
) -> tuple[list[Trial], list[str]]:
    """The pushes of one file, in s, m, rad, N and N·m unless `columns` says otherwise; the force is that on
    the object.

    Channels share the column t but need not share rates: a channel has a row where its cells are filled. If
    there is a column push_id, each of its values is a push, named after the file and the value, in order of
    first appearance. The torque is 0 where the file has none.

    Raises:
        DatasetError: missing columns, cells that are not numbers, and what `trial_from_tables` refuses. Rows
            count from 0 below the header.
    """
    table = _table(content, where, columns)
    warnings = []
    if table.unknown:
        listed = ", ".join(parsing.shown(unknown) for unknown in table.unknown)
        several = len(table.unknown) > 1
        warnings.append(
            f"{where}: the column{'s' if several else ''} {listed} {'are' if several else 'is'} unknown and"
            f" ignored; {columns.expected}"
        )
    trials = []
    for push, rows in table.pushes.items():
        place = f"{where}, {PUSH_COLUMN} {push}" if push else where
        tables = _channels({ours: values[rows] for ours, values in table.values.items()}, place, columns)
        trial, doubts = trial_from_tables(f"{name}#{push}" if push else name, role, tables, place)
        trials.append(trial)
        warnings += [doubt + _DEGREES * doubt.endswith(IN_DEGREES) for doubt in doubts]
    return trials, warnings


class _Table(NamedTuple):
    """A file's numbers by our names, the rows of each push, and the names of unknown columns."""

    values: Mapping[str, FloatArray]
    pushes: Mapping[str, NDArray[np.int_]]
    unknown: Sequence[str]


def _channels(column: Mapping[str, FloatArray], where: str, columns: CsvColumns) -> dict[str, FloatArray]:
    tables = {}
    for channel, names in CHANNELS.items():
        if all(ours in column for ours in names):
            values = np.column_stack([column[ours] for ours in names])
            also = [column[_ANGLE]] if channel == "tip_pose" and _ANGLE in column else []
            tables[channel] = np.column_stack([column["t"], values, *also])
            untimed = np.flatnonzero(np.isnan(column["t"]) & ~np.isnan(values).all(axis=1))
            if len(untimed):
                time = columns.names["t"]
                raise DatasetError(
                    f"{where}, {channel}, row {untimed[0]}: has values but no time {time}; fill it in"
                )
    if "ft_wrench" in tables and np.isnan(tables["ft_wrench"][:, 1:3]).all():
        del tables["ft_wrench"]  # the columns are there, but nothing was measured
    return tables


def _table(content: bytes, where: str, columns: CsvColumns) -> _Table:
    try:
        lines = list(csv.reader(io.StringIO(content.decode("utf-8-sig"), newline="")))
    except (csv.Error, ValueError) as error:
        raise DatasetError(
            f"{where}: not readable as CSV ({parsing.shown_error(error)}); save it as text in UTF-8"
        ) from None
    if not lines:
        raise DatasetError(f"{where}: the file is empty; {columns.expected}")
    header = [name.strip() for name in lines[0]]
    _refuse_header(header, where, columns)
    ours = {theirs: name for name, theirs in columns.names.items()}
    counted = Counter(name for name in header if name in ours or name == PUSH_COLUMN)
    name, uses = counted.most_common(1)[0]
    if uses > 1:
        raise DatasetError(
            f"{where}: the header has the column {parsing.shown(name)} {uses} times; {columns.expected}"
        )
    rows: list[list[float]] = []
    used = [(place, name) for place, name in enumerate(header) if name in ours]
    push_place = header.index(PUSH_COLUMN) if PUSH_COLUMN in header and PUSH_COLUMN not in ours else None
    pushes: dict[str, list[int]] = {}
    for row, cells in enumerate(lines[1:]):
        if not cells:
            continue
        if len(cells) != len(header):
            raise DatasetError(
                f"{where}, row {row}: has {len(cells)} cells, but the header has {len(header)}"
            )
        push = "" if push_place is None else parsing.push_label(cells[push_place])
        if push_place is not None and not push:
            raise DatasetError(
                f"{where}, row {row}: its {PUSH_COLUMN} is empty; say which push it belongs to"
            )
        pushes.setdefault(push, []).append(len(rows))
        rows.append([_cell(cells[place], f"{where}, row {row}, {name}") for place, name in used])
    array = np.array(rows, dtype=float).reshape(-1, len(used))
    values = {
        ours[name]: columns.factors[ours[name]] * array[:, place] for place, (_, name) in enumerate(used)
    }
    if "force_x" in values and "force_tau" not in values:
        values["force_tau"] = np.zeros(len(array))
    unknown = [name for name in header if name not in ours and not (name == PUSH_COLUMN or name == "")]
    parted = {push: np.array(chosen, dtype=int) for push, chosen in (pushes or {"": []}).items()}
    return _Table(values, parted, unknown)


def _refuse_header(header: list[str], where: str, columns: CsvColumns) -> None:
    absent = {name for name, theirs in columns.names.items() if theirs not in header}
    missing = [name for name in _REQUIRED if name in absent]
    if len(absent & set(_FORCE)) == 1:
        missing += [name for name in _FORCE if name in absent]
    elif _FORCE[0] in absent and _TORQUE not in absent:
        missing += _FORCE
    if not missing:
        return
    if header[:1] == ["Format Version"] or "Take Name" in header:
        raise DatasetError(
            f"{where}: this is an OptiTrack Motive export, with several header lines, quaternions and often"
            " mm and Y up (then theta is the rotation about Y, and y on the table is -Z). Write a table with"
            f" one header line: {columns.expected}"
        )
    if len(header) == 1:
        for sign, named in ((";", "semicolons"), ("\t", "tabs"), (None, "blanks")):
            if len(header[0].split(sign)) > 1:
                raise DatasetError(
                    f"{where}: its cells are separated by {named}, not commas; import it with"
                    f" `slipmap import {shlex.quote(where)} --guess`"
                )
    lacking = ", ".join(columns.names[name] for name in missing)
    raise DatasetError(
        f"{where}: the header {parsing.shown(','.join(header))} lacks {lacking}; {columns.expected}."
        " Declare other names and units under the key csv in the YAML file of --object, or import the file,"
        f" beginning with `slipmap import {shlex.quote(where)} --guess`{_further(header)}"
    )


def _further(header: list[str]) -> str:
    """Hints for headers with quaternions or split times."""
    ends = {name.rsplit(".", 1)[-1].lower() for name in header}
    said = ""
    if {"qx", "qy", "qz", "qw"} <= ends or {"x", "y", "z", "w"} <= ends:
        said += (
            ". Quaternions are not read; for an object that stays level, theta = 2 atan2(qz, qw) with z up"
        )
    if ends & {"nanosec", "nsecs", "nsec"}:
        said += ". Time must be one column: sec + 1e-9 nanosec"
    return said


def _cell(cell: str, where: str) -> float:
    return parsing.number_in(cell, where) if cell.strip() else math.nan
