"""Dry friction of a table on many points: each holds on by a short elastic bristle that gives way at a limit.

The law of Coulomb with a true state of rest: a point clings within its bristle's reach of a few micrometres
and slides beyond it at constant force. Explicit in time, with no equations to solve.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from blind.objects import FloatArray

REACH = 8e-6  # m
DAMPING_TIME = 1.5e-3  # s, force of a clinging bristle per rate, over its stiffness


@njit(cache=True)
def bristle_wrench(
    bristles: FloatArray,
    points: FloatArray,
    limit: FloatArray,
    grain: FloatArray,
    drag: float,
    table_velocity: FloatArray,
    twist: FloatArray,
    h: float,
) -> tuple[float, float, float]:
    """Move the bristles on by one step and sum up their forces.

    All vectors in the object frame.

    Args:
        bristles: (p, 2) deflections, m; changed in place.
        points: (p, 2) m.
        limit: (p,) force at which a point slides, N.
        grain: (2, 2) symmetric; identity where friction is the same in all directions. Power is lost at
            the rate limit · |grain · velocity|.
        drag: force on each point per speed, N·s/m.
        table_velocity: (2,) of the table's top, m/s.
        twist: (3,) of the object at its origin, m/s and rad/s.
        h: s.

    Returns:
        Force and torque about the origin, N and N·m.
    """
    fx = fy = torque = 0.0
    for p in range(len(points)):
        x, y = points[p, 0], points[p, 1]
        ux = twist[0] - twist[2] * y - table_velocity[0]
        uy = twist[1] + twist[2] * x - table_velocity[1]
        sx = grain[0, 0] * ux + grain[0, 1] * uy
        sy = grain[1, 0] * ux + grain[1, 1] * uy
        bx, by = bristles[p, 0] + h * sx, bristles[p, 1] + h * sy
        size = np.sqrt(bx * bx + by * by)
        if size > REACH:
            bx, by = bx * REACH / size, by * REACH / size
        bristles[p, 0], bristles[p, 1] = bx, by
        qx, qy = (bx + DAMPING_TIME * sx) / REACH, (by + DAMPING_TIME * sy) / REACH
        size = np.sqrt(qx * qx + qy * qy)
        share = limit[p] / max(size, 1.0)
        px = -share * (grain[0, 0] * qx + grain[0, 1] * qy) - drag * ux
        py = -share * (grain[1, 0] * qx + grain[1, 1] * qy) - drag * uy
        fx += px
        fy += py
        torque += x * py - y * px
    return fx, fy, torque
