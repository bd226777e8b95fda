"""Polygons found again from their blurred edges, against closed forms, differences and shapes known."""

import numpy as np
import pytest
import shapely
from scipy.stats import norm
from shapely.geometry import Point, Polygon

from slipmap.models.perception.sharp_outline import blurred, sharp_ring

BLUR = 1.1
SQUARE = np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 30.0], [0.0, 30.0]])
_TURNS = np.arange(10) * np.pi / 5
STAR = np.tile([33.0, 19.0], 5)[:, None] * np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])
ELL = np.array([[0, 0], [60, 0], [60, 20], [22, 20], [22, 48], [0, 48]], float)


def ring_of(polygon):
    return np.array(polygon.exterior.coords)[:-1][::-1]  # buffers are clockwise


def seen(corners, spacing=1.0, noise=0.0, seed=0):
    """Points along the blurred edge of a polygon, with noise across it as blurred pictures have it."""
    polygon = shapely.segmentize(Polygon(corners).exterior, spacing)
    traced = np.array(polygon.coords)[:-1]
    along = np.roll(traced, -1, axis=0) - np.roll(traced, 1, axis=0)
    normals = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
    ring = np.vstack([corners, corners[:1]])

    def share(off):
        return blurred(traced + off[:, None] * normals, ring, BLUR)[0]

    far = np.full(len(traced), 3.0)
    # No line across a tip that is narrower than the blur meets the edge.
    meets = (share(-far) > 0.5) & (share(far) < 0.5)
    traced, normals, far = traced[meets], normals[meets], far[meets]
    inner, outer = -far, far
    for _ in range(30):
        middle = (inner + outer) / 2
        inside = share(middle) > 0.5
        inner, outer = np.where(inside, middle, inner), np.where(inside, outer, middle)
    rng = np.random.default_rng(seed)
    arc = np.arange(len(traced)) * polygon.length / len(traced)
    apart = np.abs(arc[:, None] - arc)
    apart = np.minimum(apart, polygon.length - apart)
    errors = np.linalg.cholesky(np.exp(-((apart / (2 * BLUR)) ** 2)) + 1e-3 * np.eye(len(arc)))
    return traced + (inner + noise * errors @ rng.normal(size=len(arc)))[:, None] * normals


def apart(ring, corners):
    """Largest distance of the true corners from a ring, and root mean square of that ring from the edge."""
    edge = Polygon(corners).exterior
    points = shapely.points(shapely.get_coordinates(shapely.segmentize(ring, 0.5)))
    far = max(ring.distance(Point(corner)) for corner in corners)
    return far, float(np.sqrt(np.mean(shapely.distance(edge, points) ** 2)))


def test_a_blurred_rectangle_is_a_product_of_normal_distributions():
    points = np.random.default_rng(0).uniform(-4, 54, (200, 2))
    whole = blurred(points, np.vstack([SQUARE, SQUARE[:1]]), 2.0)[0]
    x, y = (points / 2.0).T
    expected = (norm.cdf(25.0 - x) - norm.cdf(-x)) * (norm.cdf(15.0 - y) - norm.cdf(-y))
    assert whole == pytest.approx(expected, abs=1e-12)


def test_its_derivatives_are_those_of_differences():
    points = np.random.default_rng(1).uniform(-20, 20, (30, 2))
    ring = np.vstack([STAR[:8], STAR[:1] + np.array([0.0, 1.0])])  # an open chain
    change = blurred(points, ring, 2.0)[1]
    for k in range(len(ring)):
        for axis in range(2):
            step = np.zeros_like(ring)
            step[k, axis] = 1e-5
            one, other = (blurred(points, ring + sign * step, 2.0)[0] for sign in (1, -1))
            # Both ends of a chain also turn what is seen of it: that cancels in a whole ring.
            turned = 0.0 if 0 < k < len(ring) - 1 else wedge(points, ring, k, step)
            assert change[:, k, axis] == pytest.approx((one - other) / 2e-5 - turned, abs=1e-8)


def wedge(points, ring, k, step):
    """Change of the angle under which an open chain is seen, per length by which its end k moves."""
    angle = [np.arctan2(*(ring[k] + sign * step[k] - points).T[::-1]) for sign in (1, -1)]
    change = np.angle(np.exp(1j * (angle[0] - angle[1]))) / 2e-5 / (2 * np.pi)
    return change if k else -change


@pytest.mark.parametrize("corners", [SQUARE, STAR, ELL], ids=["square", "star", "ell"])
def test_corners_that_blur_cut_come_out_sharp(corners):
    for seed in range(3):
        points = seen(corners, noise=0.08, seed=seed)
        cut = min(np.min(np.linalg.norm(points - corner, axis=1)) for corner in corners)
        ring = sharp_ring(points, BLUR, 0.08)
        far, rms = apart(ring, corners)
        print(f"cut by {cut:.2f}, off by {far:.2f}, {rms:.3f} pixels, {len(ring.coords) - 1} corners")
        assert ring.is_ccw
        assert len(ring.coords) - 1 <= len(corners) + 1
        assert far < 0.25
        assert rms < 0.08


def test_a_clockwise_ring_gives_the_same():
    points = seen(ELL, noise=0.08)
    one, other = (Polygon(sharp_ring(part, BLUR, 0.08)) for part in (points, points[::-1]))
    assert one.symmetric_difference(other).area < 0.02 * ELL.max()


@pytest.mark.parametrize("radius", [3.5, 5.0, 9.0])
def test_round_corners_do_not_come_out_sharp(radius):
    rounded = np.array(Polygon(SQUARE).buffer(-radius).buffer(radius, quad_segs=16).exterior.coords)[:-1][
        ::-1
    ]
    for seed in range(3):
        points = seen(rounded, noise=0.08, seed=seed)
        ring = sharp_ring(points, BLUR, 0.08)
        beyond = Polygon(ring).difference(Polygon(rounded).buffer(0.3 * radius * (np.sqrt(2) - 1) + 0.25))
        assert beyond.area < 0.1
        assert apart(ring, rounded)[1] < 0.2


def test_a_circle_stays_round():
    circle = ring_of(Point(0, 0).buffer(27, quad_segs=24))
    ring = sharp_ring(seen(circle, noise=0.08), BLUR, 0.08)
    corners = np.array(ring.coords)
    sides, middles = np.diff(corners, axis=0), (corners[1:] + corners[:-1]) / 2
    tilt = np.sum(sides * middles, axis=1) / np.linalg.norm(sides, axis=1) / np.linalg.norm(middles, axis=1)
    assert np.degrees(np.sqrt(np.mean(tilt**2))) < 1.5
    assert len(sides) > 25
    assert apart(ring, circle)[1] < 0.1
    assert abs(Polygon(ring).area / (np.pi * 27**2) - 1) < 0.005


def test_more_noise_leaves_fewer_corners_never_more_than_it_shows():
    circle = ring_of(Point(0, 0).buffer(27, quad_segs=24))
    counts = [len(sharp_ring(seen(circle, noise=noise), BLUR, noise).coords) for noise in (0.04, 0.16, 0.6)]
    assert counts[0] > counts[1] > counts[2]


def test_a_ring_that_crosses_itself_is_left_alone():
    bow = np.array([[0.0, 0.0], [10.0, 10.0], [10.0, 0.0], [0.0, 10.0]])
    assert np.array_equal(np.array(sharp_ring(bow, BLUR, 0.1).coords)[:-1], bow)
