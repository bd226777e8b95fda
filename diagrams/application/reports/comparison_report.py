"""The HTML report of one model, or of two over the same pushes: errors, pushes, patterns, correlations."""

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from slipmap.diagrams.application.figures import correlation_figure, error_figure, residual_figures
from slipmap.diagrams.application.figures.push_figures import MODEL_COLOURS
from slipmap.diagrams.application.figures.residual_figures import pattern_of
from slipmap.diagrams.application.reports import comparison_words as words
from slipmap.diagrams.application.reports.html_page import Section, page, part, picture, table
from slipmap.diagrams.application.reports.tables import joint_rows
from slipmap.diagrams.application.terminal import counted
from slipmap.models.inference.comparison import Comparison, JointComparison
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.prediction import Prediction
from slipmap.models.inference.push_errors import Errors
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.paper_notation import add

_ERROR_COLUMNS = (
    "end (ADD), mm",
    "on average (ADD), mm",
    "position, mm",
    "angle, °",
    "fit, %",
    "force, N",
    "force, %",
)

_COLOURS = ("var(--model)", "var(--other)")  # of models in the animation of a push

_COLUMNS = (("end, mm", 2), ("average, mm", 2), ("angle, °", 2), ("fit, %", 1), ("force, %", 0))
"""Errors of one model in the table, and their numbers of digits."""

_COLUMNS_OF_TWO = ("end, mm", "average, mm", "fit, %")
_BASELINES = ("spread, mm", "uniform, mm", "no motion, mm")

_FIELDS = {"table_place": ("table_drift", "table_place"), "contact_place": ("object_drift", "contact_place")}
"""Field pictures, and the factors that they show."""

_CURVES = "Pale dots: pushes. Bars: means over pushes with 95 % intervals. Band: negligible residuals."

_MOSTLY_UNSEEN = (
    "The model did not learn from most of these pushes. Errors of its maps affect all of them and can"
    " appear as patterns too; learn from these pushes to distinguish such errors from missing physics."
)


def comparison_report(
    comparisons: Sequence[Comparison],
    dataset: PushDataset,
    where: str = "DATASET",
    *,
    run: tuple[str, Sequence[str]] = ("", ()),
) -> str:
    """The report, a whole HTML document.

    Args:
        comparisons: one model, or two over the same pushes, the earlier model first.
        where: the dataset, as a command takes it.
        run: what a run that recorded the pushes says of itself: a headline, or nothing, and sentences.

    Raises:
        ValueError: none or more than two models, or models over different pushes.
    """
    first = comparisons[0]
    learned = "" if first.learnt_from == first.dataset else f", model learned from {first.learnt_from}"
    pushes = counted(len(first.pushes), "measured push")
    subtitle = f"{pushes} of {len(dataset.grid)} cells{learned}; seed {first.seed}"
    sections = comparison_sections(comparisons, dataset)
    title = f"{dataset.name}: model and measurement"
    last = comparisons[-1]
    headline, dot, others = words.warning(last, where).partition(". ")
    warned = headline + dot.rstrip()
    average = words.mean_error(last, named=len(comparisons) > 1)
    told, sentences = run
    headline, *below = [text for text in (warned, told) if text] or [average]
    if told and not warned:
        below = [average]
    found = (others, *below, *sentences, *words.findings(comparisons), *words.doubts(last))
    return page(title, subtitle, [text for text in found if text], sections, headline)


def joint_comparison_report(found: JointComparison, datasets: Sequence[PushDataset]) -> str:
    """The report of several datasets, a whole HTML document: all in one table, then each by itself."""
    count, seed = sum(len(dataset.trials) for dataset in datasets), found.datasets[0][0].seed
    subtitle = f"{count} measured pushes of {len(datasets)} datasets; seed {seed}"
    columns, rows = joint_rows(found)
    caption = (
        "Mean error at the end of the pushes that judge, mm, and number of significant patterns of the"
        " remaining error."
    )
    numbers = table(columns, rows, numbers=range(2, len(columns)), caption=caption)
    sections = [Section("datasets", "All datasets", numbers)]
    for k, models in enumerate(found.datasets):
        texts = "".join(f"<p>{escape(text)}</p>" for text in words.findings(models))
        drawn = picture(error_figure(models), "Error of every push at its end", wide=True)
        sections.append(Section(f"dataset-{k}", models[0].dataset, texts + drawn))
    sections.append(Section("method", "How to read the numbers", part("method.html")))
    lead = words.joint_findings(found)
    if found.fitted is not None:
        lead.insert(0, found.fitted.sentence)
    title = f"{', '.join(dataset.name for dataset in datasets)}: models and measurements"
    return page(title, subtitle, lead, sections)


