"""Contours in made-up height pictures: where an edge is, where a corner, and where a rounded edge ends."""

import cv2
import numpy as np
import pytest
from shapely.geometry import Polygon

from slipmap.models.perception.object_mask import HeightPicture, object_mask, smoothed_heights
from slipmap.models.perception.pinhole_camera import TablePlane
from slipmap.models.perception.seen_object import contour

HEIGHT = 0.03
FINE = 8  # pictures are made of so many times smaller pixels


def seen(scene, inside, roundness=0.0, middle=(322.3, 241.6)):
    """Rings of a shape whose `inside` (pixels from its foot) makes its heights, as a quarter of a circle of
    radius `roundness` pixels; blurred by half a pixel of jitter and by the smoothing that is always done."""
    along = (np.arange(200 * FINE) + 0.5) / FINE - 0.5
    x, y = np.meshgrid(along + 220, along + 140)
    depth = inside(x - middle[0], y - middle[1])
    rise = np.clip(depth / roundness, 0, 1) if roundness else (depth > 0).astype(float)
    fine = HEIGHT * np.sqrt(np.maximum(0, 1 - (1 - rise) ** 2)) * (depth > 0)
    picture = np.zeros((480, 640), np.float32)
    picture[140:340, 220:420] = fine.reshape(200, FINE, 200, FINE).mean(axis=(1, 3))
    picture = cv2.GaussianBlur(picture, (0, 0), np.hypot(1.0, 0.35))
    rings = contour(picture > HEIGHT / 2, HeightPicture(picture), TablePlane(), scene.view)
    assert len(rings) == 1
    return rings[0]


@pytest.mark.parametrize("roundness", [0.0, 3.0, 5.0])
def test_a_disc_ends_where_its_foot_is(scene, roundness):
    ring = seen(scene, lambda x, y: 60 - np.hypot(x, y), roundness)
    edge, foot = (np.sqrt(Polygon(side).area / np.pi) for side in ring)
    assert foot == pytest.approx(60.0, abs=0.4)
    # Half the height is reached within 13.4 % of the radius, without blur.
    assert edge < foot + 1e-9
    assert edge < 60.0 - 0.11 * roundness + 0.05


@pytest.mark.parametrize("turn", [0.0, 0.2, 0.6, 1.1])
def test_a_square_keeps_its_four_corners(scene, turn):
    c, s = np.cos(turn), np.sin(turn)
    ring = seen(scene, lambda x, y: 40 - np.maximum(abs(c * x + s * y), abs(c * y - s * x)))
    true = Polygon([(322.3 + c * a - s * b, 241.6 + s * a + c * b) for a, b in
                    ((-40, -40), (40, -40), (40, 40), (-40, 40))])  # fmt: skip
    found = Polygon(ring.edge)
    assert found.area == pytest.approx(true.area, rel=2e-3)
    for corner in true.exterior.coords:
        assert np.linalg.norm(np.array(ring.edge.coords) - corner, axis=1).min() < 0.4


def test_an_object_of_a_few_pixels_keeps_its_area(scene):
    ring = seen(scene, lambda x, y: np.minimum(3.2 - abs(x), 2.3 - abs(y)))
    assert Polygon(ring.edge).is_valid
    assert Polygon(ring.edge).area == pytest.approx(6.4 * 4.6, rel=0.2)


def test_rings_of_any_shape_are_polygons_of_about_its_area(scene):
    """Thin bars, blots, rings and stars, with noise and with pixels that have no reading."""
    for seed in range(24):
        rng = np.random.default_rng(seed)
        top = float(rng.uniform(0.006, 0.08))
        heights = np.zeros((480, 640), np.float32)
        if seed % 3 == 0:
            size, turn = (rng.uniform(15, 80), rng.uniform(1, 5)), float(rng.uniform(0, 180))
            cv2.fillPoly(heights, [np.rint(cv2.boxPoints(((320, 240), size, turn))).astype(np.int32)], top)
        elif seed % 3 == 1:
            cv2.circle(heights, (320, 240), 30, top, -1)
            cv2.circle(heights, (320 + int(rng.integers(-8, 8)), 240), int(rng.integers(2, 24)), 0.0, -1)
        else:
            cv2.fillPoly(heights, [(rng.normal(size=(9, 2)) * 30 + [320, 240]).astype(np.int32)], top)
        heights += rng.normal(size=heights.shape).astype(np.float32) * rng.choice([0, 5e-4, 1.5e-3])
        heights[rng.random(heights.shape) < rng.choice([0, 0.02, 0.2])] = np.nan
        smooth = smoothed_heights(heights)
        mask = object_mask(smooth, scene.view)
        if mask is None:
            continue
        rings = contour(mask, HeightPicture(smooth), TablePlane(), scene.view)
        for side in zip(*rings, strict=True):
            assert Polygon(side[0], side[1:]).is_valid, seed
        edge = Polygon(rings[0].edge, [ring.edge for ring in rings[1:]])
        assert abs(edge.area - mask.sum()) < 0.7 * edge.length, seed
