"""How far a model is off, push by push, beside simple ones and the noise floor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from diagrams.figures.style import BELIEF, FAINT, INK, OTHER, PlainNumbers, styled
from diagrams.wording import short_name
from models.inference.comparison import Comparison

MODEL_COLOURS = (BELIEF, OTHER)
WIDTH = 8.0  # inches
LEGEND_COLUMNS, LEGEND_ROW = 3, 0.2  # columns where one row does not hold it; inches
LETTER = 0.07  # inches, of a push's name
MOST_NAMES = 40


@styled
def error_figure(comparisons: Sequence[Comparison]) -> Figure:
    """Error at the end (ADD) of each push on a logarithmic scale, fit pushes left, held-out ones right.

    Args:
        comparisons: one model, or two over the same pushes; the first one's error gives the order.
    """
    first = comparisons[0]
    order = sorted(
        range(len(first.pushes)),
        key=lambda b: (first.pushes[b].role == "heldout", first.pushes[b].errors.final_add),
    )
    pushes = [first.pushes[b] for b in order]
    entries = 2 + len(comparisons) + (first.floor is not None)
    columns = entries if entries <= LEGEND_COLUMNS + 1 else LEGEND_COLUMNS
    names = [short_name(push.trial) for push in pushes] if len(pushes) <= MOST_NAMES else []
    longest = max(map(len, names), default=0)
    upright = len(names) > 30 or longest > 4
    below = 0.2 + LETTER * longest if upright else 0.4
    top = 0.23 + LEGEND_ROW * -(-entries // columns)
    height = 2.27 + below + top
    figure = Figure(figsize=(WIDTH, height))
    axes = figure.add_axes((0.085, below / height, 0.905, 2.27 / height))
    x = np.arange(len(pushes))
    for name, marker, colour, size in (("resting", "_", FAINT, 8.0), ("uniform", "D", FAINT, 3.6)):
        label = {"resting": "object does not move", "uniform": "uniform object"}[name]
        values = [1e3 * getattr(push, name).final_add for push in pushes]
        axes.plot(
            x, values, marker, color=colour, markersize=size, markeredgewidth=1.3, label=label,
            markerfacecolor="white", linestyle="none",
        )  # fmt: skip
    # The first of two models is a ring, so that a second one at its place does not hide it.
    for k, (comparison, colour) in enumerate(zip(comparisons, MODEL_COLOURS, strict=False)):
        ring = k == 0 and len(comparisons) > 1
        size, fill = (8.0, "none") if ring else (5.5, colour)
        values = [1e3 * comparison.pushes[b].errors.final_add for b in order]
        axes.plot(
            x, values, "o", color=colour, markersize=size, markerfacecolor=fill, label=comparison.label,
            linestyle="none", markeredgewidth=1.4 if ring else 0.0,
        )  # fmt: skip
    if first.floor is not None:
        floor = 1e3 * first.floor.add
        label = f"noise floor {floor:.2g} mm ({first.floor.source})"
        axes.axhline(floor, color=INK, linewidth=0.9, linestyle=(0, (4, 3)), label=label)
    fitted = sum(push.role == "fit" for push in pushes)
    if 0 < fitted < len(pushes):
        axes.axvspan(fitted - 0.5, len(pushes) - 0.5, color="#f6f4ef", linewidth=0, zorder=0)
    for middle, name, count in (
        ((fitted - 1) / 2, "fit", fitted),
        ((fitted + len(pushes) - 1) / 2, "held out", len(pushes) - fitted),
    ):
        if count:
            axes.annotate(
                name, (middle, 1.0), (0, 3), xycoords=("data", "axes fraction"), textcoords="offset points",
                ha="center", fontsize=8.5, color=INK,
            )  # fmt: skip
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(PlainNumbers())
    axes.set(xlim=(-0.6, len(pushes) - 0.4), ylabel="ADD at the end, mm")
    axes.set_xticks(x[: len(names)], names, rotation=90 if upright else 0, fontsize=7.5)
    axes.grid(axis="y", color="#e7e4dd", linewidth=0.6)
    axes.set_axisbelow(True)
    figure.legend(loc="upper right", ncols=columns, bbox_to_anchor=(0.995, 1.01), handletextpad=0.3)
    return figure