def comparison_sections(comparisons: Sequence[Comparison], dataset: PushDataset) -> list[Section]:
    """All sections in reading order; arguments and errors as in `comparison_report`."""
    _check_same_pushes(comparisons)
    sections = [
        _error_section(comparisons),
        _push_section(comparisons, dataset),
        _structure_section(comparisons, dataset),
    ]
    if comparisons[0].correlations is not None:
        sections.append(_correlation_section(comparisons))
    sections.append(Section("method", "How to read the numbers", part("method.html")))
    return sections


def _check_same_pushes(comparisons: Sequence[Comparison]) -> None:
    if not 1 <= len(comparisons) <= 2:
        raise ValueError(f"a report shows one model or two, got {len(comparisons)}")
    pushes = [[push.trial for push in comparison.pushes] for comparison in comparisons]
    if any(names != pushes[0] for names in pushes):
        raise ValueError("a report of two models needs both over the same pushes")


def _error_section(comparisons: Sequence[Comparison]) -> Section:
    rows = []
    first = comparisons[0]
    for role, totals in first.totals.items():
        name = f"{totals.pushes} {words.ROLES[role]}"
        for comparison in comparisons:
            rows.append([name, comparison.label, *_cells(comparison.totals[role].model)])
        rows.append([name, "uniform object", *_cells(totals.uniform)])
        rows.append([name, "object does not move", *_cells(totals.resting)])
    numbers = table(
        ["pushes", "prediction", *_ERROR_COLUMNS],
        rows,
        numbers=range(2, 2 + len(_ERROR_COLUMNS)),
        caption="Means over pushes. ADD: average distance between predicted and measured cells. Position,"
        " angle: of the object frame at the end. Force: root mean square while the finger presses steadily.",
    )
    body = (
        picture(error_figure(comparisons), "Error of every push at its end", wide=True)
        + numbers
        + _floor(first)
    )
    return Section("errors", "Prediction errors", body)


def _floor(comparison: Comparison) -> str:
    floor = comparison.floor
    if floor is None:
        text = (
            "The noise floor is unknown: no noise is declared, no push has enough poses for an estimate, and"
            " none was repeated."
        )
    elif floor.source == "repeats":
        groups = len(floor.groups)
        means = f"means of their {groups} groups of repeats" if groups > 1 else "mean of all as repeats"
        text = (
            f"Noise floor {words.millimetres(floor.add)} mm: mean ADD between {floor.repeats} pushes and the"
            f" {means} (same start relative to the object, same"
            " finger path)."
        )
    else:
        text = (
            f"Noise floor {words.millimetres(floor.add)} mm: the ADD due to the {floor.source} of one pose."
            " No push was repeated, so the scatter of real pushes is unknown."
        )
    return f'<p class="note">{escape(text)}</p>'


def _cells(errors: Errors) -> list[str]:
    def shown(value: float, digits: int) -> str:
        return f"{value:.{digits}f}" if np.isfinite(value) else "–"

    return [
        words.millimetres(errors.final_add),
        words.average(errors),
        words.millimetres(errors.position),
        shown(float(np.degrees(errors.angle)), 2),
        shown(errors.fit, 1),
        shown(errors.force, 2),
        shown(100 * errors.force_share, 0),
    ]


def _push_section(comparisons: Sequence[Comparison], dataset: PushDataset) -> Section:
    """The section with its data; it shows the worst of the pushes that count first."""
    first = comparisons[0]
    role, _ = words.judged(first)
    worst = max(
        (b for b, push in enumerate(first.pushes) if push.role == role),
        key=lambda b: first.pushes[b].errors.final_add,
    )
    grid = dataset.grid
    data = {
        "outline": [_rounded(ring) for ring in (grid.exterior, *grid.holes)],
        "centroid": _rounded(grid.centers.mean(axis=0)),
        "radius": dataset.finger_radius,
        "table": None if dataset.table is None else vars(dataset.table),
        "labels": [comparison.label for comparison in comparisons],
        "first": worst,
        "floor": None if first.floor is None else first.floor.add,
        "pushes": [
            _push([comparison.pushes[b] for comparison in comparisons], grid.centers)
            for b in range(len(first.pushes))
        ],
    }
    legend = ["<span><i style='color:var(--ink)'></i>measured</span>"]
    legend += [
        f"<span><i style='color:{colour}'></i>{escape(comparison.label)}</span>"
        for colour, comparison in zip(_COLOURS, comparisons, strict=False)
    ]
    body = f"""<p class="note">Point at a trace or a row to highlight it; click to animate it.</p>
<div class="pushes">
<div><h3>All pushes on the table</h3>
<svg class="map" role="img" aria-label="Traces of all pushes"></svg></div>
<div><h3 class="film-title">One push</h3><svg class="film" role="img" aria-label="One push"></svg></div>
</div>
<div class="legend">{"".join(legend)}<span><i style='color:var(--finger)'></i>finger</span></div>
<div class="player"><button type="button">Play</button>
<input type="range" min="0" max="1" value="1" step="1" aria-label="time within the push"></div>
<div class="course-box"><svg class="course" role="img" aria-label="Error over time"></svg></div>
<div class="readout"></div>
<div class="list"><table><thead>{_heads(comparisons)}</thead>
<tbody>{"".join(_row(comparisons, b) for b in range(len(first.pushes)))}</tbody></table></div>"""
    return Section("pushes", "Push by push", body, data, script="pushes.js")


