"""Objects with known true maps: the six of Song and Boularias (2020), shaped and coloured after their
pictures, and the demonstration's hammer."""

from collections.abc import Callable, Sequence
from difflib import get_close_matches
from typing import NamedTuple

import numpy as np
import shapely
from shapely.geometry import Point, Polygon
from shapely.geometry.base import BaseGeometry

from slipmap.models.objects.footprints import cells_from_polygon, rings_of
from slipmap.models.objects.meshes import coloured, lofted, rounded, trimesh
from slipmap.models.objects.true_object import Block, TrueObject, cell_heights
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Maps

_MM = 1e-3
_Ring = list[tuple[float, float]]
Color = tuple[float, float, float, float]
Part = tuple[trimesh.Trimesh, Color]

_ENDPAPER: Color = (0.42, 0.53, 0.62, 1.0)
_IVORY: Color = (0.95, 0.92, 0.83, 1.0)
_CLOTH: Color = (0.45, 0.11, 0.13, 1.0)
_INK: Color = (0.25, 0.25, 0.27, 1.0)
_CARDBOARD: Color = (0.64, 0.46, 0.29, 1.0)
_PALE_CARDBOARD: Color = (0.77, 0.60, 0.41, 1.0)
_TAPE: Color = (0.83, 0.71, 0.50, 1.0)
_WHITE: Color = (0.96, 0.96, 0.95, 1.0)
_BLACK_STEEL: Color = (0.16, 0.17, 0.19, 1.0)
_STEEL: Color = (0.55, 0.58, 0.62, 1.0)
_SATIN_STEEL: Color = (0.70, 0.72, 0.74, 1.0)
_CHROME: Color = (0.83, 0.85, 0.88, 1.0)
_WOOD: Color = (0.78, 0.56, 0.31, 1.0)
_DARK_WOOD: Color = (0.62, 0.41, 0.20, 1.0)
_YELLOW: Color = (0.96, 0.78, 0.18, 1.0)
_GREEN: Color = (0.16, 0.50, 0.24, 1.0)
_RED: Color = (0.80, 0.10, 0.11, 1.0)
_BLUE: Color = (0.08, 0.42, 0.66, 1.0)
_PALE_BLUE: Color = (0.55, 0.80, 0.92, 1.0)


class _Region(NamedTuple):
    """A segment of the paper."""

    outline: BaseGeometry  # mm, x right and y up in the picture, from the object's lower left corner
    height: float  # mm
    cell_mass: float  # of one cell in the authors' simulation, kg; only ratios within an object are used
    mu: float  # friction coefficient with the table
    color: Color  # red, green, blue, opacity


class _Whole(NamedTuple):
    mass: float  # kg
    cells: int  # approximate number
    mu_finger: float


_HAMMER_HEAD: _Ring = [
    (48, 49), (48, 81), (37, 85), (32, 94), (41, 110), (60, 124), (57, 131), (40, 124), (22, 109),
    (7, 90), (1, 62), (6, 36), (3, 24), (2, 2), (30, 2), (30, 24), (24, 40), (32, 49),
]  # fmt: skip
_HAMMER_HANDLE: _Ring = [
    (48, 51), (48, 81), (80, 79), (240, 80), (310, 82), (340, 81), (346, 76), (346, 56), (340, 51),
    (310, 50), (240, 52), (80, 53),
]  # fmt: skip
_WRENCH_JAW: _Ring = [
    (44, 13), (44, 31), (37, 38), (28, 42), (12, 42), (4, 37), (0, 30), (19, 29), (25, 24), (25, 18),
    (20, 14), (5, 8), (14, 2), (27, 1), (37, 6),
]  # fmt: skip
_SPRAY_HEAD: _Ring = [
    (152, 115), (139, 116), (57, 79), (46, 81), (36, 95), (36, 108), (24, 108), (8, 98), (2, 89), (0, 14),
    (13, 14), (27, 22), (53, 10), (57, 16), (30, 31), (32, 47), (50, 48), (68, 40), (124, 35), (149, 23),
    (166, 1),
]  # fmt: skip
_SPRAY_BOTTLE: _Ring = [
    (152, 115), (166, 1), (275, 2), (284, 5), (287, 12), (287, 98), (283, 105), (253, 114),
]  # fmt: skip
_SNACK_EMPTY: _Ring = [(0, 199), (1, 1), (110, 2), (110, 199)]
_SNACK_FULL: _Ring = [(110, 2), (116, 2), (240, 35), (236, 174), (122, 200), (110, 199)]

_RING = Point(259, 20.5).buffer(17, quad_segs=6)
_WRENCH_SHANK = shapely.box(44, 13, 262, 31)
_WRENCH_EYE = _RING.difference(Point(259, 20.5).buffer(9.5, quad_segs=3))

