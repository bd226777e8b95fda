"""A belief in colours: values of its maps, their scales, and the legend."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from io import BytesIO

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from diagrams.figures.style import FAINT, INK, styled
from models.inference.belief import Belief
from models.physics.cell_grid import FloatArray

MAPS = ("mass", "friction", "mass x friction")
TITLES = ("mass of a cell, g", "friction coefficient of a cell", "mass × friction: force to slide a cell, mN")
COLORS = ("viridis", "plasma", "cividis")
"""Perceptually uniform, a different one for each map."""

MAGNIFIED = 5.0
"""Residual arrows are so many times as long as the residual."""

KEY = f"black: observed, orange: predicted, red: residual × {MAGNIFIED:.0f}"

BOARD = (0.84, 0.28)
"""Size of the legend, m."""

_ROUND = np.array([1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0])
_TOP_OF_SCALE = 0.97


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

    def colors(self, which: int, hypothesis: int) -> FloatArray:
        """(n, 3) sRGB of the cells on map `which`; hypothesis 0 is the mean."""
        share = np.clip(self.values[which, hypothesis] / self.tops[which], 0.0, 1.0)
        return colormaps[COLORS[which]](share)[:, :3]


def shown(belief: Belief, most: int) -> Shown:
    """The mean of a belief and at most so many of its hypotheses."""
    maps, p = belief.maps, belief.probability
    hypotheses = np.argsort(-p, kind="stable")[:most]
    every = np.stack([1e3 * maps.mass, maps.mu, 1e3 * maps.mass * maps.mu * belief.gravity])
    values = np.concatenate([np.einsum("k,mkn->mn", p, every)[:, None], every[:, hypotheses]], axis=1)
    tops = np.array([_round_up(float(np.quantile(v, _TOP_OF_SCALE))) for v in values])
    return Shown(hypotheses, values, tops)


def _round_up(value: float) -> float:
    """The next round number, so that scales seldom change."""
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
    inch = 6.4
    figure = Figure(figsize=(BOARD[0] * inch, BOARD[1] * inch), dpi=180)
    figure.patch.set_edgecolor(FAINT)
    figure.patch.set_linewidth(2.0)
    write = partial(figure.text, color=INK, va="center")
    write(0.04, 0.86, f"Belief {basis}", fontsize=13, weight="bold")
    write(0.04, 0.66, TITLES[which], fontsize=11.5)
    bar = figure.add_axes((0.04, 0.42, 0.54, 0.15))
    scale = ScalarMappable(Normalize(0.0, what.tops[which]), colormaps[COLORS[which]])
    figure.colorbar(scale, cax=bar, orientation="horizontal", ticks=MaxNLocator(5))
    bar.tick_params(labelsize=11)
    write(0.04, 0.10, KEY, fontsize=10.5)
    probability = belief.probability[what.hypotheses]
    write(0.97, 0.86, "hypotheses' probability", fontsize=11.5, ha="right")
    chart = figure.add_axes((0.69, 0.33, 0.28, 0.40))
    chart.bar(np.arange(1, len(probability) + 1), probability, color=INK, width=0.7)
    chart.set_xlim(0.3, max(len(probability), 4) + 0.7)
    chart.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    chart.yaxis.set_major_locator(MaxNLocator(2))
    chart.tick_params(labelsize=11)
    stream = BytesIO()
    figure.savefig(stream, format="png", edgecolor=figure.get_edgecolor())
    return stream.getvalue()
