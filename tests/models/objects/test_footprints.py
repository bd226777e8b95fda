"""Cutting an outline into cells, and finding the outline of given cells."""

import numpy as np
import pytest
import shapely
import yaml
from centred_cells import cells_from_centres
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose
from shapely.geometry import Point, Polygon

from slipmap.models.objects import cells_from_polygon
from slipmap.models.objects.footprints import polygon_moments

SQUARE = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
L_SHAPE = 0.01 * np.array([[0, 0], [12, 0], [12, 5], [5, 5], [5, 12], [0, 12]], dtype=float)
L_HOLE = 0.01 * np.array([[1, 1], [3, 1], [3, 4], [1, 4]], dtype=float)


def circle(radius, corners=720):
    angle = 2 * np.pi * np.arange(corners) / corners
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def second_moment(grid):
    """Polar second moment of area of the cells about the origin."""
    return grid.width**2 * np.sum(np.sum(grid.centers**2, axis=1) + grid.width**2 / 6)


def rows(points):
    return set(map(tuple, np.round(points, 9)))


@st.composite
def star_polygons(draw):
    """Star-shaped outline around a random point, from blunt to spiky, sometimes with a round hole."""
    corners = draw(st.integers(3, 14))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    angle = 2 * np.pi * (np.arange(corners) + rng.uniform(0.05, 0.95, corners)) / corners
    radius = 0.1 * rng.uniform(draw(st.sampled_from([0.9, 0.5, 0.25])), 1.0, corners)
    middle = rng.uniform(-0.3, 0.3, 2)
    exterior = middle + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    room = Polygon(exterior).exterior.distance(Point(middle))
    inside = Polygon(exterior).contains(Point(middle))
    holes = [middle + circle(0.6 * room, 12)] if inside and room > 0.01 and draw(st.booleans()) else []
    return exterior, holes


# --- an outline ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [1, 2, 5, 10, 45])
def test_square_number_cuts_a_square_exactly(side):
    grid = cells_from_polygon(SQUARE, count=side**2)
    w = 0.1 / side
    line = w * (np.arange(side) + 0.5)
    assert grid.width == pytest.approx(w)
    assert_allclose(grid.centers, [(x, y) for y in line for x in line], atol=1e-12)
    assert second_moment(cells_from_polygon(SQUARE - 0.05, count=side**2)) == pytest.approx(0.1**4 / 6)


def test_rectangle_with_odd_and_even_numbers_of_columns():
    grid = cells_from_polygon([[0, 0], [0.2, 0], [0.2, 0.1], [0, 0.1]], count=50)
    assert len(grid) == 50
    assert len(np.unique(np.round(grid.centers[:, 0], 9))) == 10
    assert len(np.unique(np.round(grid.centers[:, 1], 9))) == 5


def test_disc_area_and_second_moment_converge():
    radius = 0.07
    errors = []
    for count in (30, 300, 3000, 30000):
        grid = cells_from_polygon(circle(radius), count=count)
        assert abs(len(grid) - count) <= 4
        area = len(grid) * grid.width**2
        errors.append(abs(second_moment(grid) / (np.pi * radius**4 / 2) - 1))
        assert area == pytest.approx(np.pi * radius**2, rel=0.5 / np.sqrt(count))
    assert errors[-1] < 2e-4
    assert errors[1] < 0.03
    assert max(errors[2:]) < errors[0] + 1e-3


def test_l_shape_with_a_hole_is_cut_exactly():
    grid = cells_from_polygon(L_SHAPE, [L_HOLE], width=0.01)
    area = 12 * 5 + 5 * 7 - 2 * 3
    assert len(grid) == area
    assert len(grid.holes) == 1
    x, y = 100 * grid.centers.T
    assert not np.any((x > 1) & (x < 3) & (y > 1) & (y < 4)), "a cell lies in the hole"
    assert not np.any((x > 5) & (y > 5)), "a cell lies outside the L"
    assert len(cells_from_polygon(L_SHAPE, [L_HOLE], count=area)) == area


def test_ring_is_symmetric_and_empty_inside():
    grid = cells_from_polygon(circle(0.1), [circle(0.06)], count=200)
    distance = np.linalg.norm(grid.centers, axis=1)
    assert np.all((distance > 0.0599) & (distance < 0.1))
    assert abs(len(grid) - 200) <= 3
    assert second_moment(grid) == pytest.approx(np.pi / 2 * (0.1**4 - 0.06**4), rel=0.03)


