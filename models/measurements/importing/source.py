"""Content of a laboratory's file: tables of named columns, each with the clock of its rows.

The readers for all kinds of files produce `Source`s and know nothing about pushes; `import_setup` states what
the columns are, `mapping` turns them into poses and forces, and `recordings` into pushes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slipmap.models.files import UnreadableFile, check_file
from slipmap.models.measurements import parsing
from slipmap.models.measurements.trial import DatasetError
from slipmap.models.physics.cell_grid import FloatArray

LARGEST_FILE = 2**30
"""Most bytes of a file; about an hour of 20 channels at 1 kHz."""

MOST_NUMBERS = 2**27
"""Most numbers of a table: 1 GiB."""

MOST_CELLS = 2**24
"""Most cells of a text table, which take sixty bytes each."""

Column = FloatArray | Sequence[str]
"""(T,) numbers, NaN where missing; or texts as in the file."""

NO_NUMBER = frozenset({"", "n/a", "na", "#n/a", "nan", "null", "none", "-", "--", "?", "missing", "nat"})
"""Words that mean a missing number, in lower case."""

_MOST_NAMED = 12
_WITH_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(\.\d{3})+(,\d*)?")


def check_size(path: Path, where: str) -> None:
    """Refuse, with a DatasetError, anything but a regular file of at most `LARGEST_FILE` bytes."""
    try:
        check_file(path, LARGEST_FILE)
    except UnreadableFile as error:
        raise DatasetError(f"{where}: {error}") from None


@dataclass(frozen=True, eq=False)
class Source:
    """A table of a file."""

    file: str  # name in error messages
    part: str  # topic, rigid body or path inside the file; empty if the file is one table
    columns: Mapping[str, Column]  # by name, all of equal length
    time: FloatArray | None = None  # (T,) s, if the kind of file determines the column
    length: str = "m"  # unit of lengths, by the file or its kind
    angle: str = "rad"  # unit of angles and rotation vectors
    up: str = "z"  # axis that points up, by the kind of file
    decimal: str = "."  # decimal sign of numbers in texts; empty if commas may also separate thousands
    first_row: int = 0  # number of the first row in error messages
    push: str = ""  # column that numbers pushes, if the kind of file has one

    @property
    def where(self) -> str:
        """File and part, for error messages."""
        return f"{self.file}, {self.part}" if self.part else self.file

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def name_of(self, column: str) -> str:
        """A column's name in the file, given this name or its number, from 0.

        Raises:
            DatasetError: there is none.
        """
        if column in self.columns:
            return column
        if column.isascii() and column.isdecimal() and int(column) < len(self.columns):
            return list(self.columns)[int(column)]
        raise DatasetError(f"{self.where}: there is no column {parsing.shown(column)}; {self.listed}")

    @property
    def listed(self) -> str:
        """The existing columns, for error messages."""
        names = [parsing.shown(name) if name.strip() != name or not name else name for name in self.columns]
        return f"there are {parsing.listed(names, _MOST_NAMED)}"

    def texts(self, column: str) -> list[str]:
        """(T,) cells of a column as texts."""
        cells = self.columns[self.name_of(column)]
        if isinstance(cells, np.ndarray):
            return [np.format_float_positional(cell, trim="-") for cell in cells.tolist()]
        return [cell.strip() for cell in cells]

    def numbers(self, column: str) -> FloatArray:
        """(T,) a column as numbers; NaN for empty cells and words such as N/A.

        Raises:
            DatasetError: no such column, or a cell that is not a number.
        """
        name = self.name_of(column)
        cells = self.columns[name]
        if isinstance(cells, np.ndarray):
            return cells
        texts = cells
        if self.decimal == ",":
            texts = [_with_point(cell) for cell in cells]
        try:
            if any("_" in text for text in texts):
                raise ValueError
            return np.array([text or "nan" for text in texts], dtype=float)
        except ValueError:
            pairs = enumerate(zip(texts, cells, strict=True))
            return np.array([self._number(text, cell, name, row) for row, (text, cell) in pairs], dtype=float)

    def _number(self, text: str, cell: str, name: str, row: int) -> float:
        cell, where = cell.strip(), f"{self.where}, row {row + self.first_row}, {name}"
        if cell.lower() in NO_NUMBER:
            return float("nan")
        if not self.decimal and re.fullmatch(r"[-+]?\d+,\d+", cell):
            raise DatasetError(
                f"{where}: {parsing.shown(cell)} may be {float(cell.replace(',', '.')):g} or"
                f" {cell.replace(',', '')}; write decimal points and no commas between thousands, or, if"
                " commas are decimal, save the table with semicolons between the cells"
            )
        return parsing.number_in(text, where)

    def chosen(self, rows: NDArray[np.int_]) -> Source:
        """Some of the rows."""
        columns: dict[str, Column] = {
            name: cells[rows] if isinstance(cells, np.ndarray) else [cells[row] for row in rows]
            for name, cells in self.columns.items()
        }
        time = None if self.time is None else self.time[rows]
        return replace(self, columns=columns, time=time)


def rows_named(table: Source, name: str) -> list[Source]:
    """The rows of a table of several bodies, one below the other, in which a column holds a body's name."""
    found: dict[bytes, Source] = {}  # by their rows, which two columns may name alike
    for cells in table.columns.values():
        if not isinstance(cells, np.ndarray):
            rows = np.flatnonzero([cell.strip() == name for cell in cells])
            if 0 < len(rows) < len(cells):
                found.setdefault(rows.tobytes(), replace(table.chosen(rows), part=name))
    return list(found.values())


