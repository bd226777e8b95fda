"""Push by push: a map of all pushes, one push as a film, and a table to sort and choose from."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from diagrams.comparison_words import judged
from diagrams.html_report.page import Section
from diagrams.wording import ROLES, short_name
from models.inference.comparison import ComparedPush, Comparison
from models.inference.observations import Observation
from models.measurements import PushDataset, Table
from models.physics.cell_grid import FloatArray
from models.physics.paper_notation import add

COLOURS = ("var(--model)", "var(--other)")


def push_section(comparisons: Sequence[Comparison], dataset: PushDataset) -> Section:
    """The section with its data; first shown is the worst of the pushes that count."""
    first = comparisons[0]
    role, _ = judged(first)
    worst = max(
        (b for b, push in enumerate(first.pushes) if push.role == role),
        key=lambda b: first.pushes[b].errors.final_add,
    )
    grid = dataset.grid
    data = {
        "outline": [_rounded(ring) for ring in (grid.exterior, *grid.holes)],
        "centroid": _rounded(grid.centers.mean(axis=0)),
        "radius": dataset.finger_radius,
        "table": _table(dataset.table),
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
        for colour, comparison in zip(COLOURS, comparisons, strict=False)
    ]
    body = f"""<p class="note">Point at a trace or a row to see it alone; click to load it into the film.</p>
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


def _push(told: Sequence[ComparedPush], centers: FloatArray) -> dict[str, Any]:
    observation = told[0].observation
    start = observation.push.start_pose
    times = np.concatenate([[0.0], np.asarray(observation.push.pose_times)])
    return {
        "name": short_name(observation.trial),
        "role": ROLES[observation.role],
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


COLUMNS = (("end, mm", 2), ("average, mm", 2), ("angle, °", 2), ("fit, %", 1), ("force, %", 0))
"""Errors of one model in the table, and their digits."""

COLUMNS_OF_TWO = ("end, mm", "average, mm", "fit, %")
BASELINES = ("spread, mm", "uniform, mm", "no motion, mm")


def _columns(comparisons: Sequence[Comparison]) -> list[tuple[str, int]]:
    return [column for column in COLUMNS if len(comparisons) == 1 or column[0] in COLUMNS_OF_TWO]


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
        f'<th class="number" tabindex="0">{name}</th>' for name in (*columns * len(comparisons), *BASELINES)
    )
    return f'{group}<tr class="sort">{texts}{numbers}</tr>'


def _row(comparisons: Sequence[Comparison], b: int) -> str:
    push = comparisons[0].pushes[b]
    largest = max(p.errors.final_add for comparison in comparisons for p in comparison.pushes) or 1.0
    cells = [f'<td>{escape(short_name(push.trial))}</td><td class="short">{ROLES[push.role]}</td>']
    for comparison in comparisons:
        errors = comparison.pushes[b].errors
        values = {
            "end, mm": 1e3 * errors.final_add,
            "average, mm": 1e3 * errors.mean_add,
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


def _table(table: Table | None) -> dict[str, Any] | None:
    if table is None:
        return None
    return {"shape": table.shape, "center": table.center, "radius": table.radius, "size": table.size}


def _rounded(values: FloatArray) -> list[Any]:
    """Numbers to a hundredth of a millimetre: the file stays small."""
    rounded: list[Any] = np.round(values, 5).tolist()
    return rounded
