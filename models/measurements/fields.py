"""Numbers, texts and tables out of parsed YAML or JSON, with errors that say where they stood."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterable
from itertools import chain
from typing import Any

import numpy as np

from slipmap.models.measurements.push_dataset import DatasetError
from slipmap.models.physics.cell_grid import FloatArray


class _Short(reprlib.Repr):
    """Values cut to a few dozen characters, however large or nested they are."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 2
        self.maxlist = self.maxdict = 4
        self.maxstring = self.maxother = 60

    def repr_int(self, value: int, level: int) -> str:
        """An integer; the text of one beyond 64 bits would not help, and can be refused by Python."""
        return repr(value) if value.bit_length() <= 64 else f"an integer of {value.bit_length()} bits"


def shown(value: object) -> str:
    """A value for an error text, on a few dozen characters."""
    return _Short().repr(value)


def mapping(value: object, where: str) -> dict[str, Any]:
    """A mapping with text keys."""
    if not isinstance(value, dict):
        raise DatasetError(f"{where}: must be a mapping of keys to values, got {shown(value)}")
    for key in value:
        if not isinstance(key, str):
            raise DatasetError(f"{where}: keys must be text, got {shown(key)}")
    return value


def required(fields: dict[str, Any], key: str, where: str, hint: str) -> Any:
    """The value of a key that must be there."""
    if fields.get(key) is None:
        raise DatasetError(f"{where}: `{key}` is missing; {hint}")
    return fields[key]


def unknown_keys(fields: Iterable[str], known: Iterable[str], where: str) -> list[str]:
    """One warning for each key that has no meaning here, most likely a slip of the pen."""
    known = sorted(known)
    return [
        f"{where}: the key {shown(key)} is unknown and ignored (known: {', '.join(known)})"
        for key in sorted(set(fields) - set(known))
    ]


def text(value: object, where: str) -> str:
    """A text."""
    if not isinstance(value, str):
        raise DatasetError(f"{where}: must be text, got {shown(value)}")
    return value


def number(value: object, where: str) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        hint = ""
        if isinstance(value, str) and "e" in value.lower() and len(value) < 40:
            hint = "; YAML reads 5e-3 and 1.e6 as text, write 5.0e-3 and 1.0e+6"
        raise DatasetError(f"{where}: must be a number, got {shown(value)}{hint}")
    result = _as_float(value, where)
    if not math.isfinite(result):
        raise DatasetError(f"{where}: must be a finite number, got {result}")
    return result


def positive(value: object, where: str, unit: str) -> float:
    """A finite number above zero."""
    result = number(value, where)
    if result <= 0:
        raise DatasetError(f"{where}: must be positive ({unit}), got {result}")
    return result


def pair(value: object, where: str) -> tuple[float, float]:
    """Two finite numbers."""
    if not isinstance(value, list) or len(value) != 2:
        raise DatasetError(f"{where}: must be two numbers [a, b], got {shown(value)}")
    return number(value[0], where), number(value[1], where)


def table(value: object, columns: int, where: str) -> FloatArray:
    """(n, columns) numbers from a list of rows; None becomes NaN, as JSON has no word for it."""
    if not isinstance(value, list):
        raise DatasetError(f"{where}: must be a list of rows, got {shown(value)}")
    if set(map(type, value)) - {list}:
        row = next(row for row, cells in enumerate(value) if not isinstance(cells, list))
        raise DatasetError(
            f"{where}, row {row}: must be a list of {columns} numbers, got {shown(value[row])}"
        )
    if set(map(len, value)) - {columns}:
        row = next(row for row, cells in enumerate(value) if len(cells) != columns)
        raise DatasetError(f"{where}, row {row}: needs {columns} columns, has {len(value[row])}")
    if set(map(type, chain.from_iterable(value))) - {int, float, type(None)}:
        for row, cells in enumerate(value):
            for cell in cells:
                if type(cell) not in (int, float, type(None)):
                    raise DatasetError(f"{where}, row {row}: must hold numbers, got {shown(cell)}")
    try:
        return np.array(value, dtype=float).reshape(-1, columns)
    except OverflowError:
        for row, cells in enumerate(value):
            for cell in cells:
                _as_float(cell or 0, f"{where}, row {row}")
        raise


def _as_float(value: int | float, where: str) -> float:
    try:
        return float(value)
    except OverflowError:
        raise DatasetError(f"{where}: {shown(value)} is beyond what a measured number can be") from None
