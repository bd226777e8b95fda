"""Balance margins against shapes with a known margin, and against a support polygon made of points."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from scipy.spatial import ConvexHull

from slipmap.models.measurements.push_dataset import Table
from slipmap.models.objects.benchmark_objects import BENCHMARK_OBJECTS, benchmark_object
from slipmap.models.objects.footprints import cells_from_polygon
from slipmap.models.physics.balance import balance_margins, fall_probability, own_balance_margins
from slipmap.models.physics.cell_grid import CellGrid

ROUND = Table("round", (0.1, -0.05), radius=0.5)
RECTANGLE = Table("rectangle", (0.1, 0.05), size=(0.8, 0.6))
TABLES = pytest.mark.parametrize("table", [ROUND, RECTANGLE], ids=["round", "rectangle"])


@pytest.fixture(scope="module")
def bar() -> CellGrid:
    """A bar of 0.2 m by 0.06 m."""
    return cells_from_polygon(np.array([[-0.1, -0.03], [0.1, -0.03], [0.1, 0.03], [-0.1, 0.03]]), width=0.02)


def test_bar_over_a_straight_edge(bar: CellGrid) -> None:
    """The edge lies at x = 0.5 m; the part of the bar on the table ends there."""
    x = np.array([0.42, 0.48, 0.53, 0.59])
    poses = np.column_stack([x, np.full(4, 0.05), np.zeros(4)])
    centers = np.array([[0.0, 0.0], [-0.06, 0.01], [-0.09, 0.0]])
    to_edge = 0.5 - x[:, None] - centers[:, 0]
    to_side = 0.03 - np.abs(centers[:, 1])
    expected = np.minimum(to_edge, np.minimum(to_side, 0.1 + centers[:, 0]))
    np.testing.assert_allclose(balance_margins(bar, centers, poses, RECTANGLE), expected, atol=1e-12)


def test_bar_that_is_turned_over_the_edge(bar: CellGrid) -> None:
    for angle in (np.pi / 2, np.pi, -np.pi / 2):
        (margin,) = balance_margins(bar, [[0.0, 0.0]], [[0.49, 0.05, angle]], RECTANGLE)[0]
        assert margin == pytest.approx(0.01, abs=1e-12)


def test_disc_on_a_disc() -> None:
    """The table supports a disc that is larger than it; a smaller disc is its own support."""
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    table = Table("round", (0.0, 0.0), radius=0.1)
    large = cells_from_polygon(0.3 * circle, width=0.05)
    margins = balance_margins(large, [[0.0, 0.0], [0.02, 0.0], [0.0, 0.15]], [[0.03, 0.04, 1.0]], table)
    middle = np.array([-0.03 * np.cos(1.0) - 0.04 * np.sin(1.0), 0.03 * np.sin(1.0) - 0.04 * np.cos(1.0)])
    centers = np.array([[0.0, 0.0], [0.02, 0.0], [0.0, 0.15]])
    np.testing.assert_allclose(margins[0], 0.1 - np.linalg.norm(centers - middle, axis=1), atol=2e-5)
    small = cells_from_polygon(0.05 * circle, width=0.02)
    assert balance_margins(small, [[0.01, 0.0]], [[0.02, 0.0, 0.0]], table)[0, 0] == pytest.approx(
        0.04, abs=1e-5
    )


def test_a_bar_across_the_rim_of_a_round_table(bar: CellGrid) -> None:
    """Along the radius it ends at the arc between its sides: the nearest point is the arc's middle."""
    table = Table("round", (0.0, 0.0), radius=0.5)
    assert balance_margins(bar, [[0.0, 0.0]], [[0.48, 0.0, 0.0]], table)[0, 0] == pytest.approx(
        0.02, abs=1e-5
    )
    # From outside the support too.
    assert balance_margins(bar, [[0.0, 0.0]], [[0.53, 0.0, 0.0]], table)[0, 0] == pytest.approx(
        -0.03, abs=1e-5
    )


def test_concave_outline_is_supported_by_its_hull() -> None:
    """A fork with only its tines on the table: there is support between the tines."""
    fork = np.array(
        [[0, -0.1], [0.3, -0.1], [0.3, 0.1], [0, 0.1], [0, 0.06], [0.2, 0.06], [0.2, -0.06], [0, -0.06]]
    )
    grid = cells_from_polygon(fork, width=0.02)
    (margin,) = balance_margins(grid, [[0.08, 0.0]], [[0.4, 0.05, 0.0]], RECTANGLE)[0]
    assert margin == pytest.approx(0.02, abs=1e-12)


def test_nothing_on_the_table(bar: CellGrid) -> None:
    for table in (ROUND, RECTANGLE):
        assert balance_margins(bar, [[0.0, 0.0]], [[2.0, 0.0, 0.3]], table)[0, 0] == -np.inf


