"""Where a model fails: residual velocities and forces over the table, over the object, and by conditions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch

from diagrams.figures.comparison import MODEL_COLOURS
from diagrams.figures.outlines import outline_path
from diagrams.figures.style import FAINT, INK, PAPER, styled
from models.inference.comparison import Comparison
from models.inference.push_conditions import PHASE_NAMES, Conditions
from models.inference.residual_factors import FORCE_FACTORS, MOTION_FACTORS
from models.inference.residual_structure import Pattern
from models.inference.residuals import Residuals
from models.measurements import PushDataset
from models.physics.cell_grid import CellGrid, FloatArray

PANEL = (4.5, 3.1)  # inches
FIELD = (4.5, 4.1)
TABLE_BINS = 7
OUTLINE_BINS = 14
LEAST_PUSHES = 2
MOST_ARROWS = 60
COLOURS = "PuOr_r"
UNITS = {"motion": "% of the speed", "force": "% of the force"}
NAMES = {"motion": "residual velocity", "force": "residual force"}


def residuals_of(comparison: Comparison, quantity: str) -> Residuals | None:
    """Residual velocities (`motion`) or forces (`force`) of a comparison."""
    return comparison.motion if quantity == "motion" else comparison.force


@styled
def table_figure(comparison: Comparison, quantity: str = "motion") -> Figure:
    """Residuals over the table: an arrow is the mean of one push, or of a place where there are many pushes.

    For motion the colour is the turning; for force faint arrows are the pieces of the pushes.

    Raises:
        ValueError: the comparison has no such residuals.
    """
    residuals = _wanted(comparison, quantity)
    at, values = residuals.at, 100 * residuals.relative
    figure, axes = _field(quantity)
    low, high = at.place.min(axis=0), at.place.max(axis=0)
    size = max(float((high - low).max()), 1e-3)
    cell = size / TABLE_BINS
    column = np.floor((at.place - low) / cell).astype(int)
    many = len(np.unique(at.push)) > MOST_ARROWS
    key = column[:, 0] * 1000 + column[:, 1] if many else at.push
    arrows = _arrows(key, at.place, values, at.push, residuals.weights, 2 if many else 1)
    scale = _arrow_scale(values[:, :2], arrows)
    _draw_pieces(axes, at.place, values, scale * cell)
    mappable = _draw_means(axes, arrows, scale * cell, quantity)
    margin = 0.6 * cell
    middle = (low + high) / 2
    half = max(size / 2 + margin, 1e-3)
    _frame(axes, middle, half)
    axes.set(xlabel="table x, m", ylabel="table y, m")
    _finish(figure, axes, mappable, scale, cell, quantity)
    axes.set_title(f"{NAMES[quantity].capitalize()} over the table", loc="left", fontsize=9.5)
    return figure


@styled
def object_figure(comparison: Comparison, grid: CellGrid, quantity: str = "motion") -> Figure:
    """Residuals seen from the object, drawn where the finger touched; arrows are means of two pushes or more.

    Raises:
        ValueError: the comparison has no such residuals, or nothing was touched.
    """
    residuals = _wanted(comparison, quantity)
    touched = np.isfinite(residuals.at.contact).all(axis=1)
    if not touched.any():
        raise ValueError("no finger touches the object in these pushes")
    at = residuals.at.rows(touched)
    values = 100 * residuals.relative[touched]
    c, s = np.cos(at.angle), np.sin(at.angle)
    values[:, :2] = np.column_stack(
        [c * values[:, 0] + s * values[:, 1], c * values[:, 1] - s * values[:, 0]]
    )
    figure, axes = _field(quantity)
    shape = outline_path(grid)
    axes.add_patch(PathPatch(shape, facecolor=PAPER, edgecolor=FAINT, linewidth=0.9))
    low, high = grid.exterior.min(axis=0), grid.exterior.max(axis=0)
    size = float((high - low).max())
    cell = size / TABLE_BINS
    place = np.floor((at.contact - low + 1e-9) / (size / OUTLINE_BINS)).astype(int)
    key = place[:, 0] * 1000 + place[:, 1]
    arrows = _arrows(key, at.contact, values, at.push, residuals.weights[touched], LEAST_PUSHES)
    scale = _arrow_scale(values[:, :2], arrows)
    _draw_pieces(axes, at.contact, values, scale * cell)
    mappable = _draw_means(axes, arrows, scale * cell, quantity)
    middle, half = (low + high) / 2, 0.5 * size + 1.3 * cell
    _frame(axes, middle, half)
    axes.set(xlabel="object x, m", ylabel="object y, m")
    _finish(figure, axes, mappable, scale, cell, quantity)
    axes.set_title(f"{NAMES[quantity].capitalize()} at the contact, object's frame", loc="left", fontsize=9.5)
    return figure


CONDITIONS: dict[str, tuple[str, Callable[[Conditions], FloatArray]]] = {
    "speed": ("speed, mm/s", lambda at: 1e3 * at.speed),
    "table_direction": ("direction of motion on the table", lambda at: np.degrees(at.table_direction)),
    "object_direction": (
        "direction of motion seen from the object",
        lambda at: np.degrees(at.object_direction),
    ),
    "phase": ("phase of the push", lambda at: at.phase.astype(float)),
    "time": ("time within the push, %", lambda at: 100 * at.share),
    "order": ("push, in the order of the experiment", lambda at: 1.0 + at.push),
}
"""Factors with one number to draw residuals against."""


@styled
def factor_figure(comparisons: Sequence[Comparison], factor: str, quantity: str = "motion") -> Figure:
    """Residuals against one condition: that component of them that deviates most in the first comparison.

    Dots are pushes (a push counts once in a bin), bars the mean over pushes with its 95 % interval.

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
    axes = figure.add_axes((0.14, 0.18, 0.83, 0.68))
    axes.axhline(0.0, color=INK, linewidth=0.8)
    first = _wanted(comparisons[0], quantity)
    edges = _edges(factor, condition(first.at))
    for k, comparison in enumerate(comparisons):
        residuals = _wanted(comparison, quantity)
        values = 100 * _component(residuals, factor, quantity, component)
        shift = (k - 0.5 * (len(comparisons) - 1)) * 0.12
        _bins(axes, condition(residuals.at), values, residuals, edges, MODEL_COLOURS[k], shift)
    _ticks(axes, factor)
    axes.set(xlabel=label, ylabel=UNITS[quantity])
    axes.set_title(f"{NAMES[quantity].capitalize()}, {component}", loc="left", fontsize=9.5)
    axes.grid(axis="y", color="#e7e4dd", linewidth=0.6)
    axes.set_axisbelow(True)
    return figure


