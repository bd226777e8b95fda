"""Small rotations: a step turns the object by hundredths of a radian; its angles are multiples of one."""

from __future__ import annotations

import math
from typing import NamedTuple

from models.physics.compiled import compiled

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
