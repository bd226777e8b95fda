"""Growth of time and memory with cells, steps and models; each point in its own process, on one core."""

import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from slipmap.diagrams.application.benchmark.scene import make_scene, median_time
from slipmap.models.progress import Progress

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
            [sys.executable, "-m", "slipmap.diagrams.application.benchmark.growth", arguments],
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
