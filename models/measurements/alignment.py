"""Channels of one trial on one clock: time zero is the first object pose.

Nothing is extrapolated and no row is moved: sensors keep their own stamps, only counted from another zero.
"""

from __future__ import annotations

import numpy as np

from models.measurements.push_dataset import Trial
from models.physics.cell_grid import FloatArray


def pose_times(trial: Trial) -> FloatArray:
    """(T,) times of the object poses after the first of them, s; compare a prediction there."""
    return trial.object_pose.time - trial.start


def finger_path(trial: Trial) -> tuple[FloatArray, FloatArray]:
    """The finger's track over exactly the time span of the object poses.

    The finger keeps its own time stamps inside the span. At the span's two ends a row is added, linear
    between neighbouring rows. Where the track begins late or ends early, the finger is held at its first or
    last position; it is never extrapolated.

    Returns:
        Times (k,) after the first pose, strictly increasing from 0 to that of the last pose, s, and positions
        (k, 2) in the world frame, m.
    """
    end = pose_times(trial)[-1]
    own = trial.tip_pose.time - trial.start
    time = np.unique(np.concatenate([[0.0], own[(own > 0.0) & (own < end)], [end]]))
    return time, trial.tip_pose.at(trial.start + time)


def wrench_samples(trial: Trial) -> tuple[FloatArray, FloatArray] | None:
    """Force rows within the time span of the object poses, on their own time stamps.

    Returns:
        Times (k,) after the first pose, s, and wrenches (k, 3) of the finger on the object, N and N·m, world
        frame; None where force was not measured. k is 0 where no row falls into the span.
    """
    if trial.ft_wrench is None:
        return None
    time = trial.ft_wrench.time - trial.start
    inside = (time >= 0.0) & (time <= pose_times(trial)[-1])
    return time[inside], trial.ft_wrench.values[inside]
