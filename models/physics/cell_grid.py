"""The object as a grid of square cells with an outline, shared by physics, data and inference."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely.geometry import Polygon

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CellGrid:
    """n square cells of side `width`, rigidly joined, and the outline that a finger can touch.

    Attributes:
        centers: (n, 2) cell centres in the object frame, m.
        width: side of a cell, m.
        exterior: (k, 2) outline in the object frame, counter-clockwise, not repeated at the end, m.
        holes: rings (k_j, 2) of openings, clockwise, not repeated at the end, m.
        members: (n,) number of equal cells that were merged to each; ones if None.

    Raises:
        ValueError: no cells, a number that is not finite, a width that is not positive, or an outline that
            crosses itself or has no area.

    Example:
        >>> import slipmap
        >>> grid, _ = slipmap.hammer()
        >>> len(grid), grid.centers.shape, grid.exterior.shape
        (60, (60, 2), (8, 2))
    """

    centers: FloatArray
    width: float
    exterior: FloatArray
    holes: tuple[FloatArray, ...] = field(default=())
    members: NDArray[np.int64] | None = None

    def __repr__(self) -> str:
        holes = f", {len(self.holes)} holes" if self.holes else ""
        width = f"{1e3 * self.width:.3g} mm"
        return f"CellGrid({len(self)} cells of {width}, {len(self.exterior)} corners{holes})"

    def __post_init__(self) -> None:
        centers = checked_points(self.centers, "cell centres")
        if len(centers) == 0:
            raise ValueError("cell grid: there are no cells")
        if not (np.isfinite(self.width) and self.width > 0):
            raise ValueError(f"cell grid: cell width must be a positive length in m, got {self.width}")
        exterior = checked_points(self.exterior, "outline")
        holes = tuple(checked_points(hole, "hole") for hole in self.holes)
        polygon = checked_polygon(exterior, holes)
        self.__dict__.update(
            centers=centers,
            exterior=_oriented(exterior, counter_clockwise=True),
            holes=tuple(_oriented(hole, counter_clockwise=False) for hole in holes),
            _polygon=polygon,
        )

    def __len__(self) -> int:
        return len(self.centers)

    @property
    def polygon(self) -> Polygon:
        """The outline as a shapely polygon, object frame."""
        return self.__dict__["_polygon"]

    @cached_property
    def reach(self) -> float:
        """Largest distance of the outline from the frame's origin, m."""
        return float(np.max(np.hypot(*self.exterior.T)))

    def center_of(self, weights: FloatArray) -> FloatArray:
        """(…, 2) mean of the cells' centres with weights (…, n), such as their masses, object frame, m."""
        return weights @ self.centers / weights.sum(axis=-1, keepdims=True)

    def squares(self, side: float) -> FloatArray:
        """(n, 4, 2) corners of squares around the cells' centres, counter-clockwise, object frame, m."""
        return self.centers[:, None] + side / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])

    @cached_property
    def edges(self) -> FloatArray:
        """(E, 4) outline edges (x0, y0, x1, y1); the object lies to the left of each edge."""
        rings = (self.exterior, *self.holes)
        edges = np.concatenate([np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in rings])
        # A corner listed twice makes no edge.
        return np.ascontiguousarray(edges[(edges[:, :2] != edges[:, 2:]).any(axis=1)])


def checked_polygon(exterior: ArrayLike, holes: tuple[FloatArray, ...] = ()) -> Polygon:
    """Polygon of an outline with holes.

    Raises:
        ValueError: fewer than three corners, no area, edges that cross, or a hole outside; the message says
            where.
    """
    from shapely.validation import explain_validity

    ring = np.asarray(exterior, dtype=float)
    if len(ring) < 3:
        raise ValueError(f"outline: needs at least three corners, has {len(ring)}")
    polygon = Polygon(ring, [np.asarray(hole, dtype=float) for hole in holes])
    shell = Polygon(ring)
    for k, hole in enumerate(holes if shell.is_valid else ()):
        if not shell.covers(Polygon(np.asarray(hole, dtype=float))):
            raise ValueError(f"holes[{k}] does not lie inside the outline")
    if not polygon.is_valid:
        raise ValueError(f"outline: not a simple polygon ({explain_validity(polygon)})")
    if polygon.area <= 0:
        raise ValueError("outline: encloses no area")
    return polygon


def checked_points(values: ArrayLike, what: str) -> FloatArray:
    """The points as a float array (n, 2), checked to be finite.

    Raises:
        ValueError: the wrong shape, or a point that is not finite; the message names `what` and the row.
    """
    points = np.asarray(values, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"{what}: expected an (n, 2) array of points, got shape {points.shape}")
    if not np.all(np.isfinite(points)):
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise ValueError(f"{what}: point {row} is not finite: {points[row].tolist()}")
    return np.ascontiguousarray(points)


def _oriented(ring: FloatArray, *, counter_clockwise: bool) -> FloatArray:
    x, y = ring.T
    signed_area = 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    return ring if (signed_area > 0) == counter_clockwise else np.ascontiguousarray(ring[::-1])
