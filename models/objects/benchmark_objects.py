"""Objects whose truth is known: the six of Song and Boularias (2020), shaped after their pictures, and the
demonstration's hammer."""

from __future__ import annotations

from difflib import get_close_matches
from typing import NamedTuple

import numpy as np
import shapely
from shapely.geometry import Point, Polygon
from shapely.geometry.base import BaseGeometry

from slipmap.models.objects import benchmark_looks as looks
from slipmap.models.objects.footprints import cells_from_polygon, rings_of
from slipmap.models.objects.meshes import coloured
from slipmap.models.objects.true_object import Block, TrueObject, cell_heights
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Maps

MM = 1e-3
Ring = list[tuple[float, float]]


class _Region(NamedTuple):
    """A segment of the paper.

    Attributes:
        outline: in mm, x right and y up in the picture, from the object's lower left.
        height: mm.
        cell_mass: of one cell in the authors' simulation, kg; only ratios within an object matter here.
        mu: friction coefficient with the table.
        color: red, green, blue, opacity.
    """

    outline: BaseGeometry
    height: float
    cell_mass: float
    mu: float
    color: looks.Color


class _Whole(NamedTuple):
    mass: float  # kg
    cells: int  # about so many
    mu_finger: float


_HAMMER_HEAD: Ring = [
    (48, 49), (48, 81), (37, 85), (32, 94), (41, 110), (60, 124), (57, 131), (40, 124), (22, 109),
    (7, 90), (1, 62), (6, 36), (3, 24), (2, 2), (30, 2), (30, 24), (24, 40), (32, 49),
]  # fmt: skip
_HAMMER_HANDLE: Ring = [
    (48, 51), (48, 81), (80, 79), (240, 80), (310, 82), (340, 81), (346, 76), (346, 56), (340, 51),
    (310, 50), (240, 52), (80, 53),
]  # fmt: skip
_WRENCH_JAW: Ring = [
    (44, 13), (44, 31), (37, 38), (28, 42), (12, 42), (4, 37), (0, 30), (19, 29), (25, 24), (25, 18),
    (20, 14), (5, 8), (14, 2), (27, 1), (37, 6),
]  # fmt: skip
_SPRAY_HEAD: Ring = [
    (152, 115), (139, 116), (57, 79), (46, 81), (36, 95), (36, 108), (24, 108), (8, 98), (2, 89), (0, 14),
    (13, 14), (27, 22), (53, 10), (57, 16), (30, 31), (32, 47), (50, 48), (68, 40), (124, 35), (149, 23),
    (166, 1),
]  # fmt: skip
_SPRAY_BOTTLE: Ring = [(152, 115), (166, 1), (275, 2), (284, 5), (287, 12), (287, 98), (283, 105), (253, 114)]
_SNACK_EMPTY: Ring = [(0, 199), (1, 1), (110, 2), (110, 199)]
_SNACK_FULL: Ring = [(110, 2), (116, 2), (240, 35), (236, 174), (122, 200), (110, 199)]

_RING = Point(259, 20.5).buffer(17, quad_segs=6)
_WRENCH_SHANK = shapely.box(44, 13, 262, 31)
_WRENCH_EYE = _RING.difference(Point(259, 20.5).buffer(9.5, quad_segs=3))

_REGIONS = {
    "book": (
        _Region(shapely.box(0, 0, 176, 255), 7, 0.370, 0.45, looks.ENDPAPER),
        _Region(shapely.box(176, 0, 364, 255), 30, 4.043, 0.35, looks.IVORY),
    ),
    "box": (
        _Region(shapely.box(0, 0, 173, 129), 70, 4.871, 0.30, looks.CARDBOARD),
        _Region(shapely.box(173, 0, 361, 129), 70, 1.508, 0.42, looks.PALE_CARDBOARD),
    ),
    "hammer": (
        _Region(Polygon(_HAMMER_HEAD), 25, 3.320, 0.22, looks.BLACK_STEEL),
        _Region(Polygon(_HAMMER_HANDLE), 25, 0.744, 0.45, looks.WOOD),
    ),
    "wrench": (
        _Region(Polygon(_WRENCH_JAW), 8, 3.901, 0.20, looks.STEEL),
        _Region(_WRENCH_SHANK.difference(_RING), 8, 0.005, 0.25, looks.SATIN_STEEL),
        _Region(_WRENCH_EYE, 8, 1.611, 0.28, looks.CHROME),
    ),
    "snack": (
        _Region(Polygon(_SNACK_EMPTY), 20, 0.938, 0.55, looks.YELLOW),
        _Region(Polygon(_SNACK_FULL), 45, 4.390, 0.38, looks.GREEN),
    ),
    "spray_gun": (
        _Region(Polygon(_SPRAY_HEAD), 38, 0.125, 0.50, looks.RED),
        _Region(Polygon(_SPRAY_BOTTLE), 60, 4.234, 0.30, looks.BLUE),
    ),
}
_WHOLES = {
    "book": _Whole(1.4, 35, 0.30),
    "box": _Whole(1.6, 44, 0.35),
    "hammer": _Whole(0.75, 60, 0.25),
    "wrench": _Whole(0.28, 62, 0.20),
    "snack": _Whole(0.4, 44, 0.40),
    "spray_gun": _Whole(0.9, 50, 0.30),
}
BENCHMARK_OBJECTS = tuple(_WHOLES)
"""Names of the paper's objects."""


