"""Many answers instead of one: the hypotheses of a belief, refitted around the best fits.

A fit to one set of pushes is one answer; the belief holds many. Each hypothesis is fitted anew to pushes
weighted at random (the Bayesian bootstrap of Rubin, 1981, but with gamma distributed weights that vary a
little more than his exponentials: with those the variance of a mean of B pushes comes out as
(B - 1) / (B + 1) of what it should be, two thirds with five pushes)
and pulled towards maps drawn from the prior. Refits to the weights show what the pushes disagree about, be
it noise or what no such model knows; refits towards random maps show what the pushes leave open. Neither
needs the errors to be independent or the model to be right, which for recorded pushes they are not. And the
hypotheses take turns in how far off they hold the model to be, up to what the pushes speak for (`trust`):
who believes every millimetre takes the model's faults for the object's, who believes few learns little, and
their mixture predicts better than either.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from models.inference.belief import Belief
from models.inference.gauss_newton import fit
from models.inference.trust import Ladder
from models.measurements import PushDataset
from models.physics.cell_grid import FloatArray
from models.physics.rollout import Maps, Slider

STRENGTHS = (0.8, 2.5)
"""Range of the factor on the prior's map variation, drawn log-uniformly for each hypothesis, see
`MapPrior.spreads`."""

Progress = Callable[[str, int, int], None]


def refitted_belief(
    dataset: PushDataset,
    ladder: Ladder,
    hypotheses: int,
    seed: int,
    report: Progress,
    *,
    mean: FloatArray | None = None,
    settings: Mapping[str, Any],
) -> Belief:
    """Randomised refits around the best fits, under each likelihood of the ladder in turn.

    Args:
        dataset: whose pushes were fitted.
        ladder: of `trust.fit_with_trust`.
        hypotheses: K.
        seed: of the draws.
        report: called with (stage, done, total).
        mean: (d,) centre of the prior, zeros if None.
        settings: what else the belief keeps on record.
    """

    def progress(done: int, total: int) -> None:
        report("hypotheses", done, total)

    maps, probability = refits(ladder, hypotheses, np.random.default_rng(seed), progress, mean)
    slider = ladder[0][0].prior.slider
    return gathered_belief(dataset, slider, maps, probability, ladder, seed, {**settings, **trusted(ladder)})


def gathered_belief(
    dataset: PushDataset,
    slider: Slider,
    maps: Maps,
    probability: FloatArray,
    ladder: Ladder,
    seed: int,
    settings: Mapping[str, Any],
) -> Belief:
    """A belief of hypotheses, with the pushes of a ladder as those that taught."""
    return Belief.learnt(
        dataset,
        slider,
        maps,
        probability,
        method="gauss-newton",
        seed=seed,
        trials=[observation.trial for observation in ladder[0][0].observations],
        settings=settings,
    )


def trusted(ladder: Ladder) -> dict[str, Any]:
    """Settings of the fits, for the record."""
    closest, _ = ladder[0]
    return {
        "strengths": list(STRENGTHS),
        "model_errors": [likelihood.settings.model_error for likelihood, _ in ladder],
        "prior": asdict(closest.prior.settings),
        "likelihood": asdict(closest.settings),
    }


def refits(
    ladder: Ladder,
    hypotheses: int,
    rng: np.random.Generator,
    report: Callable[[int, int], None],
    mean: FloatArray | None,
) -> tuple[Maps, FloatArray]:
    """Maps of K hypotheses and their probabilities (K,), see `refitted_belief`."""
    closest, _ = ladder[0]
    prior, B = closest.prior, len(closest.observations)
    shape = max(B - 1, 1) / (B + 1)
    weights = rng.gamma(shape, 1.0 / shape, (hypotheses, B))
    center = np.zeros(prior.size) if mean is None else mean
    prior_mean = center + rng.standard_normal((hypotheses, prior.size))
    strength = np.exp(rng.uniform(np.log(STRENGTHS[0]), np.log(STRENGTHS[1]), hypotheses))
    # The first hypothesis is the plain best fit.
    weights[0], prior_mean[0], strength[0] = 1.0, center, 1.0
    z = np.empty((hypotheses, prior.size))
    probability = np.empty(hypotheses)
    # Where they are fewer than likelihoods, those of the larger evidence count.
    rungs = ladder[-hypotheses:]
    for rung, (likelihood, first) in enumerate(rungs):
        who = np.arange(rung, hypotheses, len(rungs))
        found = fit(
            likelihood,
            prior.rescaled(first.z[0], strength[who]),
            weights=weights[who],
            prior_mean=prior_mean[who],
            strength=strength[who],
            offsets=np.repeat(first.offsets, len(who), axis=0),
            iterations=15,
            tolerance=3e-3,
            progress=_part(report, rung, len(rungs)),
        )
        z[who] = found.z
        probability[who] = accuracy_weights(found.push_cost.sum(axis=1)) * len(who) / hypotheses
    return prior.maps(z, strength), probability


def _part(report: Callable[[int, int], None], part: int, parts: int) -> Callable[[int, int], None]:
    return lambda done, total: report(part * total + done, parts * total)


def accuracy_weights(cost: FloatArray) -> FloatArray:
    """Probabilities of hypotheses from their costs (K,): a soft-max as in the paper's line 30.

    The temperature is twice the median excess over the best, at least 2: hypotheses that the data hold
    about equally likely keep about equal weights, and those that a refit left in a worse valley lose theirs.
    """
    excess = cost - cost.min()
    weight = np.exp(-excess / (2.0 * max(1.0, float(np.median(excess)))))
    return weight / weight.sum()
