"""Fitted models as beliefs of one hypothesis, so that whatever compares and predicts can use them."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np

from models.inference.belief import Belief
from models.inference.diagnosis.fitting import Fitted
from models.inference.diagnosis.results import Diagnosis
from models.measurements import PushDataset


def fitted_belief(fitted: Fitted, dataset: PushDataset, seed: int) -> Belief:
    """One fitted model of a diagnosis as a belief that is certain of it.

    Args:
        fitted: the model.
        dataset: whose pushes it was fitted to.
        seed: of the diagnosis.
    """
    prior = fitted.likelihood.prior
    return Belief(
        grid=dataset.grid,
        finger_radius=dataset.finger_radius,
        gravity=dataset.gravity,
        maps=prior.maps(fitted.z[None]),
        probability=np.ones(1),
        smoothing=prior.slider.smoothing,
        dataset=dataset.name,
        fingerprint=dataset.fingerprint,
        method="gauss-newton",
        seed=seed,
        settings={
            "hypotheses": 1,
            "fit_trials": [o.trial for o in fitted.likelihood.observations],
            "prior": asdict(prior.settings),
            "motion_error": fitted.likelihood.error.motion,
            "force_error": fitted.likelihood.error.force,
            "known_mass": dataset.mass,
        },
        effects=fitted.effects,
    )


def as_diagnosed(dataset: PushDataset, diagnosis: Diagnosis) -> PushDataset:
    """The dataset with the roles of the diagnosis: pushes that were locked away are held out."""
    locked = set(diagnosis.locked)
    trials = tuple(
        replace(trial, role="heldout" if trial.name in locked else "fit") for trial in dataset.trials
    )
    return replace(dataset, trials=trials)