_REGIONS = {
    "book": (
        _Region(shapely.box(0, 0, 176, 255), 7, 0.370, 0.45, _ENDPAPER),
        _Region(shapely.box(176, 0, 364, 255), 30, 4.043, 0.35, _IVORY),
    ),
    "box": (
        _Region(shapely.box(0, 0, 173, 129), 70, 4.871, 0.30, _CARDBOARD),
        _Region(shapely.box(173, 0, 361, 129), 70, 1.508, 0.42, _PALE_CARDBOARD),
    ),
    "hammer": (
        _Region(Polygon(_HAMMER_HEAD), 25, 3.320, 0.22, _BLACK_STEEL),
        _Region(Polygon(_HAMMER_HANDLE), 25, 0.744, 0.45, _WOOD),
    ),
    "wrench": (
        _Region(Polygon(_WRENCH_JAW), 8, 3.901, 0.20, _STEEL),
        _Region(_WRENCH_SHANK.difference(_RING), 8, 0.005, 0.25, _SATIN_STEEL),
        _Region(_WRENCH_EYE, 8, 1.611, 0.28, _CHROME),
    ),
    "snack": (
        _Region(Polygon(_SNACK_EMPTY), 20, 0.938, 0.55, _YELLOW),
        _Region(Polygon(_SNACK_FULL), 45, 4.390, 0.38, _GREEN),
    ),
    "spray_gun": (
        _Region(Polygon(_SPRAY_HEAD), 38, 0.125, 0.50, _RED),
        _Region(Polygon(_SPRAY_BOTTLE), 60, 4.234, 0.30, _BLUE),
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
BENCHMARK_OBJECTS = tuple(_WHOLES)  # names of the paper's objects


def benchmark_object(name: str) -> TrueObject:
    """One of the paper's six objects.

    Outlines and regions are simplified from the authors' pictures (0.53 m / 640 per pixel). Masses keep the
    ratios between segments of the authors' simulation, scaled to a realistic total; friction is chosen here
    and differs between segments. The object frame lies at the outline's centroid, with x to the right and y
    up in the picture.

    Raises:
        ValueError: an unknown name; the message lists the known ones and the nearest.

    Example:
        >>> import slipmap
        >>> wrench = slipmap.benchmark_object("wrench")
        >>> len(wrench.grid), round(float(wrench.mass.sum()), 2)
        (62, 0.28)
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
    mesh = coloured(_PARTS[name]([region.outline for region in regions]))
    mesh.apply_translation([-origin[0], -origin[1], 0.0])
    mesh.apply_scale(_MM)
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
        blocks=tuple(Block(part, region.height * _MM) for part, region in zip(placed, regions, strict=True)),
    )


def _placed(outline: BaseGeometry, origin: FloatArray) -> Polygon:
    """The outline moved from mm in the picture to m in the object frame."""
    placed = shapely.transform(outline, lambda points: (points - origin) * _MM)
    assert isinstance(placed, Polygon)
    return placed


HEAD = (0.1, 0.0375, 0.025)
"""Head of the demonstration's hammer: length across the handle, width along it, height, m."""
HANDLE = (0.025, 0.225, 0.02)  # handle of the demonstration's hammer: width, length, height, m
_STEEL_DENSITY, _BEECH_DENSITY = 7850.0, 700.0  # kg/m³


def hammer() -> tuple[CellGrid, Maps]:
    """The demonstration's hammer: 60 cells and their true maps.

    The head is 0.74 kg of steel with low friction (μ = 0.2), the handle 0.08 kg of wood with μ = 0.4. The
    object frame lies halfway along the hammer, y towards the head.

    Example:
        >>> import slipmap
        >>> grid, truth = slipmap.hammer()
        >>> len(grid), round(float(truth.mass.sum()), 2)
        (60, 0.81)
    """
    half = (HEAD[1] + HANDLE[1]) / 2
    joint = half - HEAD[1]
    right = [(HANDLE[0] / 2, -half), (HANDLE[0] / 2, joint), (HEAD[0] / 2, joint), (HEAD[0] / 2, half)]
    outline = np.array(right + [(-x, y) for x, y in reversed(right)])
    cell = 0.0125
    grid = cells_from_polygon(outline, width=cell)
    is_head = grid.centers[:, 1] > joint
    mass = cell**2 * np.where(is_head, _STEEL_DENSITY * HEAD[2], _BEECH_DENSITY * HANDLE[2])
    return grid, Maps(mass, np.where(is_head, 0.2, 0.4), np.array([0.3]))


# Looks of the objects: coloured solids over their regions, in mm, z up from the table.


def _slab(x0: float, y0: float, x1: float, y1: float, base: float, top: float) -> trimesh.Trimesh:
    return lofted(shapely.box(x0, y0, x1, y1), [(0, base), (0, top)])


def _book(regions: Sequence[BaseGeometry]) -> list[Part]:
    left, right = regions
    lines = [(y, 330 if k % 4 else 290) for k, y in enumerate(range(165, 30, -11))]
    return [
        (lofted(left, [(0, 0), (0, 3)]), _CLOTH),
        (lofted(right, [(0, 0), (0, 3)]), _CLOTH),
        # The pages reach almost to the cover's edge: the finger pushes them, so cameras must see them.
        (lofted(shapely.box(0.5, 0.5, 176, 254.5), [(0, 3), (0, 6), (1, 7)]), _ENDPAPER),
        (lofted(shapely.box(176, 0.5, 363.5, 254.5), [(0, 3), (0, 28.5), (0.7, 29.7), (1.5, 30)]), _IVORY),
        (_slab(215, 195, 270, 202, 30, 30.3), _INK),
        *((_slab(215, y, end, y + 3, 30, 30.3), _INK) for y, end in lines),
    ]


def _box(regions: Sequence[BaseGeometry]) -> list[Part]:
    left, right = regions
    return [
        (lofted(left, [(0, 0), (0, 68.5), (1.5, 70)]), _CARDBOARD),
        (lofted(right, [(0, 0), (0, 68.5), (1.5, 70)]), _PALE_CARDBOARD),
        (_slab(1, 58, 360, 72, 69.5, 70.2), _TAPE),
        (_slab(255, 14, 335, 50, 69.5, 70.2), _WHITE),
        *((_slab(x, 20, x + 2 + x % 3, 34, 70, 70.4), _INK) for x in range(264, 326, 5)),
    ]


def _hammer(regions: Sequence[BaseGeometry]) -> list[Part]:
    head, handle = regions
    face = shapely.intersection(head, shapely.box(0, 0, 48, 20))
    rest = shapely.difference(head, shapely.box(0, 0, 48, 20))
    end = shapely.intersection(handle, shapely.box(322, 0, 400, 200))
    return [
        (lofted(rest, [(0, 0), *rounded(25, 7, 9, 10)]), _BLACK_STEEL),
        (lofted(face, [(0, 0), *rounded(26, 5, 5, 10)]), _STEEL),
        (lofted(handle, [(0, 0), *rounded(25, 13, 15, 8)]), _WOOD),
        (lofted(end, [(0, 1), *rounded(25.5, 12, 14, 8)]), _DARK_WOOD),
    ]


def _wrench(regions: Sequence[BaseGeometry]) -> list[Part]:
    jaw, shank, eye = regions
    return [
        (lofted(jaw, [(0, 0), *rounded(8, 1.5)]), _STEEL),
        (lofted(shank, [(0, 0), *rounded(7, 2.5)]), _SATIN_STEEL),
        (_slab(85, 16.5, 190, 27.5, 6.5, 7.2), _BLACK_STEEL),
        (lofted(eye, [(0, 0), *rounded(8, 1.5)]), _CHROME),
    ]


def _snack(regions: Sequence[BaseGeometry]) -> list[Part]:
    empty, full = regions
    # A bag that bulges over its content, with steep sides where the finger pushes.
    pillow = [(0, 7), (0.4, 30), (2, 37), (6, 40.5), (16, 43.5), (32, 45)]
    bag = shapely.union_all([empty, full])
    filling = shapely.intersection(shapely.box(96, 0, 300, 300), bag.buffer(-0.5))
    flap = shapely.intersection(shapely.box(10, 0, 111, 300), bag.buffer(-0.5))
    return [
        (lofted(empty, [(0, 0), (0, 6), (1, 7)]), _YELLOW),
        (lofted(full, [(0, 0), (0, 6), (1, 7)]), _GREEN),
        (lofted(flap, rounded(20, 45, 13, 7)), _YELLOW),
        (lofted(filling, pillow), _GREEN),
    ]


def _spray_gun(regions: Sequence[BaseGeometry]) -> list[Part]:
    head, bottle = regions
    back = shapely.intersection(head, shapely.box(-5, 0, 16, 200))
    trigger = shapely.intersection(head, shapely.box(16, 0, 60, 33))
    nozzle = shapely.intersection(head, shapely.box(16, 33, 48, 200))
    neck = shapely.intersection(head, shapely.box(48, 33, 68, 200))
    shoulder = shapely.difference(head, shapely.box(-5, -5, 68, 200))
    return [
        (lofted(back, [(0, 0), *rounded(38, 7, 10, 4)]), _RED),
        (lofted(trigger, [(0, 0), *rounded(24, 3, 4, 4)]), _RED),
        (lofted(nozzle, [(0, 0), *rounded(38, 10, 12, 4)]), _WHITE),
        (lofted(neck, [(0, 0), *rounded(36, 9, 14, 4)]), _WHITE),
        (lofted(shoulder, [(0, 0), *rounded(38, 16, 24, 6)]), _PALE_BLUE),
        (lofted(bottle, [(0, 0), *rounded(60, 18, 28, 8)]), _BLUE),
        (_slab(178, 24, 258, 92, 59.5, 60.3), _WHITE),
        (lofted(Point(218, 58).buffer(24), [(0, 60), (0, 60.6)]), _RED),
    ]


_PARTS: dict[str, Callable[[Sequence[BaseGeometry]], list[Part]]] = {
    "book": _book,
    "box": _box,
    "hammer": _hammer,
    "wrench": _wrench,
    "snack": _snack,
    "spray_gun": _spray_gun,
}
