"""A belief with effects: maps and the effects' parameters, learnt together from the pushes to fit.

The strict likelihood of the diagnosis finds the effects. It believes every row of every force, and holds a
total mass for sure that a force model 2 % off moves by a third; what is in proportion to mass, as a tilt is,
goes with it. So the sizes of effects, and the hypotheses of a belief, come from refits under the forgiving
likelihood of the identification, from where the strict one led.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial

import numpy as np

from slipmap.models.effects.effect import Effect
from slipmap.models.effects.library import LIBRARY
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.comparison import Comparison, compare
from slipmap.models.inference.diagnosis.error_model import sensor_noise
from slipmap.models.inference.diagnosis.fitting import Fitted, Fitter, estimate_errors
from slipmap.models.inference.diagnosis.results import (
    Diagnosis,
    ParameterEstimate,
    estimates_of,
    parameter_estimates,
)
from slipmap.models.inference.diagnosis.screening import screen
from slipmap.models.inference.gauss_newton import Fits
from slipmap.models.inference.hypotheses import Ladder, fit_with_trust, refitted_belief
from slipmap.models.inference.identifiability import SHOWN_SHARE, quantities
from slipmap.models.inference.identification import check_request
from slipmap.models.inference.observations import observe_all
from slipmap.models.inference.prediction import predict_observations
from slipmap.models.inference.results import Identification, Quantity
from slipmap.models.inference.summaries import interval
from slipmap.models.measurements import DatasetError, Noise, PushDataset
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import RolloutError
from slipmap.models.progress import Progress, about, part_of, silent


def _forgiving_prior_mean(fitted: Fitted) -> FloatArray:
    """(d,) where the prior of forgiving refits is centred: as the fit's, but effects at what was found.

    They were found, so nothing pulls them to their nulls any more where the forgiving likelihood sees little
    of them.
    """
    plain = fitted.likelihood.prior.plain
    return np.concatenate([fitted.prior_mean[:plain], fitted.z[plain:]])


def _forgiving_fits(fitted: Fitted, noise: Noise) -> Ladder:
    likelihood, mean = fitted.likelihood, _forgiving_prior_mean(fitted)
    return fit_with_trust(
        likelihood.prior, likelihood.observations, noise, fitted.z[None], partial(silent, ""), mean
    )


def effect_sizes(fitted: Fitted, noise: Noise) -> tuple[ParameterEstimate, ...]:
    """Parameters of a model's effects with their 90 % intervals, cut at the allowed range.

    Where the forgiving fit leads to a model that cannot be rolled out, they are the strict fit's.
    """
    prior = fitted.likelihood.prior
    try:
        _, found = _forgiving_fits(fitted, noise)[-1]
    except (RolloutError, np.linalg.LinAlgError):
        return parameter_estimates(fitted)
    deviations = prior.effect_deviations(found.hessian[0])
    return estimates_of(fitted.effects, prior.maps(found.z).effects[0], deviations)


def fit(
    dataset: PushDataset,
    effects: Sequence[Effect | str],
    *,
    hypotheses: int = 20,
    seed: int = 0,
    progress: Progress | None = None,
) -> Identification:
    """Learn maps together with some effects, and without them, from the same pushes: `slipmap fit`.

    Args:
        dataset: measured pushes.
        effects: to add to the model; those of the library may be given by name.
        hypotheses, seed, progress: as in `fit_effects`.

    Returns:
        What was learnt with the effects; its `without_effects` holds the other model.

    Raises:
        DatasetError, ValueError, EffectError: as `fit_effects`; an EffectError also for an unknown name.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=2, heldout=1)
        >>> result = slipmap.fit(dataset, ["table_tilt"], hypotheses=2)
        >>> sorted(result.effect_estimates["table_tilt"])
        ['down_x', 'down_y']
    """
    result = fit_effects(dataset, _named(effects), hypotheses=hypotheses, seed=seed, progress=progress)
    plain = fit_effects(
        dataset, (), hypotheses=hypotheses, seed=seed, progress=about("without effects", progress or silent)
    )
    return replace(result, without_effects=plain)


def compare_with_effects(
    dataset: PushDataset, effects: Sequence[Effect | str], *, seed: int = 0, progress: Progress | None = None
) -> tuple[Comparison, Comparison]:
    """The models without and with some effects, learnt from the same pushes, each held against all pushes.

    Args:
        dataset: measured pushes.
        effects: to add to the model; those of the library may be given by name.
        seed: of every random draw.
        progress: called with (stage, done, total).

    Raises:
        DatasetError, EffectError: as `fit`.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=2, heldout=1)
        >>> [comparison.label for comparison in slipmap.compare_with_effects(dataset, ["table_tilt"])]
        ['without effects', 'with table_tilt']
    """
    added = _named(effects)
    models = {"without effects": (), "with " + " and ".join(effect.name for effect in added): added}
    beliefs = {
        label: fit_effects(dataset, given, seed=seed, progress=about(label, progress or silent)).belief
        for label, given in models.items()
    }
    before, after = (
        compare(dataset, belief, seed=seed, label=label, progress=progress)
        for label, belief in beliefs.items()
    )
    return before, after


def _named(effects: Sequence[Effect | str]) -> tuple[Effect, ...]:
    own = [effect for effect in effects if not isinstance(effect, str)]
    names = [effect if isinstance(effect, str) else effect.name for effect in effects]
    return effects_named(names, (*LIBRARY, *own))


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
    report = progress or silent
    rng = np.random.default_rng(seed)
    report("preparing pushes", 0, 1)
    every = observe_all(dataset)
    observations = [o for o in every if o.role == "fit"]
    report("fitting", 0, 3)
    noise = sensor_noise(dataset)
    fitter = Fitter(dataset, observations, noise)
    fitted = fitter.from_scratch(part_of(partial(report, "fitting"), 0, 3))
    report("fitting", 1, 3)
    if effects:
        fitted = _added(fitter, fitted, effects, rng)
    report("fitting", 2, 3)
    error = estimate_errors(fitted, noise)
    if effects:
        fitted = fitter.with_effects(effects, error, fitted, fitted.values) or fitted
    else:
        fitted = fitter.base(error, fitted)
    report("fitting", 3, 3)
    ladder = _forgiving_fits(fitted, dataset.noise)
    likelihood, information = ladder[-1]
    errors = {"motion_error": error.motion, "force_error": error.force}
    belief = refitted_belief(
        dataset, ladder, hypotheses, seed, report, mean=_forgiving_prior_mean(fitted), settings=errors
    )
    predictions = predict_observations(belief, every, progress)
    facts = (*quantities(belief, likelihood, information), *_effect_facts(belief, effects, information))
    return Identification(belief, predictions, facts, time.perf_counter() - started)


def _added(fitter: Fitter, base: Fitted, effects: Sequence[Effect], rng: np.random.Generator) -> Fitted:
    """Fit with the effects, each started where it gains most to first order."""
    scene = fitter.scene(base)
    names = [effect.name for effect in effects]
    known = (*effects, *(effect for effect in LIBRARY if effect.name not in names))
    starts = screen(fitter, base, known, len(known), scene, 1, rng).start
    guesses = [effect.start_values(scene)[int(start)] for effect, start in zip(effects, starts, strict=False)]
    fitted = fitter.with_effects(effects, base.likelihood.error, base, np.concatenate(guesses), afresh=True)
    if fitted is None:
        raise DatasetError(
            f"the model with {', '.join(names)} cannot be fitted to dataset"
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
        reason = "the pushes pin it down, if it is there"
        if not shown:
            reason = "left open by these pushes; the prior decides"
        low, high = max(low, parameter.low), min(high, parameter.high)
        name = f"{effect}: {parameter.name}"
        facts.append(Quantity(name, parameter.unit, middle, low, high, shown, reason))
    return facts


def fitted_belief(fitted: Fitted, dataset: PushDataset, seed: int) -> Belief:
    """A fitted model as a belief that is certain of it, so that whatever compares and predicts can use it.

    The dataset is the one whose pushes it was fitted to, the seed that of what fitted it.
    """
    likelihood = fitted.likelihood
    prior, error = likelihood.prior, likelihood.error
    return Belief.learnt(
        dataset,
        prior.slider,
        prior.maps(fitted.z[None]),
        np.ones(1),
        method="gauss-newton",
        seed=seed,
        trials=[observation.trial for observation in likelihood.observations],
        settings={"prior": asdict(prior.settings), "motion_error": error.motion, "force_error": error.force},
    )


def as_diagnosed(dataset: PushDataset, diagnosis: Diagnosis) -> PushDataset:
    """The dataset with the roles of the diagnosis: pushes that were locked away are held out."""
    locked = set(diagnosis.locked)
    trials = tuple(
        replace(trial, role="heldout" if trial.name in locked else "fit") for trial in dataset.trials
    )
    return replace(dataset, trials=trials)
