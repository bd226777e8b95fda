"""What a diagnosis rests on: gains of all candidates, what is left on top of them, and the locked pushes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from diagrams.diagnosis_words import nats
from diagrams.figures.style import BELIEF, FAINT, INK, OTHER, styled
from diagrams.wording import short_name
from models.inference.diagnosis import Diagnosis
from models.physics.cell_grid import FloatArray

NAMES, PANEL, ROW = 1.68, 2.1, 0.235  # inches
LOCKED, LETTER = 3.8, 0.075  # inches
ALARM = "#a3341f"
PALE = "#c9c5bb"


@styled
def gain_figure(diagnosis: Diagnosis) -> Figure:
    """Bars for every candidate: gain to first order, gain when refitted, and what another still gains.

    What another still gains is to first order too, and drawn on the scale of the first panel: short beside
    the candidate's own gain, it says that little is left. Refitted gains are of another size.
    """
    candidates = diagnosis.candidates
    height = 0.62 + ROW * len(candidates) + 0.12
    bottom, top = 0.12 / height, 1 - 0.62 / height
    answered = [c.in_set or c.name in diagnosis.effects for c in candidates]
    told_of = list(zip(candidates, answered, strict=True))
    gains: list[float | None] = [c.gain for c in candidates]
    fitted = [c.fitted_gain for c in candidates]
    left = [c.remaining_gain for c in candidates]
    plain = [OTHER if a else PALE for a in answered]
    judged = [ALARM if c.rejected_by is not None else OTHER if a else PALE for c, a in told_of]
    first_order = _longest(gains + left)
    panels = (
        ("gain to first order", gains, plain, first_order),
        ("gain when refitted", fitted, plain, _longest(fitted)),
        ("left to gain on top of it", left, judged, first_order),
    )
    shown = [panel for panel in panels if any(value is not None for value in panel[1])]
    width = NAMES + PANEL * len(shown)
    figure = Figure(figsize=(width, height))
    for k, (title, values, colours, longest) in enumerate(shown):
        axes = figure.add_axes(((NAMES + PANEL * k) / width, bottom, 0.85 * PANEL / width, top - bottom))
        _bars(axes, values, colours, longest)
        axes.set_title(f"{title}, nats", loc="left", fontsize=9)
        if k == 0:
            axes.set_yticks(range(len(candidates)), [c.name for c in candidates])
            for label, answer in zip(axes.get_yticklabels(), answered, strict=True):
                label.set_fontweight("bold" if answer else "normal")
    handles = [
        Line2D([], [], color=colour, linewidth=6, label=label)
        for colour, label in (
            (OTHER, "not ruled out"),
            (PALE, "ruled out, or no more than chance"),
            (ALARM, "another gains on top, so it is ruled out"),
        )
        if any(colour in colours for _, _, colours, _ in shown)
    ]
    if len(handles) > 1:
        figure.legend(
            handles=handles, loc="upper right", ncols=3, handlelength=1.0, bbox_to_anchor=(1.0, 1.0)
        )
    return figure


def _longest(values: Sequence[float | None]) -> float:
    """The largest gain, and more than zero."""
    return max([1e-9, *(value for value in values if value is not None)])


def _bars(axes: Axes, values: Sequence[float | None], colours: Sequence[str], longest: float) -> None:
    """Bars from zero on a scale that `longest` nearly fills; a negative gain has none, only its number."""
    rows = np.arange(len(values))
    known = np.array([np.nan if value is None else value for value in values])
    drawn = np.clip(np.nan_to_num(known), 0.0, None)
    axes.barh(rows, drawn, color=list(colours), height=0.62)
    for row, value, length in zip(rows, known, drawn, strict=True):
        text = "–" if np.isnan(value) else nats(value)
        axes.annotate(
            text, (length, row), (3, 0), textcoords="offset points", va="center", fontsize=8,
            color=FAINT if np.isnan(value) else INK,
        )  # fmt: skip
    axes.set(xlim=(0, 1.22 * longest), ylim=(len(values) - 0.45, -0.55), xticks=[], yticks=[])
    axes.spines["bottom"].set_visible(False)
    axes.tick_params(axis="y", length=0)


@styled
def locked_figure(diagnosis: Diagnosis) -> Figure:
    """Error over the course of each locked push, without and with the answer.

    Raises:
        ValueError: no push was locked away.
    """
    if diagnosis.before is None or diagnosis.after is None:
        raise ValueError("no push was locked away, so there is nothing to draw")
    before, after = 1e3 * diagnosis.before.path, 1e3 * diagnosis.after.path
    order = np.argsort(before)
    height = 0.85 + 0.21 * len(order)
    names = [short_name(diagnosis.locked[b]) for b in order]
    left = 0.25 + LETTER * max(map(len, names))
    figure = Figure(figsize=(LOCKED, height))
    axes = figure.add_axes((left / LOCKED, 0.45 / height, 1 - (left + 0.15) / LOCKED, 1 - 0.85 / height))
    rows = np.arange(float(len(order)))
    changed = bool(diagnosis.effect_objects)
    if changed:
        axes.hlines(rows, before[order], after[order], color=PALE, linewidth=2.4)
        _dots(axes, after[order], rows, OTHER, "with the answer")
    _dots(axes, before[order], rows, BELIEF, "without effects" if changed else "the model")
    if max(before.max(), after.max()) > 5 * min(before.min(), after.min()):
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("")
    axes.set_xlabel("ADD over the course, mm")
    axes.set_yticks(rows, names)
    axes.set_ylim(-0.7, len(order) - 0.3)
    axes.grid(axis="x", color="#e7e4dd", linewidth=0.6)
    axes.set_axisbelow(True)
    figure.legend(loc="upper right", ncols=2, handletextpad=0.2, bbox_to_anchor=(1.0, 1.0))
    return figure


def _dots(axes: Axes, values: FloatArray, rows: FloatArray, colour: str, label: str) -> None:
    axes.plot(values, rows, "o", color=colour, markersize=6, label=label, linestyle="none", zorder=3)
