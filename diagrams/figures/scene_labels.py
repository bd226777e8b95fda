"""Labels for the scene of a belief: PNG pictures of text and scales on a clear ground."""

from __future__ import annotations

from io import BytesIO
from typing import Any

from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from diagrams.figures.style import INK, MAP_COLORS, styled
from diagrams.systems.belief_colors import Shown, rests_on
from models.inference.belief import Belief
from models.physics.cell_grid import FloatArray

_NAMES = (
    ("mass", "of a cell, g"),
    ("friction", "coefficient of a cell"),
    ("mass × friction", "force to slide a cell, mN"),
)
_LONGEST_NAME = 36


@styled
def title(belief: Belief, size: FloatArray) -> bytes:
    """What is shown, and how to read it.

    Args:
        belief: that is shown.
        size: (2,) of the panel, of which its proportion matters.
    """
    figure = _paper(size, 12.0)
    name = (
        belief.dataset if len(belief.dataset) <= _LONGEST_NAME else f"{belief.dataset[: _LONGEST_NAME - 1]}…"
    )
    _write(figure, (0.01, 0.82), f"{name}: belief {rests_on(belief)}", 32, weight="bold")
    lines = (
        "Height and colour of a prism: the value of its cell. Red pin: centre of mass.",
        f"First the mean of all {len(belief)} hypotheses, then the most probable ones one by one.",
    )
    _write(figure, (0.01, 0.34), "\n".join(lines), 18.5, linespacing=1.5)
    return _png(figure)


@styled
def label(belief: Belief, what: Shown, hypothesis: int, size: FloatArray) -> bytes:
    """Name and probability of a hypothesis of `what`; 0 is the mean."""
    figure = _paper(size, 2.3)
    name, remark = "mean", f"of {len(belief)} hypotheses"
    if hypothesis > 0:
        name = f"hypothesis {hypothesis}"
        remark = f"probability {100 * belief.probability[what.hypotheses[hypothesis - 1]]:.1f} %"
    _write(figure, (0.5, 0.72), name, 19, weight="bold", ha="center")
    _write(figure, (0.5, 0.24), remark, 15.5, ha="center")
    return _png(figure)


@styled
def scale(what: Shown, which: int, size: FloatArray) -> bytes:
    """Name, unit and colours of a map."""
    figure = _paper(size, 2.9)
    name, unit = _NAMES[which]
    _write(figure, (0.1, 0.86), name, 17, weight="bold")
    _write(figure, (0.1, 0.66), unit, 14)
    # With room at both ends for half a number, and on the right for the arrow.
    bar = figure.add_axes((0.1, 0.34, 0.78, 0.17))
    colors = ScalarMappable(Normalize(0.0, what.tops[which]), colormaps[MAP_COLORS[which]])
    figure.colorbar(
        colors, cax=bar, orientation="horizontal", ticks=MaxNLocator(4), extend=what.beyond(which)
    )
    bar.tick_params(labelsize=14)
    return _png(figure)


def _paper(size: FloatArray, inches: float) -> Figure:
    """A figure of a panel's proportions, so many inches wide."""
    return Figure(figsize=(inches, inches * float(size[1] / size[0])), dpi=200)


def _write(figure: Figure, at: tuple[float, float], text: str, points: float, **how: Any) -> None:
    figure.text(*at, text, fontsize=points, color=INK, va="center", **how)


def _png(figure: Figure) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, format="png", transparent=True)
    return stream.getvalue()
