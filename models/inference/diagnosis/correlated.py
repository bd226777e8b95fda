"""Residuals and Jacobians of whole pushes, whitened by an error model; and the cost that fits minimise.

It has the same face as `models.inference.likelihood.Likelihood`, so that `gauss_newton.fit` serves both.
There each pose counts by itself, and little; here their correlation is spelled out, and all count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.inference.diagnosis.error_model import ErrorModel
from models.inference.diagnosis.measured_pushes import MeasuredPushes
from models.inference.likelihood import NormalEquations
from models.inference.observations import AVERAGED, Observation
from models.inference.prior import MapPrior
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

    def by(self, columns: NDArray[np.int64]) -> PushRows:
        """The same with derivatives by some coordinates (c,) and the start."""
        chosen = np.append(columns, np.arange(-3, 0))
        return PushRows(self.pose, self.pose_slopes[..., chosen], self.force, self.force_slopes[..., chosen])


class CorrelatedLikelihood:
    """Costs of K hypotheses against B observed pushes under an `ErrorModel`.

    Args:
        prior: coordinates of maps and effects.
        measured: B pushes.
        error: error model.
    """

    def __init__(self, prior: MapPrior, measured: MeasuredPushes, error: ErrorModel) -> None:
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

    def rollouts(self, z: FloatArray, offsets: FloatArray, strength: FloatArray, derive: bool) -> Rollouts:
        """Roll out the hypotheses z (K, d) from starts moved by offsets (K, B, 3)."""
        K, B = len(z), len(self.observations)
        return self.prior.slider.rollout(
            self.prior.maps(z, strength),
            self.measured.pushes,
            sensitivities=derive,
            start_poses=self.measured.starts[None] + offsets,
            start_twists=np.broadcast_to(self.measured.twists, (K, B, 3)),
        )

    def rows(self, z: FloatArray, offsets: FloatArray) -> list[PushRows]:
        """Residuals and derivatives of one hypothesis z (d,), for all pushes."""
        strength = np.ones(1)
        rollouts = self.rollouts(z[None], offsets[None], strength, True)
        maps = self.prior.maps(z[None], strength)
        by_pose = self.prior.chain(maps, rollouts.d_poses, strength)
        by_force = self.prior.chain(maps, self._mean_slopes(rollouts), strength)
        result = []
        for b in range(len(self.observations)):
            pose, slopes = self._pose(rollouts, by_pose, b)
            force = self._force(rollouts, b)
            force_slopes = by_force[:, self.measured.stretch_at[b] : self.measured.stretch_at[b + 1]]
            result.append(PushRows(pose[0], slopes[0], force[0], force_slopes[0]))
        return result

    def _arm(self, poses: FloatArray) -> FloatArray:
        c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
        x, y = self.measured.centroid
        return np.stack([c * x - s * y, s * x + c * y], axis=-1)

    def _pose(self, rollouts: Rollouts, by_pose: FloatArray | None, b: int) -> tuple[FloatArray, FloatArray]:
        measured, predicted = self.observations[b].poses, rollouts.poses_of(b)
        arm = self._arm(predicted)
        place = predicted[..., :2] + arm - measured[..., :2] - self._arm(measured)
        turn = self.measured.radius * (predicted[..., 2:] - measured[..., 2:])
        residual = np.concatenate([place, turn], axis=-1)
        if by_pose is None:
            return residual, np.zeros(0)
        J = by_pose[:, rollouts.pose_at[b] : rollouts.pose_at[b + 1]].copy()
        J[:, :, 0] -= arm[..., 1:] * J[:, :, 2]
        J[:, :, 1] += arm[..., :1] * J[:, :, 2]
        J[:, :, 2] *= self.measured.radius
        return residual, J

    def _force(self, rollouts: Rollouts, b: int) -> FloatArray:
        mean = self.measured.stretches[b] @ rollouts.forces_of(b)
        return mean - self.observations[b].forces[self.observations[b].sliding]

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
        rollouts = self.rollouts(z, offsets, strength, True)
        maps = self.prior.maps(z, strength)
        by_pose = self.prior.chain(maps, rollouts.d_poses, strength)
        by_force = self.prior.chain(maps, self._mean_slopes(rollouts), strength)
        cost = np.empty((K, B))
        hessian, gradient = np.zeros((K, d, d)), np.zeros((K, d))
        gains, start_gradients = np.empty((B, K, 3, 3)), np.empty((B, K, 3))
        couplings = np.empty((B, K, d, 3))
        for b in range(B):
            pose, slopes = self._pose(rollouts, by_pose, b)
            force = self._force(rollouts, b)
            force_slopes = by_force[:, self.measured.stretch_at[b] : self.measured.stretch_at[b + 1]]
            for k in range(K):
                columns = np.concatenate([slopes[k], pose[k][..., None]], axis=-1)
                force_columns = np.concatenate([force_slopes[k], force[k][..., None]], axis=-1)
                rows = self.whiteners[b](columns, force_columns)
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