def residual_figures(comparisons: Sequence[Comparison], dataset: PushDataset) -> dict[str, Figure]:
    """Every picture that these comparisons allow, by `<quantity>.<factor>`.

    Args:
        comparisons: one model, or two over the same pushes.
        dataset: for the outline.
    """
    figures: dict[str, Figure] = {}
    for quantity in ("motion", "force"):
        for k, comparison in enumerate(comparisons):
            residuals = residuals_of(comparison, quantity)
            if residuals is None:
                continue
            ending = "" if k == 0 else ".second"
            figures[f"{quantity}.table_place{ending}"] = table_figure(comparison, quantity)
            if np.isfinite(residuals.at.contact).all(axis=1).any():
                figures[f"{quantity}.contact_place{ending}"] = object_figure(comparison, dataset.grid, quantity)
        for factor in CONDITIONS:
            if pattern_of(comparisons[0], factor, quantity) is not None:
                figures[f"{quantity}.{factor}"] = factor_figure(comparisons, factor, quantity)
    return figures


def pattern_of(comparison: Comparison, factor: str, quantity: str) -> Pattern | None:
    """What was found for one factor, or None where it was not looked at."""
    for pattern in comparison.structure:
        if (pattern.factor, pattern.quantity) == (factor, quantity):
            return pattern
    return None


def _wanted(comparison: Comparison, quantity: str) -> Residuals:
    residuals = residuals_of(comparison, quantity)
    if residuals is None:
        raise ValueError(f"{comparison.label}: there are no residuals of {quantity} in these pushes")
    return residuals


def _component(residuals: Residuals, factor: str, quantity: str, component: str) -> FloatArray:
    (chosen,) = [f for f in (MOTION_FACTORS if quantity == "motion" else FORCE_FACTORS) if f.name == factor]
    for _, components in chosen.blocks:
        columns = components(residuals)
        if component in columns:
            return columns[component]
    raise ValueError(f"{factor} has no component {component!r}")


def _edges(factor: str, x: FloatArray) -> FloatArray:
    if factor == "phase":
        return np.arange(len(PHASE_NAMES) + 1) - 0.5
    if factor.endswith("direction"):
        return np.linspace(-180, 180, 9)
    if factor == "order":
        return np.linspace(x.min() - 0.5, x.max() + 0.5, min(9, int(np.ptp(x)) + 2))
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
        means = _push_means(values[here][:, None], residuals.at.push[here], residuals.weights[here])[:, 0]
        if len(means) == 0:
            continue
        middle = 0.5 * (edges[k] + edges[k + 1]) + shift * (edges[k + 1] - edges[k])
        axes.plot(np.full(len(means), middle), means, ".", color=colour, alpha=0.3, markersize=5, mew=0)
        if len(means) < LEAST_PUSHES:
            continue
        half = 1.96 * means.std(ddof=1) / np.sqrt(len(means))
        axes.errorbar(
            [middle], [means.mean()], [half], fmt="o", color=colour, markersize=5, elinewidth=1.8, capsize=0
        )
    reach = np.quantile(np.abs(values), 0.97) if len(values) else 1.0
    low, high = axes.get_ylim()
    axes.set_ylim(max(low, -1.6 * reach), min(high, 1.6 * reach))


