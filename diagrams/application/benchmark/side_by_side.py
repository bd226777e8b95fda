"""All engines on the same push: the compiled rollout, plain numpy, MuJoCo and Bullet."""

import time
from typing import Any

import numba
import numpy as np

from slipmap.diagrams.application.benchmark.other_engines import plain_rollout, run_bullet, run_mujoco
from slipmap.diagrams.application.benchmark.scene import (
    STEP,
    Outcome,
    Scene,
    make_scene,
    measure_growth,
    median_time,
)
from slipmap.models.progress import Progress, silent


def run_benchmark(
    *,
    cells: int = 60,
    models: int = 64,
    steps: int = 200,
    repeats: int = 5,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Compare the compiled rollout with plain numpy, MuJoCo and Bullet, and measure how its cost grows.

    Engines whose package is missing are left out with a note.

    Args:
        cells: intended number of cells of the object.
        models: number of maps that one call rolls out.
        steps: of the push, each 5 ms.
        repeats: number of runs; times are their medians.
        seed: of the friction maps.

    Returns:
        A JSON-serialisable dict: `scene`; `engines`, a list with name, seconds per rollout, ratio to the
        first, final_pose (m, m, rad) and remark; `missing`, notes by name; `kernel`, see `_time_rollouts`;
        `numpy_difference`, the largest difference of a pose from plain numpy (m, rad); `growth`, a list of
        results of `scene.measure`.
    """
    report = progress or silent
    scene = make_scene(cells=cells, models=models, steps=steps, seed=seed)
    report("slipmap", 0, 1)
    outcomes, kernel = _time_rollouts(scene, repeats)
    report("plain numpy", 0, 1)
    outcomes["plain numpy"], difference = _plain_numpy(scene, repeats)
    missing = {}
    for name, run in (("MuJoCo", run_mujoco), ("Bullet", run_bullet)):
        report(name, 0, 1)
        try:
            outcomes[name] = run(scene, repeats)
        except ModuleNotFoundError as error:
            missing[name] = f"left out, {error.name} is missing: install with pip install 'slipmap[bench]'"
    growth = measure_growth(cells=cells, steps=steps, repeats=repeats, seed=seed, progress=report)
    first = next(iter(outcomes.values())).seconds
    return {
        "scene": {"cells": len(scene.slider.grid), "models": models, "steps": steps, "step": STEP,
                  "repeats": repeats, "seed": seed},
        "engines": [
            {
                "name": name,
                "seconds": outcome.seconds,
                "ratio": outcome.seconds / first,
                "final_pose": outcome.final_pose.tolist(),
                "remark": outcome.remark,
            }
            for name, outcome in outcomes.items()
        ],
        "missing": missing,
        "kernel": kernel,
        "numpy_difference": difference,
        "growth": growth,
    }  # fmt: skip


def _time_rollouts(scene: Scene, repeats: int) -> tuple[dict[str, Outcome], dict[str, float]]:
    """Time all models of the scene under its push; restores the number of threads at the end.

    Returns:
        The outcomes, and the cost of one rollout: `evaluations_per_step`, sums over all cells in a step;
        `ns_per_cell_evaluation`, time of the whole rollout over cells and evaluations, ns;
        `jacobian_rollouts`, time with the derivatives of all poses over the time without; `columns`,
        parameters of that Jacobian.
    """
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
            parallel, pose, f"{models} models in one call; wall time, valid on idle cores only"
        ),
        "slipmap, single call": Outcome(single, pose, "one model in one call, one core"),
    }
    steps = len(scene.push.tip) - 1
    return outcomes, {
        "evaluations_per_step": evaluations / steps,
        "ns_per_cell_evaluation": 1e9 * together / (cells * evaluations),
        "jacobian_rollouts": jacobian / together,
        "columns": slider.columns,
    }


def _plain_numpy(scene: Scene, repeats: int) -> tuple[Outcome, float]:
    """Outcome of plain numpy, and the largest difference of its poses from ours."""
    poses = plain_rollout(scene.slider, scene.maps, scene.push)
    ours = scene.slider.rollout(scene.maps[:1], [scene.push]).poses[0]
    difference = float(np.abs(poses[1:] - ours).max())
    seconds = median_time(lambda: plain_rollout(scene.slider, scene.maps, scene.push), repeats)
    return Outcome(seconds, poses[-1], "the same convex step, one model"), difference


def format_table(result: dict[str, Any]) -> str:
    """A result of `run_benchmark` as plain text of at most 80 columns."""
    return "\n".join([*_engines(result), "", *_kernel(result), "", *_growth(result)])


def _engines(result: dict[str, Any]) -> list[str]:
    scene = result["scene"]
    lines = [
        "One finger push: {cells} cells, {steps} steps of {ms:g} ms; medians of {repeats}".format(
            ms=1e3 * scene["step"], **scene
        ),
        "",
        f"{'':24}{'ms/rollout':>13}{'ratio':>9}   final x, y (mm), angle (deg)",
    ]
    for engine in result["engines"]:
        x, y, angle = engine["final_pose"]
        lines.append(
            f"{engine['name']:24}{1e3 * engine['seconds']:13.4g}{engine['ratio']:9.3g}"
            f"   {1e3 * x:8.2f}{1e3 * y:8.2f}{np.degrees(angle):9.2f}"
        )
        lines.append(f"  {engine['remark']}")
    lines += [f"{name}: {note}" for name, note in result["missing"].items()]
    lines.append("Times are processor time of one core, unless marked as wall time.")
    return lines


def _kernel(result: dict[str, Any]) -> list[str]:
    kernel = result["kernel"]
    return [
        "Per cell and energy evaluation    {ns_per_cell_evaluation:.3g} ns".format(**kernel),
        "Evaluations per step              {evaluations_per_step:.3g}".format(**kernel),
        "Jacobian, {columns} parameters         {jacobian_rollouts:.3g} rollouts".format(**kernel),
        f"Largest difference from numpy     {result['numpy_difference']:.1e} (m, rad)",
    ]


def _growth(result: dict[str, Any]) -> list[str]:
    lines = [
        "Growth, on one core",
        f"{'cells':>8}{'steps':>8}{'models':>8}{'ms/rollout':>15}{'ns/cell/eval.':>15}{'peak MiB':>10}",
    ]
    for row in result["growth"]:
        lines.append(
            f"{row['cells']:8}{row['steps']:8}{row['models']:8}{1e3 * row['seconds']:15.4g}"
            f"{row['ns_per_cell_evaluation']:15.3g}{row['peak_mib']:10.0f}"
        )
    return lines
