"""What one of several datasets says by itself about the effects of a model that was fitted to all."""

from __future__ import annotations

from copy import copy

import numpy as np

from slipmap.models.inference.gauss_newton import fit
from slipmap.models.inference.together import JointFit
from slipmap.models.physics.cell_grid import FloatArray

_OPEN, _HELD = 1e2, 1e-3
"""Standard deviations, in scales, of amplitudes, which are left to the pushes, and of held parameters."""

_ITERATIONS, _TOLERANCE = 15, 1e-4
"""Most iterations, and the share of the cost below which a step ends them: a few hundredths of a nat."""


def alone(found: JointFit, k: int) -> tuple[FloatArray, FloatArray]:
    """Parameters (P,) of the effects from dataset k alone, without a prior of theirs, and their standard
    deviations.

    The dataset's maps are refitted too. The joint model bends the maps of an object whose dataset disagrees
    with the others, and to first order around such maps the parameters may come out far off, with the wrong
    sign. Parameters that only shape an effect are held, with deviations of 0.

    Raises:
        RolloutError: the derivatives overflow.
    """
    likelihood, place = copy(found.likelihood.parts[k]), found.likelihood.prior.places[k]
    prior = likelihood.prior = copy(likelihood.prior)
    values = found.values(k)
    P = len(values)
    amplitudes = prior.amplitudes[:P]
    prior.effect_centers, prior.effect_scales = prior.effect_centers.copy(), prior.effect_scales.copy()
    prior.effect_centers[:P] = values
    prior.effect_scales[:P] *= np.where(amplitudes, _OPEN, _HELD)
    own = slice(prior.plain, prior.plain + P)
    start, mean = found.found.z[:, place].copy(), found.mean[None, place].copy()
    start[:, own] = mean[:, own] = 0.0
    offsets = found.found.offsets[:, found.likelihood.pushes[k]]
    best = fit(
        likelihood, start, prior_mean=mean, offsets=offsets, iterations=_ITERATIONS, tolerance=_TOLERANCE
    )
    deviations = prior.effect_deviations(best.hessian[0])[:P]
    return prior.effect_values(best.z)[0, :P], np.where(amplitudes, deviations, 0.0)
