"""Shared style of figures and of the Meshcat board: colours, font sizes, scales of maps."""

import logging
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import matplotlib
import numpy as np

from slipmap.models.physics.cell_grid import FloatArray

INK = "#222222"
FAINT = "#9a9a9a"
PAPER = "#f1efea"
BELIEF = "#1f6fb4"
FINGER = "#d4691e"
OTHER = "#2f8f6b"

MAP_COLORS = ("viridis", "plasma", "cividis")
"""Colormaps of mass, friction and their product; perceptually uniform, a different one for each map."""

SCALED_SHARE = 0.97
SCALED_RATIO = 1.5

STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "axes.edgecolor": FAINT,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.fonttype": "none",
    "svg.hashsalt": "slipmap",
    # A dollar sign in the name of a dataset, trial or effect does not start a formula.
    "text.parse_math": False,
}


def top_of_scale(values: FloatArray) -> float:
    """Upper end of the colour scale shared by maps (columns, n); larger values get the last colour.

    It lies at the 97 % quantile of all values, and at most at 1.5 times the median of the maps' own
    quantiles: neither a single cell nor a single odd map should make all others pale.
    """
    each = np.quantile(values, SCALED_SHARE, axis=1, method="lower")
    return min(float(np.quantile(values, SCALED_SHARE)), SCALED_RATIO * float(np.median(each))) or 1.0


def beyond(values: FloatArray, top: float, low: float = 0.0) -> str:
    """Whether a scale from `low` to `top` needs arrows, as the `extend` argument of `Figure.colorbar`."""
    over, under = float(values.max()) > 1.02 * top, float(values.min()) < 0.98 * low
    return "both" if over and under else "max" if over else "min" if under else "neither"


Arguments = ParamSpec("Arguments")
Drawn = TypeVar("Drawn")


def styled(draw: Callable[Arguments, Drawn]) -> Callable[Arguments, Drawn]:
    """Decorator: draw in the project's style, regardless of the caller's own settings."""

    @wraps(draw)
    def drawn(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Drawn:
        # A missing font weight is replaced by the nearest one; a warning about that helps nobody.
        logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)
        with matplotlib.rc_context(STYLE):
            return draw(*args, **kwargs)

    return drawn
