"""The strict likelihood: residuals and Jacobians of whole pushes, whitened by an `ErrorModel`.

It has the same face as `slipmap.models.inference.likelihood.Likelihood`, so that `gauss_newton.fit` serves
both. There each pose counts by itself, and little; here their correlation is spelled out, and all count.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from slipmap.models.geometry import radius_of_gyration, rotated
from slipmap.models.inference.error_model import ErrorModel, SensorNoise, travelled
from slipmap.models.inference.likelihood import NormalEquations, slopes_at_centroid
from slipmap.models.inference.observations import AVERAGED, SAMPLES, Observation
from slipmap.models.inference.prior import MapPrior
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Push, Rollouts


@dataclass(frozen=True, eq=False)
class Whitener:
    """Inverse Cholesky factors of the covariances of one push.

    Attributes:
        pose: (3, S, S) of x, y and ρ θ.
        force: (T, T) of a component of the forces that count.
        log_determinant: logarithm of the determinant of the factors, by which densities are normalised.
    """

    pose: FloatArray
    force: FloatArray
    log_determinant: float

    def __call__(self, pose: FloatArray, force: FloatArray) -> FloatArray:
        """Whiten columns of residuals or derivatives: (S, 3, c) and (T, 2, c) to (3 S + 2 T, c)."""
        parts = [self.pose[i] @ pose[:, i] for i in range(3)]
        if len(force):
            parts += [self.force @ force[:, i] for i in range(2)]
        return np.concatenate(parts)


class FitData:
    """What fits of all models to the same pushes share: which forces count, and how residuals are whitened.

    Args:
        observations: B pushes.
        grid: of the object.

    Attributes:
        observations: the same.
        pushes: to roll out, with the times of all forces that count.
        stretches: (T, steps) of each push, the matrix that takes the means of these forces.
        stretch_at: (B + 1,) where each push begins when all stretches are joined.
        centroid: (2,) of the cells, object frame, m.
        radius: of gyration, by which angles are multiplied, m.
        starts: (B, 3) poses, world.
        twists: (B, 3) object frame.
    """

    def __init__(self, observations: Sequence[Observation], grid: CellGrid) -> None:
        self.observations: Sequence[Observation] = list(observations)
        dense = [_force_steps(o) for o in self.observations]
        self.pushes: list[Push] = [
            replace(o.push, force_times=times) for o, (times, _) in zip(self.observations, dense, strict=True)
        ]
        self.stretches = [stretch for _, stretch in dense]
        self.stretch_at = np.cumsum([0, *(len(stretch) for stretch in self.stretches)])
        self.centroid, self.radius = grid.centers.mean(axis=0), radius_of_gyration(grid)
        self.starts = np.array([push.start_pose for push in self.pushes])
        self.twists = np.array([push.start_twist for push in self.pushes])
        self._travel = [travelled(o, grid.centers) for o in self.observations]
        self._kept: dict[tuple[str, SensorNoise, float], list[tuple[FloatArray, float]]] = {}

    def whiteners(self, error: ErrorModel) -> list[Whitener]:
        """Of all pushes; what was computed once for an α or a β is kept."""
        poses = self._once(
            ("pose", error.noise, error.motion),
            lambda b: error.pose_covariance(self.observations[b], self._travel[b], self.radius),
        )
        forces = self._once(
            ("force", error.noise, error.force), lambda b: error.force_covariance(self.observations[b])[None]
        )
        return [
            Whitener(pose, force[0], own + 2.0 * other)
            for (pose, own), (force, other) in zip(poses, forces, strict=True)
        ]

    def _once(
        self, key: tuple[str, SensorNoise, float], covariance: Callable[[int], FloatArray]
    ) -> list[tuple[FloatArray, float]]:
        if key not in self._kept:
            self._kept[key] = [_inverse_factors(covariance(b)) for b in range(len(self.observations))]
        return self._kept[key]


def _inverse_factors(covariances: FloatArray) -> tuple[FloatArray, float]:
    """Inverse lower Cholesky factors (k, S, S) of covariances, and the log of the factors' determinants."""
    if covariances.size == 0:
        return covariances, 0.0
    factors = np.linalg.cholesky(covariances)
    unit = np.eye(covariances.shape[-1])
    inverses = np.array(
        [scipy.linalg.solve_triangular(factor, unit, lower=True, check_finite=False) for factor in factors]
    )
    return inverses, float(np.log(np.diagonal(factors, axis1=-2, axis2=-1)).sum())


