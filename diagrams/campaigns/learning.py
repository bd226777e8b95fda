"""Pushes recorded in a campaign's world, and what is learned from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from diagrams.campaigns.direct_world import DirectWorld
from diagrams.campaigns.worlds import world_of
from diagrams.systems.measurement_logger import dataset_of
from models.inference.belief import Belief
from models.measurements import PushDataset, Trial
from planners.learn_by_pushing import learn_by_pushing
from planners.pregrasp_settings import PregraspSettings

PUSHES = 5
"""From which an object is identified, as in the paper."""


def as_dataset(world: DirectWorld, fit: Sequence[Trial], heldout: Sequence[Trial] = ()) -> PushDataset:
    """Recorded trials as a dataset: those to learn from, then those to judge with.

    Raises:
        DatasetError: there is no trial.
    """
    trials = [
        replace(trial, name=f"trials/{number:03d}.json", role="fit" if number < len(fit) else "heldout")
        for number, trial in enumerate([*fit, *heldout])
    ]
    return dataset_of(
        trials,
        world.true_object.grid,
        name=world.true_object.name,
        finger_radius=world.finger_radius,
        noise=world.noise.sensors,
        table=world.table,
        description=f"Recorded in the world of {type(world).__name__}.",
    )


@lru_cache(maxsize=32)
def identified(truth: str, object_name: str, seed: int) -> Belief:
    """What five pushes of an object in its world teach; made once in a process for each seed.

    Raises:
        ObjectFell, PushNotMade: the object could not be explored.
    """
    return explored(world_of(truth, object_name), seed)[0]


def explored(world: DirectWorld, seed: int) -> tuple[Belief, tuple[Trial, ...]]:
    """What `PUSHES` pushes teach of the object at the table's middle, and the pushes.

    Raises:
        ObjectFell, PushNotMade: the object could not be explored.
    """
    rng = np.random.default_rng([seed, 0])
    world.reset(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]), rng)
    return learn_by_pushing(
        world,
        world.true_object.grid,
        lambda trials, grid: as_dataset(world, trials),
        PregraspSettings(explorations=PUSHES),
        np.random.default_rng([seed, 1]),
    )
