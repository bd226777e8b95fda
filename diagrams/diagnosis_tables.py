"""A diagnosis on the terminal: verdict, ranking, size, locked pushes, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence

import click

from diagrams.console import paragraph, table
from diagrams.diagnosis_words import (
    QUICK,
    after_label,
    evidence,
    improvement,
    locked_rows,
    nats,
    p_shown,
    rivals_sentence,
    sizes,
    standing,
    tried,
)
from diagrams.effect_words import parameter_rows
from models.effects.effect import Effect
from models.inference.diagnosis import Diagnosis
from models.measurements import PushDataset


def show_diagnosis(diagnosis: Diagnosis, dataset: PushDataset, effects: Sequence[Effect]) -> None:
    """Print what a diagnosis found.

    Args:
        diagnosis: of the dataset.
        dataset: its pushes.
        effects: all that were tried.
    """
    paragraph(f"Verdict: {diagnosis.verdict}. {diagnosis.sentence}")
    for text in (*sizes(diagnosis, dataset.grid), improvement(diagnosis), rivals_sentence(diagnosis)):
        paragraph(text)
    paragraph(QUICK if diagnosis.quick else "")
    click.echo()
    table(
        f"Effects that were tried. {evidence(diagnosis)}",
        ["effect", "gain", "p", "refitted", "standing"],
        [
            [
                candidate.name,
                nats(candidate.gain),
                p_shown(candidate.p_value),
                "–" if candidate.fitted_gain is None else nats(candidate.fitted_gain),
                standing(candidate, diagnosis),
            ]
            for candidate in diagnosis.candidates
        ],
        numbers=(1, 2, 3),
    )
    rows = parameter_rows(tried(diagnosis, effects), diagnosis.parameters)
    if rows:
        table(
            f"Parameters of {', '.join(diagnosis.effects)}",
            ["parameter", "value", "90 % interval", "meaning"],
            rows,
            numbers=(1, 2),
        )
    _show_locked(diagnosis)
    if diagnosis.next_push is not None:
        paragraph(f"Next push: {diagnosis.next_push['sentence']}")


def _show_locked(diagnosis: Diagnosis) -> None:
    rows = locked_rows(diagnosis)
    if not rows:
        paragraph("No push was locked away, so there are no errors to judge by: record three pushes or more.")
        return
    count = len(diagnosis.locked)
    title = f"Error on the {count} locked {'push' if count == 1 else 'pushes'}"
    if diagnosis.effect_objects:
        columns = ["", "without effects", after_label(diagnosis)]
        table(title, columns, rows, numbers=(1, 2))
    else:
        table(title, ["", "the model"], [row[:2] for row in rows], numbers=(1,))
