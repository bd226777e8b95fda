"""The forgiving likelihood: the cost of measured pushes under a model, and its derivatives.

Poses are compared at the cells' centroid as (dx, dy, ρ dθ), where ρ is the cells' radius of gyration, so that
the norm is close to ADD. Even the best model misses a measured push by sensor noise and by a model error that
grows with the distance travelled:

    σ² = σ_noise² + σ_0² + (α travel)²

Residuals along a push are correlated, so a push counts as a few independent poses, however densely it was
sampled. Huber's cost keeps a push that the model cannot explain from deciding everything. The start pose of
each push is known only as well as the tracker sees it; its offset is solved for together with the maps and
eliminated from their equations (Schur complement).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from slipmap.models.geometry import radius_of_gyration, rotated
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.prior import MapPrior
from slipmap.models.measurements import Noise
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps, Push, Rollouts

_JACOBIANS = 2**28
"""Most bytes for the Jacobians of pushes rolled out together."""


@dataclass(frozen=True)
class LikelihoodSettings:
    """How far the data are trusted."""

    model_error: float = 0.005  # α, error of the best model as a share of the distance travelled
    base_error: float = 5e-4  # σ_0, m
    independent: float = 4.0  # number of independent poses that a push counts as
    independent_forces: float = 1.0  # the same for its forces, which set the scale of friction
    force_error: float = 0.15  # error of the best model's force as a share of the push's typical force
    huber: float = 2.0  # residuals beyond this many standard deviations count linearly
    start_position: float = 1e-4  # standard deviation of the start where noise is not declared, m
    start_angle: float = 1e-3  # the same for the angle, rad


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Quadratic model of the cost around the current maps, with the start offsets eliminated."""

    cost: FloatArray  # (K, B) robust cost of each push, including the prior of its start offset
    hessian: FloatArray  # (K, d, d) Gauss-Newton, weighted sum over pushes
    gradient: FloatArray  # (K, d)
    push_gradient: FloatArray  # (B, K, d) of each push, unweighted
    start_gain: FloatArray  # (B, K, 3, 3) inverse Hessian of each push's start offset
    start_gradient: FloatArray  # (B, K, 3)
    coupling: FloatArray  # (B, K, d, 3) Hessian block of maps and start


class PushCosts(Protocol):
    """Interface of B pushes to a fit."""

    observations: Sequence[Observation]
    start_sigma: FloatArray  # (B, 3) standard deviations of start offsets, m and rad

    def linearise(
        self, z: FloatArray, offsets: FloatArray, strength: FloatArray, weights: FloatArray
    ) -> NormalEquations:
        """Costs and normal equations, see `PushLikelihood.linearise`."""


