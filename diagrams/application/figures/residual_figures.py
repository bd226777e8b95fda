"""Figures of where a model fails: residuals against conditions, as fields, and correlations over lags.

A condition is speed, direction, phase, time or order. Fields cover the table, or the object where it was
touched. The bounds of correlations come from resampling whole pushes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from slipmap.diagrams.application.figures.push_figures import MODEL_COLOURS
from slipmap.diagrams.application.figures.style import draw_outline, light_grid, round_length
from slipmap.diagrams.systems.look import FAINT, INK, PAPER, styled
from slipmap.models.geometry import rotated
from slipmap.models.inference.comparison import Comparison
from slipmap.models.inference.residual_structure import (
    FORCE_FACTORS,
    MOTION_FACTORS,
    NEGLIGIBLE,
    THEN,
    Pattern,
)
from slipmap.models.inference.residuals import PHASE_NAMES, Conditions, Residuals
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import CellGrid, FloatArray

_UNITS = {"motion": "% of the speed", "force": "% of the force"}
_NAMES = {"motion": "residual velocity", "force": "residual force"}
_LEAST_PUSHES = 2

_TITLES = {
    "memory": ("Residual with itself", "lag, s"),
    "finger_along": ("Residual with the finger's velocity", "lag of the residual, s"),
    "finger_left": ("…across the finger's velocity", "lag of the residual, s"),
}

_PANEL = (3.65, 2.8)  # inches
_PUSHES_TOGETHER, _MOST_BINS = 3, 8
"""Fewest successive pushes that share a bin, and most bins of the whole experiment."""

CONDITIONS: dict[str, tuple[str, Callable[[Conditions], FloatArray]]] = {
    "speed": ("speed, mm/s", lambda at: np.array(1e3 * at.speed)),
    "table_direction": ("direction of motion on the table", lambda at: np.degrees(at.table_direction)),
    "object_direction": (
        "direction of motion in the object frame",
        lambda at: np.degrees(at.object_direction),
    ),
    "phase": ("phase of the push", lambda at: at.phase.astype(float)),
    "time": ("time within the push, %", lambda at: np.array(100 * at.share)),
    "order": ("push number in the experiment", lambda at: np.array(1.0 + at.push)),
}
"""Factors that are a single number, against which residuals are drawn."""

_FIELD = (3.65, 3.4)  # inches
_TABLE_BINS = 7
_OUTLINE_BINS = 10
_MOST_ARROWS = 60
_COLOURS = "PuOr_r"
_SCALED = 0.95
"""Share of the arrows within the colour scale; one push that turns a lot would leave all others pale."""
_ARROW: dict[str, Any] = {
    "angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.008, "headwidth": 3.6, "headlength": 4,
}  # fmt: skip


def _wanted(comparison: Comparison, quantity: str) -> Residuals:
    """Residual velocities (`motion`) or forces (`force`). Raises ValueError where there are none."""
    residuals: Residuals | None = getattr(comparison, quantity)
    if residuals is None:
        raise ValueError(f"{comparison.label}: there are no residuals of {quantity} in these pushes")
    return residuals


def pattern_of(comparison: Comparison, factor: str, quantity: str) -> Pattern | None:
    """The pattern of one factor, or None where it was not tested."""
    tested = (p for p in comparison.structure if (p.factor, p.quantity) == (factor, quantity))
    return next(tested, None)


def _push_means(values: FloatArray, push: np.ndarray, weights: FloatArray) -> FloatArray:
    """(m, c) weighted mean over each push that occurs."""
    return np.array(
        [np.average(values[push == b], axis=0, weights=weights[push == b]) for b in np.unique(push)]
    ).reshape(-1, values.shape[1])


@styled
def correlation_figure(comparisons: Sequence[Comparison]) -> Figure:
    """Three correlations over lags; the band contains 95 % of chance results at all lags together.

    Raises:
        ValueError: the first comparison has no correlations.
    """
    if comparisons[0].correlations is None:
        raise ValueError(f"{comparisons[0].label}: too few pushes show their course for correlations")
    figure = Figure(figsize=(8.0, 2.7))
    panels = figure.subplots(1, 3, sharey=True)
    figure.subplots_adjust(left=0.085, right=0.99, top=0.88, bottom=0.2, wspace=0.1)
    for axes, (name, (title, label)) in zip(panels, _TITLES.items(), strict=True):
        for k, comparison in enumerate(comparisons):
            if comparison.correlations is None:
                continue
            found = getattr(comparison.correlations, name)
            if k == 0:
                axes.fill_between(found.lags, -found.bounds, found.bounds, color="#e9e5dc", linewidth=0)
            else:
                for side in (-1, 1):
                    axes.plot(found.lags, side * found.bounds, color=MODEL_COLOURS[k], linewidth=0.6)
            axes.plot(found.lags, found.values, color=MODEL_COLOURS[k], linewidth=1.8)
        axes.axhline(0.0, color=INK, linewidth=0.7)
        axes.set(ylim=(-1.02, 1.02), xlabel=label)
        axes.set_title(title, loc="left", fontsize=9.5)
        axes.margins(x=0)
        axes.xaxis.set_major_locator(MaxNLocator(5, prune="both" if name != "memory" else None))
        if name != "memory":
            axes.axvline(0.0, color=PAPER, linewidth=0.8, zorder=0)
    panels[0].set_ylabel("correlation")
    return figure


@styled
def factor_figure(comparisons: Sequence[Comparison], factor: str, quantity: str = "motion") -> Figure:
    """Residuals against one condition: the component that deviates most in the first comparison.

    Pale dots are pushes (each once per bin, at its own condition); bars are means over pushes with 95 %
    intervals, where a bin has several pushes. Residuals within the band are negligible.

    Args:
        comparisons: one model, or two over the same pushes.
        factor: one of `CONDITIONS`.
        quantity: `motion` or `force`.

    Raises:
        ValueError: the factor is not a single number, or was not tested.
    """
    if factor not in CONDITIONS:
        raise ValueError(f"unknown factor {factor!r}; choose one of {', '.join(CONDITIONS)}")
    pattern = pattern_of(comparisons[0], factor, quantity)
    if pattern is None:
        raise ValueError(f"{comparisons[0].label}: {factor} of {quantity} was not tested")
    component = pattern.strongest.split(THEN)[0]
    label, condition = CONDITIONS[factor]
    figure = Figure(figsize=_PANEL)
    axes = figure.add_axes((0.16, 0.21, 0.82, 0.68))
    axes.axhline(0.0, color=INK, linewidth=0.8)
    small = 100 * NEGLIGIBLE[quantity]
    axes.axhspan(-small, small, color=PAPER, linewidth=0, zorder=0)
    first = _wanted(comparisons[0], quantity)
    edges = _edges(factor, condition(first.at))
    (chosen,) = [f for f in (MOTION_FACTORS if quantity == "motion" else FORCE_FACTORS) if f.name == factor]
    for k, comparison in enumerate(comparisons):
        residuals = _wanted(comparison, quantity)
        values = 100 * chosen.components(residuals)[component]
        shift = (k - 0.5 * (len(comparisons) - 1)) * 0.12
        _bins(axes, condition(residuals.at), values, residuals, edges, MODEL_COLOURS[k], shift)
    _ticks(axes, factor)
    axes.set(xlabel=label, ylabel=f"residual, {_UNITS[quantity]}")
    axes.set_title(component[0].upper() + component[1:], loc="left", fontsize=9.5)
    light_grid(axes, "y")
    return figure


def _edges(factor: str, x: FloatArray) -> FloatArray:
    if factor == "phase":
        return np.linspace(-0.5, len(PHASE_NAMES) - 0.5, len(PHASE_NAMES) + 1)
    if factor.endswith("direction"):
        return np.linspace(-180, 180, 9)
    if factor == "order":
        bins = int(np.clip(len(np.unique(x)) // _PUSHES_TOGETHER, 1, _MOST_BINS))
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
        at, means = _push_means(pairs, residuals.at.push[here], residuals.weights[here]).T
        if len(means) == 0:
            continue
        at = at + shift * (edges[k + 1] - edges[k])
        axes.plot(at, means, ".", color=colour, alpha=0.45, markersize=8, mew=0)
        if len(means) < _LEAST_PUSHES:
            continue
        half = 1.96 * means.std(ddof=1) / np.sqrt(len(means))
        axes.errorbar(
            [at.mean()], [means.mean()], [half], fmt="o", color=colour, markersize=5, elinewidth=1.8,
            capsize=0,
        )  # fmt: skip


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


@dataclass(frozen=True, eq=False)
class _Field:
    """Residuals (%) by place, their means as arrows, and the width of a bin, the unit of arrow lengths."""

    place: FloatArray
    values: FloatArray
    arrows: list[tuple[FloatArray, FloatArray]]
    low: FloatArray
    high: FloatArray
    bin: float


@styled
def table_figure(
    comparison: Comparison, quantity: str = "motion", beside: Sequence[Comparison] = ()
) -> Figure:
    """Residuals over the table: an arrow is the mean of one push, or of one place if there are many pushes.

    For motion, the colour is the rotation; for force, faint arrows are pieces of pushes. Figures drawn with
    the same models `beside` have the same scales.

    Raises:
        ValueError: the comparison has no such residuals.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=1, heldout=1)
        >>> belief = slipmap.identify(dataset, hypotheses=2, friction_laws=False).belief
        >>> type(slipmap.figures.table_figure(slipmap.compare(dataset, belief))).__name__
        'Figure'
    """
    field = _on_table(comparison, quantity)
    fields = [field, *(_on_table(other, quantity) for other in beside if other is not comparison)]
    figure, axes = _drawn(fields, quantity, 0.6)
    axes.set(xlabel="table x, m", ylabel="table y, m")
    _name(axes, comparison, f"{_NAMES[quantity].capitalize()} over the table", fields)
    return figure


@styled
def object_figure(
    comparison: Comparison, grid: CellGrid, quantity: str = "motion", beside: Sequence[Comparison] = ()
) -> Figure:
    """Residuals in the object frame, drawn at the contact: an arrow is the mean of one push at one place, or
    of several pushes if there are many.

    Figures drawn with the same models `beside` have the same scales.

    Raises:
        ValueError: the comparison has no such residuals, or the finger touched nothing.
    """
    field = _on_object(comparison, grid, quantity)
    fields = [field, *(_on_object(other, grid, quantity) for other in beside if other is not comparison)]
    figure, axes = _drawn(fields, quantity, 1.3)
    draw_outline(axes, grid, color=FAINT, fill=PAPER, zorder=0)
    axes.set(xlabel="object x, m", ylabel="object y, m")
    _name(axes, comparison, f"{_NAMES[quantity].capitalize()} at the contact", fields)
    return figure


def _name(axes: Axes, comparison: Comparison, title: str, fields: Sequence[_Field]) -> None:
    """Write the title, with the model's label if there are several models."""
    axes.set_title(f"{title}\n{comparison.label}" if len(fields) > 1 else title, loc="left", fontsize=9.5)


