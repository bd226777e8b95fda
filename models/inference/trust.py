"""How far data are trusted: the error of the best model, learnt from the pushes themselves.

The likelihood counts the model off by a share α of the way travelled. On an object that is as the model has
it, α is half a percent; in another simulator, or on a worn table, it is ten times that, and who trusts the
pushes all the same takes the model's errors for the object's maps. How large α can be is told by the
evidence, by Laplace's approximation around the best fit,

    log p(data | α) ≈ -cost(α) - ½ log det(1 + H) - Σ_b ½ log det(1 + σ H_b σ) - Σ log σ_row(α),

with H the curvature of the data's cost over the maps, H_b over the start of a push, and p(α) ∝ 1/α per
logarithm of α, so that a larger one has to be shown.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from models.inference.gauss_newton import Fits, fit
from models.inference.likelihood import Likelihood, LikelihoodSettings
from models.inference.observations import Observation
from models.inference.prior import MapPrior
from models.measurements import Noise
from models.physics.cell_grid import FloatArray

Ladder = list[tuple[Likelihood, Fits]]
"""Fits under likelihoods that trust the data ever less."""

MODEL_ERRORS = (0.005, 0.015, 0.04, 0.1)
"""α to choose from, ascending."""

FORCE_ERROR = 10.0
LARGEST_FORCE_ERROR = 0.4
"""Error of the best model's force, as a share of the force: by α, and at most."""


def fit_with_trust(
    prior: MapPrior,
    observations: Sequence[Observation],
    noise: Noise,
    starts: FloatArray,
    progress: Callable[[int, int], None],
    mean: FloatArray | None = None,
) -> Ladder:
    """The best fit under every α up to the one of the largest evidence.

    α is raised from the smallest as long as that helps, each fit beginning where the last one ended.

    Args:
        prior: coordinates of the maps.
        observations: pushes to learn from.
        noise: of the sensors, where declared.
        starts: (K, d) coordinates to start from.
        progress: called with (done, total); often it ends before all is done.
        mean: (d,) centre of the prior, zeros if None.

    Returns:
        For each α, ascending: the likelihood with that α in its settings, and the fit, one hypothesis.
    """
    found: Ladder = []
    highest, offsets = -np.inf, None
    for rung, alpha in enumerate(MODEL_ERRORS):
        likelihood = Likelihood(prior, observations, noise, trusting(alpha))
        center = None if mean is None else np.repeat(mean[None], len(starts), axis=0)

        def told(done: int, total: int, rung: int = rung) -> None:
            progress(rung * total + done, len(MODEL_ERRORS) * total)

        best = fit(likelihood, starts, prior_mean=center, offsets=offsets, progress=told).best()
        evidence = log_evidence(likelihood, best) - float(np.log(alpha))
        if evidence < highest:
            break
        found.append((likelihood, best))
        highest, starts, offsets = evidence, best.z, best.offsets
    return found


def trusting(alpha: float) -> LikelihoodSettings:
    """What data are trusted with if the best model is off by a share α of the way travelled.

    Its force is held to be off by ten times that share, 40 % at most.
    """
    return replace(
        LikelihoodSettings(), model_error=alpha, force_error=min(FORCE_ERROR * alpha, LARGEST_FORCE_ERROR)
    )


def log_evidence(likelihood: Likelihood, found: Fits) -> float:
    """log p(data), up to a constant that does not depend on the likelihood's settings; see above."""
    one = np.ones(1)
    equations = likelihood.linearise(found.z, found.offsets, one, np.ones((1, len(likelihood.observations))))
    maps = np.linalg.slogdet(equations.hessian[0] + np.eye(found.z.shape[1]))[1]
    # The gain is the inverse of 1 / σ² + H_b.
    scale = np.outer(likelihood.start_sigma, likelihood.start_sigma)
    starts = np.linalg.slogdet(equations.start_gain[:, 0] / scale)[1].sum()
    return float(-found.cost[0] - 0.5 * maps + 0.5 * starts - likelihood.log_widths())
