"""The hypotheses of a belief: randomised refits around the best fits.

A fit to one set of pushes is one answer; the belief holds many. Each hypothesis is fitted to randomly
weighted pushes (the Bayesian bootstrap of Rubin, 1981, but with gamma distributed weights that vary a little
more than his exponentials, with which the variance of a mean of B pushes would be (B - 1) / (B + 1) of what
it should be, two thirds for five pushes) and pulled towards maps drawn from the prior. The random weights
show what the pushes disagree about, be it noise or model error; the random maps show what the pushes leave
open. Neither requires independent errors or a correct model, which recorded pushes do not have.

Where pushes agree better than the likelihood's standard deviations say, this is not enough: the prior pulls a
fit as far as errors of that size would allow, and the hypotheses scatter less. So each also assumes errors of
the measurements (randomised maximum likelihood: Ba, de Wiljes, Oliver and Reich, arXiv:2101.03612), as large
as the likelihood allows beyond what the residuals show; the weights vary less accordingly. Under the smallest
α only, because larger ones are there for a model that is wrong, and then pushes disagree. The start's own
error is not drawn.

The likelihood assumes a model error of a share α of the distance travelled. On an object that matches the
model, α is half a percent; in another simulator, or on a worn table, it is ten times that, and a fit that
still trusts the pushes mistakes the model's errors for the object's maps. α follows from the evidence, by
Laplace's approximation around the best fit,

    log p(data | α) ≈ -cost(α) - ½ log det(1 + H) - Σ_b ½ log det(1 + σ H_b σ) - Σ log σ_row(α),

where H is the curvature of the data's cost over the maps, H_b over the start of a push, and p(α) ∝ 1/α per
logarithm of α, so that a larger α needs evidence. The hypotheses take turns among all α up to the one of
largest evidence: a small α mistakes model errors for the object, a large one learns little, and their mixture
predicts better than either.

Where the model is right, half a percent allows too much: predictions are farther off and less sure than the
pushes make them. So pushes that it explains exactly are fitted once more with `FINE_ERROR`, and where the
evidence is larger, all hypotheses come from that fit. What counts as shown is judged with half a percent all
the same, lest errors of a tenth of a millimetre in a model that is nearly right pass for knowledge.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from slipmap.models.inference.gauss_newton import Fits, fit
from slipmap.models.inference.likelihood import DrawnErrors, Likelihood, LikelihoodSettings
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.prior import MapPrior
from slipmap.models.measurements import Noise
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps, RolloutError
from slipmap.models.progress import StageProgress, part_of, shares_of, side_by_side

Ladder = list[tuple[Likelihood, Fits]]
"""Fits under likelihoods that trust the data less and less."""

MODEL_ERRORS = (0.005, 0.015, 0.04, 0.1)
"""Values of α to choose from, ascending."""

FINE_ERROR = 0.00125
"""α tried where the smallest of these explains the pushes exactly."""


def fit_with_trust(
    prior: MapPrior,
    observations: Sequence[Observation],
    noise: Noise,
    starts: FloatArray,
    progress: StageProgress,
    *,
    only_exact: bool = False,
    near: Ladder | None = None,
) -> Ladder:
    """The best fit for every α up to the one of largest evidence.

    α is raised from the smallest as long as the evidence grows; each fit starts where the last one ended.

    Args:
        prior: coordinates of the maps.
        noise: of the sensors, where declared.
        starts: (K, d) coordinates to start from.
        progress: called with (done, total); the search often stops before the last α.
        only_exact: stop after the smallest α if that does not explain the pushes exactly.
        near: fits of the same model to some of the pushes or with longer steps, from which each α starts
            instead.

    Returns:
        For each α, ascending: the likelihood with that α in its settings, and the fit, one hypothesis.
    """
    found: Ladder = []
    highest, offsets = -np.inf, None
    # With the same pushes, longer steps hardly change which α is best.
    same = near is not None and len(near[0][0].observations) == len(observations)
    for rung, alpha in enumerate(MODEL_ERRORS[: len(near) if near and same else None]):
        likelihood = Likelihood(prior, observations, noise, trusting(alpha))
        own = part_of(progress, rung, len(MODEL_ERRORS))
        if near is not None and rung < len(near):
            starts = near[rung][1].z
            offsets = near[rung][1].offsets if same else offsets
        best = fit(likelihood, starts, offsets=offsets, worth=np.inf, progress=own).best()
        evidence = log_evidence(likelihood, best) - float(np.log(alpha))
        if evidence < highest:
            break
        found.append((likelihood, best))
        if only_exact and not explains_exactly(likelihood, best):
            break
        highest, starts, offsets = evidence, best.z, best.offsets
    return found


def refined(ladder: Ladder, noise: Noise) -> Ladder:
    """The fit with `FINE_ERROR` where it has more evidence than the ladder's only one, that with the smallest
    α; otherwise nothing."""
    ((likelihood, best),) = ladder
    fine = Likelihood(likelihood.prior, likelihood.observations, noise, trusting(FINE_ERROR))
    try:
        found = fit(fine, best.z, offsets=best.offsets, worth=np.inf).best()
    except (RolloutError, np.linalg.LinAlgError):
        return []
    return [(fine, found)] if log_evidence(fine, found) > log_evidence(likelihood, best) else []


def explains_exactly(likelihood: Likelihood, found: Fits) -> bool:
    """Whether residuals are, on average, no larger than the likelihood's standard deviations."""
    return _mean_square(likelihood, found) <= 1.0


