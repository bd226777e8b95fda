"""Objects of many cells: pushes are learned from with neighbouring cells merged.

The time of a fit grows with the number of cells, but a few hundred resolve what the prior lets maps vary. The
belief has the dataset's cells again: those that were merged share their mass evenly and their friction.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slipmap.models.inference.belief import Belief
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps

MOST_CELLS = 800
"""Most cells to learn with."""


def with_fewer_cells(dataset: PushDataset) -> PushDataset:
    """The dataset with square blocks of cells merged, if there are more than `MOST_CELLS` of them.

    Unchanged where the maps are known by cell.
    """
    grid = dataset.grid
    if len(grid) <= MOST_CELLS or dataset.known is not None:
        return dataset
    place = _merged(grid)
    members = np.bincount(place)
    centers = np.column_stack([np.bincount(place, axis) / members for axis in grid.centers.T])
    width = grid.width * _side(grid)
    return replace(dataset, grid=CellGrid(centers, width, grid.exterior, grid.holes))


def spread_out(belief: Belief, dataset: PushDataset) -> Belief:
    """A belief about merged cells, as one about the dataset's own."""
    if len(belief.grid) == len(dataset.grid):
        return belief
    place, maps = _merged(dataset.grid), belief.maps
    mass = (maps.mass / np.bincount(place))[:, place]
    spread = Maps(mass, maps.mu[:, place], maps.mu_finger, maps.effects)
    return replace(belief, grid=dataset.grid, maps=spread, fingerprint=dataset.fingerprint)


def _merged(grid: CellGrid, side: int | None = None) -> NDArray[np.int64]:
    """(n,) index of the block, `side` cells wide, that each cell belongs to."""
    width = grid.width * (_side(grid) if side is None else side)
    corner = grid.centers.min(axis=0) - 0.5 * grid.width
    blocks = np.floor((grid.centers - corner) / width + 1e-6).astype(np.int64)
    return np.unique(blocks, axis=0, return_inverse=True)[1].reshape(-1)


def _side(grid: CellGrid) -> int:
    """Width in cells of the smallest blocks that are few enough."""
    side = 2
    while _merged(grid, side).max() >= MOST_CELLS:
        side += 1
    return side
