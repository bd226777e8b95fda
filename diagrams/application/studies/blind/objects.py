"""Random objects, which are footprints of square cells with maps of mass and friction, and random pushes.

Pushes are slow, medium, fast, accelerating or in strokes; straight or curved; with three kinds of endings.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from slipmap.models.geometry import turn

FloatArray = NDArray[np.float64]
GRAVITY = 9.81


@dataclass(frozen=True, eq=False)
class SlidingObject:
    """A rigid footprint on a table and the round finger that pushes it."""

    shape: str  # such as 'hammer'
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
    weighed: bool = False  # whether the dataset states the total mass

    @cached_property
    def centers(self) -> FloatArray:
        """(n, 2) centres of the cells in the object frame, m."""
        return self.origin + (self.cells + 0.5) * self.width

    @cached_property
    def footprint(self) -> shapely.Polygon:
        """Union of the cells in the object frame."""
        low = self.centers - 0.5 * self.width
        high = self.centers + 0.5 * self.width
        # Neighbours share borders exactly only when rounded to one lattice.
        union = shapely.union_all(shapely.box(*low.T, *high.T), grid_size=1e-9)
        return shapely.orient_polygons(union.simplify(1e-7))

    @cached_property
    def outline(self) -> FloatArray:
        """(m, 2) corners, counter-clockwise, m."""
        return np.array(self.footprint.exterior.coords)[:-1]

    @property
    def total_mass(self) -> float:
        """Mass of all cells, kg."""
        return float(self.mass.sum())

    @property
    def center_of_mass(self) -> FloatArray:
        """(2,) centre of mass in the object frame, m."""
        return self.mass @ self.centers / self.mass.sum()

    @property
    def inertia(self) -> float:
        """Moment of inertia about the object frame's origin, kg·m², with cells as uniform squares."""
        return float(self.mass @ ((self.centers**2).sum(axis=1) + self.width**2 / 6))

    @property
    def friction_force(self) -> float:
        """Friction when all cells slide in one direction, N."""
        return float(GRAVITY * self.mass @ self.mu)

    @property
    def area(self) -> float:
        """Area of the footprint, m²."""
        return len(self.cells) * self.width**2

    @property
    def reach(self) -> float:
        """Largest distance of the outline from the origin, m."""
        return float(np.hypot(*self.outline.T).max())

    def rectangles(self) -> list[tuple[FloatArray, FloatArray]]:
        """Centre and size of overlapping rectangles; each straight side of the outline lies on one of them.

        So a finger never crosses a joint between two rectangles along a side.
        """
        spans: set[tuple[int, int, int, int]] = set()
        for along, across in ((0, 1), (1, 0)):
            rows_of: dict[tuple[int, int], list[int]] = {}
            for row in np.unique(self.cells[:, across]).tolist():
                for run in _runs(self.cells[self.cells[:, across] == row, along]):
                    rows_of.setdefault(run, []).append(row)
            for run, rows in rows_of.items():
                for span in _runs(rows):
                    spans.add((*run, *span) if along == 0 else (*span, *run))
        result = []
        for left, right, bottom, top in sorted(spans):
            low = self.origin + self.width * np.array([left, bottom])
            high = self.origin + self.width * (np.array([right, top]) + 1)
            result.append((0.5 * (low + high), high - low))
        return result

    def quadrature(self, spacing: float = 0.003) -> tuple[FloatArray, NDArray[np.int64], int]:
        """Points that share a cell's load evenly: (p, 2) places, (p,) their cells, points per cell."""
        across = max(2, int(np.ceil(self.width / spacing)))
        offset = ((np.arange(across) + 0.5) / across - 0.5) * self.width
        inside = np.stack(np.meshgrid(offset, offset), axis=-1).reshape(-1, 2)
        points = (self.centers[:, None] + inside).reshape(-1, 2)
        return points, np.repeat(np.arange(len(self.cells)), across**2), across**2


def _runs(numbers: ArrayLike) -> list[tuple[int, int]]:
    """First and last of each run of consecutive whole numbers."""
    ordered = np.sort(numbers)
    runs = np.split(ordered, np.flatnonzero(np.diff(ordered) > 1) + 1)
    return [(int(run[0]), int(run[-1])) for run in runs]


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


KINDS = ("medium",) * 7 + ("fast",) * 6 + ("slow",) * 4 + ("accelerating",) * 4 + ("strokes",) * 3
"""The kinds of the 24 pushes of a dataset, in no particular order."""

HELDOUT = 8
TABLE_SIZE = 1.0  # m, a square about the origin
_START_WITHIN = 0.33  # m
_SPARE = 0.1  # s; the path continues so long after the recording


@dataclass(frozen=True, eq=False)
class FingerPath:
    """An arc of constant curvature with a speed that is piecewise linear in time.

    Attributes:
        start: (2,) m.
        heading: initial direction, rad.
        curvature: 1/m, positive to the left.
        times, speeds: (k,) s and m/s.
    """

    start: FloatArray
    heading: float
    curvature: float
    times: FloatArray
    speeds: FloatArray

    def travelled(self, t: FloatArray) -> FloatArray:
        """(T,) distance travelled since time zero, m."""
        span = np.diff(self.times)
        ways = np.concatenate([[0.0], np.cumsum(0.5 * (self.speeds[1:] + self.speeds[:-1]) * span)])
        t = np.clip(t, self.times[0], self.times[-1])
        piece = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(span) - 1)
        since = t - self.times[piece]
        slope = (self.speeds[piece + 1] - self.speeds[piece]) / span[piece]
        return ways[piece] + self.speeds[piece] * since + 0.5 * slope * since**2

    def positions(self, t: FloatArray) -> FloatArray:
        """(T, 2) positions at times (T,), m."""
        way = self.travelled(t)
        half = 0.5 * self.curvature * way
        chord = way * np.sinc(half / np.pi)
        direction = self.heading + half
        return self.start + chord[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])


