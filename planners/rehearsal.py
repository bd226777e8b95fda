"""Simulated pushes: what rival models predict for them, and how far apart the predictions are.

Distances are in standard deviations of the error model: the whitened distance between two predicted
trajectories of poses, and of forces if the dataset has any, weighted as in a fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy.linalg

from slipmap.models.geometry import radius_of_gyration, rotated
from slipmap.models.inference.diagnosis.fitting import Fitted
from slipmap.models.inference.error_model import ErrorModel, travelled
from slipmap.models.inference.observations import (
    LONGEST_STEP,
    LONGEST_STRIDE,
    SAMPLES,
    Observation,
    moving_speeds,
)
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Maps, Push, RolloutError, Slider

RAMP = 0.1  # time in which the finger speeds up, s
AFTERWARDS = 0.4  # time observed after it has stopped, s
_REST = 0.1  # s for which it waits before it starts
_FASTER = 1.5  # factor by which a proposed push may be faster or slower than any recorded one


@dataclass(frozen=True, eq=False)
class Rival:
    """A candidate model."""

    name: str  # display name
    slider: Slider  # model
    maps: Maps  # one hypothesis

    @classmethod
    def of(cls, fitted: Fitted, name: str | None = None, z: FloatArray | None = None) -> Rival:
        """A fitted model, at its own coordinates or at `z` (d,)."""
        prior = fitted.likelihood.prior
        own = " and ".join(effect.name for effect in fitted.effects) or "no effect"
        return cls(name or own, prior.slider, prior.maps((fitted.z if z is None else z)[None]))


@dataclass(frozen=True, eq=False)
class Predictions:
    """One model's predictions for B pushes; NaN where there is none, for example because the object tips."""

    poses: FloatArray  # (B, S, 3) as the tracker reports them
    forces: FloatArray  # (B, S, 2) of the finger on the object, means over equal intervals, world, N


@dataclass(frozen=True)
class Habits:
    """Statistics of the recorded pushes, from which new ones are proposed."""

    low: FloatArray  # (2,) lower corner of the object's positions, m
    high: FloatArray  # (2,) upper corner
    speeds: tuple[float, float, float]  # slow, medium and fast, m/s
    lengths: tuple[float, float]  # shortest and longest push to propose, m
    pose_rows: float  # number of tracker rows averaged in an observed pose
    force_rows: float  # the same for a force; 0 if none was measured
    pushes: int  # number of recorded pushes
    ends_only: bool  # whether the object was seen only before and after them


def habits_of(observations: Sequence[Observation], dataset: PushDataset) -> Habits:
    """Region, speeds and lengths of recorded pushes."""
    poses = np.concatenate([np.vstack([o.push.start_pose, o.poses]) for o in observations])[:, :2]
    speeds, ways = [], []
    for o in observations:
        if len(moving := moving_speeds(o.push)):
            speeds.append(float(np.median(moving)))
        ways.append(float(np.hypot(*(o.poses[-1, :2] - o.push.start_pose[:2]))))
    speeds = speeds or [0.05]
    force_rows = np.concatenate([o.force_rows[o.sliding] for o in observations])
    longest = max(max(ways), 0.5 * float(np.ptp(dataset.grid.exterior, axis=0).max()))
    return Habits(
        poses.min(axis=0),
        poses.max(axis=0),
        (min(speeds) / _FASTER, float(np.median(speeds)), max(speeds) * _FASTER),
        (0.5 * longest, longest),
        float(np.median(np.concatenate([o.pose_rows for o in observations]))),
        float(np.median(force_rows)) if len(force_rows) else 0.0,
        len(dataset.trials),
        all(trial.ends_only for trial in dataset.trials),
    )


def straight_push(
    pose: FloatArray,
    begin: FloatArray,
    end: FloatArray,
    speed: float,
    *,
    dwell: float = 0.0,
    order: float = 0.0,
    coarseness: float = 1.0,
) -> Push:
    """A push along a line with a gentle start and an abrupt stop; if `dwell` is positive, also a stop
    half-way.

    Args:
        pose: (3,) of the object before the push, world.
        begin: (2,) finger centre at the start, world, m.
        end: (2,) finger centre at the end.
        speed: m/s.
        dwell: duration of the stop half-way, s.
        order: place in the experiment.
        coarseness: factor on the usual time step.
    """
    h = coarseness * min(LONGEST_STEP, LONGEST_STRIDE / speed)
    length = float(np.hypot(*(end - begin)))
    parts = 2 if dwell > 0 else 1
    way = length / parts
    ramp = min(RAMP, way / speed)
    moving = way / speed + ramp / 2
    duration = _REST + parts * moving + (parts - 1) * dwell + AFTERWARDS
    times = h * np.arange(0.0, int(np.ceil(duration / h)) + 1)
    travelled_way = np.zeros(len(times))
    for part in range(parts):
        t = np.clip(times - _REST - part * (moving + dwell), 0.0, moving)
        travelled_way += speed * np.where(t < ramp, t**2 / (2 * ramp), t - ramp / 2)
    tip = begin + np.outer(np.minimum(travelled_way / length, 1.0), end - begin)
    return sampled_push(h, times, tip, pose, order)


