"""Fitted models as beliefs, so that whatever compares and predicts can use them."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np

from models.inference.belief import Belief
from models.inference.diagnosis.fitting import Fitted
from models.inference.diagnosis.results import Diagnosis
from models.measurements import PushDataset


def fitted_belief(fitted: Fitted, dataset: PushDataset, seed: int) -> Belief:
    """A fitted model as a belief that is certain of it.

    Args:
        fitted: the model.
        dataset: whose pushes it was fitted to.
        seed: of what fitted it.
    """
    likelihood = fitted.likelihood
    prior = likelihood.prior
    return Belief.learnt(
        dataset,
        prior.slider,
        prior.maps(fitted.z[None]),
        np.ones(1),
        method="gauss-newton",
        seed=seed,
        trials=[observation.trial for observation in likelihood.observations],
        settings={
            "prior": asdict(prior.settings),
            "motion_error": likelihood.error.motion,
            "force_error": likelihood.error.force,
        },
    )


def as_diagnosed(dataset: PushDataset, diagnosis: Diagnosis) -> PushDataset:
    """The dataset with the roles of the diagnosis: pushes that were locked away are held out."""
    locked = set(diagnosis.locked)
    trials = tuple(
        replace(trial, role="heldout" if trial.name in locked else "fit") for trial in dataset.trials
    )
    return replace(dataset, trials=trials)
