"""Errors of a belief on pushes that were locked away before anything was fitted."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slipmap.models.inference.push_errors import Errors
from slipmap.models.inference.results import Identification
from slipmap.models.measurements import DatasetError, PushDataset, Trial
from slipmap.models.physics.cell_grid import FloatArray


@dataclass(frozen=True, eq=False)
class LockedErrors:
    """Errors on each of L locked pushes."""

    path: FloatArray  # (L,) ADD averaged over the trajectory, m
    final: FloatArray  # (L,) ADD at the end, m
    misfit: FloatArray  # (L,) of each, see `push_errors.Errors`

    @classmethod
    def of(cls, errors: Sequence[Errors]) -> LockedErrors:
        """Join the errors of L pushes."""
        names = ("mean_add", "final_add", "misfit")
        return cls(*(np.array([getattr(error, name) for error in errors]) for name in names))

    @property
    def total_misfit(self) -> float:
        """Root mean square of the misfits over all pushes."""
        return float(np.sqrt((self.misfit**2).mean()))


def locked_trials(dataset: PushDataset, rng: np.random.Generator) -> list[str]:
    """Names of the trials to lock away: those held out, otherwise three in ten if there are at least
    three."""
    heldout = [trial.name for trial in dataset.heldout_trials]
    if heldout:
        return heldout
    names = [trial.name for trial in dataset.trials]
    if len(names) < 3:
        return []
    count = max(1, round(0.3 * len(names)))
    return sorted(rng.choice(names, count, replace=False).tolist())


def open_trials(dataset: PushDataset, locked: Collection[str]) -> list[Trial]:
    """The trials that are not locked away.

    Raises:
        DatasetError: there are none.
    """
    trials = [trial for trial in dataset.trials if trial.name not in locked]
    if not trials:
        raise DatasetError(
            f"dataset {dataset.name} has no push left to fit; set the role of at least one push to fit"
        )
    return trials


def with_locked(dataset: PushDataset, locked: Collection[str]) -> PushDataset:
    """The dataset with the trials of these names held out and all others to learn from."""
    trials = tuple(
        replace(trial, role="heldout" if trial.name in locked else "fit") for trial in dataset.trials
    )
    return replace(dataset, trials=trials)


def locked_errors(learned: Identification) -> LockedErrors | None:
    """Errors of a belief on the pushes held out from it; None where there are none."""
    errors = [push.errors for push in learned.pushes if push.role == "heldout"]
    return LockedErrors.of(errors) if errors else None