def benchmark_object(name: str) -> TrueObject:
    """One of the paper's six objects.

    Outlines and regions are those of the authors' pictures (0.53 m / 640 a pixel), simplified. Masses keep
    the ratios between segments of the authors' simulation, scaled to what such a thing weighs; friction is
    chosen here, another one for each segment. The object frame lies at the outline's centroid, x to the right
    and y up in the picture.

    Raises:
        ValueError: an unknown name; lists the names there are and the nearest.
    """
    if name not in _WHOLES:
        near = get_close_matches(str(name).lower().replace(" ", "_"), BENCHMARK_OBJECTS, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise ValueError(f"object {name!r} is unknown; there are {', '.join(BENCHMARK_OBJECTS)}{hint}")
    regions, whole = _REGIONS[name], _WHOLES[name]
    union = shapely.union_all([region.outline for region in regions], grid_size=1e-3)
    assert isinstance(union, Polygon)
    origin = np.array(union.centroid.coords[0])
    placed = [_placed(region.outline, origin) for region in regions]
    grid = cells_from_polygon(*rings_of(_placed(union.simplify(0.01), origin)), count=whole.cells)
    labels = np.argmin([shapely.distance(part, shapely.points(grid.centers)) for part in placed], axis=0)
    relative = np.array([region.cell_mass for region in regions])[labels]
    mesh = coloured(looks.PARTS[name]([region.outline for region in regions]))
    mesh.apply_translation([-origin[0], -origin[1], 0.0])
    mesh.apply_scale(MM)
    return TrueObject(
        name=name,
        grid=grid,
        labels=labels,
        mass=whole.mass * relative / relative.sum(),
        mu=np.array([region.mu for region in regions])[labels],
        mu_finger=whole.mu_finger,
        height=cell_heights(mesh, grid),
        mesh=mesh,
        colors=np.array([region.color for region in regions]),
        blocks=tuple(Block(part, region.height * MM) for part, region in zip(placed, regions, strict=True)),
    )


def _placed(outline: BaseGeometry, origin: FloatArray) -> Polygon:
    """From mm in the picture to m in the object frame."""
    placed = shapely.transform(outline, lambda points: (points - origin) * MM)
    assert isinstance(placed, Polygon)
    return placed


HEAD = (0.1, 0.0375, 0.025)
"""Of the demonstration's hammer: length across the handle, width along it and height, m."""
_HANDLE = (0.025, 0.225, 0.02)  # m; width, length and height
_STEEL, _BEECH = 7850.0, 700.0  # kg/m³


def hammer() -> tuple[CellGrid, Maps]:
    """The demonstration's hammer: 60 cells and their true maps.

    Its head is 0.74 kg of steel that slides easily (μ = 0.2), its handle 0.08 kg of wood that does not (0.4).

    The object frame lies in the middle of the whole length, y towards the head.
    """
    half = (HEAD[1] + _HANDLE[1]) / 2
    joint = half - HEAD[1]
    right = [(_HANDLE[0] / 2, -half), (_HANDLE[0] / 2, joint), (HEAD[0] / 2, joint), (HEAD[0] / 2, half)]
    outline = np.array(right + [(-x, y) for x, y in reversed(right)])
    cell = 0.0125
    grid = cells_from_polygon(outline, width=cell)
    is_head = grid.centers[:, 1] > joint
    mass = cell**2 * np.where(is_head, _STEEL * HEAD[2], _BEECH * _HANDLE[2])
    return grid, Maps(mass, np.where(is_head, 0.2, 0.4), np.array([0.3]))
