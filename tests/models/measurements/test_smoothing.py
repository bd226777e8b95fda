"""Smoothing of a finger's track."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import savgol_filter

from slipmap.models.measurements.motion import _local_quadratics


@pytest.mark.parametrize("rows", [5, 21, 81])
def test_local_quadratics_are_those_of_savitzky_and_golay(rows: int) -> None:
    track = np.cumsum(np.random.default_rng(rows).normal(size=(81, 2)), axis=0)
    expected = savgol_filter(track, rows, 2, axis=0, mode="interp")
    np.testing.assert_allclose(_local_quadratics(track, rows), expected, atol=1e-10)
