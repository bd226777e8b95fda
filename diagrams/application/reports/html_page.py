"""HTML pages: sections assembled into one file with styles, scripts and data inside.

The template `page.html` is filled without a template engine, which would be another dependency and save no
code here.
"""

import base64
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from slipmap.diagrams.application.figures.style import keep_labels_inside
from slipmap.diagrams.systems.look import STYLE
from slipmap.models.files import plain


@dataclass(frozen=True, eq=False)
class Section:
    """One part of a report."""

    key: str  # identifies it in links and in the data
    title: str
    body: str
    data: Mapping[str, Any] = field(default_factory=dict)  # for its scripts, JSON-serialisable
    script: str = ""  # name of its script in this folder; empty for none


def page(
    title: str, subtitle: str, lead: Sequence[str], sections: Sequence[Section], headline: str = ""
) -> str:
    """A whole HTML document.

    Args:
        subtitle: a line below the title: what was compared, and with what.
        lead: paragraphs with the findings, the most important first.
        sections: in reading order; keys must differ.
        headline: a sentence in large letters above the lead.

    Raises:
        ValueError: two sections have the same key.
    """
    keys = [section.key for section in sections]
    if len(set(keys)) < len(keys):
        raise ValueError(f"report: section keys must differ, got {', '.join(keys)}")
    scripts = dict.fromkeys(section.script for section in sections if section.script)
    data = {section.key: plain(section.data) for section in sections if section.data}
    paragraphs = "\n".join(f"<p>{_words(text)}</p>" for text in lead)
    parts = {
        "title": escape(title),
        "subtitle": escape(subtitle),
        "style": part("style.css"),
        "headline": f'<p class="headline">{_words(headline)}</p>' if headline else "",
        "lead": f'<div class="lead">\n{paragraphs}\n</div>' if lead else "",
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


def _words(text: str) -> str:
    """HTML of a text, with backquoted parts as code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))


def part(name: str) -> str:
    """A file of this folder."""
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def picture(figure: Figure, alternative: str, *, wide: bool = False) -> str:
    """An `img` element with the figure as SVG; letters are drawn as paths, to look the same everywhere.

    Args:
        alternative: what it shows, for those who cannot see it.
        wide: whether it fills the width of the page instead of keeping its own.
    """
    stream = io.BytesIO()
    with matplotlib.rc_context({**STYLE, "svg.fonttype": "path"}):
        keep_labels_inside(figure)
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
        numbers: columns to align on the right.
        marked: for each row, whether it is highlighted.
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
