"""`slipmap identify`: from recorded pushes to a belief about mass and friction."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from diagrams.commands.options import (
    OutputFile,
    dataset_argument,
    json_option,
    load_dataset,
    object_option,
    seed_option,
)
from diagrams.console import BadInput, Progress, note, prepare_kernels
from diagrams.outputs import make_folder, write_figures, write_json

if TYPE_CHECKING:
    from models.inference.results import Identification
    from models.measurements import PushDataset
    from models.physics.rollout import Maps


@click.command()
@dataset_argument
@click.option(
    "-o",
    "--output",
    type=OutputFile(),
    required=True,
    metavar="FILE",
    help="Where the belief goes, such as belief.npz.",
)
@click.option(
    "--method",
    type=click.Choice(["gauss-newton", "paper"]),
    default="gauss-newton",
    show_default=True,
    help="How maps are found; `paper` is Algorithm 1 of Song and Boularias (2020) as printed.",
)
@click.option(
    "--hypotheses",
    type=click.IntRange(2, 1000),
    default=20,
    show_default=True,
    metavar="K",
    help="Hypotheses to find.",
)
@seed_option
@click.option(
    "--fit-pushes", type=click.IntRange(1), metavar="N", help="Learn from the first N fit pushes alone."
)
@object_option
@click.option(
    "--pictures",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder for the pictures; beside the belief if not given.",
)
@json_option
def identify(
    dataset: Path,
    output: Path,
    method: str,
    hypotheses: int,
    seed: int,
    fit_pushes: int | None,
    object_name: str | None,
    pictures: Path | None,
    json_file: Path | None,
) -> None:
    """Learn maps of mass and friction from recorded pushes.

    DATASET is a folder with a dataset.yaml (push-dataset/1), or files of the MIT push dataset (.json,
    .h5), or CSV files. Pushes with the role `fit` teach; `heldout` pushes only judge.

    Writes the belief, a picture of its maps (belief.maps.png) and one of the pushes as measured and as
    predicted (belief.pushes.png), and prints how well it predicts and what these pushes pin down.
    """
    with Progress() as progress:
        measured = load_dataset(dataset, object_name, progress)
        if fit_pushes is not None:
            measured = _first_pushes(measured, fit_pushes)
        if pictures is not None:
            make_folder(pictures)
        prepare_kernels()
        from models.inference import identification

        result = identification.identify(
            measured, method=method, hypotheses=hypotheses, seed=seed, progress=progress
        )
        result.belief.save(output)
        drawn = draw(result, measured, pictures or output.parent, output.stem, progress)
    if json_file is not None:
        write_json(json_file, result.to_json())
    show(result, measured)
    note(f"belief: {output}")
    for path in drawn:
        note(f"picture: {path}")


def draw(
    result: Identification,
    dataset: PushDataset,
    folder: Path,
    stem: str,
    progress: Progress,
    truth: Maps | None = None,
) -> list[Path]:
    """Write the pictures of an identification and return their paths."""
    from diagrams.figures import maps_figure, push_figures

    progress("drawing", 0, 2)
    paths = write_figures(folder / f"{stem}.maps.png", [maps_figure(result.belief, truth=truth)])
    progress("drawing", 1, 2)
    paths += write_figures(folder / f"{stem}.pushes.png", push_figures(result.pushes, dataset))
    progress("drawing", 2, 2)
    return paths


def show(result: Identification, dataset: PushDataset) -> None:
    """Print what was found."""
    from diagrams.reports import show_errors, show_quantities

    click.echo(
        f"{dataset.name}: {len(dataset.grid)} cells, {len(dataset.fit_trials)} pushes to learn from,"
        f" {len(dataset.heldout_trials)} held out\n"
        f"{len(result.belief)} hypotheses in {result.seconds:.0f} s\n"
    )
    show_errors(result.pushes)
    show_quantities(result.quantities)


def _first_pushes(dataset: PushDataset, count: int) -> PushDataset:
    available = len(dataset.fit_trials)
    if count > available:
        raise BadInput(
            f"--fit-pushes {count}: dataset {dataset.name} has {available} pushes with the role fit; ask for"
            f" 1 to {available}"
        )
    return dataset.with_fit_pushes(count)
