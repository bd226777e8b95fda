"""Maps of mass, friction and their product, several hypotheses side by side, after the paper's Figure 2."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from slipmap.diagrams.application.figures import style
from slipmap.diagrams.systems.look import (
    BELIEF,
    INK,
    MAP_COLORS,
    PAPER,
    SCALED_SHARE,
    beyond,
    styled,
    top_of_scale,
)
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.results import Identification, belief_of
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps
from slipmap.models.settings import check_whole

_LEFT, _RIGHT, _TOP, _BOTTOM = 1.35, 1.05, 0.86, 0.5  # inches around the panels
_GAP, _WIDE_GAP = 0.12, 0.34
_LARGEST_PANEL = (1.7, 1.75)
_NARROWEST_COLUMN = 1.0  # inches; the titles need as much
_LOG_FROM = 6.0
"""Ratio of the columns' totals from which colours are logarithmic; a linear scale would show one map only."""

# Styles of the centres of mass and of friction, and of the centres of mass of all hypotheses.
_MARK = {"linestyle": "none", "markerfacecolor": "none"}
_CROSS: dict[str, Any] = _MARK | {"marker": "x", "color": INK, "markersize": 6, "markeredgewidth": 1.4}
_RING: dict[str, Any] = _MARK | {"marker": "o", "color": INK, "markersize": 7.5, "markeredgewidth": 1.2}
_DOT: dict[str, Any] = {
    "linestyle": "none", "marker": "o", "color": BELIEF, "markersize": 2.6, "markeredgewidth": 0
}  # fmt: skip
_SEAM = 2.0  # points


@dataclass(frozen=True, eq=False)
class _Row:
    """One quantity: name, unit, colours and values (columns, n)."""

    name: str
    unit: str
    colours: str
    values: FloatArray

    @property
    def norm(self) -> Normalize:
        """One scale for all columns; a few of the largest values may lie beyond it."""
        totals = self.values.sum(axis=1)
        if totals.max() > _LOG_FROM * totals.min() > 0:
            low, top = np.quantile(self.values, [0.02, SCALED_SHARE])
            return LogNorm(max(float(low), 1e-4 * float(top)), float(top))
        return Normalize(0.0, top_of_scale(self.values))


@dataclass(frozen=True, eq=False)
class _Column:
    """One model: title, maps (one), and whether a wide gap precedes it."""

    title: str
    maps: Maps
    apart: bool = False


@styled
def maps_figure(belief: Belief | Identification, *, truth: Maps | None = None, hypotheses: int = 6) -> Figure:
    """Footprint, mass, friction and mass × friction of the most probable hypotheses and of their mean.

    A cross marks the centre of mass, a ring the centre of friction (the mean position of the cells weighted
    by mass × friction). Dots in the first row are the centres of mass of all hypotheses.

    Hypotheses are numbered by decreasing probability, as in `slipmap view`.

    Args:
        belief: what to draw.
        truth: true maps (one model), drawn in their own column where known.
        hypotheses: how many to show, most probable first.

    Raises:
        TypeError, ValueError: something other than a belief, true maps of another grid or of several models,
            or a negative number of hypotheses.

    Example:
        >>> import slipmap
        >>> dataset, truth = slipmap.simulated_hammer(seed=1, fit=1, heldout=0)
        >>> belief = slipmap.identify(dataset, hypotheses=2, friction_laws=False).belief
        >>> len(slipmap.maps_figure(belief, truth=truth).axes) > 3
        True
    """
    belief = belief_of(belief)
    check_whole("maps_figure: hypotheses", hypotheses, 0)
    if truth is not None and truth.mass.shape != (1, len(belief.grid)):
        models, cells = truth.mass.shape
        raise ValueError(
            f"maps_figure: truth must be one model of the belief's {len(belief.grid)} cells, got {models} of"
            f" {cells}"
        )
    columns = _columns(belief, truth, hypotheses)
    mass = np.concatenate([column.maps.mass for column in columns])
    mu = np.concatenate([column.maps.mu for column in columns])
    in_grams = np.quantile(mass, 0.99) < 0.5
    scaled, unit = (1e3 * mass, "g per cell") if in_grams else (mass, "kg per cell")
    rows = [
        _Row("mass", unit, MAP_COLORS[0], scaled),
        _Row("friction\ncoefficient", "", MAP_COLORS[1], mu),
        _Row("mass × friction:\nforce to slide it", "N per cell", MAP_COLORS[2], mass * mu * belief.gravity),
    ]
    return _drawn(belief, columns, rows)


def _columns(belief: Belief, truth: Maps | None, hypotheses: int) -> list[_Column]:
    p = belief.probability
    order = np.argsort(-p, kind="stable")[:hypotheses]
    columns = [
        _Column(f"hypothesis {column + 1}\n{100 * p[k]:.1f} %", belief.maps[int(k)], apart=not column)
        for column, k in enumerate(order)
    ]
    mass, load = p @ belief.maps.mass, p @ (belief.maps.mass * belief.maps.mu)
    mean = Maps(mass[None], (load / np.maximum(mass, 1e-300))[None], np.array([p @ belief.maps.mu_finger]))
    columns.append(_Column(f"mean of\nall {len(belief)}", mean, apart=True))
    return columns if truth is None else [_Column("truth\n", truth), *columns]


