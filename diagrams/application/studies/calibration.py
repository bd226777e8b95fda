"""Whether 90 % intervals contain the truth nine times in ten, over many simulated objects.

Objects, maps and pushes are random, so the ranks of the truth among hypotheses are uniform for a calibrated
belief (Talts et al., 2018). The kinds of maps take turns: two materials with a sharp border, as in most
objects of the paper; even; smooth; three to five feet; an almost massless middle. Cell masses differ by up
to a factor of 1000, frictions by up to 4. A belief is learned from three to ten pushes as by `slipmap
identify`; every fourth object, on average, has no force sensor; the declared noise is right, half or double.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np

from slipmap.models.inference.identifiability import friction_arms
from slipmap.models.inference.identification import identify
from slipmap.models.inference.results import Identification
from slipmap.models.inference.summaries import interval
from slipmap.models.measurements import Noise, PushDataset
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.models.progress import Progress, silent
from slipmap.planners.exploration import candidate_pushes

LEVEL = 0.9
_CELLS, _HELDOUT_PUSHES = 40, 4
QUANTITIES = (
    "centre of mass, x", "centre of mass, y", "total friction", "friction arm", "predicted position",
)  # fmt: skip
KINDS = ("two materials", "even", "smooth", "feet", "light middle")


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """How often intervals contained the truth."""

    objects: int  # number of identified objects
    seed: int  # of every draw
    seconds: float  # duration
    coverage: dict[str, float]  # share of 90 % intervals that contain the truth, by quantity
    # (m,) the belief's cumulative probability at the truth, by quantity; uniform in [0, 1] if calibrated
    ranks: dict[str, FloatArray] = field(repr=False)
    # coverage by kind of object, for those of `KINDS` that occurred
    by_kind: dict[str, dict[str, float]] = field(repr=False)


def calibrate(*, objects: int, seed: int, progress: Progress | None = None) -> CalibrationResult:
    """Identify `objects` simulated objects and compare their beliefs with the truth.

    Args:
        objects: at least 1.
        seed: of shapes, maps, pushes and noise.
        progress: called with (stage, done, total).
    """
    started = time.perf_counter()
    found: list[tuple[str, str, float]] = []
    report = progress or silent
    report("identifying simulated objects", 0, objects)
    for index in range(objects):
        rng = np.random.default_rng([seed, index])
        kind = KINDS[index % len(KINDS)]
        found += [(kind, name, rank) for name, rank in _one_object(rng, index, kind)]
        report("identifying simulated objects", index + 1, objects)

    def coverage(of: str | None) -> dict[str, float]:
        return {name: _held(found, name, of) for name in QUANTITIES}

    ranks = {name: np.array([rank for _, n, rank in found if n == name]) for name in QUANTITIES}
    by_kind = {kind: coverage(kind) for kind in KINDS[:objects]}
    return CalibrationResult(objects, seed, time.perf_counter() - started, coverage(None), ranks, by_kind)


def _held(found: list[tuple[str, str, float]], name: str, kind: str | None) -> float:
    """Share of a quantity's ranks, of one kind or all, within the central `LEVEL`."""
    tail = 0.5 * (1.0 - LEVEL)
    ranks = [rank for k, n, rank in found if n == name and kind in (None, k)]
    return float(np.mean([tail < rank < 1.0 - tail for rank in ranks]))


def _one_object(rng: np.random.Generator, index: int, kind: str) -> list[tuple[str, float]]:
    grid = _random_object(rng)
    slider = Slider(grid, finger_radius=float(rng.uniform(0.004, 0.01)))
    truth = _random_maps(rng, grid, kind)
    count = int(rng.integers(3, 11))
    pushes = [
        candidate.push([*rng.uniform(-0.2, 0.2, 2), rng.uniform(-np.pi, np.pi)])
        for candidate in candidate_pushes(
            grid, slider.finger_radius, rng, count + _HELDOUT_PUSHES, length=(0.05, 0.12)
        )
    ]
    dataset = record_pushes(slider, truth, pushes, rng, heldout=_HELDOUT_PUSHES, mass=float(truth.mass.sum()))
    dataset = _as_declared(dataset, rng.choice([0.5, 1.0, 2.0]), force=rng.uniform() < 0.75)
    exact = slider.rollout(truth, pushes)
    result = identify(dataset, seed=index)
    belief = result.belief
    p = belief.probability
    friction = float((truth.mass * truth.mu).sum() * slider.gravity)
    told = {name: fact for fact in result.quantities for name in QUANTITIES if fact.name.startswith(name)}
    known = (*grid.center_of(truth.mass)[0].tolist(), friction, float(friction_arms(grid, truth)[0]))
    found = [
        (name, _rank(told[name].low, told[name].high, p, value, log="friction" in name))
        for name, value in zip(QUANTITIES, known, strict=False)
    ]
    return found + _position_ranks(result, exact.end[0, count:, :2])