def _ticks(axes: Axes, factor: str) -> None:
    if factor == "phase":
        names = [name.replace("pushing, contact", "contact") for name in PHASE_NAMES.values()]
        axes.set_xticks(range(len(names)), names, fontsize=8)
        axes.set_xlim(-0.5, len(names) - 0.5)
    elif factor.endswith("direction"):
        name = factor.split("_")[0]
        axes.set_xticks([-180, -90, 0, 90, 180], ["-x", "-y", "+x", "+y", "-x"])
        axes.set_xlabel(f"direction of motion, {name}'s axes")
        axes.set_xlim(-185, 185)


def _push_means(values: FloatArray, push: np.ndarray, weights: FloatArray) -> FloatArray:
    """(m, c) weighted mean of each push that occurs."""
    return np.array(
        [np.average(values[push == b], axis=0, weights=weights[push == b]) for b in np.unique(push)]
    ).reshape(-1, values.shape[1])


def _arrows(
    key: np.ndarray, place: FloatArray, values: FloatArray, push: np.ndarray, weights: FloatArray, least: int
) -> list[tuple[FloatArray, FloatArray]]:
    """Mean place and mean value over pushes of each bin that at least so many pushes passed."""
    arrows = []
    for bin_key in np.unique(key):
        here = key == bin_key
        if len(np.unique(push[here])) >= least:
            means = _push_means(np.hstack([place, values])[here], push[here], weights[here]).mean(axis=0)
            arrows.append((means[:2], means[2:]))
    return arrows


def _arrow_scale(values: FloatArray, arrows: list[tuple[FloatArray, FloatArray]]) -> float:
    """Bins that an arrow of 1 % is long: a large mean fills one bin."""
    sizes = [np.hypot(*value[:2]) for _, value in arrows] or list(np.hypot(*values.T))
    return 0.95 / max(float(np.quantile(sizes, 0.9)), 1e-9)


def _draw_pieces(axes: Axes, place: FloatArray, values: FloatArray, length: float) -> None:
    """Pieces of pushes: faint arrows of forces; of motion, whose pieces are noisy, only their places."""
    if values.shape[1] == 3:
        axes.plot(*place.T, ".", color=FAINT, alpha=0.35, markersize=2.5, markeredgewidth=0)
        return
    axes.quiver(
        *place.T, *(length * values).T, angles="xy", scale_units="xy", scale=1, color=FAINT, alpha=0.35,
        width=0.0022, headwidth=3.5, headlength=4,
    )  # fmt: skip


def _draw_means(
    axes: Axes, arrows: list[tuple[FloatArray, FloatArray]], length: float, quantity: str
) -> ScalarMappable | None:
    if not arrows:
        return None
    place = np.array([a for a, _ in arrows])
    values = np.array([v for _, v in arrows])
    style = dict(angles="xy", scale_units="xy", scale=1, width=0.008, headwidth=3.6, headlength=4, zorder=3)
    if quantity == "force":
        axes.quiver(*place.T, *(length * values[:, :2]).T, color=INK, **style)
        return None
    limit = max(float(np.abs(values[:, 2]).max()), 1e-9)
    norm = Normalize(-limit, limit)
    axes.quiver(
        *place.T, *(length * values[:, :2]).T, values[:, 2], cmap=COLOURS, norm=norm, edgecolor=INK, linewidth=0.6,
        **style,
    )  # fmt: skip
    return ScalarMappable(norm, COLOURS)


def _field(quantity: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=FIELD)
    axes = figure.add_axes((0.15, 0.16, 0.66 if quantity == "motion" else 0.74, 0.75))
    axes.tick_params(labelsize=7.5)
    return figure, axes


def _frame(axes: Axes, middle: FloatArray, half: float) -> None:
    """Limits around what is drawn, with room below for the arrow that gives the scale."""
    axes.set(xlim=middle[0] + half * np.array([-1, 1]), ylim=middle[1] + half * np.array([-1.22, 1]))
    axes.set_aspect("equal")


def _finish(
    figure: Figure, axes: Axes, mappable: ScalarMappable | None, scale: float, cell: float, quantity: str
) -> None:
    percent = _round(0.8 / scale)
    x0, x1 = axes.get_xlim()
    y0, y1 = axes.get_ylim()
    start = np.array([x0 + 0.03 * (x1 - x0), y0 + 0.03 * (y1 - y0)])
    axes.quiver(
        *start, scale * cell * percent, 0, angles="xy", scale_units="xy", scale=1, color=INK, width=0.008,
        headwidth=3.6, headlength=4,
    )  # fmt: skip
    axes.annotate(
        f"{percent:g} {UNITS[quantity]}", start, (0, 5), textcoords="offset points", fontsize=8, va="bottom"
    )
    if mappable is not None:
        bar = figure.colorbar(mappable, cax=figure.add_axes((0.85, 0.25, 0.025, 0.55)))
        bar.set_label("turning, % (+ counter-clockwise)", fontsize=8)
        bar.outline.set_linewidth(0.5)
        bar.ax.tick_params(labelsize=7.5)


def _round(value: float) -> float:
    power = 10.0 ** np.floor(np.log10(max(value, 1e-12)))
    return float(max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)) * power)
