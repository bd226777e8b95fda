"""What fits of all models to the same pushes share: which forces count, and the whitening of residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from models.inference.centroid import radius_of_gyration
from models.inference.diagnosis.error_model import ErrorModel, SensorNoise, travelled
from models.inference.observations import SAMPLES, Observation
from models.physics.cell_grid import CellGrid, FloatArray
from models.physics.rollout import Push


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
