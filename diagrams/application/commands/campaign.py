"""`slipmap campaign`: the paper's experiments, many trials each, beside the paper's own numbers."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from slipmap.diagrams.application.campaigns.experiments import ABOUT, experiment_of
from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.outputs import lock_folder, make_folder, write_figures
from slipmap.diagrams.application.terminal import Progress, note, paragraph, prepare_kernels, table
from slipmap.models.files import BadInput, together, write_json

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slipmap.diagrams.application.campaigns.experiments import Summary
    from slipmap.planners.trials import Backend, TrialOutcome, TrialSpec

_SHOWN_FAILURES = 5


@click.command(epilog="Experiments: " + "; ".join(f"{name}, {about}" for name, about in ABOUT.items()) + ".")
@click.argument("experiment", type=click.Choice(list(ABOUT)), metavar="EXPERIMENT")
@options.objects_option("--objects", about="Object", default="all six; fig7: hammer")
@click.option(
    "--methods", "methods", multiple=True, metavar="NAME",
    help="Method of fig6 and fig7, or what is hidden in adapt; may be given several times. [default: all]",
)  # fmt: skip
@options.count_option(
    "--trials", most=100_000,
    about="Trials of each object, with seeds from SEED on. [default: as the experiment needs]",
)  # fmt: skip
@click.option(
    "--truth", type=click.Choice(["plant", "bullet"]), default="plant", show_default=True,
    help="What plays the real world: Drake's MultibodyPlant, or Bullet (extra `bench`).",
)  # fmt: skip
@click.option(
    "--backend", type=click.Choice(["processes", "dask"]), default="processes", show_default=True,
    help="Where trials run: on this machine, or on a Dask cluster (extra `cluster`).",
)  # fmt: skip
@click.option("--scheduler", metavar="ADDRESS", help="Dask's scheduler, such as tcp://10.0.0.1:8786.")
@options.count_option("--workers", most=1024, about="Processes on this machine. [default: one a core]")
@options.results_option("folder", default="campaign")
@options.seed_option
@options.json_option
def campaign(
    experiment: str,
    object_names: tuple[str, ...],
    methods: tuple[str, ...],
    trials: int | None,
    truth: str,
    backend: Backend,
    scheduler: str | None,
    workers: int | None,
    folder: Path,
    seed: int,
    json_file: Path | None,
) -> None:
    """Repeat an experiment of the paper, or one beyond it.

    Shows the numbers beside the paper's. Each trial leaves a file in DIR/EXPERIMENT-TRUTH. What is there
    already is not run again, so a campaign that was stopped goes on; what failed is tried again. The same
    seeds give the same table, whatever runs the trials.
    """
    from joblib import cpu_count

    from slipmap.planners.trials import CampaignError, run_trials

    chosen = experiment_of(experiment)
    names = _checked(object_names or chosen.objects)
    files = folder / f"{experiment}-{truth}"
    make_folder(files)
    lock_folder(files)
    prepare_kernels()
    try:
        specs = _by_methods(chosen.specs(names, trials or chosen.trials, seed, truth), methods)
        if truth == "bullet" and find_spec("pybullet") is None:
            raise BadInput("Bullet is not installed; `pip install 'slipmap[bench]'` brings it")
        with Progress() as progress:
            outcomes = run_trials(
                specs,
                files,
                backend=backend,
                workers=workers or cpu_count(),
                scheduler=scheduler,
                progress=lambda done, total: progress(f"{experiment}, trials", done, total),
            )
    except CampaignError as error:
        raise BadInput(str(error)) from error
    summary = chosen.summary(outcomes)
    picture = folder / f"{experiment}-{truth}.png"
    document = summary.document | {
        "experiment": experiment,
        "truth": truth,
        "seed": seed,
        "objects": list(names),
        "trials": len(outcomes),
        "failed": {o.spec.name: o.failure for o in outcomes if o.failure is not None},
    }
    with together():
        write_figures(picture, summary.figures())
        write_json(folder / f"{experiment}-{truth}.json", document)
        write_json(json_file, document)
    _show(summary, outcomes)
    note(f"trials are in {files}, the picture is {picture}")


def _checked(object_names: Sequence[str]) -> tuple[str, ...]:
    from slipmap.models.objects.benchmark_objects import BENCHMARK_OBJECTS, benchmark_object

    for name in object_names:
        try:
            benchmark_object(name)
        except ValueError as error:
            raise BadInput(str(error)) from error
    return tuple(dict.fromkeys(object_names)) or tuple(BENCHMARK_OBJECTS)


def _by_methods(specs: list[TrialSpec], methods: Sequence[str]) -> list[TrialSpec]:
    """The trials of some methods, all where none is named."""
    if not methods:
        return specs
    key = "hidden" if "hidden" in specs[0].parameters else "method"
    known = list(dict.fromkeys(spec.parameters[key] for spec in specs if key in spec.parameters))
    if not known:
        raise BadInput(
            "--methods chooses among the methods of fig6 and fig7, and what is hidden in adapt; this"
            " experiment has none"
        )
    for method in methods:
        if method not in known:
            raise BadInput(f"method {method!r} is unknown; choose among {', '.join(known)}")
    return [spec for spec in specs if spec.parameters[key] in methods]


def _show(summary: Summary, outcomes: Sequence[TrialOutcome]) -> None:
    for shown in summary.tables:
        words = shown.columns.index("") if "" in shown.columns[1:] else 0
        table(shown.title, shown.columns, shown.rows, numbers=range(words + 1, len(shown.columns)))
    paragraph("Intervals hold 95 %. " + summary.remark)
    failed = [outcome for outcome in outcomes if outcome.failure is not None]
    if failed:
        note(f"{len(failed)} of {len(outcomes)} trials failed; the table leaves them out:")
        for outcome in failed[:_SHOWN_FAILURES]:
            note(f"  {outcome.spec.name}: {outcome.failure}")
        if len(failed) > _SHOWN_FAILURES:
            note("  …")
