"""Does a 90 % interval hold the truth nine times in ten? Identify many simulated objects and count.

Objects, maps and pushes are drawn at random: two materials with a sharp border on top of smooth variation,
whose masses differ up to ten-fold, as in most objects of the paper; frictions and total masses over an order
of magnitude. Rows carry sensor noise. The truth is then looked up in the intervals of a belief that is learnt
as `slipmap identify` does, with several laws of friction.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from slipmap.models.inference.identification import identify
from slipmap.models.inference.results import Identification
from slipmap.models.inference.summaries import interval
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.models.progress import Progress, silent
from slipmap.planners.exploration import candidate_pushes

LEVEL = 0.9
_CELLS, _FIT_PUSHES, _HELDOUT_PUSHES = 40, 6, 4
QUANTITIES = ("centre of mass, x", "centre of mass, y", "total friction", "predicted position")


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """How often intervals held the truth.

    Attributes:
        objects: how many were identified.
        seed: of every draw.
        seconds: taken.
        coverage: share of 90 % intervals that held the truth, by quantity.
        ranks: (m,) for each quantity, the belief's cumulative probability at the truth, uniform in [0, 1]
            for a calibrated belief.
    """

    objects: int
    seed: int
    seconds: float
    coverage: dict[str, float]
    ranks: dict[str, FloatArray] = field(repr=False)


def calibrate(*, objects: int = 40, seed: int = 0, progress: Progress | None = None) -> CalibrationResult:
    """Identify `objects` simulated objects and compare their beliefs with the truth.

    Args:
        objects: at least 1.
        seed: of shapes, maps, pushes and noise.
        progress: called with (stage, done, total).

    Raises:
        ValueError: objects below 1.
    """
    if objects < 1:
        raise ValueError(f"objects must be at least 1, got {objects}")
    started = time.perf_counter()
    ranks: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    report = progress or silent
    report("identifying simulated objects", 0, objects)
    for index in range(objects):
        rng = np.random.default_rng([seed, index])
        for name, rank in _one_object(rng, index):
            ranks[name].append(rank)
        report("identifying simulated objects", index + 1, objects)
    arrays = {name: np.array(values) for name, values in ranks.items()}
    tail = 0.5 * (1.0 - LEVEL)
    coverage = {name: float(np.mean((r > tail) & (r < 1.0 - tail))) for name, r in arrays.items()}
    return CalibrationResult(objects, seed, time.perf_counter() - started, coverage, arrays)


def _one_object(rng: np.random.Generator, index: int) -> list[tuple[str, float]]:
    grid = _random_object(rng)
    slider = Slider(grid, finger_radius=float(rng.uniform(0.004, 0.01)))
    truth = _random_maps(rng, grid)
    pushes = [
        candidate.push([*rng.uniform(-0.2, 0.2, 2), rng.uniform(-np.pi, np.pi)])
        for candidate in candidate_pushes(
            grid, slider.finger_radius, rng, _FIT_PUSHES + _HELDOUT_PUSHES, length=(0.05, 0.12)
        )
    ]
    dataset = record_pushes(slider, truth, pushes, rng, heldout=_HELDOUT_PUSHES, mass=float(truth.mass.sum()))
    exact = slider.rollout(truth, pushes)
    result = identify(dataset, seed=index)
    belief = result.belief
    com = (truth.mass @ grid.centers / truth.mass.sum(axis=1, keepdims=True))[0]
    friction = float((truth.mass * truth.mu).sum() * slider.gravity)
    found = [
        (QUANTITIES[axis], _rank(belief.centers_of_mass[:, axis], belief.probability, float(com[axis])))
        for axis in (0, 1)
    ]
    found.append((QUANTITIES[2], _rank(belief.friction_forces, belief.probability, friction, log=True)))
    found += _position_ranks(result, exact.end[0, _FIT_PUSHES:, :2])
    return found


def _position_ranks(result: Identification, ends: FloatArray) -> list[tuple[str, float]]:
    heldout = [push for push in result.pushes if push.role == "heldout"]
    return [
        (QUANTITIES[3], _rank(push.hypotheses[:, -1, axis], result.belief.probability, float(end[axis])))
        for push, end in zip(heldout, ends, strict=True)
        for axis in (0, 1)
    ]


def _rank(values: FloatArray, probability: FloatArray, truth: float, *, log: bool = False) -> float:
    """Cumulative probability at the truth, of the same Student-t distribution that intervals are made of."""
    from scipy.stats import t

    _, low, high = interval(values, probability, level=LEVEL, log=log)
    if log:
        low, high, truth = np.log(low), np.log(high), np.log(truth)
    freedom = max(2.0, 1.0 / float((probability**2).sum())) - 1.0
    scale = 0.5 * (high - low) / float(t.ppf(0.5 + 0.5 * LEVEL, freedom))
    return float(t.cdf((truth - 0.5 * (low + high)) / max(scale, 1e-300), freedom))


def _random_object(rng: np.random.Generator) -> CellGrid:
    """A rectangle, an L, a T or a wedge, 8 to 20 cm long."""
    a, b = rng.uniform(0.08, 0.2), rng.uniform(0.05, 0.12)
    p, q = rng.uniform(0.3, 0.6, 2)
    shapes = [
        [[0, 0], [a, 0], [a, b], [0, b]],
        [[0, 0], [a, 0], [a, q * b], [p * a, q * b], [p * a, b], [0, b]],
        [[p * a / 2, 0], [a - p * a / 2, 0], [a - p * a / 2, q * b], [a, q * b], [a, b], [0, b], [0, q * b],
         [p * a / 2, q * b]],
        [[0, 0], [a, 0], [p * a, b], [0, b]],
    ]  # fmt: skip
    corners = np.array(shapes[rng.integers(len(shapes))]) - [a / 2, b / 2]
    return cells_from_polygon(corners, count=_CELLS)


def _random_maps(rng: np.random.Generator, grid: CellGrid) -> Maps:
    """Two materials divided by a random line, smooth variation within, random scales."""
    normal = rng.standard_normal(2)
    side = (grid.centers - grid.centers.mean(axis=0)) @ normal > 0.02 * rng.standard_normal()

    def variation(contrast: float, waviness: float) -> FloatArray:
        wave = grid.centers @ (rng.standard_normal(2) / np.ptp(grid.centers, axis=0).max())
        return contrast * rng.uniform(-1, 1) * side + waviness * np.sin(3 * wave + rng.uniform(0, 2 * np.pi))

    mass = np.exp(variation(2.3, 0.2))
    mu = np.exp(variation(0.8, 0.1))
    total = np.exp(rng.uniform(np.log(0.2), np.log(2.0)))
    friction = np.exp(rng.uniform(np.log(0.1), np.log(1.0)))
    finger = np.exp(rng.uniform(np.log(0.1), np.log(1.0)))
    return Maps(mass * total / mass.sum(), mu * friction / mu.mean(), np.array([finger]))
