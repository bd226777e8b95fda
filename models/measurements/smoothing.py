"""Smoothing of a recorded finger track.

A finger is stiff and smooth, its record jitters. Fed into the model as it is, jitter of 0.05 mm rattles the
contact between no force and twice the force, and rectifies into a drift: with the true maps of a simulated
object, pushes ended 1.4 mm off on average, and 0.5 mm off after this smoothing.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import correlate1d, maximum_filter1d, uniform_filter1d

from models.physics.cell_grid import FloatArray

WINDOWS = (0.4, 0.3, 0.2, 0.14, 0.1, 0.07, 0.05)
"""Windows of the local quadratic that are tried, s, the widest first."""

TOLERATED = 2.0
"""A window is good where what it leaves (rms over five rows) is below this many times the noise."""

SMALLEST_NOISE = 2e-6
"""Rounding of the record is not noise, m."""


def smooth_track(time: FloatArray, track: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Local quadratics over the widest window that the noise allows at each time.

    The noise is estimated from third differences, which smooth motion hardly has. Where the finger starts,
    stops or turns within a window, the quadratic leaves more than the noise and a narrower window is taken,
    down to the record itself.

    Args:
        time: (T,) increasing, s; rows may jitter in time.
        track: (T, 2) positions, m.

    Returns:
        Times at the median rate over the same span, and the track there. Tracks of fewer than twelve rows
        come back as they are.
    """
    if len(time) < 12:
        return time, track
    step = float(np.median(np.diff(time)))
    grid = np.linspace(time[0], time[-1], max(2, round((time[-1] - time[0]) / step) + 1))
    raw = np.column_stack([np.interp(grid, time, column) for column in track.T])
    third = np.abs(np.diff(raw, 3, axis=0))
    noise = max(float((np.median(third, axis=0) / 0.6745 / np.sqrt(20.0)).max()), SMALLEST_NOISE)
    smooth = raw.copy()
    settled = np.zeros(len(grid), dtype=bool)
    for window in WINDOWS:
        rows = int(window / step) // 2 * 2 + 1
        if rows < 5 or rows > len(grid):
            continue
        fitted = _local_quadratics(raw, rows)
        left = uniform_filter1d(((raw - fitted) ** 2).mean(axis=1), 5, mode="nearest")
        worst = maximum_filter1d(np.sqrt(np.maximum(left, 0.0)), rows, mode="nearest")
        good = (worst < TOLERATED * noise) & ~settled
        smooth[good] = fitted[good]
        settled |= good
    return grid, smooth


def _local_quadratics(track: FloatArray, rows: int) -> FloatArray:
    """Each row (T, c) on the parabola through the `rows` around it, an odd number; at the ends, through the
    first or last of them (Savitzky and Golay 1964).

    As scipy.signal has it, whose import takes a second.
    """
    half = rows // 2
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, rows), 3))
    weights = basis @ basis.T  # [i, j]: of row j in the parabola at row i
    fitted = correlate1d(track, weights[half], axis=0)
    fitted[:half] = weights[:half] @ track[:rows]
    fitted[-half:] = weights[-half:] @ track[-rows:]
    return fitted