def _on_table(comparison: Comparison, quantity: str) -> _Field:
    residuals = _wanted(comparison, quantity)
    at, values = residuals.at, 100 * residuals.relative
    low, high = at.place.min(axis=0), at.place.max(axis=0)
    side = max(float((high - low).max()), 1e-3) / _TABLE_BINS
    column = np.floor((at.place - low) / side).astype(int)
    many = len(np.unique(at.push)) > _MOST_ARROWS
    key = column[:, 0] * 1000 + column[:, 1] if many else at.push
    arrows = _arrows(key, at.place, values, at.push, residuals.weights, 2 if many else 1)
    return _Field(at.place, values, arrows, low, high, side)


def _on_object(comparison: Comparison, grid: CellGrid, quantity: str) -> _Field:
    residuals = _wanted(comparison, quantity)
    touched = np.array(np.isfinite(residuals.at.contact).all(axis=1))
    if not touched.any():
        raise ValueError("no finger touches the object in these pushes")
    at = residuals.at.rows(touched)
    values = 100 * residuals.relative[touched]
    values[:, :2] = rotated(values[:, :2], -at.angle)
    low, high = grid.exterior.min(axis=0), grid.exterior.max(axis=0)
    size = float((high - low).max())
    place = np.floor((at.contact - low + 1e-9) / (size / _OUTLINE_BINS)).astype(int)
    many = len(np.unique(at.push)) > _MOST_ARROWS
    key = place[:, 0] * 1000 + place[:, 1] + (0 if many else 1_000_000 * at.push)
    arrows = _arrows(key, at.contact, values, at.push, residuals.weights[touched], 2 if many else 1)
    return _Field(at.contact, values, arrows, low, high, size / _OUTLINE_BINS)