@pytest.mark.parametrize("count", [7, 28, 60, 88, 500])
def test_symmetric_objects_get_symmetric_cells(count):
    hammer = shapely.box(-0.2, -0.012, 0.2, 0.012).union(shapely.box(0.14, -0.06, 0.18, 0.06))
    outline = np.array(hammer.exterior.coords)[:-1] + np.array([0.31, -0.17])
    centers = cells_from_polygon(outline, count=count).centers
    assert rows(centers * [1, -1] - [0, 0.34]) == rows(centers)
    disc = cells_from_polygon(circle(0.1) + np.array([0.013, 0.7]), count=count).centers - [0.013, 0.7]
    assert rows(disc) == rows(-disc) == rows(disc * [1, -1])


@pytest.mark.parametrize("shift", [0.0, 0.123456789, -7.7])
def test_centres_on_the_outline_are_outside(shift):
    # Five cells each way; eight of the centres lie exactly on the border of the hole, up to rounding.
    square = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    w = 0.013
    grid = cells_from_polygon(2.5 * w * square + shift, [w * square + shift], width=w)
    assert len(grid) == 16
    assert_allclose(np.abs(grid.centers - shift).max(axis=1), 2 * w)


def test_one_cell_has_area_and_centroid_of_the_outline():
    grid = cells_from_polygon(L_SHAPE, [L_HOLE], count=1)
    polygon = Polygon(L_SHAPE, [L_HOLE])
    assert len(grid) == 1
    assert grid.width**2 == pytest.approx(polygon.area)
    assert_allclose(grid.centers[0], polygon.centroid.coords[0], atol=1e-12)


@pytest.mark.parametrize("count", [2000, 5000])
@pytest.mark.parametrize("holes", [[], [circle(0.03)]])
def test_thousands_of_cells(count, holes):
    wavy = circle(1.0) * (0.1 + 0.02 * np.sin(7 * 2 * np.pi * np.arange(720) / 720))[:, None]
    grid = cells_from_polygon(wavy, holes, count=count)
    assert abs(len(grid) - count) <= 2
    assert len(grid) * grid.width**2 == pytest.approx(grid.polygon.area, rel=0.01)


