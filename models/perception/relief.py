"""The object's heights as a map."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from shapely.geometry import Polygon

from slipmap.models.perception.edge_kernels import SPACING, Land
from slipmap.models.perception.table_plane import TablePlane
from slipmap.models.physics.cell_grid import FloatArray

_NEIGHBOURS = 4  # readings whose median is a height
_FOR_PLANE = 12  # readings through which a plane is laid at the rim
_WALL, _STEEP = 2.0, 6.0  # a reading that is lower than one beside it by more (pixels, slope) is no top


@dataclass(frozen=True, eq=False)
class Relief:
    """Height of the object's top over the points of a square grid in O, 0 outside the footprint.

    Attributes:
        corner: (2,) the grid's first point in O, m.
        heights: (rows, columns) m; rows along y, columns along x, 1 mm apart.
    """

    corner: FloatArray
    heights: NDArray[np.float32]

    @staticmethod
    def from_cloud(polygon: Polygon, points: FloatArray, tops: FloatArray, pixel: float) -> Relief:
        """Heights inside a footprint from what a camera sees.

        Args:
            polygon: the footprint in O, m.
            points: (k, 2) of the readings in O, m.
            tops: (k,) heights of the readings, m.
            pixel: distance of neighbouring readings, m.
        """
        on_top = ~_on_flank(points, tops, pixel)
        points, tops = points[on_top], tops[on_top]
        tree = cKDTree(points)
        x0, y0, x1, y1 = polygon.bounds
        # A margin of one point, so that the distance to the outside is known everywhere.
        x = np.arange(x0 - SPACING, x1 + 2 * SPACING, SPACING)
        y = np.arange(y0 - SPACING, y1 + 2 * SPACING, SPACING)
        grid = np.stack(np.meshgrid(x, y), axis=-1)
        inside = shapely.contains_xy(polygon, grid[..., 0], grid[..., 1])
        heights = np.zeros(inside.shape, np.float32)
        _, index = tree.query(grid[inside], k=min(_NEIGHBOURS, len(points)))
        heights[inside] = np.median(tops[np.asarray(index).reshape(inside.sum(), -1)], axis=1)
        # No reading lies on the rim itself; a rounded top goes on falling up to there.
        to_rim = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 5) * SPACING
        rim = inside & (to_rim < pixel)
        if len(points) >= _FOR_PLANE and np.any(rim):
            index = np.asarray(tree.query(grid[rim], k=_FOR_PLANE)[1])
            heights[rim] = _on_planes(grid[rim], points[index], tops[index])
        return Relief(np.array([x[0], y[0]]), np.maximum(heights, 0.0))

    def at(self, points: FloatArray) -> FloatArray:
        """Heights (...) of the grid points nearest to points (..., 2) in O, m; 0 beside the object."""
        nearest = np.rint((points - self.corner) / SPACING).astype(int)
        size = np.array(self.heights.shape[::-1])
        columns, rows = np.moveaxis(np.clip(nearest, 0, size - 1), -1, 0)
        beside = np.any((nearest < 0) | (nearest >= size), axis=-1)
        return np.where(beside, 0.0, self.heights[rows, columns].astype(float))

    def smooth(self, points: FloatArray, window: float) -> tuple[FloatArray, FloatArray]:
        """Heights (k,) at points (k, 2) in O, m, and their slopes (k, 2), averaged over a window.

        Args:
            points: inside the footprint, further from its edge than the window.
            window: standard deviation of a Gaussian, m.
        """
        smooth = cv2.GaussianBlur(self.heights, (0, 0), window / SPACING)
        slopes = [cv2.Sobel(smooth, cv2.CV_32F, *axis, scale=1 / (8 * SPACING)) for axis in ((1, 0), (0, 1))]
        read = [Relief(self.corner, field).at(points) for field in (smooth, *slopes)]
        return read[0], np.stack(read[1:], axis=-1)

    def land(self, table: TablePlane) -> Land:
        """The map, on a table, for kernels."""
        plane = np.array([table.slope_x, table.slope_y, table.height])
        heights = np.array(self.heights, np.float32, order="C")
        return Land(plane, np.array(self.corner, dtype=float), heights, float(heights.max()))


def _on_flank(points: FloatArray, tops: FloatArray, pixel: float) -> NDArray[np.bool_]:
    """(k,) readings from an upright side: much higher ones lie right beside them."""
    distance, index = (np.asarray(a) for a in cKDTree(points).query(points, k=min(6, len(points))))
    rise = tops[index.reshape(len(points), -1)] - tops[:, None]
    beside = distance.reshape(len(points), -1) < 1.5 * pixel
    flank = np.any(beside & (rise > np.maximum(_WALL * pixel, _STEEP * distance.reshape(rise.shape))), axis=1)
    return flank if not np.all(flank) else np.zeros_like(flank)


def _on_planes(at: FloatArray, points: FloatArray, tops: FloatArray) -> FloatArray:
    """(m,) heights at (m, 2) on the planes through (m, k, 2) points with heights (m, k), between the lowest
    and the highest of these."""
    middle = points.mean(axis=1)
    arm = points - middle[:, None]
    mean = tops.mean(axis=1)
    spread = np.einsum("mki,mkj->mij", arm, arm) + 1e-12 * np.eye(2)
    moment = np.einsum("mki,mk->mi", arm, tops - mean[:, None])
    slope = np.linalg.solve(spread, moment[..., None])[..., 0]
    plane = mean + np.sum(slope * (at - middle), axis=1)
    return np.clip(plane, tops.min(axis=1), tops.max(axis=1))