class PushLikelihood(ABC):
    """Costs of K hypotheses on B observed pushes, for any model of the residuals.

    Args:
        prior: coordinates of the maps.
        observations: B pushes.
        pushes: the rollouts to make of them, with the times at which a residual is needed.
        start_sigma: (B, 3) standard deviations of start offsets, m and rad.
    """

    def __init__(
        self,
        prior: MapPrior,
        observations: Sequence[Observation],
        pushes: Sequence[Push],
        start_sigma: FloatArray,
    ) -> None:
        self.prior = prior
        self.observations: Sequence[Observation] = list(observations)
        self.start_sigma = start_sigma
        grid = prior.slider.grid
        self._centroid, self._radius = grid.centers.mean(axis=0), radius_of_gyration(grid)
        self._pushes = list(pushes)
        self._starts = np.array([push.start_pose for push in pushes])
        self._twists = np.array([push.start_twist for push in pushes])

    def linearise(
        self, z: FloatArray, offsets: FloatArray, strength: FloatArray, weights: FloatArray
    ) -> NormalEquations:
        """Costs and normal equations at coordinates z (K, d) and start offsets (K, B, 3).

        Args:
            z: coordinates of the prior.
            offsets: start offsets, m and rad.
            strength: (K,) see `MapPrior.maps`.
            weights: (K, B) weight of each push in the equations of each hypothesis; 0 leaves it out.
        """
        prior = self.prior
        K, d, B = len(z), prior.size, len(self.observations)
        maps = prior.maps(z, strength)
        scaled_offsets = offsets / self.start_sigma
        cost = 0.5 * (scaled_offsets**2).sum(axis=-1)
        # Normal equations in the rollout's own columns, which are fewer than the coordinates; pushes that
        # stay away from the table's rim have only the first columns.
        columns, start = prior.columns(maps, strength), prior.start_columns
        by_column = columns.transpose(0, 2, 1)
        P = columns.shape[1]
        reduced_hessian, reduced_gradient = np.zeros((K, P, P)), np.zeros((K, P))
        gains, start_gradients = np.empty((B, K, 3, 3)), np.empty((B, K, 3))
        couplings, push_gradients = np.empty((B, K, d, 3)), np.empty((B, K, d))
        for b, rollouts, place in self._rolled_out(maps, offsets, P):
            J, r, own = self._whitened(rollouts, b, place)
            p = J.shape[-1]
            cost[:, b] += own
            transposed = J.transpose(0, 2, 1)
            full = transposed @ J
            slope = (transposed @ r[..., None])[..., 0]
            start_hessian = full[:, start, start] + np.diag(self.start_sigma[b] ** -2.0)
            start_gradient = slope[:, start] + scaled_offsets[:, b] / self.start_sigma[b]
            coupling = full[:, :, start]
            gain = np.linalg.inv(start_hessian)
            w = weights[:, b]
            own_hessian = full - coupling @ gain @ coupling.transpose(0, 2, 1)
            own_gradient = slope - (coupling @ gain @ start_gradient[..., None])[..., 0]
            reduced_hessian[:, :p, :p] += w[:, None, None] * own_hessian
            reduced_gradient[:, :p] += w[:, None] * own_gradient
            gains[b], start_gradients[b] = gain, start_gradient
            couplings[b] = by_column[..., :p] @ coupling
            push_gradients[b] = (by_column[..., :p] @ own_gradient[..., None])[..., 0]
        hessian = by_column @ reduced_hessian @ columns
        gradient = (by_column @ reduced_gradient[..., None])[..., 0]
        return NormalEquations(cost, hessian, gradient, push_gradients, gains, start_gradients, couplings)

    def _rolled_out(
        self, maps: Maps, offsets: FloatArray, columns: int
    ) -> Iterator[tuple[int, Rollouts, int]]:
        """Each push b, the rollouts that contain it, and its place in them; pushes are rolled out in batches
        whose Jacobians over P columns take at most about `_JACOBIANS` bytes."""
        K, B = len(maps), len(self.observations)
        forces = [0 if p.force_times is None else len(p.force_times) for p in self._pushes]
        rows = 3 * np.array([len(o.poses) for o in self.observations]) + 2 * np.array(forces)
        parts = np.cumsum(8 * K * columns * rows) // _JACOBIANS
        for part in np.split(np.arange(B), np.flatnonzero(np.diff(parts)) + 1):
            rollouts = self.prior.slider.rollout(
                maps,
                [self._pushes[b] for b in part],
                sensitivities=True,
                start_poses=self._starts[part] + offsets[:, part],
                start_twists=np.broadcast_to(self._twists[part], (K, len(part), 3)),
            )
            for place, b in enumerate(part.tolist()):
                yield b, rollouts, place

    def _pose_errors(self, rollouts: Rollouts, b: int, place: int) -> tuple[FloatArray, FloatArray]:
        """Predicted minus measured (x, y, ρ θ) of the cells' centroid (K, S, 3), m, and derivatives
        (K, S, 3, P) with respect to the rollout's own columns."""
        measured, predicted = self.observations[b].poses, rollouts.poses_of(place)
        arm = rotated(self._centroid, predicted[..., 2])
        here, there = predicted[..., :2] + arm, measured[..., :2] + rotated(self._centroid, measured[..., 2])
        turn = self._radius * (predicted[..., 2:] - measured[..., 2:])
        slopes = slopes_at_centroid(
            self._by_own(rollouts.d_poses_of(place), rollouts, place), arm, self._radius
        )
        return np.concatenate([here - there, turn], axis=-1), slopes

    def _by_own(self, slopes: FloatArray, rollouts: Rollouts, place: int) -> FloatArray:
        """Derivatives (…, P) of the push at a place, without the mass columns where these are all zero."""
        return slopes if rollouts.reached[:, place].any() else slopes[..., : self.prior.slider.columns]

    @abstractmethod
    def _whitened(self, rollouts: Rollouts, b: int, place: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Jacobians (K, R, P) and residuals (K, R) of push b, which is at a place in the rollouts, in
        standard deviations and with the weights of a robust cost, and that cost (K,)."""


class Likelihood(PushLikelihood):
    """The forgiving likelihood.

    Args:
        prior: coordinates of the maps.
        observations: B pushes.
        noise: of the sensors, where declared.
        settings: how far the data are trusted.
    """

    def __init__(
        self,
        prior: MapPrior,
        observations: Sequence[Observation],
        noise: Noise,
        settings: LikelihoodSettings,
    ) -> None:
        start = np.array([settings.start_position, settings.start_position, settings.start_angle])
        if noise.position is not None and noise.angle is not None:
            # With many rows the start is a mean of several and known better than a single row.
            single = any(len(observation.poses) == 1 for observation in observations)
            start = (1.0 if single else 0.4) * np.array([noise.position, noise.position, noise.angle])
        pushes = [observation.push for observation in observations]
        super().__init__(prior, observations, pushes, np.tile(start, (len(pushes), 1)))
        self.settings = settings
        self._sigmas = [self._pose_sigma(observation, noise) for observation in self.observations]
        self._force_sigmas = [self._force_sigma(observation, noise) for observation in self.observations]

    def _pose_sigma(self, observation: Observation, noise: Noise) -> FloatArray:
        s = self.settings
        measured = noise.position or 0.0
        travel = observation.travel(self.prior.slider.grid.centers)
        return np.sqrt(measured**2 + s.base_error**2 + (s.model_error * travel) ** 2)

    def _force_sigma(self, observation: Observation, noise: Noise) -> float:
        if not observation.sliding.any():
            return np.inf
        return float(np.hypot(self.settings.force_error * observation.typical_force, noise.force or 0.0))

    def _counted(self, observation: Observation) -> tuple[float, float]:
        """Numbers of independent poses and forces that a push counts as."""
        s = self.settings
        forces = min(s.independent_forces, float(observation.sliding.sum()))
        return min(s.independent, len(observation.poses)), forces

    @property
    def rows_counted(self) -> float:
        """Number of independent poses and forces that all pushes together count as."""
        return sum(sum(self._counted(observation)) for observation in self.observations)

    def log_widths(self) -> float:
        """Σ log σ of all residuals, counted as in the costs; its negative normalises densities."""
        total = 0.0
        for observation, sigma, force in zip(
            self.observations, self._sigmas, self._force_sigmas, strict=True
        ):
            poses, forces = self._counted(observation)
            total += 3.0 * poses * float(np.log(sigma).mean())
            if forces > 0.0:
                total += 2.0 * forces * float(np.log(force))
        return total

    def _whitened(self, rollouts: Rollouts, b: int, place: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        observation, settings = self.observations[b], self.settings
        error, slopes = self._pose_errors(rollouts, b, place)
        groups: list[tuple[FloatArray, FloatArray, FloatArray | float, float]] = [
            (error, slopes, self._sigmas[b], settings.independent)
        ]
        sliding = observation.sliding
        if sliding.any():
            error = rollouts.forces_of(place)[:, sliding] - observation.forces[sliding]
            slopes = self._by_own(rollouts.d_forces_of(place), rollouts, place)[:, sliding]
            groups.append((error, slopes, self._force_sigmas[b], settings.independent_forces))
        K, P = len(error), slopes.shape[-1]
        jacobians, residuals, costs = [], [], np.zeros(K)
        for error, slopes, sigma, independent in groups:
            share = min(1.0, independent / error.shape[1])
            weight, cost = self._robust(np.linalg.norm(error, axis=-1) / sigma)
            root = np.sqrt(share * weight) / sigma
            jacobians.append((slopes * root[..., None, None]).reshape(K, -1, P))
            residuals.append((error * root[..., None]).reshape(K, -1))
            costs += share * cost.sum(axis=1)
        return np.concatenate(jacobians, axis=1), np.concatenate(residuals, axis=1), costs

    def _robust(self, scaled: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Huber's weight and cost of residual norms in standard deviations."""
        limit = self.settings.huber
        beyond = scaled > limit
        weight = np.where(beyond, limit / np.maximum(scaled, 1e-300), 1.0)
        return weight, np.where(beyond, limit * (scaled - 0.5 * limit), 0.5 * scaled**2)


def slopes_at_centroid(slopes: FloatArray, arm: FloatArray, radius: float) -> FloatArray:
    """(K, S, 3, P) derivatives of (x, y, ρ θ) of the cells' centroid, from those of the object frame's pose.

    Args:
        slopes: (K, S, 3, P) of x, y, θ.
        arm: (K, S, 2) from the frame's origin to the centroid, world, m.
        radius: ρ, m.
    """
    result = slopes.copy()
    result[:, :, 0] -= arm[..., 1:] * result[:, :, 2]
    result[:, :, 1] += arm[..., :1] * result[:, :, 2]
    result[:, :, 2] *= radius
    return result
