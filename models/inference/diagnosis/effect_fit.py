"""A belief with effects: maps and the effects' parameters, learnt together from the pushes with the role
`fit`.

The strict likelihood of the diagnosis finds the effects. The hypotheses are those of an identification,
refits under the forgiving likelihood with the effects in the model (`effect_size` tells why).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from models.effects.effect import Effect, Scene
from models.effects.library import LIBRARY
from models.inference.belief import Belief
from models.inference.diagnosis.effect_size import forgiving_fits, forgiving_prior_mean
from models.inference.diagnosis.error_model import sensor_noise
from models.inference.diagnosis.fitting import Fitted, Fitter, estimate_errors
from models.inference.diagnosis.screening import screen
from models.inference.gauss_newton import Fits
from models.inference.hypotheses import refitted_belief
from models.inference.identifiability import SHOWN_SHARE, quantities
from models.inference.identification import check_request
from models.inference.intervals import interval
from models.inference.observations import observe_all
from models.inference.prediction import predict_observations
from models.inference.results import Identification, Quantity
from models.measurements import DatasetError, PushDataset

Progress = Callable[[str, int, int], None]


def fit_effects(
    dataset: PushDataset,
    effects: Sequence[Effect],
    *,
    hypotheses: int = 20,
    seed: int = 0,
    progress: Progress | None = None,
) -> Identification:
    """Learn maps and the parameters of some effects; judge them on all pushes.

    Args:
        dataset: measured pushes.
        effects: that the model is given; none fits the plain model.
        hypotheses: K, at least 2.
        seed: of every random draw.
        progress: called with (stage, done, total).

    Raises:
        DatasetError: there is no push to fit.
        ValueError: too few hypotheses.
        EffectError: a formula cannot be used.
    """
    check_request(dataset, hypotheses)
    started = time.perf_counter()
    report = progress or (lambda stage, done, total: None)
    rng = np.random.default_rng(seed)
    report("preparing pushes", 0, 1)
    every = observe_all(dataset)
    observations = [o for o in every if o.role == "fit"]
    report("fitting", 0, 3)
    noise = sensor_noise(dataset)
    fitter = Fitter(dataset, observations, noise)
    fitted = fitter.from_scratch(lambda done, total: report("fitting", done, 3 * total))
    report("fitting", 1, 3)
    scene = fitter.scene(fitted)
    if effects:
        fitted = _added(fitter, fitted, effects, scene, rng)
    report("fitting", 2, 3)
    error = estimate_errors(fitted, noise)
    again = (
        fitter.with_effects(effects, error, fitted, fitted.values) if effects else fitter.base(error, fitted)
    )
    fitted = again or fitted
    report("fitting", 3, 3)
    ladder = forgiving_fits(fitted, dataset.noise)
    likelihood, information = ladder[-1]
    belief = refitted_belief(
        dataset,
        ladder,
        hypotheses,
        seed,
        report,
        mean=forgiving_prior_mean(fitted),
        settings={"motion_error": error.motion, "force_error": error.force},
    )
    predictions = predict_observations(belief, every, progress)
    facts = (*quantities(belief, likelihood, information), *_effect_facts(belief, effects, information))
    return Identification(belief, predictions, facts, time.perf_counter() - started)


def _added(
    fitter: Fitter, base: Fitted, effects: Sequence[Effect], scene: Scene, rng: np.random.Generator
) -> Fitted:
    """Fit with the effects, each started where it gains most to first order."""
    guesses = []
    known = (*effects, *(effect for effect in LIBRARY if effect.name not in {e.name for e in effects}))
    screening = screen(fitter, base, known, len(known), scene, 1, rng)
    for effect in effects:
        place = screening.candidates.index(effect)
        guesses.append(effect.start_values(scene)[int(screening.start[place])])
    fitted = fitter.with_effects(effects, base.likelihood.error, base, np.concatenate(guesses), afresh=True)
    if fitted is None:
        raise DatasetError(
            f"the model with {', '.join(e.name for e in effects)} cannot be fitted to dataset"
            f" {fitter.dataset.name}: its rollouts do not converge"
        )
    return fitted


def _effect_facts(belief: Belief, effects: Sequence[Effect], information: Fits) -> list[Quantity]:
    """Parameters of the effects as facts beside the others, intervals from the hypotheses."""
    named = [(effect.name, parameter) for effect in effects for parameter in effect.parameters]
    size = len(information.hessian[0])
    left = np.diagonal(np.linalg.inv(information.hessian[0] + np.eye(size)))[size - len(named) :]
    facts = []
    for (effect, parameter), values, share in zip(named, belief.maps.effects.T, left, strict=True):
        shown = bool(share < SHOWN_SHARE)
        middle, low, high = interval(values, belief.probability)
        facts.append(
            Quantity(
                f"{effect}: {parameter.name}",
                parameter.unit,
                middle,
                max(low, parameter.low),
                min(high, parameter.high),
                shown,
                "the pushes pin it down, if it is there"
                if shown
                else "left open by these pushes; the prior decides",
            )
        )
    return facts
