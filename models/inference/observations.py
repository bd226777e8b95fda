"""From a trial to an observation: a push to simulate, and the poses and forces to match."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TypeVar

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import binary_erosion, uniform_filter1d

from slipmap.models.effects.effect import Scene
from slipmap.models.geometry import rotated
from slipmap.models.measurements import (
    DatasetError,
    PushDataset,
    Trial,
    finger_path,
    pose_times,
    wrench_samples,
)
from slipmap.models.measurements.motion import interpolated, smooth_track
from slipmap.models.measurements.rim_checks import beside_table
from slipmap.models.measurements.trial_tables import smoothed_angle
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.rollout import Push, Smoothing

SAMPLES = 30
"""Poses compared per push. Residuals along a push are so correlated that more poses add nothing."""

AVERAGED, DENSE = 5, 100
"""Tracker rows averaged into an observed pose, in trials with more than this many rows."""

MOST_PUSHES = 400
"""Most pushes of a dataset to learn from, which bounds time and memory."""

T = TypeVar("T")

_LONG_REST = 0.15
"""A record in which the object moves for less than this share is cut to its motion and some rest before and
after it, so that most of the poses and forces compared are not those of rest."""

_LEAST_REST = 0.5  # s, kept before and after the motion if there is so much

_TURNING_ARM = 0.03  # m; a rotation counts like a motion so far from the axis

LONGEST_STEP = 0.01  # s
LONGEST_STRIDE = 6e-4  # m that the finger may move in a step
_FEW_ROWS = 12  # of the finger; with fewer, a stop between two rows would become a ramp
_DRAWN_PAIRS = 4  # of opposite tracks that the finger may have taken
_LEAST_SCATTER = 2e-6  # m between tracks that matters
# s and m, for an object that starts in motion; an implicit step stops it half a stride too early
_SLIDING_STEP, _SHORTEST_STEP, _SLIDING_STRIDE = 2e-3, 1e-4, 2e-4

MEASURED_CONTACT = Smoothing(penetration=1e-4, relaxation=1.2e-2)
"""Contact for recorded fingers: 0.1 mm of penetration, like the give of real fingers, keeps the remaining
jitter from rattling the force, and the damping keeps impacts from throwing the object."""


@dataclass(frozen=True, eq=False)
class Observation:
    """One trial, ready to be compared with a rollout."""

    trial: str  # its name
    role: str  # `fit` or `heldout`
    push: Push  # what drives the object; its pose and force times are those of the rows below
    poses: FloatArray  # (S, 3) measured world poses, m and rad
    pose_rows: FloatArray  # (S,) number of tracker rows averaged into each pose
    start_rows: int  # the same for the start pose
    forces: FloatArray  # (T, 2) measured force of the finger on the object, world, N; T may be 0
    force_rows: FloatArray  # (T,) number of sensor rows averaged into each force
    # (T,) whether a force counts: the finger moves and presses, away from its first touch and its stop, where
    # force depends on contact stiffness rather than on friction
    sliding: np.ndarray
    # times (k,) and positions (k, 2) of the finger, if it may have taken other tracks than `push.tip`
    finger: tuple[FloatArray, FloatArray] | None = None

    @property
    def likely_pushes(self) -> list[Push]:
        """The push along each track that the finger may have taken; the push alone if there is one.

        They are drawn at each call, the same ones: they take more memory than the rest of an observation.
        """
        if self.finger is None:
            return [self.push]
        time, _, likeliest = smooth_track(*self.finger, _DRAWN_PAIRS)
        ends = np.minimum(self.push.h * np.arange(len(self.push.tip)), time[-1])
        # Each beside its opposite.
        paired = (
            likeliest.reshape(2, _DRAWN_PAIRS, *likeliest.shape[1:]).swapaxes(0, 1).reshape(likeliest.shape)
        )
        return [replace(self.push, tip=tip) for tip in PchipInterpolator(time, paired, axis=1)(ends)]

    @property
    def counted(self) -> Push:
        """The push with the times of those forces that count."""
        times = np.asarray(self.push.force_times)[self.sliding]
        return replace(self.push, force_times=times)

    @property
    def with_long_steps(self) -> Observation:
        """The same with steps twice as long, for a search that ends with the usual ones."""
        fine = self.push
        steps = max(8, len(fine.tip) // 2)
        h = fine.h * (len(fine.tip) - 1) / steps
        times = h * np.arange(steps + 1), fine.h * np.arange(len(fine.tip))
        angle = None if fine.tip_angle is None else np.interp(*times, fine.tip_angle)
        return replace(self, push=replace(fine, h=h, tip=interpolated(*times, fine.tip), tip_angle=angle))

    @property
    def without_forces(self) -> Observation:
        """The same, as if no force counted."""
        return replace(self, sliding=np.zeros(len(self.sliding), dtype=bool))

    def travel(self, centers: FloatArray) -> FloatArray:
        """(S,) ADD between each measured pose and the start, m."""
        return add(self.poses, self.push.start_pose, centers)

    @property
    def typical_force(self) -> float:
        """Median magnitude of the forces that count (at least one), N."""
        return float(np.median(np.hypot(*self.forces[self.sliding].T)))


def observe(trial: Trial, order: int = 0, coarseness: float = 1.0, *, reach: float = 0.0) -> Observation:
    """Prepare one trial: cut off long rests, smooth the finger's track, choose the step, average rows, mask
    forces.

    Args:
        trial: as recorded.
        order: its place in the experiment as recorded, from 0.
        coarseness: factor by which steps may be longer than usual.
        reach: of the object's outline from its frame's origin, m, see `Trial.finger_near`.
    """
    trial = _without_long_rest(trial)
    pushed = trial.finger_near(reach)
    times = pose_times(trial)
    duration = float(times[-1])
    twist = trial.initial_velocity()
    path = finger_path(trial)
    track_time, track, apart = _smooth(*path)
    speed = _fast_speed(track_time, track) if pushed else 0.0
    step = min(LONGEST_STEP, LONGEST_STRIDE / speed) if speed > 0 else LONGEST_STEP
    if twist.any():
        fastest = float(np.hypot(*twist[:2])) + _TURNING_ARM * abs(float(twist[2]))
        step = min(step, _SLIDING_STEP, max(_SLIDING_STRIDE / fastest, _SHORTEST_STEP))
    step *= coarseness
    steps = max(8, int(np.ceil(duration / step)))
    step = duration / steps
    ends = step * np.arange(steps + 1)
    tip, scatters = np.full((steps + 1, 2), np.nan), False
    if len(track_time) >= _FEW_ROWS and pushed:
        # Straight lines between rows would change the speed at each row at once, and the force would ring.
        tip = PchipInterpolator(track_time, track)(np.minimum(ends, track_time[-1]))
        scatters = apart > _LEAST_SCATTER
    elif pushed:
        tip = interpolated(ends, track_time, track)

    start, start_rows = trial.object_pose.values[0].copy(), 1
    if not trial.ends_only and not twist.any():
        start, start_rows = _resting_pose(trial.object_pose.values)
    rows = np.unique(np.linspace(0, len(times) - 1, SAMPLES + 1).astype(int))[1:]
    poses, pose_rows = _averaged_rows(times, trial.object_pose.values, rows)
    force_times, forces, force_rows = _force_rows(trial)
    push = Push(
        step,
        tip,
        start,
        np.append(rotated(twist[:2], -start[2]), twist[2]),
        pose_times=np.minimum(times[rows], steps * step),
        force_times=np.minimum(force_times, steps * step),
        force_span=duration / SAMPLES,
        order=float(order),
        tip_angle=_angle(trial, np.asarray(ends)) if pushed else None,
    )
    return Observation(
        trial.name, trial.role, push, poses, pose_rows, start_rows, forces, force_rows,
        _sliding(push, forces), path if scatters else None,
    )  # fmt: skip


def observe_all(
    dataset: PushDataset, trials: Iterable[Trial] | None = None, coarseness: float = 1.0
) -> list[Observation]:
    """Prepare some or all trials of a dataset, see `observe`.

    Raises:
        DatasetError: no table carries the object in one of them.
    """
    chosen = dataset.trials if trials is None else list(trials)
    for trial in chosen:
        if (off := beside_table(dataset, trial)) is not None:
            raise DatasetError(f"dataset {dataset.name}: {trial.name}: {off}")
    return [observe(trial, trial.order or 0, coarseness, reach=dataset.reach) for trial in chosen]


def moving_speeds(push: Push) -> FloatArray:
    """(k,) speeds of the finger, m/s, in the steps in which it moves; none without a finger."""
    speed = np.hypot(*np.diff(push.tip, axis=0).T) / push.h
    return speed[np.isfinite(speed) & (speed > 1e-3)]


def scene_of(observations: Sequence[Observation], grids: Sequence[CellGrid], weight: float) -> Scene:
    """The scene from which effects derive their starting values.

    Args:
        observations: pushes of one object or several.
        grids: of these objects.
        weight: of an object, N.
    """
    poses = np.concatenate([o.poses for o in observations])[:, :2]
    center = 0.5 * (poses.min(axis=0) + poses.max(axis=0))
    speeds = [float(moving.mean()) for o in observations if len(moving := moving_speeds(o.push))]
    return Scene(
        (float(center[0]), float(center[1])),
        float(np.abs(poses - center).max()),
        max(float(np.linalg.norm(grid.exterior, axis=1).max()) for grid in grids),
        float(np.median(speeds)) if speeds else 0.05,
        len(observations),
        weight,
    )


def to_learn_from(pushes: Sequence[T]) -> list[T]:
    """The pushes that a model is fitted to: all, or `MOST_PUSHES` of them drawn at random, in their order."""
    if len(pushes) <= MOST_PUSHES:
        return list(pushes)
    drawn = np.random.default_rng(0).choice(len(pushes), MOST_PUSHES, replace=False)
    return [pushes[b] for b in np.sort(drawn)]


def _smooth(time: FloatArray, track: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Times and places of `smooth_track`, and how far the likeliest tracks are from them at most, m.

    Kept, because learning, comparing and diagnosing observe the same pushes, and smoothing takes longest.
    """
    grid, smooth, apart = _smoothed(np.asarray(time, float).tobytes(), np.asarray(track, float).tobytes())
    return grid.copy(), smooth.copy(), apart


