"""What the camera will see of an object that lies somewhere, past the resting arm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.perception.arm_mask import Hull, draw_hulls
from models.perception.camera import View
from models.perception.seen_object import SeenObject
from models.physics.cell_grid import FloatArray


class Sight:
    """The camera's view of the table while the arm rests.

    Args:
        view: the camera at its place.
        hulls: around the arm where it rests, see `ArmHulls`.
    """

    def __init__(self, view: View, hulls: Sequence[Hull]) -> None:
        self._view = view
        self._hidden = draw_hulls(hulls, view)

    def share(self, seen: SeenObject, pose: FloatArray) -> float:
        """Share of an object's cells that are in the picture and not hidden, at a pose (3,), m and rad."""
        c, s = np.cos(pose[2]), np.sin(pose[2])
        places = pose[:2] + seen.grid.centers @ np.array([[c, s], [-s, c]])
        pixels, _ = self._view.project(np.column_stack([places, seen.cell_heights]))
        column, row = np.round(pixels).astype(int).T
        height, width = self._hidden.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        clear = ~self._hidden[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        return float((inside & clear).mean())
