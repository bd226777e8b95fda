"""`slipmap diagnose`: which physical effect do the pushes show that the model does not have?"""

from pathlib import Path

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.terminal import Progress, note, prepare_kernels
from slipmap.models.files import write_json, write_text


@click.command()
@options.dataset_argument
@options.effect_file_option
@click.option(
    "--quick", is_flag=True,
    help="A look at ten pushes with larger steps; no p-values, and no report unless -o asks for one.",
)  # fmt: skip
@options.count_option(
    "--draws", least=99, most=100_000, default=199,
    about="Datasets to simulate for the p-values; the smallest p is 1 / (N + 1).",
)  # fmt: skip
@options.seed_option
@options.report_option("diagnosis.html")
@options.object_option
@options.json_option
def diagnose(
    dataset: Path,
    effect_files: tuple[Path, ...],
    quick: bool,
    draws: int,
    seed: int,
    output: Path,
    object_name: str | None,
    json_file: Path | None,
) -> None:
    """Find out which physical effect the model misses.

    Fits the model without effects to pushes of DATASET, asks every effect of the library, and every one of
    your own files, what it would explain, and asks those that explain most what they leave. The verdict is
    one effect, a set that the data cannot tell apart, none, something unknown, or too little data. A share
    of the pushes is locked away before and judges the answer.
    """
    effects = options.find_effects(effect_files)
    with Progress() as progress:
        measured = options.load_dataset(dataset, object_name, progress)
        prepare_kernels()
        from slipmap.planners import telling_push

        result = telling_push.diagnose(
            measured, effects=effects, draws=draws, quick=quick, seed=seed, progress=progress
        )
        wanted = not quick or options.asked_for("output")
        if wanted:
            from slipmap.diagrams.application.reports.diagnosis_sections import diagnosis_report

            write_text(output, diagnosis_report(result, measured, effects, progress))
    write_json(json_file, result.to_json())
    from slipmap.diagrams.application.reports.diagnosis_words import show_diagnosis

    show_diagnosis(result, measured, effects)
    note(f"report: {output}" if wanted else "no report of a quick look; -o FILE asks for one")