def _drawn(fields: Sequence[_Field], quantity: str, rim: float) -> tuple[Figure, Axes]:
    """Draw the first of some fields, on scales that suit all of them, with a rim (in bins) around."""
    field = fields[0]
    figure = Figure(figsize=_FIELD)
    width, height = 0.55 if quantity == "motion" else 0.74, 0.75 if len(fields) == 1 else 0.7
    axes = figure.add_axes((0.17, 0.16, width, height))
    axes.tick_params(labelsize=8)
    cell = max(other.bin for other in fields)
    axes.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    scale = min(_arrow_scale(other.values[:, :2], other.arrows, quantity) for other in fields)
    turning = [abs(float(value[2])) for other in fields for _, value in other.arrows if len(value) > 2]
    _draw_pieces(axes, field.place, field.values, scale * cell)
    limit = max(float(np.quantile(turning or [0.0], _SCALED)), 200 * NEGLIGIBLE[quantity])
    mappable = _draw_means(axes, field.arrows, scale * cell, quantity, limit)
    low = np.min([other.low for other in fields], axis=0) - rim * cell
    high = np.max([other.high for other in fields], axis=0) + rim * cell
    middle = (low + high) / 2
    # Tips of long arrows must be visible.
    tips = [place + scale * cell * value[:2] for other in fields for place, value in other.arrows]
    if quantity == "force":
        tips += [tip for other in fields for tip in other.place + scale * cell * other.values]
    reach = np.abs(np.array(tips).reshape(-1, 2) - middle).max(initial=0.0)
    half = max(float((high - low).max()) / 2, 1.05 * float(reach), 1e-3)
    # Leaves room below for the scale arrow.
    axes.set(xlim=middle[0] + half * np.array([-1, 1]), ylim=middle[1] + half * np.array([-1.22, 1]))
    axes.set_aspect("equal")
    _finish(figure, axes, mappable, scale, cell, quantity)
    return figure, axes


