"""The part of a dataset that is not a trial: object, finger, table, gravity and sensor noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from slipmap.models.measurements import fields
from slipmap.models.measurements.push_dataset import DatasetError, Noise, Table
from slipmap.models.physics.cell_grid import CellGrid, FloatArray

SETUP_KEYS = ("name", "description", "object", "finger", "table", "gravity", "noise")
DEFAULT_CELLS = 60
STANDARD_GRAVITY = 9.81  # m/s²
SMALLEST_EXTENT = 1e-3  # m
LARGEST_EXTENT = 5.0  # m; no object on a table is larger, so the numbers are mm
LARGEST_FINGER = 0.5  # m
LARGEST_NOISE = {"position": 0.1, "angle": 1.0, "tip": 0.1, "force": 1e3}  # m, rad, m, N
MASSES = (1e-6, 1e6)  # kg
GRAVITIES = (1e-3, 1e3)  # m/s²
HEIGHT_PER_SIZE = (1e-3, 10.0)  # of a sheet of card, and of a tall bottle
MASS_PER_AREA = (0.1, 2e4)  # kg/m²; of stiff paper, and of two metres of steel
NEAR_GRAVITY = (1.0, 30.0)  # m/s²; from the moon to a heavy planet


@dataclass(frozen=True, eq=False)
class Setup:
    """What was pushed, with what and on what; the attributes are those of PushDataset."""

    name: str
    description: str
    grid: CellGrid
    height: float | None
    mass: float | None
    finger_radius: float
    table: Table | None
    gravity: float
    noise: Noise
    warnings: tuple[str, ...]


def parse_setup(document: dict[str, Any], where: str, default_name: str) -> Setup:
    """Setup from the keys of a dataset.yaml.

    Args:
        document: the parsed mapping; keys beyond `SETUP_KEYS` are the caller's.
        where: the file, for error texts.
        default_name: name where the document gives none.

    Raises:
        DatasetError: a missing key, a wrong type, a number out of range, an outline that crosses itself.
    """
    shape = fields.mapping(
        fields.required(document, "object", where, "give at least its outline"), f"{where}: object"
    )
    finger = fields.mapping(
        fields.required(document, "finger", where, "give finger.radius in m"), f"{where}: finger"
    )
    warnings = fields.unknown_keys(shape, ("outline", "cells", "height", "mass"), f"{where}: object")
    warnings += fields.unknown_keys(finger, ("radius",), f"{where}: finger")
    grid = _grid(shape, f"{where}: object", warnings)
    radius = fields.positive(finger.get("radius"), f"{where}: finger.radius", "m")
    if radius > LARGEST_FINGER:
        raise DatasetError(
            f"{where}: finger.radius is {radius:g} m; no finger is that thick, divide by 1000?"
        )
    gravity = fields.positive(document.get("gravity", STANDARD_GRAVITY), f"{where}: gravity", "m/s²")
    _refuse_beyond(gravity, GRAVITIES, f"{where}: gravity", "m/s²")
    if not NEAR_GRAVITY[0] <= gravity <= NEAR_GRAVITY[1]:
        warnings.append(f"{where}: gravity is {gravity:g} m/s²; 9.81 was to be expected")
    return Setup(
        name=fields.text(document.get("name", default_name), f"{where}: name"),
        description=fields.text(document.get("description", ""), f"{where}: description"),
        grid=grid,
        height=_height(shape, grid, f"{where}: object.height", warnings),
        mass=_mass(shape, grid, f"{where}: object.mass", warnings),
        finger_radius=radius,
        table=_table(document.get("table"), f"{where}: table", warnings),
        gravity=gravity,
        noise=_noise(document.get("noise"), f"{where}: noise", warnings),
        warnings=tuple(warnings),
    )


def _height(shape: dict[str, Any], grid: CellGrid, where: str, warnings: list[str]) -> float | None:
    height = _optional(shape, "height", where, "m")
    if height is None:
        return None
    size = float(np.ptp(grid.exterior, axis=0).max())
    if not HEIGHT_PER_SIZE[0] <= height / size <= HEIGHT_PER_SIZE[1]:
        warnings.append(f"{where} is {height:g} m over a footprint of {size:.3g} m; are both in m?")
    return height


def _mass(shape: dict[str, Any], grid: CellGrid, where: str, warnings: list[str]) -> float | None:
    mass = _optional(shape, "mass", where, "kg")
    if mass is None:
        return None
    _refuse_beyond(mass, MASSES, where, "kg")
    per_area = mass / float(grid.polygon.area)
    if not MASS_PER_AREA[0] <= per_area <= MASS_PER_AREA[1]:
        warnings.append(
            f"{where} is {mass:g} kg on {1e4 * grid.polygon.area:.3g} cm², {per_area:.3g} kg/m²; is it in kg,"
            " and the outline in m?"
        )
    return mass


def _refuse_beyond(value: float, limits: tuple[float, float], where: str, unit: str) -> None:
    if not limits[0] <= value <= limits[1]:
        raise DatasetError(f"{where}: lies in {limits[0]:g} to {limits[1]:g} {unit}, got {value:g}")


def _optional(values: dict[str, Any], key: str, where: str, unit: str) -> float | None:
    return None if values.get(key) is None else fields.positive(values[key], where, unit)


def _grid(shape: dict[str, Any], where: str, warnings: list[str]) -> CellGrid:
    rows = fields.required(shape, "outline", where, "give the corners of the footprint, [[x, y], ...] in m")
    outline = _outline(rows, f"{where}.outline", warnings)
    cells = shape.get("cells")
    try:
        if cells is None:
            from slipmap.models.objects.footprints import cells_from_polygon

            return cells_from_polygon(outline, count=DEFAULT_CELLS)
        cells = fields.mapping(cells, f"{where}.cells")
        warnings += fields.unknown_keys(cells, ("width", "centers"), f"{where}.cells")
        width = fields.positive(cells.get("width"), f"{where}.cells.width", "m")
        centers = fields.table(cells.get("centers"), 2, f"{where}.cells.centers")
        _refuse_extent(np.append(centers, [[width, width]], axis=0), f"{where}.cells")
        grid = CellGrid(centers, width, outline)
    except DatasetError:
        raise
    except ValueError as error:
        raise DatasetError(f"{where}: {error}; correct the outline or the cells") from None
    warnings += _doubtful_cells(grid, f"{where}.cells")
    return grid


def _outline(rows: object, where: str, warnings: list[str]) -> FloatArray:
    outline = fields.table(rows, 2, where)
    if not np.isfinite(outline).all():
        row = int(np.flatnonzero(~np.isfinite(outline).all(axis=1))[0])
        raise DatasetError(
            f"{where}, row {row}: a corner must be two finite numbers, got {outline[row].tolist()}"
        )
    if len(outline) > 1 and np.array_equal(outline[0], outline[-1]):
        warnings.append(
            f"{where}: the last corner repeats the first and is left out; the outline closes itself"
        )
        outline = outline[:-1]
    repeated = np.flatnonzero((outline == np.roll(outline, 1, axis=0)).all(axis=1))
    if len(outline) > 1 and len(repeated):
        raise DatasetError(f"{where}, row {repeated[0]}: the same corner as the one before; leave it out")
    _refuse_extent(outline, where)
    return outline


def _refuse_extent(points: FloatArray, where: str) -> None:
    extent = float(np.max(np.abs(points), initial=0.0))
    if extent > LARGEST_EXTENT:
        raise DatasetError(
            f"{where}: reaches {extent:g} m from the object frame; lengths are in m, divide by 1000?"
        )
    if 0.0 < extent < SMALLEST_EXTENT:
        raise DatasetError(f"{where}: is only {extent:g} m large; lengths are in m, multiply by 1000?")


def _doubtful_cells(grid: CellGrid, where: str) -> list[str]:
    points = shapely.points(grid.centers)
    slack = 1e-3 * grid.width  # centres are often rounded
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
    # To the nearest that is not at the same place.
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
    table = fields.mapping(value, where)
    shape = table.get("shape")
    center = fields.pair(table.get("center"), f"{where}.center")
    if shape == "round":
        warnings += fields.unknown_keys(table, ("shape", "center", "radius"), where)
        return Table("round", center, radius=fields.positive(table.get("radius"), f"{where}.radius", "m"))
    if shape == "rectangle":
        warnings += fields.unknown_keys(table, ("shape", "center", "size"), where)
        size = fields.pair(table.get("size"), f"{where}.size")
        for side in size:
            fields.positive(side, f"{where}.size", "m")
        return Table("rectangle", center, size=size)
    raise DatasetError(f"{where}.shape: must be round or rectangle, got {fields.shown(shape)}")


def _noise(value: object, where: str, warnings: list[str]) -> Noise:
    if value is None:
        return Noise()
    noise = fields.mapping(value, where)
    known = ("position", "angle", "tip", "force")
    warnings += fields.unknown_keys(noise, known, where)
    levels = {key: fields.number(noise[key], f"{where}.{key}") for key in known if noise.get(key) is not None}
    for key, level in levels.items():
        if not 0 <= level <= LARGEST_NOISE[key]:
            raise DatasetError(
                f"{where}.{key}: a standard deviation lies in 0 to {LARGEST_NOISE[key]:g}, got {level}"
            )
    return Noise(**levels)
