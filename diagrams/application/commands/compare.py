"""`slipmap predict`, `compare` and `diagnose`: how far a model is from measured pushes, where it fails, and
which physical effect it misses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.outputs import write_figures
from slipmap.diagrams.application.terminal import (
    Progress,
    counted,
    note,
    paragraph,
    prepare_kernels,
    printable,
)
from slipmap.models.files import BadInput, all_or_nothing, write_json, write_text

if TYPE_CHECKING:
    from slipmap.models.effects.effect import Effect
    from slipmap.models.inference.belief import Belief
    from slipmap.models.inference.comparison import Comparison
    from slipmap.models.inference.prediction import Prediction
    from slipmap.models.measurements import PushDataset


@click.command()
@options.dataset_argument
@options.belief_option(required=True)
@options.picture_option(
    "-o", "--output", default="predictions.png",
    about="Picture of the pushes (.png, .pdf or .svg), 24 pushes a page; further pages are"
    " predictions.2.png and so on.",
)  # fmt: skip
@options.effect_file_option
@options.object_option
@options.json_option
def predict(
    dataset: Path,
    belief_file: Path,
    output: Path,
    effect_files: tuple[Path, ...],
    object_name: str | None,
    json_file: Path | None,
) -> None:
    """Predict recorded pushes with a belief, and compare.

    Simulates every push of DATASET from its first pose with every hypothesis of the belief. The picture
    overlays measured and predicted trajectories; the table lists the errors at the ends. DATASET must have
    the object and the finger of the belief, but may differ from the dataset that it was learned from.
    """
    from slipmap.models.inference.belief import Belief

    belief = Belief.load(belief_file, options.find_effects(effect_files))
    with Progress() as progress:
        measured = options.load_dataset(dataset, object_name, progress)
        prepare_kernels()
        from slipmap.models.inference import prediction

        pushes = prediction.predict(belief, measured, progress)
        from slipmap.diagrams.application.figures import push_figures

        with all_or_nothing():
            with progress.step("drawing"):
                drawn = write_figures(output, push_figures(pushes, measured))
            write_json(json_file, _prediction_document(belief, measured.name, pushes))
    from slipmap.diagrams.application.reports.comparison_words import advice, unexplained
    from slipmap.diagrams.application.reports.tables import show_errors
    from slipmap.models.inference.hypotheses import unexplained_share

    count = counted(len(pushes))
    click.echo(printable(f"dataset {measured.name}: {count}; belief learned from dataset {belief.dataset}\n"))
    show_errors(pushes, measured, options.datasets_typed(), belief.effects)
    far_off = unexplained(unexplained_share(belief.settings)) if belief.dataset == measured.name else ""
    if far_off:
        paragraph(f"{far_off} {advice(options.datasets_typed())}")
    for path in drawn:
        note(f"picture: {path}")


class _Report(NamedTuple):
    """Options of `compare` and `diagnose`: what the datasets are, and where to write the results."""

    apart: tuple[str, ...]
    output: Path
    seed: int
    object_name: str | None
    maps: Path | None
    json_file: Path | None


@click.command()
@options.datasets_argument
@options.belief_option(required=False, more="; without it, a model is learned from the fit pushes first")
@options.effect_option(required=False, purpose="Effect to add, for a comparison with the model without it")
@options.effect_file_option
@options.apart_option
@options.report_option("comparison.html")
@options.seed_option
@options.object_option
@options.maps_option
@options.json_option
@options.bundled("wanted", _Report)
def compare(
    datasets: tuple[Path, ...],
    belief_file: Path | None,
    effect_names: tuple[str, ...],
    effect_files: tuple[Path, ...],
    wanted: _Report,
) -> None:
    """Compare a model with pushes, and see where it fails.

    Predicts every push of DATASET from its first pose. The report compares the model's error with two simple
    baselines and with the noise, shows every push as measured and as predicted, and tests what the remaining
    error depends on: place, direction, speed, phase, time and order. With --effect, two models are learned
    from the fit pushes, without and with the effects, and shown side by side.

    Several datasets, each of one object, are compared one by one, and the report says what the remaining
    error depends on in more than one of them. With --effect, their models share the effects as in
    `slipmap fit`.
    """
    from slipmap.models.effects.registry import effects_named
    from slipmap.models.inference.belief import Belief

    if belief_file is not None and effect_names:
        raise BadInput(
            "--belief and --effect exclude each other: a belief has its own effects (`slipmap fit` adds"
            " them), and --effect learns two new models"
        )
    known = options.find_effects(effect_files)
    effects = effects_named(effect_names, known)
    if len(datasets) > 1:
        if wanted.apart and not effects:
            raise BadInput("--apart says which effects several datasets do not share; add --effect")
        _compare_together(datasets, effects, wanted)
        return
    options.refuse_apart(wanted.apart)
    (dataset,) = datasets
    belief = Belief.load(belief_file, known) if belief_file is not None else None
    seed = wanted.seed
    with Progress() as progress:
        measured = options.load_dataset(dataset, wanted.object_name, progress, wanted.maps)
        prepare_kernels()
        from slipmap.models.inference import comparison

        if belief is None:
            _check_fit_pushes(measured)
        results = (
            [*comparison.compare_with_effects(measured, effects, seed=seed, progress=progress)]
            if effects
            else [comparison.compare(measured, belief, seed=seed, progress=progress)]
        )
        from slipmap.diagrams.application.reports.comparison_report import comparison_report

        with progress.step("drawing"):
            text = comparison_report(results, measured, options.datasets_typed())
    before, *after = (result.to_json() for result in results)
    both = {"before": before, "after": after[0], "effects": list(effect_names)} if after else before
    with all_or_nothing():
        write_text(wanted.output, text)
        write_json(wanted.json_file, both)
    show(results, options.datasets_typed())
    note(f"report: {wanted.output}")


def _compare_together(datasets: Sequence[Path], effects: Sequence[Effect], wanted: _Report) -> None:
    with Progress() as progress:
        measured = options.load_together(datasets, wanted.object_name, progress, one_only=["--belief"])
        for dataset in measured:
            _check_fit_pushes(dataset)
        prepare_kernels()
        from slipmap.models.inference.comparison import compare_together

        result = compare_together(measured, effects, apart=wanted.apart, seed=wanted.seed, progress=progress)
        from slipmap.diagrams.application.reports.comparison_report import joint_comparison_report

        with progress.step("drawing"):
            text = joint_comparison_report(result, measured)
    with all_or_nothing():
        write_text(wanted.output, text)
        write_json(wanted.json_file, result.to_json())
    from slipmap.diagrams.application.reports.comparison_words import joint_findings
    from slipmap.diagrams.application.reports.diagnosis_words import joint_fit_findings
    from slipmap.diagrams.application.reports.tables import show_joint_comparison

    told = [] if result.fitted is None else joint_fit_findings(result.fitted, measured)
    show_joint_comparison(result)
    for text in (*told, *joint_findings(result)):
        paragraph(text)
    note(f"report: {wanted.output}")


def _prediction_document(belief: Belief, dataset: str, pushes: Sequence[Prediction]) -> dict[str, Any]:
    trials = [{**push.to_json(), "predicted_end_hypotheses": push.hypotheses[:, -1]} for push in pushes]
    means = {}
    for role in ("fit", "heldout"):
        errors = [push.final_add for push in pushes if push.role == role]
        means[f"{role}_error_mean"] = sum(errors) / len(errors) if errors else None
    return {
        "dataset": dataset,
        "belief_dataset": belief.dataset,
        "probability": belief.probability,
        "trials": trials,
        **means,
    }


def show(results: Sequence[Comparison], where: str = "DATASET") -> None:
    """Print the comparison of one model, or of two over the same pushes; `where` is the dataset's path."""
    from slipmap.diagrams.application.reports.comparison_words import doubts, findings, warning
    from slipmap.diagrams.application.reports.tables import show_comparison

    first = results[0]
    count = counted(len(first.pushes))
    click.echo(
        printable(f"dataset {first.dataset}: {count}; model learned from dataset {first.learnt_from}\n")
    )
    show_comparison(results)
    for text in findings(results):
        paragraph(text)
    for text in (warning(results[-1], where), *doubts(results[-1])):
        paragraph(text)


