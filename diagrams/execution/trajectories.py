"""Joint angles over time: paths through given angles, and how fast to go along them."""

from __future__ import annotations

import numpy as np
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PathParameterizedTrajectory, PiecewisePolynomial, Trajectory

from diagrams.execution.finger_kinematics import FingerKinematics
from models.physics.cell_grid import FloatArray
from models.robots import ACCELERATION_LIMITS, SPEED_LIMITS
from planners.table_push import Pace

SPEED_SHARE = 0.9
"""Share of the joints' speed limits that motions use."""
ACCELERATION_SHARE = 0.6
"""Share of the joints' acceleration limits that motions use."""

_MINIMUM_JERK = Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])  # Flash and Hogan 1985


def joint_path(knots: FloatArray) -> PiecewisePolynomial:
    """Smooth path over [0, 1] through joint angles.

    Args:
        knots: (m, 7) angles, evenly spaced along the path, rad; m >= 2. Two are joined by a straight line.
    """
    breaks = np.linspace(0.0, 1.0, len(knots))
    if len(knots) < 4:
        return PiecewisePolynomial.FirstOrderHold(breaks, knots.T)
    return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
        breaks, knots.T, periodic_end_condition=False
    )


def smooth(path: Trajectory, kinematics: FingerKinematics, tip_speed: float) -> Trajectory:
    """Along a path from rest to rest with the minimum-jerk profile, as fast as joints and finger may.

    With s(t) = σ(t/T), speeds are q'σ'/T and accelerations (q''σ'² + q'σ'')/T²: this gives the shortest T.

    Args:
        path: of 7 joint angles over [0, 1], rad.
        kinematics: of the arm.
        tip_speed: largest speed of the finger's end, m/s.
    """
    shares = np.linspace(0.0, 1.0, 101)
    unit = PiecewisePolynomial([_MINIMUM_JERK], [0.0, 1.0])
    sigma, d_sigma, dd_sigma = (unit.MakeDerivative(order).vector_values(shares)[0] for order in range(3))
    q, dq, ddq = (path.MakeDerivative(order).vector_values(sigma) for order in range(3))
    speeds, accelerations = dq * d_sigma, ddq * d_sigma**2 + dq * dd_sigma
    tip_speeds = [np.linalg.norm(kinematics.jacobian(q[:, k])[3:] @ speeds[:, k]) for k in range(len(shares))]
    duration = max(
        (np.abs(speeds).max(axis=1) / (SPEED_SHARE * SPEED_LIMITS)).max(),
        np.sqrt((np.abs(accelerations).max(axis=1) / (ACCELERATION_SHARE * ACCELERATION_LIMITS)).max()),
        max(tip_speeds) / tip_speed,
    )
    unit.ScaleTime(duration)
    return PathParameterizedTrajectory(path, unit)


def paced(path: Trajectory, pace: Pace, rest: float) -> Trajectory:
    """Along a path over [0, 1] at a given pace, then a rest.

    Args:
        path: of 7 joint angles, rad; equal steps of its parameter are equal ways of the finger.
        pace: of the finger.
        rest: time at the end, s.
    """
    times, ways, speeds = (list(values) for values in (pace.times, pace.ways, pace.speeds))
    if rest > 1e-9:
        times, ways, speeds = [*times, times[-1] + rest], [*ways, ways[-1]], [*speeds, 0.0]
    share = PiecewisePolynomial.CubicHermite(
        times, np.array([ways]) / ways[-1], np.array([speeds]) / ways[-1]
    )
    return PathParameterizedTrajectory(path, share)


def braking(q: FloatArray, speed: FloatArray) -> Trajectory:
    """From motion to rest with constant accelerations of the joints, within their limits.

    Args:
        q: (7,) joint angles at the begin, rad.
        speed: (7,) joint speeds at the begin, rad/s.
    """
    duration = max(float((np.abs(speed) / (ACCELERATION_SHARE * ACCELERATION_LIMITS)).max()), 0.01)
    return PiecewisePolynomial.CubicHermite(
        [0.0, duration],
        np.column_stack([q, q + speed * duration / 2.0]),
        np.column_stack([speed, np.zeros(7)]),
    )