@lru_cache(maxsize=256)
def _smoothed(time: bytes, track: bytes) -> tuple[FloatArray, FloatArray, float]:
    rows = np.frombuffer(time)
    grid, smooth, likeliest = smooth_track(rows, np.frombuffer(track).reshape(len(rows), 2))
    return grid, smooth, float(np.abs(likeliest - smooth).max())


def _fast_speed(time: FloatArray, track: FloatArray) -> float:
    """98th percentile of the finger's speed, taken over 50 ms so that jitter does not count."""
    grid = np.arange(time[0], time[-1], 0.01)
    if len(grid) < 7:
        return float(np.hypot(*(track[-1] - track[0])) / max(time[-1] - time[0], 1e-9))
    x, y = interpolated(grid, time, track).T
    return float(np.percentile(np.hypot(x[5:] - x[:-5], y[5:] - y[:-5]) / 0.05, 98))


def _resting_pose(poses: FloatArray) -> tuple[FloatArray, int]:
    """Mean of the rows before the object moves, so that noise in the first row does not shift the push, and
    the number of these rows."""
    jitter = 3.0 * float(np.median(np.abs(np.diff(poses[:, :2], axis=0)))) + 1e-4
    calm = uniform_filter1d(poses, 5, axis=0, mode="nearest")
    way = np.hypot(*(calm[:, :2] - calm[0, :2]).T)
    turned = _TURNING_ARM * np.abs(calm[:, 2] - calm[0, 2])
    # Angles much noisier than positions are no sign of motion. Steady rotation has no second differences.
    second = np.abs(np.diff(poses[:, 2], 2)) if len(poses) > 2 else np.zeros(1)
    jitter_of_angle = 3.0 * _TURNING_ARM * float(np.median(second)) / np.sqrt(3.0)
    least = max(jitter, 5e-4)
    moving = np.flatnonzero((way > least) | (way + turned > max(least, jitter_of_angle)))
    still = max(1, int(0.7 * (moving[0] if len(moving) else len(poses))))
    return poses[:still].mean(axis=0), still