def _drawn(belief: Belief, columns: list[_Column], rows: list[_Row]) -> Figure:
    low, high = belief.grid.exterior.min(axis=0), belief.grid.exterior.max(axis=0)
    margin = 0.06 * float((high - low).max())
    extent = high - low + 2 * margin
    width, height = extent * min(_LARGEST_PANEL / extent)
    spare = max(0.0, _NARROWEST_COLUMN - width - _GAP)
    gaps = [0.0] + [spare + (_WIDE_GAP if column.apart else _GAP) for column in columns[1:]]
    across = _LEFT + len(columns) * width + sum(gaps) + _RIGHT
    down = _TOP + (1 + len(rows)) * height + len(rows) * _GAP + _BOTTOM
    across_at_least = max(across, 6.4)
    left = _LEFT + (across_at_least - across) / 2
    figure = Figure(figsize=(across_at_least, down))
    places = left + np.cumsum(gaps) + width * np.arange(len(columns))

    def axes(row: int, column: int) -> Axes:
        bottom = down - _TOP - (row + 1) * height - row * _GAP
        place = (places[column] / across_at_least, bottom / down, width / across_at_least, height / down)
        result = figure.add_axes(place)
        result.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
        result.axis("off")
        return result

    for c, column in enumerate(columns):
        panel = axes(0, c)
        panel.set_title(column.title, color=INK, pad=4)
        _footprint(panel, belief, column.maps)
        for r, row in enumerate(rows, start=1):
            panel = axes(r, c)
            style.draw_cells(panel, belief.grid, row.values[c], colors=row.colours, norm=row.norm)
            _marks(panel, belief, column.maps, mass=r == 1, friction=r == len(rows))
    style.scale_bar(axes(0, len(columns) - 1), low - margin, float(extent.max()))
    for r, name in enumerate(["footprint", *(row.name for row in rows)]):
        middle = down - _TOP - (r + 0.5) * height - r * _GAP
        figure.text((left - 0.2) / across_at_least, middle / down, name, ha="right", va="center", fontsize=10)
    for r, row in enumerate(rows, start=1):
        bottom = down - _TOP - (r + 0.94) * height - r * _GAP
        right = (places[-1] + width + 0.2) / across_at_least
        place = (right, bottom / down, 0.13 / across_at_least, 0.88 * height / down)
        _colour_bar(figure, place, row)
    _legend(figure, belief)
    return figure


def _footprint(axes: Axes, belief: Belief, maps: Maps) -> None:
    style.draw_outline(axes, belief.grid, color="none", fill=PAPER)
    squares = PolyCollection(
        list(belief.grid.squares(belief.grid.width)), facecolors="none", edgecolors="#d5d0c6", linewidths=0.4
    )
    squares.set_clip_path(style.outline_path(belief.grid), axes.transData)
    axes.add_collection(squares, autolim=False)
    style.draw_outline(axes, belief.grid)  # last, or the pale squares would cover it
    axes.plot(*belief.centers_of_mass.T, **_DOT)
    # On this pale background, a seam around the marks would hide the dots.
    _marks(axes, belief, maps, seam=0.0)


def _marks(
    axes: Axes, belief: Belief, maps: Maps, *, mass: bool = True, friction: bool = True, seam: float = _SEAM
) -> None:
    """Draw ring and cross, with a white seam (points) that sets them off from the colours."""
    marks = []
    if friction:
        marks.append((belief.grid.center_of(maps.mass * maps.mu)[0], _RING))
    if mass:
        marks.append((belief.grid.center_of(maps.mass)[0], _CROSS))
    for place, how in marks:
        if seam:
            wider = how["markeredgewidth"] + seam
            axes.plot(*place, **{**how, "color": "white", "markeredgewidth": wider})
        axes.plot(*place, **how)


def _colour_bar(figure: Figure, place: tuple[float, float, float, float], row: _Row) -> None:
    norm = row.norm
    arrow = beyond(row.values, float(norm.vmax or 0.0), float(norm.vmin or 0.0))
    bar = figure.colorbar(ScalarMappable(norm, row.colours), cax=figure.add_axes(place), extend=arrow)
    if isinstance(norm, LogNorm):
        bar.formatter, bar.minorformatter = style.PlainNumbers(), style.PlainNumbers()
    bar.set_label(row.unit)
    bar.outline.set_linewidth(0.5)


def _legend(figure: Figure, belief: Belief) -> None:
    handles = [
        Line2D([], [], label="centre of mass", **_CROSS),
        Line2D([], [], label="centre of friction", **_RING),
        Line2D([], [], label="centres of mass of all hypotheses", **_DOT),
    ]
    figure.legend(handles=handles, loc="lower center", ncols=3, bbox_to_anchor=(0.5, 0.0))
    title = f"{belief.dataset}: belief with {len(belief)} hypotheses (one colour scale per row)"
    figure.text(
        0.5, 1 - 0.14 / figure.get_size_inches()[1], title, ha="center", va="top", fontsize=11, color=INK
    )