def _force_steps(observation: Observation) -> tuple[FloatArray, FloatArray]:
    """Times of all steps in the stretches whose mean force counts, and the matrix (T, steps) of the means.

    A finger path with a little noise rattles the object; over a stretch that cancels in the force as measured
    and as predicted, if all of it is counted.
    """
    push = observation.push
    middles = np.asarray(push.force_times)[observation.sliding]
    if len(middles) == 0:
        return np.zeros(0), np.zeros((0, 0))
    steps = len(push.tip) - 1
    half = 0.5 * steps * push.h / SAMPLES
    times = (np.arange(steps) + 0.5) * push.h
    inside = np.abs(times[None] - middles[:, None]) <= half * (1 + 1e-9)
    # A stretch shorter than a step takes the step that holds it.
    empty = ~inside.any(axis=1)
    inside[empty, np.clip((middles[empty] / push.h).astype(int), 0, steps - 1)] = True
    used = inside.any(axis=0)
    return times[used], inside[:, used] / inside.sum(axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class Linearised:
    """Residuals of one push and their derivatives, of one model and not whitened.

    Attributes:
        pose: (S, 3) predicted minus measured, (dx, dy, ρ dθ) at the cells' centroid, m.
        pose_slopes: (S, 3, d + 3) by coordinates and start.
        force: (T, 2) predicted minus measured force where it counts, N.
        force_slopes: (T, 2, d + 3).
    """

    pose: FloatArray
    pose_slopes: FloatArray
    force: FloatArray
    force_slopes: FloatArray

    def by(self, columns: NDArray[np.int64]) -> Linearised:
        """The same with derivatives by some coordinates (c,) and the start."""
        chosen = np.append(columns, np.arange(-3, 0))
        return Linearised(
            self.pose, self.pose_slopes[..., chosen], self.force, self.force_slopes[..., chosen]
        )

    def whitened(self, whitener: Whitener) -> FloatArray:
        """(3 S + 2 T, d + 4) derivatives and, in the last column, residuals."""
        return whitener(
            np.concatenate([self.pose_slopes, self.pose[..., None]], axis=-1),
            np.concatenate([self.force_slopes, self.force[..., None]], axis=-1),
        )


class CorrelatedLikelihood:
    """Costs of K hypotheses, in the prior's coordinates of maps and effects, against B pushes under an
    `ErrorModel`."""

    def __init__(self, prior: MapPrior, measured: FitData, error: ErrorModel) -> None:
        self.prior = prior
        self.measured = measured
        self.error = error
        self.whiteners = measured.whiteners(error)
        noise = error.noise
        # Where the object is still at first, the start is a mean of many rows; it may settle meanwhile.
        start_rows = np.minimum([o.start_rows for o in measured.observations], AVERAGED)
        self.start_sigma = (
            np.array([noise.position, noise.position, noise.angle]) / np.sqrt(start_rows)[:, None]
        )

    @property
    def observations(self) -> Sequence[Observation]:
        """The B pushes."""
        return self.measured.observations

    def rows(self, z: FloatArray, offsets: FloatArray) -> list[Linearised]:
        """Residuals and derivatives of one hypothesis z (d,) with start offsets (B, 3), for all pushes."""
        return [models[0] for models in self._linearised(z[None], offsets[None], np.ones(1))]

    def _linearised(
        self, z: FloatArray, offsets: FloatArray, strength: FloatArray
    ) -> Iterator[list[Linearised]]:
        """For each push, residuals and derivatives of the K hypotheses."""
        data = self.measured
        K, B = len(z), len(data.observations)
        maps = self.prior.maps(z, strength)
        rollouts = self.prior.slider.rollout(
            maps,
            data.pushes,
            sensitivities=True,
            start_poses=data.starts[None] + offsets,
            start_twists=np.broadcast_to(data.twists, (K, B, 3)),
        )
        by_pose = self.prior.chain(maps, rollouts.d_poses, strength)
        by_force = self.prior.chain(maps, self._mean_slopes(rollouts), strength)
        for b, observation in enumerate(data.observations):
            predicted, measured = rollouts.poses_of(b), observation.poses
            arm = rotated(data.centroid, predicted[..., 2])
            place = predicted[..., :2] + arm - measured[..., :2] - rotated(data.centroid, measured[..., 2])
            turn = data.radius * (predicted[..., 2:] - measured[..., 2:])
            pose = np.concatenate([place, turn], axis=-1)
            by_object = by_pose[:, rollouts.pose_at[b] : rollouts.pose_at[b + 1]]
            slopes = slopes_at_centroid(by_object, arm, data.radius)
            force = data.stretches[b] @ rollouts.forces_of(b) - observation.forces[observation.sliding]
            force_slopes = by_force[:, data.stretch_at[b] : data.stretch_at[b + 1]]
            yield [Linearised(pose[k], slopes[k], force[k], force_slopes[k]) for k in range(K)]

    def _mean_slopes(self, rollouts: Rollouts) -> FloatArray:
        """Derivatives of the mean forces (K, stretches of all pushes, 2, P) by the rollout's own columns,
        which are many times fewer than those of the forces that they are the means of."""
        every = rollouts.d_forces
        K, _, _, columns = every.shape
        means = np.empty((K, self.measured.stretch_at[-1], 2, columns))
        for b, mean in enumerate(self.measured.stretches):
            steps = every[:, rollouts.force_at[b] : rollouts.force_at[b + 1]].reshape(K, -1, 2 * columns)
            rows = slice(self.measured.stretch_at[b], self.measured.stretch_at[b + 1])
            means[:, rows] = (mean @ steps).reshape(K, -1, 2, columns)
        return means

    def linearise(
        self, z: FloatArray, offsets: FloatArray, strength: FloatArray, weights: FloatArray
    ) -> NormalEquations:
        """See `Likelihood.linearise`."""
        K, d, B = len(z), self.prior.size, len(self.observations)
        cost = np.empty((K, B))
        hessian, gradient = np.zeros((K, d, d)), np.zeros((K, d))
        gains, start_gradients = np.empty((B, K, 3, 3)), np.empty((B, K, 3))
        couplings = np.empty((B, K, d, 3))
        for b, models in enumerate(self._linearised(z, offsets, strength)):
            sigma = self.start_sigma[b]
            for k, model in enumerate(models):
                rows = model.whitened(self.whiteners[b])
                J, r = rows[:, :-1], rows[:, -1]
                weight, value = _robust(float(r @ r), len(r))
                scaled = offsets[k, b] / sigma
                cost[k, b] = value + 0.5 * float(scaled @ scaled)
                full = weight * (J.T @ J)
                slope = weight * (J.T @ r)
                start_hessian = full[d:, d:] + np.diag(sigma**-2.0)
                start_gradient = slope[d:] + scaled / sigma
                coupling = full[:d, d:]
                gain = np.linalg.inv(start_hessian)
                w = weights[k, b]
                hessian[k] += w * (full[:d, :d] - coupling @ gain @ coupling.T)
                gradient[k] += w * (slope[:d] - coupling @ gain @ start_gradient)
                gains[b, k], start_gradients[b, k], couplings[b, k] = gain, start_gradient, coupling
        return NormalEquations(cost, hessian, gradient, gains, start_gradients, couplings)


_OUTLIER = 2.5
"""Pushes whose whitened residuals are larger than this, in root mean square, count linearly (Huber)."""


def _robust(square: float, rows: int) -> tuple[float, float]:
    """Huber's weight and cost of a push by the squared norm of its whitened residuals."""
    norm, limit = float(np.sqrt(square)), _OUTLIER * float(np.sqrt(rows))
    if norm <= limit:
        return 1.0, 0.5 * square
    return limit / norm, limit * (norm - 0.5 * limit)
