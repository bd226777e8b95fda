"""A recorded push as equal time steps and velocities between them: what Algorithm 1 learns from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.measurements import Trial, finger_path, pose_times
from models.measurements.smoothing import smooth_track
from models.physics.cell_grid import FloatArray
from models.physics.rollout import Push

STEPS = 20
"""Time steps a recorded push is cut into. In shorter ones the object moves less than trackers err."""


@dataclass(frozen=True, eq=False)
class ObservedPush:
    """A recorded push at T + 1 times, dt apart.

    Attributes:
        dt: s.
        poses: (T + 1, 3) x^g, world pose of the object, m and unwrapped rad; T >= 2.
        tip: (T + 1, 2) finger centre, world, m; NaN where there is no finger.

    Raises:
        ValueError: shapes that do not fit, fewer than three poses, poses not finite, dt not positive.
    """

    dt: float
    poses: FloatArray
    tip: FloatArray

    def __post_init__(self) -> None:
        poses, tip = np.asarray(self.poses, dtype=float), np.asarray(self.tip, dtype=float)
        if not (np.isfinite(self.dt) and self.dt > 0):
            raise ValueError(f"observed push: dt must be positive, got {self.dt} s")
        if poses.ndim != 2 or poses.shape[1] != 3 or len(poses) < 3 or not np.isfinite(poses).all():
            raise ValueError(f"observed push: needs finite poses (T + 1, 3), T >= 2, got shape {poses.shape}")
        if tip.shape != (len(poses), 2):
            raise ValueError(f"observed push: tip must have shape ({len(poses)}, 2), got {tip.shape}")
        object.__setattr__(self, "poses", poses)
        object.__setattr__(self, "tip", tip)

    @property
    def twists(self) -> FloatArray:
        """(T, 3) ẋ^g_t in the object frame: the constant twist that moves pose t to pose t + 1 in dt."""
        half = 0.5 * np.diff(self.poses[:, 2])
        dx, dy = np.diff(self.poses[:, :2], axis=0).T / np.sinc(half / np.pi)
        c, s = np.cos(self.poses[:-1, 2] + half), np.sin(self.poses[:-1, 2] + half)
        return np.stack([c * dx + s * dy, c * dy - s * dx, 2.0 * half], axis=-1) / self.dt

    def transitions(self) -> list[Push]:
        """T - 1 single steps: number t starts in the observed (x_{t+1}, ẋ_t) and predicts x_{t+2}."""
        return [
            Push(self.dt, self.tip[t + 1 : t + 3], self.poses[t + 1], twist)
            for t, twist in enumerate(self.twists[:-1])
        ]


def observe_steps(trial: Trial) -> ObservedPush:
    """A trial of three poses or more at equal times, linear between rows, the finger's track smoothed."""
    times = pose_times(trial)
    steps = min(STEPS, len(times) - 1)
    ends = np.linspace(0.0, times[-1], steps + 1)
    track_times, track = smooth_track(*finger_path(trial))
    tip = np.column_stack([np.interp(ends, track_times, column) for column in track.T])
    if not trial.has_finger:
        tip[:] = np.nan
    return ObservedPush(float(times[-1]) / steps, trial.object_pose.at(trial.start + ends), tip)
