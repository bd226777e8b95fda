"""Error model of the residuals of one push: independent noise in each row, plus correlated model error.

A pose carries sensor noise, independent between poses that are compared, and the error of the best model of
its kind: its rate, per metre travelled, has standard deviation α and correlation length ℓ,

    cov(e(T), e(T')) = α² ∫₀^T ∫₀^T' exp(-|a - b| / ℓ) da db.

A force carries sensor noise and an error of a share β of the push's typical force, correlated over a time.
Rows of a push are thus correlated; different pushes are independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from slipmap.models.inference.observations import Observation
from slipmap.models.measurements import PushDataset
from slipmap.models.measurements.lasting_noise import NONE_LASTS, Lasting, noise_of_poses
from slipmap.models.measurements.motion import white_noise
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.paper_notation import add

MEMORY = 0.03
"""ℓ, m travelled by the cells."""

FORCE_MEMORY = 0.3
"""Correlation time of the force error, s."""

_CORNER = 2.5
"""How many times farther off than elsewhere an outline is at a corner."""


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of one row of a sensor, m, rad, N."""

    position: float  # of x and y each
    angle: float  # of θ
    force: float  # of each component of the force
    # whether the dataset declares it; otherwise it was estimated from the scatter of neighbouring rows
    declared: bool
    # whether no push has enough poses for an estimate either, so that the poses' noise is the least possible
    assumed: bool = False
    outline: float = 0.0  # of the outline where a finger touches it, m
    # how much of the poses' noise lasts from row to row; nothing where it is declared
    lasting_position: Lasting = NONE_LASTS
    lasting_angle: Lasting = NONE_LASTS

    @property
    def of_poses(self) -> FloatArray:
        """(3,) of x, y and θ."""
        return np.array([self.position, self.position, self.angle])

    def of_means(self, rows: ArrayLike) -> FloatArray:
        """(…, 3) of x, y and θ of means of so many consecutive rows (…)."""
        position, angle = self.lasting_position.independent(rows), self.lasting_angle.independent(rows)
        return self.of_poses / np.sqrt(np.stack([position, position, angle], axis=-1))


@dataclass(frozen=True)
class ErrorModel:
    """Sensor noise, and the error of the best model of its kind."""

    noise: SensorNoise  # of the sensors
    motion: float  # α
    force: float  # β

    def pose_covariance(self, observation: Observation, travel: FloatArray, radius: float) -> FloatArray:
        """Covariances (3, S, S) of x, y and ρ θ of one push, which are mutually independent.

        Args:
            travel: (S,) distance travelled by the cells up to each pose, m, ascending.
            radius: ρ, by which angles are multiplied, m.
        """
        lasting = self.motion**2 * _accumulated(travel)
        rows = (self.noise.of_means(observation.pose_rows) * [1.0, 1.0, radius]) ** 2
        return lasting + np.array([np.diag(one) for one in rows.T])

    def force_covariance(self, observation: Observation) -> FloatArray:
        """Covariance (T, T) of one component of the forces of a push that count."""
        times = np.asarray(observation.push.force_times)[observation.sliding]
        if len(times) == 0:
            return np.zeros((0, 0))
        fresh = self.noise.force**2 / observation.force_rows[observation.sliding]
        apart = np.abs(times[:, None] - times[None])
        lasting = (self.force * observation.typical_force) ** 2 * np.exp(-apart / FORCE_MEMORY)
        return lasting + np.diag(fresh)


def _accumulated(travel: FloatArray) -> FloatArray:
    """(S, S) double integral of exp(-|a - b|/ℓ) over [0, T] × [0, T'], in closed form, m²."""
    low = np.minimum(travel[:, None], travel[None])
    end = np.exp(-travel / MEMORY)
    gap = np.exp(-np.abs(travel[:, None] - travel[None]) / MEMORY)
    return MEMORY * (2.0 * low - MEMORY * (1.0 - end[:, None] - end[None] + gap))


def outline_errors(count: int) -> FloatArray:
    """(count, 2) equally likely errors of an outline, evenly around, with unit variances of x and y.

    One in five is `_CORNER` times as far: seen outlines are off the most at corners.
    """
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    far = np.where(np.arange(count) % 5 == 2, _CORNER, 1.0)
    radius = far * np.sqrt(2.0 / np.mean(far**2))
    return radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def travelled(observation: Observation, centers: FloatArray) -> FloatArray:
    """(S,) distance travelled by the cells along the measured poses, m, summed from pose to pose."""
    poses = np.concatenate([observation.push.start_pose[None], observation.poses])
    return np.cumsum(add(poses[1:], poses[:-1], centers))


def sensor_noise(dataset: PushDataset) -> SensorNoise:
    """Noise of pose and force rows: as declared, otherwise from the scatter of neighbouring rows, their
    rounding, and the scatter of poses while the object rests."""
    declared, poses = dataset.noise, noise_of_poses(dataset, dataset.trials)
    force = declared.force
    if force is None:
        wrenches = [trial.ft_wrench for trial in dataset.trials if trial.ft_wrench is not None]
        found = [white_noise(channel.values[:, :2]).mean() for channel in wrenches if len(channel.time) > 5]
        force = max(float(np.median(found)), 0.02) if found else 0.1
    known = declared.position is not None and declared.angle is not None
    return SensorNoise(
        poses.position,
        poses.angle,
        force,
        known,
        poses.assumed,
        declared.outline or 0.0,
        poses.lasting_position,
        poses.lasting_angle,
    )
