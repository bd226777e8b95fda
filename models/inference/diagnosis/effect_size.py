"""How large an effect is, once it was found: its parameters, no surer than the model is right.

The strict likelihood that finds effects believes every row of every force, and holds a total mass for sure
that a force model 2 % off moves by a third; what is in proportion to mass, as a tilt is, goes with it. So
sizes are told by the forgiving likelihood of the identification, from where the strict one led.
"""

from __future__ import annotations

import numpy as np

from models.inference.diagnosis.fitting import Fitted
from models.inference.diagnosis.results import ParameterEstimate, estimates_of, parameter_estimates
from models.inference.gauss_newton import Fits
from models.inference.likelihood import Likelihood
from models.inference.trust import fit_with_trust
from models.measurements import Noise
from models.physics.cell_grid import FloatArray
from models.physics.rollout import RolloutError


def forgiving_prior_mean(fitted: Fitted) -> FloatArray:
    """(d,) where the prior of forgiving refits is centred: as the fit's, but effects at what was found.

    They were found, so nothing pulls them to their nulls any more where the forgiving likelihood sees little
    of them.
    """
    plain = fitted.likelihood.prior.plain
    return np.concatenate([fitted.prior_mean[:plain], fitted.z[plain:]])


def forgiving_fits(fitted: Fitted, noise: Noise) -> list[tuple[Likelihood, Fits]]:
    """The model fitted again under the likelihoods of `fit_with_trust`, from where it is."""
    return fit_with_trust(
        fitted.likelihood.prior,
        fitted.likelihood.observations,
        noise,
        fitted.z[None],
        lambda done, total: None,
        forgiving_prior_mean(fitted),
    )


def effect_sizes(fitted: Fitted, noise: Noise) -> tuple[ParameterEstimate, ...]:
    """Parameters of a model's effects with their 90 % intervals, cut at the allowed range.

    Where the forgiving fit leads to a model that cannot be rolled out, they are the strict fit's.
    """
    prior = fitted.likelihood.prior
    try:
        _, found = forgiving_fits(fitted, noise)[-1]
    except (RolloutError, np.linalg.LinAlgError):
        return parameter_estimates(fitted)
    covariance = np.linalg.inv(found.hessian[0] + np.eye(prior.size))
    deviations = np.sqrt(np.diagonal(covariance)[prior.plain :]) * prior.effect_scales
    return estimates_of(fitted.effects, prior.maps(found.z).effects[0], deviations)
