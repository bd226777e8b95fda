"""From pushes to a belief: several starts, Gauss-Newton on whole trajectories, randomised refits.

A fit to one set of pushes is one answer; the belief holds many. Each hypothesis is fitted anew to pushes
weighted at random (the Bayesian bootstrap of Rubin, 1981: independent exponentials)
and pulled towards maps drawn from the prior. Refits to the weights show what the pushes disagree about, be
it noise or what no such model knows; refits towards random maps show what the pushes leave open. Neither
needs the errors to be independent or the model to be right, which for recorded pushes they are not. And the
hypotheses take turns in how far off they hold the model to be, up to what the pushes speak for (`trust`):
who believes every millimetre takes the model's faults for the object's, who believes few learns little, and
their mixture predicts better than either.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from models.inference.belief import Belief
from models.inference.gauss_newton import Fits, fit
from models.inference.identifiability import quantities
from models.inference.likelihood import Likelihood, LikelihoodSettings
from models.inference.observations import MEASURED_CONTACT, observe_all
from models.inference.prediction import predict_observations
from models.inference.prior import MapPrior, PriorSettings
from models.inference.results import Identification
from models.inference.trust import fit_with_trust
from models.measurements import DatasetError, PushDataset
from models.physics.cell_grid import FloatArray
from models.physics.rollout import Slider

METHODS = ("gauss-newton", "paper")

FINGER_STARTS = (0.12, 0.35, 1.0)
"""Finger frictions to start from: contact that sticks and contact that slides are different valleys."""

STRENGTHS = (0.8, 3.5)
"""Range of the factor on the prior's map variation, drawn log-uniformly for each hypothesis."""

Progress = Callable[[str, int, int], None]


def identify(
    dataset: PushDataset,
    *,
    method: str = "gauss-newton",
    hypotheses: int = 20,
    seed: int = 0,
    progress: Progress | None = None,
    prior_settings: PriorSettings | None = None,
) -> Identification:
    """Learn the maps of mass and friction from a dataset's `fit` pushes; judge them on all pushes.

    Args:
        dataset: measured pushes.
        method: `gauss-newton`, or `paper` for Algorithm 1 as printed.
        hypotheses: K, at least 2.
        seed: of every random draw.
        progress: called with (stage, done, total).
        prior_settings: how strongly maps are held together before any push.

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
    fitted = [observation for observation in observations if observation.role == "fit"]
    if method == "paper":
        from models.inference.paper_method import identify_by_algorithm_1

        belief = identify_by_algorithm_1(dataset, hypotheses=hypotheses, seed=seed, progress=progress)
        likelihood, information = Likelihood(prior, fitted, dataset.noise, LikelihoodSettings()), None
    else:
        starts = np.array([prior.start(friction) for friction in FINGER_STARTS])
        ladder = fit_with_trust(
            prior, fitted, dataset.noise, starts, lambda done, total: report("fitting", done, total)
        )
        likelihood, information = ladder[-1]
        belief = _gauss_newton_belief(dataset, ladder, hypotheses, seed, report)
    predictions = predict_observations(belief, observations, progress)
    facts = quantities(belief, likelihood, information)
    return Identification(belief, predictions, facts, time.perf_counter() - started)


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


def _gauss_newton_belief(
    dataset: PushDataset, ladder: list[tuple[Likelihood, Fits]], hypotheses: int, seed: int, report: Progress
) -> Belief:
    """Randomised refits around the best fits, under each likelihood of the ladder in turn."""
    closest, _ = ladder[0]
    prior, B = closest.prior, len(closest.observations)
    rng = np.random.default_rng(seed)
    weights = rng.exponential(size=(hypotheses, B))
    prior_mean = rng.standard_normal((hypotheses, prior.size))
    strength = np.exp(rng.uniform(np.log(STRENGTHS[0]), np.log(STRENGTHS[1]), hypotheses))
    # The first hypothesis is the plain best fit.
    weights[0], prior_mean[0], strength[0] = 1.0, 0.0, 1.0
    z = np.empty((hypotheses, prior.size))
    probability = np.empty(hypotheses)
    for rung, (likelihood, first) in enumerate(ladder[:hypotheses]):
        who = np.arange(rung, hypotheses, len(ladder))
        refits = fit(
            likelihood,
            _rescaled(prior, first.z[0], strength[who]),
            weights=weights[who],
            prior_mean=prior_mean[who],
            strength=strength[who],
            offsets=np.repeat(first.offsets, len(who), axis=0),
            iterations=15,
            tolerance=3e-3,
            progress=_part(report, rung, len(ladder)),
        )
        z[who] = refits.z
        probability[who] = accuracy_weights(refits.push_cost.sum(axis=1)) * len(who) / hypotheses
    return Belief.learnt(
        dataset,
        prior.slider,
        prior.maps(z, strength),
        probability,
        method="gauss-newton",
        seed=seed,
        trials=[observation.trial for observation in closest.observations],
        settings={
            "finger_starts": list(FINGER_STARTS),
            "strengths": list(STRENGTHS),
            "model_errors": [likelihood.settings.model_error for likelihood, _ in ladder],
            "prior": asdict(prior.settings),
            "likelihood": asdict(closest.settings),
        },
    )


def _part(report: Progress, part: int, parts: int) -> Callable[[int, int], None]:
    return lambda done, total: report("hypotheses", part * total + done, parts * total)


def _rescaled(prior: MapPrior, z: FloatArray, strength: FloatArray) -> FloatArray:
    """The same maps in the coordinates of hypotheses with other strengths."""
    start = np.repeat(z[None], len(strength), axis=0)
    start[:, : 2 * prior.basis.shape[1]] /= strength[:, None]
    return start


def accuracy_weights(cost: FloatArray) -> FloatArray:
    """Probabilities of hypotheses from their costs (K,): a soft-max as in the paper's line 30.

    The temperature is twice the median excess over the best, at least 2: hypotheses that the data hold
    about equally likely keep about equal weights, and those that a refit left in a worse valley lose theirs.
    """
    excess = cost - cost.min()
    weight = np.exp(-excess / (2.0 * max(1.0, float(np.median(excess)))))
    return weight / weight.sum()
