"""Pushing an object in a world to learn what it is like: Algorithms 1 and 2 together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from models.inference.belief import Belief
from models.inference.identification import identify
from models.measurements import PushDataset, Trial
from models.physics.cell_grid import CellGrid
from planners.action_selection import Poke, select_poke
from planners.pregrasp_settings import PregraspSettings
from planners.table_push import TablePush
from planners.world import PushNotMade, World

MakeDataset = Callable[[Sequence[Trial], CellGrid], PushDataset]


def learn_by_pushing(
    world: World,
    grid: CellGrid,
    make_dataset: MakeDataset,
    settings: PregraspSettings,
    rng: np.random.Generator,
    *,
    allowed: Callable[[TablePush], bool] = lambda push: True,
) -> tuple[Belief, tuple[Trial, ...]]:
    """Choose a push, make it, identify; as often as the settings say. The belief comes from all pushes.

    Args:
        world: where pushes are made.
        grid: the object as it was seen.
        make_dataset: puts trials and grid together with what else is known of the cell.
        settings: of the procedure.
        rng: source of every draw.
        allowed: whether the robot can make a push.

    Raises:
        ObjectFell: it is not on the table any more.
        PushNotMade: the robot refused `settings.refusals` pushes in a row.
        NoReachablePush: no candidate is allowed.
    """
    seed = int(rng.integers(2**31))

    def learn(trials: Sequence[Trial]) -> Belief:
        return identify(make_dataset(trials, grid), hypotheses=settings.hypotheses, seed=seed).belief

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
    """Choose and make pushes one after the other (Algorithm 2), and record them.

    Args:
        world: where pushes are made.
        grid: the object as it was seen.
        settings: of the procedure.
        rng: source of every draw.
        learn: the belief after some pushes; asked before each push whose choice depends on it.
        allowed: whether the robot can make a push.

    Raises:
        ObjectFell, PushNotMade, NoReachablePush: see `learn_by_pushing`.
    """
    belief: Belief | None = None
    pokes: list[Poke] = []
    trials: list[Trial] = []
    refusals = 0
    while len(trials) < settings.explorations:
        if settings.strategy == "most-distinctive" and trials and refusals == 0:
            belief = learn(trials)
        poke = select_poke(
            grid,
            world.look(),
            world.finger_radius,
            strategy=settings.strategy,
            belief=belief,
            past=pokes,
            settings=settings.poke,
            allowed=allowed,
            rng=rng,
        )
        try:
            trial = world.push(poke.push)
        except PushNotMade:
            refusals += 1
            if refusals == settings.refusals:
                raise
            continue
        refusals = 0
        pokes.append(poke)
        trials.append(replace(trial, name=f"trials/{len(trials):03d}.json", role="fit"))
    world.look()
    return tuple(trials)
