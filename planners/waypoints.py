"""Waypoints to a goal, by RRT* in SE(2): Algorithm 3, line 1.

The object may be at any pose where it is balanced, with its footprint on the table or partly over the edge.

The paper measures gaps between poses by the distance between their 3n vectors. Without the angles, and per
cell, that is the root mean square distance between the cells, which equals the Euclidean distance between the
vectors

    e(q) = (c_x, c_y, ρ cos θ, ρ sin θ),

where c is the position of the cells' centroid and ρ² their mean square distance from it, since
mean |p^i - p'^i|² = |c - c'|² + 2 ρ² (1 - cos(θ - θ')). So any nearest-neighbour search finds nearest poses,
and the mean square gap over uncertain poses is the squared gap of the mean plus the variance.
"""

from __future__ import annotations

import numpy as np
from ompl import base, geometric, util

from slipmap.models.geometry import compose, radius_of_gyration, turned_to
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.balance import balance_margins, corners_of, fall_probability
from slipmap.models.physics.cell_grid import CellGrid, FloatArray


class PoseMetric:
    """Root mean square distance between the cells of an object in two poses, m."""

    def __init__(self, grid: CellGrid) -> None:
        self._centroid = np.append(grid.centers.mean(axis=0), 0.0)
        self.radius = radius_of_gyration(grid)

    def embedding(self, poses: FloatArray) -> FloatArray:
        """(…, 4) vectors e(q) of poses (…, 3); distances between them are gaps."""
        place = compose(poses, self._centroid)
        angle = poses[..., 2, None]
        turned = self.radius * np.concatenate([np.cos(angle), np.sin(angle)], axis=-1)
        return np.concatenate([place[..., :2], turned], axis=-1)

    def gap(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """(…) gap between poses (…, 3), m; leading axes broadcast."""
        return np.linalg.norm(self.embedding(one) - self.embedding(other), axis=-1)

    def gaps(self, poses: FloatArray, targets: FloatArray) -> FloatArray:
        """(…, G) gap between each pose (…, 3) and each target (G, 3), m; accurate to 0.1 µm."""
        points, goals = self.embedding(poses), self.embedding(targets)
        square = (points**2).sum(axis=-1)[..., None] + (goals**2).sum(axis=-1) - 2.0 * points @ goals.T
        return np.sqrt(np.maximum(square, 0.0))


ITERATIONS = 250  # iterations of RRT*
_RANGE = 0.2  # longest edge of the tree, m
_DOOMED = 0.5  # probability of falling from which on a pose is no goal
_RESOLUTION = 0.02  # distance between poses on an edge at which balance is checked, m


class NoWay(ValueError):
    """No path to the goal was found on which the object stays balanced."""


def find_waypoints(
    belief: Belief,
    start: FloatArray,
    goal: FloatArray,
    table: Table,
    rng: np.random.Generator,
    *,
    epsilon: float = 0.1,
    margin: float = 0.0,
) -> FloatArray:
    """Find waypoints from `start` to `goal`; the straight path if it is safe.

    A pose is safe if the object falls there with a probability of at most `epsilon`, or of that at the start
    or the goal if that is higher. Distances weight angles by the object's radius of gyration.

    Args:
        belief: hypotheses about the centre of mass.
        start: (3,) world, m and rad.
        goal: (3,) world.
        rng: source of the seed.
        epsilon: largest probability of falling.
        margin: balance margin below which it counts as falling, m.

    Returns:
        (n, 3) waypoints, ending with the goal, without the start; angles are continuous from the start's.

    Raises:
        NoWay: none was found, or the object would more probably fall at the goal than stay.
    """

    def falls(pose: FloatArray) -> float:
        margins = balance_margins(belief.grid, belief.centers_of_mass, pose[None], table)
        return float(fall_probability(margins, belief.probability, margin)[0])

    at_goal = falls(goal)
    if at_goal > _DOOMED:
        raise NoWay(
            f"at {np.round(goal, 3).tolist()} the object falls with a probability of {at_goal:.0%}: no goal"
        )
    limit = max(epsilon, falls(start), at_goal) + 1e-9
    space = _space(PoseMetric(belief.grid).radius, belief, table)
    # OMPL's generators take their seeds from a shared one; setting that again logs an error but works.
    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(int(rng.integers(1, 2**31)))
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(lambda state: falls(_pose(state)) <= limit)
    information.setStateValidityCheckingResolution(_RESOLUTION / space.getMaximumExtent())
    information.setup()
    ends = [_state(space, pose) for pose in (start, goal)]
    if information.checkMotion(*ends):
        return turned_to(goal, float(start[2]))[None]

    setup = geometric.SimpleSetup(information)
    setup.setStartAndGoalStates(*ends)
    planner = geometric.RRTstar(information)
    planner.setRange(_RANGE)
    setup.setPlanner(planner)
    setup.solve(base.PlannerTerminationCondition(_after(ITERATIONS)))
    if not setup.haveExactSolutionPath():
        raise NoWay(
            f"no path from {np.round(start, 3).tolist()} to {np.round(goal, 3).tolist()} was found on which"
            " the object stays balanced"
        )
    path = setup.getSolutionPath()
    geometric.PathSimplifier(information).reduceVertices(path)
    way: list[FloatArray] = []
    for state in path.getStates()[1:]:
        way.append(turned_to(_pose(state), float(way[-1][2] if way else start[2])))
    return np.array(way)


def _space(radius: float, belief: Belief, table: Table) -> base.SE2StateSpace:
    corners = corners_of(table) - np.asarray(table.center)
    reach = np.abs(corners).max(axis=0) if len(corners) else np.full(2, table.radius or 0.0)
    reach = reach + np.linalg.norm(belief.grid.exterior, axis=1).max()
    bounds = base.RealVectorBounds(2)
    for axis in range(2):
        bounds.setLow(axis, float(table.center[axis] - reach[axis]))
        bounds.setHigh(axis, float(table.center[axis] + reach[axis]))
    space = base.SE2StateSpace()
    space.setBounds(bounds)
    space.setSubspaceWeight(1, radius)
    return space


def _state(space: base.SE2StateSpace, pose: FloatArray) -> base.State:
    state = space.allocState()
    state.setX(float(pose[0]))
    state.setY(float(pose[1]))
    state.setYaw(float(np.arctan2(np.sin(pose[2]), np.cos(pose[2]))))
    return state


def _pose(state: base.SE2StateType) -> FloatArray:
    return np.array([state.getX(), state.getY(), state.getYaw()])


def _after(calls: int):  # type: ignore[no-untyped-def]
    """A condition that ends planning after a number of calls, one per iteration."""
    left = iter(range(calls))
    return lambda: next(left, None) is None
