"""Memory of the residual and its correlation with the finger's motion, with bounds that whole pushes give."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from diagrams.figures.comparison import MODEL_COLOURS
from diagrams.figures.style import INK, PAPER, styled
from models.inference.comparison import Comparison

TITLES = {
    "memory": ("Residual with itself later", "lag, s"),
    "finger_along": ("Residual with the finger's velocity", "residual follows by, s"),
    "finger_left": ("…across the finger's velocity", "residual follows by, s"),
}


@styled
def correlation_figure(comparisons: Sequence[Comparison]) -> Figure:
    """Three correlations over lags; the band holds all lags of 95 % of chance results.

    Args:
        comparisons: one model, or two over the same pushes.

    Raises:
        ValueError: the first comparison has no correlations.
    """
    if comparisons[0].correlations is None:
        raise ValueError(f"{comparisons[0].label}: too few pushes show their course for correlations")
    figure = Figure(figsize=(8.0, 2.7))
    panels = figure.subplots(1, 3, sharey=True)
    figure.subplots_adjust(left=0.085, right=0.99, top=0.88, bottom=0.2, wspace=0.1)
    for axes, (name, (title, label)) in zip(panels, TITLES.items(), strict=True):
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
