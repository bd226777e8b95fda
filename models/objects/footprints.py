"""Footprints cut into square cells, cells on the contours that a finger can touch, and convex pieces of an
outline for collision engines.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from shapely.geometry import Polygon

from slipmap.models.geometry import cross
from slipmap.models.physics.cell_grid import CellGrid, FloatArray, checked_points, checked_polygon

_MAX_CELLS = 50_000  # a finer grid is probably a mistake in units
_LARGEST = 10.0  # m; so is a larger object
# The centre of the bounding box holds a cell's centre (0) or a cell's edge (0.5), in x and in y.
_OFFSETS = ((0.0, 0.0), (0.5, 0.5), (0.5, 0.0), (0.0, 0.5))
_FINE_STEPS = 40
_ROUGHLY = 1.25  # factor by which a rough number of cells may be missed
_FEW = 10  # of fewer cells none are to spare for the outline's proportions
_PIECES_PER_CELL = 32  # pieces of a ring per cell width; each piece belongs to one cell
_LEAST_SHARE = 0.1  # of a cell's width


def cells_from_polygon(
    exterior: ArrayLike,
    holes: Sequence[ArrayLike] = (),
    *,
    count: int | None = None,
    width: float | None = None,
    about: int = 60,
) -> CellGrid:
    """Grid of the squares whose centre lies inside an outline.

    On a straight edge this equals requiring half coverage. At corners and thin parts it biases area and
    second moment less than coverage does, because a strip thinner than half a cell still has its share of
    centres. The grid is centred on the bounding box, with cell centres or cell edges on the box's middle
    lines, so an object symmetric about them gets a symmetric grid. A centre on the outline counts as outside.

    Without `count` and `width`, the grid has up to a quarter more or fewer cells than `about`, as many as
    best reproduce the outline's area, centroid and second moments. A block of 120 by 60 mm gets 72 cells of
    10 mm; the best grid of exactly 60 cells would be a tenth too short.

    With `count`, the width is chosen to bring the number of cells as near as possible to it and, second, the
    area of the cells to that of the outline. Symmetry can rule a number out: a disc has no symmetric grid of
    10 cells and gets a number near it. `count=1` gives one square of the outline's area at its centroid. Rows
    run in ascending y, and within a row in ascending x.

    Args:
        exterior: (k, 2) outline in the object frame, in either direction, m.
        holes: rings (k_j, 2) of openings, m.
        count: wanted number of cells. Give at most one of this and `width`.
        width: side of a cell, m.
        about: rough number of cells where neither is given; met as closely as by `count` if below ten.

    Raises:
        TypeError: holes that are no rings.
        ValueError: count and width are both given, or one is out of range; the outline is not a simple
            polygon, or measures more than 10 m, as in mm; or the width is so large that no centre lies
            inside.

    Example:
        >>> import slipmap
        >>> grid = slipmap.cells_from_polygon([[0, 0], [0.1, 0], [0.1, 0.06], [0, 0.06]], count=15)
        >>> len(grid), round(grid.width, 4)
        (15, 0.02)
    """
    if not isinstance(holes, Iterable):
        raise TypeError(f"cell grid: holes must be a list of rings, got {holes}; give count= or width=")
    if count is not None and width is not None:
        raise ValueError("cell grid: give only one of count and width")
    outline, openings = checked_points(exterior, "outline"), checked_holes(holes)
    polygon = checked_polygon(outline, openings)
    x0, y0, x1, y1 = polygon.bounds
    if max(x1 - x0, y1 - y0) > _LARGEST:
        raise ValueError(
            f"outline: measures {x1 - x0:.4g} m × {y1 - y0:.4g} m; corners must be in m, divide by 1000?"
        )
    for name, number in (("count", count), ("about", about)):
        whole = isinstance(number, int | np.integer) and not isinstance(number, bool)
        if number is not None and not (whole and 1 <= number <= _MAX_CELLS):
            raise ValueError(
                f"cell grid: {name} must be a whole number from 1 to {_MAX_CELLS}, got {number!r}"
            )
    if count is not None:
        centers, width = _counted(polygon, int(count))
    elif width is not None:
        centers = _sized(polygon, width)
    else:
        centers, width = _fitting(polygon, int(about))
    return CellGrid(centers, float(width), outline, openings)


def contour_cells(
    grid: CellGrid, room: float | None = None
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Cells that own a stretch of a contour, each with a contact point and the normal there.

    A cell owns the part of a ring to which it is the nearest cell. Its contact point is the point of this
    part nearest to the cell's centre: for a cell with a side on the outline, the middle of that side.
    Cells that own less than a tenth of their width, such as one behind a re-entrant corner, are left out,
    unless no cell owns more.

    Args:
        room: radius of a disc, m; openings that hold one have contact cells too. If None, none has.

    Returns:
        indices: (c,) cells in counter-clockwise order along the exterior, each once, followed by those along
            each opening, clockwise.
        points: (c, 2) contact points on the rings, never on a corner, object frame, m.
        normals: (c, 2) unit normals, out of the object, of the edges they lie on, object frame.
    """
    openings = [] if room is None else wide_holes(grid, room)
    found = [_contacts(grid, ring) for ring in (grid.exterior, *openings)]
    cells, points, normals = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return cells, points, normals


