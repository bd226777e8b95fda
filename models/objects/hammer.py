"""A hammer of two materials, the object of the demonstration: head of steel, handle of wood."""

from __future__ import annotations

import numpy as np

from models.objects.footprints import cells_from_polygon
from models.physics.cell_grid import CellGrid
from models.physics.rollout import Maps

CELL = 0.0125
HEAD = (0.1, 0.0375, 0.025)
"""Length across the handle, width along it and height, m."""
HANDLE = (0.025, 0.225, 0.02)
"""Width, length and height, m."""
STEEL, BEECH = 7850.0, 700.0  # kg/m³
MU_STEEL, MU_BEECH = 0.2, 0.4
MU_FINGER = 0.3


def hammer() -> tuple[CellGrid, Maps]:
    """60 cells, and their true maps: 0.74 kg of steel that slides easily, 0.08 kg of wood that does not.

    The object frame lies in the middle of the whole length, y towards the head.
    """
    half = (HEAD[1] + HANDLE[1]) / 2
    joint = half - HEAD[1]
    right = [(HANDLE[0] / 2, -half), (HANDLE[0] / 2, joint), (HEAD[0] / 2, joint), (HEAD[0] / 2, half)]
    outline = np.array(right + [(-x, y) for x, y in reversed(right)])
    grid = cells_from_polygon(outline, width=CELL)
    is_head = grid.centers[:, 1] > joint
    mass = CELL**2 * np.where(is_head, STEEL * HEAD[2], BEECH * HANDLE[2])
    return grid, Maps(mass, np.where(is_head, MU_STEEL, MU_BEECH), np.array([MU_FINGER]))
