"""Lines of push meet the object where they say, and the first follows the paper's rule."""

import numpy as np
import pytest
import shapely

from slipmap.models.objects import cells_from_polygon, contour_cells
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.planners.contact_lines import ContactContour, ways_of_center
from slipmap.planners.exploration import DESCENT, NoReachablePush
from tests.models.physics.sliding_objects import signed_distances
from tests.planners.cell_world import RADIUS

APPROACH, CONE = 0.02, 0.4
NOWHERE = np.zeros(0)


@pytest.mark.parametrize("name", ["wrench", "hammer", "book"])
def test_lines_touch_the_outline_only_at_their_end(name):
    grid = benchmark_object(name).grid
    lines = ContactContour(grid, RADIUS, APPROACH).spread(NOWHERE, 64, CONE, np.random.default_rng(0))
    assert len(lines) == 64
    assert signed_distances(grid, lines.touches) == pytest.approx(RADIUS, abs=1e-8)
    for share in (0.05, 0.5, 0.95):
        assert (
            signed_distances(grid, lines.touches - share * APPROACH * lines.directions).min() > RADIUS - 1e-8
        )
    assert signed_distances(grid, lines.touches - APPROACH * lines.directions).min() > RADIUS + DESCENT - 1e-8


def test_a_line_is_at_its_place_and_angle():
    grid = benchmark_object("book").grid
    lines = ContactContour(grid, RADIUS, APPROACH).lines(np.array([0.05]), np.array([0.3]))
    ring = shapely.LinearRing(grid.exterior)
    contact = shapely.get_coordinates(ring.interpolate(0.05))[0]
    # The book is upright: the contact lies on a side, the inward normal points to the middle.
    inward = -np.sign(contact) * (np.abs(contact) == np.abs(grid.exterior).max(axis=0))
    assert lines.touches[0] == pytest.approx(contact - RADIUS * inward)
    cross = inward[0] * lines.directions[0, 1] - inward[1] * lines.directions[0, 0]
    assert (lines.directions[0] @ inward, cross) == pytest.approx((np.cos(0.3), np.sin(0.3)))


def test_the_first_candidate_follows_the_rule_of_the_expected_center_of_mass():
    grid = benchmark_object("hammer").grid
    contour = ContactContour(grid, RADIUS, APPROACH)
    _, points, _ = contour_cells(grid)
    center, target = np.array([-0.06, 0.0]), np.array([0.2, 0.15, 0.5])
    c, s = np.cos(0.5), np.sin(0.5)
    wanted = target[:2] + np.array([[c, -s], [s, c]]) @ center
    axis = center - wanted
    cosines = [axis @ (p - center) / np.hypot(*axis) / np.hypot(*(p - center)) for p in points]
    place = contour.nearest_to_axis(center, ways_of_center(center, target[None]))
    ring = shapely.LinearRing(grid.exterior)
    assert shapely.get_coordinates(ring.interpolate(place[0]))[0] == pytest.approx(
        points[int(np.argmax(cosines))], abs=1e-9
    )
    lines = contour.spread(place, 10, CONE, np.random.default_rng(0))
    assert (lines.places[0], lines.angles[0]) == pytest.approx((place[0], 0.0))


def test_perturbed_lines_stay_near_those_that_were_chosen():
    grid = benchmark_object("book").grid
    contour = ContactContour(grid, RADIUS, APPROACH)
    rng = np.random.default_rng(0)
    lines = contour.spread(NOWHERE, 16, CONE, rng)
    near = contour.near(lines, np.array([3]), 20, 0.002, 0.02, CONE, rng)
    assert len(near) > 10
    assert np.hypot(*(near.touches - lines.touches[3]).T).max() < 0.02
    assert np.abs(near.angles - lines.angles[3]).max() < 0.1
    both = lines.joined(near)
    assert both.places.tolist() == [*lines.places, *near.places]


def ring(inner):
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    return cells_from_polygon(0.06 * circle, [inner * circle], count=40)


def test_lines_begin_in_an_opening_that_is_wide_enough_and_stay_there():
    grid = ring(0.04)
    contour, rng = ContactContour(grid, RADIUS, APPROACH), np.random.default_rng(0)
    lines = contour.spread(NOWHERE, 60, CONE, rng)
    inside = np.hypot(*lines.touches.T) < 0.04
    assert 10 < inside.sum() < 50
    assert signed_distances(grid, lines.touches) == pytest.approx(RADIUS, abs=1e-8)
    assert signed_distances(grid, lines.touches - APPROACH * lines.directions).min() > RADIUS + DESCENT - 1e-8
    # Along both rings, neighbours of a line lie on its own ring, though it begins where the other one ends.
    for first in (np.argmin(np.where(inside, lines.places, np.inf)), np.argmax(lines.places * ~inside)):
        near = contour.near(lines, np.array([first]), 40, 0.01, 0.0, CONE, rng)
        assert (np.hypot(*(near.touches - lines.touches[first]).T) < 0.05).all() and len(near) > 20
        assert ((np.hypot(*near.touches.T) < 0.04) == inside[first]).all()
    # The paper's rule is for a finger outside.
    place = contour.nearest_to_axis(np.zeros(2), np.array([[0.1, 0.0]]))
    assert contour.lines(place, np.zeros(1)).touches[0] == pytest.approx([-0.06 - RADIUS, 0.0], abs=1e-3)


def test_an_opening_that_is_too_narrow_has_no_lines():
    lines = ContactContour(ring(0.015), RADIUS, APPROACH).spread(NOWHERE, 60, CONE, np.random.default_rng(0))
    assert np.hypot(*lines.touches.T).min() > 0.06


def test_a_finger_that_fits_nowhere_is_refused():
    angle = np.arange(16) * np.pi / 8
    star = np.where(np.arange(16) % 2, 0.03, 0.1)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    grid = CellGrid(np.zeros((1, 2)), 0.02, star)
    with pytest.raises(NoReachablePush, match="thinner finger"):
        ContactContour(grid, 0.5, APPROACH).spread(NOWHERE, 4, CONE, np.random.default_rng(0))
