"""`slipmap compare`: how far a model is from measured pushes, and where it fails."""

from __future__ import annotations

import textwrap
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
from diagrams.console import WIDTH, BadInput, Progress, note, prepare_kernels
from diagrams.outputs import whole_file, write_json

if TYPE_CHECKING:
    from models.inference.belief import Belief
    from models.inference.comparison import Comparison
    from models.measurements import PushDataset


@click.command()
@dataset_argument
@click.option(
    "--belief", "belief_file", type=click.Path(path_type=Path), metavar="FILE",
    help="Belief that `slipmap identify` wrote; without it the fit pushes are learnt from first.",
)  # fmt: skip
@click.option(
    "-o", "--output", type=OutputFile("html", "htm"), default="comparison.html", show_default=True,
    metavar="FILE", help="The report, one file for any browser; it needs no network.",
)  # fmt: skip
@seed_option
@object_option
@json_option
def compare(
    dataset: Path,
    belief_file: Path | None,
    output: Path,
    seed: int,
    object_name: str | None,
    json_file: Path | None,
) -> None:
    """Compare a model with measured pushes, and see where it fails.

    Every push of DATASET is predicted from its first pose. The report says how far off the model is beside
    two simple ones and the noise, shows every push as measured and as predicted, and tests what the rest
    hangs together with: place, direction, speed, phase, time and order.
    """
    from models.inference.belief import Belief

    belief = Belief.load(belief_file) if belief_file is not None else None
    with Progress() as progress:
        measured = load_dataset(dataset, object_name, progress)
        prepare_kernels()
        if belief is None:
            belief = _learnt(measured, seed, progress)
        from models.inference import comparison

        result = comparison.compare(measured, belief, seed=seed, progress=progress)
        progress("drawing", 0, 1)
        text = report([result], measured)
        with whole_file(output) as part:
            part.write_text(text, encoding="utf-8")
        progress("drawing", 1, 1)
    if json_file is not None:
        write_json(json_file, result.to_json())
    show(result)
    note(f"report: {output}")


def report(comparisons: list[Comparison], dataset: PushDataset) -> str:
    """The HTML of one model, or of two over the same pushes."""
    from diagrams.comparison_words import finding, summary, summary_of_two
    from diagrams.html_report import check_same_pushes, comparison_sections, page

    first = comparisons[0]
    learnt = "" if first.learnt_from == first.dataset else f", model learnt from {first.learnt_from}"
    subtitle = f"{len(first.pushes)} measured pushes of {len(dataset.grid)} cells{learnt}; seed {first.seed}"
    check_same_pushes(comparisons)
    lead = [summary(first), finding(first)]
    if len(comparisons) > 1:
        lead = [summary_of_two(*comparisons), *(f"{c.label}: {finding(c)}" for c in comparisons)]
    return page(
        f"{dataset.name}: model against measurement",
        subtitle,
        lead,
        comparison_sections(comparisons, dataset),
    )


def show(result: Comparison) -> None:
    """Print what was found."""
    from diagrams.comparison_words import finding, summary
    from diagrams.reports import show_comparison

    click.echo(f"{result.dataset}, {len(result.pushes)} pushes; model learnt from {result.learnt_from}\n")
    show_comparison(result)
    for text in (summary(result), finding(result)):
        click.echo(textwrap.fill(text, WIDTH))


def _learnt(dataset: PushDataset, seed: int, progress: Progress) -> Belief:
    from models.inference import identification

    if not dataset.fit_trials:
        raise BadInput(
            f"dataset {dataset.name} has no push with the role fit to learn from; name a belief with"
            " --belief, or give at least one push that role"
        )
    return identification.identify(dataset, seed=seed, progress=progress).belief
