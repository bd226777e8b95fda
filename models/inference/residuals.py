"""What a prediction leaves unexplained, as a rate: the residual velocity and the residual force.

The residual is measured minus predicted. A pose that is off stays off, so its residual says little of the
moment; the rate at which it grows says when and where the model fails. It is taken from the increments of
the residual between every second sample (about a fifteenth of a push), where the object moves. Increments
telescope: summed over a push, the sensor's noise enters once and not with every sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.inference.centroid import at_centroid, radius_of_gyration
from models.inference.observations import SAMPLES, Observation
from models.inference.predicted_motion import PredictedMotion
from models.inference.push_conditions import Conditions, conditions
from models.physics.cell_grid import CellGrid, FloatArray

STRIDE = 2
"""Samples from one increment to the next."""

LEAST_WAY = 3e-4
"""An interval counts where the object moves farther, as measured or as predicted, m…"""

LEAST_SHARE = 0.1
"""…and farther than this share of the push's fastest interval."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residual velocities or forces of N pieces of pushes.

    Attributes:
        at: conditions of the pieces.
        values: (N, 3) residual velocity in the world, m/s, the turning times the cells' radius of gyration;
            or (N, 2) residual force on the object in the world, N.
        weights: (N,) duration of a piece, s; of a force 1.
        scale: (B,) what makes pushes comparable: mean speed of each push, m/s; or the typical force, N.
    """

    at: Conditions
    values: FloatArray
    weights: FloatArray
    scale: FloatArray

    @property
    def relative(self) -> FloatArray:
        """(N, 3) or (N, 2) residuals as a share of the push's speed or of the typical force."""
        return self.values / self.scale[self.at.push][:, None]


def motion_residuals(
    observations: Sequence[Observation], motions: Sequence[PredictedMotion], grid: CellGrid, radius: float
) -> Residuals | None:
    """Residual velocities of pushes, or None where nothing moves.

    Args:
        observations: B pushes.
        motions: their predictions.
        grid: cells and outline.
        radius: of the finger, m.
    """
    parts, values, weights = [], [], []
    scale = np.ones(len(observations))
    for b, (observation, motion) in enumerate(zip(observations, motions, strict=True)):
        times, measured, predicted = centroid_tracks(observation, motion.middle_poses(grid), grid)
        edges = np.unique([*range(0, len(times), STRIDE), len(times) - 1])
        steps = [np.diff(track[edges], axis=0) for track in (measured, predicted)]
        duration = np.diff(times[edges])
        way = np.maximum(*(np.linalg.norm(step, axis=1) for step in steps))
        moving = (way > max(LEAST_WAY, LEAST_SHARE * way.max())) & (duration > 0)
        if not moving.any():
            continue
        begin, end = times[edges[:-1]][moving], times[edges[1:]][moving]
        parts.append(conditions(b, observation, motion.likeliest_poses, begin, end, grid, radius))
        values.append((steps[0] - steps[1])[moving] / duration[moving, None])
        weights.append(duration[moving])
        scale[b] = way[moving].sum() / duration[moving].sum()
    if not parts:
        return None
    return Residuals(Conditions.joined(parts), np.concatenate(values), np.concatenate(weights), scale)


def force_residuals(
    observations: Sequence[Observation], motions: Sequence[PredictedMotion], grid: CellGrid, radius: float
) -> Residuals | None:
    """Residual forces where the finger presses steadily, or None where force was not measured."""
    parts, values, sizes = [], [], []
    for b, (observation, motion) in enumerate(zip(observations, motions, strict=True)):
        used = observation.sliding
        if not used.any():
            continue
        push = observation.push
        duration = push.h * (len(push.tip) - 1)
        half = 0.5 * duration / SAMPLES
        middle = push.force_times[used]
        begin, end = np.maximum(middle - half, 0.0), np.minimum(middle + half, duration)
        parts.append(conditions(b, observation, motion.likeliest_poses, begin, end, grid, radius))
        values.append((observation.forces - motion.mean_forces)[used])
        sizes.append(np.hypot(*observation.forces[used].T))
    if not parts:
        return None
    joined = np.concatenate(values)
    typical = float(np.median(np.concatenate(sizes)))
    return Residuals(
        Conditions.joined(parts), joined, np.ones(len(joined)), np.full(len(observations), typical)
    )


def centroid_tracks(
    observation: Observation, predicted: FloatArray, grid: CellGrid
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (S + 1,) from the start on, and measured and predicted (x, y, ρ θ) of the cells' centroid.

    Args:
        observation: one push.
        predicted: (S, 3) poses.
        grid: cells.
    """
    assert observation.push.pose_times is not None
    scale = np.array([1.0, 1.0, radius_of_gyration(grid)])
    start = observation.push.start_pose
    measured, told = (
        at_centroid(np.vstack([start, poses]), grid) * scale for poses in (observation.poses, predicted)
    )
    return np.concatenate([[0.0], observation.push.pose_times]), measured, told
