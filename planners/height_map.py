"""What is known of an object's height over a raster of points, from one height for each cell."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from models.physics.cell_grid import CellGrid, FloatArray

PITCH = 2e-3
"""Side of a raster's pixel, m."""

Raster = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Least and largest height at points of the object frame; 0 outside the outline.

    A height is known where cells are alike: between the centres of cells it may be any between theirs.

    Attributes:
        corner: (2,) the raster's first point, m; its rows go along y, its columns along x.
        lowest: least height, m.
        highest: largest height, m.
    """

    corner: FloatArray
    lowest: Raster
    highest: Raster

    @staticmethod
    def of(grid: CellGrid, heights: FloatArray) -> HeightMap:
        """Heights between the cells of a grid.

        Args:
            grid: n cells and the outline.
            heights: (n,) m, positive.

        Raises:
            ValueError: not one height for each cell, or one that is not positive.
        """
        heights = np.asarray(heights, dtype=float)
        if heights.shape != (len(grid),):
            raise ValueError(f"heights: {len(grid)} cells need as many heights, got shape {heights.shape}")
        if not (np.isfinite(heights) & (heights > 0)).all():
            cell = int(np.flatnonzero(~(np.isfinite(heights) & (heights > 0)))[0])
            raise ValueError(f"heights: cell {cell} must have a positive height, has {heights[cell]} m")
        x0, y0, x1, y1 = grid.polygon.bounds
        x, y = np.arange(x0, x1 + PITCH, PITCH), np.arange(y0, y1 + PITCH, PITCH)
        points = np.stack(np.meshgrid(x, y), axis=-1)
        inside = shapely.contains_xy(grid.polygon, points[..., 0], points[..., 1])
        low, high = _between_cells(grid, heights, points[inside])
        lowest, highest = (np.zeros(inside.shape, dtype=np.float32) for _ in range(2))
        lowest[inside], highest[inside] = low, high
        return HeightMap(np.array([x0, y0]), lowest, highest)

    def highest_within(self, distance: float) -> Raster:
        """Largest height within a distance (m) of each point; a larger raster, as `sampled` takes it."""
        reach = int(np.ceil(distance / PITCH))
        offset = np.arange(-reach, reach + 1) * PITCH
        disc = (np.hypot(*np.meshgrid(offset, offset)) <= distance + PITCH / 2).astype(np.uint8)
        padded = np.pad(self.highest, reach)
        return np.asarray(cv2.dilate(padded, disc), dtype=np.float32)

    def sampled(self, raster: Raster, points: FloatArray) -> Raster:
        """Values (...) of one of this map's rasters at points (..., 2); 0 beyond it.

        Args:
            raster: `lowest`, `highest` or one of `highest_within`, centred on the same points.
            points: object frame, m.
        """
        more = (np.array(raster.shape) - self.lowest.shape) // 2
        column = np.rint((points[..., 0] - self.corner[0]) / PITCH).astype(np.intp) + more[1]
        row = np.rint((points[..., 1] - self.corner[1]) / PITCH).astype(np.intp) + more[0]
        within = (row >= 0) & (row < raster.shape[0]) & (column >= 0) & (column < raster.shape[1])
        values = raster[np.where(within, row, 0), np.where(within, column, 0)]
        return np.asarray(np.where(within, values, 0), dtype=np.float32)


def _between_cells(grid: CellGrid, heights: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and largest height of the cells around each point, mostly four, at the rim fewer."""
    tree = cKDTree(grid.centers)
    _, around = tree.query(points, k=9, p=np.inf, distance_upper_bound=0.999 * grid.width)
    nearest = heights[tree.query(points)[1]]
    low = np.append(heights, np.inf)[around].min(axis=1)
    high = np.append(heights, -np.inf)[around].max(axis=1)
    return np.where(np.isfinite(low), low, nearest), np.where(np.isfinite(high), high, nearest)
