"""Faults of time stamps that only their neighbours show: single ones far from those around them, and clocks
too coarse for the rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.cell_grid import FloatArray

_AROUND = 5  # rows on either side among which a stamp is judged, and longest run of wrong ones
_FAR, _PERIODS = 0.1, 20.0  # s, and usual steps, that a wrong stamp is from those around it
_ELSEWHERE = 1e6  # s from the next stamps, at an end: a clock that was not set yet
_MOST_SHARE = 0.1  # of the rows; if more are odd, the clock is of another kind
_COARSE = 3.0  # rows with one stamp, on average, that still differ


def wild_rows(time: FloatArray) -> NDArray[np.int_]:
    """Rows whose stamps lie far outside those before and after them, such as 0 where none was taken.

    Stamps that start anew, and pauses, are not among them: a stamp is compared with the median of the rows
    around it, which in order is the stamp itself. At the ends only a stamp out of order counts, or one that
    is over a million seconds away.

    Args:
        time: (T,) s, NaN where unknown.
    """
    known = np.flatnonzero(np.isfinite(time))
    count = 2 * _AROUND + 1
    if len(known) <= count:
        return np.zeros(0, dtype=int)
    stamps = time[known]
    windows = np.lib.stride_tricks.sliding_window_view(stamps, count)
    middle = np.median(windows, axis=1)
    usual = np.concatenate([np.full(_AROUND, middle[0]), middle, np.full(_AROUND, middle[-1])])
    off = stamps - usual
    period = float(np.median(np.abs(np.diff(stamps))))
    wild = np.abs(off) > max(_FAR, _PERIODS * period)
    wild[:_AROUND] &= (off[:_AROUND] > 0.0) | (off[:_AROUND] < -_ELSEWHERE)
    wild[-_AROUND:] &= (off[-_AROUND:] < 0.0) | (off[-_AROUND:] > _ELSEWHERE)
    return known[wild] if wild.sum() <= _MOST_SHARE * len(stamps) else np.zeros(0, dtype=int)


def coarse_text(time: FloatArray, values: FloatArray) -> str:
    """What is odd about stamps that many rows share although their values differ; "" if nothing.

    Args:
        time: (T,) s, in order.
        values: (T, n) of the rows.
    """
    new = np.append(True, np.diff(time) > 0.0)
    moved = np.append(True, (np.diff(values, axis=0) != 0.0).any(axis=1))
    moments = int(new.sum())
    if moments < 2 or int((new | moved).sum()) < _COARSE * moments:
        return ""
    step = float(np.median(np.diff(time[new])))
    return (
        f"its clock counts in steps of {step:.3g} s only, while the rows change in between; if the rows are"
        " evenly spaced, give their `rate` in Hz"
    )