def _mean_square(likelihood: Likelihood, found: Fits) -> float:
    """About the mean square of the residuals of a fit, in standard deviations of the likelihood."""
    # A pose has three residuals; each costs a half if it is as large as its standard deviation.
    return float(found.push_cost.sum()) / (1.5 * likelihood.rows_counted)


def trusting(alpha: float) -> LikelihoodSettings:
    """Likelihood settings for a model error of a share α of the distance travelled.

    The force error is taken as ten times that share, at most 40 %; the error of short pushes as that of one
    of 10 cm, at most half a millimetre.
    """
    base = min(0.1 * alpha, LikelihoodSettings.base_error)
    force = min(10.0 * alpha, 0.4)
    return replace(LikelihoodSettings(), model_error=alpha, base_error=base, force_error=force)


def log_evidence(likelihood: Likelihood, found: Fits) -> float:
    """log p(data) up to a constant independent of the likelihood's settings; see the top of the file."""
    maps = np.linalg.slogdet(found.hessian[0] + np.eye(found.z.shape[1]))[1]
    # The gain is the inverse of 1 / σ² + H_b.
    sigma = np.broadcast_to(likelihood.start_sigma, (len(likelihood.observations), 3))
    scale = sigma[:, :, None] * sigma[:, None]
    starts = np.linalg.slogdet(found.start_gain[0] / scale)[1].sum()
    return float(-found.cost[0] - 0.5 * maps + 0.5 * starts - likelihood.log_widths())


_STRENGTHS = (0.7, 1.4)
"""Range of the factor on the prior's map variation, drawn log-uniformly for each hypothesis (see
`MapPrior.spreads`)."""


def trusted(ladder: Ladder) -> dict[str, Any]:
    """Settings of the fits, for the record."""
    closest, _ = ladder[0]
    return {
        "strengths": list(_STRENGTHS),
        "model_errors": [likelihood.settings.model_error for likelihood, _ in ladder],
        "prior": asdict(closest.prior.settings),
        "likelihood": asdict(closest.settings),
    }


def unexplained_share(settings: Mapping[str, Any]) -> float | None:
    """Share of the distance moved by which the best maps miss the pushes, if it is the largest of
    `MODEL_ERRORS` and may be larger; else None.

    Args:
        settings: of a belief, with those that `trusted` records where it was learned by these fits.
    """
    missed = max(settings.get("model_errors", [0.0]))
    return missed if missed >= MODEL_ERRORS[-1] else None


class Draws(NamedTuple):
    """What refits of K hypotheses are drawn around."""

    weights: FloatArray  # (K, B) of the pushes
    prior_mean: FloatArray  # (K, d)
    strength: FloatArray  # (K,) see `MapPrior.spreads`
    errors: DrawnErrors  # of the measurements


