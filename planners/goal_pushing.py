"""Pushing an object to a goal in a world that does not do what was planned: Algorithm 3 as a whole.

After each push the object is looked at and the next push planned anew, among all goals: what was to be the
goal before does not bind. Waypoints count where the straight way to the goal is not safe.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from models.inference.belief import Belief
from models.measurements.push_dataset import Table, Trial
from models.physics.balance import balance_margins
from models.physics.cell_grid import FloatArray
from planners.exploration import NoReachablePush
from planners.foresight import least_margins
from planners.goals import Goal
from planners.pose_metric import PoseMetric, angle_between
from planners.pregrasp_settings import PregraspSettings, PushSettings
from planners.robust_push import PlannedPush, plan_push
from planners.table_push import TablePush
from planners.waypoints import NoWay, find_waypoints
from planners.world import ObjectFell, PushNotMade, World

WAYPOINT_REACHED = 0.05
"""ε of Algorithm 3, line 22: gap of the cells at which a waypoint counts as passed, m."""

LANDING, LANDINGS = 0.007, 32
"""One standard deviation of where an object comes to lie around a goal, m, and how often that is drawn."""

SAME_PUSH = 0.005
"""Pushes whose begins and ends are nearer than this count as the one that was refused, m."""

Allowed = Callable[[TablePush], bool]


class NoPushLeft(Exception):
    """Nothing that could be tried brings the object nearer to a goal. The text says what was tried."""


@dataclass(frozen=True, eq=False)
class Way:
    """Where the object is being pushed.

    Attributes:
        goal: index of the goal.
        waypoints: (n, 3) that are left, the goal last, world.
    """

    goal: int
    waypoints: FloatArray


@dataclass(frozen=True, eq=False)
class MadePush:
    """A push towards a goal.

    Attributes:
        before: (3,) pose as seen before, world.
        goal: that it served.
        planned: push and prediction.
        trial: what was recorded.
    """

    before: FloatArray
    goal: Goal
    planned: PlannedPush
    trial: Trial


@dataclass(frozen=True, eq=False)
class Pushing:
    """How pushing to a goal ended.

    Attributes:
        reached: whether the object lies within the tolerances of `goal`, as seen.
        goal: the last that was aimed at; None where there was no push.
        pose: (3,) as seen last, world.
        pushes: that were made.
        reason: in words.
    """

    reached: bool
    goal: Goal | None
    pose: FloatArray
    pushes: tuple[MadePush, ...]
    reason: str


def push_to_goal(
    world: World,
    belief: Belief,
    goals: Sequence[Goal],
    settings: PregraspSettings,
    rng: np.random.Generator,
    *,
    allowed: Allowed = lambda push: True,
    good: Callable[[FloatArray], bool] = lambda pose: True,
) -> Pushing:
    """Push the object to one of the goals (Algorithm 3).

    Ends when the object lies within the tolerances of the goal last aimed at; or it fell; or the budget of
    pushes is spent; or no push is left, because goals are left out after `settings.patience` pushes, pushes
    that the robot refused are not asked for again, and too many refusals in a row end it too.

    Args:
        world: where pushes are made.
        belief: hypotheses, one or many.
        goals: at least one, best first.
        settings: of the procedure.
        rng: source of every draw.
        allowed: whether the robot can make a push.
        good: whether a pose (3,) within the tolerances will do.

    Raises:
        ValueError: there is no goal.
    """
    pose, way = world.look(), None
    made: list[MadePush] = []
    refused: list[TablePush] = []
    served: Counter[int] = Counter()

    def possible(push: TablePush) -> bool:
        return not any(_alike(push, other) for other in refused) and allowed(push)

    def ended(reached: bool, reason: str) -> Pushing:
        return Pushing(reached, goals[way.goal] if way else None, pose, tuple(made), reason)

    while True:
        goal = goals[way.goal] if way else None
        if goal and made and near_enough(pose, goal.pose, settings.push) and good(pose):
            return ended(True, f"the goal was reached with {len(made)} pushes")
        if len(made) == settings.pushes:
            return ended(False, f"no goal was reached with {settings.pushes} pushes")
        left_out = {index for index, count in served.items() if count >= settings.patience}
        try:
            planned, way = next_push(
                belief, pose, goals, way, world.table, settings, rng, allowed=possible, left_out=left_out
            )
        except (NoPushLeft, NoReachablePush) as error:
            return ended(False, str(error))
        try:
            trial = world.push(planned.push)
        except PushNotMade as error:
            refused.append(planned.push)
            if len(refused) == settings.refusals:
                return ended(False, f"{len(refused)} pushes in a row were refused, the last because {error}")
            continue
        refused.clear()
        served[way.goal] += 1
        made.append(MadePush(pose, goals[way.goal], planned, trial))
        try:
            pose = world.look()
        except ObjectFell as error:
            return ended(False, str(error))


def next_push(
    belief: Belief,
    pose: FloatArray,
    goals: Sequence[Goal],
    way: Way | None,
    table: Table,
    settings: PregraspSettings,
    rng: np.random.Generator,
    *,
    allowed: Allowed = lambda push: True,
    left_out: set[int] = frozenset(),  # type: ignore[assignment]
) -> tuple[PlannedPush, Way]:
    """The next push towards a goal, and the way that it follows (Algorithm 3, lines 1 to 5 and 22 to 23).

    Args:
        belief: hypotheses, one or many.
        pose: (3,) of the object now, world.
        goals: that will do.
        way: that was followed so far; None at first.
        table: its top.
        settings: of the procedure.
        rng: source of every draw.
        allowed: whether the robot can make a push.
        left_out: indices of goals that are given up.

    Raises:
        ValueError: there is no goal.
        NoPushLeft: every goal is given up or cannot be reached safely.
        NoReachablePush: no candidate is allowed.
    """
    if not goals:
        raise ValueError("planning: there is no goal to push to")
    metric = PoseMetric(belief.grid)
    if way and way.goal not in left_out:
        waypoints = _not_yet_passed(way.waypoints, pose, metric)
        if len(waypoints) > 1:
            return _towards_nearest(belief, pose, Way(way.goal, waypoints), table, settings, rng, allowed)
    usable = [index for index in range(len(goals)) if index not in left_out]
    while usable:
        poses = np.array([goals[index].pose for index in usable])
        costs = goal_costs(belief, poses, table, settings.push, rng)
        planned = plan_push(belief, pose, poses, table, settings.push, rng, allowed, costs)
        goal = usable[planned.target]
        try:
            waypoints = find_waypoints(
                belief,
                pose,
                goals[goal].pose,
                table,
                rng,
                epsilon=settings.goals.epsilon,
                margin=settings.push.margin,
            )
        except NoWay:
            usable.remove(goal)
            continue
        if len(waypoints) == 1:
            return planned, Way(goal, waypoints)
        return _towards_nearest(belief, pose, Way(goal, waypoints), table, settings, rng, allowed)
    raise NoPushLeft(
        f"of {len(goals)} goals, {len(left_out)} were given up after {settings.patience} pushes each, and"
        " the others cannot be reached without risking a fall"
    )


def near_enough(pose: FloatArray, goal: FloatArray, settings: PushSettings) -> bool:
    """Whether a pose (3,) lies within the tolerances of place and angle around a goal (3,)."""
    distance = np.hypot(*(pose[:2] - goal[:2]))
    angle = abs(angle_between(pose[2], goal[2]))
    return bool(distance <= settings.tolerance and angle <= np.radians(settings.tolerance_angle))


def goal_costs(
    belief: Belief, poses: FloatArray, table: Table, settings: PushSettings, rng: np.random.Generator
) -> FloatArray:
    """(G,) price of goals (G, 3) in pushes: the risk of falling there if the object lands a little off."""
    off = rng.standard_normal((LANDINGS, 3)) * [LANDING, LANDING, LANDING / PoseMetric(belief.grid).radius]
    landed = (poses[:, None] + off).reshape(-1, 3)
    margins = balance_margins(belief.grid, belief.centers_of_mass, landed, table)
    falls = (margins < least_margins(belief, settings)) @ belief.probability
    return settings.fall_cost * falls.reshape(len(poses), LANDINGS).mean(axis=1)


def _not_yet_passed(waypoints: FloatArray, pose: FloatArray, metric: PoseMetric) -> FloatArray:
    """Waypoints without those that are reached, and those before them; the goal always stays."""
    reached = np.flatnonzero(metric.gap(pose, waypoints[:-1]) <= WAYPOINT_REACHED)
    return waypoints[reached[-1] + 1 :] if len(reached) else waypoints


def _towards_nearest(
    belief: Belief,
    pose: FloatArray,
    way: Way,
    table: Table,
    settings: PregraspSettings,
    rng: np.random.Generator,
    allowed: Allowed,
) -> tuple[PlannedPush, Way]:
    """A push to the nearest waypoint (line 4); the goal has to wait until all others are passed."""
    nearest = int(np.argmin(PoseMetric(belief.grid).gap(pose, way.waypoints[:-1])))
    left = way.waypoints[nearest:]
    return plan_push(belief, pose, left[0], table, settings.push, rng, allowed), Way(way.goal, left)


def _alike(one: TablePush, other: TablePush) -> bool:
    apart = np.hypot(*(one.begin - other.begin)), np.hypot(*(one.end - other.end))
    return bool(max(apart) < SAME_PUSH)
