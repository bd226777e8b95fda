"""Figures of many trials (curves, bars beside the paper's, calibration), and of audits of engines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slipmap.diagrams.application.figures.style import draw_outline, light_grid, scale_bar
from slipmap.diagrams.systems.look import BELIEF, FAINT, FINGER, INK, OTHER, PAPER, styled
from slipmap.models.physics.cell_grid import FloatArray

if TYPE_CHECKING:
    from slipmap.diagrams.application.audit.procedure import Audit
    from slipmap.diagrams.application.campaigns.trials import Estimate
    from slipmap.diagrams.application.studies.calibration import CalibrationResult

_COLORS = (BELIEF, FINGER, OTHER, FAINT)
_COLUMNS = 3
_LEVELS = np.linspace(0.0, 1.0, 201)  # probabilities of intervals along a reliability curve
_PANEL = 2.5  # inches


@styled
def curves_figure(title: str, curves: Mapping[str, Mapping[str, Sequence[Estimate]]]) -> Figure:
    """One panel per object with one curve per label over the number of pushes, with 95 % intervals, in mm.

    Args:
        curves: by object and label, one estimate (m) after each push.
    """
    columns = max(1, min(_COLUMNS, len(curves)))
    rows = max(1, -(-len(curves) // columns))
    figure = Figure(figsize=(max(6.4, 2.7 * columns), 2.3 * rows + 0.7), layout="constrained")
    figure.suptitle(title, fontsize=11)
    panels = figure.subplots(rows, columns, squeeze=False)
    for axes in panels.flat[len(curves) :]:
        axes.set_visible(False)
    for axes, (name, labels) in zip(panels.flat, curves.items(), strict=False):
        for (label, estimates), color in zip(labels.items(), _COLORS, strict=False):
            x = np.arange(1, len(estimates) + 1)
            axes.plot(x, [1e3 * e.value for e in estimates], "-o", color=color, markersize=3, label=label)
            low, high = ([1e3 * value for value in ends] for ends in zip(*map(_ends, estimates), strict=True))
            axes.fill_between(x, low, high, color=color, alpha=0.15, linewidth=0)
        axes.set_title(name.replace("_", " "))
        axes.set_ylim(bottom=0)
        axes.set_xticks(x)
        axes.set_xlabel("number of fit pushes")
    for axes in panels[:, 0]:
        axes.set_ylabel("error, mm")
    if curves:
        panels[0, 0].legend()
    return figure


@styled
def shares_figure(
    title: str,
    shares: Mapping[str, Mapping[str, Estimate]],
    paper: Mapping[str, Mapping[str, tuple[float, float]]],
) -> Figure:
    """Bars of shares in per cent with 95 % intervals, grouped by object, and the paper's numbers as marks.

    Args:
        shares: by object and method.
        paper: by object and method, the paper's range of the share in per cent, where it has one.
    """
    figure = _bars(title, shares, 100.0, paper)
    figure.axes[0].set(ylim=(0, 104), ylabel="%")
    return figure


@styled
def means_figure(title: str, means: Mapping[str, Mapping[str, Estimate]], factor: float, unit: str) -> Figure:
    """Bars of means with 95 % intervals, grouped by object.

    Args:
        means: by object and label.
        factor: converts them to the unit.
        unit: shown on the axis.
    """
    figure = _bars(title, means, factor, {})
    figure.axes[0].set(ylabel=unit)
    figure.axes[0].set_ylim(bottom=0.0)
    return figure


def _bars(
    title: str,
    values: Mapping[str, Mapping[str, Estimate]],
    factor: float,
    marks: Mapping[str, Mapping[str, tuple[float, float]]],
) -> Figure:
    """Bars with intervals, scaled by a factor: a group for each object, a colour for each label, and the
    paper's marks."""
    figure = Figure(figsize=(max(6.4, 1.6 * len(values) + 1.0), 3.4), layout="constrained")
    axes = figure.subplots()
    every = list(dict.fromkeys(label for labels in values.values() for label in labels))
    width = 0.8 / max(1, len(every))
    for index, (label, color) in enumerate(zip(every, _COLORS, strict=False)):
        for group, (name, labels) in enumerate(values.items()):
            if label not in labels or not np.isfinite(labels[label].value):
                continue
            value, low, high = factor * np.array([labels[label].value, labels[label].low, labels[label].high])
            x = group - 0.4 + (index + 0.5) * width
            axes.bar(x, value, 0.92 * width, color=color, alpha=0.8)
            if np.isfinite(low + high):
                off = [[max(value - low, 0.0)], [max(high - value, 0.0)]]
                axes.errorbar(x, value, off, color=INK, linewidth=0.8)
            if label in marks.get(name, {}):
                axes.plot([x, x], marks[name][label], "_", color=INK, markersize=9)
        axes.bar(0.0, 0.0, color=color, alpha=0.8, label=label)
    if marks:
        axes.plot([], [], "_", color=INK, markersize=9, label="the paper")
    axes.set_xticks(range(len(values)), [name.replace("_", " ") for name in values])
    axes.set_title(title)
    axes.legend(ncols=len(every) + 1, loc="upper center", bbox_to_anchor=(0.5, -0.1))
    return figure


