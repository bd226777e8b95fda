"""Pushes recorded in a campaign's world, as a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from diagrams.campaigns.direct_world import DirectWorld
from diagrams.systems.measurement_logger import dataset_of
from models.measurements import PushDataset, Trial


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
