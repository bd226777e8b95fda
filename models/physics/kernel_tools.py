"""Copies between arrays in kernels, without the slice assignments of numba.

Each kind of slice assignment brings along code that writes the shapes into an error message, which takes
three seconds to compile.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.compiled import compiled


@compiled(forceinline=True)
def copy_into(target, source):  # type: ignore[no-untyped-def]
    """Copy (n,) numbers.

    Raises:
        ValueError: the lengths differ.
    """
    if target.shape[0] != source.shape[0]:
        raise ValueError("copy_into: lengths differ")
    for i in range(source.shape[0]):
        target[i] = source[i]


@compiled(forceinline=True)
def add_columns(target, first, source, count):  # type: ignore[no-untyped-def]
    """Add the first `count` columns of `source` to those of `target` from `first` on, of equal rows."""
    for a in range(target.shape[0]):
        for k in range(count):
            target[a, first + k] += source[a, k]


# Small rotations: a step turns the object by hundredths of a radian; its angles are multiples of one.


_SMALL = 0.1  # rad; up to here the series below are exact to rounding


class Turn(NamedTuple):
    """Rotation by an angle α.

    Attributes:
        cos: cos α.
        sin: sin α.
        sinc: sin(α)/α.
        sinc_slope: derivative of sin(α)/α by α.
    """

    cos: float
    sin: float
    sinc: float
    sinc_slope: float


@compiled(forceinline=True, fastmath={"contract"})
def turn_by(angle):  # type: ignore[no-untyped-def]
    """The `Turn` by an angle in rad, from power series where it is small."""
    z = angle * angle
    if z > _SMALL * _SMALL:
        c = math.cos(angle)
        s = math.sin(angle)
        return Turn(c, s, s / angle, (c - s / angle) / angle)
    c = 1.0 + z * (-1 / 2 + z * (1 / 24 + z * (-1 / 720 + z * (1 / 40320))))
    sinc = 1.0 + z * (-1 / 6 + z * (1 / 120 + z * (-1 / 5040 + z * (1 / 362880))))
    slope = angle * (-1 / 3 + z * (1 / 30 + z * (-1 / 840 + z * (1 / 45360 - z * (1 / 3991680)))))
    return Turn(c, angle * sinc, sinc, slope)


@compiled(forceinline=True, fastmath={"contract"})
def joined(c1, s1, c2, s2):  # type: ignore[no-untyped-def]
    """Cosine and sine of the sum of two angles given by theirs."""
    return c1 * c2 - s1 * s2, s1 * c2 + c1 * s2


@compiled(forceinline=True, fastmath={"contract"})
def turned(c, s, x, y):  # type: ignore[no-untyped-def]
    """The vector (x, y) turned by the angle with cosine c and sine s."""
    return c * x - s * y, s * x + c * y


# In which order jobs are handed to threads, so that all are busy to the end.


def evenly_dealt(steps: NDArray[np.int64], models: int, threads: int | None = None) -> NDArray[np.int64]:
    """Jobs k B + b of models times pushes, in an order whose equal parts, one a thread, are equally long.

    A parallel loop gives each thread one run of consecutive jobs. With ten pushes in the order of their
    recording, one of two threads waited for an eighth of the time.

    Args:
        steps: (B,) of each push.
        models: K.
        threads: among which jobs are dealt; those of numba if None.
    """
    threads = numba.get_num_threads() if threads is None else threads
    longest_first = np.argsort(-np.tile(steps, models), kind="stable")
    turn, seat = np.divmod(np.arange(len(longest_first)), threads)
    # Dealt there and back, as who is first in one turn gets the longer job.
    hand = np.where(turn % 2 == 0, seat, threads - 1 - seat)
    return longest_first[np.argsort(hand, kind="stable")]