def _push(told: Sequence[Prediction], centers: FloatArray) -> dict[str, Any]:
    observation = told[0].observation
    start = observation.push.start_pose
    times = np.concatenate([[0.0], np.asarray(observation.push.pose_times)])
    return {
        "name": words.short_name(observation.trial),
        "role": words.ROLES[observation.role],
        "times": _rounded(times),
        "measured": _rounded(np.vstack([start, observation.poses])),
        "predicted": [_rounded(np.vstack([start, push.predicted])) for push in told],
        "add": [
            _rounded(np.concatenate([[0.0], add(push.predicted, observation.poses, centers)]))
            for push in told
        ],
        "finger": _finger(observation, times),
    }


def _finger(observation: Observation, times: FloatArray) -> list[Any]:
    push = observation.push
    if np.isnan(push.tip).any():
        return [None] * len(times)
    steps = push.h * np.arange(len(push.tip))
    return _rounded(np.column_stack([np.interp(times, steps, column) for column in push.tip.T]))


def _columns(comparisons: Sequence[Comparison]) -> list[tuple[str, int]]:
    return [column for column in _COLUMNS if len(comparisons) == 1 or column[0] in _COLUMNS_OF_TWO]


def _heads(comparisons: Sequence[Comparison]) -> str:
    columns = [name for name, _ in _columns(comparisons)]
    group = ""
    if len(comparisons) > 1:
        names = "".join(
            f'<th class="group number" colspan="{len(columns)}">{escape(comparison.label)}</th>'
            for comparison in comparisons
        )
        group = f'<tr><th class="group" colspan="2"></th>{names}<th class="group" colspan="3"></th></tr>'
    texts = "".join(f'<th tabindex="0">{name}</th>' for name in ("push", "role"))
    numbers = "".join(
        f'<th class="number" tabindex="0">{name}</th>' for name in (*columns * len(comparisons), *_BASELINES)
    )
    return f'{group}<tr class="sort">{texts}{numbers}</tr>'


def _row(comparisons: Sequence[Comparison], b: int) -> str:
    push = comparisons[0].pushes[b]
    largest = max(p.errors.final_add for comparison in comparisons for p in comparison.pushes) or 1.0
    cells = [
        f'<td>{escape(words.short_name(push.trial))}</td><td class="short">{words.ROLES[push.role]}</td>'
    ]
    for comparison in comparisons:
        errors = comparison.pushes[b].errors
        values = {
            "end, mm": 1e3 * errors.final_add,
            "average, mm": np.nan if comparison.pushes[b].ends_only else 1e3 * errors.mean_add,
            "angle, °": float(np.degrees(errors.angle)),
            "fit, %": errors.fit,
            "force, %": 100 * errors.force_share,
        }
        for name, digits in _columns(comparisons):
            bar = errors.final_add / largest if name == "end, mm" else None
            cells.append(_number(values[name], digits, bar))
    for value in (push.spread, push.uniform.final_add, push.resting.final_add):
        cells.append(_number(1e3 * value, 1))
    return f'<tr data-push="{b}" tabindex="0">{"".join(cells)}</tr>'


def _number(value: float, digits: int, bar: float | None = None) -> str:
    if not np.isfinite(value):
        return '<td class="number" data-value="">–</td>'
    drawn = "" if bar is None else f'<i style="width:{100 * bar:.1f}%"></i>'
    kind = "number" if bar is None else "number bar"
    return f'<td class="{kind}" data-value="{value:.6g}">{drawn}{value:.{digits}f}</td>'


def _rounded(values: FloatArray) -> list[Any]:
    """Numbers rounded to a hundredth of a millimetre, to keep the file small."""
    rounded: list[Any] = np.round(values, 5).tolist()
    return rounded