def _arrows(
    key: np.ndarray, place: FloatArray, values: FloatArray, push: np.ndarray, weights: FloatArray, least: int
) -> list[tuple[FloatArray, FloatArray]]:
    """Mean place and mean value over pushes of each bin that at least `least` pushes crossed."""
    arrows = []
    for bin_key in np.unique(key):
        here = key == bin_key
        if len(np.unique(push[here])) >= least:
            means = _push_means(np.hstack([place, values])[here], push[here], weights[here]).mean(axis=0)
            arrows.append((means[:2], means[2:]))
    return arrows


def _arrow_scale(values: FloatArray, arrows: list[tuple[FloatArray, FloatArray]], quantity: str) -> float:
    """Length of an arrow of 1 % in bins: a large mean fills one bin, unless it is negligible."""
    sizes = [np.hypot(*value[:2]) for _, value in arrows] or list(np.hypot(*values.T))
    return 0.95 / max(float(np.quantile(sizes, 0.9)), 200 * NEGLIGIBLE[quantity])


def _draw_pieces(axes: Axes, place: FloatArray, values: FloatArray, length: float) -> None:
    """Draw pieces of pushes: faint arrows for forces; only dots for motion, whose pieces are noisy."""
    if values.shape[1] == 3:
        axes.plot(*place.T, ".", color=FAINT, alpha=0.35, markersize=2.5, markeredgewidth=0)
        return
    thin = _ARROW | {"width": 0.0022, "headwidth": 3.5}
    axes.quiver(*place.T, *(length * values).T, color=FAINT, alpha=0.35, **thin)


