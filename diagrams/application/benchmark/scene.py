"""The push that every engine of the benchmark simulates, and how the engines are timed."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps, Push, Slider

WIDTH, DEPTH = 0.20, 0.12  # sides of the object, a rectangle, m
MASS = 1.5
MU_FINGER = 0.3
GRAVITY = 9.81
FINGER_RADIUS = 0.008
SPEED = 0.06
STEP = 0.005
FINGER_START = (0.03, -DEPTH / 2 - FINGER_RADIUS - 2e-4)


@dataclass(frozen=True)
class Scene:
    """One object, K maps of it, and one push: a finger moves along +y against the long side, off-centre.

    All cells have the same mass, so that each carries its own weight in rigid-body engines too.
    The friction coefficients are random.
    """

    slider: Slider  # the cell-grid model of the object
    maps: Maps  # K models
    push: Push  # the finger's motion, with poses at the ends of all steps


@dataclass(frozen=True)
class Outcome:
    """Result of one engine."""

    seconds: float  # median time of one rollout, s
    final_pose: FloatArray  # (3,) x, y, θ of the object after the push, with the first of the maps
    remark: str  # how the engine represents the object


def make_scene(*, cells: int, models: int, steps: int, seed: int) -> Scene:
    """The benchmark's push; the number of cells is as close to `cells` as a grid over the rectangle allows.

    Raises:
        ValueError: cells, models or steps below 1.
    """
    for name, value in (("cells", cells), ("models", models), ("steps", steps)):
        if value < 1:
            raise ValueError(f"benchmark: {name} must be at least 1, got {value}")
    corners = np.array([[-WIDTH, -DEPTH], [WIDTH, -DEPTH], [WIDTH, DEPTH], [-WIDTH, DEPTH]]) / 2
    grid = cells_from_polygon(corners, count=cells)
    n = len(grid)
    mu = np.random.default_rng(seed).uniform(0.2, 0.6, (models, n))
    maps = Maps(np.full((models, n), MASS / n), mu, np.full(models, MU_FINGER))
    tip = np.array(FINGER_START) + np.outer(STEP * SPEED * np.arange(steps + 1), (0.0, 1.0))
    return Scene(Slider(grid, FINGER_RADIUS, GRAVITY), maps, Push(STEP, tip, np.zeros(3)))


def median_time(
    work: Callable[[], object], repeats: int, clock: Callable[[], float] = time.process_time
) -> float:
    """Median duration of some work, s; processor time is less affected by other programs."""
    durations = []
    for _ in range(repeats):
        start = clock()
        work()
        durations.append(clock() - start)
    return statistics.median(durations)
