"""Errors of a belief on pushes that were locked away before anything was fitted. Datasets of a joint
diagnosis with their locked pushes, and models that these have judged."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slipmap.models.inference.belief import Belief
from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.inference.identification import with_fewer_cells
from slipmap.models.inference.observations import Observation, observe_all, to_learn_from
from slipmap.models.inference.prediction import predicted_motion
from slipmap.models.inference.prior import MapPrior
from slipmap.models.inference.push_errors import Errors, Paired, errors
from slipmap.models.inference.results import Identification
from slipmap.models.inference.together import JointFit, Taught
from slipmap.models.measurements import DatasetError, PushDataset, Trial
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps
from slipmap.models.progress import StageProgress

UNAFFECTED = 0.5
"""Nats by which the cost of a dataset's locked pushes may change where an effect makes no difference to them.
By noise alone, one more parameter changes a cost by half a nat on average."""

CLEARLY = 3.0
"""Nats by which locked pushes are clearly predicted better or worse: 20 to 1."""


def turned(fall: float) -> str:
    """Whether a drop in the cost of a dataset's locked pushes, in nats, is `better`, `worse` or neither."""
    if abs(fall) <= UNAFFECTED:
        return "unaffected"
    return "better" if fall > 0.0 else "worse"


@dataclass(frozen=True, eq=False)
class LockedErrors:
    """Errors on each of L locked pushes."""

    path: FloatArray  # (L,) ADD averaged over the trajectory, m
    final: FloatArray  # (L,) ADD at the end, m
    misfit: FloatArray  # (L,) of each, see `push_errors.Errors`
    spread: FloatArray  # (L,) misfit that the spread of the hypotheses alone would cause

    @classmethod
    def of(cls, errors: Sequence[Errors], spread: Sequence[float] | FloatArray) -> LockedErrors:
        """Join the errors of L pushes, and the misfits (L,) by the spread of the hypotheses."""
        names = ("mean_add", "final_add", "misfit")
        path, final, misfit = (np.array([getattr(error, name) for error in errors]) for name in names)
        return cls(path, final, misfit, np.array(spread))

    def with_open_misfits(self, other: LockedErrors) -> LockedErrors:
        """The same, each misfit raised to what this model and another one both leave open.

        A push near balance may end far from where either says, and within what both leave open.
        """
        return replace(self, misfit=np.maximum(self.misfit, np.minimum(self.spread, other.spread)))

    @property
    def ends_only(self) -> bool:
        """Whether nothing was measured on the way, so that `path` repeats `final`."""
        return bool(np.array_equal(self.path, self.final))

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
    pushes = [push for push in learned.pushes if push.role == "heldout"]
    if not pushes:
        return None
    return LockedErrors.of([push.errors for push in pushes], [push.spread_misfit for push in pushes])


@dataclass(frozen=True, eq=False)
class Ground:
    """One dataset, fitted without effects, with its locked pushes."""

    taught: Taught
    locked: Sequence[Observation]
    whole: bool  # whether the whole object is locked away, so that its open pushes teach only its maps

    @classmethod
    def of(
        cls, dataset: PushDataset, whole: bool, rng: np.random.Generator, progress: StageProgress
    ) -> Ground:
        """Lock some pushes of a dataset away, and fit the model without effects to the others."""
        locked = locked_trials(dataset, rng)
        trials = to_learn_from(open_trials(dataset, locked))
        taught = Taught.of(with_fewer_cells(dataset), observe_all(dataset, trials), progress)
        judging = [trial for trial in dataset.trials if trial.name in locked]
        return cls(taught, observe_all(dataset, judging), whole)

    def judged(self, prior: MapPrior, z: FloatArray, seed: int) -> tuple[LockedErrors, FloatArray] | None:
        """Errors and costs (L,) of the locked pushes at coordinates z (d,); None without locked pushes."""
        if not self.locked:
            return None
        dataset, slider = self.taught.dataset, prior.slider
        belief = Belief.learned(
            dataset, slider, prior.maps(z[None]), np.ones(1), method="gauss-newton", seed=seed,
            trials=[o.trial for o in self.taught.observations], settings={},
        )  # fmt: skip
        noise = sensor_noise(dataset)
        found = [
            errors(o, motion.middle_poses, motion.mean_forces, dataset.grid, noise)
            for o, motion in zip(self.locked, predicted_motion(belief, self.locked), strict=True)
        ]
        return LockedErrors.of(found, np.zeros(len(found))), self.taught.costs(self.locked, prior, z)


@dataclass(frozen=True, eq=False)
class JudgedFit:
    """A model with effects that the locked pushes have judged."""

    fit: JointFit
    after: list[LockedErrors | None]  # of each dataset
    falls: list[float]  # drop in cost of each dataset's locked pushes, nats
    held: list[Maps]  # best maps of each dataset with the effects held, one hypothesis
    score: float  # evidence from the open pushes plus drop in cost of the locked ones, nats
    datasets: tuple[str, ...]  # their names
    shared: bool  # whether the datasets share the parameters of all effects

    @property
    def name(self) -> str:
        """The effects."""
        return " and ".join(effect.name for effect in self.fit.effects)

    @property
    def pronoun(self) -> str:
        """The effects in a sentence."""
        return "it" if len(self.fit.effects) == 1 else "them"

    @property
    def fall(self) -> float:
        """Drop in cost of all locked pushes, nats."""
        return sum(self.falls)

    @property
    def is_supported(self) -> bool:
        """Whether the locked pushes speak for the effects: in total, and dataset by dataset."""
        return self.fall > CLEARLY and self.agrees

    @property
    def agrees(self) -> bool:
        """Whether the datasets agree: the cost drops in more than half of those that are affected.

        What they do not share may be in a single one: there it must drop clearly, and rise clearly in none.
        """
        falls = list(self.judging.values())
        if not self.shared:
            return max(falls, default=0.0) > CLEARLY and min(falls) >= -CLEARLY
        votes = [turned(fall) for fall in falls]
        return votes.count("better") > votes.count("worse")

    @property
    def judging(self) -> dict[str, float]:
        """Drops in cost of the datasets that have locked pushes, nats, by name."""
        every = zip(self.datasets, self.falls, self.after, strict=True)
        return {name: fall for name, fall, now in every if now is not None}

    @property
    def worse(self) -> list[str]:
        """Datasets whose locked pushes are predicted worse: where they do not share the effects, clearly."""
        least = UNAFFECTED if self.shared else CLEARLY
        return [name for name, fall in self.judging.items() if fall < -least]

    @property
    def misfits(self) -> FloatArray:
        """(L,) misfits of the locked pushes of all datasets."""
        return np.concatenate([np.zeros(0), *(errors.misfit for errors in self.after if errors is not None)])

    def is_better_than(self, other: JudgedFit, least: float) -> bool:
        """Whether the locked pushes are predicted better than with another model: the cost at least so many
        nats lower in total, in datasets that agree, and the misfits lower on average."""
        drops = [own - others for own, others in zip(self.falls, other.falls, strict=True)]
        more = replace(self, falls=drops)
        return more.fall > least and more.agrees and Paired.of(other.misfits, self.misfits).ratio < 1.0
