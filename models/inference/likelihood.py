"""The forgiving likelihood: the cost of measured pushes under a model, and its derivatives.

Poses are compared at the cells' centroid as (dx, dy, ρ dθ), where ρ is the cells' radius of gyration, so that
the norm is close to ADD. Even the best model misses a measured push by sensor noise and by a model error that
grows with the distance travelled:

    σ² = σ_noise² + σ_0² + (α travel)²

Residuals along a push are correlated, so a push counts as a few independent poses, however densely it was
sampled. Huber's cost keeps a push that the model cannot explain from deciding everything. The start pose of
each push is known only as well as the tracker sees it; its offset is solved for together with the maps and
eliminated from their equations (Schur complement).

An outline that is off by t where the finger touches it acts as if the object started elsewhere and its poses
were measured from there. So the offset is a = s - t, where s is the tracker's error of the start. Predicted
poses are moved back by the expected t,

    E(t | a) = -κ a,    κ = σ_t² / (σ_s² + σ_t²).

The rest of t, whose standard deviation is below σ_s, is neglected, as is that t turns with the object.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from slipmap.models.geometry import radius_of_gyration, rotated
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.prior import MapPrior
from slipmap.models.measurements import Noise
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps, Push, Rollouts

_JACOBIANS = 2**28
"""Most bytes for the Jacobians of pushes rolled out together."""

_ALIKE = 2**22
"""The same for pushes whose residuals are weighted together; what the cache holds is fastest."""


_MANY_COLUMNS = 2.0
"""From this ratio of a rollout's columns to coordinates on, derivatives are converted to coordinates."""


@contextmanager
def overflowing() -> Iterator[None]:
    """Where what a user's formula gives may overflow; the result is checked."""
    with np.errstate(over="ignore", invalid="ignore"):
        yield


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
    start_gain: FloatArray  # (B, K, 3, 3) inverse Hessian of each push's start offset
    start_gradient: FloatArray  # (B, K, 3)
    coupling: FloatArray  # (B, K, d, 3) Hessian block of maps and start
    push_gradient: FloatArray | None = None  # (B, K, d) of each push, unweighted, where asked for

    @property
    def finite(self) -> NDArray[np.bool_]:
        """(K,) whether nothing overflowed, as derivatives of a user's formula may."""
        parts = self.hessian, self.gradient[:, None], self.cost[:, None]
        return np.array([all(np.isfinite(part[k]).all() for part in parts) for k in range(len(self.cost))])


class PushCosts(Protocol):
    """Interface of B pushes to a fit."""

    observations: Sequence[Observation]
    start_sigma: FloatArray  # (B, 3) standard deviations of start offsets, m and rad

    def linearise(
        self, z: FloatArray, offsets: FloatArray, strength: FloatArray, weights: FloatArray
    ) -> NormalEquations:
        """Costs and normal equations, see `PushLikelihood.linearise`."""


class DrawnErrors(NamedTuple):
    """Errors of the measurements of B pushes that each of K hypotheses assumes, in standard deviations."""

    poses: FloatArray  # (K, B, n, 3) of (x, y, ρ θ) at the cells' centroid, over n stretches of each push
    forces: FloatArray  # (K, B, 2) of all forces of a push

    def of(self, hypotheses: NDArray[np.int64]) -> DrawnErrors:
        """Those of some hypotheses."""
        return DrawnErrors(self.poses[hypotheses], self.forces[hypotheses])

    def times(self, factor: float) -> DrawnErrors:
        """The same, larger by a factor."""
        return DrawnErrors(factor * self.poses, factor * self.forces)

    def of_poses(self, pushes: NDArray[np.int64], rows: int) -> FloatArray:
        """(K, G, S, 3) errors of pushes (G,) with S poses each; fewer than n have one error each."""
        count = self.poses.shape[2]
        stretch = np.arange(rows) * count // max(rows, count)
        return self.poses[:, pushes][:, :, stretch]


