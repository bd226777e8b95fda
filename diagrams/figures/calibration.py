"""How often the truth lies inside the intervals that a belief gives: reliability curves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diagrams.figures.style import BELIEF, FAINT, INK, PAPER, styled
from models.physics.cell_grid import FloatArray

LEVELS = np.linspace(0.0, 1.0, 201)
PANEL = 2.5  # inches


class Calibration(Protocol):
    """What is drawn of a calibration: the number of objects, and where the truths fell."""

    @property
    def objects(self) -> int:
        """Number of simulated objects."""

    @property
    def ranks(self) -> Mapping[str, FloatArray]:
        """For each quantity (m,) probability-integral values of the truth, in [0, 1]."""


@styled
def calibration_figure(result: Calibration) -> Figure:
    """For each quantity, the share of truths inside the central interval against the interval's probability.

    On the diagonal the intervals are right; below it they are too narrow, above it too wide. The band holds
    90 % of the curves that right intervals give with so few objects (pointwise, binomial).
    """
    names = list(result.ranks)
    columns = min(4, max(1, len(names)))
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(max(columns * (PANEL + 0.3) + 0.6, 6.4), rows * (PANEL + 0.55) + 1.0))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    height = figure.get_size_inches()[1]
    figure.subplots_adjust(
        left=0.09 if columns > 2 else 0.14,
        right=0.98,
        top=1 - 0.75 / height,
        bottom=0.6 / height,
        wspace=0.12,
        hspace=0.3,
    )
    for axes, name in zip(panels.flat, names, strict=False):
        _curve(axes, name, np.asarray(result.ranks[name], dtype=float), result.objects)
    for axes in panels.flat[len(names) :]:
        axes.set_visible(False)
    for axes in panels[:, 0]:
        axes.set_ylabel("truth inside")
    for column in range(columns):
        last = [axes for axes in panels[:, column] if axes.get_visible()][-1]
        last.set_xlabel("interval of the belief")
        last.tick_params(labelbottom=True)
    figure.suptitle(
        f"Calibration on {result.objects} simulated objects: below the diagonal, intervals are too narrow",
        y=1 - 0.12 / height, va="top", fontsize=11,
    )  # fmt: skip
    return figure


def inside_share(ranks: FloatArray, levels: FloatArray) -> FloatArray:
    """(l,) share of truths in the central interval of each level (l,), from their integral values (m,)."""
    return (np.abs(2.0 * ranks - 1.0)[None] <= levels[:, None]).mean(axis=1)


def _curve(axes: Axes, name: str, ranks: FloatArray, objects: int) -> None:
    from scipy.stats import binom  # takes half a second to load, and every picture loads this file

    count = len(ranks)
    draws = min(count, objects)  # several pushes of one object are one story
    low, high = (binom.ppf(q, draws, LEVELS) / draws for q in (0.05, 0.95))
    axes.fill_between(LEVELS, low, high, color=PAPER, linewidth=0)
    axes.plot([0, 1], [0, 1], color=FAINT, linewidth=0.8)
    axes.plot(LEVELS, inside_share(ranks, LEVELS), color=BELIEF, linewidth=1.6, drawstyle="steps-post")
    share = float(inside_share(ranks, np.array([0.9]))[0])
    axes.plot([0.9], [share], "o", color=INK, markersize=4)
    axes.annotate(f"{100 * share:.0f} % in the 90 % interval", (0.98, 0.05), ha="right", fontsize=8)
    axes.set_title(f"{name} ({count})", fontsize=9)
    axes.set(xlim=(0, 1), ylim=(0, 1.02), aspect="equal", xticks=[0, 0.5, 1], yticks=[0, 0.5, 1])
    axes.set_xticklabels(["0", "50 %", "100 %"])
    axes.set_yticklabels(["0", "50 %", "100 %"])
