"""Cross-validation: the error of a model on pushes it was not fitted to, from the fitted pushes alone.

The error on a fitted push understates the model's error: with few pushes and many map coordinates, the fit
follows each of them. So the pushes are split into folds, and the model is refitted without each fold,
starting from the best fit to all. An end of a left-out push is off by what the refit leaves open, with the
variance V = J (I + H)⁻¹ Jᵀ, by the sensors' noise, and by the model's error, of which a share ε of the travel
is Student's. Only ε is unknown: its distribution, given how far off all ends are, is computed on a grid.
Five short pushes may leave open whether it is a thousandth or some hundredths, so predictions use all of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from slipmap.models.geometry import radius_of_gyration
from slipmap.models.inference.end_region import MODEL_FREEDOM, MOST_FREEDOM
from slipmap.models.inference.error_model import SensorNoise, outline_errors
from slipmap.models.inference.gauss_newton import Fits, fit
from slipmap.models.inference.likelihood import Likelihood
from slipmap.models.inference.prediction import effective_travel
from slipmap.models.physics.cell_grid import FloatArray

_FOLDS = 8

_SHARES = np.geomspace(1e-4, 1.0, 401)
"""Values of ε, equally likely beforehand: from what no camera could see to the whole travel."""

_QUANTILES = (np.arange(9) + 0.5) / 9
"""Of ε: so many equally likely values stand for its distribution."""

_OUTLINES = 20
"""So many outlines stand for an uncertain one: near a corner the finger holds or slips off, which derivatives
do not show."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Fits of a model, each without one fold of the pushes."""

    likelihood: Likelihood  # of all B pushes
    fits: Fits  # one for each fold
    fold: NDArray[np.int64]  # (B,) index of the fit that a push was left out of

    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Ends of the pushes, each predicted by the fit that left it out.

        Returns:
            World poses (B, 3), m and rad, and the variances (B, 3) of what that fit, the tracker's view of
            the start, the outline and the record of the finger's track leave open of them.
        """
        prior, observations = self.likelihood.prior, self.likelihood.observations
        maps = prior.maps(self.fits.z)
        ends, variances = np.empty((2, len(observations), 3))
        for k in range(len(maps)):
            own = np.flatnonzero(self.fold == k).tolist()
            pushes = [observations[b].push for b in own]
            rollouts = prior.slider.rollout(maps[k : k + 1], pushes, sensitivities=True)
            ends[own] = rollouts.end[0, :, :3]
            left = np.linalg.inv(self.fits.hessian[k] + np.eye(prior.size))
            likely = [observations[b].likely_pushes for b in own]
            along = prior.slider.rollout(maps[k : k + 1], [push for tracks in likely for push in tracks])
            by_track = np.split(along.end[0, :, :3], np.cumsum([len(tracks) for tracks in likely])[:-1])
            for place, b in enumerate(own):
                slopes = prior.chain(maps[k : k + 1], rollouts.d_poses_of(place)[:, -1])[0]
                by_maps, by_start = slopes[:, : prior.size], slopes[:, prior.size :]
                started = (by_start * self.likelihood.tracker_sigma[b]) ** 2
                variances[b] = ((by_maps @ left) * by_maps).sum(axis=1) + started.sum(axis=1)
                variances[b] += by_track[place].var(axis=0)
            if outline := self.likelihood.outline:
                ways = outline * outline_errors(_OUTLINES)
                touched = [replace(push, tip=push.tip + way) for push in pushes for way in ways]
                elsewhere = prior.slider.rollout(maps[k : k + 1], touched).end[0, :, :3]
                variances[own] += elsewhere.reshape(len(own), _OUTLINES, 3).var(axis=1)
        return ends, variances


def leave_out(likelihood: Likelihood, best: Fits) -> LeftOut:
    """Refit without each fold; for a single push this leaves the prior alone.

    Args:
        likelihood: of B pushes.
        best: the fit to all of them, one hypothesis.
    """
    B = len(likelihood.observations)
    folds = min(_FOLDS, B)
    fold = np.arange(B) % folds
    fits = fit(
        likelihood,
        np.repeat(best.z, folds, axis=0),
        weights=(fold != np.arange(folds)[:, None]).astype(float),
        offsets=np.repeat(best.offsets, folds, axis=0),
        iterations=6,
        tolerance=1e-2,
    )
    return LeftOut(likelihood, fits, fold)


def end_errors(left_out: LeftOut, noise: SensorNoise) -> list[list[float]]:
    """Errors of predicted ends beyond sensor noise and what the pushes leave open, as shares of the travel.

    Args:
        left_out: fits without each fold.

    Returns:
        Standard deviations of x and y, and of ρ θ, where ρ is the cells' radius of gyration, as shares of
        `prediction.effective_travel`: equally likely values of each, ascending.
    """
    likelihood = left_out.likelihood
    grid = likelihood.prior.slider.grid
    scale = np.array([1.0, 1.0, radius_of_gyration(grid)])
    ends, variances = left_out.ends()
    measured = np.array([observation.poses[-1] for observation in likelihood.observations])
    off = (ends - measured) * scale
    open_ = (variances + noise.of_poses**2) * scale**2
    travel = np.array([observation.travel(grid.centers)[-1] for observation in likelihood.observations])
    parts = slice(0, 2), slice(2, 3)
    return [_shares(off[:, part], open_[:, part], effective_travel(travel)) for part in parts]


def _shares(off: FloatArray, variance: FloatArray, travel: FloatArray) -> list[float]:
    """Quantiles of ε, from errors (B, m), their variances (B, m) without ε, and travels (B,)."""
    of_model = (_SHARES * travel[:, None, None]) ** 2
    total = variance[..., None] + of_model
    # The sum of a normal and a Student's error as in `EndRegion`.
    freedom = np.minimum(MODEL_FREEDOM * (total / of_model) ** 2, MOST_FREEDOM)
    spread = (freedom - 2.0) * total
    density = gammaln(0.5 * (freedom + 1.0)) - gammaln(0.5 * freedom) - 0.5 * np.log(spread)
    density -= 0.5 * (freedom + 1.0) * np.log1p(off[..., None] ** 2 / spread)
    log = density.sum(axis=(0, 1))
    if not np.isfinite(log).all():  # a fit that says nothing of these pushes
        return [float(_SHARES[-1])] * len(_QUANTILES)
    below = np.cumsum(np.exp(log - log.max()))
    return [float(share) for share in _SHARES[np.searchsorted(below, _QUANTILES * below[-1])]]
