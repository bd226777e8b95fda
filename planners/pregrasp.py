"""Pre-grasp sliding of an unknown object: Algorithm 4 of Song and Boularias (IROS 2020)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from models.inference.belief import Belief
from models.measurements import Trial
from models.physics.cell_grid import CellGrid, FloatArray
from models.physics.maps import Maps
from planners.exploration import NoReachablePush
from planners.goal_pushing import MadePush, push_to_goal
from planners.goals import Goal, Graspable
from planners.grasps import Grasp
from planners.learn_by_pushing import MakeDataset, learn_by_pushing
from planners.methods import planning_belief
from planners.pregrasp_settings import PregraspSettings
from planners.push_decisions import Allowed
from planners.world import ObjectFell, PushNotMade, World


@dataclass(frozen=True, eq=False)
class Pregrasp:
    """How the procedure ended.

    Attributes:
        success: whether the object lies at a goal, as seen, and can be grasped there.
        reason: in words, of success or failure.
        method: that planned.
        belief: identified, of all hypotheses; None where the object could not be explored.
        explorations: pushes that it was learned from.
        goals: that there were to choose from.
        goal: the last that was aimed at; None where it did not come to that.
        pose: (3,) as seen last, world; None where it did not come to that.
        grasp: the best at this pose; None without success.
        pushes: towards the goal.
    """

    success: bool
    reason: str
    method: str
    belief: Belief | None
    explorations: tuple[Trial, ...] = ()
    goals: tuple[Goal, ...] = ()
    goal: Goal | None = None
    pose: FloatArray | None = None
    grasp: Grasp | None = None
    pushes: tuple[MadePush, ...] = ()


def pregrasp(
    world: World,
    grid: CellGrid,
    heights: ArrayLike,
    make_dataset: MakeDataset,
    settings: PregraspSettings,
    rng: np.random.Generator,
    *,
    method: str = "probabilistic",
    truth: Maps | None = None,
    allowed: Allowed = lambda push: True,
    goal_allowed: Callable[[Goal], bool] = lambda goal: True,
) -> Pregrasp:
    """Explore an unknown object and bring it to the table's edge, where it can be grasped (Algorithm 4).

    The grasp itself (line 8) is left to the robot: `Pregrasp.grasp` says how.

    Args:
        world: with the object on its table.
        grid: the object's cells and outline as seen, lines 1 and 2.
        heights: (n,) of its top over the cells, m.
        make_dataset: puts trials and grid together with what else is known of the cell.
        settings: of the procedure.
        rng: source of every draw.
        method: one of `planners.methods.METHODS`.
        truth: the true maps, for the method `true`.
        allowed: whether the robot can make a push.
        goal_allowed: whether the robot can grasp at a goal.

    Raises:
        ValueError: settings or arguments that make no sense.
    """
    settings.check()
    try:
        belief, trials = learn_by_pushing(world, grid, make_dataset, settings, rng, allowed=allowed)  # line 4
    except (ObjectFell, PushNotMade, NoReachablePush) as error:
        return Pregrasp(False, f"while it was explored: {error}", method, None)
    ended = bring_to_edge(
        world,
        belief,
        heights,
        settings,
        rng,
        method=method,
        truth=truth,
        allowed=allowed,
        goal_allowed=goal_allowed,
    )
    return replace(ended, explorations=trials)


def bring_to_edge(
    world: World,
    belief: Belief,
    heights: ArrayLike,
    settings: PregraspSettings,
    rng: np.random.Generator,
    *,
    method: str = "probabilistic",
    truth: Maps | None = None,
    allowed: Allowed = lambda push: True,
    goal_allowed: Callable[[Goal], bool] = lambda goal: True,
) -> Pregrasp:
    """Lines 5 to 7 of Algorithm 4, for an object that is known already; arguments as for `pregrasp`.

    Args:
        belief: what was identified.
    """
    settings.check()
    known = planning_belief(method, belief, rng, truth)
    thing = Graspable.of(
        known.grid,
        heights,
        known.centers_of_mass,
        known.probability,
        settings.goals,
        masses=known.maps.mass.sum(axis=1),
    )
    goals = thing.sample_goals(world.table, rng, goal_allowed)  # line 5
    if not goals:
        reason = (
            f"of {settings.goals.samples} poses at the edge, in none the object stays with a probability of"
            f" {1 - settings.goals.epsilon:.0%} and can be grasped"
        )
        return Pregrasp(False, reason, method, belief)

    def graspable(pose: FloatArray) -> bool:
        return bool(thing.grasps_at(pose, world.table))

    try:
        ended = push_to_goal(world, known, goals, settings, rng, allowed=allowed, good=graspable)  # 6 and 7
    except ObjectFell as error:
        return Pregrasp(False, str(error), method, belief, goals=tuple(goals))
    return Pregrasp(
        success=ended.reached,
        reason=ended.reason,
        method=method,
        belief=belief,
        goals=tuple(goals),
        goal=ended.goal,
        pose=ended.pose,
        grasp=thing.grasps_at(ended.pose, world.table)[0] if ended.reached else None,
        pushes=ended.pushes,
    )