def _without_long_rest(trial: Trial) -> Trial:
    """The trial cut to its motion and some rest before and after it, if most of it is rest.

    Half of the motion's time is kept on either side, since a slow beginning or end cannot be told from rest.
    """
    time, poses = trial.object_pose.time, trial.object_pose.values
    if trial.ends_only or len(time) <= DENSE:
        return trial
    calm = uniform_filter1d(poses, AVERAGED, axis=0, mode="nearest")
    from_start, to_end = (
        np.hypot(*(calm[:, :2] - still[:2]).T) + _TURNING_ARM * np.abs(calm[:, 2] - still[2])
        for still in calm[[0, -1]]
    )
    jitter = 3.0 * float(np.median(np.abs(np.diff(poses[:, :2], axis=0)))) + 1e-4  # m
    least = max(jitter, 0.02 * float(from_start.max()))
    if not ((from_start > least).any() and (to_end > least).any()):
        return trial
    first, last = np.flatnonzero(from_start > least)[0], np.flatnonzero(to_end > least)[-1]
    moving, whole = float(time[last] - time[first]), float(time[-1] - time[0])
    if not 0.0 < moving < _LONG_REST * whole:
        return trial
    beside = max(0.5 * moving, min(0.5 * _LONG_REST * whole, _LEAST_REST))
    kept = (time >= time[first] - beside) & (time <= time[last] + beside)
    return replace(trial, object_pose=trial.object_pose.chosen(kept))


