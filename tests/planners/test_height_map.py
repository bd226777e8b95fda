"""Heights between cells."""

from __future__ import annotations

import numpy as np
import pytest

from slipmap.models.objects.footprints import cells_from_polygon
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.planners.grasps import HeightMap


@pytest.fixture(scope="module")
def step() -> tuple[CellGrid, np.ndarray]:
    """Four cells of 4 cm in a row along x, the last two higher."""
    grid = cells_from_polygon(np.array([[0, 0], [0.16, 0], [0.16, 0.04], [0, 0.04]]), width=0.04)
    return grid, np.where(grid.centers[:, 0] > 0.08, 0.03, 0.01)


def test_height_is_open_between_unlike_cells_and_known_elsewhere(step: tuple[CellGrid, np.ndarray]) -> None:
    field = HeightMap.of(*step)
    points = np.array([[0.03, 0.02], [0.07, 0.02], [0.09, 0.02], [0.13, 0.02], [0.2, 0.02], [0.05, -0.01]])
    low, high = (field.sampled(raster, points) for raster in (field.lowest, field.highest))
    np.testing.assert_allclose(low, [0.01, 0.01, 0.01, 0.03, 0.0, 0.0], rtol=1e-6)
    np.testing.assert_allclose(high, [0.01, 0.03, 0.03, 0.03, 0.0, 0.0], rtol=1e-6)


def test_highest_within_reaches_just_so_far(step: tuple[CellGrid, np.ndarray]) -> None:
    field = HeightMap.of(*step)
    near = field.highest_within(0.02)
    # Heights may be 30 mm from x = 60 mm on.
    for x, y, expected in ((0.036, 0.02, 0.01), (0.044, 0.02, 0.03), (0.0, -0.016, 0.01), (0.0, -0.024, 0.0)):
        assert field.sampled(near, np.array([x, y])) == pytest.approx(expected, rel=1e-6)
    # A disc, not a square.
    assert field.sampled(near, np.array([-0.017, -0.017])) == 0.0


def test_wrong_heights_are_named(step: tuple[CellGrid, np.ndarray]) -> None:
    grid, heights = step
    with pytest.raises(ValueError, match="4 cells need as many heights"):
        HeightMap.of(grid, heights[:2])
    with pytest.raises(ValueError, match="cell 1 must have a positive height"):
        HeightMap.of(grid, np.array([0.01, 0.0, 0.01, 0.01]))
