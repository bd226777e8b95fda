"""Residuals against one condition: speed, direction, phase, time, order."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diagrams.figures.comparison import MODEL_COLOURS
from diagrams.figures.residual_means import LEAST_PUSHES, NAMES, UNITS, pattern_of, push_means, wanted
from diagrams.figures.style import INK, PAPER, styled
from models.inference.comparison import Comparison
from models.inference.push_conditions import PHASE_NAMES, Conditions
from models.inference.residual_factors import FORCE_FACTORS, MOTION_FACTORS
from models.inference.residual_structure import NEGLIGIBLE
from models.inference.residuals import Residuals
from models.physics.cell_grid import FloatArray

PANEL = (3.65, 2.8)  # inches
PUSHES_TOGETHER, MOST_BINS = 3, 8
"""Pushes in a row that share a bin at least, and bins of the whole experiment at most."""

CONDITIONS: dict[str, tuple[str, Callable[[Conditions], FloatArray]]] = {
    "speed": ("speed, mm/s", lambda at: np.array(1e3 * at.speed)),
    "table_direction": ("direction of motion on the table", lambda at: np.degrees(at.table_direction)),
    "object_direction": (
        "direction of motion seen from the object",
        lambda at: np.degrees(at.object_direction),
    ),
    "phase": ("phase of the push", lambda at: at.phase.astype(float)),
    "time": ("time within the push, %", lambda at: np.array(100 * at.share)),
    "order": ("push, in the order of the experiment", lambda at: np.array(1.0 + at.push)),
}
"""Factors with one number to draw residuals against."""


@styled
def factor_figure(comparisons: Sequence[Comparison], factor: str, quantity: str = "motion") -> Figure:
    """Residuals against one condition: that component of them that deviates most in the first comparison.

    Pale dots are pushes (a push counts once in a bin, at its own condition), bars the mean over pushes with
    its 95 % interval, where a bin has several pushes. The band is what counts as negligible.

    Args:
        comparisons: one model, or two over the same pushes.
        factor: one of `CONDITIONS`.
        quantity: `motion` or `force`.

    Raises:
        ValueError: a factor without a number to draw against, or one that was not looked at.
    """
    if factor not in CONDITIONS:
        raise ValueError(f"unknown factor {factor!r}; choose one of {', '.join(CONDITIONS)}")
    pattern = pattern_of(comparisons[0], factor, quantity)
    if pattern is None:
        raise ValueError(f"{comparisons[0].label}: {factor} of {quantity} was not looked at")
    component = pattern.strongest.split(", ")[0]
    label, condition = CONDITIONS[factor]
    figure = Figure(figsize=PANEL)
    axes = figure.add_axes((0.16, 0.21, 0.82, 0.68))
    axes.axhline(0.0, color=INK, linewidth=0.8)
    small = 100 * NEGLIGIBLE[quantity]
    axes.axhspan(-small, small, color=PAPER, linewidth=0, zorder=0)
    first = wanted(comparisons[0], quantity)
    edges = _edges(factor, condition(first.at))
    for k, comparison in enumerate(comparisons):
        residuals = wanted(comparison, quantity)
        values = 100 * _component(residuals, factor, quantity, component)
        shift = (k - 0.5 * (len(comparisons) - 1)) * 0.12
        _bins(axes, condition(residuals.at), values, residuals, edges, MODEL_COLOURS[k], shift)
    _ticks(axes, factor)
    axes.set(xlabel=label, ylabel=UNITS[quantity])
    axes.set_title(f"{NAMES[quantity].capitalize()}, {component}", loc="left", fontsize=9.5)
    axes.grid(axis="y", color="#e7e4dd", linewidth=0.6)
    axes.set_axisbelow(True)
    return figure


def _component(residuals: Residuals, factor: str, quantity: str, component: str) -> FloatArray:
    (chosen,) = [f for f in (MOTION_FACTORS if quantity == "motion" else FORCE_FACTORS) if f.name == factor]
    for _, components in chosen.blocks:
        columns = components(residuals)
        if component in columns:
            return columns[component]
    raise ValueError(f"{factor} has no component {component!r}")


def _edges(factor: str, x: FloatArray) -> FloatArray:
    if factor == "phase":
        return np.linspace(-0.5, len(PHASE_NAMES) - 0.5, len(PHASE_NAMES) + 1)
    if factor.endswith("direction"):
        return np.linspace(-180, 180, 9)
    if factor == "order":
        bins = int(np.clip(len(np.unique(x)) // PUSHES_TOGETHER, 1, MOST_BINS))
        return np.linspace(x.min() - 0.5, x.max() + 0.5, bins + 1)
    return np.unique(np.quantile(x, np.linspace(0, 1, 7)))


def _bins(
    axes: Axes, x: FloatArray, values: FloatArray, residuals: Residuals, edges: FloatArray, colour: str,
    shift: float,
) -> None:  # fmt: skip
    if len(edges) < 2:
        return
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    for k in range(len(edges) - 1):
        here = place == k
        pairs = np.column_stack([x, values])[here]
        at, means = push_means(pairs, residuals.at.push[here], residuals.weights[here]).T
        if len(means) == 0:
            continue
        at = at + shift * (edges[k + 1] - edges[k])
        axes.plot(at, means, ".", color=colour, alpha=0.45, markersize=8, mew=0)
        if len(means) < LEAST_PUSHES:
            continue
        half = 1.96 * means.std(ddof=1) / np.sqrt(len(means))
        axes.errorbar(
            [at.mean()],
            [means.mean()],
            [half],
            fmt="o",
            color=colour,
            markersize=5,
            elinewidth=1.8,
            capsize=0,
        )
    reach = float(np.quantile(np.abs(values), 0.97)) if len(values) else 1.0
    low, high = axes.get_ylim()
    axes.set_ylim(max(low, -1.6 * reach), min(high, 1.6 * reach))


def _ticks(axes: Axes, factor: str) -> None:
    if factor == "phase":
        names = [name.removeprefix("pushing, ").replace(" ", "\n") for name in PHASE_NAMES.values()]
        axes.set_xticks(range(len(names)), names)
        axes.set_xlim(-0.5, len(names) - 0.5)
    elif factor.endswith("direction"):
        name = factor.split("_")[0]
        axes.set_xticks([-180, -90, 0, 90, 180], ["-x", "-y", "+x", "+y", "-x"])
        axes.set_xlabel(f"direction of motion, {name}'s axes")
        axes.set_xlim(-185, 185)
