"""`slipmap explore-study`: explore objects many times over, and hold every belief against the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.commands.cell_run import Stopped, scenario_of
from slipmap.diagrams.application.outputs import make_folder
from slipmap.diagrams.application.terminal import Progress, note, paragraph, prepare_kernels, table
from slipmap.models.files import BadInput, write_json

if TYPE_CHECKING:
    from slipmap.diagrams.loops.exploration_run import ExplorationRun


@click.command("explore-study")
@options.objects_option("--object", about="Object to explore")
@options.count_option("--runs", most=1000, default=10, about="Runs of each object, with seeds from SEED on.")
@options.explorations_option
@options.count_option("--checks", most=100, default=10, about="Random pushes after these, to judge with.")
@options.results_option("folder", default="explore-study")
@options.seed_option
@options.json_option
def explore_study(
    object_names: tuple[str, ...],
    runs: int,
    pushes: int,
    checks: int,
    folder: Path,
    seed: int,
    json_file: Path | None,
) -> None:
    """Explore objects several times and judge the predictions.

    Tells how well each object's further pushes were predicted. Each run leaves a JSON file in DIR, and its
    pushes as a dataset. What is there already is not run again, so a study that was stopped goes on. A run
    of 15 pushes takes two to three minutes.
    """
    from slipmap.diagrams.loops.exploration_run import ExplorationStopped
    from slipmap.models.objects.benchmark_objects import BENCHMARK_OBJECTS

    names = object_names or tuple(BENCHMARK_OBJECTS)
    make_folder(folder)
    prepare_kernels()
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    for name in names:
        for number in range(seed, seed + runs):
            try:
                rows[name].append(_row(folder, name, number, pushes, checks))
            except (ExplorationStopped, KeyboardInterrupt) as error:
                raise Stopped(
                    f"stopped at {name}, seed {number}, of which nothing is kept. The runs before are in"
                    f" {folder}; called again, the study goes on where it was."
                ) from error
    _show(rows)
    write_json(json_file, rows)


def _row(folder: Path, name: str, seed: int, pushes: int, checks: int) -> dict[str, Any]:
    """Result of one run, from its file or run now.

    Raises:
        ExplorationStopped: Ctrl-C; nothing of this run is kept.
    """
    path = folder / f"{name}-{seed}.json"
    if path.exists():
        return _row_of(path, pushes, checks)
    from slipmap.diagrams.loops.exploration_loop import LoopOptions
    from slipmap.diagrams.loops.exploration_run import ExplorationFailed, ExplorationStopped, explore
    from slipmap.models.measurements import write_dataset

    options_of_run = LoopOptions(pushes=pushes, checks=checks, seed=seed)
    try:
        with Progress() as progress:
            scenario = scenario_of(None, name)
            run = explore(scenario, options_of_run, progress=progress, learn_when_stopped=False)
    except ExplorationStopped:
        raise
    except ExplorationFailed as error:
        row: dict[str, Any] = {"failed": str(error)}
    else:
        write_dataset(run.dataset, folder / f"{name}-{seed}", overwrite=True)
        row = _judged(run)
    row |= {"pushes": pushes, "checks": checks}
    write_json(path, row)
    note(f"{name}, seed {seed}: {row.get('failed') or 'error {:.1f} mm'.format(1e3 * row['error'])}")
    return row


def _row_of(path: Path, pushes: int, checks: int) -> dict[str, Any]:
    """What an earlier study left, if it asked for the same."""
    try:
        row = dict(json.loads(path.read_text(encoding="utf-8")))
        asked = row["pushes"], row["checks"]
    except (ValueError, KeyError, TypeError) as error:
        raise BadInput(f"{path}: is no run of a study; move it away") from error
    if asked != (pushes, checks):
        raise BadInput(
            f"{path}: is a run of {asked[0]} pushes and {asked[1]} checks, this study asks for {pushes} and"
            f" {checks}; name another folder with -o"
        )
    return row


def _judged(run: ExplorationRun) -> dict[str, Any]:
    import numpy as np

    from slipmap.models.inference.summaries import in_region

    found = run.identification
    centers, p = found.belief.centers_of_mass, found.belief.probability
    mean = p @ centers
    off = run.true_center_of_mass - mean
    return {
        "error": float(found.errors("heldout").mean()),
        "uniform": float(found.errors("heldout", "uniform_add").mean()),
        "center_of_mass_off": float(np.hypot(*off)),
        "center_of_mass_inside": in_region(run.true_center_of_mass, centers, p),
        "simulated": run.simulated,
        "seconds": run.seconds,
    }


def _show(rows: dict[str, list[dict[str, Any]]]) -> None:
    cells, inside, done = [], 0, 0
    for name, results in rows.items():
        good = [row for row in results if "failed" not in row]
        done += len(good)
        count = sum(row["center_of_mass_inside"] for row in good)
        failed = len(results) - len(good)
        means = [
            f"{1e3 * sum(row[key] for row in good) / len(good):.{digits}f}" if good else "–"
            for key, digits in (("error", 1), ("uniform", 1), ("center_of_mass_off", 0))
        ]
        cells.append([name, str(len(good)), str(failed), *means, str(count)])
        inside += count
    table(
        "Final error (ADD) on further pushes, mm",
        ["object", "runs", "failed", "belief", "uniform", "centre of mass off", "inside 90 %"],
        cells,
        numbers=(1, 2, 3, 4, 5, 6),
    )
    paragraph(f"The centre of mass lies in the belief's 90 % region in {inside} of {done} runs.")
