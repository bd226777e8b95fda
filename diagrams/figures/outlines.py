"""Outlines of objects and a bar of known length, shared by the pictures."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.path import Path
from numpy.typing import ArrayLike

from diagrams.figures.style import INK
from models.physics.cell_grid import CellGrid, FloatArray


def outline_path(grid: CellGrid, pose: ArrayLike = (0.0, 0.0, 0.0)) -> Path:
    """Exterior and holes as one path, placed at a pose (3,) in the world, m and rad."""
    rings = [placed(ring, pose) for ring in (grid.exterior, *grid.holes)]
    return Path.make_compound_path(*(Path(np.vstack([ring, ring[:1]]), closed=True) for ring in rings))


def placed(points: FloatArray, pose: ArrayLike) -> FloatArray:
    """Object-frame points (…, 2) in the world, for one pose (3,), m and rad."""
    x, y, angle = np.asarray(pose, dtype=float)
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]]) + [x, y]


def scale_bar(axes: Axes, corner: ArrayLike, extent: float) -> None:
    """A bar of a round length, up to a quarter of `extent` (m), from `corner` (m) to the right, labelled."""
    length = round_length(extent / 4)
    x, y = np.asarray(corner, dtype=float)
    axes.plot([x, x + length], [y, y], color=INK, linewidth=1.6, solid_capstyle="butt", clip_on=False)
    axes.annotate(
        f"{length * 1e3:g} mm", (x + length / 2, y), (0, -3), textcoords="offset points",
        ha="center", va="top", fontsize=7.5, annotation_clip=False,
    )  # fmt: skip


def round_length(largest: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above `largest` (> 0)."""
    power = 10.0 ** np.floor(np.log10(largest))
    return float(max(step for step in (1, 2, 5) if step * power <= largest * (1 + 1e-9)) * power)
