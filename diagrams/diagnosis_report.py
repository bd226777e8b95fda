"""The HTML report of a diagnosis: verdict, ranking, locked pushes, both models beside the measurements."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from diagrams.comparison_words import finding
from diagrams.diagnosis_words import after_label, before_label, improvement, rivals_sentence, sizes
from diagrams.html_report import comparison_sections, diagnosis_sections, page, reading_section
from models.effects.effect import Effect
from models.inference.comparison import Comparison, compare
from models.inference.diagnosis import Diagnosis
from models.inference.diagnosis.fitted_belief import as_diagnosed, fitted_belief
from models.measurements import PushDataset

Progress = Callable[[str, int, int], None]


def diagnosis_report(
    diagnosis: Diagnosis, dataset: PushDataset, effects: Sequence[Effect], progress: Progress | None = None
) -> str:
    """The report, a whole HTML document.

    Args:
        diagnosis: of the dataset.
        dataset: its pushes.
        effects: all that were tried.
        progress: called with (stage, done, total).
    """
    comparisons = compared(diagnosis, dataset, progress)
    report = progress or (lambda stage, done, total: None)
    report("drawing", 0, 1)
    count = len(dataset.trials)
    subtitle = (
        f"{count} measured {'push' if count == 1 else 'pushes'} of {len(dataset.grid)} cells, {len(effects)}"
        f" effects tried in {diagnosis.seconds:.0f} s; seed {diagnosis.seed}"
    )
    lead = [*sizes(diagnosis, dataset.grid), improvement(diagnosis), rivals_sentence(diagnosis)]
    if not diagnosis.effects:
        lead.append(finding(comparisons[0]))
    text = page(
        f"{dataset.name}: what does the model miss?",
        subtitle,
        [paragraph for paragraph in lead if paragraph],
        [
            *diagnosis_sections(diagnosis, dataset, effects),
            *comparison_sections(comparisons, as_diagnosed(dataset, diagnosis)),
            reading_section(),
        ],
        headline=diagnosis.sentence,
    )
    report("drawing", 1, 1)
    return text


def compared(
    diagnosis: Diagnosis, dataset: PushDataset, progress: Progress | None = None
) -> list[Comparison]:
    """The model without effects, and the best one where it differs, against all pushes."""
    pushes = as_diagnosed(dataset, diagnosis)
    models = [(before_label(diagnosis), diagnosis.base)]
    if diagnosis.effect_objects:
        models.append((after_label(diagnosis), diagnosis.best))
    return [
        compare(
            pushes,
            fitted_belief(fitted, dataset, diagnosis.seed),
            seed=diagnosis.seed,
            label=label,
            progress=progress,
        )
        for label, fitted in models
    ]
