"""Cells on the outer contour with their contact points and normals."""

import numpy as np
import pytest
import shapely
from centred_cells import cells_from_centres
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose
from shapely.geometry import Polygon

from slipmap.models.objects import (
    cells_from_label_image,
    cells_from_polygon,
    contour_cells,
)
from slipmap.models.physics.cell_grid import CellGrid


def circle(radius, corners=720):
    angle = 2 * np.pi * np.arange(corners) / corners
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def square_cells(columns, rows, width=0.1):
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    return width * np.column_stack([x.ravel(), y.ravel()])


def check_contour(grid):
    """What must hold on any object; returns the contour."""
    indices, points, normals = contour_cells(grid)
    size = np.ptp(grid.exterior, axis=0).max()
    exterior = Polygon(grid.exterior)
    assert len(indices) == len(set(indices.tolist())) == len(points) == len(normals) > 0
    assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    assert np.all(exterior.exterior.distance(shapely.points(points)) < 1e-12 * size)
    eps = 1e-8 * size
    assert not np.any(exterior.contains(shapely.points(points + eps * normals))), "a normal points inward"
    assert np.all(exterior.contains(shapely.points(points - eps * normals)))
    travelled = [exterior.exterior.project(p) for p in shapely.points(points)]
    if exterior.exterior.is_ccw:
        assert np.all(np.diff(travelled) > 0), "not in counter-clockwise order"
    # The contact point belongs to no other cell.
    distance = np.linalg.norm(points[:, None] - grid.centers, axis=2)
    assert np.all(distance[np.arange(len(indices)), indices] <= distance.min(axis=1) + 0.02 * grid.width)
    return indices, points, normals


@pytest.mark.parametrize("given_outline", [False, True])
def test_square_touches_at_the_middles_of_sides(given_outline):
    outline = [[-0.05, -0.05], [0.45, -0.05], [0.45, 0.45], [-0.05, 0.45]] if given_outline else None
    grid = cells_from_centres(square_cells(5, 5), 0.1, outline)
    indices, points, normals = check_contour(grid)
    border = np.any((grid.centers < 0.01) | (grid.centers > 0.39), axis=1)
    assert set(indices) == set(np.flatnonzero(border))
    assert_allclose(points, grid.centers[indices] + 0.05 * normals, atol=1e-9)


def test_one_cell_touches_at_a_side():
    indices, points, normals = check_contour(cells_from_centres([[0.3, 0.2]], 0.1))
    assert indices.tolist() == [0]
    assert_allclose(points[0], [0.3, 0.2] + 0.05 * normals[0], atol=1e-9)


def test_order_is_counter_clockwise_about_the_middle():
    grid = cells_from_polygon(circle(0.1), count=120)
    _, points, normals = check_contour(grid)
    angle = np.unwrap(np.arctan2(points[:, 1], points[:, 0]))
    assert np.all(np.diff(angle) > 0)
    assert 1.9 * np.pi * (1 - 2 / len(points)) < angle[-1] - angle[0] < 2 * np.pi
    assert_allclose(normals, points / 0.1, atol=0.01)


def test_clockwise_outline_gives_the_same_contour():
    outline = circle(0.1, 40)
    a, b = (cells_from_polygon(ring, count=50) for ring in (outline, outline[::-1]))
    assert set(check_contour(a)[0]) == set(check_contour(b)[0])


def test_reentrant_corner_has_no_contact_cell():
    cells = np.array([c for c in square_cells(4, 4, 1.0) if min(c) < 2])
    grid = cells_from_centres(cells, 1.0)
    indices, _, _ = check_contour(grid)
    # Cell (1, 1) meets the outline only in the re-entrant corner (1.5, 1.5).
    assert {tuple(c) for c in cells} - {tuple(cells[i]) for i in indices} == {(1.0, 1.0)}
    # Nor is the share it gets from a chamfer there large enough to push against.
    chamfered = [
        (-0.5, -0.5),
        (3.5, -0.5),
        (3.5, 1.5),
        (1.52, 1.5),
        (1.48, 1.48),
        (1.5, 1.52),
        (1.5, 3.5),
        (-0.5, 3.5),
    ]
    assert set(check_contour(CellGrid(cells, 1.0, chamfered))[0]) == set(indices)