def test_part_thinner_than_a_cell_still_gets_the_wanted_number():
    bar = [[0, 0], [1.0, 0], [1.0, 0.01], [0, 0.01]]
    grid = cells_from_polygon(bar, count=20)
    assert len(grid) == 20
    assert_allclose(grid.centers[:, 1], 0.005, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(shape=star_polygons(), count=st.integers(1, 400))
def test_counted_cells_of_random_outlines(shape, count):
    exterior, holes = shape
    grid = cells_from_polygon(exterior, holes, count=count)
    polygon = Polygon(exterior, holes)
    assert grid.polygon.equals(polygon)
    assert abs(len(grid) - count) <= max(1, 0.02 * count)
    if count > 1:
        assert np.all(polygon.contains(shapely.points(grid.centers)))
    if count >= 100:
        assert len(grid) * grid.width**2 == pytest.approx(polygon.area, rel=0.15)


@settings(max_examples=60, deadline=None)
@given(shape=star_polygons(), width=st.floats(0.004, 0.015))
def test_every_grid_square_with_its_centre_inside_is_a_cell(shape, width):
    exterior, holes = shape
    grid = cells_from_polygon(exterior, holes, width=width)
    polygon = Polygon(exterior, holes)
    assert np.all(polygon.contains(shapely.points(grid.centers)))
    # Squares that the outline misses are whole or absent, so cells and outline differ only near the outline.
    band = polygon.boundary.buffer(width / np.sqrt(2) * 1.01).area
    assert abs(len(grid) * width**2 - polygon.area) <= band
    # The grid goes on: all lattice points inside are there.
    k = np.arange(-60, 61) * width
    lattice = grid.centers[0] + np.stack(np.meshgrid(k, k), axis=-1).reshape(-1, 2)
    assert len(grid) == np.sum(polygon.buffer(-1e-9).contains(shapely.points(lattice)))


@settings(max_examples=150, deadline=None)
@given(shape=star_polygons(), scale=st.sampled_from([1e-3, 1.0, 30.0]), shift=st.floats(-5, 5))
def test_the_unit_and_the_origin_do_not_matter(shape, scale, shift):
    exterior, holes = shape
    grid = cells_from_polygon(exterior, holes, count=60)
    moved = cells_from_polygon(scale * (exterior + shift), [scale * (h + shift) for h in holes], count=60)
    assert moved.width == pytest.approx(scale * grid.width, rel=1e-6)
    assert_allclose(moved.centers / scale - shift, grid.centers, atol=1e-7)


def test_moments_of_a_box_with_a_hole_off_its_middle():
    outline, hole = shapely.box(1, 2, 5, 4), shapely.box(1.5, 2.5, 2.5, 3.0)
    area, centroid, second = polygon_moments(outline.difference(hole))
    # Steiner: box 4 × 2 about (3, 3) less box 1 × 0.5 about (2, 2.75).
    middle = (8 * np.array([3, 3]) - 0.5 * np.array([2, 2.75])) / 7.5
    expected = 8 * np.diag([16, 4]) / 12 + 8 * np.outer(middle - [3, 3], middle - [3, 3])
    expected -= 0.5 * np.diag([1, 0.25]) / 12 + 0.5 * np.outer(middle - [2, 2.75], middle - [2, 2.75])
    assert area == pytest.approx(7.5)
    assert_allclose(centroid, middle)
    assert_allclose(second, expected)


@pytest.mark.parametrize(
    "outline",
    [
        [[0, 0], [0.12, 0], [0.12, 0.06], [0, 0.06]],
        [[0, 0], [0.12, 0], [0.12, 0.03], [0.04, 0.03], [0.04, 0.08], [0, 0.08]],
        [[0, 0], [0.09, 0], [0.09, 0.09], [0, 0.09]],
        [[0, 0], [0.12, 0], [0.03, 0.09]],
    ],
    ids=["rectangle", "L", "square", "triangle"],
)
def test_a_rough_number_of_cells_keeps_the_proportions_of_the_outline(outline):
    grid = cells_from_polygon(outline)
    area, centroid, wanted = polygon_moments(grid.polygon)
    around = grid.centers - centroid
    second = grid.width**2 * (around.T @ around + len(grid) * grid.width**2 / 12 * np.eye(2))
    assert 48 <= len(grid) <= 75
    assert len(grid) * grid.width**2 == pytest.approx(area, rel=0.01)
    assert_allclose(second, wanted, rtol=0.02, atol=0.01 * np.trace(wanted))
    assert np.hypot(*around.mean(axis=0)) < 0.02 * np.sqrt(area)


@pytest.mark.parametrize("cells", [1, 3, 4, 9])
def test_of_few_cells_there_are_as_many_as_asked_for(cells):
    outline = [[0, 0], [0.12, 0], [0.12, 0.06], [0, 0.06]]
    rough, counted = cells_from_polygon(outline, about=cells), cells_from_polygon(outline, count=cells)
    assert_allclose(rough.centers, counted.centers)
    assert rough.width == counted.width


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"count": 4, "width": 0.01}, "only one of count and width"),
        ({"about": 0}, "about must be a whole number from 1"),
        ({"count": 0}, "count must be a whole number from 1"),
        ({"count": 3.5}, "count must be a whole number"),
        ({"count": True}, "count must be a whole number"),
        ({"width": -0.01}, "positive length in m, got -0.01"),
        ({"width": float("nan")}, "positive length in m"),
        ({"width": 1e-5}, "check the units"),
    ],
)
def test_wrong_size_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        cells_from_polygon(SQUARE, **arguments)


def test_wrong_outlines_are_refused():
    with pytest.raises(ValueError, match="not a simple polygon"):
        cells_from_polygon(SQUARE[[0, 2, 1, 3]], count=4)
    with pytest.raises(ValueError, match="hole 1: expected an"):
        cells_from_polygon(SQUARE, [0.03 + 0.2 * SQUARE, [1, 2, 3]], count=4)
    with pytest.raises(ValueError, match="point 2 is not finite"):
        cells_from_polygon([[0, 0], [1, 0], [np.nan, 1]], count=4)
    with pytest.raises(ValueError, match="choose a smaller width"):
        cells_from_polygon(circle(0.1), [circle(0.099)], width=0.3)


# --- given centres ------------------------------------------------------------------------------------------


def test_outline_of_squares_is_their_border():
    cells = np.array([[0, 0], [1, 0], [2, 0], [0, 1], [2, 1], [0, 2], [1, 2], [2, 2], [3, 2]])
    grid = cells_from_centres(0.02 * cells + 0.5, 0.02)
    assert grid.polygon.area == pytest.approx(9 * 0.02**2)
    assert len(grid.exterior) == 6
    assert_allclose(grid.polygon.bounds, 0.5 + 0.02 * np.array([-0.5, -0.5, 3.5, 2.5]))
    (hole,) = grid.holes
    assert rows(hole) == rows(0.5 + 0.02 * np.array([[0.5, 0.5], [1.5, 0.5], [1.5, 1.5], [0.5, 1.5]]))


