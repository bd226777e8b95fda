"""What the columns of CSV files are called, and in which units they stand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from models.measurements import fields
from models.measurements.push_dataset import DatasetError

_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
_ANGLES = {"rad": 1.0, "deg": 0.017453292519943295}
_FORCES = {"N": 1.0, "mN": 1e-3, "kN": 1e3}
UNITS: Mapping[str, Mapping[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "object_x": _LENGTHS,
    "object_y": _LENGTHS,
    "object_theta": _ANGLES,
    "tip_x": _LENGTHS,
    "tip_y": _LENGTHS,
    "force_x": _FORCES,
    "force_y": _FORCES,
    "force_tau": {"N m": 1.0, "N mm": 1e-3, "mN m": 1e-3},
}
"""Our names, and how much of the SI unit each unit is that a column may have."""

OPTIONAL = ("force_x", "force_y", "force_tau")
REQUIRED = tuple(name for name in UNITS if name not in OPTIONAL)


@dataclass(frozen=True)
class CsvColumns:
    """Columns of CSV files.

    Attributes:
        names: our name to that in the files.
        factors: our name to what its numbers have to be multiplied by to be s, m, rad, N or N·m.
    """

    names: Mapping[str, str]
    factors: Mapping[str, float]

    @property
    def expected(self) -> str:
        """Which columns there have to be, for error texts."""
        required, optional = (", ".join(self.names[name] for name in group) for group in (REQUIRED, OPTIONAL))
        return f"expected are {required} and, where force was measured, {optional}"


STANDARD = CsvColumns({name: name for name in UNITS}, {name: 1.0 for name in UNITS})
"""Our own names, in s, m, rad, N and N·m."""


def parse_columns(value: object, where: str) -> CsvColumns:
    """Columns of the key `csv`: by our name that of the files, or `{column: ..., unit: ...}`.

    Args:
        value: as parsed; None for the standard.
        where: the file and key, for error texts.

    Raises:
        DatasetError: a name or unit that is not known, or one column for two things.
    """
    if value is None:
        return STANDARD
    names, factors = dict(STANDARD.names), dict(STANDARD.factors)
    for name, entry in fields.mapping(value, where).items():
        place = f"{where}.{name}"
        if name not in UNITS:
            raise DatasetError(f"{place}: there is no such quantity; there are {', '.join(UNITS)}")
        told = {"column": entry} if isinstance(entry, str) else fields.mapping(entry, place)
        for key in told:
            if key not in ("column", "unit"):
                raise DatasetError(f"{place}: {fields.shown(key)} is unknown; there are column and unit")
        names[name] = fields.text(told.get("column", name), f"{place}.column")
        unit = told.get("unit", next(iter(UNITS[name])))
        if not isinstance(unit, str) or unit not in UNITS[name]:
            raise DatasetError(
                f"{place}.unit: must be one of {', '.join(UNITS[name])}, got {fields.shown(unit)}"
            )
        factors[name] = UNITS[name][unit]
    for name, column in names.items():
        others = [other for other, same in names.items() if same == column and other != name]
        if others:
            raise DatasetError(f"{where}: the column {fields.shown(column)} cannot be {name} and {others[0]}")
    return CsvColumns(names, factors)
