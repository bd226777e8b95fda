"""One round of Algorithm 3: where the object lies, and what came of pushing so far, to the next push.

Each push is planned anew, among all goals: what was to be the goal before does not bind. Waypoints count
where the straight way to the goal is not safe.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.angles import angle_between
from models.inference.belief import Belief
from models.measurements.push_dataset import Table
from models.physics.balance import balance_margins
from models.physics.cell_grid import FloatArray
from planners.exploration import NoReachablePush
from planners.foresight import least_margins
from planners.goals import Goal
from planners.pose_metric import PoseMetric
from planners.pregrasp_settings import PregraspSettings, PushSettings
from planners.robust_push import PlannedPush, plan_push
from planners.table_push import TablePush
from planners.waypoints import NoWay, find_waypoints

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
class Pursuit:
    """What came of pushing so far; nothing before the first push.

    Attributes:
        way: that is followed; None at first.
        served: goal, by its index, of every push that was made.
        refused: pushes that the robot refused since the last that was made.
        refusal: why it refused the last of these.
    """

    way: Way | None = None
    served: tuple[int, ...] = ()
    refused: tuple[TablePush, ...] = ()
    refusal: str = ""

    def made(self, way: Way) -> Pursuit:
        """After one more push on a way was made."""
        return Pursuit(way, (*self.served, way.goal))

    def not_made(self, way: Way, push: TablePush, refusal: str) -> Pursuit:
        """After the robot refused one."""
        return replace(self, way=way, refused=(*self.refused, push), refusal=refusal)

    def left_out(self, patience: int) -> set[int]:
        """Goals that were served by so many pushes."""
        return {goal for goal, count in Counter(self.served).items() if count >= patience}


@dataclass(frozen=True, eq=False)
class Decision:
    """What to do next.

    Attributes:
        planned: the next push; None where pushing ends.
        way: that it follows; None where there never was one.
        reached: whether pushing ends because the object lies within the tolerances of a goal.
        reason: why it ends, in words.
    """

    planned: PlannedPush | None
    way: Way | None
    reached: bool = False
    reason: str = ""


def decide(
    belief: Belief,
    pose: FloatArray,
    goals: Sequence[Goal],
    pursuit: Pursuit,
    table: Table,
    settings: PregraspSettings,
    rng: np.random.Generator,
    *,
    allowed: Allowed = lambda push: True,
    good: Callable[[FloatArray], bool] = lambda pose: True,
) -> Decision:
    """One round of Algorithm 3: the next push, or that the object lies at a goal, or why there is no push.

    Args:
        belief: hypotheses, one or many.
        pose: (3,) of the object now, world.
        goals: that will do.
        pursuit: what came of pushing so far.
        table: its top.
        settings: of the procedure.
        rng: source of every draw.
        allowed: whether the robot can make a push.
        good: whether a pose (3,) within the tolerances will do.

    Raises:
        ValueError: there is no goal.
    """
    way, count = pursuit.way, len(pursuit.served)
    if way and count and near_enough(pose, goals[way.goal].pose, settings.push) and good(pose):
        return Decision(None, way, True, f"the goal was reached with {count} pushes")
    if count == settings.pushes:
        return Decision(None, way, reason=f"no goal was reached with {count} pushes")
    refused = pursuit.refused
    if len(refused) == settings.refusals:
        reason = f"{len(refused)} pushes in a row were refused, the last because {pursuit.refusal}"
        return Decision(None, way, reason=reason)

    def possible(push: TablePush) -> bool:
        return not any(_alike(push, other) for other in refused) and allowed(push)

    left_out = pursuit.left_out(settings.patience)
    try:
        planned, way = next_push(
            belief, pose, goals, way, table, settings, rng, allowed=possible, left_out=left_out
        )
    except (NoPushLeft, NoReachablePush) as error:
        return Decision(None, way, reason=str(error))
    return Decision(planned, way)


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
