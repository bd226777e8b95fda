"""What a diagnosis of several datasets found, on the terminal."""

from collections.abc import Sequence

import click

from slipmap.diagrams.application.reports.comparison_words import millimetres
from slipmap.diagrams.application.reports.diagnosis_words import nats
from slipmap.diagrams.application.reports.effect_words import effect_in_words
from slipmap.diagrams.application.terminal import paragraph, table
from slipmap.models.inference.diagnosis.results import ParameterEstimate
from slipmap.models.inference.diagnosis.several import DatasetResult, JointDiagnosis
from slipmap.models.physics.cell_grid import CellGrid


def show_together(diagnosis: JointDiagnosis, grid: CellGrid) -> None:
    """Print it; `grid` is that of one object, for what its size decides."""
    paragraph(f"Verdict: {diagnosis.verdict}. {diagnosis.sentence}")
    for name in diagnosis.effects:
        estimates = [p for p in diagnosis.parameters if p.effect == name]
        if estimates:
            paragraph(f"{name}: {effect_in_words(name, estimates, grid)}.")
    paragraph(where_it_falls(diagnosis))
    paragraph(f"Next: {diagnosis.next_step()}")
    click.echo()
    table(
        "Effects that were tried, in nats",
        ["effect", "gain", "refitted", "evidence", "standing"],
        [
            [
                c.name,
                nats(c.first_gain),
                nats(c.gain),
                nats(c.evidence),
                "not ruled out" if c.in_set else "ruled out",
            ]
            for c in diagnosis.candidates
        ],
        numbers=(1, 2, 3),
    )
    table(
        "Locked pushes of each dataset: error at the end (ADD), mm, and fall of their cost, nats",
        ["dataset", "open", "locked", "without", "with", "fall", "alone it says"],
        [_row(one) for one in diagnosis.datasets],
        numbers=(1, 2, 3, 4, 5),
    )


def where_it_falls(diagnosis: JointDiagnosis) -> str:
    """On which datasets the locked pushes are better predicted with the answer; empty without one."""
    falls = {one.name: one.fall for one in diagnosis.datasets if one.fall is not None}
    if not falls:
        return ""
    against = [name for name, fall in falls.items() if fall <= 0.0]
    which = "every dataset are better predicted"
    if against:
        better = len(falls) - len(against)
        which = f"{better} of {len(falls)} datasets are better predicted, not those of {', '.join(against)}"
    return (
        f"With {diagnosis.effects[0]} the locked pushes of {which}. Their cost falls by"
        f" {nats(diagnosis.fall)} nats in all."
    )


def _row(one: DatasetResult) -> list[str]:
    errors = [millimetres(float(e.final.mean())) if e is not None else "–" for e in (one.before, one.after)]
    name = f"{one.name} (whole)" if one.whole else one.name
    return [name, str(len(one.open_trials)), str(len(one.locked)), *errors, nats(one.fall), _said(one.alone)]


def _said(estimates: Sequence[ParameterEstimate]) -> str:
    return ", ".join(f"{e.name} {e.value:.2g} ({e.low:.2g} to {e.high:.2g})" for e in estimates)
