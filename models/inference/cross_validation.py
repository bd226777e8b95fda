"""Cross-validation: the error of a model on pushes it was not fitted to, from the fitted pushes alone.

The error on a fitted push understates the model's error: with few pushes and many map coordinates, the fit
follows each of them. So the pushes are split into folds, and the model is refitted without each fold,
starting from the best fit to all. Its errors on the left-out pushes show how far off predicted ends will be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from slipmap.models.geometry import radius_of_gyration
from slipmap.models.inference.error_model import SensorNoise
from slipmap.models.inference.gauss_newton import Fits, fit
from slipmap.models.inference.likelihood import Likelihood
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.prediction import Motion
from slipmap.models.physics.cell_grid import FloatArray

_FOLDS = 8


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Fits of a model, each without one fold of the pushes."""

    likelihood: Likelihood  # of all B pushes
    fits: Fits  # one for each fold
    fold: NDArray[np.int64]  # (B,) index of the fit that a push was left out of

    def ends(self) -> FloatArray:
        """(B, 3) world poses at the end of each push, predicted by the fit that left it out."""
        prior, observations = self.likelihood.prior, self.likelihood.observations
        maps = prior.maps(self.fits.z)
        ends = np.empty((len(observations), 3))
        for k in range(len(maps)):
            own = np.flatnonzero(self.fold == k).tolist()
            pushes = [observations[b].push for b in own]
            ends[own] = prior.slider.rollout(maps[k : k + 1], pushes).end[0, :, :3]
        return ends


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


def end_errors(
    left_out: LeftOut, observations: Sequence[Observation], motions: Sequence[Motion], noise: SensorNoise
) -> list[float]:
    """Errors of predicted ends beyond sensor noise and the spread of hypotheses, as shares of the travel.

    Args:
        left_out: fits without each fold.
        observations: the pushes.
        motions: the belief's predictions of them.
        noise: of the sensors.

    Returns:
        Standard deviations of x and y, and of ρ θ, where ρ is the cells' radius of gyration: root mean
        squares over the pushes, widened so that a normal 90 % interval is as wide as Student's.
    """
    grid = left_out.likelihood.prior.slider.grid
    radius = radius_of_gyration(grid)
    floor = np.array([noise.position, noise.position, radius * noise.angle])
    squares = []
    for observation, motion, end in zip(observations, motions, left_out.ends(), strict=True):
        off = (end - observation.poses[-1]) * [1.0, 1.0, radius]
        ends, p = motion.poses[:, -1] * [1.0, 1.0, radius], motion.probability
        scatter = p @ (ends - p @ ends) ** 2
        travel = max(float(observation.travel(grid.centers)[-1]), 1e-3)
        squares.append((off**2 - floor**2 - scatter) / travel**2)
    widened = (stdtrit(len(squares), 0.95) / ndtri(0.95)) ** 2
    place, place_too, turn = np.mean(squares, axis=0) * widened
    return [float(np.sqrt(max(value, 0.0))) for value in (0.5 * (place + place_too), turn)]