def _averaged_rows(times: FloatArray, poses: FloatArray, rows: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """Poses at given rows, averaged over neighbours where rows are dense, and the numbers averaged."""
    half = AVERAGED // 2 if len(poses) > DENSE else 0
    inner = (rows >= half) & (rows < len(poses) - half)
    # Across a gap, such as that of an occlusion, the mean of neighbours is no pose on the track.
    around = times[np.minimum(rows + half, len(times) - 1)] - times[np.maximum(rows - half, 0)]
    inner &= around < 3.0 * half * times[-1] / (len(times) - 1)
    reach = np.where(inner, half, 0)
    means = [poses[row - n : row + n + 1].mean(axis=0) for row, n in zip(rows, reach, strict=True)]
    return np.array(means), 2.0 * reach + 1.0


def _force_rows(trial: Trial) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Midpoints of those of `SAMPLES` equal intervals of the trial that contain force rows, the mean forces
    there, and the numbers of rows."""
    samples = wrench_samples(trial)
    if samples is None or len(samples[0]) == 0:
        return np.zeros(0), np.zeros((0, 2)), np.zeros(0)
    time, wrench = samples
    edges = np.linspace(0.0, float(pose_times(trial)[-1]), SAMPLES + 1)
    place = np.clip(np.searchsorted(edges, time, side="right") - 1, 0, SAMPLES - 1)
    used, count = np.unique(place, return_counts=True)
    means = np.array([wrench[place == k, :2].mean(axis=0) for k in used])
    return 0.5 * (edges[used] + edges[used + 1]), means, count.astype(float)


def _angle(trial: Trial, times: FloatArray) -> FloatArray | None:
    """Angle of the finger at times after the first pose, as a mean over 0.1 s, if it turns."""
    if trial.tip_angle is None:
        return None
    own, angle = trial.tip_angle.time, trial.tip_angle.values[:, 0]
    return np.interp(times, own - trial.start, smoothed_angle(own, angle))


def _sliding(push: Push, forces: FloatArray) -> np.ndarray:
    """Which force rows belong to steady pushing: finger fast and force present, in this row and around it."""
    if len(forces) == 0 or np.isnan(push.tip).any():
        return np.zeros(len(forces), dtype=bool)
    speed = np.hypot(*np.diff(push.tip, axis=0).T) / push.h
    at = np.clip((push.force_times / push.h).astype(int), 0, len(speed) - 1)
    size = np.hypot(*forces.T)
    steady = (speed[at] > 0.2 * speed.max()) & (size > 0.2 * np.percentile(size, 90))
    # A sensor that averages over 20 ms smears short events into the next row.
    apart = 2
    return binary_erosion(steady, np.ones(2 * apart + 1))