def draws(ladder: Ladder, hypotheses: int, rng: np.random.Generator, *, keep_best: bool) -> Draws:
    """Draws for K hypotheses around the fits of a ladder.

    Args:
        ladder: of `fit_with_trust`.
        hypotheses: K.
        keep_best: whether the first hypothesis is the plain best fit.
    """
    likelihood, _ = ladder[0]
    B = len(likelihood.observations)
    shape = _shape(B)
    weights = rng.gamma(shape, 1.0 / shape, (hypotheses, B))
    prior_mean = rng.standard_normal((hypotheses, likelihood.prior.size))
    strength = np.exp(rng.uniform(np.log(_STRENGTHS[0]), np.log(_STRENGTHS[1]), hypotheses))
    stretches, (of_errors,) = int(likelihood.settings.independent), rng.spawn(1)
    errors = DrawnErrors(
        _balanced((hypotheses, B, stretches, 3), len(ladder), of_errors),
        _balanced((hypotheses, B, 2), len(ladder), of_errors),
    )
    if keep_best:  # whose own errors are missing from the mean of zero then
        weights[0], prior_mean[0], strength[0] = 1.0, 0.0, 1.0
        errors.poses[0] = errors.forces[0] = 0.0
    return Draws(weights, prior_mean, strength, errors)


def _shape(B: int) -> float:
    """Of the gamma distribution of the weights of B pushes; their mean is one, their variance its inverse."""
    return max(B - 1, 1) / (B + 1)


def _balanced(shape: tuple[int, ...], rungs: int, rng: np.random.Generator) -> FloatArray:
    """Standard normal draws for K hypotheses, the first entry of a shape. Those under the same likelihood
    have a mean of zero, so that the mean of few hypotheses stays near the best fit."""
    drawn = rng.standard_normal(shape)
    for rung in range(rungs):
        own = drawn[rung::rungs]
        if len(own) > 1:
            own -= own.mean(axis=0)
            own *= np.sqrt(len(own) / (len(own) - 1))
    return drawn


def refits(ladder: Ladder, drawn: Draws, report: StageProgress) -> tuple[Maps, FloatArray]:
    """Randomised refits around the best fits, under each likelihood of a ladder in turn.

    Returns:
        Maps of K hypotheses and their probabilities (K,).
    """
    weights, prior_mean, strength, errors = drawn
    hypotheses, prior = len(strength), ladder[0][0].prior
    # With fewer hypotheses than likelihoods, those of larger evidence are used.
    rungs = ladder[-hypotheses:]

    done = shares_of(report, len(rungs))

    def refitted(rung: int, likelihood: Likelihood, first: Fits) -> Fits:
        own = np.arange(rung, hypotheses, len(rungs))
        weight, assumed = weights[own], None
        if likelihood is ladder[0][0] and (m := _mean_square(likelihood, first)) < 1.0:
            weight, assumed = _divided(m, weight, errors.of(own))
        return fit(
            likelihood,
            prior.rescaled(first.z[0], strength[own]),
            weights=weight,
            prior_mean=prior_mean[own],
            strength=strength[own],
            offsets=np.repeat(first.offsets, len(own), axis=0),
            errors=assumed,
            iterations=15,
            tolerance=3e-3,
            progress=done[rung],
        )

    z, probability = np.empty((hypotheses, prior.size)), np.empty(hypotheses)
    found = side_by_side([partial(refitted, rung, *rungs[rung]) for rung in range(len(rungs))])
    for rung, fits in enumerate(found):
        z[rung :: len(rungs)] = fits.z
        weight = accuracy_weights(fits.push_cost.sum(axis=1))
        probability[rung :: len(rungs)] = weight * len(weight) / hypotheses
    return prior.maps(z, strength), probability


def _divided(m: float, weights: FloatArray, errors: DrawnErrors) -> tuple[FloatArray, DrawnErrors]:
    """Weights (K, B) and errors that together scatter hypotheses by what the likelihood allows.

    With residuals of mean square m < 1, in its standard deviations, weights of variance m v instead of v give
    m² of the variance that it allows, and the errors the rest. A push carries its errors into the gradient w
    times, which multiplies their variance by E(w²) = 1 + m v.
    """
    v = 1.0 / _shape(weights.shape[1])
    return 1.0 + np.sqrt(m) * (weights - 1.0), errors.times(np.sqrt((1.0 - m**2) / (1.0 + m * v)))


def accuracy_weights(cost: FloatArray) -> FloatArray:
    """Probabilities of hypotheses from their costs (K,): a soft-max as in the paper's line 30.

    The temperature is twice the median excess over the best, at least 2: hypotheses that are about equally
    likely keep about equal weights, and those stuck in a worse local minimum lose theirs.
    """
    excess = cost - cost.min()
    weight = np.exp(-excess / (2.0 * max(1.0, float(np.median(excess)))))
    return weight / weight.sum()
