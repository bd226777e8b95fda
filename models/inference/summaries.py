"""Summaries of weighted hypotheses: a central pose, and an interval.

Hypotheses can diverge where a push may go to either side of balance. Their mean then lies where none of them
is, and follows those that go farthest astray. Predictions are judged by ADD, a distance, and the expected
distance is smallest at the geometric median.

Hypotheses are few, so their quantiles would be too coarse. They are treated as draws from a normal
distribution with their weighted moments, and intervals are prediction intervals for another draw: Student's,
with 1 / Σ p² effective draws for weights p. For several numbers together see `end_region`.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import stdtrit

from slipmap.models.geometry import at_centroid, from_centroid, radius_of_gyration
from slipmap.models.physics.cell_grid import CellGrid, FloatArray


def decimals(size: float) -> int:
    """Decimals that show two figures of a number of this size, 0 to 8."""
    size = abs(size)
    return min(max(1 - math.floor(math.log10(size)), 0), 8) if math.isfinite(size) and size > 0 else 3


def middle_poses(poses: FloatArray, probability: FloatArray, grid: CellGrid) -> FloatArray:
    """Geometric median of planar poses, by the iteration of Weiszfeld (1937).

    Distances are those of (x, y, ρ θ) at the cells' centroid, with their radius of gyration ρ: nearly ADD.

    Args:
        poses: (K, …, 3) of the object frame, m and rad; angles to be averaged do not wrap.
        probability: (K,) sums to one.

    Returns:
        (…, 3) poses.
    """
    scale = np.array([1.0, 1.0, radius_of_gyration(grid)])
    points = at_centroid(poses, grid) * scale
    weight = probability.reshape(-1, *[1] * (points.ndim - 1))
    middle = (weight * points).sum(axis=0)
    # Below the first distance a hypothesis pulls less and less, m; a step below the second ends the search,
    # m.
    close, settled = 1e-4, 1e-6
    for _ in range(100):
        distance = np.linalg.norm(points - middle, axis=-1, keepdims=True)
        pull = weight / np.sqrt(distance**2 + close**2)
        before, middle = middle, (pull * points).sum(axis=0) / pull.sum(axis=0)
        if np.abs(middle - before).max(initial=0.0) < settled:
            break
    return from_centroid(middle / scale, grid)


def interval(
    values: FloatArray, probability: FloatArray, *, level: float = 0.9, log: bool = False, more: float = 0.0
) -> tuple[float, float, float]:
    """Weighted median and central interval of draws.

    Args:
        values: (K,).
        probability: (K,) weights.
        level: share of cases in which the truth should lie inside.
        log: whether the logarithm is normally distributed.
        more: standard deviation of further errors of each draw.
    """
    x = np.log(np.maximum(values, 1e-300)) if log else values
    mean = float(probability @ x)
    effective = max(2.0, 1.0 / float(probability @ probability))
    variance = float(probability @ (x - mean) ** 2) * effective / (effective - 1.0)
    spread = np.sqrt(variance * (1.0 + 1.0 / effective) + more**2)
    width = float(stdtrit(effective - 1.0, 0.5 + 0.5 * level)) * spread
    order = np.argsort(x)
    middle = float(x[order][np.searchsorted(np.cumsum(probability[order]), 0.5)])
    low, high = float(mean - width), float(mean + width)
    return (float(np.exp(middle)), float(np.exp(low)), float(np.exp(high))) if log else (middle, low, high)
