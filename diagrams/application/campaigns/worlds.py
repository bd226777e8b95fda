"""The worlds that play the truth in a campaign; each object's is built once in a process."""

from __future__ import annotations

from functools import lru_cache

from slipmap.diagrams.application.campaigns.direct_world import DirectWorld
from slipmap.models.objects.benchmark_objects import benchmark_object

TRUTHS = ("plant", "bullet")
"""Drake's MultibodyPlant; Bullet, which needs the `bench` extra."""


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
