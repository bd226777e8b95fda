"""Residuals and Jacobians of whole pushes, whitened by an error model; and the cost that fits minimise.

It has the same face as `slipmap.models.inference.likelihood.Likelihood`, so that `gauss_newton.fit` serves both.
There each pose counts by itself, and little; here their correlation is spelled out, and all count.

A pose is off by the sensor's noise, fresh in each row, and by what the best model of its kind does not know:
its speed is wrong by a share α of the way travelled, by an error that lasts a stretch ℓ of way,

    cov(e(T), e(T')) = α² ∫₀^T ∫₀^T' exp(-|a - b| / ℓ) da db.

The force is off by the sensor's noise and by a share β of the push's typical force that lasts a time. Rows
of a push are thus one story; different pushes are independent. That is what the scores count.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from slipmap.models.geometry import radius_of_gyration
from slipmap.models.inference.likelihood import NormalEquations
from slipmap.models.inference.observations import AVERAGED, DENSE, SAMPLES, Observation
from slipmap.models.inference.prior import MapPrior
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Push, Rollouts

# How the residuals of one push hang together if the model is right: noise of each row, and errors that
# last.


MEMORY = 0.03
"""ℓ, m of way travelled by the cells."""

FORCE_MEMORY = 0.3
"""s that an error of the force lasts."""


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of one row of a sensor, m, rad, N.

    Attributes:
        position: of x and y each.
        angle: of θ.
        force: of each component of the force.
        declared: whether the dataset says so; else they were estimated from the scatter of neighbouring rows.
    """

    position: float
    angle: float
    force: float
    declared: bool


@dataclass(frozen=True)
class ErrorModel:
    """Sensor noise, and what the best model of its kind is off by.

    Attributes:
        noise: of the sensors.
        motion: α.
        force: β.
    """

    noise: SensorNoise
    motion: float
    force: float

    def pose_covariance(self, observation: Observation, travel: FloatArray, radius: float) -> FloatArray:
        """(3, S, S) of x, y and ρ θ of one push, which are independent of each other.

        Args:
            observation: the push.
            travel: (S,) way travelled by the cells up to each pose, m, ascending.
            radius: that angles are multiplied by, m.
        """
        n = self.noise
        lasting = self.motion**2 * _accumulated(travel)
        rows = [
            np.diag(sigma**2 / observation.pose_rows) for sigma in (n.position, n.position, radius * n.angle)
        ]
        return lasting + np.array(rows)

    def force_covariance(self, observation: Observation) -> FloatArray:
        """(T, T) of a component of the forces of one push that count."""
        times = np.asarray(observation.push.force_times)[observation.sliding]
        if len(times) == 0:
            return np.zeros((0, 0))
        typical = float(np.median(np.hypot(*observation.forces[observation.sliding].T)))
        fresh = self.noise.force**2 / observation.force_rows[observation.sliding]
        apart = np.abs(times[:, None] - times[None])
        return (self.force * typical) ** 2 * np.exp(-apart / FORCE_MEMORY) + np.diag(fresh)


def _accumulated(travel: FloatArray) -> FloatArray:
    """(S, S) double integral of exp(-|a - b|/ℓ) over [0, T] × [0, T'], in closed form, m²."""
    low = np.minimum(travel[:, None], travel[None])
    end = np.exp(-travel / MEMORY)
    gap = np.exp(-np.abs(travel[:, None] - travel[None]) / MEMORY)
    return MEMORY * (2.0 * low - MEMORY * (1.0 - end[:, None] - end[None] + gap))


def travelled(observation: Observation, centers: FloatArray) -> FloatArray:
    """(S,) way of the cells along the measured poses, m; from pose to pose, hence ascending."""
    from slipmap.models.physics.paper_notation import add

    poses = np.concatenate([observation.push.start_pose[None], observation.poses])
    return np.cumsum(add(poses[1:], poses[:-1], centers))


def sensor_noise(dataset: PushDataset) -> SensorNoise:
    """Noise of the rows of poses and forces: as declared, else from the scatter of neighbouring rows.

    The second difference of white noise has six times its variance; the median over rows leaves real
    acceleration out.
    """
    declared = dataset.noise
    position, angle, force = declared.position, declared.angle, declared.force
    dense = [trial for trial in dataset.trials if len(trial.object_pose.time) > DENSE]
    if position is None or angle is None:
        found = (
            np.array([_scatter(trial.object_pose.values) for trial in dense]) if dense else np.zeros((1, 3))
        )
        typical = np.median(found, axis=0)
        # A sensor that repeats rows seems to have no noise at all.
        position = max(float(np.hypot(typical[0], typical[1])) / np.sqrt(2.0), 1e-4)
        angle = max(float(typical[2]), 1e-3)
    rows = [
        trial.ft_wrench
        for trial in dataset.trials
        if trial.ft_wrench is not None and len(trial.ft_wrench.time) > 5
    ]
    if force is None:
        scatter = [_scatter(channel.values[:, :2]).mean() for channel in rows]
        force = max(float(np.median(scatter)), 0.02) if scatter else 0.1
    known = declared.position is not None and declared.angle is not None
    return SensorNoise(position, angle, force, known)


def _scatter(values: FloatArray) -> FloatArray:
    """Standard deviation of white noise in each column, from the median of second differences."""
    second = values[2:] - 2.0 * values[1:-1] + values[:-2]
    smooth = uniform_filter1d(second, 5, axis=0)
    return np.median(np.abs(second - smooth), axis=0) / 0.6745 / np.sqrt(6.0 * 0.8)


# What fits of all models to the same pushes share: which forces count, and the whitening of residuals.


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
        """Whiten columns of residuals or derivatives: pose (S, 3, c) and force (T, 2, c) to (3 S + 2 T,
        c)."""
        parts = [self.pose[i] @ pose[:, i] for i in range(3)]
        if len(force):
            parts += [self.force @ force[:, i] for i in range(2)]
        return np.concatenate(parts)


class MeasuredPushes:
    """Pushes as models are fitted to them.

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
        noise = error.noise
        poses = self._once(
            ("pose", noise, error.motion),
            lambda b: error.pose_covariance(self.observations[b], self._travel[b], self.radius),
        )
        forces = self._once(
            ("force", noise, error.force), lambda b: error.force_covariance(self.observations[b])[None]
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