@dataclass(frozen=True, eq=False)
class PushPlan:
    """One push: finger path and initial pose of the object."""

    # kind, end: such as 'medium' and 'abrupt'
    kind: str
    end: str
    duration: float  # of the recording, s
    pose: FloatArray  # (3,) of the object before, m and rad
    path: FingerPath  # of the finger, m


def random_plan(rng: np.random.Generator, thing: SlidingObject, kind: str) -> PushPlan:
    """A push of the given kind somewhere on the table, against a random place of the outline."""
    end, times, speeds = _timing(rng, kind)
    duration = round(float(times[-1]) - _SPARE, 2)
    curved = kind != "strokes" and rng.random() < 0.65
    curvature = float(rng.uniform(-3.5, 3.5)) if curved else 0.0
    start, heading = _approach(rng, thing)
    pose = np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    path = FingerPath(turn(pose[2]) @ start, heading + pose[2], curvature, times, speeds)
    # Keep the object well within the table.
    way = path.positions(times[-1:])[0] - path.start
    for _ in range(1000):
        place = rng.uniform(-_START_WITHIN, _START_WITHIN, 2)
        if np.abs(place + way).max() + thing.reach < 0.5 * TABLE_SIZE:
            break
    else:
        place = -0.5 * way
    pose[:2] = place
    return PushPlan(
        kind, end, duration, pose, FingerPath(path.start + place, path.heading, curvature, times, speeds)
    )


def _timing(rng: np.random.Generator, kind: str) -> tuple[str, FloatArray, FloatArray]:
    """Kind of ending, and times (s) and speeds (m/s) of the finger."""
    chances = {"slow": (0.0, 0.2, 0.8), "medium": (0.35, 0.4, 0.25), "strokes": (0.5, 0.5, 0.0)}
    end = str(rng.choice(["gentle", "abrupt", "moving"], p=chances.get(kind, (0.5, 0.5, 0.0))))
    if kind == "strokes":
        times, speeds = _strokes(rng)
    elif kind == "accelerating":
        top = rng.uniform(0.12, 0.2)
        rise = rng.uniform(1.2, 1.7)
        hold = 0.05 if end == "abrupt" else 0.001
        times, speeds = [0.0, 0.05, rise, rise + hold], [0.0, 0.01, top, top]
    else:
        low, high = {"slow": (0.011, 0.025), "medium": (0.035, 0.095), "fast": (0.1, 0.19)}[kind]
        speed = rng.uniform(low, high)
        low, high = {"slow": (2.8, 3.6), "medium": (1.4, 2.8), "fast": (0.7, 1.3)}[kind]
        times, speeds = [0.0, rng.uniform(0.05, 0.28), rng.uniform(low, high)], [0.0, speed, speed]
    if end == "moving":
        times, speeds = [*times, times[-1] + _SPARE], [*speeds, speeds[-1]]
    else:
        brake = rng.uniform(0.14, 0.36) if end == "gentle" else rng.uniform(0.008, 0.02)
        stop = times[-1] + brake
        times, speeds = [*times, stop, stop + rng.uniform(0.4, 1.2)], [*speeds, 0.0, 0.0]
    return end, np.array(times), np.array(speeds)


def _strokes(rng: np.random.Generator) -> tuple[list[float], list[float]]:
    """A slow and a faster stroke, in half of the cases with a pause between them."""
    slow, fast = rng.uniform(0.02, 0.065), rng.uniform(0.065, 0.175)
    first = rng.uniform(0.7, 1.1)
    times, speeds = [0.0, 0.1, first], [0.0, slow, slow]
    if rng.random() < 0.5:
        times += [first + 0.02, first + rng.uniform(0.2, 0.4)]
        speeds += [0.0, 0.0]
    times += [times[-1] + 0.1, times[-1] + 0.1 + rng.uniform(0.4, 1.1)]
    speeds += [fast, fast]
    return times, speeds


def _approach(rng: np.random.Generator, thing: SlidingObject) -> tuple[FloatArray, float]:
    """Start and heading of a finger that touches the outline after a few mm, in the object frame."""
    ring = thing.footprint.exterior
    while True:
        at = rng.uniform(0, ring.length)
        near = np.array([ring.interpolate(at + d).coords[0] for d in (-1e-4, 0.0, 1e-4)])
        tangent = (near[2] - near[0]) / np.linalg.norm(near[2] - near[0])
        outward = np.array([tangent[1], -tangent[0]])
        heading = float(np.arctan2(*-outward[::-1]) + rng.uniform(-0.6, 0.6))
        direction = np.array([np.cos(heading), np.sin(heading)])
        touch = near[1] + thing.finger_radius * outward
        start = touch - rng.uniform(0.002, 0.012) * direction
        free = shapely.LineString([start, touch - 1e-3 * direction]).distance(thing.footprint)
        if free > thing.finger_radius + 2e-4:
            return start, heading
