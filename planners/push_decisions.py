"""Algorithm 3: pushing an object to one of several goals, as single decisions and as a whole.

`decide` is one round: from the object's pose and the pushes so far to the next push. Each push is planned
among all goals, whichever was the goal before. Waypoints matter if the straight path to the goal is not safe.
`push_to_goal` repeats rounds in a `World`, a simulation or a robot, which does not follow the plan exactly.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from slipmap.models.geometry import angle_between
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.measurements.trial import Trial
from slipmap.models.physics.balance import balance_margins
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.planners.exploration import NoReachablePush
from slipmap.planners.goals import Goal
from slipmap.planners.robust_push import PlannedPush, least_margins, plan_push
from slipmap.planners.settings import PregraspSettings, PushSettings
from slipmap.planners.table_push import TablePush
from slipmap.planners.waypoints import NoWay, PoseMetric, find_waypoints

_WAYPOINT_REACHED = 0.05  # m; ε of Algorithm 3, line 22: gap of the cells at which a waypoint is passed
_LANDING, _LANDINGS = 0.007, 32  # m, standard deviation of final positions around a goal; number of draws
_SAME_PUSH = 0.005  # m; a push with begin and end nearer than this counts as the refused one

Allowed = Callable[[TablePush], bool]


class NoPushLeft(Exception):
    """No push can bring the object nearer to a goal. The text says what was tried."""


@dataclass(frozen=True, eq=False)
class Way:
    """The path along which the object is being pushed."""

    goal: int  # index of the goal
    waypoints: FloatArray  # (n, 3) remaining ones, the goal last, world


@dataclass(frozen=True, eq=False)
class Pursuit:
    """The history of pushing; empty before the first push."""

    way: Way | None = None  # followed now; None at first
    # index of the goal of every push made; -1 for goals that are none any more
    served: tuple[int, ...] = ()
    # pushes since the last one made that the robot refused, or that touched nothing
    refused: tuple[TablePush, ...] = ()
    refusal: str = ""  # why it did not make the last of these

    def made(self, way: Way) -> Pursuit:
        """The history with one more push made."""
        return Pursuit(way, (*self.served, way.goal))

    def not_made(self, way: Way, push: TablePush, refusal: str) -> Pursuit:
        """The history with one more push refused by the robot, or that touched nothing."""
        return replace(self, way=way, refused=(*self.refused, push), refusal=refusal)

    def to_other_goals(self, places: Mapping[int, int]) -> Pursuit:
        """The history after goals were replaced; all pushes count.

        Args:
            places: new index, by the old one, of the goals that remain.
        """
        way = self.way if self.way is not None and self.way.goal in places else None
        return replace(
            self,
            way=None if way is None else Way(places[way.goal], way.waypoints),
            served=tuple(places.get(goal, -1) for goal in self.served),
        )

    def left_out(self, patience: int) -> set[int]:
        """Goals that at least `patience` pushes have served."""
        return {goal for goal, count in Counter(self.served).items() if goal >= 0 and count >= patience}


@dataclass(frozen=True, eq=False)
class Decision:
    """What to do next."""

    planned: PlannedPush | None  # the next push; None if pushing ends
    way: Way | None  # that it follows; None if there never was one
    reached: bool = False  # whether pushing ends because the object lies within the tolerances of a goal
    reason: str = ""  # why it ends, in words


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
    """One round of Algorithm 3: the next push, or that a goal is reached, or why there is no push.

    Args:
        belief: hypotheses, one or many.
        pose: (3,) of the object now as the tracker reports it, world; the decision and `good` are about the
            true pose that the belief expects for it (`Belief.true_pose`).
        goals: acceptable goals, true poses.
        pursuit: history of pushing.
        good: whether a pose (3,) within the tolerances is acceptable.

    Raises:
        ValueError: there is no goal.
    """
    pose, belief = belief.true_pose(pose), belief.in_world()
    way, count = pursuit.way, len(pursuit.served)
    at = _goal_at(pose, goals, way, settings.push)
    if at is not None and good(pose):
        there = way if way and way.goal == at else Way(at, goals[at].pose[None])
        reason = f"the goal was reached in {count} pushes" if count else "the object already lies at a goal"
        return Decision(None, there, True, reason)
    if count == settings.pushes:
        return Decision(None, way, reason=f"no goal was reached in {count} pushes")
    refused = pursuit.refused
    if len(refused) == settings.refusals:
        reason = f"{len(refused)} pushes in a row were refused or missed, the last because {pursuit.refusal}"
        return Decision(None, way, reason=reason)

    def possible(push: TablePush) -> bool:
        return not any(_same_push(push, other) for other in refused) and allowed(push)

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
    left_out: Collection[int] = (),
) -> tuple[PlannedPush, Way]:
    """The next push towards a goal, and the `Way` that it follows (Algorithm 3, lines 1 to 5 and 22 to 23).

    Args:
        belief, goals: as for `decide`.
        pose: (3,) true pose of the object, world.
        way: followed so far; None at first.
        left_out: indices of goals that were given up.

    Raises:
        ValueError: there is no goal.
        NoPushLeft: every goal was given up or cannot be reached safely.
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
                belief, pose, goals[goal].pose, table, rng,
                epsilon=settings.goals.epsilon, margin=settings.push.margin,
            )  # fmt: skip
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
    """Whether a pose (3,) lies within the tolerances of position and angle around a goal (3,)."""
    distance = np.hypot(*(pose[:2] - goal[:2]))
    angle = abs(angle_between(pose[2], goal[2]))
    return bool(distance <= settings.tolerance and angle <= np.radians(settings.tolerance_angle))