@styled
def reliability_figure(title: str, bins: Mapping[str, Sequence[tuple[float, Estimate]]]) -> Figure:
    """Observed share of events against their stated probability.

    Args:
        bins: by label, for each bin the mean stated probability and the observed share.
    """
    figure = Figure(figsize=(4.2, 4.2), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color=FAINT, linewidth=0.8)
    for (label, points), color in zip(bins.items(), _COLORS, strict=False):
        stated = [place for place, _ in points]
        values = [estimate.value for _, estimate in points]
        off = [[e.value - e.low for _, e in points], [e.high - e.value for _, e in points]]
        axes.errorbar(
            stated, values, np.maximum(off, 0.0), fmt="-o", color=color, markersize=4, capsize=2, label=label
        )
    axes.set(
        xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal", title=title,
        xlabel="stated probability", ylabel="observed share",
    )  # fmt: skip
    axes.legend(loc="upper left")
    return figure


def _ends(estimate: Estimate) -> tuple[float, float]:
    """The interval; the value itself where a single trial gives none."""
    if np.isfinite(estimate.low + estimate.high):
        return estimate.low, estimate.high
    return estimate.value, estimate.value


@styled
def calibration_figure(result: CalibrationResult) -> Figure:
    """For each quantity, the share of truths inside the central interval against the interval's probability.

    On the diagonal the intervals are right; below it they are too narrow, above it too wide. The band
    contains 90 % of the curves of right intervals with so few objects (pointwise, binomial).
    """
    names = list(result.ranks)
    columns = min(4, max(1, len(names)))
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(max(columns * (_PANEL + 0.3) + 0.6, 6.4), rows * (_PANEL + 0.55) + 1.0))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    height = figure.get_size_inches()[1]
    figure.subplots_adjust(
        left=0.09 if columns > 2 else 0.14, right=0.98, top=1 - 0.75 / height, bottom=0.6 / height,
        wspace=0.12, hspace=0.3,
    )  # fmt: skip
    for axes, name in zip(panels.flat, names, strict=False):
        _curve(axes, name, np.asarray(result.ranks[name], dtype=float), result.objects)
    for axes in panels.flat[len(names) :]:
        axes.set_visible(False)
    for axes in panels[:, 0]:
        axes.set_ylabel("share of truths inside")
    for column in range(columns):
        last = [axes for axes in panels[:, column] if axes.get_visible()][-1]
        last.set_xlabel("probability of the interval")
        last.tick_params(labelbottom=True)
    figure.suptitle(
        f"Calibration on {result.objects} simulated objects: below the diagonal, intervals are too narrow",
        y=1 - 0.12 / height, va="top", fontsize=11,
    )  # fmt: skip
    return figure


def inside_share(ranks: FloatArray, levels: FloatArray) -> FloatArray:
    """(l,) share of truths in the central interval of each level (l,), from their probability ranks (m,)."""
    return (np.abs(2.0 * ranks - 1.0)[None] <= levels[:, None]).mean(axis=1)


