"""Random objects: footprints of square cells with maps of mass and friction."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
GRAVITY = 9.81


def rotation_matrix(angle: float) -> FloatArray:
    """(2, 2) that turns vectors by an angle, rad."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


@dataclass(frozen=True, eq=False)
class SlidingObject:
    """A rigid footprint on a table and the round finger that pushes it."""

    shape: str  # what it looks like, such as 'hammer'
    cells: NDArray[np.int64]  # (n, 2) column and row of every cell
    width: float  # of a cell, m
    origin: FloatArray  # (2,) corner of cell (0, 0) in the object frame, m
    # mass, mu: (n,) kg, and friction against the table
    mass: FloatArray
    mu: FloatArray
    mu_finger: float  # friction against the finger
    # finger_radius, height: m
    finger_radius: float
    height: float
    weighed: bool = False  # whether the dataset tells the total mass

    @cached_property
    def centers(self) -> FloatArray:
        """(n, 2) in the object frame, m."""
        return self.origin + (self.cells + 0.5) * self.width

    @cached_property
    def footprint(self) -> shapely.Polygon:
        """Union of the cells in the object frame."""
        low = self.centers - 0.5 * self.width
        high = self.centers + 0.5 * self.width
        # Neighbours share their borders to the last bit only when rounded to one lattice.
        union = shapely.union_all(shapely.box(*low.T, *high.T), grid_size=1e-9)
        return shapely.orient_polygons(union.simplify(1e-7))

    @cached_property
    def outline(self) -> FloatArray:
        """(m, 2) corners, counter-clockwise, m."""
        return np.array(self.footprint.exterior.coords)[:-1]

    @property
    def total_mass(self) -> float:
        """Of all cells, kg."""
        return float(self.mass.sum())

    @property
    def center_of_mass(self) -> FloatArray:
        """(2,) in the object frame, m."""
        return self.mass @ self.centers / self.mass.sum()

    @property
    def inertia(self) -> float:
        """About the object frame's origin, kg·m², each cell a uniform square."""
        return float(self.mass @ ((self.centers**2).sum(axis=1) + self.width**2 / 6))

    @property
    def friction_force(self) -> float:
        """When all cells slide one way, N."""
        return float(GRAVITY * self.mass @ self.mu)

    @property
    def area(self) -> float:
        """Of the footprint, m²."""
        return len(self.cells) * self.width**2

    @property
    def reach(self) -> float:
        """Largest distance of the outline from the origin, m."""
        return float(np.hypot(*self.outline.T).max())

    def rectangles(self) -> list[tuple[FloatArray, FloatArray]]:
        """Center and size of overlapping rectangles; each straight side of the outline lies on one of them.

        A finger thus meets no joint between two rectangles along a side.
        """
        spans: set[tuple[int, int, int, int]] = set()
        for along, across in ((0, 1), (1, 0)):
            rows: dict[int, list[int]] = {}
            for cell in self.cells:
                rows.setdefault(int(cell[across]), []).append(int(cell[along]))
            open_runs: dict[tuple[int, int], int] = {}
            for row in [*sorted(rows), max(rows) + 2]:
                runs = _runs(sorted(rows.get(row, [])))
                for run in [run for run in open_runs if run not in runs]:
                    first = open_runs.pop(run)
                    last = max(r for r in rows if r < row)
                    spans.add((*run, first, last) if along == 0 else (first, last, *run))
                for run in runs:
                    open_runs.setdefault(run, row)
        result = []
        for left, right, bottom, top in sorted(spans):
            low = self.origin + self.width * np.array([left, bottom])
            high = self.origin + self.width * (np.array([right, top]) + 1)
            result.append((0.5 * (low + high), high - low))
        return result

    def quadrature(self, spacing: float = 0.003) -> tuple[FloatArray, NDArray[np.int64], int]:
        """Points that share a cell's load evenly: (p, 2) places, (p,) their cells, points a cell."""
        across = max(2, int(np.ceil(self.width / spacing)))
        offset = ((np.arange(across) + 0.5) / across - 0.5) * self.width
        inside = np.stack(np.meshgrid(offset, offset), axis=-1).reshape(-1, 2)
        points = (self.centers[:, None] + inside).reshape(-1, 2)
        return points, np.repeat(np.arange(len(self.cells)), across**2), across**2


def _runs(sorted_numbers: list[int]) -> list[tuple[int, int]]:
    """First and last of each run of consecutive numbers."""
    runs: list[tuple[int, int]] = []
    for number in sorted_numbers:
        if runs and runs[-1][1] == number - 1:
            runs[-1] = (runs[-1][0], number)
        else:
            runs.append((number, number))
    return runs


