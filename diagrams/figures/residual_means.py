"""What pictures of residuals share: which residuals, their names, means over pushes."""

from __future__ import annotations

import numpy as np

from models.inference.comparison import Comparison
from models.inference.residual_structure import Pattern
from models.inference.residuals import Residuals
from models.physics.cell_grid import FloatArray

LEAST_PUSHES = 2
UNITS = {"motion": "% of the speed", "force": "% of the force"}
NAMES = {"motion": "residual velocity", "force": "residual force"}


def residuals_of(comparison: Comparison, quantity: str) -> Residuals | None:
    """Residual velocities (`motion`) or forces (`force`) of a comparison."""
    return comparison.motion if quantity == "motion" else comparison.force


def wanted(comparison: Comparison, quantity: str) -> Residuals:
    """The same.

    Raises:
        ValueError: the comparison has no such residuals.
    """
    residuals = residuals_of(comparison, quantity)
    if residuals is None:
        raise ValueError(f"{comparison.label}: there are no residuals of {quantity} in these pushes")
    return residuals


def pattern_of(comparison: Comparison, factor: str, quantity: str) -> Pattern | None:
    """What was found for one factor, or None where it was not looked at."""
    for pattern in comparison.structure:
        if (pattern.factor, pattern.quantity) == (factor, quantity):
            return pattern
    return None


def push_means(values: FloatArray, push: np.ndarray, weights: FloatArray) -> FloatArray:
    """(m, c) weighted mean of each push that occurs."""
    return np.array(
        [np.average(values[push == b], axis=0, weights=weights[push == b]) for b in np.unique(push)]
    ).reshape(-1, values.shape[1])