def wide_holes(grid: CellGrid, room: float) -> list[FloatArray]:
    """Rings (k_j, 2) of the openings that hold a disc of radius `room`, m."""
    return [hole for hole in grid.holes if not Polygon(hole).buffer(-room).is_empty]


def _contacts(grid: CellGrid, ring: FloatArray) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Cells, contact points and normals along one ring (k, 2)."""
    edges = np.hstack([ring, np.roll(ring, -1, axis=0)])
    start, along, edge, limits = _pieces(edges, grid.width)
    length = np.linalg.norm(along, axis=1)
    owner = np.asarray(cKDTree(grid.centers).query(start + along / 2)[1])
    share = np.bincount(owner, weights=length, minlength=len(grid))
    least = min(_LEAST_SHARE * grid.width, float(share.max()))

    # The point of each piece nearest to its owner, kept away from the edge's ends.
    offset = grid.centers[owner] - start
    fraction = np.clip(np.sum(offset * along, axis=1) / length**2, *limits)
    points = start + fraction[:, None] * along
    distance = np.linalg.norm(points - grid.centers[owner], axis=1)

    # Rounded, so that the first of equally near points is taken despite rounding errors.
    key = np.round(distance / grid.width, 6)
    order = np.lexsort((np.arange(len(owner)), key, owner))
    cells, first = np.unique(owner[order], return_index=True)
    chosen = order[first][share[cells] >= least]
    chosen.sort()
    tangent = edges[edge[chosen], 2:] - edges[edge[chosen], :2]
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    return owner[chosen], points[chosen], np.column_stack([tangent[:, 1], -tangent[:, 0]])


def rings_of(polygon: Polygon) -> tuple[FloatArray, tuple[FloatArray, ...]]:
    """Corners (k, 2) of the exterior and (k_j, 2) of the holes, none repeated at the end."""
    exterior, *holes = (np.asarray(ring.coords)[:-1] for ring in (polygon.exterior, *polygon.interiors))
    return exterior, tuple(holes)


def without_small_holes(polygon: Polygon, area: float) -> Polygon:
    """The polygon without its holes of up to the given area."""
    return Polygon(polygon.exterior, [hole for hole in polygon.interiors if Polygon(hole).area > area])


def polygon_moments(polygon: Polygon) -> tuple[float, FloatArray, FloatArray]:
    """Area (m²), centroid (2,) (m) and second moments about the centroid (2, 2) (m⁴), by Green's theorem."""
    area, first, second = 0.0, np.zeros(2), np.zeros((2, 2))
    middle = np.array(polygon.centroid.coords[0])
    for sign, ring in ((1.0, polygon.exterior), *((-1.0, hole) for hole in polygon.interiors)):
        a = np.asarray(ring.coords)[:-1] - middle
        b = np.roll(a, -1, axis=0)
        twice = cross(a, b)
        sign *= float(np.sign(twice.sum()))
        area += sign * float(twice.sum()) / 2
        first += sign * (twice @ (a + b)) / 6
        ends = a.T @ (twice[:, None] * a) + b.T @ (twice[:, None] * b)
        mixed = a.T @ (twice[:, None] * b)
        second += sign * (ends + 0.5 * (mixed + mixed.T)) / 12
    shift = first / area
    return area, middle + shift, second - area * np.outer(shift, shift)


