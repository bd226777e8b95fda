"""Angles, which come round again after a whole turn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def angle_between(one: FloatArray | float, other: FloatArray | float) -> FloatArray:
    """(…) the angle one - other, wrapped to half a turn on both sides, rad: -π to below π."""
    return np.remainder(np.asarray(one, dtype=float) - other + np.pi, 2 * np.pi) - np.pi
