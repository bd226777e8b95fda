"""A belief with effects: maps and the effects' parameters, learnt together from the pushes with the role
`fit`.

The error model is estimated as in a diagnosis. The hypotheses are refits to pushes weighted at random and
towards maps drawn from the prior, as in `models.inference.identification`, but under the strict likelihood.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from models.effects.effect import Effect, Scene
from models.effects.library import LIBRARY
from models.inference.belief import Belief
from models.inference.diagnosis.error_model import sensor_noise
from models.inference.diagnosis.fitted_belief import belief_around
from models.inference.diagnosis.fitting import Fitted, Fitter, estimate_errors
from models.inference.diagnosis.results import parameter_estimates
from models.inference.diagnosis.screening import screen
from models.inference.gauss_newton import fit
from models.inference.identifiability import quantities
from models.inference.identification import accuracy_weights, check_request
from models.inference.likelihood import Likelihood, LikelihoodSettings
from models.inference.observations import observe_all
from models.inference.prediction import predict_observations
from models.inference.results import Identification, Quantity
from models.measurements import DatasetError, PushDataset

Progress = Callable[[str, int, int], None]

PULL = 0.7
"""Standard deviation of the random prior means that refits are drawn towards: with weights drawn as well, the
intervals come out calibrated with less than one."""


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
    fitted = fitter.from_scratch()
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
    K, B, d = hypotheses, len(observations), fitted.likelihood.prior.size
    weights = rng.exponential(size=(K, B))
    means = fitted.prior_mean + PULL * rng.standard_normal((K, d))
    weights[0], means[0] = 1.0, fitted.prior_mean
    refits = fit(
        fitted.likelihood,
        np.repeat(fitted.z[None], K, axis=0),
        weights=weights,
        prior_mean=means,
        offsets=np.repeat(fitted.offsets[None], K, axis=0),
        iterations=12,
        tolerance=3e-3,
        progress=lambda done, total: report("hypotheses", done, total),
    )
    probability = accuracy_weights(refits.push_cost.sum(axis=1))
    belief = belief_around(fitted, refits.z, probability, dataset, seed)
    predictions = predict_observations(belief, every, progress)
    plain = Likelihood(fitter.prior(()), observations, dataset.noise, LikelihoodSettings())
    facts = (*quantities(belief, plain, None), *_effect_facts(belief, fitted))
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


def _effect_facts(belief: Belief, fitted: Fitted) -> list[Quantity]:
    """Parameters of the effects as facts beside the others, intervals from the hypotheses."""
    facts = []
    for column, estimate in enumerate(parameter_estimates(fitted)):
        values = belief.maps.effects[:, column]
        low, high = np.quantile(values, [0.05, 0.95])
        sure = (estimate.high - estimate.low) < 3.29 * fitted.likelihood.prior.effect_scales[column]
        facts.append(
            Quantity(
                f"{estimate.effect}: {estimate.name}",
                estimate.unit,
                float(np.median(values)),
                float(min(low, estimate.low)),
                float(max(high, estimate.high)),
                bool(sure),
                "the pushes pin it down" if sure else "left open by these pushes; the prior decides",
            )
        )
    return facts