def test_cut_and_rebuilt_object_keeps_cells_and_area():
    cut = cells_from_polygon(circle(0.1), [circle(0.05)], count=400)
    rebuilt = cells_from_centres(np.round(cut.centers, 5), round(cut.width, 6))
    assert rebuilt.polygon.area == pytest.approx(len(cut) * cut.width**2, rel=1e-3)
    assert rebuilt.polygon.symmetric_difference(cut.polygon).area < 0.1 * cut.polygon.area
    assert len(rebuilt.holes) == 1


def test_rounded_centres_leave_no_cracks():
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.arange(8), np.arange(5))
    centers = 0.013 * np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-5e-4, 5e-4, (40, 2))
    grid = cells_from_centres(centers, 0.013)
    assert len(grid.exterior) == 4
    assert grid.polygon.area == pytest.approx(40 * 0.013**2, rel=1e-9)
    assert_allclose(grid.centers, centers)


@pytest.mark.parametrize("step", [1, -1])
def test_corner_neighbours_are_bridged(step):
    grid = cells_from_centres([[0, 0], [0.1, 0.1 * step]], 0.1)
    assert grid.polygon.geom_type == "Polygon"
    assert grid.polygon.area == pytest.approx(2 * 0.01 + 2 * 0.005**2)
    assert grid.polygon.contains(Point(0.05, 0.05 * step))


def test_ring_closed_by_a_corner_keeps_its_hole():
    cells = [[0, 0], [1, 0], [2, 0], [2, 1], [1, 2], [0, 2], [0, 1]]
    grid = cells_from_centres(np.array(cells) * 0.1, 0.1)
    assert len(grid.holes) == 1
    assert grid.polygon.area == pytest.approx(0.07 + 2 * 0.005**2)


def test_given_outline_is_kept():
    grid = cells_from_centres([[0.02, 0.02], [0.05, 0.05]], 0.03, SQUARE, [0.07 + 0.1 * SQUARE])
    assert rows(grid.exterior) == rows(SQUARE)
    assert len(grid.holes) == 1


@pytest.mark.parametrize(
    ("centers", "message"),
    [
        ([[0, 0], [0.3, 0]], "2 separate parts"),
        ([[0, 0], [0.1, 0], [0.4, 0], [0.5, 0], [0.6, 0]], "smallest has 2 of 5 cells, among them cell 0"),
        ([[0, 0], [0.1, 0], [0.15, 0.1]], "off the square grid"),
        ([[0, 0], [0.1, 0], [0.101, 0]], "cells 1 and 2 overlap|cells 2 and 1 overlap"),
        ([[0, 0], [0, 0]], "overlap"),
        ([[0, 0], [np.inf, 0]], "point 1 is not finite"),
        (np.empty((0, 2)), "no cells"),
    ],
)
def test_impossible_cells_are_refused(centers, message):
    with pytest.raises(ValueError, match=message):
        cells_from_centres(centers, 0.1)


def test_cells_far_from_the_given_outline_are_refused():
    with pytest.raises(ValueError, match=r"cell 1 at \[50.0, 20.0\] lies"):
        cells_from_centres([[0.05, 0.05], [50.0, 20.0]], 0.02, SQUARE)
    with pytest.raises(ValueError, match="holes were given without an outline"):
        cells_from_centres([[0, 0]], 0.1, holes=[SQUARE])


def test_cells_of_measured_datasets(shared_data):
    found = 0
    for path in sorted(shared_data.glob("*/*/dataset.yaml")):
        entry = yaml.safe_load(path.read_text())["object"]
        cells = entry.get("cells")
        if cells is None:
            continue
        found += 1
        grid = cells_from_centres(cells["centers"], cells["width"])
        given_outline = cells_from_centres(cells["centers"], cells["width"], entry["outline"])
        band = given_outline.polygon.boundary.buffer(cells["width"]).area
        assert grid.polygon.symmetric_difference(given_outline.polygon).area < band, path
        assert grid.polygon.area == pytest.approx(len(grid) * cells["width"] ** 2, rel=0.01), path
    assert found >= 3
