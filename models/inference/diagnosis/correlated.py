"""Residuals and Jacobians of whole pushes, whitened by an error model; and the cost that fits minimise.

It has the same face as `models.inference.likelihood.Likelihood`, so that `gauss_newton.fit` serves both.
There each pose counts by itself, and little; here their correlation is spelled out, and all count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from models.inference.diagnosis.error_model import ErrorModel, travelled
from models.inference.likelihood import NormalEquations
from models.inference.observations import AVERAGED, SAMPLES, Observation
from models.inference.prior import MapPrior
from models.inference.push_errors import radius_of_gyration
from models.physics.cell_grid import FloatArray
from models.physics.rollout import Rollouts

OUTLIER = 2.5
"""Pushes whose whitened residuals are larger than this, in root mean square, count linearly (Huber)."""


@dataclass(frozen=True, eq=False)
class PushRows:
    """One push of one model: residuals and derivatives, not whitened.

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


class CorrelatedLikelihood:
    """Costs of K hypotheses against B observed pushes under an `ErrorModel`.

    Args:
        prior: coordinates of maps and effects.
        observations: B pushes.
        error: error model.
    """

    def __init__(self, prior: MapPrior, observations: Sequence[Observation], error: ErrorModel) -> None:
        self.prior = prior
        self.observations: Sequence[Observation] = list(observations)
        self.error = error
        grid = prior.slider.grid
        self._centroid, self._radius = grid.centers.mean(axis=0), radius_of_gyration(grid)
        self._factors = [
            error.factors(o, travelled(o, grid.centers), self._radius) for o in self.observations
        ]
        noise = error.noise
        # Where the object is still at first, the start is a mean of many rows; it may settle meanwhile.
        start_rows = np.minimum([o.start_rows for o in self.observations], AVERAGED)
        self.start_sigma = (
            np.array([noise.position, noise.position, noise.angle]) / np.sqrt(start_rows)[:, None]
        )
        dense = [_force_steps(o) for o in self.observations]
        self._stretches = [stretch for _, stretch in dense]
        self._pushes = [
            replace(o.push, force_times=times) for o, (times, _) in zip(self.observations, dense, strict=True)
        ]
        self._starts = np.array([push.start_pose for push in self._pushes])
        self._twists = np.array([push.start_twist for push in self._pushes])

    def log_determinant(self, push: int) -> float:
        """Logarithm of the determinant of the Cholesky factors of one push, by which densities are
        normalised."""
        pose, force = self._factors[push]
        total = sum(float(np.log(np.diagonal(factor)).sum()) for factor in pose)
        return total + 2.0 * float(np.log(np.diagonal(force)).sum())

    def rollouts(self, z: FloatArray, offsets: FloatArray, strength: FloatArray, derive: bool) -> Rollouts:
        """Roll out the hypotheses z (K, d) from starts moved by offsets (K, B, 3)."""
        K, B = len(z), len(self.observations)
        return self.prior.slider.rollout(
            self.prior.maps(z, strength),
            self._pushes,
            sensitivities=derive,
            start_poses=self._starts[None] + offsets,
            start_twists=np.broadcast_to(self._twists, (K, B, 3)),
        )

    def rows(self, z: FloatArray, offsets: FloatArray) -> list[PushRows]:
        """Residuals and derivatives of one hypothesis z (d,), for all pushes."""
        strength = np.ones(1)
        rollouts = self.rollouts(z[None], offsets[None], strength, True)
        maps = self.prior.maps(z[None], strength)
        by_pose = self.prior.chain(maps, rollouts.d_poses, strength)
        by_force = self.prior.chain(maps, rollouts.d_forces, strength)
        result = []
        for b in range(len(self.observations)):
            pose, slopes = self._pose(rollouts, by_pose, b)
            force, force_slopes = self._force(rollouts, by_force, b)
            result.append(PushRows(pose[0], slopes[0], force[0], force_slopes[0]))
        return result

    def whitened(self, push: int, pose: FloatArray, force: FloatArray) -> FloatArray:
        """Whiten columns of residuals or derivatives: pose (S, 3, c) and force (T, 2, c) to (3 S + 2 T,
        c)."""
        factors, force_factor = self._factors[push]
        parts = [
            scipy.linalg.solve_triangular(factors[i], pose[:, i], lower=True, check_finite=False)
            for i in range(3)
        ]
        if len(force):
            parts += [
                scipy.linalg.solve_triangular(force_factor, force[:, i], lower=True, check_finite=False)
                for i in range(2)
            ]
        return np.concatenate(parts)

    def _arm(self, poses: FloatArray) -> FloatArray:
        c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
        x, y = self._centroid
        return np.stack([c * x - s * y, s * x + c * y], axis=-1)

    def _pose(self, rollouts: Rollouts, by_pose: FloatArray | None, b: int) -> tuple[FloatArray, FloatArray]:
        measured, predicted = self.observations[b].poses, rollouts.poses_of(b)
        arm = self._arm(predicted)
        place = predicted[..., :2] + arm - measured[..., :2] - self._arm(measured)
        turn = self._radius * (predicted[..., 2:] - measured[..., 2:])
        residual = np.concatenate([place, turn], axis=-1)
        if by_pose is None:
            return residual, np.zeros(0)
        J = by_pose[:, rollouts.pose_at[b] : rollouts.pose_at[b + 1]].copy()
        J[:, :, 0] -= arm[..., 1:] * J[:, :, 2]
        J[:, :, 1] += arm[..., :1] * J[:, :, 2]
        J[:, :, 2] *= self._radius
        return residual, J

    def _force(
        self, rollouts: Rollouts, by_force: FloatArray | None, b: int
    ) -> tuple[FloatArray, FloatArray]:
        mean = self._stretches[b]
        residual = np.einsum("ts,ksi->kti", mean, rollouts.forces_of(b))
        residual = residual - self.observations[b].forces[self.observations[b].sliding]
        if by_force is None:
            return residual, np.zeros(0)
        steps = by_force[:, rollouts.force_at[b] : rollouts.force_at[b + 1]]
        return residual, np.einsum("ts,ksic->ktic", mean, steps)

    def linearise(
        self, z: FloatArray, offsets: FloatArray, strength: FloatArray, weights: FloatArray
    ) -> NormalEquations:
        """See `Likelihood.linearise`."""
        K, d, B = len(z), self.prior.size, len(self.observations)
        rollouts = self.rollouts(z, offsets, strength, True)
        maps = self.prior.maps(z, strength)
        by_pose = self.prior.chain(maps, rollouts.d_poses, strength)
        by_force = self.prior.chain(maps, rollouts.d_forces, strength)
        cost = np.empty((K, B))
        hessian, gradient = np.zeros((K, d, d)), np.zeros((K, d))
        gains, start_gradients = np.empty((B, K, 3, 3)), np.empty((B, K, 3))
        couplings = np.empty((B, K, d, 3))
        for b in range(B):
            pose, slopes = self._pose(rollouts, by_pose, b)
            force, force_slopes = self._force(rollouts, by_force, b)
            for k in range(K):
                columns = np.concatenate([slopes[k], pose[k][..., None]], axis=-1)
                force_columns = np.concatenate([force_slopes[k], force[k][..., None]], axis=-1)
                rows = self.whitened(b, columns, force_columns)
                J, r = rows[:, :-1], rows[:, -1]
                weight, value = self._robust(float(r @ r), len(r))
                sigma = self.start_sigma[b]
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

    @staticmethod
    def _robust(square: float, rows: int) -> tuple[float, float]:
        """Huber's weight and cost of a push by the norm of its whitened residuals."""
        norm, limit = float(np.sqrt(square)), OUTLIER * float(np.sqrt(rows))
        if norm <= limit:
            return 1.0, 0.5 * square
        return limit / norm, limit * (norm - 0.5 * limit)


def _force_steps(observation: Observation) -> tuple[FloatArray, FloatArray]:
    """Times of all steps in the stretches whose mean force counts, and the matrix (T, steps) that takes the
    means.

    A finger path with a little noise rattles the object; over a stretch that cancels in the force as measured
    and as predicted, if all of it is counted.
    """
    push = observation.push
    middles = np.asarray(push.force_times)[observation.sliding]
    steps = len(push.tip) - 1
    half = 0.5 * steps * push.h / SAMPLES
    times = (np.arange(steps) + 0.5) * push.h
    inside = np.abs(times[None] - middles[:, None]) <= half * (1 + 1e-9)
    if len(middles) == 0:
        return np.zeros(0), np.zeros((0, 0))
    # A stretch shorter than a step takes the step that holds it.
    empty = ~inside.any(axis=1)
    inside[empty, np.clip((middles[empty] / push.h).astype(int), 0, steps - 1)] = True
    used = inside.any(axis=0)
    mean = inside[:, used] / inside.sum(axis=1, keepdims=True)
    return times[used], mean
