"""Ways between two postures around what stands between them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from ompl import base, geometric, util

from diagrams.execution.motion import MotionRefused
from models.physics.cell_grid import FloatArray
from models.robots import POSITION_LIMITS

RESOLUTION = 0.06
"""Between the postures of a way that are looked at, rad (norm over all joints)."""
ITERATIONS = 500
_SHORTCUTS = 60
_SEED = 7


def find_way(
    start: FloatArray, goal: FloatArray, is_clear: Callable[[FloatArray], bool], what: str
) -> FloatArray:
    """Corners (m, 7) of a polygon of joint angles from start to goal, both included, by RRT-Connect.

    Args:
        start, goal: (7,) rad.
        is_clear: whether the arm may be at a posture (7,), rad.
        what: the way, for the message.

    Raises:
        MotionRefused: none is found, or an end is not clear.
    """
    for q in (start, goal):
        if not is_clear(q):
            raise MotionRefused(f"no way {what}: the arm would be too close to something at its end")
    space = base.RealVectorStateSpace(7)
    bounds = base.RealVectorBounds(7)
    for k, limit in enumerate(POSITION_LIMITS):
        bounds.setLow(k, -float(limit))
        bounds.setHigh(k, float(limit))
    space.setBounds(bounds)
    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(_SEED)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(lambda state: is_clear(_posture(state)))
    information.setStateValidityCheckingResolution(RESOLUTION / space.getMaximumExtent())
    information.setup()
    ends = [space.allocState() for _ in range(2)]
    for state, q in zip(ends, (start, goal), strict=True):
        for k in range(7):
            state[k] = float(q[k])
    if information.checkMotion(*ends):
        return np.array([start, goal])
    setup = geometric.SimpleSetup(information)
    setup.setStartAndGoalStates(*ends)
    planner = geometric.RRTConnect(information)
    planner.setRange(0.6)
    setup.setPlanner(planner)
    left = iter(range(ITERATIONS))
    setup.solve(base.PlannerTerminationCondition(lambda: next(left, None) is None))
    if not setup.haveExactSolutionPath():
        raise MotionRefused(f"no way {what} was found around table, stand and object")
    path = setup.getSolutionPath()
    simplifier = geometric.PathSimplifier(information)
    simplifier.reduceVertices(path)
    simplifier.partialShortcutPath(path, _SHORTCUTS)
    simplifier.reduceVertices(path)
    return np.array([_posture(state) for state in path.getStates()])


def _posture(state: base.State) -> FloatArray:
    return np.array([state[k] for k in range(7)])
