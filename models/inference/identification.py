"""From pushes to a belief: several starts, Gauss-Newton on whole trajectories, randomised refits."""

from __future__ import annotations

import time
from functools import partial

from slipmap.models.inference.friction_laws import Law, fit_laws, mixed_belief
from slipmap.models.inference.hypotheses import MODEL_ERRORS
from slipmap.models.inference.identifiability import quantities
from slipmap.models.inference.likelihood import Likelihood, LikelihoodSettings
from slipmap.models.inference.observations import observe_all
from slipmap.models.inference.prediction import predict_observations
from slipmap.models.inference.prior import SINGLE_CELLS, MapPrior, PriorSettings, slider_for
from slipmap.models.inference.results import Identification
from slipmap.models.measurements import DatasetError, PushDataset
from slipmap.models.progress import Progress, silent

METHODS = ("gauss-newton", "paper")

FINGER_STARTS = (0.12, 0.35, 1.0)
"""Finger frictions to start from: contact that sticks and contact that slides are different valleys."""


def identify(
    dataset: PushDataset,
    *,
    method: str = "gauss-newton",
    hypotheses: int = 20,
    seed: int = 0,
    progress: Progress | None = None,
    prior_settings: PriorSettings | None = None,
    friction_laws: bool = True,
) -> Identification:
    """Learn the maps of mass and friction from a dataset's `fit` pushes; judge them on all pushes.

    Args:
        dataset: measured pushes.
        method: `gauss-newton`, or `paper` for Algorithm 1 as printed.
        hypotheses: K, at least 2.
        seed: of every random draw.
        progress: called with (stage, done, total).
        prior_settings: how strongly maps are held together before any push; if None, as in `PriorSettings`,
            or as in `SINGLE_CELLS` where the best law is off by more than the smallest of `MODEL_ERRORS`.
        friction_laws: whether other laws of friction than the plain one take part, each as much as the
            pushes speak for it (see `friction_laws`); takes about four times as long. The method `paper`
            knows the plain one alone.

    Raises:
        DatasetError: there is no push to fit.
        ValueError: an unknown method or too few hypotheses.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=2, heldout=1)
        >>> result = slipmap.identify(dataset, hypotheses=4, friction_laws=False)
        >>> len(result.belief), result.errors("heldout").shape
        (4, (1,))
    """
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}; choose one of {', '.join(METHODS)}")
    check_request(dataset, hypotheses)
    started = time.perf_counter()
    report = progress or silent
    report("preparing pushes", 0, 1)
    observations = observe_all(dataset)
    report("preparing pushes", 1, 1)
    fitted = [observation for observation in observations if observation.role == "fit"]

    def laws_with(settings: PriorSettings) -> list[Law]:
        own = partial(report, "fitting")
        return fit_laws(dataset, fitted, settings, FINGER_STARTS, own, plain_only=not friction_laws)

    if method == "paper":
        from slipmap.models.inference.paper_method import identify_by_algorithm_1

        belief = identify_by_algorithm_1(dataset, hypotheses=hypotheses, seed=seed, progress=progress)
        prior = MapPrior(slider_for(dataset), prior_settings or PriorSettings(), dataset.mass)
        likelihood, information = Likelihood(prior, fitted, dataset.noise, LikelihoodSettings()), None
    else:
        laws = laws_with(prior_settings or SINGLE_CELLS)
        if prior_settings is None and laws[0].model_error == MODEL_ERRORS[0]:
            laws = laws_with(PriorSettings())
        likelihood, information = laws[0].ladder[-1]
        record = {"finger_starts": list(FINGER_STARTS)}
        belief = mixed_belief(dataset, laws, hypotheses, seed, report, settings=record)
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
