"""Pre-grasp sliding of an unknown object: Algorithm 4 of Song and Boularias (IROS 2020).

The whole procedure in a `World` is `learn_by_pushing` (Algorithms 1 and 2), then `bring_to_edge`; the grasp
itself (line 8) is left to the robot. The methods that the paper compares (section VI.B) plan in the same way,
but with different beliefs, made by `planning_belief`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from slipmap.models.inference.belief import END_ERRORS, Belief
from slipmap.models.inference.identification import identify
from slipmap.models.inference.prediction import uniform_maps
from slipmap.models.measurements import Trial
from slipmap.models.measurements.push_dataset import MakeDataset
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.maps import Maps
from slipmap.planners.action_selection import Choice, choose_push
from slipmap.planners.goals import Goal, Graspable
from slipmap.planners.grasps import Grasp
from slipmap.planners.push_decisions import Allowed, MadePush, ObjectFell, PushNotMade, World, push_to_goal
from slipmap.planners.settings import METHODS, PregraspSettings
from slipmap.planners.table_push import TablePush


def planning_belief(
    method: str, belief: Belief, rng: np.random.Generator, truth: Maps | None = None
) -> Belief:
    """The belief with which a method plans; the planner itself is the same for all methods.

    Args:
        method: one of `METHODS`.
        rng: source of the draw of `deterministic`.
        truth: the true maps, one hypothesis; only `true` uses them.

    Raises:
        ValueError: an unknown method, or `true` without one true map.
    """
    if method == "probabilistic":
        return belief
    if method == "deterministic":
        k = int(rng.choice(len(belief), p=belief.probability / belief.probability.sum()))
        return _alone(belief, belief.maps[k : k + 1], method)
    if method == "uniform":
        return _alone(belief, uniform_maps(belief), method)
    if method == "true":
        if truth is None or len(truth) != 1:
            raise ValueError("method 'true' needs the true maps, exactly one hypothesis")
        plain = Maps(belief.maps.mass, belief.maps.mu, belief.maps.mu_finger)
        known = belief if truth.effects.shape[1] else replace(belief, maps=plain, effects=())
        return _alone(known, truth, method)
    raise ValueError(f"unknown method {method!r}; choose one of {', '.join(METHODS)}")


def _alone(belief: Belief, maps: Maps, method: str) -> Belief:
    """A belief in one hypothesis as the truth, without the model errors learned with the full belief."""
    settings = {**belief.settings, "planning": method}
    settings.pop(END_ERRORS, None)
    return replace(belief, maps=maps, probability=np.ones(1), settings=settings)


def learn_by_pushing(
    world: World,
    grid: CellGrid,
    make_dataset: MakeDataset,
    settings: PregraspSettings,
    rng: np.random.Generator,
    *,
    allowed: Callable[[TablePush], bool] = lambda push: True,
) -> tuple[Belief, tuple[Trial, ...]]:
    """Choose a push, make it and identify, as often as the settings say; the belief comes from all pushes.

    Args:
        grid: the object as seen.

    Raises:
        ObjectFell: the object is no longer on the table.
        PushNotMade: the robot refused `settings.refusals` pushes in a row.
        NoReachablePush: no candidate is allowed.
    """
    seed = int(rng.integers(2**31))

    def learn(trials: Sequence[Trial]) -> Belief:
        return identify(
            make_dataset(trials, grid), hypotheses=settings.hypotheses, seed=seed, friction_laws=False
        ).belief

    trials = explore(world, grid, settings, rng, learn=learn, allowed=allowed)
    return learn(trials), trials


def explore(
    world: World,
    grid: CellGrid,
    settings: PregraspSettings,
    rng: np.random.Generator,
    *,
    learn: Callable[[Sequence[Trial]], Belief],
    allowed: Callable[[TablePush], bool] = lambda push: True,
) -> tuple[Trial, ...]:
    """Choose and make pushes one after another (Algorithm 2), and record them.

    Args:
        grid: the object as seen.
        learn: computes the belief from pushes; called before each push whose choice depends on it.

    Raises:
        ObjectFell, PushNotMade, NoReachablePush: as for `learn_by_pushing`.
    """
    belief: Belief | None = None
    choices: list[Choice] = []
    trials: list[Trial] = []
    refusals = 0
    while len(trials) < settings.explorations:
        if settings.strategy == "most-distinctive" and trials and refusals == 0:
            belief = learn(trials)
        choice = choose_push(
            grid, world.look(), world.finger_radius,
            strategy=settings.strategy, belief=belief, past=choices, settings=settings.poke,
            table=world.table, allowed=allowed, rng=rng,
        )  # fmt: skip
        try:
            trial = world.push(choice.push)
        except PushNotMade:
            refusals += 1
            if refusals == settings.refusals:
                raise
            continue
        refusals = 0
        choices.append(choice)
        trials.append(replace(trial, name=f"trials/{len(trials):03d}.json", role="fit"))
    world.look()
    return tuple(trials)


@dataclass(frozen=True, eq=False)
class Pregrasp:
    """The outcome of the procedure."""

    success: bool  # whether the object was seen to lie at a goal and can be grasped there
    reason: str  # of success or failure, in words
    method: str  # of planning
    belief: Belief  # identified, with all hypotheses
    goal: Goal | None = None  # the last one aimed at, if any
    pose: FloatArray | None = None  # (3,) last seen, as the tracker reports it, world, if any
    grasp: Grasp | None = None  # the best at this pose; None without success
    pushes: tuple[MadePush, ...] = ()  # towards the goal


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
    """Push an object that is already identified to a goal at the edge (Algorithm 4, lines 5 to 7).

    Args:
        world: with the object on its table.
        heights: (n,) of the object's top over the cells, m.
        method: one of `slipmap.planners.settings.METHODS`.
        truth: the true maps, for the method `true`.
        goal_allowed: whether the robot can grasp at a goal.

    Raises:
        ValueError: invalid settings or arguments.
    """
    settings.check()
    known = planning_belief(method, belief, rng, truth)
    thing = Graspable.of_belief(known, heights, settings.goals)
    goals = thing.sample_goals(world.table, rng, goal_allowed)  # line 5
    if not goals:
        reason = (
            f"at none of {settings.goals.samples} poses at the edge can the object be grasped and stay on the"
            f" table with a probability of {1 - settings.goals.epsilon:.0%}"
        )
        return Pregrasp(False, reason, method, belief)

    def graspable(pose: FloatArray) -> bool:
        return bool(thing.grasps_at(pose, world.table))

    try:
        ended = push_to_goal(world, known, goals, settings, rng, allowed=allowed, good=graspable)  # 6 and 7
    except ObjectFell as error:
        return Pregrasp(False, str(error), method, belief)
    return Pregrasp(
        success=ended.reached,
        reason=ended.reason,
        method=method,
        belief=belief,
        goal=ended.goal,
        pose=ended.pose,
        grasp=thing.grasps_at(known.true_pose(ended.pose), world.table)[0] if ended.reached else None,
        pushes=ended.pushes,
    )