def _structure_section(comparisons: Sequence[Comparison], dataset: PushDataset) -> Section:
    parts = []
    for comparison in comparisons:
        name = f"<b>{escape(comparison.label)}:</b> " if len(comparisons) > 1 else ""
        parts.append(f"<p>{name}{escape(words.finding(comparison))}</p>")
    if any(comparison.mostly_unseen and comparison.significant for comparison in comparisons):
        parts.append(f'<p class="note">{escape(_MOSTLY_UNSEEN)}</p>')
    for comparison in comparisons:
        parts.append(_pattern_table(comparison, named=len(comparisons) > 1))
    figures = residual_figures(comparisons, dataset)
    for quantity, title in (("motion", "Residual velocity"), ("force", "Residual force")):
        chosen = {key: figure for key, figure in figures.items() if key.startswith(f"{quantity}.")}
        if not chosen:
            continue
        fields = {key: figure for key, figure in chosen.items() if key.split(".")[1] in _FIELDS}
        curves = {key: figure for key, figure in chosen.items() if key not in fields}
        parts.append(f"<h3>{title}</h3>")
        for group, kind in (
            (fields, "fields pairs" if len(comparisons) > 1 else "fields"),
            (curves, "curves"),
        ):
            shown = [_figure(key, figure, comparisons, title) for key, figure in group.items()]
            if group is curves and shown:
                parts.append(f"{_legend(comparisons)}<p class=note>{_CURVES}</p>")
            parts.append(f'<div class="pictures {kind}">{"".join(shown)}</div>')
    return Section("where", "Where it fails", "\n".join(parts))


def _legend(comparisons: Sequence[Comparison]) -> str:
    """Colours of the models, if there are several."""
    if len(comparisons) < 2:
        return ""
    entries = zip(comparisons, MODEL_COLOURS, strict=False)
    items = [
        f'<span><i style="border-color: {colour}"></i>{escape(one.label)}</span>' for one, colour in entries
    ]
    return f'<div class="legend">{"".join(items)}</div>'


def _pattern_table(comparison: Comparison, *, named: bool) -> str:
    rows = [
        [
            words.QUANTITIES[pattern.quantity],
            pattern.title,
            pattern.strongest,
            words.size_text(pattern),
            words.p_text(pattern.p),
            words.p_text(pattern.p_corrected),
        ]
        for pattern in comparison.structure
    ]
    marked = [pattern.significant for pattern in comparison.structure]
    columns = ["error in", "depends on", "mostly", "size (95 % interval)", "p, this test", "p, all tests"]
    head = f"{comparison.label}: " if named else ""
    count = max((pattern.pushes for pattern in comparison.structure), default=0)
    caption = (
        f"{head}{len(rows)} tests over {counted(count)},"
        " each push counting once; marked where p, corrected for all tests, is below 5 %."
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
    for name in _FIELDS.get(factor, (factor,)):
        pattern = pattern_of(comparison, name, quantity)
        if pattern is not None:
            text = f"{pattern.title}: p = {words.p_text(pattern.p_corrected)}, corrected".replace(
                "= below", "below"
            )
            text = escape(text[0].upper() + text[1:])
            lines.append(f"<b>{text}</b>" if pattern.significant else text)
    head = f"{escape(comparison.label)}. " if len(comparisons) > 1 else ""
    drawn = picture(figure, f"{title}: {factor.replace('_', ' ')}")
    return f"<figure>{drawn}<figcaption>{head}{'. '.join(lines)}</figcaption></figure>"


def _correlation_section(comparisons: Sequence[Comparison]) -> Section:
    found = comparisons[0].correlations
    assert found is not None
    longest = found.memory.lags[-1]
    memory = (
        f"The correlation falls to 1/e after {found.memory_time:.2f} s: a push is worth about"
        f" {found.independent:.1f} independent residuals, however densely it was sampled."
        if np.isfinite(found.memory_time)
        else f"The correlation does not fall to 1/e within {longest:.1f} s: a push is worth about one"
        " independent residual, however densely it was sampled."
    )
    along, left = (
        "outside the band" if correlation.p < 0.05 else "inside the band"
        for correlation in (found.finger_along, found.finger_left)
    )
    body = (
        picture(correlation_figure(comparisons), "Correlations over lags", wide=True)
        + f"<p>Left: autocorrelation of the pose residual. {escape(memory)} Middle and right: correlation"
        " of the residual with the finger's velocity, along it"
        f" ({along}, p {words.p_text(found.finger_along.p)}) and to its left"
        f" ({left}, p {words.p_text(found.finger_left.p)}). A negative correlation along the velocity means"
        " that measured poses trail behind.</p>"
        '<p class="note">The bands contain 95 % of chance results at all lags together: pairs of different'
        " pushes for the left picture, random signs of whole pushes for the others. These two p-values are"
        " exploratory; only the tests above are corrected together.</p>"
    )
    return Section("time", "Over time", body)
