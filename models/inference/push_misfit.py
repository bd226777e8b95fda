"""How badly one push was predicted, beside what sensors and the model are off by anyway; what that proves.

The statistic is the one by which the diagnosis tells an outlying push (`diagnosis.correlated`): the root mean
square of a push's residuals after whitening with its error model, so that the correlation along a push is
spelled out. About 1 where the error model holds and the belief is sure of itself.

Evidence gathers over pushes. If nothing is missing, each p is uniform or larger, whatever came before. A bet
against that pays e(p), with mean 1 at most, and E ← max(E, 1) e(p) from push to push is a CUSUM of such bets:
at least 1/a pushes pass on average before E reaches 1/a (Vovk, Gammerman and Shafer, 2005).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg
from scipy.stats import chi2

from models.inference.diagnosis.error_model import ErrorModel, SensorNoise, travelled
from models.inference.observations import Observation
from models.inference.push_errors import radius_of_gyration
from models.inference.residuals import centroid_tracks
from models.physics.cell_grid import CellGrid, FloatArray
from models.physics.rollout import Push


def pose_noise(position: float, angle: float) -> SensorNoise:
    """Noise of observed poses alone: standard deviations of x and y each, m, and of θ, rad."""
    return SensorNoise(position, angle, 0.0, declared=True)


def observed_push(push: Push, poses: FloatArray, name: str = "push") -> Observation:
    """A push with poses (S, 3) observed at its `pose_times`, without forces."""
    none = np.zeros(0)
    return Observation(
        name, "heldout", push, poses, np.ones(len(poses)), 1, np.zeros((0, 2)), none, none.astype(bool)
    )


def push_misfit(observation: Observation, predicted: FloatArray, error: ErrorModel, grid: CellGrid) -> float:
    """Root mean square of the whitened residuals of one push.

    Args:
        observation: the push.
        predicted: (S, 3) poses, predicted from the observed start.
        error: noise of the poses, and α, by which share of the way the model is off anyway.
        grid: cells.
    """
    _, measured, told = centroid_tracks(observation, predicted, grid)
    residual = (measured - told)[1:]
    # The way is taken from the prediction: noise of the observed poses would lengthen it.
    factors = _factors(replace(observation, poses=predicted), error, grid)
    white = [scipy.linalg.solve_triangular(factors[i], residual[:, i], lower=True) for i in range(3)]
    return float(np.sqrt(np.mean(np.square(white))))


def _factors(predicted: Observation, error: ErrorModel, grid: CellGrid) -> FloatArray:
    """(3, S, S) Cholesky factors; the prediction's start was seen with the noise of a pose, too."""
    radius = radius_of_gyration(grid)
    covariance = error.pose_covariance(predicted, travelled(predicted, grid.centers), radius)
    noise = np.array([error.noise.position, error.noise.position, radius * error.noise.angle])
    return np.linalg.cholesky(covariance + (noise**2)[:, None, None])


def resting_misfit(
    start: FloatArray,
    observed: FloatArray,
    told: FloatArray,
    probability: FloatArray,
    error: ErrorModel,
    grid: CellGrid,
) -> tuple[float, float]:
    """Misfit of where an object came to rest, beside all that is not known of it.

    The residual r against the mean of the hypotheses is whitened with the covariance Σ of the error model
    and of the hypotheses together: 3 misfit² = rᵀ Σ⁻¹ r, which is χ² distributed with three degrees of
    freedom if errors and hypotheses are normally distributed.

    Args:
        start: (3,) pose before the push.
        observed: (3,) pose at rest after it.
        told: (K, 3) where the hypotheses ended.
        probability: (K,) of them.
        error: see `push_misfit`.
        grid: cells.

    Returns:
        The misfit, about 1 where nothing is missing, and p, the probability of one as large then.
    """
    mean = (probability @ told)[None]
    push = Push(1.0, np.full((2, 2), np.nan), start, pose_times=np.ones(1))

    def residual(pose: FloatArray) -> FloatArray:
        _, measured, expected = centroid_tracks(observed_push(push, pose[None]), mean, grid)
        return (measured - expected)[1]

    spread = np.array([residual(pose) for pose in told])
    covariance = np.einsum("k,ki,kj->ij", probability, spread, spread)
    # One row: the factors are standard deviations.
    covariance += np.diag(_factors(observed_push(push, mean), error, grid)[:, 0, 0] ** 2)
    r = residual(observed)
    square = float(r @ np.linalg.solve(covariance, r))
    return float(np.sqrt(square / 3.0)), float(chi2.sf(square, 3))


def bet(p: float) -> float:
    """e(p) = ∫₀¹ κ p^(κ-1) dκ = (1 - p + p ln p) / (p ln² p), with mean 1 over uniform p; 1/2 at p = 1."""
    if p > 1.0 - 1e-4:
        return 0.5
    log = float(np.log(p))
    return (1.0 - p + p * log) / (p * log * log)


__all__ = ["bet", "observed_push", "pose_noise", "push_misfit", "resting_misfit"]
