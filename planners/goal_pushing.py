"""Pushing an object to a goal in a world that does not do what was planned: Algorithm 3 as a whole."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from models.inference.belief import Belief
from models.measurements import Trial
from models.physics.cell_grid import FloatArray
from planners.goals import Goal
from planners.pregrasp_settings import PregraspSettings
from planners.push_decisions import Allowed, Pursuit, decide
from planners.robust_push import PlannedPush
from planners.world import ObjectFell, PushNotMade, World


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
    pose, pursuit = world.look(), Pursuit()
    made: list[MadePush] = []
    while True:
        told = decide(belief, pose, goals, pursuit, world.table, settings, rng, allowed=allowed, good=good)
        goal = goals[told.way.goal] if told.way else None
        if told.planned is None or told.way is None or goal is None:
            return Pushing(told.reached, goal, pose, tuple(made), told.reason)
        try:
            trial = world.push(told.planned.push)
        except PushNotMade as error:
            pursuit = pursuit.not_made(told.way, told.planned.push, str(error))
            continue
        pursuit = pursuit.made(told.way)
        made.append(MadePush(pose, goal, told.planned, trial))
        try:
            pose = world.look()
        except ObjectFell as error:
            return Pushing(False, goal, pose, tuple(made), str(error))
