"""The push that every engine of the benchmark simulates, its timing, and the growth of time and memory."""

import json
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps, Push, Slider
from slipmap.models.progress import Progress

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
    """The benchmark's push; the number of cells is as close to `cells` as a grid over a rectangle allows."""
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


CELLS = (60, 250, 1000, 2000)
STEPS = (100, 200, 400, 800)
MODELS = (1, 100, 1000)


def sizes(cells: int, steps: int) -> Iterator[dict[str, int]]:
    """Points to measure: one number grows while the others stay fixed; the last has most cells and models."""
    points = [(value, steps, 1) for value in CELLS]
    points += [(cells, value, 1) for value in STEPS]
    points += [(cells, steps, value) for value in MODELS]
    points.append((max(CELLS), steps, max(MODELS)))
    for point in dict.fromkeys(points):
        yield dict(zip(("cells", "steps", "models"), point, strict=True))


def measure_growth(
    *, cells: int, steps: int, repeats: int, seed: int, progress: Progress
) -> list[dict[str, Any]]:
    """Measurements of all `sizes`, see `measure`; `progress` is called with (stage, done, total).

    Raises:
        RuntimeError: a measurement failed; the message ends with its last output.
    """
    results: list[dict[str, Any]] = []
    points = list(sizes(cells, steps))
    for done, size in enumerate(points):
        progress("growth", done, len(points))
        arguments = json.dumps({**size, "repeats": repeats, "seed": seed})
        child = subprocess.run(
            [sys.executable, "-m", "slipmap.diagrams.application.benchmark.scene", arguments],
            capture_output=True, text=True, env={**os.environ, "NUMBA_NUM_THREADS": "1"},
        )  # fmt: skip
        if child.returncode:
            raise RuntimeError(f"benchmark: growth at {size} failed: {child.stderr.strip()[-500:]}")
        results.append(json.loads(child.stdout))
    progress("growth", len(points), len(points))
    return results


def measure(*, cells: int, steps: int, models: int, repeats: int, seed: int) -> dict[str, Any]:
    """Time of one rollout (s) and of one cell in one evaluation (ns), peak memory of this process (MiB)."""
    scene = make_scene(cells=cells, models=models, steps=steps, seed=seed)
    rollouts = scene.slider.rollout(scene.maps, [scene.push])
    seconds = median_time(lambda: scene.slider.rollout(scene.maps, [scene.push]), repeats)
    n = len(scene.slider.grid)
    return {
        "cells": n,
        "steps": steps,
        "models": models,
        "seconds": seconds / models,
        "ns_per_cell_evaluation": 1e9 * seconds / (n * float(rollouts.evaluations.sum())),
        "peak_mib": _peak_memory() / 2**20,
    }


def _peak_memory() -> int:
    """Largest resident memory of this process so far, bytes."""
    status = Path("/proc/self/status")
    if status.is_file():
        # Unlike getrusage, which starts with the size of the parent process.
        line = next(row for row in status.read_text().splitlines() if row.startswith("VmHWM"))
        return int(line.split()[1]) * 1024
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


if __name__ == "__main__":
    print(json.dumps(measure(**json.loads(sys.argv[1]))))
