"""The compiled rollout: on one core, on all, one model at a time, and the price of its Jacobian."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numba
import numpy as np

from slipmap.diagrams.application.benchmark.scene import Outcome, Scene, median_time


@dataclass(frozen=True)
class KernelCost:
    """What one rollout consists of.

    Attributes:
        evaluations_per_step: sums over all cells in a step.
        ns_per_cell_evaluation: time of the whole rollout over cells and evaluations, ns.
        jacobian_rollouts: time with the derivatives of all poses over the time without.
        columns: parameters of that Jacobian.
    """

    evaluations_per_step: float
    ns_per_cell_evaluation: float
    jacobian_rollouts: float
    columns: int


def time_rollouts(scene: Scene, repeats: int) -> tuple[dict[str, Outcome], KernelCost]:
    """Time all models of the scene under its push; the number of threads is put back at the end."""
    slider, maps, pushes = scene.slider, scene.maps, [scene.push]
    models, cells = len(maps), len(slider.grid)
    one = maps[:1]
    threads = numba.get_num_threads()
    # The first call compiles.
    rollouts = slider.rollout(maps, pushes)
    slider.rollout(maps, pushes, sensitivities=True)
    slider.rollout(one, pushes)
    pose = rollouts.end[0, 0, :3]
    evaluations = float(rollouts.evaluations.mean())
    try:
        numba.set_num_threads(1)
        together = median_time(lambda: slider.rollout(maps, pushes), repeats) / models
        single = median_time(lambda: slider.rollout(one, pushes), repeats)
        jacobian = median_time(lambda: slider.rollout(maps, pushes, sensitivities=True), repeats) / models
        numba.set_num_threads(threads)
        parallel = median_time(lambda: slider.rollout(maps, pushes), repeats, time.perf_counter) / models
    finally:
        numba.set_num_threads(threads)
    outcomes = {
        "slipmap, one core": Outcome(together, pose, f"{models} models in one call"),
        f"slipmap, {threads} cores": Outcome(
            parallel, pose, f"{models} models in one call; wall time, which needs idle cores"
        ),
        "slipmap, single call": Outcome(single, pose, "one model in one call, one core"),
    }
    steps = len(scene.push.tip) - 1
    cost = KernelCost(
        evaluations / steps, 1e9 * together / (cells * evaluations), jacobian / together, slider.columns
    )
    return outcomes, cost


def poses(scene: Scene) -> np.ndarray:
    """(N, 3) poses of the first model at the ends of the steps."""
    return scene.slider.rollout(scene.maps[:1], [scene.push]).poses[0]