def _check_fit_pushes(dataset: PushDataset) -> None:
    if not dataset.fit_trials:
        raise BadInput(
            f"dataset {dataset.name} has no push with the role fit to learn from; name a belief with"
            " --belief, or give at least one push that role"
        )


@click.command()
@options.datasets_argument
@options.effect_file_option
@click.option(
    "--quick", is_flag=True,
    help="Look at ten pushes at most, with larger steps; no p-values, and no report unless -o asks for one.",
)  # fmt: skip
@options.count_option(
    "--draws", least=99, most=100_000, default=199,
    about="Datasets to simulate (of several datasets, random signs of whole pushes) for the p-values; the"
    " smallest possible p is 1 / (N + 1).",
)  # fmt: skip
@options.apart_option
@options.seed_option
@options.report_option("diagnosis.html")
@options.object_option
@options.maps_option
@options.json_option
@options.bundled("wanted", _Report)
def diagnose(
    datasets: tuple[Path, ...], effect_files: tuple[Path, ...], quick: bool, draws: int, wanted: _Report
) -> None:
    """Find out which physical effect the model misses.

    Fits the model without effects to pushes of DATASET, computes how much every effect of the library and of
    your own files would explain, and refits with those that explain most to see what is left. The verdict is
    one effect, a set that the data cannot tell apart, no missing effect, something unknown, or too little
    data. Some pushes are locked away beforehand and test the answer.

    Several datasets, each of one object, are searched for one effect that all of them miss: each object has
    its own maps, while effects of table, tracker, finger and force sensor are shared unless --apart says
    otherwise.
    """
    effects = options.find_effects(effect_files)
    if len(datasets) > 1:
        _diagnose_together(datasets, effects, draws, wanted)
        return
    options.refuse_apart(wanted.apart)
    (dataset,) = datasets
    where = options.datasets_typed()
    with Progress() as progress:
        measured = options.load_dataset(dataset, wanted.object_name, progress, wanted.maps)
        prepare_kernels()
        from slipmap.planners import telling_push

        result = telling_push.diagnose(
            measured, effects=effects, draws=draws, quick=quick, seed=wanted.seed, progress=progress
        )
        reported = not quick or options.asked_for("--output")
        with all_or_nothing():
            if reported:
                from slipmap.diagrams.application.reports.diagnosis_report import diagnosis_report

                told = diagnosis_report(result, measured, effects, where, progress)
                write_text(wanted.output, told)
            write_json(wanted.json_file, result.to_json(where))
    from slipmap.diagrams.application.reports.diagnosis_words import show_diagnosis

    show_diagnosis(result, measured, effects, where)
    note(
        f"report: {wanted.output}" if reported else "a quick look writes no report; ask for one with -o FILE"
    )


def _diagnose_together(
    datasets: Sequence[Path], effects: Sequence[Effect], draws: int, wanted: _Report
) -> None:
    where = options.datasets_typed()
    with Progress() as progress:
        measured = options.load_together(datasets, wanted.object_name, progress, one_only=["--quick"])
        prepare_kernels()
        from slipmap.models.inference.diagnosis.several import diagnose_together

        result = diagnose_together(
            measured, effects=effects, apart=wanted.apart, draws=draws, seed=wanted.seed, progress=progress
        )
        from slipmap.diagrams.application.reports.diagnosis_report import joint_report

        with all_or_nothing():
            with progress.step("drawing"):
                write_text(wanted.output, joint_report(result, measured, effects, where))
            write_json(wanted.json_file, result.to_json(where))
    from slipmap.diagrams.application.reports.diagnosis_words import show_together

    show_together(result, measured, effects, where)
    note(f"report: {wanted.output}")
