"""From pushes to a belief: several starts, Gauss-Newton on whole trajectories, randomised refits."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from models.inference.friction_laws import Law, fit_laws
from models.inference.identifiability import quantities
from models.inference.likelihood import Likelihood, LikelihoodSettings
from models.inference.mixed_belief import mixed_belief
from models.inference.observations import MEASURED_CONTACT, observe_all
from models.inference.prediction import predict_observations
from models.inference.prior import MapPrior, PriorSettings
from models.inference.results import Identification
from models.measurements import DatasetError, PushDataset
from models.physics.rollout import Slider

METHODS = ("gauss-newton", "paper")

FINGER_STARTS = (0.12, 0.35, 1.0)
"""Finger frictions to start from: contact that sticks and contact that slides are different valleys."""

Progress = Callable[[str, int, int], None]


def identify(
    dataset: PushDataset,
    *,
    method: str = "gauss-newton",
    hypotheses: int = 20,
    seed: int = 0,
    progress: Progress | None = None,
    prior_settings: PriorSettings | None = None,
    friction_laws: bool = False,
) -> Identification:
    """Learn the maps of mass and friction from a dataset's `fit` pushes; judge them on all pushes.

    Args:
        dataset: measured pushes.
        method: `gauss-newton`, or `paper` for Algorithm 1 as printed.
        hypotheses: K, at least 2.
        seed: of every random draw.
        progress: called with (stage, done, total).
        prior_settings: how strongly maps are held together before any push.
        friction_laws: whether other laws of friction than the plain one take part, each as much as the
            pushes speak for it (`models.inference.friction_laws`); takes about four times as long. The
            method `paper` knows the plain one alone.

    Raises:
        DatasetError: there is no push to fit.
        ValueError: an unknown method or too few hypotheses.
    """
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}; choose one of {', '.join(METHODS)}")
    check_request(dataset, hypotheses)
    started = time.perf_counter()
    report = progress or (lambda stage, done, total: None)
    report("preparing pushes", 0, 1)
    observations = observe_all(dataset)
    report("preparing pushes", 1, 1)
    slider = Slider(dataset.grid, dataset.finger_radius, dataset.gravity, MEASURED_CONTACT)
    prior = MapPrior(slider, prior_settings or PriorSettings(), dataset.mass)
    laws: list[Law] = []
    fitted = [observation for observation in observations if observation.role == "fit"]
    if method == "paper":
        from models.inference.paper_method import identify_by_algorithm_1

        belief = identify_by_algorithm_1(dataset, hypotheses=hypotheses, seed=seed, progress=progress)
        likelihood, information = Likelihood(prior, fitted, dataset.noise, LikelihoodSettings()), None
    else:
        starts = np.array([prior.start(friction) for friction in FINGER_STARTS])
        laws = fit_laws(
            dataset,
            fitted,
            prior.settings,
            starts,
            lambda done, total: report("fitting", done, total),
            plain_only=not friction_laws,
        )
        likelihood, information = laws[0].ladder[-1]
        belief = mixed_belief(
            dataset, laws, hypotheses, seed, report, settings={"finger_starts": list(FINGER_STARTS)}
        )
    predictions = predict_observations(belief, observations, progress)
    facts = quantities(belief, likelihood, information)
    shares = belief.settings.get("friction_laws", {})
    return Identification(belief, predictions, facts, time.perf_counter() - started, shares)


def check_request(dataset: PushDataset, hypotheses: int) -> None:
    """Refuse what no belief of several hypotheses can be learnt from.

    Raises:
        DatasetError: there is no push to fit.
        ValueError: too few hypotheses.
    """
    if hypotheses < 2:
        raise ValueError(f"hypotheses must be at least 2, got {hypotheses}")
    if not dataset.fit_trials:
        raise DatasetError(
            f"dataset {dataset.name} has no push with the role fit; give at least one that role"
        )