def _goal_at(pose: FloatArray, goals: Sequence[Goal], way: Way | None, settings: PushSettings) -> int | None:
    """Index of the goal at which the object lies: the one that the way leads to, otherwise the best."""
    near = [index for index, goal in enumerate(goals) if near_enough(pose, goal.pose, settings)]
    if way is not None and way.goal in near:
        return way.goal
    return near[0] if near else None


def goal_costs(
    belief: Belief, poses: FloatArray, table: Table, settings: PushSettings, rng: np.random.Generator
) -> FloatArray:
    """(G,) cost of goals (G, 3) in pushes: the risk of falling if the object lands slightly off the goal."""
    off = rng.standard_normal((_LANDINGS, 3)) * [
        _LANDING,
        _LANDING,
        _LANDING / PoseMetric(belief.grid).radius,
    ]
    landed = (poses[:, None] + off).reshape(-1, 3)
    margins = balance_margins(belief.grid, belief.centers_of_mass, landed, table)
    falls = (margins < least_margins(belief, settings)) @ belief.probability
    return settings.fall_cost * falls.reshape(len(poses), _LANDINGS).mean(axis=1)


def _not_yet_passed(waypoints: FloatArray, pose: FloatArray, metric: PoseMetric) -> FloatArray:
    """Waypoints after the last one reached; the goal always stays."""
    reached = np.flatnonzero(metric.gap(pose, waypoints[:-1]) <= _WAYPOINT_REACHED)
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
    """A push to the nearest waypoint (line 4); the goal comes only after all others are passed."""
    nearest = int(np.argmin(PoseMetric(belief.grid).gap(pose, way.waypoints[:-1])))
    left = way.waypoints[nearest:]
    return plan_push(belief, pose, left[0], table, settings.push, rng, allowed), Way(way.goal, left)


def _same_push(one: TablePush, other: TablePush) -> bool:
    apart = np.hypot(*(one.begin - other.begin)), np.hypot(*(one.end - other.end))
    return bool(max(apart) < _SAME_PUSH)


class ObjectFell(Exception):
    """The object is no longer on the table. The text says where it was last seen."""


class PushNotMade(Exception):
    """The robot cannot or will not make this push. The text says why; nothing has moved."""


class World(Protocol):
    """A table with one object on it, and a finger that pushes.

    Attributes:
        table: its top.
        finger_radius: m.
    """

    table: Table
    finger_radius: float

    def look(self) -> FloatArray:
        """(3,) pose of the object as seen now, world, m and rad.

        Raises:
            ObjectFell: it is not on the table.
        """
        ...

    def push(self, push: TablePush) -> Trial:
        """Make a push and return its recording; a fall of the object shows only at the next look.

        Raises:
            PushNotMade: the robot refuses.
        """
        ...


@dataclass(frozen=True, eq=False)
class MadePush:
    """A push towards a goal, and its recording."""

    before: FloatArray  # (3,) pose seen before it, as the tracker reports it, world
    goal: Goal  # that it served
    planned: PlannedPush  # push and prediction
    trial: Trial  # its recording


@dataclass(frozen=True, eq=False)
class Pushing:
    """The outcome of pushing to a goal."""

    reached: bool  # whether the object was seen within the tolerances of `goal`
    goal: Goal | None  # where it lies if reached, otherwise the last one aimed at; None if there was none
    pose: FloatArray  # (3,) last seen, world
    pushes: tuple[MadePush, ...]  # all that were made
    reason: str  # why pushing ended, in words


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

    Pushing ends when the object lies within the tolerances of a goal, also at once, when it has fallen,
    when the budget of pushes is spent, after too many refusals in a row, or when no push is left: goals are
    given up after `settings.patience` pushes, and pushes that the robot refused are not requested again.

    Args:
        goals: at least one, best first.
        belief, good: as for `decide`.

    Raises:
        ValueError: there is no goal.
    """
    pose, pursuit = world.look(), Pursuit()
    made: list[MadePush] = []
    while True:
        decision = decide(
            belief, pose, goals, pursuit, world.table, settings, rng, allowed=allowed, good=good
        )
        goal = goals[decision.way.goal] if decision.way else None
        if decision.planned is None or decision.way is None or goal is None:
            return Pushing(decision.reached, goal, pose, tuple(made), decision.reason)
        try:
            trial = world.push(decision.planned.push)
        except PushNotMade as error:
            pursuit = pursuit.not_made(decision.way, decision.planned.push, str(error))
            continue
        pursuit = pursuit.made(decision.way)
        made.append(MadePush(pose, goal, decision.planned, trial))
        try:
            pose = world.look()
        except ObjectFell as error:
            return Pushing(False, goal, pose, tuple(made), str(error))
