"""Datasets of a joint diagnosis with their locked pushes, and models that these have judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slipmap.models.inference.belief import Belief
from slipmap.models.inference.diagnosis.locked import LockedErrors, locked_trials, open_trials
from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.inference.fewer_cells import with_fewer_cells
from slipmap.models.inference.observations import Observation, observe_all, to_learn_from
from slipmap.models.inference.prediction import predicted_motion
from slipmap.models.inference.prior import MapPrior
from slipmap.models.inference.push_errors import errors
from slipmap.models.inference.together import JointFit, Taught
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps
from slipmap.models.progress import StageProgress


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
        return LockedErrors.of(found), self.taught.costs(self.locked, prior, z)


@dataclass(frozen=True, eq=False)
class JudgedFit:
    """A model with effects that the locked pushes have judged."""

    fit: JointFit
    after: list[LockedErrors | None]  # of each dataset
    falls: list[float]  # drop in cost of each dataset's locked pushes, nats
    held: list[Maps]  # best maps of each dataset with the effects held, one hypothesis
    score: float  # evidence from the open pushes plus drop in cost of the locked ones, nats

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
    def falls_in_most(self) -> bool:
        """Whether the cost drops in more than half of the datasets that have locked pushes."""
        judging = [fall for fall, now in zip(self.falls, self.after, strict=True) if now is not None]
        return sum(fall > 0.0 for fall in judging) > len(judging) / 2
