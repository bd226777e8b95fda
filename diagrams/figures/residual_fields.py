"""Residual velocities and forces as fields: over the table, and over the object where it was touched."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch

from diagrams.figures.outlines import outline_path, round_length
from diagrams.figures.residual_means import LEAST_PUSHES, NAMES, UNITS, push_means, wanted
from diagrams.figures.style import FAINT, INK, PAPER, styled
from models.inference.comparison import Comparison
from models.inference.residual_structure import NEGLIGIBLE
from models.physics.cell_grid import CellGrid, FloatArray

FIELD = (4.5, 4.1)  # inches
TABLE_BINS = 7
OUTLINE_BINS = 14
MOST_ARROWS = 60
COLOURS = "PuOr_r"


@styled
def table_figure(comparison: Comparison, quantity: str = "motion") -> Figure:
    """Residuals over the table: an arrow is the mean of one push, or of a place where there are many pushes.

    For motion the colour is the turning; for force faint arrows are the pieces of the pushes.

    Raises:
        ValueError: the comparison has no such residuals.
    """
    residuals = wanted(comparison, quantity)
    at, values = residuals.at, 100 * residuals.relative
    figure, axes = _field(quantity)
    low, high = at.place.min(axis=0), at.place.max(axis=0)
    size = max(float((high - low).max()), 1e-3)
    cell = size / TABLE_BINS
    column = np.floor((at.place - low) / cell).astype(int)
    many = len(np.unique(at.push)) > MOST_ARROWS
    key = column[:, 0] * 1000 + column[:, 1] if many else at.push
    arrows = _arrows(key, at.place, values, at.push, residuals.weights, 2 if many else 1)
    scale = _arrow_scale(values[:, :2], arrows, quantity)
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
    figure, axes = _field(quantity)
    shape = outline_path(grid)
    axes.add_patch(PathPatch(shape, facecolor=PAPER, edgecolor=FAINT, linewidth=0.9))
    low, high = grid.exterior.min(axis=0), grid.exterior.max(axis=0)
    size = float((high - low).max())
    cell = size / TABLE_BINS
    place = np.floor((at.contact - low + 1e-9) / (size / OUTLINE_BINS)).astype(int)
    key = place[:, 0] * 1000 + place[:, 1]
    arrows = _arrows(key, at.contact, values, at.push, residuals.weights[touched], LEAST_PUSHES)
    scale = _arrow_scale(values[:, :2], arrows, quantity)
    _draw_pieces(axes, at.contact, values, scale * cell)
    mappable = _draw_means(axes, arrows, scale * cell, quantity)
    middle, half = (low + high) / 2, 0.5 * size + 1.3 * cell
    _frame(axes, middle, half)
    axes.set(xlabel="object x, m", ylabel="object y, m")
    _finish(figure, axes, mappable, scale, cell, quantity)
    axes.set_title(f"{NAMES[quantity].capitalize()} at the contact, object's frame", loc="left", fontsize=9.5)
    return figure


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
    limit = max(float(np.abs(values[:, 2]).max()), 200 * NEGLIGIBLE[quantity])
    norm = Normalize(-limit, limit)
    axes.quiver(
        *place.T, *(length * values[:, :2]).T, values[:, 2], cmap=COLOURS, norm=norm, edgecolor=INK,
        linewidth=0.6, **style,
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
        bar = figure.colorbar(mappable, cax=figure.add_axes((0.85, 0.25, 0.025, 0.55)))
        bar.set_label("turning, % (+ counter-clockwise)", fontsize=8)
        bar.outline.set_linewidth(0.5)
        bar.ax.tick_params(labelsize=7.5)
