"""How fast the arm is brought to rest when something is wrong."""

from __future__ import annotations

import numpy as np

from diagrams.hardware.channels import ARM_PERIOD
from models.physics.cell_grid import FloatArray
from models.robots import ACCELERATION_LIMITS

_SOONEST = 2 * ARM_PERIOD

_SOON = 4 * ARM_PERIOD
"""s; in a push the finger brakes so long by the data sheet."""

_HARD = 4.5
"""Times the acceleration that the data sheet allows for motions, in an emergency."""


def braking(speed: FloatArray, longest: float) -> float:
    """Time for even braking, s, a whole number of commands.

    At the acceleration that the robot's data sheet allows for motions where the arm then rests within 20 ms;
    within 20 ms where that takes up to 4.5 times as much; else at 4.5 times as much, but within the longest
    time, whatever that asks of the joints.

    Args:
        speed: (7,) of the joints, rad/s.
        longest: s.
    """
    gentle = float((np.abs(speed) / ACCELERATION_LIMITS).max())
    needed = max(min(gentle, _SOON), gentle / _HARD)
    return min(max(ARM_PERIOD * np.ceil(needed / ARM_PERIOD - 1e-9), _SOONEST), longest)