def _sized(polygon: Polygon, width: float) -> FloatArray:
    check_width(width)
    expected = polygon.area / width**2
    if expected > _MAX_CELLS:
        raise ValueError(
            f"cell grid: a width of {width:.4g} m cuts the outline into about {expected:.3g} cells, more "
            f"than {_MAX_CELLS}; check the units"
        )
    target = polygon_moments(polygon)
    interior = _Interior(polygon)
    candidates = [interior.centers(width, offset) for offset in _OFFSETS]
    centers = min(candidates, key=lambda c: _mismatch(c, width, target))
    if len(centers) == 0:
        x0, y0, x1, y1 = polygon.bounds
        raise ValueError(
            f"cell grid: no cell of width {width:.4g} m has its centre inside the outline, which measures "
            f"{x1 - x0:.4g} m × {y1 - y0:.4g} m; choose a smaller width"
        )
    return centers


def _counted(polygon: Polygon, count: int) -> tuple[FloatArray, float]:
    target = polygon_moments(polygon)
    area, centroid, _ = target
    equal_area = float(np.sqrt(area / count))
    if count == 1:
        return centroid[None, :], equal_area
    interior = _Interior(polygon)
    crossing = _crossing_width(interior, equal_area, count)
    # One step changes the number by about half a cell. Searching outwards, the first hit has the best area.
    steps = np.arange(-_FINE_STEPS, _FINE_STEPS + 1) / (4 * count)
    widths = np.concatenate([equal_area * np.exp(steps), crossing * np.exp(steps)])
    best: tuple[tuple[float, ...], FloatArray, float] | None = None
    distance = np.round(np.abs(np.log(widths / equal_area)), 9)  # so that rounding errors break no tie
    for width in widths[np.argsort(distance, kind="stable")]:
        for centers in (interior.centers(width, offset) for offset in _OFFSETS):
            if len(centers) == 0:
                continue
            area_error = abs(float(np.log(len(centers) * width**2 / area)))
            key = (abs(len(centers) - count), round(area_error, 9), _mismatch(centers, width, target))
            if best is None or key < best[0]:
                best = key, centers, float(width)
        if best is not None and best[0][0] == 0:
            break
    assert best is not None, "a crossing width has cells"
    return best[1], best[2]


def _fitting(polygon: Polygon, about: int) -> tuple[FloatArray, float]:
    """Centres and width of the grid of roughly so many cells that fits the outline best."""
    if about < _FEW:
        return _counted(polygon, about)
    fewest, most = about / _ROUGHLY, about * _ROUGHLY
    finest, coarsest = np.sqrt(polygon.area / most), np.sqrt(polygon.area / fewest)
    x0, y0, x1, y1 = polygon.bounds
    # Whole numbers of cells along a side cut a rectangle without a remainder.
    whole = np.outer((x1 - x0, y1 - y0), 1.0 / np.arange(1.0, most + 1.0)).ravel()
    widths = [*whole[(whole >= finest) & (whole <= coarsest)], *np.geomspace(finest, coarsest, _FINE_STEPS)]
    interior, target = _Interior(polygon), polygon_moments(polygon)
    grids = [(interior.centers(width, offset), float(width)) for width in widths for offset in _OFFSETS]
    rough = [grid for grid in grids if fewest <= len(grid[0]) <= most]
    if not rough:  # thin parts or few cells
        return _counted(polygon, about)

    def worth(grid: tuple[FloatArray, float]) -> tuple[float, float, int]:
        n = len(grid[0])
        # Pushes show no mismatch below a percent.
        poor = _mismatch(*grid, target) + _distortion(*grid, target)
        return round(poor, 2), round(abs(float(np.log(n / about))), 9), -n

    return min(rough, key=worth)


