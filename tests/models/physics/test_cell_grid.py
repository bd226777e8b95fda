"""The cell grid's own checks and orientation."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from slipmap.models.physics.cell_grid import CellGrid, checked_points, checked_polygon

SQUARE = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
HOLE = np.array([[0.02, 0.02], [0.05, 0.02], [0.05, 0.04]])


def inward_points(grid):
    """A point just left of the middle of each edge."""
    start, end = grid.edges[:, :2], grid.edges[:, 2:]
    along = end - start
    left = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    return (start + end) / 2 + 1e-6 * left


@pytest.mark.parametrize("flip_outline", [1, -1])
@pytest.mark.parametrize("flip_hole", [1, -1])
def test_object_lies_to_the_left_of_every_edge(flip_outline, flip_hole):
    from shapely import points

    grid = CellGrid([[0.08, 0.08]], 0.02, SQUARE[::flip_outline], (HOLE[::flip_hole],))
    assert grid.edges.shape == (7, 4)
    assert np.all(grid.polygon.contains(points(inward_points(grid))))
    assert_allclose(grid.edges[:4, 2:], np.roll(grid.exterior, -1, axis=0))


def test_area_of_the_polygon_leaves_out_holes():
    grid = CellGrid([[0.08, 0.08], [0.06, 0.08]], 0.02, SQUARE, (HOLE,))
    assert len(grid) == 2
    assert grid.polygon.area == pytest.approx(0.01 - 0.03 * 0.02 / 2)


def test_centres_are_weighted_means():
    grid = CellGrid([[0.08, 0.08], [0.06, 0.08]], 0.02, SQUARE)
    assert_allclose(grid.center_of(np.array([3.0, 1.0])), [0.075, 0.08])
    assert_allclose(grid.center_of(np.array([[1.0, 0.0], [2.0, 2.0]])), [[0.08, 0.08], [0.07, 0.08]])


def test_squares_lie_around_the_cells():
    grid = CellGrid([[0.08, 0.08], [0.06, 0.08]], 0.02, SQUARE)
    corners = [[0.055, 0.075], [0.065, 0.075], [0.065, 0.085], [0.055, 0.085]]
    assert_allclose(grid.squares(0.01)[1], corners)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.empty((0, 2)), 0.01, SQUARE), "there are no cells"),
        (([[0, 0, 0]], 0.01, SQUARE), r"cell centres: expected an \(n, 2\) array"),
        (([[0, 0], [0, np.nan]], 0.01, SQUARE), "cell centres: point 1 is not finite"),
        (([[0, 0]], 0.0, SQUARE), "width must be a positive length in m, got 0"),
        (([[0, 0]], np.inf, SQUARE), "width must be a positive length"),
        (([[0, 0]], 0.01, SQUARE[:2]), "at least three corners, has 2"),
        (([[0, 0]], 0.01, SQUARE[[0, 2, 1, 3]]), "not a simple polygon"),
        (([[0, 0]], 0.01, SQUARE, (HOLE + 1,)), r"holes\[0\] does not lie inside the outline"),
        (([[0, 0]], 0.01, SQUARE, (HOLE[:, :1],)), "hole: expected an"),
    ],
)
def test_wrong_grids_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        CellGrid(*arguments)


def test_flat_outline_is_refused():
    with pytest.raises(ValueError, match="outline"):
        checked_polygon([[0, 0], [1, 0], [2, 0]])


def test_points_are_returned_as_floats():
    points = checked_points([[1, 2], [3, 4]], "corner")
    assert points.dtype == float
    with pytest.raises(ValueError, match="corner: expected an"):
        checked_points([1, 2], "corner")
