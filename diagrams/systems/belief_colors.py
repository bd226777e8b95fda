"""A belief in colours: values of its maps, their scales, and the legend."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from diagrams.figures.style import FAINT, INK, MAP_COLORS, beyond, styled, top_of_scale
from models.inference.belief import Belief
from models.physics.cell_grid import FloatArray

MAPS = ("mass", "friction", "mass x friction")
TITLES = ("mass of a cell, g", "friction coefficient of a cell", "mass × friction: force to slide a cell, mN")
MAGNIFIED = 5.0
"""Residual arrows are so many times as long as the residual."""

BLACK, ORANGE, RED, BLUE = (0.08, 0.08, 0.08), (0.93, 0.45, 0.08), (0.80, 0.10, 0.15), (0.12, 0.44, 0.71)

KEY = (
    (BLACK, "observed outline"),
    (ORANGE, "predicted outline"),
    (RED, f"residual × {MAGNIFIED:.0f}"),
    (BLUE, "the finger's way"),
)
"""What the colours over the object mean."""

BOARD = (0.60, 0.42)
"""Size of the legend, m."""

_ROUND = np.array([1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0])


@dataclass(frozen=True, eq=False)
class Shown:
    """What is shown of a belief.

    Attributes:
        hypotheses: (k,) the most probable ones, the most probable first.
        values: (3, 1 + k, n) the maps `MAPS` in the units of `TITLES`: their mean over all hypotheses, then
            of `hypotheses`.
        tops: (3,) ends of the colour scales, which begin at 0; the largest few percent may lie beyond.
    """

    hypotheses: np.ndarray
    values: FloatArray
    tops: FloatArray

    def beyond(self, which: int) -> str:
        """Whether values of map `which` lie beyond the end of its scale, as `Figure.colorbar` takes it."""
        return beyond(self.values[which], float(self.tops[which]))

    def colors(self, which: int, hypothesis: int) -> FloatArray:
        """(n, 3) sRGB of the cells on map `which`; hypothesis 0 is the mean."""
        share = np.clip(self.values[which, hypothesis] / self.tops[which], 0.0, 1.0)
        return colormaps[MAP_COLORS[which]](share)[:, :3]


def shown(belief: Belief, most: int, *, round_tops: bool = False) -> Shown:
    """The mean of a belief and at most so many of its hypotheses.

    Args:
        belief: to be shown.
        most: hypotheses.
        round_tops: whether scales end at round numbers, so that they seldom change with the belief; otherwise
            they end where those of `maps_figure` do for as many hypotheses.
    """
    maps, p = belief.maps, belief.probability
    hypotheses = np.argsort(-p, kind="stable")[:most]
    every = np.stack([1e3 * maps.mass, maps.mu, 1e3 * maps.mass * maps.mu * belief.gravity])
    values = np.concatenate([np.einsum("k,mkn->mn", p, every)[:, None], every[:, hypotheses]], axis=1)
    tops = [top_of_scale(v) for v in values]
    return Shown(hypotheses, values, np.array([_round_up(top) for top in tops] if round_tops else tops))


def rests_on(belief: Belief) -> str:
    """What a belief rests on, a few words for a heading."""
    pushes = belief.taught
    return f"after {pushes} push{'es' * (pushes > 1)}" if pushes else f"of {len(belief)} hypotheses"


def _round_up(value: float) -> float:
    """The next round number."""
    if value <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * _ROUND[np.searchsorted(_ROUND, value / power * (1 - 1e-9))])


@styled
def legend(belief: Belief, what: Shown, which: int, basis: str) -> bytes:
    """PNG of the colour scale of map `which` and the probabilities of the hypotheses.

    Args:
        belief: that is shown.
        what: is shown of it.
        which: map.
        basis: what the belief rests on, a few words.
    """
    figure = _board(f"Belief {basis}")
    figure.text(0.05, 0.76, TITLES[which], fontsize=10.5, color=INK, va="center")
    bar = figure.add_axes((0.05, 0.62, 0.90, 0.085))
    scale = ScalarMappable(Normalize(0.0, what.tops[which]), colormaps[MAP_COLORS[which]])
    figure.colorbar(scale, cax=bar, orientation="horizontal", ticks=MaxNLocator(5), extend=what.beyond(which))
    bar.tick_params(labelsize=10)
    probability = belief.probability[what.hypotheses]
    figure.text(0.05, 0.45, "probability of the hypotheses", fontsize=10.5, color=INK, va="center")
    chart = figure.add_axes((0.13, 0.28, 0.82, 0.13))
    chart.bar(np.arange(1, len(probability) + 1), probability, color=INK, width=0.7)
    chart.set_xlim(0.3, max(len(probability), 4) + 0.7)
    chart.xaxis.set_major_locator(MaxNLocator(12, integer=True))
    chart.yaxis.set_major_locator(MaxNLocator(2))
    chart.tick_params(labelsize=9)
    return _png(figure)


@styled
def blank_legend() -> bytes:
    """PNG of the board before there is a belief."""
    figure = _board("No belief yet")
    text = "The maps appear when the first push\nhas been learned from."
    figure.text(0.05, 0.62, text, fontsize=11.5, color=INK, va="center", linespacing=1.5)
    return _png(figure)


def _board(title: str) -> Figure:
    """The title, and below what the colours over the object mean."""
    inch = 6.4
    figure = Figure(figsize=(BOARD[0] * inch, BOARD[1] * inch), dpi=220)
    figure.patch.set_edgecolor(FAINT)
    figure.patch.set_linewidth(2.0)
    figure.text(0.05, 0.90, title, fontsize=14, color=INK, va="center", weight="bold")
    for k, (color, meaning) in enumerate(KEY):
        place = (0.05 + 0.47 * (k % 2), 0.125 - 0.075 * (k // 2))
        figure.text(*place, "\u25a0", fontsize=11, color=color, va="center")
        figure.text(place[0] + 0.05, place[1], meaning, fontsize=10, color=INK, va="center")
    return figure


def _png(figure: Figure) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, format="png", edgecolor=figure.get_edgecolor())
    return stream.getvalue()
