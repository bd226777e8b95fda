"""What a report says of one model, or of two over the same pushes: errors, pushes, patterns, correlations."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
from matplotlib.figure import Figure

from slipmap.diagrams.application.figures import correlation_figure, error_figure, residual_figures
from slipmap.diagrams.application.figures.residual_figures import pattern_of
from slipmap.diagrams.application.reports.comparison_words import (
    QUANTITIES,
    finding,
    millimetres,
    p_text,
    role_name,
    size_text,
)
from slipmap.diagrams.application.reports.html_page import Section, part, picture, push_section, table
from slipmap.models.inference.comparison import Comparison
from slipmap.models.inference.push_errors import Errors
from slipmap.models.measurements import PushDataset

ERROR_COLUMNS = (
    "end (ADD), mm",
    "on average (ADD), mm",
    "position, mm",
    "angle, °",
    "fit, %",
    "force, N",
    "force, %",
)

FIELDS = {"table_place": ("table_drift", "table_place"), "contact_place": ("object_drift", "contact_place")}
"""Pictures of fields, and the factors that they show."""

MOSTLY_UNSEEN = (
    "The model did not learn from most of these pushes. Errors of its maps are common to them and can show as"
    " patterns too; learn from these pushes to tell them from missing physics."
)


def comparison_sections(comparisons: Sequence[Comparison], dataset: PushDataset) -> list[Section]:
    """All sections, in the order of reading.

    Args:
        comparisons: one model, or two over the same pushes, the first being the one before.
        dataset: its pushes.

    Raises:
        ValueError: none or more than two models, or models over different pushes.
    """
    check_same_pushes(comparisons)
    sections = [error_section(comparisons), push_section(comparisons, dataset)]
    sections.append(structure_section(comparisons, dataset))
    if comparisons[0].correlations is not None:
        sections.append(correlation_section(comparisons))
    sections.append(Section("method", "How to read the numbers", part("method.html")))
    return sections


def check_same_pushes(comparisons: Sequence[Comparison]) -> None:
    """Raise ValueError unless there are one or two models over the same pushes."""
    if not 1 <= len(comparisons) <= 2:
        raise ValueError(f"a report shows one model or two, got {len(comparisons)}")
    pushes = [[push.trial for push in comparison.pushes] for comparison in comparisons]
    if any(names != pushes[0] for names in pushes):
        raise ValueError("a report of two models needs both over the same pushes")


def error_section(comparisons: Sequence[Comparison]) -> Section:
    """How far off: means by role beside the baselines, and every push."""
    rows, marked = [], []
    first = comparisons[0]
    for role, totals in first.totals.items():
        name = role_name(role, totals)
        for comparison in comparisons:
            rows.append([name, comparison.label, *_cells(comparison.totals[role].model)])
            marked.append(False)
        rows.append([name, "uniform object", *_cells(totals.uniform)])
        rows.append([name, "object does not move", *_cells(totals.resting)])
    numbers = table(
        ["pushes", "prediction", *ERROR_COLUMNS],
        rows,
        numbers=range(2, 2 + len(ERROR_COLUMNS)),
        caption="Means over pushes. Position, angle: of the object frame at the end. Force: root mean square"
        " while the finger presses steadily.",
    )
    body = (
        picture(error_figure(comparisons), "Error of every push at its end", wide=True)
        + numbers
        + _floor(first)
    )
    return Section("errors", "How far off", body)


def _floor(comparison: Comparison) -> str:
    floor = comparison.floor
    if floor is None:
        text = "No noise is declared and no push was repeated, so there is no noise floor to show."
    elif floor.source == "repeats":
        text = (
            f"Noise floor {millimetres(floor.add)} mm: mean ADD of {floor.repeats} pushes in"
            f" {len(floor.groups)} groups of repeats (same start relative to the object, same finger path)"
            " from the mean of their group."
        )
    else:
        text = (
            f"Noise floor {millimetres(floor.add)} mm: the ADD that the declared noise of one pose makes. No"
            " push was repeated, so how far real pushes scatter is not known."
        )
    return f'<p class="note">{escape(text)}</p>'


def _cells(errors: Errors) -> list[str]:
    def shown(value: float, digits: int) -> str:
        return f"{value:.{digits}f}" if np.isfinite(value) else "–"

    return [
        millimetres(errors.final_add),
        millimetres(errors.mean_add),
        millimetres(errors.position),
        shown(float(np.degrees(errors.angle)), 2),
        shown(errors.fit, 1),
        shown(errors.force, 2),
        shown(100 * errors.force_share, 0),
    ]


def structure_section(comparisons: Sequence[Comparison], dataset: PushDataset) -> Section:
    """Where the model fails: tests of all factors, and pictures of residuals against them."""
    parts = []
    for comparison in comparisons:
        name = f"<b>{escape(comparison.label)}:</b> " if len(comparisons) > 1 else ""
        parts.append(f"<p>{name}{escape(finding(comparison))}</p>")
    if any(comparison.mostly_unseen and comparison.significant for comparison in comparisons):
        parts.append(f'<p class="note">{escape(MOSTLY_UNSEEN)}</p>')
    for comparison in comparisons:
        parts.append(_pattern_table(comparison, named=len(comparisons) > 1))
    figures = residual_figures(comparisons, dataset)
    for quantity, title in (("motion", "Residual velocity"), ("force", "Residual force")):
        chosen = {key: figure for key, figure in figures.items() if key.startswith(f"{quantity}.")}
        if not chosen:
            continue
        fields = {key: figure for key, figure in chosen.items() if key.split(".")[1] in FIELDS}
        curves = {key: figure for key, figure in chosen.items() if key not in fields}
        parts.append(f"<h3>{title}</h3>")
        for group, kind in ((fields, "fields"), (curves, "curves")):
            shown = [_figure(key, figure, comparisons, title) for key, figure in group.items()]
            parts.append(f'<div class="pictures {kind}">{"".join(shown)}</div>')
    return Section("where", "Where it fails", "\n".join(parts))


def _pattern_table(comparison: Comparison, *, named: bool) -> str:
    rows = [
        [
            QUANTITIES[pattern.quantity],
            pattern.title,
            pattern.strongest,
            size_text(pattern),
            p_text(pattern.p),
            p_text(pattern.p_corrected),
        ]
        for pattern in comparison.structure
    ]
    marked = [pattern.significant for pattern in comparison.structure]
    columns = ["of", "hangs together with", "most in", "size (95 % interval)", "p", "p, all tests"]
    head = f"{comparison.label}: " if named else ""
    caption = (
        f"{head}{len(rows)} tests with {max((p.pushes for p in comparison.structure), default=0)} pushes as"
        " the unit of evidence; marked where chance gives as much with less than 5 % probability, all tests"
        " considered."
    )
    most = max(6, sum(marked))
    shown = table(columns, rows[:most], numbers=(3, 4, 5), marked=marked, caption=caption)
    rest = rows[most:]
    if rest:
        other = table(columns, rest, numbers=(3, 4, 5))
        shown += f"<details><summary>{len(rest)} more tests</summary>{other}</details>"
    return shown


def _figure(key: str, figure: Figure, comparisons: Sequence[Comparison], title: str) -> str:
    quantity, factor = key.split(".")[:2]
    comparison = comparisons[1] if key.endswith(".second") else comparisons[0]
    lines = []
    for name in FIELDS.get(factor, (factor,)):
        pattern = pattern_of(comparison, name, quantity)
        if pattern is not None:
            text = f"{pattern.title}: p = {p_text(pattern.p_corrected)}, corrected".replace(
                "= below", "below"
            )
            text = escape(text[0].upper() + text[1:])
            lines.append(f"<b>{text}</b>" if pattern.significant else text)
    head = f"{escape(comparison.label)}. " if len(comparisons) > 1 else ""
    drawn = picture(figure, f"{title}: {factor.replace('_', ' ')}")
    return f"<figure>{drawn}<figcaption>{head}{'. '.join(lines)}</figcaption></figure>"


def correlation_section(comparisons: Sequence[Comparison]) -> Section:
    """Memory of the residual, and its correlation with the finger."""
    found = comparisons[0].correlations
    assert found is not None
    longest = found.memory.lags[-1]
    memory = (
        f"It falls to 1/e after {found.memory_time:.2f} s: a push holds as much as about"
        f" {found.independent:.1f} independent residuals, however densely it was sampled."
        if np.isfinite(found.memory_time)
        else f"It does not fall to 1/e within {longest:.1f} s: a push is about one independent residual,"
        " however densely it was sampled."
    )
    along, left = (
        "outside the band" if correlation.p < 0.05 else "inside the band"
        for correlation in (found.finger_along, found.finger_left)
    )
    body = (
        picture(correlation_figure(comparisons), "Correlations over lags", wide=True)
        + f"<p>Left: how long the pose residual remembers itself. {escape(memory)} Middle and right: the"
        f" residual against the finger's velocity, in its direction ({along}, p"
        f" {p_text(found.finger_along.p)}) and to its left ({left}, p {p_text(found.finger_left.p)}). A"
        " negative correlation in its direction means that measured poses trail behind.</p>"
        '<p class="note">Bands hold all lags of 95 % of chance results: pairs of different pushes for the'
        " left picture, random signs of whole pushes for the others. These two p-values are for looking; the"
        " tests above are the ones that are corrected together.</p>"
    )
    return Section("time", "Over time", body)
