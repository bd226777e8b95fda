"""Residual velocity and residual force: what a prediction leaves unexplained, as a rate.

The residual is measured minus predicted. A pose that is off stays off, so its residual says little about the
moment; the rate at which it grows shows when and where the model fails. The rate is taken from increments of
the residual between every second sample (about a fifteenth of a push), where the object moves. Increments
telescope: summed over a push, sensor noise enters once and not with every sample.

Conditions come from the predicted motion and the finger's recorded path, never from the measured pose, whose
noise is also in the residual and would make the two look related.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray

from slipmap.models.geometry import at_centroid, radius_of_gyration, seen_from
from slipmap.models.inference.observations import SAMPLES, Observation
from slipmap.models.inference.prediction import Motion
from slipmap.models.measurements.motion import interpolated
from slipmap.models.physics.cell_grid import CellGrid, FloatArray


class Phase(IntEnum):
    """Phase of a push."""

    FIRST_TOUCH = 0
    STICKING = 1
    SLIDING = 2
    COASTING = 3


PHASE_NAMES = {
    Phase.FIRST_TOUCH: "first touch",
    Phase.STICKING: "pushing, contact sticks",
    Phase.SLIDING: "pushing, contact slides",
    Phase.COASTING: "coasting",
}


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions of N pieces of pushes: place, direction, speed and contact."""

    push: NDArray[np.int64]  # (N,) index of the push
    time: FloatArray  # (N,) midpoint, s after the first pose
    share: FloatArray  # (N,) the same as a share of the push's duration
    place: FloatArray  # (N, 2) cells' centroid on the table, m
    angle: FloatArray  # (N,) of the object frame, rad
    # (N, 3) of the centroid in the world, m/s, and angular velocity times the cells' radius of gyration
    velocity: FloatArray
    contact: FloatArray  # (N, 2) contact in the object frame, m; NaN where nothing touches
    phase: NDArray[np.int64]  # (N,) see `Phase`

    def __len__(self) -> int:
        return len(self.push)

    @property
    def speed(self) -> FloatArray:
        """(N,) m/s."""
        return np.linalg.norm(self.velocity, axis=1)

    @property
    def table_direction(self) -> FloatArray:
        """(N,) direction of the centroid's motion on the table, rad."""
        return np.arctan2(self.velocity[:, 1], self.velocity[:, 0])

    @property
    def object_direction(self) -> FloatArray:
        """(N,) the same in the object frame, -π to π."""
        return np.angle(np.exp(1j * (self.table_direction - self.angle)))

    @property
    def translating(self) -> FloatArray:
        """(N,) share of translation in the motion, 0 to 1; near 0 its direction is meaningless."""
        return np.hypot(*self.velocity[:, :2].T) / np.maximum(self.speed, 1e-12)

    def rows(self, chosen: NDArray[np.bool_]) -> Self:
        """Some of the pieces."""
        return type(self)(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    @classmethod
    def joined(cls, parts: list[Self]) -> Self:
        """Concatenate the pieces of several pushes."""
        return cls(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)})


def conditions(
    push: int, observation: Observation, poses: FloatArray, begin: FloatArray, end: FloatArray,
    grid: CellGrid, finger_radius: float,
) -> Conditions:  # fmt: skip
    """Conditions of the pieces from `begin` to `end` (N,) s of one push.

    Args:
        push: its index.
        poses: (S, 3) predicted poses at the observation's pose times.
        begin: (N,) s after the first pose.
        end: (N,) s after the first pose, later than `begin`.
        finger_radius: m.
    """
    assert observation.push.pose_times is not None
    times = np.concatenate([[0.0], observation.push.pose_times])
    track = np.vstack([observation.push.start_pose, poses])
    first, last = interpolated(begin, times, track), interpolated(end, times, track)
    radius = radius_of_gyration(grid)
    before, after = at_centroid(first, grid), at_centroid(last, grid)
    velocity = (after - before) * [1, 1, radius] / (end - begin)[:, None]
    contact, phase = _touch(observation, first, last, begin, end, grid, finger_radius)
    way = np.linalg.norm((at_centroid(first, grid) - at_centroid(track[0], grid)) * [1, 1, radius], axis=1)
    pressing = (phase == Phase.STICKING) | (phase == Phase.SLIDING)
    # First touch lasts until the object has moved this far, m.
    phase[pressing & (way < 1.5e-3)] = Phase.FIRST_TOUCH
    return Conditions(
        push=np.full(len(begin), push, dtype=np.int64),
        time=0.5 * (begin + end),
        share=0.5 * (begin + end) / times[-1],
        place=0.5 * (before + after)[:, :2],
        angle=0.5 * (first + last)[:, 2],
        velocity=velocity,
        contact=contact,
        phase=phase,
    )