def _as_declared(dataset: PushDataset, factor: float, *, force: bool) -> PushDataset:
    """The dataset with its declared noise scaled by a factor, with or without its force channel."""
    noise = Noise(**{name: value and value * factor for name, value in vars(dataset.noise).items()})
    trials = dataset.trials if force else tuple(replace(one, ft_wrench=None) for one in dataset.trials)
    return replace(dataset, noise=noise, trials=trials)


def _position_ranks(result: Identification, ends: FloatArray) -> list[tuple[str, float]]:
    heldout = [push for push in result.pushes if push.role == "heldout"]
    p = result.belief.probability
    return [
        (
            QUANTITIES[4],
            _rank(*interval(push.hypotheses[:, -1, axis], p, level=LEVEL)[1:], p, float(end[axis])),
        )
        for push, end in zip(heldout, ends, strict=True)
        for axis in (0, 1)
    ]


def _rank(low: float, high: float, probability: FloatArray, truth: float, *, log: bool = False) -> float:
    """Cumulative probability at the truth of the Student-t distribution behind an interval."""
    from scipy.stats import t

    if log:
        low, high, truth = np.log(low), np.log(high), np.log(truth)
    freedom = max(2.0, 1.0 / float((probability**2).sum())) - 1.0
    scale = 0.5 * (high - low) / float(t.ppf(0.5 + 0.5 * LEVEL, freedom))
    return float(t.cdf((truth - 0.5 * (low + high)) / max(scale, 1e-300), freedom))


def _random_object(rng: np.random.Generator) -> CellGrid:
    """A rectangle, L, T or wedge, 8 to 20 cm long."""
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


def _random_maps(rng: np.random.Generator, grid: CellGrid, kind: str) -> Maps:
    """Random maps of a kind with random scales."""
    places = (grid.centers - grid.centers.mean(axis=0)) / np.ptp(grid.centers, axis=0).max()
    n = len(places)

    def side() -> FloatArray:
        return (places @ rng.standard_normal(2) > 0.1 * rng.standard_normal()).astype(float)

    def wave() -> FloatArray:
        return np.sin(3 * places @ rng.standard_normal(2) + rng.uniform(0, 2 * np.pi))

    log_mu = rng.uniform(0.0, 0.7) * side() + 0.1 * wave()
    if kind == "two materials":
        log_mass = 2.3 * rng.uniform(-1, 1) * side() + 0.2 * wave()
    elif kind == "even":
        log_mass, log_mu = np.zeros(n), np.zeros(n)
    elif kind == "smooth":
        log_mass = rng.uniform(0.2, 1.0) * wave() + rng.uniform(0.1, 0.5) * wave()
    elif kind == "feet":
        log_mass = np.full(n, -rng.uniform(4.0, 6.9))
        log_mass[rng.choice(n, int(rng.integers(3, 6)), replace=False)] = 0.0
    else:
        along = places @ np.linalg.eigh(places.T @ places)[1][:, 1]
        log_mass = np.where(np.abs(along) < 0.5 * np.abs(along).max(), -rng.uniform(2.3, 6.9), 0.0)
        log_mass += 0.2 * wave()
    mass, mu = np.exp(log_mass), np.exp(log_mu)
    total = np.exp(rng.uniform(np.log(0.2), np.log(2.0)))
    friction = np.exp(rng.uniform(np.log(0.1), np.log(1.0)))
    finger = np.exp(rng.uniform(np.log(0.1), np.log(1.0)))
    return Maps((mass * total / mass.sum())[None], (mu * friction / mu.mean())[None], np.array([finger]))
