"""Read tables from text: CSV of any dialect, logs with blanks between cells, `rostopic echo -p`, and exports
of motion-capture programs.

Cells stay texts until a column is requested, so that words in other columns do no harm.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from slipmap.models.measurements import parsing
from slipmap.models.measurements.importing.source import LARGEST_FILE, MOST_CELLS, NO_NUMBER, Column, Source
from slipmap.models.measurements.trial import DatasetError
from slipmap.models.physics.cell_grid import FloatArray

TEXT_ENDINGS = (".csv", ".txt", ".tsv", ".dat", ".log")

_CLOCK = re.compile(r"(?:(\d+):)?(\d+):(\d+(?:[.,]\d+)?)$")
_GERMAN_DATE = re.compile(r"\A(\d{2})\.(\d{2})\.(\d{4})(?!\d)")
_PER_SECOND = ((1e17, 1e9, "ns"), (1e14, 1e6, "µs"), (1e11, 1e3, "ms"))
"""Stamps since 1970 above the first number count this many per second; unambiguous from 1973 to 5138."""

_LONGEST_STEP = 600.0  # s between rows, as of poses that are seen before and after pushes only

_SIGN_OF_EXCEL = re.compile(r"\A\"?sep=.\"?\s*\n", re.I)
"""First line of some exports, which states the separator of the cells."""

_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(,\d{3})+")
_GROUPS = re.compile(r"[-+]?[1-9]\d{0,2}(,\d{3}){2,}")
_LINES_SNIFFED = 30
_ROWS_SNIFFED = 8  # of these, the last, which are no header
_DAY = 86400.0  # s
_LENGTHS = {"meters": "m", "centimeters": "cm", "millimeters": "mm", "m": "m", "cm": "cm", "mm": "mm"}


def read_text(path: Path, where: str) -> list[Source]:
    """The tables of a text file.

    Raises:
        DatasetError: not text, no rows, or rows whose length differs from the header's.
    """
    content = parsing.read_bytes(path, LARGEST_FILE)
    encoding = "utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = content.decode(encoding)
    except ValueError:
        text = content.decode("latin-1")
    if "\0" in text:
        raise DatasetError(f"{where}: this is not a text file; is its file extension right?")
    text = _SIGN_OF_EXCEL.sub("", text)
    lines = text.splitlines()
    first = next((line for line in lines if line.strip()), "")
    if not first:
        raise DatasetError(f"{where}: the file is empty")
    words = {cell.strip().strip('"') for cell in re.split(r"[,;\t]", first)}
    if {"Format Version", "Take Name"} & words:
        return _motive(_rows(text, _sign(lines), where), where)
    if words <= {"Objects", "Segments", "Trajectories", "Model Outputs", ""}:
        return _vicon(_rows(text, _sign(lines), where), where)
    return [_table(lines, where)]


def _sign(lines: Sequence[str]) -> str | None:
    """The separator of the cells: comma, semicolon, tab, or None for blanks."""
    sample = [line for line in lines if line.strip() and not _is_comment(line)][:_LINES_SNIFFED]
    for sign in (";", "\t"):
        if sample and all(sign in line for line in sample[:2]):
            return sign
    if all("," in line for line in sample[:2]) and not _decimal_commas(sample):
        return ","
    if sample and all(len(line.split()) > 1 for line in sample[:2]):
        return None
    return ","


def _decimal_commas(sample: Sequence[str]) -> bool:
    """Whether the commas are decimal commas of numbers between blanks."""
    cells = sample[-1].split() if sample else []
    return len(cells) > 1 and all(re.fullmatch(r"[-+]?\d+(,\d+)?(e[-+]?\d+)?", cell, re.I) for cell in cells)


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith("#")


def _rows(text: str, sign: str | None, where: str) -> list[list[str]]:
    if sum(map(text.count, (sign or " ", "\n"))) > MOST_CELLS:
        raise DatasetError(
            f"{where}: has more than {MOST_CELLS} cells; split the recording into several files"
        )
    try:
        if sign is None:
            return [line.split() for line in text.splitlines()]
        return list(csv.reader(io.StringIO(text, newline=""), delimiter=sign, skipinitialspace=True))
    except csv.Error as error:
        raise DatasetError(f"{where}: not readable as a table ({parsing.shown_error(error)})") from None


def _table(lines: Sequence[str], where: str) -> Source:
    """A table with one header line or none, in any dialect."""
    comments = 0
    while comments < len(lines) and (_is_comment(lines[comments]) or not lines[comments].strip()):
        comments += 1
    body, header_line = lines[comments:], None
    if above := _lines_above_header(body):
        body, comments = body[above:], 0
    sign = _sign(body)
    if not body or (comments and _is_header(lines[comments - 1].lstrip("# "), body[0], sign)):
        header_line = lines[comments - 1].lstrip("# ") if comments else ""
    rows = _rows("\n".join(body), sign, where)
    decimal = _decimal_sign(rows, sign)
    if header_line is not None:
        names = _rows(header_line, sign, where)[0] if header_line else []
    elif rows and all(_numeric(cell, decimal) for cell in rows[0]):
        names = [str(number) for number in range(len(rows[0]))]
    else:
        names, rows = (rows[0], rows[1:]) if rows else ([], [])
        if len(rows) > 1 and _words_over_numbers(rows[0], rows[1], decimal):
            word = next(cell for cell in rows[0] if cell.strip().lower() not in NO_NUMBER)
            raise DatasetError(
                f"{where}, row 0: there are words below the header, such as {parsing.shown(word.strip())}; if"
                " they are units, delete the line and give them in setup.yaml under `unit`"
            )
    names = [name.strip() for name in names]
    wide = {len(row) for row in rows}
    if len(names) > 1 and not names[-1] and wide <= {0, len(names), len(names) - 1}:
        names = names[:-1]  # every line ends with the separator
    source = Source(where, "", _columns(names, rows, where), decimal=decimal)
    if names and names[0] == "%time":  # rostopic echo -p
        stamp = next((name for name in names if name.endswith("header.stamp")), "%time")
        time = source.numbers(stamp)
        return Source(where, "", source.columns, 1e-9 * (time if time.any() else source.numbers("%time")))
    return source


def _lines_above_header(lines: Sequence[str]) -> int:
    """How many lines, such as a title and a date, stand above the line that names the columns.

    They have at most half as many cells as the rows, the header as many or, if each row ends with a
    separator, one less.
    """
    sample = [number for number, line in enumerate(lines[:_LINES_SNIFFED]) if line.strip()]
    rows = [lines[number] for number in sample[-_ROWS_SNIFFED:]]
    sign = _sign(rows)
    counts = [_cells(line, sign) for line in rows]
    if len(sample) <= _ROWS_SNIFFED or min(counts) < max(counts) or counts[0] < 3:
        return 0
    first = next(number for number in sample if _cells(lines[number], sign) >= counts[0] - 1)
    header = [cell for cell in lines[first].split(sign) if cell.strip()]
    if not header or any(_numeric(cell, ".") or _numeric(cell, ",") for cell in header):  # no names
        return 0
    above = [_cells(line, sign) for line in lines[:first]]
    return first if max(above, default=0) <= counts[0] / 2 else 0


def _cells(line: str, sign: str | None) -> int:
    if sign is None:
        return len(line.split())
    return len(next(csv.reader([line], delimiter=sign, skipinitialspace=True), []))


def _is_header(comment: str, line: str, sign: str | None) -> bool:
    """Whether a comment line before the first row names the columns."""
    names = comment.split(sign)
    return len(names) > 1 and len(names) == len(line.split(sign))


def _numeric(cell: str, decimal: str = ".") -> bool:
    if "_" in cell:  # which Python takes between digits
        return False
    try:
        float(cell.replace(decimal or ",", ".") or "nan")
    except ValueError:
        return False
    return True


def _decimal_sign(rows: Sequence[Sequence[str]], sign: str | None) -> str:
    """Decimal sign of the numbers in a table; empty if its commas may be decimal or separate thousands.

    The first lines decide; where they cannot, all do.
    """
    for some in (rows[1:_LINES_SNIFFED], rows[1:]):
        cells = [cell.strip() for row in some for cell in row if "," in cell or "." in cell]
        if any("." in cell and _numeric(cell, ".") for cell in cells):
            return "."
        commas = [cell for cell in cells if _numeric(cell, ",")]
        if not all(_THOUSANDS.fullmatch(cell) for cell in commas):
            return ","
    if not commas or any(_GROUPS.fullmatch(cell) for cell in cells):
        return "."
    return "," if sign == ";" else ""


def _words_over_numbers(first: Sequence[str], second: Sequence[str], decimal: str) -> bool:
    """Whether every cell of a row is a word or empty, with numbers below the words."""
    words = [k for k, cell in enumerate(first) if cell.strip().lower() not in NO_NUMBER]
    if not words or any(any(sign.isdigit() for sign in first[k]) or _numeric(first[k]) for k in words):
        return False
    return all(k < len(second) and second[k].strip() and _numeric(second[k], decimal) for k in words)


def _columns(names: Sequence[str], rows: Sequence[Sequence[str]], where: str) -> dict[str, Column]:
    """Columns by name; the second of two with the same name becomes name.1, and so on."""
    filled = [row for row in rows if row]
    for number, row in enumerate(filled):
        if len(row) != len(names) and not (len(row) == len(names) + 1 and not row[-1].strip()):
            header = parsing.shown(",".join(names))
            raise DatasetError(
                f"{where}, row {number}: has {len(row)} cells, but the header {header} has {len(names)}"
            )
    if not filled:
        raise DatasetError(f"{where}: has a header but no rows")
    named: dict[str, Column] = {}
    for number, (name, cells) in enumerate(zip(names, zip(*filled, strict=False), strict=False)):
        unique, repeated = name, 0
        while unique in named:
            repeated += 1
            unique = f"{name}.{repeated}"
        named[unique or f"column {number}" if unique in named else unique] = cells
    return named


def seconds(source: Source, columns: Sequence[str], unit: float | None) -> tuple[FloatArray, str]:
    """(T,) times, s, from one column or from seconds and nanoseconds, and a remark on how they were read, or
    "".

    Texts may be ISO times, which count from 1970 in UTC, or hours:minutes:seconds, which go on past midnight.
    Numbers count in units of `unit` seconds; without one, stamps since 1970 are recognised by their size and
    all others are in s.
    """
    if len(columns) == 2:
        return source.numbers(columns[0]) + 1e-9 * source.numbers(columns[1]), ""
    cells = source.columns[source.name_of(columns[0])]
    if not isinstance(cells, np.ndarray):
        first = next((cell.strip() for cell in cells if cell.strip().lower() not in NO_NUMBER), "")
        if not _numeric(first, source.decimal):
            time = _moments(source, columns[0])
            told = f"{columns[0]} holds times such as {parsing.shown(first)}"
            return _past_midnight(time) if _CLOCK.match(first) else time, told
    time = source.numbers(columns[0])
    if unit is not None:
        return unit * time, ""
    known = time[np.isfinite(time)]
    largest = float(np.max(np.abs(known), initial=0.0))
    step = float(np.median(np.abs(np.diff(known)))) if len(known) > 1 else 0.0
    for least, count, name in _PER_SECOND:
        if largest > least:
            if step > _LONGEST_STEP * count:  # such as ns since the computer was started
                break
            return time / count, f"{columns[0]} counts {name} since 1970"
    return time, ""


def _moments(source: Source, column: str) -> FloatArray:
    result = []
    for row, cell in enumerate(source.texts(column)):
        value = float("nan") if cell.lower() in NO_NUMBER else _moment(cell)
        if value is None:
            raise DatasetError(
                f"{source.where}, row {row}, {column}: {parsing.shown(cell)} is not a time; write s,"
                " 2024-02-06T15:25:00.02 or 15:25:00.02"
            )
        result.append(value)
    return np.array(result)


def _past_midnight(time: FloatArray) -> FloatArray:
    """(T,) times of day, s, with a day added wherever they fall by more than half a day."""
    known = np.flatnonzero(np.isfinite(time))
    days = np.cumsum(np.diff(time[known], prepend=time[known[:1]]) < -0.5 * _DAY)
    result = time.copy()
    result[known] += _DAY * days
    return result


def _moment(cell: str) -> float | None:
    if match := _CLOCK.match(cell):
        hours, minutes, rest = match.groups()
        return 3600.0 * int(hours or 0) + 60.0 * int(minutes) + float(rest.replace(",", "."))
    cell = _GERMAN_DATE.sub(r"\3-\2-\1", cell)
    try:
        moment = datetime.fromisoformat(cell.replace("/", "-"))
    except ValueError:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


# Exports of motion-capture programs.


def _motive(rows: list[list[str]], where: str) -> list[Source]:
    """Rigid bodies of an OptiTrack Motive export: name, x, y, z and a quaternion each, on one clock.

    Motive's world has y up unless the export was configured otherwise, which the file does not show.
    """
    said = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    length = _LENGTHS.get(said.get("Length Units", "Meters").strip().lower())
    if length is None:
        raise DatasetError(f"{where}: unknown unit of length {parsing.shown(said['Length Units'])}")
    place = next((k for k, row in enumerate(rows[:20]) if row and row[0].strip() == "Frame"), None)
    names = next((row for row in rows[:20] if len(row) > 1 and row[1].strip() == "Name"), None)
    if place is None or names is None or place == 0:
        raise DatasetError(
            f"{where}: this Motive export lacks the lines Name and Frame; export it again with the header"
        )
    kinds = next((row for row in rows[:20] if len(row) > 1 and row[1].strip() == "Type"), [])
    what, axis = rows[place - 1], rows[place]
    body = [row for row in rows[place + 1 :] if any(cell.strip() for cell in row)]
    table = Source(where, "", _columns([str(k) for k in range(len(axis))], body, where), first_row=0)
    time = table.numbers("1")
    order = said.get("Rotation Type", "Quaternion").strip()
    found: dict[str, dict[tuple[str, str], int]] = {}
    for k in range(2, min(len(axis), len(names), len(what))):
        marker = k < len(kinds) and "marker" in kinds[k].lower()
        if names[k].strip() and not marker:
            found.setdefault(names[k].strip(), {})[what[k].strip(), axis[k].strip()] = k
    sources = []
    for name, columns in found.items():
        if not {("Position", sign) for sign in "XYZ"} <= columns.keys():
            continue
        values: dict[str, Column] = {
            sign.lower(): table.numbers(str(columns["Position", sign])) for sign in "XYZ"
        }
        turn = [columns.get(("Rotation", sign)) for sign in "XYZW"]
        turns = [table.numbers(str(k)) for k in turn if k is not None]
        if len(turns) == 3:
            turns = _quaternions(np.column_stack(turns), order, where)
        if len(turns) == 4:
            values |= zip(("qx", "qy", "qz", "qw"), turns, strict=True)
        sources.append(Source(where, name, values, time, length, up="y"))
    if not sources:
        raise DatasetError(
            f"{where}: contains no rigid body with a position; export rigid bodies from Motive"
        )
    return sources


def _quaternions(angles: FloatArray, order: str, where: str) -> list[FloatArray]:
    """Columns x, y, z, w from Euler angles X, Y, Z in degrees about moving axes in a given order."""
    from scipy.spatial.transform import Rotation

    if sorted(order.upper()) != ["X", "Y", "Z"]:
        raise DatasetError(f"{where}: unknown rotation type {parsing.shown(order)}")
    known = np.isfinite(angles).all(axis=1)
    result = np.full((len(angles), 4), np.nan)
    columns = ["XYZ".index(axis) for axis in order.upper()]
    if known.any():
        turns = Rotation.from_euler(order.upper(), angles[known][:, columns], degrees=True)
        result[known] = turns.as_quat()
    return list(result.T)


def _vicon(rows: list[list[str]], where: str) -> list[Source]:
    """Objects of a Vicon Tracker or Nexus export, whose frames count at the rate in the second line."""
    place = next((k for k, row in enumerate(rows[:12]) if row and row[0].strip() == "Frame"), None)
    if place is None or place < 2:
        raise DatasetError(f"{where}: this Vicon export lacks the line Frame; export it again")
    try:
        rate = float(rows[1][0])
        if not rate > 0.0:
            raise ValueError
    except (ValueError, IndexError):
        raise DatasetError(f"{where}: the second line must be the rate in Hz") from None
    units = rows[place + 1] if place + 1 < len(rows) else []
    stop = next((k for k, row in enumerate(rows) if k > place + 1 and not any(map(str.strip, row))), None)
    body = rows[place + 2 : stop]
    table = Source(where, "", _columns([str(k) for k in range(len(rows[place]))], body, where))
    time = table.numbers("0") / rate
    if rows[place][1:2] and "sub" in rows[place][1].lower():
        steps = float(np.nanmax(table.numbers("1"), initial=0.0)) + 1.0
        time = time + table.numbers("1") / (steps * rate)
    names, name = rows[place - 1], ""
    bodies: dict[str, dict[str, Column]] = {}
    lengths: dict[str, str] = {}
    angles: dict[str, str] = {}
    for k, column in enumerate(cell.strip() for cell in rows[place]):
        if k < len(names) and names[k].strip():
            name = re.sub(r"^Global Angle ", "", names[k].strip())
        unit = units[k].strip().lower() if k < len(units) else ""
        values = bodies.setdefault(name, {}) if name and k > 1 else {}
        if re.fullmatch(r"T?[XYZ]", column):
            values[column[-1].lower()] = table.numbers(str(k))
            lengths[name] = _LENGTHS.get(unit, "mm")
        elif column in ("RX", "RY", "RZ", "RW"):
            values[f"r{column[1].lower()}"] = table.numbers(str(k))
            angles[name] = "deg" if "deg" in unit else "rad"
    sources = []
    for name, values in bodies.items():
        if "rw" in values:
            values = {column.replace("r", "q"): cells for column, cells in values.items()}
        if {"x", "y", "z"} <= values.keys():
            sources.append(Source(where, name, values, time, lengths[name], angles.get(name, "rad")))
    if not sources:
        raise DatasetError(f"{where}: contains no object with a position (TX, TY, TZ)")
    return sources
