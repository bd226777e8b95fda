"""A finger meets the object's side at the outline, with the outline's normal, also at corners and seams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from slipmap.diagrams.station.finger_contact import skin_of, walls_of
from slipmap.diagrams.station.sliding_object import CLEARANCE
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.objects.footprints import without_scan_noise
from slipmap.models.objects.true_object import Block, TrueObject
from tests.diagrams.station.pushed_object import FINGER_RADIUS, TestBed

NAMES = ("book", "hammer", "wrench")
AT_REST = np.zeros(3)


def outline_of(thing: TrueObject) -> shapely.Polygon:
    """The union of the blocks, seen from above, with its exterior counter-clockwise."""
    whole = shapely.union_all([block.outline.buffer(1e-7, join_style="mitre") for block in thing.blocks])
    return shapely.orient_polygons(without_scan_noise(whole.simplify(1e-6)))


def contacts(bed: TestBed, tip: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Normals (2,) towards the finger, and depths (m), of the contacts of object and finger at a tip (2,)."""
    bed.plant.SetPositions(bed.context, bed.finger, tip)
    found = bed.plant.get_geometry_query_input_port().Eval(bed.context)
    inspector, result = found.inspector(), []
    for pair in found.ComputePointPairPenetration():
        one, other = inspector.GetName(pair.id_A), inspector.GetName(pair.id_B)
        if "cell" in one + other:
            continue
        assert {name.split("_")[0] for name in (one, other)} == {"finger::ball", "object::wall"}
        result.append(((1.0 if "ball" in one else -1.0) * pair.nhat_BA_W[:2], pair.depth))
    return result


@pytest.mark.parametrize("name", NAMES)
def test_normals_are_those_of_the_outline(name: str) -> None:
    """The finger sinks in by 50 um at places along the outline and all around its convex corners."""
    thing, depth = benchmark_object(name), 5e-5
    skin = skin_of(thing)
    bed = TestBed(thing, finger=True)
    bed.start(AT_REST, np.array([1.0, 1.0]))
    outline = outline_of(thing)
    rng = np.random.default_rng(1)
    ways = rng.uniform(0.0, outline.exterior.length, 200)
    places = np.vstack([shapely.get_coordinates(outline.exterior.interpolate(ways)), outline.exterior.coords])
    angles = rng.uniform(0.0, 2.0 * np.pi, (len(places), 5))
    checked = 0
    for place, own in zip(places, angles, strict=True):
        for angle in own:
            beside = shapely.Point(place + 1e-3 * np.array([np.cos(angle), np.sin(angle)]))
            if outline.contains(beside):
                continue
            nearest = shapely.get_coordinates(shapely.shortest_line(beside, outline.exterior))[1]
            way = (shapely.get_coordinates(beside)[0] - nearest) / beside.distance(outline.exterior)
            tip = nearest + (FINGER_RADIUS - depth) * way
            if shapely.Point(tip).distance(outline) < FINGER_RADIUS - 1.001 * depth:
                continue  # in a notch, it sinks in farther elsewhere
            checked += 1
            normal, deep = max(contacts(bed, tip), key=lambda contact: contact[1])
            assert deep == pytest.approx(depth + skin, abs=1e-5)  # outlines are simplified
            assert normal @ way > 0.999
    assert checked > 300


def test_blocks_that_touch_at_a_corner_have_walls_of_their_own() -> None:
    blocks = tuple(Block(shapely.box(x, x, x + 0.05, x + 0.05), 0.02) for x in (0.0, 0.05))
    ring = Block(shapely.box(0.2, 0.0, 0.3, 0.1).difference(shapely.box(0.23, 0.03, 0.27, 0.07)), 0.02)
    thing = replace(benchmark_object("book"), blocks=(*blocks, ring))
    walls = walls_of(thing)
    assert sum(wall.width() for _, wall in walls) == pytest.approx(2 * 0.2 + 0.4 + 0.16, abs=1e-4)
    for X_OG, wall in walls:
        inside, outside = (
            shapely.Point((X_OG @ np.array([0.0, way * wall.depth(), 0.0]))[:2]) for way in (0.0, -1.0)
        )
        assert any(block.outline.contains(inside) for block in thing.blocks)
        assert not any(block.outline.contains(outside) for block in thing.blocks)


def test_walls_follow_the_outline_up_to_the_lower_block() -> None:
    """Two blocks side by side, of different heights, and a low one apart."""
    low = Block(shapely.box(0.0, 0.0, 0.1, 0.05), 0.01)
    high = Block(shapely.box(0.1, 0.0, 0.15, 0.05), 0.03)
    thing = replace(
        benchmark_object("book"), blocks=(low, high, Block(shapely.box(0.2, 0.0, 0.3, 0.1), 0.02))
    )
    walls = walls_of(thing)
    assert len(walls) == 8, "none between blocks, and one along a side that two share"
    length = sum(wall.width() for _, wall in walls)
    assert length == pytest.approx(2 * (0.15 + 0.05) + 4 * 0.1, abs=1e-5)
    for X_OG, wall in walls:
        x, y, z = X_OG.translation()
        bottom, top = z - 0.5 * wall.height(), z + 0.5 * wall.height()
        assert bottom == pytest.approx(CLEARANCE)
        assert top == pytest.approx(0.02 if x > 0.19 else 0.03 if x > 0.14 else 0.01)
        outside = X_OG @ np.array([0.0, -wall.depth(), 0.0])
        assert not any(block.outline.contains(shapely.Point(outside[:2])) for block in thing.blocks)
        assert any(block.outline.contains(shapely.Point(x, y)) for block in thing.blocks)
