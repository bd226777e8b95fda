"""How badly one push was predicted, beside what sensors and the model are off by anyway; what that proves.

The statistic is the one by which the diagnosis tells an outlying push (`diagnosis.correlated`): the root mean
square of a push's residuals after whitening with its error model, so that the correlation along a push is
spelled out. About 1 where the error model holds.

Evidence gathers over pushes. How usual a misfit is, is told by its rank among the misfits of pushes without
any missing effect (calibration) and all pushes before: as long as they are exchangeable, the rank p is
uniform and independent of the past (conformal prediction; Vovk, Gammerman and Shafer, 2005). A bet against
that pays e(p), with mean 1 at most, and E ← max(E, 1) e(p) from push to push is a CUSUM of such bets: if
nothing is missing, at least 1/a pushes pass on average before E reaches 1/a.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg

from models.inference.belief import Belief
from models.inference.diagnosis.error_model import ErrorModel, SensorNoise, travelled
from models.inference.observations import Observation
from models.inference.predicted_motion import predicted_motion
from models.inference.push_errors import radius_of_gyration
from models.inference.residuals import centroid_tracks
from models.physics.cell_grid import CellGrid, FloatArray
from models.physics.rollout import Push


def pose_noise(position: float, angle: float) -> SensorNoise:
    """Noise of observed poses alone: standard deviations of x and y each, m, and of θ, rad."""
    return SensorNoise(position, angle, 0.0, position, angle, 0.0, declared=True)


def observed_push(push: Push, poses: FloatArray, name: str = "push") -> Observation:
    """A push with poses (S, 3) observed at its `pose_times`, without forces."""
    return Observation(name, "heldout", push, poses, np.zeros((0, 2)), np.zeros(0, dtype=bool))


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
    factors, _ = error.factors(predicted, travelled(predicted, grid.centers), radius)
    noise = np.array([error.noise.position, error.noise.position, radius * error.noise.angle])
    covariance = factors @ factors.transpose(0, 2, 1) + (noise**2)[:, None, None]
    return np.linalg.cholesky(covariance)


def simulated_misfits(
    belief: Belief, pushes: Sequence[Push], error: ErrorModel, draws: int, rng: np.random.Generator
) -> FloatArray:
    """(draws,) misfits of pushes in which nothing is missing: parametric bootstrap of the belief itself.

    The truth of each draw is a hypothesis, taken by probability, with errors as the error model has them; the
    prediction is the belief's mean from a start seen with noise.

    Args:
        belief: whose predictions are judged.
        pushes: typical ones, drawn from again and again.
        error: see `push_misfit`.
        draws: number of misfits.
        rng: of the truths and the noise.
    """
    grid = belief.grid
    radius = radius_of_gyration(grid)
    noise = np.array([error.noise.position, error.noise.position, error.noise.angle])
    chosen = [pushes[b] for b in rng.integers(len(pushes), size=draws)]
    truth = rng.choice(len(belief), size=draws, p=belief.probability)
    begun = [replace(push, start_pose=push.start_pose + noise * rng.normal(size=3)) for push in chosen]
    # Placeholders stand for the poses, which the prediction does not read.
    motions, told = (
        predicted_motion(belief, [observed_push(p, np.zeros((len(p.pose_samples[0]), 3))) for p in group])
        for group in (chosen, begun)
    )
    misfits = np.empty(draws)
    for b, (push, motion, prediction) in enumerate(zip(begun, motions, told, strict=True)):
        poses = motion.poses[truth[b]]
        exact = observed_push(push, poses)
        factors, _ = error.factors(exact, travelled(exact, grid.centers), radius)
        off = np.stack([factor @ rng.normal(size=len(poses)) for factor in factors], axis=1)
        observed = observed_push(push, poses + off / np.array([1.0, 1.0, radius]))
        misfits[b] = push_misfit(observed, prediction.mean_poses, error, grid)
    return misfits


def rank_p(misfit: float, before: FloatArray) -> float:
    """Share of pushes, this one included, whose misfit is as large; uniform if they are exchangeable."""
    return (1 + int((before >= misfit).sum())) / (1 + len(before))


def bet(p: float) -> float:
    """e(p) = ∫₀¹ κ p^(κ-1) dκ = (1 - p + p ln p) / (p ln² p), with mean 1 over uniform p; 1/2 at p = 1."""
    if p > 1.0 - 1e-4:
        return 0.5
    log = float(np.log(p))
    return (1.0 - p + p * log) / (p * log * log)


__all__ = ["bet", "observed_push", "pose_noise", "push_misfit", "rank_p", "simulated_misfits"]
