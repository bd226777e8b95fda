"""Residual velocities and forces as fields: over the table, and over the object where it was touched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.ticker import MaxNLocator

from diagrams.figures.outlines import outline_path, round_length
from diagrams.figures.residual_means import LEAST_PUSHES, NAMES, UNITS, push_means, wanted
from diagrams.figures.style import FAINT, INK, PAPER, styled
from models.inference.comparison import Comparison
from models.inference.residual_structure import NEGLIGIBLE
from models.physics.cell_grid import CellGrid, FloatArray

FIELD = (3.65, 3.4)  # inches
TABLE_BINS = 7
OUTLINE_BINS = 10
MOST_ARROWS = 60
COLOURS = "PuOr_r"
SCALED = 0.95
"""Share of the arrows on the colour scale; a single push that turns would leave all others pale."""


@dataclass(frozen=True, eq=False)
class _Field:
    """Residuals (%) by place, their means as arrows, and the side of a bin, in which arrows are measured."""

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
    """Residuals over the table: an arrow is the mean of one push, or of a place where there are many pushes.

    For motion the colour is the turning; for force faint arrows are the pieces of the pushes. Figures that
    are drawn with the same models `beside` have the same scales.

    Raises:
        ValueError: the comparison has no such residuals.
    """
    field = _on_table(comparison, quantity)
    half = max(float((field.high - field.low).max()) / 2 + 0.6 * field.bin, 1e-3)
    fields = [field, *(_on_table(other, quantity) for other in beside if other is not comparison)]
    figure, axes = _drawn(fields, quantity, half)
    axes.set(xlabel="table x, m", ylabel="table y, m")
    axes.set_title(f"{NAMES[quantity].capitalize()} over the table", loc="left", fontsize=9.5)
    return figure


@styled
def object_figure(
    comparison: Comparison, grid: CellGrid, quantity: str = "motion", beside: Sequence[Comparison] = ()
) -> Figure:
    """Residuals seen from the object, drawn where the finger touched; arrows are means of two pushes or more.

    Figures that are drawn with the same models `beside` have the same scales.

    Raises:
        ValueError: the comparison has no such residuals, or nothing was touched.
    """
    field = _on_object(comparison, grid, quantity)
    half = 0.5 * float((field.high - field.low).max()) + 1.3 * field.bin
    fields = [field, *(_on_object(other, grid, quantity) for other in beside if other is not comparison)]
    figure, axes = _drawn(fields, quantity, half)
    axes.add_patch(PathPatch(outline_path(grid), facecolor=PAPER, edgecolor=FAINT, linewidth=0.9, zorder=0))
    axes.set(xlabel="object x, m", ylabel="object y, m")
    axes.set_title(f"{NAMES[quantity].capitalize()} at the contact", loc="left", fontsize=9.5)
    return figure


def _on_table(comparison: Comparison, quantity: str) -> _Field:
    residuals = wanted(comparison, quantity)
    at, values = residuals.at, 100 * residuals.relative
    low, high = at.place.min(axis=0), at.place.max(axis=0)
    side = max(float((high - low).max()), 1e-3) / TABLE_BINS
    column = np.floor((at.place - low) / side).astype(int)
    many = len(np.unique(at.push)) > MOST_ARROWS
    key = column[:, 0] * 1000 + column[:, 1] if many else at.push
    arrows = _arrows(key, at.place, values, at.push, residuals.weights, 2 if many else 1)
    return _Field(at.place, values, arrows, low, high, side)


def _on_object(comparison: Comparison, grid: CellGrid, quantity: str) -> _Field:
    residuals = wanted(comparison, quantity)
    touched = np.array(np.isfinite(residuals.at.contact).all(axis=1))
    if not touched.any():
        raise ValueError("no finger touches the object in these pushes")
    at = residuals.at.rows(touched)
    values = 100 * residuals.relative[touched]
    c, s = np.cos(at.angle), np.sin(at.angle)
    values[:, :2] = np.column_stack(
        [c * values[:, 0] + s * values[:, 1], c * values[:, 1] - s * values[:, 0]]
    )
    low, high = grid.exterior.min(axis=0), grid.exterior.max(axis=0)
    size = float((high - low).max())
    place = np.floor((at.contact - low + 1e-9) / (size / OUTLINE_BINS)).astype(int)
    key = place[:, 0] * 1000 + place[:, 1]
    arrows = _arrows(key, at.contact, values, at.push, residuals.weights[touched], LEAST_PUSHES)
    return _Field(at.contact, values, arrows, low, high, size / OUTLINE_BINS)


def _drawn(fields: Sequence[_Field], quantity: str, half: float) -> tuple[Figure, Axes]:
    """The first of some fields, so that all of them would have the same scales."""
    field = fields[0]
    figure, axes = _new_figure(quantity)
    scale = min(_arrow_scale(other.values[:, :2], other.arrows, quantity) for other in fields)
    turning = [abs(float(value[2])) for other in fields for _, value in other.arrows if len(value) > 2]
    _draw_pieces(axes, field.place, field.values, scale * field.bin)
    limit = max(float(np.quantile(turning or [0.0], SCALED)), 200 * NEGLIGIBLE[quantity])
    mappable = _draw_means(axes, field.arrows, scale * field.bin, quantity, limit)
    middle = (field.low + field.high) / 2
    # One large residual gives a long arrow, and its point is what it says.
    reach = [
        float(np.abs(place + scale * field.bin * value[:2] - middle).max()) for place, value in field.arrows
    ]
    _frame(axes, middle, max([half, *(1.05 * far for far in reach)]))
    _finish(figure, axes, mappable, scale, field.bin, quantity)
    return figure, axes


def _arrows(
    key: np.ndarray, place: FloatArray, values: FloatArray, push: np.ndarray, weights: FloatArray, least: int
) -> list[tuple[FloatArray, FloatArray]]:
    """Mean place and mean value over pushes of each bin that at least so many pushes passed."""
    arrows = []
    for bin_key in np.unique(key):
        here = key == bin_key
        if len(np.unique(push[here])) >= least:
            means = push_means(np.hstack([place, values])[here], push[here], weights[here]).mean(axis=0)
            arrows.append((means[:2], means[2:]))
    return arrows


def _arrow_scale(values: FloatArray, arrows: list[tuple[FloatArray, FloatArray]], quantity: str) -> float:
    """Bins that an arrow of 1 % is long: a large mean fills one bin, unless it is negligible."""
    sizes = [np.hypot(*value[:2]) for _, value in arrows] or list(np.hypot(*values.T))
    return 0.95 / max(float(np.quantile(sizes, 0.9)), 200 * NEGLIGIBLE[quantity])


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
    axes: Axes, arrows: list[tuple[FloatArray, FloatArray]], length: float, quantity: str, limit: float
) -> ScalarMappable | None:
    if not arrows:
        return None
    place = np.array([a for a, _ in arrows])
    values = np.array([v for _, v in arrows])
    style = dict(angles="xy", scale_units="xy", scale=1, width=0.008, headwidth=3.6, headlength=4, zorder=3)
    if quantity == "force":
        axes.quiver(*place.T, *(length * values[:, :2]).T, color=INK, **style)
        return None
    norm = Normalize(-limit, limit)
    axes.quiver(
        *place.T, *(length * values[:, :2]).T, values[:, 2], cmap=COLOURS, norm=norm, edgecolor=INK,
        linewidth=0.6, **style,
    )  # fmt: skip
    return ScalarMappable(norm, COLOURS)


def _new_figure(quantity: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=FIELD)
    axes = figure.add_axes((0.17, 0.16, 0.55 if quantity == "motion" else 0.74, 0.75))
    axes.tick_params(labelsize=8)
    axes.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    return figure, axes


def _frame(axes: Axes, middle: FloatArray, half: float) -> None:
    """Limits around what is drawn, with room below for the arrow that gives the scale."""
    axes.set(xlim=middle[0] + half * np.array([-1, 1]), ylim=middle[1] + half * np.array([-1.22, 1]))
    axes.set_aspect("equal")


def _finish(
    figure: Figure, axes: Axes, mappable: ScalarMappable | None, scale: float, cell: float, quantity: str
) -> None:
    percent = round_length(0.8 / scale)
    x0, x1 = axes.get_xlim()
    y0, y1 = axes.get_ylim()
    start = np.array([x0 + 0.03 * (x1 - x0), y0 + 0.03 * (y1 - y0)])
    axes.quiver(
        *start, scale * cell * percent, 0, angles="xy", scale_units="xy", scale=1, color=INK, width=0.008,
        headwidth=3.6, headlength=4,
    )  # fmt: skip
    axes.annotate(
        f"{percent:g} {UNITS[quantity]}",
        (start[0], start[1]),
        (0, 5),
        textcoords="offset points",
        fontsize=8,
        va="bottom",
    )
    if mappable is not None:
        bar = figure.colorbar(mappable, cax=figure.add_axes((0.755, 0.25, 0.03, 0.55)), extend="both")
        bar.locator = MaxNLocator(5, steps=[1, 2, 5, 10])
        bar.update_ticks()
        bar.set_label("turning, % (+ counter-clockwise)", fontsize=8)
        bar.outline.set_linewidth(0.5)
        bar.ax.tick_params(labelsize=8)
