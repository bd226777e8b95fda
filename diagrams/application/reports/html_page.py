"""Sections put together into one HTML page with its styles, scripts and data inside."""

from __future__ import annotations

import base64
import io
import json
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from slipmap.diagrams.application.reports.comparison_words import ROLES, judged, short_name
from slipmap.diagrams.systems.look import STYLE
from slipmap.models.files import plain
from slipmap.models.inference.comparison import ComparedPush, Comparison
from slipmap.models.inference.observations import Observation
from slipmap.models.measurements import PushDataset, Table
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.paper_notation import add


@dataclass(frozen=True, eq=False)
class Section:
    """One part of a report.

    Attributes:
        key: identifies it in links and in the data.
        title: heading.
        body: HTML.
        data: what its scripts need, JSON-able.
        script: name of a script in this folder that gives its body life; empty for none.
    """

    key: str
    title: str
    body: str
    data: Mapping[str, Any] = field(default_factory=dict)
    script: str = ""


def page(
    title: str, subtitle: str, lead: Sequence[str], sections: Sequence[Section], headline: str = ""
) -> str:
    """A whole HTML document.

    Args:
        title: of the page.
        subtitle: a line below it: what was compared, when and with what.
        lead: paragraphs that say what was found, the most important first.
        sections: in the order of reading; keys must differ.
        headline: a sentence in large letters above the lead.

    Raises:
        ValueError: two sections have one key.
    """
    keys = [section.key for section in sections]
    if len(set(keys)) < len(keys):
        raise ValueError(f"report: section keys must differ, got {', '.join(keys)}")
    scripts = dict.fromkeys(section.script for section in sections if section.script)
    data = {section.key: plain(section.data) for section in sections if section.data}
    parts = {
        "title": escape(title),
        "subtitle": escape(subtitle),
        "style": part("style.css"),
        "headline": f'<p class="headline">{escape(headline)}</p>' if headline else "",
        "lead": "\n".join(f"<p>{escape(text)}</p>" for text in lead),
        "links": "\n".join(f'<a href="#{s.key}">{escape(s.title)}</a>' for s in sections),
        "sections": "\n".join(
            f'<section id="{s.key}">\n<h2>{escape(s.title)}</h2>\n{s.body}\n</section>' for s in sections
        ),
        # A "<" inside a script could end it.
        "data": json.dumps(data, allow_nan=False).replace("<", "\\u003c"),
        "scripts": "\n".join(part(name) for name in scripts),
    }
    text = part("page.html")
    for name, value in parts.items():
        text = text.replace(f"<!--{name}-->", value)
    return text


def part(name: str) -> str:
    """A file of this folder."""
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def picture(figure: Figure, alternative: str, *, wide: bool = False) -> str:
    """An `img` element that holds the figure; letters are drawn, so that it looks alike everywhere.

    Args:
        figure: to be shown.
        alternative: what it shows, for those who cannot see it.
        wide: as wide as the page, instead of its own width at most.
    """
    stream = io.BytesIO()
    with matplotlib.rc_context({**STYLE, "svg.fonttype": "path"}):
        figure.savefig(stream, format="svg", metadata={"Date": None})
    width, height = figure.get_size_inches() * 96
    code = base64.b64encode(stream.getvalue()).decode("ascii")
    kind = " class=wide" if wide else ""
    return (
        f'<img{kind} alt="{escape(alternative)}" width="{width:.0f}" height="{height:.0f}"'
        f' src="data:image/svg+xml;base64,{code}">'
    )


def table(
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    numbers: Sequence[int] = (),
    marked: Sequence[bool] = (),
    caption: str = "",
) -> str:
    """An HTML table of plain texts.

    Args:
        columns: headings.
        rows: cells.
        numbers: columns to align on the right.
        marked: for each row whether it is to stand out.
        caption: sentence above it.
    """
    kinds = [' class="number"' if k in numbers else "" for k in range(len(columns))]
    head = "".join(f"<th{kind}>{escape(name)}</th>" for kind, name in zip(kinds, columns, strict=True))
    lines = []
    for index, row in enumerate(rows):
        mark = ' class="marked"' if index < len(marked) and marked[index] else ""
        cells = "".join(f"<td{kind}>{escape(cell)}</td>" for kind, cell in zip(kinds, row, strict=True))
        lines.append(f"<tr{mark}>{cells}</tr>")
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    return (
        f'<div class="scroll"><table>{title}<thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


# Push by push: a map of all pushes, one push as a film, and a table to sort and choose from.


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


# A picture of a page as a browser without a window shows it, where there is one.


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

_FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--hide-scrollbars",
    "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-dev-shm-usage", "--virtual-time-budget=4000",
)  # fmt: skip
_PATIENCE = 60.0  # s


def page_picture(page: Path, width: int = 1000, height: int = 700) -> bytes | None:
    """PNG of the upper part of a page.

    Args:
        page: HTML file that needs no network.
        width: of the window, pixels.
        height: of the same.

    Returns:
        The picture; None where there is no Chromium or Chrome, or it makes none.

    Raises:
        FileNotFoundError: there is no such page.
    """
    address = page.resolve(strict=True).as_uri()
    program = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if program is None:
        return None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        picture = Path(folder) / "page.png"
        command = [
            program, *_FLAGS, f"--user-data-dir={folder}/profile", f"--window-size={width},{height}",
            f"--screenshot={picture}", address,
        ]  # fmt: skip
        try:
            subprocess.run(command, capture_output=True, check=False, timeout=_PATIENCE)
        except subprocess.TimeoutExpired:
            return None
        return picture.read_bytes() if picture.is_file() else None