def sampled_push(h: float, times: FloatArray, tip: FloatArray, pose: FloatArray, order: float) -> Push:
    """A push to simulate, with `SAMPLES` poses and the force of every step, as in a fit.

    Args:
        h: step, s.
        times: (N + 1,) of the steps' ends, s.
        tip: (N + 1, 2) finger centre at these times, world, m.
        pose: (3,) of the object before the push, world.
        order: place in the experiment.
    """
    looks = times[-1] * np.arange(1, SAMPLES + 1) / SAMPLES
    return Push(h, tip, pose, pose_times=looks, force_times=times[1:] - h / 2, order=order)


def predict(rival: Rival, pushes: Sequence[Push]) -> Predictions:
    """Roll out one model on all pushes at once."""
    B = len(pushes)
    try:
        out = rival.slider.rollout(rival.maps, pushes)
    except RolloutError:
        if B == 1:
            return Predictions(np.full((1, SAMPLES, 3), np.nan), np.full((1, SAMPLES, 2), np.nan))
        parts = [predict(rival, pushes[: B // 2]), predict(rival, pushes[B // 2 :])]
        return Predictions(
            np.concatenate([part.poses for part in parts]), np.concatenate([part.forces for part in parts])
        )
    poses = np.array([out.poses_of(b)[0] for b in range(B)])
    forces = np.array([_means(out.forces_of(b)[0]) for b in range(B)])
    poses[out.tipped[0]] = forces[out.tipped[0]] = np.nan
    return Predictions(poses, forces)


def separations(
    predictions: Sequence[Predictions],
    pushes: Sequence[Push],
    error: ErrorModel,
    grid: CellGrid,
    habits: Habits,
) -> FloatArray:
    """(pairs, B) distances between the predictions of each pair of models, in standard deviations.

    Args:
        pushes: B pushes.
        habits: how many rows are averaged, and whether the object is seen only before and after a push.
    """
    pairs = list(combinations(range(len(predictions)), 2))
    result = np.zeros((len(pairs), len(pushes)))
    centroid, radius = grid.centers.mean(axis=0), radius_of_gyration(grid)
    for b, push in enumerate(pushes):
        first = -1 if habits.ends_only else 0
        poses = np.array([p.poses[b, first:] for p in predictions])
        forces = np.array([p.forces[b] for p in predictions])
        if not np.isfinite(poses).all():
            continue
        middle = np.mean(forces, axis=0)
        counts = _steady(push, middle) if habits.force_rows else np.zeros(SAMPLES, dtype=bool)
        assert push.pose_times is not None
        stretch = len(push.tip) - 1
        times = push.h * stretch * (np.arange(SAMPLES) + 0.5) / SAMPLES
        imagined = Observation(
            "", "fit", replace(push, pose_times=push.pose_times[first:], force_times=times),
            np.mean(poses, axis=0), np.full(poses.shape[1], habits.pose_rows), 1,
            middle, np.full(SAMPLES, habits.force_rows), counts,
        )  # fmt: skip
        lasting = error.pose_covariance(imagined, travelled(imagined, grid.centers), radius)
        places = poses[..., :2] + rotated(centroid, poses[..., 2])
        rows = np.concatenate([places, radius * poses[..., 2:]], axis=-1)
        white = [_whitened(lasting[i], rows[..., i]) for i in range(3)]
        if counts.any():
            of_force = error.force_covariance(imagined)
            white += [_whitened(of_force, forces[:, counts, i]) for i in range(2)]
        every = np.concatenate(white, axis=1)
        result[:, b] = [float(np.linalg.norm(every[i] - every[j])) for i, j in pairs]
    return result


def keeps_touch(push: Push, forces: FloatArray) -> bool:
    """Whether the finger stays in contact from first touch to its stop: models cannot say when it slides off.

    Args:
        forces: (S, 2) predicted for it.
    """
    size = np.hypot(*forces.T)
    pressed = size > 0.05 * size.max()
    moving = np.flatnonzero(_paces(push) > 1e-9)
    first = int(np.argmax(pressed))
    # The force may vanish in a stop half-way; the last interval of motion may be cut short.
    return bool(pressed[first : moving[-1]][_paces(push)[first : moving[-1]] > 1e-9].all())


def _paces(push: Push) -> FloatArray:
    """(SAMPLES,) distance that the finger travels per step, mean over each interval, m."""
    return _means(np.hypot(*np.diff(push.tip, axis=0).T))


def _means(steps: FloatArray) -> FloatArray:
    """(SAMPLES, …) means of rows (N, …) over equal intervals."""
    edges = np.linspace(0, len(steps), SAMPLES + 1).astype(int)
    return (np.add.reduceat(steps, edges[:-1], axis=0).T / np.diff(edges)).T


def _whitened(covariance: FloatArray, rows: FloatArray) -> FloatArray:
    """Rows (k, S) in standard deviations, their entries independent."""
    return scipy.linalg.solve_triangular(np.linalg.cholesky(covariance), rows.T, lower=True).T


def _steady(push: Push, forces: FloatArray) -> np.ndarray:
    """Intervals of steady pushing, as in fits: fast finger and present force, also in both neighbours."""
    mean = _paces(push)
    size = np.hypot(*forces.T)
    steady = (mean > 0.5 * mean.max()) & (size > 0.2 * np.percentile(size, 90))
    padded = np.concatenate([[False], steady, [False]])
    return steady & padded[:-2] & padded[2:]
