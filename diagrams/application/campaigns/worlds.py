"""The worlds that play the truth in a campaign, and what is learned from pushes in them.

Each object's world is built, and each belief is made, once in a process.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from slipmap.diagrams.application.campaigns.direct_world import DirectWorld
from slipmap.diagrams.systems.measurement_logger import dataset_of
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements import PushDataset, Trial
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.planners.pregrasp import learn_by_pushing
from slipmap.planners.settings import PregraspSettings

TRUTHS = ("plant", "bullet")
"""Drake's MultibodyPlant; Bullet, which needs the `bench` extra."""

_MOST_PUSHES = 5  # from which an object is identified, as in the paper


@lru_cache(maxsize=16)
def world_of(truth: str, object_name: str) -> DirectWorld:
    """The world of one of the paper's objects on the paper's table, with the usual noise.

    Raises:
        ValueError: an unknown truth or object.
        ModuleNotFoundError: Bullet is not installed.
    """
    thing = benchmark_object(object_name)
    if truth == "plant":
        from slipmap.diagrams.application.campaigns.plant_world import PlantWorld

        return PlantWorld(thing)
    if truth == "bullet":
        from slipmap.diagrams.application.campaigns.bullet_world import BulletWorld

        return BulletWorld(thing)
    raise ValueError(f"unknown truth {truth!r}; choose one of {', '.join(TRUTHS)}")


def as_dataset(world: DirectWorld, fit: Sequence[Trial], heldout: Sequence[Trial] = ()) -> PushDataset:
    """RecordedRun trials as a dataset: those to learn from, then those to judge with.

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
        description=f"RecordedRun in the world of {type(world).__name__}.",
    )


@lru_cache(maxsize=32)
def identified(truth: str, object_name: str, seed: int) -> Belief:
    """What five pushes of an object in its world teach; made once in a process for each seed.

    Raises:
        ObjectFell, PushNotMade: the object could not be explored.
    """
    return explored(world_of(truth, object_name), seed)[0]


def explored(world: DirectWorld, seed: int) -> tuple[Belief, tuple[Trial, ...]]:
    """What `_MOST_PUSHES` pushes teach of the object at the table's middle, and the pushes.

    Raises:
        ObjectFell, PushNotMade: the object could not be explored.
    """
    rng = np.random.default_rng([seed, 0])
    world.reset(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]), rng)
    return learn_by_pushing(
        world,
        world.true_object.grid,
        lambda trials, grid: as_dataset(world, trials),
        PregraspSettings(explorations=_MOST_PUSHES),
        np.random.default_rng([seed, 1]),
    )
