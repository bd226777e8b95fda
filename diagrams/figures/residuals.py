"""Every picture of where a model fails."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from diagrams.figures.residual_curves import CONDITIONS, factor_figure
from diagrams.figures.residual_fields import object_figure, table_figure
from diagrams.figures.residual_means import pattern_of, residuals_of, wanted
from models.inference.comparison import Comparison
from models.measurements import PushDataset


def residual_figures(comparisons: Sequence[Comparison], dataset: PushDataset) -> dict[str, Figure]:
    """Every picture that these comparisons allow, by `<quantity>.<factor>`.

    Args:
        comparisons: one model, or two over the same pushes.
        dataset: for the outline.
    """
    figures: dict[str, Figure] = {}
    for quantity in ("motion", "force"):
        known = [c for c in comparisons if residuals_of(c, quantity) is not None]
        touching = [c for c in known if np.isfinite(wanted(c, quantity).at.contact).all(axis=1).any()]
        for comparison in known:
            ending = "" if comparison is comparisons[0] else ".second"
            figures[f"{quantity}.table_place{ending}"] = table_figure(comparison, quantity, known)
            if comparison in touching:
                figures[f"{quantity}.contact_place{ending}"] = object_figure(
                    comparison, dataset.grid, quantity, touching
                )
        for factor in CONDITIONS:
            if pattern_of(comparisons[0], factor, quantity) is not None:
                figures[f"{quantity}.{factor}"] = factor_figure(comparisons, factor, quantity)
    return figures
