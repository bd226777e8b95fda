"""How fast the arm is brought to rest when something is wrong."""

from __future__ import annotations

import numpy as np

from diagrams.hardware.channels import ARM_PERIOD
from models.physics.cell_grid import FloatArray
from models.robots import ACCELERATION_LIMITS

_SOONEST = 2 * ARM_PERIOD


def braking(speed: FloatArray, longest: float) -> float:
    """Time for even braking, s: at the acceleration that the robot's data sheet allows for motions, a whole
    number of commands, but within the longest time, whatever that asks of the joints.

    Args:
        speed: (7,) of the joints, rad/s.
        longest: s.
    """
    needed = float((np.abs(speed) / ACCELERATION_LIMITS).max())
    return min(max(ARM_PERIOD * np.ceil(needed / ARM_PERIOD - 1e-9), _SOONEST), longest)