def _draw_means(
    axes: Axes, arrows: list[tuple[FloatArray, FloatArray]], length: float, quantity: str, limit: float
) -> ScalarMappable | None:
    if not arrows:
        return None
    place = np.array([a for a, _ in arrows])
    values = np.array([v for _, v in arrows])
    if quantity == "force":
        axes.quiver(*place.T, *(length * values[:, :2]).T, color=INK, zorder=3, **_ARROW)
        return None
    norm = Normalize(-limit, limit)
    axes.quiver(
        *place.T, *(length * values[:, :2]).T, values[:, 2], cmap=_COLOURS, norm=norm, edgecolor=INK,
        linewidth=0.6, zorder=3, **_ARROW,
    )  # fmt: skip
    return ScalarMappable(norm, _COLOURS)


def _finish(
    figure: Figure, axes: Axes, mappable: ScalarMappable | None, scale: float, cell: float, quantity: str
) -> None:
    percent = round_length(0.8 / scale)
    x0, x1 = axes.get_xlim()
    y0, y1 = axes.get_ylim()
    start = np.array([x0 + 0.03 * (x1 - x0), y0 + 0.03 * (y1 - y0)])
    axes.quiver(*start, scale * cell * percent, 0, color=INK, **_ARROW)
    axes.annotate(
        f"{percent:g} {_UNITS[quantity]}", (start[0], start[1]), (0, 5), textcoords="offset points",
        fontsize=8, va="bottom",
    )  # fmt: skip
    if mappable is not None:
        bar = figure.colorbar(mappable, cax=figure.add_axes((0.755, 0.25, 0.03, 0.55)), extend="both")
        bar.locator = MaxNLocator(5, steps=[1, 2, 5, 10])
        bar.update_ticks()
        bar.set_label("rotation, % (+ counter-clockwise)", fontsize=8)
        bar.outline.set_linewidth(0.5)
        bar.ax.tick_params(labelsize=8)


def residual_figures(comparisons: Sequence[Comparison], dataset: PushDataset) -> dict[str, Figure]:
    """All figures that these comparisons allow, by `<quantity>.<factor>`."""
    figures: dict[str, Figure] = {}
    endings = {id(comparison): ".second" if k else "" for k, comparison in enumerate(comparisons)}
    for quantity in ("motion", "force"):
        known = [c for c in comparisons if getattr(c, quantity) is not None]
        touching = [c for c in known if np.isfinite(_wanted(c, quantity).at.contact).all(axis=1).any()]
        for one in known:
            figures[f"{quantity}.table_place{endings[id(one)]}"] = table_figure(one, quantity, known)
        for one in touching:
            figure = object_figure(one, dataset.grid, quantity, touching)
            figures[f"{quantity}.contact_place{endings[id(one)]}"] = figure
        for factor in CONDITIONS:
            if pattern_of(comparisons[0], factor, quantity) is not None:
                figures[f"{quantity}.{factor}"] = factor_figure(comparisons, factor, quantity)
    return figures
