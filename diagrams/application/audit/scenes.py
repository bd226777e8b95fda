"""The objects of an audit: an L of one material for the probes, of two for the pushes."""

import numpy as np

from slipmap.diagrams.application.audit.engine import EngineScene
from slipmap.models.objects import cells_from_polygon

OUTLINE = 1e-3 * np.array([[-81, -63], [81, -63], [81, -9], [-27, -9], [-27, 63], [-81, 63]])
"""(6, 2) corners of the L, m; cut into 39 cells of 18 mm."""

MU, MU_FINGER, FINGER_RADIUS = 0.35, 0.25, 6e-3
_CELLS = 39
_FOOT_ABOVE = -0.018  # m; cells above this y are of the other material


def plain_scene() -> EngineScene:
    """Equal cells, friction `MU` everywhere."""
    grid = cells_from_polygon(OUTLINE, count=_CELLS)
    n = len(grid)
    return EngineScene(grid, np.full(n, 1.0 / n), np.full(n, MU), MU_FINGER, FINGER_RADIUS)


def two_material_scene() -> EngineScene:
    """A light rough leg on a heavy smooth foot."""
    grid = cells_from_polygon(OUTLINE, count=_CELLS)
    leg = grid.centers[:, 1] > _FOOT_ABOVE + 1e-6
    return EngineScene(grid, np.where(leg, 0.014, 0.034), np.where(leg, 0.5, 0.28), MU_FINGER, FINGER_RADIUS)
