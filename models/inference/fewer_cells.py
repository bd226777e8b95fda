"""Objects of many cells: pushes are learned from with neighbouring cells merged.

The time of a fit grows with the number of cells, but a few hundred resolve what the prior lets maps vary. The
belief has the dataset's cells again: those that were merged share their mass evenly and their friction.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

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
    known = dataset.known
    by_cell = known is not None and (known.mass is not None or known.friction is not None)
    if len(dataset.grid) <= MOST_CELLS or by_cell:
        return dataset
    return replace(dataset, grid=_merged(dataset.grid)[0])


def spread_out(belief: Belief, dataset: PushDataset) -> Belief:
    """A belief about merged cells, as one about the dataset's own."""
    if len(belief.grid) == len(dataset.grid):
        return belief
    place, maps = _merged(dataset.grid)[1], belief.maps
    mass = (maps.mass / np.bincount(place))[:, place]
    spread = Maps(mass, maps.mu[:, place], maps.mu_finger, maps.effects)
    return replace(belief, grid=dataset.grid, maps=spread)


@lru_cache(maxsize=16)
def _merged(grid: CellGrid) -> tuple[CellGrid, NDArray[np.int64]]:
    """The cells merged to at most `MOST_CELLS` blocks, and the block (n,) that each belongs to."""
    corner = grid.centers.min(axis=0) - 0.5 * grid.width
    side, place = 1, np.arange(len(grid))
    while place.max() >= MOST_CELLS:
        side *= 2
        blocks = np.floor((grid.centers - corner) / (side * grid.width) + 1e-6)
        place = np.unique(blocks, axis=0, return_inverse=True)[1].reshape(-1)
    members = np.bincount(place)
    centers = np.column_stack([np.bincount(place, axis) / members for axis in grid.centers.T])
    return CellGrid(centers, side * grid.width, grid.exterior, grid.holes, members), place