class Alike(NamedTuple):
    """Rollouts of G pushes with equally many poses S, and their derivatives by p columns."""

    pushes: NDArray[np.int64]  # (G,) which of the B pushes these are
    poses: FloatArray  # (K, G, S, 3)
    forces: FloatArray  # (K, G, T, 2), zero after a push's own; T is the number of the push with most
    d_poses: FloatArray  # (K, G, S, 3, p)
    d_forces: FloatArray  # (K, G, T, 2, p)


class PushLikelihood(ABC):
    """Costs of K hypotheses on B observed pushes, for any model of the residuals.

    Args:
        prior: coordinates of the maps.
        observations: B pushes.
        pushes: the rollouts to make of them, with the times at which a residual is needed.
        tracker_sigma: (B, 3) standard deviations of the starts as the tracker sees them, m and rad.
        outline: the same of the outline where the finger touches it, m.
    """

    def __init__(
        self,
        prior: MapPrior,
        observations: Sequence[Observation],
        pushes: Sequence[Push],
        tracker_sigma: FloatArray,
        outline: float,
    ) -> None:
        self.prior = prior
        self.observations: Sequence[Observation] = list(observations)
        self.tracker_sigma, self.outline = tracker_sigma, outline
        self.start_sigma = np.hypot(tracker_sigma, [outline, outline, 0.0])
        self._of_outline = (outline / self.start_sigma[:, 0]) ** 2
        grid = prior.slider.grid
        self._centroid, self._radius = grid.centers.mean(axis=0), radius_of_gyration(grid)
        self._pushes = list(pushes)
        self._starts = np.array([push.start_pose for push in pushes])
        self._twists = np.array([push.start_twist for push in pushes])
        poses = np.array([len(observation.poses) for observation in self.observations], dtype=np.int64)
        forces = np.array([len(push.force_times) for push in self._pushes], dtype=np.int64)
        self._order = np.lexsort((forces, poses))
        # In that order: which pushes have equally many poses, and how many rows of derivatives each has.
        self._kind = poses[self._order]
        self._rows = (3 * poses + 2 * forces)[self._order]

    @overflowing()
    def linearise(
        self,
        z: FloatArray,
        offsets: FloatArray,
        strength: FloatArray,
        weights: FloatArray,
        *,
        by_push: bool = False,
        errors: DrawnErrors | None = None,
    ) -> NormalEquations:
        """Costs and normal equations at coordinates z (K, d) and start offsets (K, B, 3).

        Args:
            z: coordinates of the prior.
            offsets: start offsets, m and rad.
            strength: (K,) see `MapPrior.maps`.
            weights: (K, B) weight of each push in the equations of each hypothesis; 0 leaves it out.
            by_push: whether the gradient of each push is wanted too.
            errors: to be subtracted from the measurements, where a hypothesis assumes some.
        """
        prior = self.prior
        K, d, B = len(z), prior.size, len(self.observations)
        maps = prior.maps(z, strength)
        scaled_offsets = offsets / self.start_sigma
        cost = 0.5 * (scaled_offsets**2).sum(axis=-1)
        # Normal equations in the rollout's own columns, unless these are many more than the coordinates;
        # pushes that stay away from the table's rim have only the first columns.
        columns, start = prior.columns(maps, strength), prior.start_columns
        convert = columns.shape[1] > _MANY_COLUMNS * d
        rolled_out = self._rolled_out(maps, offsets, columns, convert=convert)
        if convert:
            columns, start = np.eye(d + 3, d)[None], slice(d, d + 3)
        by_column = columns.transpose(0, 2, 1)
        P = columns.shape[1]
        reduced_hessian, reduced_gradient = np.zeros((K, P, P)), np.zeros((K, P))
        gains, start_gradients = np.empty((B, K, 3, 3)), np.empty((B, K, 3))
        couplings = np.empty((B, K, d, 3))
        push_gradients = np.empty((B, K, d)) if by_push else None
        for alike in rolled_out:
            own = alike.pushes
            J, r, own_cost = self._whitened(alike, errors)
            G, p = len(own), J.shape[-1]
            cost[:, own] += own_cost
            transposed = J.swapaxes(-1, -2)
            coupling = transposed @ J[..., start]
            slope = (transposed @ r[..., None])[..., 0]
            precision = self.start_sigma[own, :, None] ** -2.0 * np.eye(3)
            gain = np.linalg.inv(coupling[..., start, :] + precision)
            start_gradient = slope[..., start] + scaled_offsets[:, own] / self.start_sigma[own]
            w = weights[:, own]
            # Sums over the pushes are products of matrices with the rows, or columns, of all of them.
            rows = (J if (w == 1.0).all() else np.sqrt(w)[..., None, None] * J).reshape(K, -1, p)
            eliminated = w[..., None, None] * (coupling @ gain)
            beside = coupling.transpose(0, 2, 1, 3).reshape(K, p, 3 * G)
            reduced_hessian[:, :p, :p] += rows.transpose(0, 2, 1) @ rows
            reduced_hessian[:, :p, :p] -= eliminated.transpose(0, 2, 1, 3).reshape(K, p, 3 * G) @ (
                beside.transpose(0, 2, 1)
            )
            own_gradient = slope - (coupling @ gain @ start_gradient[..., None])[..., 0]
            reduced_gradient[:, :p] += (w[..., None] * own_gradient).sum(axis=1)
            if push_gradients is not None:
                push_gradients[own] = (own_gradient @ columns[:, :p]).swapaxes(0, 1)
            gains[own], start_gradients[own] = gain.swapaxes(0, 1), start_gradient.swapaxes(0, 1)
            by_start = (by_column[..., :p] @ beside).reshape(K, d, G, 3)
            couplings[own] = by_start.transpose(2, 0, 1, 3)
        hessian = by_column @ reduced_hessian @ columns
        gradient = (by_column @ reduced_gradient[..., None])[..., 0]
        return NormalEquations(cost, hessian, gradient, gains, start_gradients, couplings, push_gradients)

    def _rolled_out(
        self, maps: Maps, offsets: FloatArray, columns: FloatArray, *, convert: bool
    ) -> Iterator[Alike]:
        """All pushes from starts moved by offsets (K, B, 3), in batches whose Jacobians over P columns take
        at most about `_JACOBIANS` bytes, and of these those of one size together.

        With `convert`, derivatives are those by coordinates (d) and start (3); `columns` (K, P, d) are those
        of the prior. Refits and folds set out from one fit: hypotheses that agree are rolled out once.
        """
        K = len(maps)
        if _agree(maps, offsets):
            maps = maps[:1]
        size = 8 * K * columns.shape[1] * self._rows
        for part in _cut(np.cumsum(size) // _JACOBIANS):
            own = self._order[part]
            rollouts = self.prior.slider.rollout(
                maps,
                [self._pushes[b] for b in own],
                sensitivities=True,
                start_poses=self._starts[own] + offsets[: len(maps), own],
                start_twists=np.broadcast_to(self._twists[own], (len(maps), len(own), 3)),
            )
            self._move_back(rollouts, own, offsets[: len(maps), own])
            reached = np.asarray(rollouts.reached.any(axis=0))
            for alike in _cut(self._kind[part], reached, np.cumsum(size[part]) // _ALIKE):
                used = slice(None) if reached[alike.start] else slice(self.prior.slider.columns)
                yield self._alike(own, alike, rollouts, used, columns, convert=convert)

    def _move_back(self, rollouts: Rollouts, pushes: NDArray[np.int64], offsets: FloatArray) -> None:
        """Move poses back by the share of the start offsets (K, n, 3) that is due to the outline."""
        if self.outline == 0.0:
            return
        rows = np.diff(rollouts.pose_at)
        share, start = np.repeat(self._of_outline[pushes], rows), self.prior.start_columns.start
        rollouts.poses[..., :2] -= share[:, None] * np.repeat(offsets[..., :2], rows, axis=1)
        for i in range(2):
            rollouts.d_poses[:, :, i, start + i] -= share

    def _alike(
        self,
        pushes: NDArray[np.int64],
        alike: slice,
        rollouts: Rollouts,
        used: slice,
        columns: FloatArray,
        *,
        convert: bool,
    ) -> Alike:
        """Some of the rolled-out pushes, with the used columns of the derivatives, or these converted."""
        own, G = pushes[alike], alike.stop - alike.start
        poses = slice(rollouts.pose_at[alike.start], rollouts.pose_at[alike.stop])
        ends = rollouts.force_at[alike.start : alike.stop + 1].tolist()

        def spread(rows: FloatArray) -> FloatArray:
            """The rows of each hypothesis, from those of each or of all."""
            return np.broadcast_to(rows, (len(columns), *rows.shape[1:]))

        def slopes(rows: FloatArray) -> FloatArray:
            return self.prior.converted(spread(rows), columns) if convert else spread(rows)

        def side_by_side(rows: FloatArray) -> FloatArray:
            """(K, G, T, …) forces from those of all pushes (K, Σ, …)."""
            if ends[0] == ends[-1]:
                return np.zeros((len(rows), G, 0, *rows.shape[2:]))
            each = [rows[:, i:j] for i, j in pairwise(ends)]
            result = np.zeros((len(rows), G, max(one.shape[1] for one in each), *rows.shape[2:]))
            for place, one in enumerate(each):
                result[:, place, : one.shape[1]] = one
            return result

        return Alike(
            own,
            spread(_split(rollouts.poses[:, poses], G)),
            spread(side_by_side(rollouts.forces)),
            slopes(_split(rollouts.d_poses[:, poses, :, used], G)),
            slopes(side_by_side(rollouts.d_forces[..., used])),
        )

    def _pose_errors(self, alike: Alike) -> tuple[FloatArray, FloatArray]:
        """Predicted minus measured (x, y, ρ θ) of the cells' centroid (K, G, S, 3), m, and derivatives
        (K, G, S, 3, p) with respect to the rollout's own columns."""
        measured = np.stack([self.observations[b].poses for b in alike.pushes])
        predicted = alike.poses
        arm = rotated(self._centroid, predicted[..., 2])
        here, there = predicted[..., :2] + arm, measured[..., :2] + rotated(self._centroid, measured[..., 2])
        turn = self._radius * (predicted[..., 2:] - measured[..., 2:])
        slopes = slopes_at_centroid(alike.d_poses, arm, self._radius)
        return np.concatenate([here - there, turn], axis=-1), slopes

    def _force_errors(self, alike: Alike) -> FloatArray:
        """Mean forces that count, predicted minus measured (K, G, T, 2), N."""
        seen = [self.observations[b] for b in alike.pushes]
        measured = [observation.forces[observation.sliding] for observation in seen]
        return alike.forces - stacked(measured, alike.forces.shape[2])

    @abstractmethod
    def _whitened(
        self, alike: Alike, errors: DrawnErrors | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Jacobians (K, G, R, p) and residuals (K, G, R) of some pushes, in standard deviations and with the
        weights of a robust cost, and that cost (K, G)."""


def _cut(*labels: NDArray[Any]) -> Iterator[slice]:
    """Runs of entries whose labels, arrays (n,), are all equal."""
    changes = np.any([label[1:] != label[:-1] for label in labels], axis=0)
    ends = [0, *(np.flatnonzero(changes) + 1).tolist(), len(labels[0])]
    return (slice(first, last) for first, last in pairwise(ends))


def _agree(maps: Maps, offsets: FloatArray) -> bool:
    """Whether all of several hypotheses have the same maps, up to rounding, and start offsets (K, B, 3)."""
    parts = maps.mass, maps.mu, maps.mu_finger, maps.effects
    same = all((np.abs(part - part[:1]) <= 1e-12 * np.abs(part[:1])).all() for part in parts)
    return same and len(offsets) > 1 and bool((offsets == offsets[:1]).all())


def _split(rows: FloatArray, count: int) -> FloatArray:
    """(K, G, S, …) rows of `count` pushes with equally many, from (K, G S, …)."""
    return rows.reshape(len(rows), count, -1, *rows.shape[2:])


def stacked(arrays: Sequence[FloatArray], length: int) -> FloatArray:
    """(G, length, …) arrays (T_g, …), with zeros after the rows of the shorter ones."""
    result = np.zeros((len(arrays), length, *arrays[0].shape[1:]), arrays[0].dtype)
    for place, one in enumerate(arrays):
        result[place, : len(one)] = one
    return result


class Likelihood(PushLikelihood):
    """The forgiving likelihood.

    Args:
        prior: coordinates of the maps.
        observations: B pushes.
        noise: of the sensors, where declared.
    """

    def __init__(
        self, prior: MapPrior, observations: Sequence[Observation], noise: Noise, settings: LikelihoodSettings
    ) -> None:
        start = np.array([settings.start_position, settings.start_position, settings.start_angle])
        if noise.position is not None and noise.angle is not None:
            # With many rows the start is a mean of several and known better than a single row.
            single = any(len(observation.poses) == 1 for observation in observations)
            start = (1.0 if single else 0.4) * np.array([noise.position, noise.position, noise.angle])
        pushes = [observation.counted for observation in observations]
        super().__init__(prior, observations, pushes, np.tile(start, (len(pushes), 1)), noise.outline or 0.0)
        self.settings = settings
        self._sigmas = [self._pose_sigma(observation, noise) for observation in self.observations]
        self._force_sigmas = np.array([self._force_sigma(one, noise) for one in self.observations])

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

    @property
    def degrees(self) -> float:
        """Number of independent residuals of them: three of each pose, two of each force."""
        counted = np.array([self._counted(observation) for observation in self.observations])
        return float((counted @ [3.0, 2.0]).sum())

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

    def _whitened(
        self, alike: Alike, errors: DrawnErrors | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        settings, seen = self.settings, [self.observations[b] for b in alike.pushes]
        error, slopes = self._pose_errors(alike)
        K, G, S, _, p = slopes.shape
        sigma = np.stack([self._sigmas[b] for b in alike.pushes])
        if errors is not None:
            error = error + sigma[..., None] * errors.of_poses(alike.pushes, S)
        share = np.full((G, 1), min(1.0, settings.independent / S))
        groups = [(error, slopes, sigma, share)]
        T = alike.forces.shape[2]
        if T:
            count = np.array([observation.sliding.sum() for observation in seen])
            sigma = self._force_sigmas[alike.pushes][:, None]
            share = np.minimum(1.0, settings.independent_forces / np.maximum(count, 1))
            share = (np.arange(T) < count[:, None]) * share[:, None]
            error = self._force_errors(alike)
            if errors is not None:
                finite = np.where(share > 0.0, sigma, 0.0)
                error = error + finite[..., None] * errors.forces[:, alike.pushes, None]
            groups.append((error, alike.d_forces, sigma, share))
        jacobians, residuals, costs = [], [], np.zeros((K, G))
        for error, slopes, sigma, share in groups:
            scaled = np.linalg.norm(error, axis=-1) / sigma
            weight, cost = huber(scaled, scaled**2, settings.huber)
            root = np.sqrt(share * weight) / sigma
            jacobians.append((slopes * root[..., None, None]).reshape(K, G, -1, p))
            residuals.append((error * root[..., None]).reshape(K, G, -1))
            costs += (share * cost).sum(axis=-1)
        return np.concatenate(jacobians, axis=2), np.concatenate(residuals, axis=2), costs


def huber(norm: FloatArray, square: FloatArray, limit: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Huber's weights and costs (…) of residuals, from their norms (…) in standard deviations and the squares
    of these; beyond the limit, residuals count linearly."""
    beyond = norm > limit
    weight = np.where(beyond, limit / np.maximum(norm, 1e-300), 1.0)
    return weight, np.where(beyond, limit * (norm - 0.5 * limit), 0.5 * square)


def slopes_at_centroid(slopes: FloatArray, arm: FloatArray, radius: float) -> FloatArray:
    """(…, 3, P) derivatives of (x, y, ρ θ) of the cells' centroid, from those of the object frame's pose.

    Args:
        slopes: (…, 3, P) of x, y, θ.
        arm: (…, 2) from the frame's origin to the centroid, world, m.
        radius: ρ, m.
    """
    result = slopes.copy()
    result[..., 0, :] -= arm[..., 1:] * result[..., 2, :]
    result[..., 1, :] += arm[..., :1] * result[..., 2, :]
    result[..., 2, :] *= radius
    return result