def _curve(axes: Axes, name: str, ranks: FloatArray, objects: int) -> None:
    from scipy.stats import binom  # takes half a second to load, and every figure loads this module

    count = len(ranks)
    draws = min(count, objects)  # pushes of one object are not independent
    low, high = (binom.ppf(q, draws, _LEVELS) / draws for q in (0.05, 0.95))
    axes.fill_between(_LEVELS, low, high, color=PAPER, linewidth=0)
    axes.plot([0, 1], [0, 1], color=FAINT, linewidth=0.8)
    axes.plot(_LEVELS, inside_share(ranks, _LEVELS), color=BELIEF, linewidth=1.6, drawstyle="steps-post")
    share = float(inside_share(ranks, np.array([0.9]))[0])
    axes.plot([0.9], [share], "o", color=INK, markersize=4)
    axes.annotate(f"{100 * share:.0f} % in the 90 % interval", (0.98, 0.05), ha="right", fontsize=8)
    axes.set_title(f"{name} ({count})", fontsize=9)
    axes.set(xlim=(0, 1), ylim=(0, 1.02), aspect="equal")
    axes.set_xticks([0, 0.5, 1], ["0", "50 %", "100 %"])
    axes.set_yticks([0, 0.5, 1], ["0", "50 %", "100 %"])


@styled
def friction_figure(audit: Audit) -> Figure:
    """Polar plot of friction relative to Coulomb's by direction of motion; dashes show where it points."""
    figure = Figure(figsize=(4.6, 4.6), layout="constrained")
    axes = figure.add_subplot(projection="polar")
    angle = np.arctan2(*audit.answers.direction.T[::-1])
    size = np.linalg.norm(audit.answers.friction, axis=1)
    around = np.linspace(0, 2 * np.pi, 361)
    axes.plot(around, np.ones_like(around), color=FAINT, linewidth=1.0, label="Coulomb's law")
    place = audit.answers.direction * size[:, None]
    for at, force in zip(place, -audit.answers.friction, strict=True):
        tip = at + 0.25 * force
        ends = np.array([at, tip])
        axes.plot(np.arctan2(ends[:, 1], ends[:, 0]), np.hypot(*ends.T), color=FINGER, linewidth=1.0)
    axes.plot([], [], color=FINGER, linewidth=1.0, label="direction of friction, reversed")
    axes.plot(angle, size, "o", color=BELIEF, markersize=4, label=audit.name)
    axes.set_ylim(0, max(1.5, 1.1 * size.max() + 0.25))
    axes.set_yticks([0.5, 1.0, 1.5])
    axes.grid(color="#e7e4dd", linewidth=0.6)
    axes.spines["polar"].set_color("#e7e4dd")
    axes.legend(loc="upper left", bbox_to_anchor=(-0.1, 1.1))
    return figure


@styled
def ends_figure(audit: Audit) -> Figure:
    """The four pushes that end farthest from Coulomb's law: start, end by the law, end in the engine."""
    figure = Figure(figsize=(7.2, 2.2), layout="constrained")
    worst = np.argsort(audit.pushed.errors)[::-1][:4]
    for axes, k in zip(figure.subplots(1, 4), worst, strict=True):
        grid, standard = audit.standard.scene.grid, audit.standard
        draw_outline(axes, grid, standard.starts[k], color=FAINT)
        draw_outline(axes, grid, audit.pushed.ends[k], color=BELIEF, width=1.8)
        draw_outline(axes, grid, standard.law[k], color=INK, width=0.8)
        axes.set_aspect("equal")
        axes.autoscale()
        axes.axis("off")
        axes.set_title(f"{1e3 * audit.pushed.errors[k]:.1f} mm")
        left, right = axes.get_xlim()
        scale_bar(axes, (left, axes.get_ylim()[0]), right - left)
    return figure


@styled
def prices_figure(prices: Mapping[str, float]) -> Figure:
    """Bars of each engine's price (m): mean distance from Coulomb's law at the ends of pushes."""
    figure = Figure(figsize=(7.2, 0.5 + 0.28 * len(prices)), layout="constrained")
    axes = figure.add_subplot()
    values = 1e3 * np.array(list(prices.values()))
    axes.barh(list(prices), values, color=BELIEF, height=0.6)
    for place, value in enumerate(values):
        axes.annotate(
            f"{value:.2f}", (value, place), (3, 0), textcoords="offset points", va="center", fontsize=8
        )
    axes.invert_yaxis()
    axes.set_xlim(0, 1.12 * max(values.max(), 0.1))
    axes.set_xlabel("price: mean distance from Coulomb's law at the end of a push, mm")
    light_grid(axes, "x")
    return figure
