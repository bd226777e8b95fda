"""The force at the finger, from the torques it causes in the joints."""

from __future__ import annotations

import numpy as np

from models.physics.cell_grid import FloatArray

TORQUE_NOISE = 0.1
"""Standard deviation of a joint's external torque, N m."""
MOMENT_SPREAD = 0.5
"""Standard deviation of the contact force's moment about the finger's end, N m: 15 N act some cm above it."""


def tip_force(jacobian: FloatArray, torque_external: FloatArray) -> FloatArray:
    """Force (3,) of the finger on the object, world, N.

    The torques are Jᵀ times the wrench on the finger. How high the object touches the finger is not known, so
    a moment about its end is estimated along with the force, under a Gaussian prior of mean zero.

    In simulated pushes of a 1 kg box (5 N) at 0.1 m/s the estimate is the plant's contact force within 0.1 N
    on average and 0.3 to 0.6 N (rms) in each sample, at steps of 1 to 5 ms: the driver smooths the torques
    over 10 ms. The blow of first touch, up to 80 N for a step or two, comes out smoothed likewise.

    Args:
        jacobian: (6, 7) angular, then linear velocity of the finger's end per joint speed, world.
        torque_external: (7,) joint torques caused by contact, N m.
    """
    rows = np.vstack([jacobian.T / TORQUE_NOISE, np.eye(3, 6) / MOMENT_SPREAD])
    sides = np.concatenate([torque_external / TORQUE_NOISE, np.zeros(3)])
    wrench = np.linalg.lstsq(rows, sides, rcond=None)[0]
    return -wrench[3:]