def _touch(
    observation: Observation, first: FloatArray, last: FloatArray, begin: FloatArray, end: FloatArray,
    grid: CellGrid, radius: float,
) -> tuple[FloatArray, NDArray[np.int64]]:  # fmt: skip
    """Contact points (N, 2) and phases (N,); `FIRST_TOUCH` occurs only where the finger arrives."""
    N = len(begin)
    push = observation.push
    phase = np.full(N, Phase.COASTING, dtype=np.int64)
    contact = np.full((N, 2), np.nan)
    if np.isnan(push.tip).any():
        return contact, phase
    steps = np.array(push.h * np.arange(len(push.tip)))
    path = [interpolated(time, steps, push.tip) for time in (begin, end)]
    tips = [seen_from(tip, pose) for pose, tip in zip((first, last), path, strict=True)]
    gaps, feet = zip(*(_nearest(tip, grid) for tip in tips), strict=True)
    touching = [gap < radius + 5e-4 for gap in gaps]  # m
    for there, foot in zip(touching, feet, strict=True):
        contact[there] = np.where(np.isnan(contact[there]), foot[there], 0.5 * (contact[there] + foot[there]))
    # Sliding is the motion of the finger's surface relative to the object's, along the outline. The finger
    # does not rotate, so seen from the object its surface rotates backwards about its centre.
    turn = (last - first)[:, 2:]
    arm = feet[1] - tips[1]
    normal = arm / np.maximum(np.linalg.norm(arm, axis=1, keepdims=True), 1e-12)
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    slip = (tangent * (tips[1] - tips[0])).sum(axis=1) - turn[:, 0] * np.linalg.norm(arm, axis=1)
    way = np.linalg.norm(path[1] - path[0], axis=1)
    creep = 0.15  # contact that moves by less than this share of the finger's travel counts as sticking
    sliding = np.abs(slip) > creep * np.maximum(way, 1e-9)
    phase[touching[1]] = np.where(sliding, Phase.SLIDING, Phase.STICKING)[touching[1]]
    phase[touching[1] & ~touching[0]] = Phase.FIRST_TOUCH
    return contact, phase


def _nearest(points: FloatArray, grid: CellGrid) -> tuple[FloatArray, FloatArray]:
    """Distances (N,) of points to the outline, and the nearest points (N, 2) on it, object frame."""
    start, way = grid.edges[:, :2], grid.edges[:, 2:] - grid.edges[:, :2]
    along = ((points[:, None] - start) * way).sum(axis=2) / (way**2).sum(axis=1)
    feet = start + np.clip(along, 0.0, 1.0)[..., None] * way
    distance = np.linalg.norm(points[:, None] - feet, axis=2)
    edge = distance.argmin(axis=1)
    rows = np.arange(len(points))
    return distance[rows, edge], feet[rows, edge]


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residual velocities or forces of N pieces of pushes."""

    at: Conditions  # conditions of the pieces
    # (N, 3) residual velocity in the world, m/s, with the angular velocity times the cells' radius of
    # gyration; or (N, 2) residual force on the object in the world, N
    values: FloatArray
    weights: FloatArray  # (N,) duration of a piece, s; of a force 1
    # (B,) scale of each push: its mean speed, m/s; or the typical force, N
    scale: FloatArray

    @property
    def relative(self) -> FloatArray:
        """(N, 3) or (N, 2) residuals as a share of the push's speed or of the typical force."""
        return self.values / self.scale[self.at.push][:, None]


def motion_residuals(
    observations: Sequence[Observation], motions: Sequence[Motion], grid: CellGrid, radius: float
) -> Residuals | None:
    """Residual velocities of pushes, or None where nothing moves; `radius` of the finger, m."""
    parts, values, weights = [], [], []
    scale = np.ones(len(observations))
    for b, (observation, motion) in enumerate(zip(observations, motions, strict=True)):
        times, measured, predicted = centroid_tracks(observation, motion.middle_poses, grid)
        edges = np.unique([*range(0, len(times), 2), len(times) - 1])
        steps = [np.diff(track[edges], axis=0) for track in (measured, predicted)]
        duration = np.diff(times[edges])
        way = np.maximum(*(np.linalg.norm(step, axis=1) for step in steps))
        # The object moves by more than 0.3 mm and more than a tenth of the push's fastest interval.
        moving = (way > max(3e-4, 0.1 * way.max())) & (duration > 0)
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
    observations: Sequence[Observation], motions: Sequence[Motion], grid: CellGrid, radius: float
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
    scale = np.full(len(observations), np.median(np.concatenate(sizes)))
    return Residuals(Conditions.joined(parts), joined, np.ones(len(joined)), scale)


def centroid_tracks(
    observation: Observation, predicted: FloatArray, grid: CellGrid
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (S + 1,), including the start, and the measured and predicted (x, y, ρ θ) of the cells' centroid,
    given predicted poses (S, 3)."""
    assert observation.push.pose_times is not None
    scale = np.array([1.0, 1.0, radius_of_gyration(grid)])
    start = observation.push.start_pose
    tracks = [
        at_centroid(np.vstack([start, poses]), grid) * scale for poses in (observation.poses, predicted)
    ]
    return np.concatenate([[0.0], observation.push.pose_times]), tracks[0], tracks[1]