def random_object(rng: np.random.Generator) -> SlidingObject:
    """A T, L, book, hammer, bar, cross, step or wedge of 20 to 60 cells, 0.3 to 2 kg."""
    shape, cells = _random_cells(rng)
    longest = float(np.ptp(cells, axis=0).max() + 1)
    width = float(np.clip(rng.uniform(0.16, 0.26) / longest, 0.010, 0.024))
    middle = (cells + 0.5).mean(axis=0) * width
    origin = -middle + rng.uniform(-0.5, 0.5, 2) * width
    centers = origin + (cells + 0.5) * width
    mass = np.exp(0.25 * _smooth_field(rng, centers) + 0.15 * rng.standard_normal(len(cells)))
    if rng.random() < 0.4:
        mass[rng.integers(len(cells))] *= rng.uniform(2.5, 6.0)
    mass *= np.exp(rng.uniform(np.log(0.3), np.log(2.0))) / mass.sum()
    mu = np.exp(0.15 * _smooth_field(rng, centers) + 0.07 * rng.standard_normal(len(cells)))
    mu = np.clip(mu * rng.uniform(0.2, 0.5) / mu.mean(), 0.08, 0.6)
    return SlidingObject(
        shape=shape,
        cells=cells,
        width=width,
        origin=origin,
        mass=mass,
        mu=mu,
        mu_finger=float(rng.uniform(0.15, 0.5)),
        finger_radius=float(rng.uniform(0.005, 0.008)),
        height=float(rng.uniform(0.03, 0.08)),
        weighed=bool(rng.random() < 0.5),
    )


def _smooth_field(rng: np.random.Generator, centers: FloatArray) -> FloatArray:
    """(n,) a random field of unit variance, smooth over about a third of the object."""
    length = 0.35 * float(np.ptp(centers, axis=0).max())
    distance = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    covariance = np.exp(-0.5 * (distance / length) ** 2) + 1e-9 * np.eye(len(centers))
    return np.linalg.cholesky(covariance) @ rng.standard_normal(len(centers))


def _random_cells(rng: np.random.Generator) -> tuple[str, NDArray[np.int64]]:
    while True:
        shape = str(rng.choice(list(_SHAPES)))
        filled = _SHAPES[shape](rng)
        if 20 <= filled.sum() <= 60:
            if rng.random() < 0.5:
                filled = filled[::-1]
            return shape, np.argwhere(filled)


def _t_shape(rng: np.random.Generator) -> NDArray[np.bool_]:
    bar, stem, length = rng.integers(5, 12), rng.integers(2, 5), rng.integers(3, 9)
    filled = np.zeros((bar, length + 3), dtype=bool)
    filled[:, length:] = True
    start = (bar - stem) // 2
    filled[start : start + stem, :length] = True
    return filled


def _l_shape(rng: np.random.Generator) -> NDArray[np.bool_]:
    a, b, p, q = rng.integers(5, 11), rng.integers(5, 11), rng.integers(2, 5), rng.integers(2, 5)
    filled = np.zeros((a, b), dtype=bool)
    filled[:, :q] = True
    filled[:p, :] = True
    return filled


def _hammer(rng: np.random.Generator) -> NDArray[np.bool_]:
    handle, head, tall = rng.integers(6, 11), rng.integers(2, 5), rng.integers(5, 9)
    filled = np.zeros((handle + head, tall), dtype=bool)
    filled[handle:] = True
    start = rng.integers(1, tall - 2)
    filled[:handle, start : start + 2] = True
    return filled


def _cross(rng: np.random.Generator) -> NDArray[np.bool_]:
    a, b, p, q = rng.integers(6, 11), rng.integers(6, 11), rng.integers(2, 4), rng.integers(2, 4)
    filled = np.zeros((a, b), dtype=bool)
    filled[:, (b - q) // 2 : (b - q) // 2 + q] = True
    filled[(a - p) // 2 : (a - p) // 2 + p] = True
    return filled


def _step(rng: np.random.Generator) -> NDArray[np.bool_]:
    a, b, shift = rng.integers(5, 9), rng.integers(2, 4), rng.integers(1, 4)
    filled = np.zeros((a + shift, 2 * b), dtype=bool)
    filled[:a, :b] = True
    filled[shift:, b:] = True
    return filled


def _wedge(rng: np.random.Generator) -> NDArray[np.bool_]:
    a, b = rng.integers(7, 11), rng.integers(5, 9)
    reach = np.ceil(np.linspace(a, rng.integers(2, 5), b)).astype(int)
    return np.arange(a)[:, None] < reach


_SHAPES: dict[str, Callable[[np.random.Generator], NDArray[np.bool_]]] = {
    "T": _t_shape,
    "L": _l_shape,
    "book": lambda rng: np.ones((rng.integers(5, 10), rng.integers(4, 8)), dtype=bool),
    "hammer": _hammer,
    "bar": lambda rng: np.ones((rng.integers(8, 15), rng.integers(2, 5)), dtype=bool),
    "cross": _cross,
    "step": _step,
    "wedge": _wedge,
}