def _crossing_width(interior: _Interior, start: float, count: int) -> float:
    """A width at which the number of cells passes `count`, which thin parts move away from `start`."""

    def number(width: float) -> int:
        return max(len(interior.centers(width, offset)) for offset in _OFFSETS)

    fine = coarse = start
    while number(coarse) > count:
        fine, coarse = coarse, coarse * 1.25
    while number(fine) < count:
        fine, coarse = fine / 1.25, fine
    for _ in range(12):
        middle = float(np.sqrt(fine * coarse))
        fine, coarse = (middle, coarse) if number(middle) >= count else (fine, middle)
    return fine


class _Interior:
    """Grid points inside a polygon."""

    def __init__(self, polygon: Polygon) -> None:
        x0, y0, x1, y1 = polygon.bounds
        self.middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
        self.half_extent = np.array([(x1 - x0) / 2, (y1 - y0) / 2])
        # Shrunk by far more than rounding errors, so that centres on opposite edges are treated alike.
        self.polygon = polygon.buffer(-1e-9 * float(self.half_extent.max()), join_style="mitre")
        shapely.prepare(self.polygon)

    def centers(self, width: float, offset: tuple[float, float]) -> FloatArray:
        """(n, 2) inner points at (k + offset) width from the bounding box's centre, row by row."""
        axes = []
        for half, shift in zip(self.half_extent, offset, strict=True):
            k = np.floor(half / width + 1)
            axes.append(np.arange(-k, k + 1 - 2 * shift) + shift)
        x, y = (grid.ravel() * width for grid in np.meshgrid(*axes))
        points = np.column_stack([x, y]) + self.middle
        return points[shapely.contains_xy(self.polygon, points[:, 0], points[:, 1])]


def _mismatch(centers: FloatArray, width: float, target: tuple[float, FloatArray, FloatArray]) -> float:
    """Sum of the relative errors of area and polar second moment and the centroid's offset in radii of
    gyration."""
    if len(centers) == 0:
        return float("inf")
    area, centroid, wanted = target
    polar, second = float(np.trace(wanted)), _second_moments(centers, width, centroid)
    shift = float(np.hypot(*(centers - centroid).mean(axis=0)) / np.sqrt(polar / area))
    # Rounded, so that order and not rounding errors decides between equally good grids.
    return round(
        abs(len(centers) * width**2 / area - 1) + abs(float(np.trace(second)) / polar - 1) + shift, 9
    )


def _distortion(centers: FloatArray, width: float, target: tuple[float, FloatArray, FloatArray]) -> float:
    """Sum of the relative errors of all second moments."""
    _, centroid, wanted = target
    scale = np.sqrt(np.diagonal(wanted))
    errors = np.abs(_second_moments(centers, width, centroid) - wanted) / scale[:, None] / scale
    return float(np.triu(errors).sum())


def _second_moments(centers: FloatArray, width: float, around: FloatArray) -> FloatArray:
    """Second moments (2, 2) of square cells about a point, m⁴."""
    offsets = centers - around
    return width**2 * (offsets.T @ offsets + len(centers) * width**2 / 12 * np.eye(2))


def check_width(width: float) -> None:
    """Raise ValueError unless the width is positive and finite."""
    if not (np.isfinite(width) and width > 0):
        raise ValueError(f"cell grid: cell width must be a positive length in m, got {width}")


def checked_holes(holes: Sequence[ArrayLike]) -> tuple[FloatArray, ...]:
    """Rings (k_j, 2) of openings, checked; a ValueError names the faulty one."""
    return tuple(checked_points(hole, f"hole {j}") for j, hole in enumerate(holes))