def test_holes_are_not_contour():
    width = 0.01
    grid = cells_from_polygon(circle(0.1), [circle(0.04)], width=width)
    indices, points, normals = check_contour(grid)
    radius = np.linalg.norm(grid.centers, axis=1)
    assert np.all(radius[indices] > 0.1 - 1.5 * width)
    assert set(np.flatnonzero(radius > 0.1 - 0.5 * width)) <= set(indices)
    assert np.all(np.sum(points * normals, axis=1) > 0)


def test_openings_that_hold_a_disc_are_contour_after_the_exterior():
    grid = cells_from_polygon(circle(0.1), [circle(0.04)], width=0.01)
    outer, outer_points, _ = contour_cells(grid)
    indices, points, normals = contour_cells(grid, 0.039)
    assert indices[: len(outer)].tolist() == outer.tolist()
    assert_allclose(points[: len(outer)], outer_points)
    inner = points[len(outer) :]
    assert len(inner) > 15 and len(set(indices[len(outer) :])) == len(inner)
    assert_allclose(np.linalg.norm(inner, axis=1), 0.04, atol=1e-5)
    assert_allclose(normals[len(outer) :], -inner / 0.04, atol=0.01)
    assert np.all(np.diff(np.unwrap(np.arctan2(*inner.T[::-1]))) < 0), "not clockwise"
    assert len(contour_cells(grid, 0.041)[0]) == len(outer)


def test_slot_is_contour():
    # A comb: 3 × 3 cells with the middle of the top row cut out.
    cells = [c for c in square_cells(3, 3, 1.0) if tuple(c) != (1.0, 2.0)]
    grid = cells_from_centres(cells, 1.0)
    indices, _, normals = check_contour(grid)
    bottom = [tuple(c) for c in cells].index((1.0, 1.0))
    assert_allclose(normals[indices.tolist().index(bottom)], [0, 1], atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    corners=st.integers(3, 40),
    spread=st.floats(0, 0.8),
    count=st.integers(1, 200),
)
def test_contour_of_random_outlines(seed, corners, spread, count):
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * (np.arange(corners) + rng.uniform(0.1, 0.9, corners)) / corners
    radius = 0.1 * rng.uniform(1 - spread, 1.0, corners)
    outline = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    check_contour(cells_from_polygon(outline, count=count))


def test_random_clusters_of_cells():
    rng = np.random.default_rng(11)
    for _ in range(20):
        cells = [(0, 0)]
        while len(cells) < 40:
            i, j = cells[rng.integers(len(cells))]
            step = [(1, 0), (-1, 0), (0, 1), (0, -1)][rng.integers(4)]
            new = (i + step[0], j + step[1])
            if new not in cells:
                cells.append(new)
        grid = cells_from_centres(0.02 * np.array(cells), 0.02)
        indices, _, _ = check_contour(grid)
        touching = {
            k
            for k, (i, j) in enumerate(0.02 * np.array(cells))
            if shapely.box(i - 0.01, j - 0.01, i + 0.01, j + 0.01)
            .boundary.intersection(Polygon(grid.exterior).exterior.buffer(1e-7))
            .length
            > 0.01
        }
        assert set(indices) == touching


def test_contour_of_thousands_of_cells():
    grid = cells_from_polygon(circle(0.1), [circle(0.05)], count=2000)
    indices, _, _ = check_contour(grid)
    assert len(indices) == pytest.approx(2 * np.pi * 0.1 / grid.width, rel=0.2)


def test_repeated_corner_in_the_outline_is_harmless():
    outline = np.array([[0, 0], [0.1, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]])
    with np.errstate(all="raise"):
        indices, _, _ = check_contour(CellGrid(square_cells(2, 2, 0.05) + 0.025, 0.05, outline))
    assert set(indices) == {0, 1, 2, 3}


def test_pictures_of_real_objects(shared_data):
    for path in sorted((shared_data / "paper_objects").glob("*_label.png")):
        grid, _ = cells_from_label_image(path, 0.53 / 640, count=60)
        indices, _, _ = check_contour(grid)
        assert len(indices) >= 20, path