def names_in(table: Source) -> list[str]:
    """The words by which rows of a table of several bodies may be told apart; empty if there are none."""
    for cells in table.columns.values():
        if isinstance(cells, np.ndarray):
            continue
        words = list(dict.fromkeys(cell.strip() for cell in cells))
        if 1 < len(words) <= _MOST_NAMED and all(word[:1].isalpha() for word in words):
            return sorted(words)
    return []


def _with_point(cell: str) -> str:
    """A number with a decimal comma, written with a point; points between thousands are left out."""
    if "." in cell and not _WITH_THOUSANDS.fullmatch(cell.strip()):
        return cell
    return cell.replace(".", "").replace(",", ".")


Reader = Callable[[Path, str], list[Source]]
"""Reader of a file, given its path and its name in error messages."""


def missing_library(where: str, library: str) -> DatasetError:
    """Error about an optional library that is not installed."""
    return DatasetError(
        f"{where}: reading such files needs the library {library}; install it with `pip install"
        " 'slipmap[import]'`"
    )


def tables_of_arrays(file: str, found: Mapping[str, FloatArray]) -> list[Source]:
    """Tables from arrays at paths: arrays of one folder and length are the columns of a table, as are the
    columns of an array, as `name.0`, `name.1`.

    Every array with several columns is also a separate table, with columns named by their numbers.
    """
    folders: dict[tuple[str, int], dict[str, Column]] = {}
    own: list[Source] = []
    for path, values in found.items():
        folder, _, name = path.rpartition("/")
        table = folders.setdefault((folder, len(values)), {})
        if values.ndim == 1:
            table[name] = values
        elif values.ndim == 2 and values.shape[1] == 1:
            table[name] = values[:, 0]
        elif values.ndim == 2:
            for number in range(values.shape[1]):
                table[f"{name}.{number}"] = values[:, number]
            columns: dict[str, Column] = {str(k): values[:, k] for k in range(values.shape[1])}
            own.append(Source(file, path, columns))
    whole = [Source(file, folder or "/", table) for (folder, _), table in folders.items() if table]
    taken = {source.part for source in whole}
    return whole + [source for source in own if source.part not in taken]