def _pieces(edges: FloatArray, width: float) -> tuple[FloatArray, FloatArray, NDArray[np.intp], FloatArray]:
    """Edges cut into short pieces: start (p, 2), vector (p, 2), edge (p,), usable fractions (2, p)."""
    vectors = edges[:, 2:] - edges[:, :2]
    lengths = np.linalg.norm(vectors, axis=1)
    number = np.maximum(1, np.ceil(lengths * _PIECES_PER_CELL / width)).astype(int)
    number[lengths == 0] = 0
    edge = np.repeat(np.arange(len(edges)), number)
    rank = np.arange(len(edge)) - np.repeat(np.cumsum(number) - number, number)
    along = vectors[edge] / number[edge, None]
    start = edges[edge, :2] + rank[:, None] * along
    limits = np.array([np.where(rank == 0, 0.01, 0.0), np.where(rank == number[edge] - 1, 0.99, 1.0)])
    return start, along, edge, limits


_MANY_CORNERS = 100
_SCAN_ERROR = 3e-4  # m


def without_scan_noise(polygon: Polygon) -> Polygon:
    """The polygon, simplified by at most 0.3 mm if it has more than 100 corners, as from a scan."""
    if shapely.get_num_coordinates(polygon) <= _MANY_CORNERS:
        return polygon
    simple = polygon.simplify(_SCAN_ERROR)
    assert isinstance(simple, Polygon)
    return simple


_BULGE = 1e-4  # m; a convex piece may protrude from the polygon by this much

_Borders = dict[int, dict[int, float]]
"""Piece: its neighbours and the length of the common border, m; NaN if the two cannot be joined."""


def convex_pieces(polygon: Polygon) -> list[Polygon]:
    """Convex polygons that cover a polygon with holes and protrude by no more than 0.1 mm.

    Triangles that share a side are joined, longest common border first, as long as the result stays convex
    (the algorithm of Hertel and Mehlhorn, which finds at most four times as many pieces as needed). Two
    pieces that cannot be joined never can, however they grow, so each pair is tried once.
    """
    allowed = polygon.buffer(_BULGE, quad_segs=2)
    shapely.prepare(allowed)
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    pieces: dict[int, Polygon] = dict(enumerate(triangles))
    borders = _common_sides(triangles)
    waiting = [(-length, i, j) for i, beside in borders.items() for j, length in beside.items() if i < j]
    heapq.heapify(waiting)
    following = len(pieces)
    while waiting:
        _, i, j = heapq.heappop(waiting)
        if i not in pieces or j not in pieces:
            continue  # one of them is part of a larger piece by now
        hull = shapely.union(pieces[i], pieces[j]).convex_hull
        if not allowed.covers(hull):
            borders[i][j] = borders[j][i] = np.nan
            continue
        del pieces[i], pieces[j]
        pieces[following] = hull
        one, other = borders.pop(i), borders.pop(j)
        borders[following] = {}
        for k in sorted((one.keys() | other.keys()) - {i, j}):
            length = one.get(k, 0.0) + other.get(k, 0.0)
            borders[k].pop(i, None)
            borders[k].pop(j, None)
            borders[k][following] = borders[following][k] = length
            if not np.isnan(length):
                heapq.heappush(waiting, (-length, k, following))
        following += 1
    return list(pieces.values())


def _common_sides(triangles: NDArray[np.object_]) -> _Borders:
    owners: dict[frozenset[tuple[float, float]], list[int]] = defaultdict(list)
    borders: _Borders = {number: {} for number in range(len(triangles))}
    for number, corners in enumerate(shapely.get_coordinates(triangles).reshape(-1, 4, 2).tolist()):
        ring = [tuple(corner) for corner in corners]
        for a, b in pairwise(ring):
            for other in owners[frozenset((a, b))]:
                borders[number][other] = borders[other][number] = float(np.hypot(a[0] - b[0], a[1] - b[1]))
            owners[frozenset((a, b))].append(number)
    return borders
