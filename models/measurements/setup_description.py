"""The part of a dataset.yaml besides the trials: object, finger, table, gravity and sensor noise.

Its numbers are declared once, with units and limits, for reading, checking and writing.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import shapely

from slipmap.models.measurements import known_maps, parsing
from slipmap.models.measurements.parsing import Number
from slipmap.models.measurements.push_dataset import LEAST_PER_AREA, MOST_PER_AREA, Noise, Setup, Table
from slipmap.models.measurements.trial import DatasetError
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.settings import THICKEST_FINGER, TOO_THICK

SETUP_KEYS = ("name", "description", "object", "finger", "table", "gravity", "noise", "known")

_DEVIATION = "{where}: a standard deviation must lie between 0 and {high:g}, got {value}"
_LENGTH = Number("m")
_OBJECT = {"height": _LENGTH, "mass": Number("kg", 1e-6, 1e6)}
_FINGER = {
    "radius": Number("m", high=THICKEST_FINGER, beyond=TOO_THICK),
    "height": Number("m", high=0.5, beyond="{where} is {value:g} m above the table; divide by 1000?"),
}
_GRAVITY = Number("m/s²", 1e-3, 1e3)
_NOISE = {
    name: Number(unit, high=high, beyond=_DEVIATION, or_zero=True)
    for name, (unit, high) in {
        "position": ("m", 0.1), "angle": ("rad", 1.0), "tip": ("m", 0.1), "force": ("N", 1e3),
        "outline": ("m", 0.1),
    }.items()
}  # fmt: skip

_STANDARD_GRAVITY = 9.81  # m/s²
_SMALLEST_EXTENT = 1e-3  # m
_LARGEST_EXTENT = 5.0  # m; no object on a table is larger, so the numbers must be mm
# Limits beyond which a value is unusual, but not refused.
_HEIGHT_PER_SIZE = (1e-3, 10.0)  # of a sheet of card, and of a tall bottle
_NEAR_GRAVITY = (1.0, 30.0)  # m/s²; from the moon to a heavy planet


def parse_setup(document: dict[str, Any], where: str, default_name: str) -> tuple[Setup, list[str]]:
    """Setup from the keys of a dataset.yaml, and warnings about it.

    Args:
        document: the parsed mapping; keys beyond `SETUP_KEYS` are the caller's.
        where: the file, for error messages.
        default_name: name if the document gives none.

    Raises:
        DatasetError: a missing key, a wrong type, a number out of range, an outline that crosses itself.
    """
    warnings: list[str] = []
    shape = parsing.required(document, "object", where, "give at least its outline")
    shape = parsing.section(shape, ("outline", "holes", "cells", *_OBJECT), f"{where}: object", warnings)
    finger = parsing.required(document, "finger", where, "give finger.radius in m")
    finger = parsing.section(finger, _FINGER, f"{where}: finger", warnings)
    grid = _grid(shape, f"{where}: object", warnings)
    radius = _FINGER["radius"].read(finger.get("radius"), f"{where}: finger.radius")
    above = _numbers(finger, {"height": _FINGER["height"]}, f"{where}: finger").get("height")
    gravity = _GRAVITY.read(document.get("gravity", _STANDARD_GRAVITY), f"{where}: gravity")
    if not _NEAR_GRAVITY[0] <= gravity <= _NEAR_GRAVITY[1]:
        warnings.append(f"{where}: gravity is {gravity:g} m/s²; expected about 9.81")
    name = parsing.text(document.get("name", default_name), f"{where}: name")
    description = parsing.text(document.get("description", ""), f"{where}: description")
    measured = _numbers(shape, _OBJECT, f"{where}: object")
    warnings += _doubtful_object(measured, grid, f"{where}: object")
    table = _table(document.get("table"), f"{where}: table", warnings)
    noise = _noise(document.get("noise"), f"{where}: noise", warnings)
    height, mass = measured.get("height"), measured.get("mass")
    if above is not None and height is not None and above >= height:
        warnings.append(
            f"{where}: finger.height is {above:g} m and object.height {height:g} m: the finger passes over"
            " the object"
        )
    known = None
    if document.get("known") is not None:
        known, doubts = known_maps.parse_known(document["known"], grid, mass, f"{where}: known")
        warnings += doubts
    setup = Setup(
        name, description, grid, height, mass, radius, table, gravity, noise, known=known, finger_height=above
    )
    return setup, warnings


def setup_document(setup: Setup) -> dict[str, Any]:
    """The keys of a dataset.yaml from which `parse_setup` reads a setup."""
    document: dict[str, Any] = {
        "name": setup.name,
        "description": setup.description,
        "object": {
            "outline": setup.grid.exterior.tolist(),
            **({"holes": [hole.tolist() for hole in setup.grid.holes]} if setup.grid.holes else {}),
            "cells": {"width": float(setup.grid.width), "centers": setup.grid.centers.tolist()},
            **_known(setup, _OBJECT),
        },
        "finger": {
            "radius": float(setup.finger_radius),
            **({} if setup.finger_height is None else {"height": float(setup.finger_height)}),
        },
    }
    if setup.table is not None:
        center = [float(value) for value in setup.table.center]
        document["table"] = {"shape": setup.table.shape, "center": center, **_known(setup.table, ("radius",))}
        if setup.table.size is not None:
            document["table"]["size"] = [float(value) for value in setup.table.size]
    document["gravity"] = float(setup.gravity)
    if noise := _known(setup.noise, _NOISE):
        document["noise"] = noise
    if setup.known is not None:
        document["known"] = known_maps.known_document(setup.known)
    return document


def _numbers(section: dict[str, Any], declared: Mapping[str, Number], where: str) -> dict[str, float]:
    return {
        key: number.read(section[key], f"{where}.{key}")
        for key, number in declared.items()
        if section.get(key) is not None
    }


def _known(source: object, names: Iterable[str]) -> dict[str, float]:
    return {name: float(value) for name in names if (value := getattr(source, name)) is not None}


def _doubtful_object(measured: Mapping[str, float | None], grid: CellGrid, where: str) -> list[str]:
    """What looks wrong with the `height` (m) and `mass` (kg) that were measured of an object, if anything."""
    warnings = []
    if (height := measured.get("height")) is not None:
        size = float(np.ptp(grid.exterior, axis=0).max())
        if not _HEIGHT_PER_SIZE[0] <= height / size <= _HEIGHT_PER_SIZE[1]:
            warnings.append(
                f"{where}.height is {height:g} m over a footprint of {size:.3g} m; are both in m?"
            )
    if (mass := measured.get("mass")) is not None:
        area = float(grid.polygon.area)
        if not LEAST_PER_AREA <= mass / area <= MOST_PER_AREA:
            warnings.append(
                f"{where}.mass is {mass:g} kg on {1e4 * area:.3g} cm², {mass / area:.3g} kg/m²; is it in kg,"
                " and the outline in m?"
            )
    return warnings


def _grid(shape: dict[str, Any], where: str, warnings: list[str]) -> CellGrid:
    rows = parsing.required(shape, "outline", where, "give the corners of the footprint, [[x, y], ...] in m")
    outline = _outline(rows, f"{where}.outline", warnings)
    openings = shape.get("holes") or []
    if not isinstance(openings, list):
        raise DatasetError(
            f"{where}.holes: must be a list of rings, [[[x, y], ...], ...] in m,"
            f" got {parsing.shown(openings)}"
        )
    holes = [_outline(ring, f"{where}.holes[{k}]", warnings) for k, ring in enumerate(openings)]
    cells = shape.get("cells")
    try:
        if cells is None:
            from slipmap.models.objects.footprints import cells_from_polygon

            return cells_from_polygon(outline, holes)
        cells = parsing.section(cells, ("width", "centers"), f"{where}.cells", warnings)
        width = _LENGTH.read(cells.get("width"), f"{where}.cells.width")
        centers = parsing.table(cells.get("centers"), 2, f"{where}.cells.centers")
        _refuse_extent(np.append(centers, [[width, width]], axis=0), f"{where}.cells")
        grid = CellGrid(centers, width, outline, tuple(holes))
    except DatasetError:
        raise
    except ValueError as error:
        other = "hole" if str(error).startswith("holes") else "cells"
        raise DatasetError(f"{where}: {error}; correct the outline or the {other}") from None
    warnings += _doubtful_cells(grid, f"{where}.cells")
    return grid


def _outline(rows: object, where: str, warnings: list[str]) -> FloatArray:
    outline = parsing.table(rows, 2, where)
    if not np.isfinite(outline).all():
        row = int(np.flatnonzero(~np.isfinite(outline).all(axis=1))[0])
        raise DatasetError(
            f"{where}, row {row}: a corner must be two finite numbers, got {outline[row].tolist()}"
        )
    if len(outline) > 1 and np.array_equal(outline[0], outline[-1]):
        warnings.append(
            f"{where}: the last corner repeats the first and is left out; the outline closes by itself"
        )
        outline = outline[:-1]
    repeated = (outline == np.roll(outline, 1, axis=0)).all(axis=1)
    if len(outline) > 1 and repeated.any():
        first = int(np.flatnonzero(repeated)[0])
        warnings.append(f"{where}, row {first}: repeats the corner before it and is left out")
        outline = outline[~repeated]
    _refuse_extent(outline, where)
    return outline


def _refuse_extent(points: FloatArray, where: str) -> None:
    extent = float(np.max(np.abs(points), initial=0.0))
    if extent > _LARGEST_EXTENT:
        raise DatasetError(
            f"{where}: reaches {extent:g} m from the object frame; lengths are in m, divide by 1000?"
        )
    if 0.0 < extent < _SMALLEST_EXTENT:
        raise DatasetError(f"{where}: is only {extent:g} m across; lengths are in m, multiply by 1000?")


def _doubtful_cells(grid: CellGrid, where: str) -> list[str]:
    points = shapely.points(grid.centers)
    slack = 0.1 * grid.width  # centres are often rounded, and a camera sees the outline again and again
    outside = np.flatnonzero(shapely.distance(grid.polygon, points) > slack)
    if len(outside) == len(grid):
        raise DatasetError(
            f"{where}: no centre lies inside the outline; give both in m and in the object frame"
        )
    warnings = []
    if len(outside):
        warnings.append(
            f"{where}: {len(outside)} of {len(grid)} centres lie outside the outline, first row {outside[0]}"
        )
    repeated = len(np.unique(grid.centers, axis=0)) < len(grid)
    # Distance to the nearest centre at a different place.
    _, apart = shapely.STRtree(points).query_nearest(points, exclusive=True, return_distance=True)
    if repeated or np.min(apart, initial=np.inf) < 0.5 * grid.width:
        warnings.append(f"{where}: some cells overlap by half a cell or more; each should be listed once")
    covered = len(grid) * grid.width**2 / grid.polygon.area
    if not 0.5 < covered < 1.5:
        warnings.append(
            f"{where}: the cells' area is {covered:.2g} times that of the outline; is the width right?"
        )
    return warnings


def _table(value: object, where: str, warnings: list[str]) -> Table | None:
    if value is None:
        return None
    table = parsing.mapping(value, where)
    shape = table.get("shape")
    center = parsing.pair(table.get("center"), f"{where}.center")
    if shape not in ("round", "rectangle"):
        raise DatasetError(f"{where}.shape: must be round or rectangle, got {parsing.shown(shape)}")
    measure = "radius" if shape == "round" else "size"
    warnings += parsing.unknown_keys(table, ("shape", "center", measure), where)
    if shape == "round":
        return Table("round", center, radius=_LENGTH.read(table.get("radius"), f"{where}.radius"))
    size = parsing.pair(table.get("size"), f"{where}.size")
    for side in size:
        _LENGTH.read(side, f"{where}.size")
    return Table("rectangle", center, size=size)


def _noise(value: object, where: str, warnings: list[str]) -> Noise:
    if value is None:
        return Noise()
    return Noise(**_numbers(parsing.section(value, _NOISE, where, warnings), _NOISE, where))