@TABLES
@pytest.mark.parametrize("name", BENCHMARK_OBJECTS)
def test_margin_against_points_laid_closely(name: str, table: Table) -> None:
    """Brute force: points every millimetre, those on the table, their hull by Qhull."""
    grid = benchmark_object(name).grid
    rng = np.random.default_rng(1)
    inside = _points_within(grid)
    turn = rng.uniform(0, 2 * np.pi, 25)
    poses = np.column_stack([*(0.42 * np.array([np.cos(turn), 0.8 * np.sin(turn)])), rng.uniform(-4, 4, 25)])
    centers = rng.uniform(-0.08, 0.08, (6, 2))
    margins = balance_margins(grid, centers, poses, table)
    compared = 0
    for pose, row in zip(poses, margins, strict=True):
        on_table = inside[_over(table, _moved(inside, pose))]
        if len(on_table) < 20:
            continue
        # Equations n · p + d <= 0 inside, n of unit length; valid inside, outside a lower bound of the way.
        equations = ConvexHull(on_table).equations
        brute = -(centers @ equations[:, :2].T + equations[:, 2]).max(axis=1)
        deep = brute > -5e-3
        np.testing.assert_allclose(row[deep], brute[deep], atol=1.5e-3)
        assert (row[~deep] <= brute[~deep] + 1.5e-3).all()
        compared += int(deep.sum())
    assert compared > 10


@TABLES
def test_poses_with_centres_of_their_own(table: Table) -> None:
    grid = benchmark_object("wrench").grid
    rng = np.random.default_rng(2)
    poses = np.column_stack([rng.uniform(-0.6, 0.6, (8, 2)), rng.uniform(-3, 3, 8)])
    centers = rng.uniform(-0.05, 0.05, (5, 2))
    together = balance_margins(grid, centers, poses, table)
    own = own_balance_margins(grid, centers, np.repeat(poses[:, None], 5, axis=1), table)
    np.testing.assert_array_equal(own, together)


def test_moving_out_costs_margin_and_turning_the_scene_nothing() -> None:
    thing = benchmark_object("spray_gun")
    table = Table("round", (0.0, 0.0), radius=0.5)
    center = thing.center_of_mass[None, :2]
    margins = [balance_margins(thing.grid, center, [[r, 0.0, 0.4]], table)[0, 0] for r in (0.38, 0.42, 0.46)]
    assert margins[0] > margins[1] > margins[2]
    turned = [
        balance_margins(thing.grid, center, [[0.42 * np.cos(a), 0.42 * np.sin(a), 0.4 + a]], table)[0, 0]
        for a in np.linspace(0, 6, 5)
    ]
    np.testing.assert_allclose(turned, margins[1], atol=1e-5)


def test_fall_probability_adds_hypotheses_that_fall() -> None:
    margins = np.array([[0.01, 0.002, -0.01], [0.01, 0.02, 0.03], [-np.inf, -1.0, -1.0]])
    probability = np.array([0.5, 0.3, 0.2])
    np.testing.assert_allclose(fall_probability(margins, probability), [0.2, 0.0, 1.0])
    np.testing.assert_allclose(fall_probability(margins, probability, margin=0.005), [0.5, 0.0, 1.0])
    assert fall_probability(np.full(5, -1.0), np.array([2, 3, 3, 6, 1]) / 15) <= 1.0


def test_wrong_arguments_are_named(bar: CellGrid) -> None:
    with pytest.raises(ValueError, match="poses"):
        balance_margins(bar, [[0.0, 0.0]], [[0.0, 0.0]], ROUND)
    with pytest.raises(ValueError, match="centres of mass, row 0 is not finite"):
        balance_margins(bar, [[np.nan, 0.0]], [[0.0, 0.0, 0.0]], ROUND)
    with pytest.raises(ValueError, match="radius of a round table"):
        balance_margins(bar, [[0.0, 0.0]], [[0.0, 0.0, 0.0]], Table("round", (0.0, 0.0)))


def _points_within(grid: CellGrid) -> np.ndarray:
    """Points every millimetre inside the outline, and the outline's own points."""
    x0, y0, x1, y1 = grid.polygon.bounds
    x, y = np.meshgrid(np.arange(x0, x1, 1e-3), np.arange(y0, y1, 1e-3))
    lattice = np.column_stack([x.ravel(), y.ravel()])
    rings = shapely.get_coordinates(shapely.segmentize(grid.polygon, 1e-3))
    return np.vstack([lattice[shapely.contains_xy(grid.polygon, lattice)], rings])


def _moved(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]


def _over(table: Table, points: np.ndarray) -> np.ndarray:
    away = points - np.asarray(table.center)
    if table.shape == "round":
        return np.hypot(*away.T) <= table.radius
    return (np.abs(away) <= np.asarray(table.size) / 2).all(axis=1)
