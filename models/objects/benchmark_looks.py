"""What the paper's six objects look like: coloured solids over their regions, in mm, z up from the table."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import shapely
import trimesh
from shapely.geometry import Point
from shapely.geometry.base import BaseGeometry

from slipmap.models.objects.meshes import lofted, rounded

Color = tuple[float, float, float, float]
Part = tuple[trimesh.Trimesh, Color]

ENDPAPER: Color = (0.42, 0.53, 0.62, 1.0)
IVORY: Color = (0.95, 0.92, 0.83, 1.0)
CLOTH: Color = (0.45, 0.11, 0.13, 1.0)
INK: Color = (0.25, 0.25, 0.27, 1.0)
CARDBOARD: Color = (0.64, 0.46, 0.29, 1.0)
PALE_CARDBOARD: Color = (0.77, 0.60, 0.41, 1.0)
TAPE: Color = (0.83, 0.71, 0.50, 1.0)
WHITE: Color = (0.96, 0.96, 0.95, 1.0)
BLACK_STEEL: Color = (0.16, 0.17, 0.19, 1.0)
STEEL: Color = (0.55, 0.58, 0.62, 1.0)
SATIN_STEEL: Color = (0.70, 0.72, 0.74, 1.0)
CHROME: Color = (0.83, 0.85, 0.88, 1.0)
WOOD: Color = (0.78, 0.56, 0.31, 1.0)
DARK_WOOD: Color = (0.62, 0.41, 0.20, 1.0)
YELLOW: Color = (0.96, 0.78, 0.18, 1.0)
GREEN: Color = (0.16, 0.50, 0.24, 1.0)
RED: Color = (0.80, 0.10, 0.11, 1.0)
BLUE: Color = (0.08, 0.42, 0.66, 1.0)
PALE_BLUE: Color = (0.55, 0.80, 0.92, 1.0)


def _slab(x0: float, y0: float, x1: float, y1: float, base: float, top: float) -> trimesh.Trimesh:
    return lofted(shapely.box(x0, y0, x1, y1), [(0, base), (0, top)])


def _book(regions: Sequence[BaseGeometry]) -> list[Part]:
    left, right = regions
    lines = [(y, 330 if k % 4 else 290) for k, y in enumerate(range(165, 30, -11))]
    return [
        (lofted(left, [(0, 0), (0, 3)]), CLOTH),
        (lofted(right, [(0, 0), (0, 3)]), CLOTH),
        # The pages reach almost to the cover's edge: the finger pushes them, and what it pushes must be seen.
        (lofted(shapely.box(0.5, 0.5, 176, 254.5), [(0, 3), (0, 6), (1, 7)]), ENDPAPER),
        (lofted(shapely.box(176, 0.5, 363.5, 254.5), [(0, 3), (0, 28.5), (0.7, 29.7), (1.5, 30)]), IVORY),
        (_slab(215, 195, 270, 202, 30, 30.3), INK),
        *((_slab(215, y, end, y + 3, 30, 30.3), INK) for y, end in lines),
    ]


def _box(regions: Sequence[BaseGeometry]) -> list[Part]:
    left, right = regions
    return [
        (lofted(left, [(0, 0), (0, 68.5), (1.5, 70)]), CARDBOARD),
        (lofted(right, [(0, 0), (0, 68.5), (1.5, 70)]), PALE_CARDBOARD),
        (_slab(1, 58, 360, 72, 69.5, 70.2), TAPE),
        (_slab(255, 14, 335, 50, 69.5, 70.2), WHITE),
        *((_slab(x, 20, x + 2 + x % 3, 34, 70, 70.4), INK) for x in range(264, 326, 5)),
    ]


def _hammer(regions: Sequence[BaseGeometry]) -> list[Part]:
    head, handle = regions
    face = shapely.intersection(head, shapely.box(0, 0, 48, 20))
    rest = shapely.difference(head, shapely.box(0, 0, 48, 20))
    end = shapely.intersection(handle, shapely.box(322, 0, 400, 200))
    return [
        (lofted(rest, [(0, 0), *rounded(25, 7, 9, 10)]), BLACK_STEEL),
        (lofted(face, [(0, 0), *rounded(26, 5, 5, 10)]), STEEL),
        (lofted(handle, [(0, 0), *rounded(25, 13, 15, 8)]), WOOD),
        (lofted(end, [(0, 1), *rounded(25.5, 12, 14, 8)]), DARK_WOOD),
    ]


def _wrench(regions: Sequence[BaseGeometry]) -> list[Part]:
    jaw, shank, eye = regions
    return [
        (lofted(jaw, [(0, 0), *rounded(8, 1.5)]), STEEL),
        (lofted(shank, [(0, 0), *rounded(7, 2.5)]), SATIN_STEEL),
        (_slab(85, 16.5, 190, 27.5, 6.5, 7.2), BLACK_STEEL),
        (lofted(eye, [(0, 0), *rounded(8, 1.5)]), CHROME),
    ]


def _snack(regions: Sequence[BaseGeometry]) -> list[Part]:
    empty, full = regions
    # A bag that swells towards what is in it; steep at the sides, where the finger pushes it.
    pillow = [(0, 7), (0.4, 30), (2, 37), (6, 40.5), (16, 43.5), (32, 45)]
    bag = shapely.union_all([empty, full])
    filling = shapely.intersection(shapely.box(96, 0, 300, 300), bag.buffer(-0.5))
    flap = shapely.intersection(shapely.box(10, 0, 111, 300), bag.buffer(-0.5))
    return [
        (lofted(empty, [(0, 0), (0, 6), (1, 7)]), YELLOW),
        (lofted(full, [(0, 0), (0, 6), (1, 7)]), GREEN),
        (lofted(flap, rounded(20, 45, 13, 7)), YELLOW),
        (lofted(filling, pillow), GREEN),
    ]


def _spray_gun(regions: Sequence[BaseGeometry]) -> list[Part]:
    head, bottle = regions
    back = shapely.intersection(head, shapely.box(-5, 0, 16, 200))
    trigger = shapely.intersection(head, shapely.box(16, 0, 60, 33))
    nozzle = shapely.intersection(head, shapely.box(16, 33, 48, 200))
    neck = shapely.intersection(head, shapely.box(48, 33, 68, 200))
    shoulder = shapely.difference(head, shapely.box(-5, -5, 68, 200))
    return [
        (lofted(back, [(0, 0), *rounded(38, 7, 10, 4)]), RED),
        (lofted(trigger, [(0, 0), *rounded(24, 3, 4, 4)]), RED),
        (lofted(nozzle, [(0, 0), *rounded(38, 10, 12, 4)]), WHITE),
        (lofted(neck, [(0, 0), *rounded(36, 9, 14, 4)]), WHITE),
        (lofted(shoulder, [(0, 0), *rounded(38, 16, 24, 6)]), PALE_BLUE),
        (lofted(bottle, [(0, 0), *rounded(60, 18, 28, 8)]), BLUE),
        (_slab(178, 24, 258, 92, 59.5, 60.3), WHITE),
        (lofted(Point(218, 58).buffer(24), [(0, 60), (0, 60.6)]), RED),
    ]


PARTS: dict[str, Callable[[Sequence[BaseGeometry]], list[Part]]] = {
    "book": _book,
    "box": _box,
    "hammer": _hammer,
    "wrench": _wrench,
    "snack": _snack,
    "spray_gun": _spray_gun,
}
"""Solids by the object's name, from the outlines of its regions in mm."""
