"""What it costs to take every square for an equal part of an even object: the table of docs/lab/outline.md.

    python -m tests.models.inference.outline_study [--objects N] [--page PAGE.md]

Benchmark objects with maps of their own are pushed; their outlines are seen with an error, and cut into
squares anew, as the station does. `identify` learns from five pushes twice: once with `CellGrid.area_ratios`,
once as if these were all one.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np

import slipmap
from slipmap.models.objects.benchmark_objects import BENCHMARK_OBJECTS
from slipmap.models.physics.cell_grid import CellGrid

PUSHES, HELDOUT, SEEN = 5, 5, 0.001
COMMAND = "python -m tests.models.inference.outline_study"
QUANTITIES = (
    "even object's centre off, mm",
    "centre of mass off, mm",
    "total friction off, %",
    "held-out error, mm",
)


def seen(grid: CellGrid, rng: np.random.Generator) -> CellGrid:
    """The outline as a camera makes it out, cut into as many squares."""
    ring = np.asarray(grid.polygon.segmentize(0.02).exterior.coords)[:-1]
    outline = ring + SEEN * rng.standard_normal(ring.shape)
    return slipmap.cells_from_polygon(outline, count=len(grid))


def errors(name: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Quantities with equal squares, and with the areas that they stand for."""
    rng = np.random.default_rng([seed, sum(map(ord, name))])
    thing = slipmap.benchmark_object(name)
    slider, truth = slipmap.Slider(thing.grid, finger_radius=0.008), thing.maps
    pushes = [
        candidate.push([0.0, 0.0, 0.0])
        for candidate in slipmap.candidate_pushes(
            thing.grid, 0.008, rng, PUSHES + HELDOUT, length=(0.06, 0.1)
        )
    ]
    dataset = slipmap.record_pushes(slider, truth, pushes, rng, heldout=HELDOUT)
    dataset = replace(dataset, grid=seen(thing.grid, rng))
    centroid = np.array(dataset.grid.polygon.centroid.coords[0])
    friction = float((truth.mass * truth.mu).sum() * slider.gravity)

    def found() -> np.ndarray:
        areas = dataset.grid.area_ratios
        result = slipmap.identify(dataset, seed=seed, friction_laws=False)
        belief = result.belief
        center = belief.probability @ belief.centers_of_mass
        total = float(belief.probability @ belief.friction_forces)
        return np.array(
            [
                1e3 * np.hypot(*(areas @ dataset.grid.centers / areas.sum() - centroid)),
                1e3 * np.hypot(*(center - thing.center_of_mass[:2])),
                100.0 * abs(total / friction - 1.0),
                1e3 * float(result.errors("heldout").mean()),
            ]
        )

    with mock.patch.object(CellGrid, "area_ratios", property(lambda grid: np.ones(len(grid)))):
        even = found()
    return even, found()


def main() -> None:
    """Run the study, and write its page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", type=int, default=12, help="so many, the benchmarks in turn")
    parser.add_argument("--page", type=Path, help="where the page goes")
    arguments = parser.parse_args()
    names = [BENCHMARK_OBJECTS[k % len(BENCHMARK_OBJECTS)] for k in range(arguments.objects)]
    pairs = []
    for seed, name in enumerate(names):
        pairs.append(errors(name, seed))
        print(f"{seed} {name}: {np.round(pairs[-1], 2).tolist()}", flush=True)
    both = np.array(pairs)
    lines = [
        "# What squares cost that do not fit the outline",
        "",
        f"Made by `{COMMAND} --objects {len(names)} --page PAGE.md`:",
        f"benchmark objects in turn, seeds from 0, {PUSHES} pushes to learn from, outlines seen with an",
        f"error of {1e3 * SEEN:g} mm and cut anew. Medians over the objects.",
        "",
        "| quantity | every square alike | areas of the outline | smaller with areas |",
        "| --- | --- | --- | --- |",
    ]
    for column, quantity in enumerate(QUANTITIES):
        even, area = both[:, 0, column], both[:, 1, column]
        smaller = f"{(area < even).sum()} of {len(names)}"
        lines.append(f"| {quantity} | {np.median(even):.1f} | {np.median(area):.1f} | {smaller} |")
    text = "\n".join([*lines, ""])
    print(text)
    if arguments.page is not None:
        arguments.page.write_text(text)


if __name__ == "__main__":
    main()
