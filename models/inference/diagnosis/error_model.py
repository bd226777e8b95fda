"""How the residuals of one push hang together if the model is right: noise of each row, and errors that last.

A pose is off by the sensor's noise, fresh in each row, and by what the best model of its kind does not know:
its speed is wrong by a share α of the way travelled, by an error that lasts a stretch ℓ of way,

    cov(e(T), e(T')) = α² ∫₀^T ∫₀^T' exp(-|a - b| / ℓ) da db.

The force is off by the sensor's noise and by a share β of the push's typical force that lasts a time. Rows
of a push are thus one story; different pushes are independent. That is what the scores count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from models.inference.observations import DENSE, Observation
from models.measurements import PushDataset
from models.physics.cell_grid import FloatArray

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
    from models.physics.paper_notation import add

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
