"""Read what is known about an object's maps before any push, from the key `known` of a dataset.yaml or from a
file of the same keys.

Statements about the whole object apply first, then regions in order, each overriding those before it. What is
not mentioned stays free.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from slipmap.models.measurements import parsing
from slipmap.models.measurements.parsing import Number
from slipmap.models.measurements.push_dataset import LEAST_SPREAD, KnownMaps, PushDataset
from slipmap.models.measurements.trial import DatasetError
from slipmap.models.physics.cell_grid import CellGrid, FloatArray

_NUMBERS = {"mass": Number("kg", 1e-9, 1e6), "friction": Number("", 1e-4, 10.0)}
_LENGTH = Number("m")
_USUAL_SPREAD = 0.05
_SPREAD = Number(
    "",
    LEAST_SPREAD,
    1.0,
    "{where}: a relative standard deviation must lie between {low:g} and {high:g}, got {value:g}",
)


def with_known_maps(dataset: PushDataset, path: str | os.PathLike[str]) -> PushDataset:
    """The dataset with known maps from a YAML file with `known` of a dataset.yaml, or the keys under it.

    Raises:
        DatasetError: the file cannot be used, or does not match the object; the message names file and key.
    """
    where = str(path)
    _, document = parsing.read_yaml(Path(path), where)
    if isinstance(document, dict) and "known" in document:
        if len(document) > 1:
            others = ", ".join(map(parsing.shown, sorted(map(str, set(document) - {"known"}))))
            raise DatasetError(
                f"{where}: give keys either under `known` or at the top level, not both ({others})"
            )
        document, where = document["known"], f"{where}: known"
    known, warnings = parse_known(document, dataset.grid, dataset.mass, where)
    return replace(dataset, known=known, warnings=(*dataset.warnings, *warnings))


def parse_known(value: object, grid: CellGrid, mass: float | None, where: str) -> tuple[KnownMaps, list[str]]:
    """Known maps from a parsed mapping, and warnings about it.

    Raises:
        DatasetError: it cannot be used, or does not match the object; the message names the key.
    """
    warnings: list[str] = []
    fields = parsing.section(value, ("spread", "finger_friction", "regions", *_NUMBERS), where, warnings)
    usual = _SPREAD.read(fields.get("spread", _USUAL_SPREAD), f"{where}: spread")
    maps = {
        name: _Map.parsed(name, fields.get(name), len(grid), usual, f"{where}: {name}", warnings)
        for name in _NUMBERS
    }
    regions = fields.get("regions", [])
    if not isinstance(regions, list):
        raise DatasetError(f"{where}: regions must be a list, got {parsing.shown(regions)}")
    for row, region in enumerate(regions):
        _lay(region, maps, grid, usual, f"{where}: regions, row {row}", warnings)
    rubbing = fields.get("finger_friction")
    if isinstance(rubbing, dict) and "ratios" in rubbing:
        raise DatasetError(f"{where}: finger_friction is a single number and cannot be given as ratios")
    single = rubbing.get("value") if isinstance(rubbing, dict) else rubbing
    if single is not None and (isinstance(single, bool) or not isinstance(single, int | float)):
        raise DatasetError(f"{where}: finger_friction must be a number, got {parsing.shown(single)}")
    finger = _Map.parsed("friction", rubbing, 1, usual, f"{where}: finger_friction", warnings)
    named = {name: one for name, one in maps.items() if not np.isnan(one.values).all()}
    if not named and np.isnan(finger.values[0]):
        place = "under `known`" if where.endswith(": known") else "at the top level"
        unknown = f" ({'; '.join(warnings)})" if warnings else ""
        raise DatasetError(
            f"{where}: states nothing known; give mass, friction, finger_friction or regions {place}{unknown}"
        )
    arguments: dict[str, Any] = {}
    for name, one in named.items():
        arguments |= {name: one.values, f"{name}_spread": one.spread, f"{name}_ratios": one.ratios}
    if not np.isnan(finger.values[0]):
        arguments |= {"finger_friction": float(finger.values[0]), "finger_spread": float(finger.spread[0])}
    try:
        known = KnownMaps(**arguments)
        known.check(len(grid), mass)
    except DatasetError as error:
        raise DatasetError(f"{where}: {str(error).removeprefix('known maps: ')}") from None
    return known, warnings


def known_document(known: KnownMaps) -> dict[str, Any]:
    """The mapping from which `parse_known` reads the same known maps: values and spreads of every cell."""
    document: dict[str, Any] = {}
    for name in _NUMBERS:
        values, spread = getattr(known, name), getattr(known, f"{name}_spread")
        if values is not None:
            document[name] = {
                "value": [None if np.isnan(value) else value for value in values.tolist()],
                "spread": spread.tolist(),
                "ratios": getattr(known, f"{name}_ratios"),
            }
    if known.finger_friction is not None:
        document["finger_friction"] = {
            "value": float(known.finger_friction), "spread": float(known.finger_spread)
        }  # fmt: skip
    return document


@dataclass
class _Map:
    """One map while it is being read."""

    values: FloatArray  # (n,) NaN where not known
    spread: FloatArray  # (n,)
    ratios: bool  # whether only the ratios of the values count

    @classmethod
    def parsed(
        cls, name: str, value: object, cells: int, usual: float, where: str, warnings: list[str]
    ) -> _Map:
        """Parse `uniform`, a number, one number per cell, or a mapping of `value` and optionally `spread`."""
        fields: dict[str, Any] = {"value": value}
        if isinstance(value, dict):
            fields = parsing.section(value, ("value", "spread", "ratios"), where, warnings)
            parsing.required(fields, "value", where, "give the known value")
        value, spread, ratios = fields["value"], fields.get("spread", usual), fields.get("ratios", False)
        if not isinstance(ratios, bool):
            raise DatasetError(f"{where}.ratios: must be true or false, got {parsing.shown(ratios)}")
        if value == "uniform":
            value, ratios = [1.0] * cells, True
        elif name == "mass" and value is not None and not isinstance(value, list):
            raise DatasetError(
                f"{where}: must be `uniform` or a list of every cell's mass in kg, got"
                f" {parsing.shown(value)}; the object's total mass belongs in object.mass"
            )
        spreads = [_SPREAD.read(one, f"{where}.spread") for one in _each(spread, cells, f"{where}.spread")]
        values = [
            np.nan if one is None else _NUMBERS[name].read(one, where) for one in _each(value, cells, where)
        ]
        return cls(np.array(values), np.array(spreads), ratios)


def _each(value: object, cells: int, where: str) -> list[Any]:
    """One value for each cell, from one for all or from a list."""
    values = value if isinstance(value, list) else [value] * cells
    if len(values) != cells:
        raise DatasetError(
            f"{where}: has {len(values)} values for {cells} cells; give one for all cells, or one for each in"
            " the order of object.cells.centers"
        )
    return values


def _lay(
    value: object, maps: Mapping[str, _Map], grid: CellGrid, usual: float, where: str, warnings: list[str]
) -> None:
    """Apply a region to the maps: a friction coefficient, and a mass that its cells share."""
    region = parsing.section(value, ("disc", "polygon", "spread", *_NUMBERS), where, warnings)
    cells = _cells(region, grid, where, warnings)
    spread = _SPREAD.read(region.get("spread", usual), f"{where}.spread")
    given = [name for name in _NUMBERS if region.get(name) is not None]
    if not given:
        raise DatasetError(f"{where}: states nothing known; give its mass (kg) or friction")
    for name in given:
        number = _NUMBERS[name].read(region[name], f"{where}.{name}")
        if maps[name].ratios:
            raise DatasetError(
                f"{where}.{name}: cannot be combined with a {name} map that is given as ratios; give every"
                f" cell's {name} as a number, or leave {name} out of one of the two"
            )
        maps[name].values[cells] = number / len(cells) if name == "mass" else number
        maps[name].spread[cells] = spread


def _cells(region: dict[str, Any], grid: CellGrid, where: str, warnings: list[str]) -> NDArray[np.intp]:
    """Cells whose centres lie in a region, or the nearest cell if the region is smaller than that."""
    if ("disc" in region) == ("polygon" in region):
        raise DatasetError(f"{where}: give either a disc or a polygon, in the object frame, m")
    if "disc" in region:
        disc = parsing.section(region["disc"], ("center", "radius"), f"{where}.disc", warnings)
        center = parsing.pair(disc.get("center"), f"{where}.disc.center")
        shape = shapely.Point(center).buffer(_LENGTH.read(disc.get("radius"), f"{where}.disc.radius"))
    else:
        corners = parsing.table(region["polygon"], 2, f"{where}.polygon")
        if len(corners) < 3 or not np.isfinite(corners).all():
            raise DatasetError(f"{where}.polygon: needs at least three corners, each of two finite numbers")
        shape = shapely.Polygon(corners)
        if not shape.is_valid:
            raise DatasetError(f"{where}.polygon: crosses itself; give its corners in order")
    inside = np.flatnonzero(shapely.intersects_xy(shape, *grid.centers.T))
    if len(inside):
        return inside
    distance = np.hypot(*(grid.centers - shape.centroid.coords[0]).T)
    nearest = int(np.argmin(distance))
    if distance[nearest] > grid.width:
        raise DatasetError(f"{where}: lies outside the object; give it in the object frame, m")
    return np.array([nearest])
