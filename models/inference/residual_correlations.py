"""Memory of the residual, its correlation with the finger's motion, and the delay of measured poses.

Within a push neighbouring residuals are alike, so the usual bounds ±1.96/√samples would find correlation
anywhere. Here the bounds come from whole pushes: for the autocorrelation from pairing each push with
another one, for the correlation with the finger from random signs of whole pushes, and both hold for all
lags together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slipmap.models.inference.observations import Observation, interpolated
from slipmap.models.inference.prediction import Motion
from slipmap.models.inference.residual_structure import NEGLIGIBLE, OUTLYING, Pattern, described
from slipmap.models.inference.residuals import centroid_tracks
from slipmap.models.inference.sign_flips import beyond, random_signs, sign_flip_test
from slipmap.models.physics.cell_grid import CellGrid, FloatArray

_LAG_STEP, _LONGEST_LAG = 0.05, 1.0  # s
_DRAWS = 1999
_LEAST_PUSHES = 4


class _Fields:
    def to_json(self) -> dict[str, object]:
        """All fields."""
        values = vars(self).items()
        return {key: v.to_json() if isinstance(v, Correlation) else _plain(v) for key, v in values}


def _plain(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray) else value


@dataclass(frozen=True, eq=False)
class Correlation(_Fields):
    """Correlation over lags, with what chance gives."""

    name: str  # `memory`, `finger_along` or `finger_left`
    lags: FloatArray  # (L,) s; at a positive one the residual follows
    values: FloatArray  # (L,) correlation, -1 to 1
    bounds: FloatArray  # (L,) |values| stays below them with 95 % probability at all lags together, by chance
    p: float  # of the largest excess


@dataclass(frozen=True, eq=False)
class Correlations(_Fields):
    """All correlations of one comparison."""

    memory: Correlation  # of the residual with itself
    finger_along: Correlation  # of the residual with the finger's velocity, in its direction
    finger_left: Correlation  # of the residual with the finger's velocity, to its left
    memory_time: float  # lag at which the memory has fallen to 1/e, s; NaN where it never does
    independent: float  # about so many independent residuals a push holds: its duration over twice that


@dataclass(frozen=True, eq=False)
class _Track:
    """One push at even times: residual (n, 3) and velocity of the finger (n, 2)."""

    residual: FloatArray
    finger: FloatArray


def correlations(
    observations: Sequence[Observation],
    motions: Sequence[Motion],
    grid: CellGrid,
    rng: np.random.Generator,
) -> Correlations | None:
    """Correlations over all pushes whose course was measured; None where there are too few."""
    found = [_track(o, motion, grid) for o, motion in zip(observations, motions, strict=True)]
    tracks = [track for track in found if track is not None]
    if len(tracks) < _LEAST_PUSHES:
        return None
    typical = int(np.median([len(track.residual) for track in tracks]))
    most = max(2, min(round(_LONGEST_LAG / _LAG_STEP), typical // 2))
    memory = _memory(tracks, most, rng)
    below = np.flatnonzero(memory.values < np.exp(-1.0))
    time = float(memory.lags[below[0]]) if len(below) else float("nan")
    duration = _LAG_STEP * float(np.mean([len(track.residual) for track in tracks]))
    return Correlations(
        memory=memory,
        finger_along=_with_finger(tracks, most, "finger_along", rng),
        finger_left=_with_finger(tracks, most, "finger_left", rng),
        memory_time=time,
        independent=max(1.0, duration / (2 * time)) if np.isfinite(time) else 1.0,
    )


def delay_pattern(
    observations: Sequence[Observation],
    motions: Sequence[Motion],
    grid: CellGrid,
    rng: np.random.Generator,
) -> Pattern | None:
    """Whether measured poses come late: the delay is minus the slope of residual over predicted velocity."""
    scores, powers = [], []
    for observation, motion in zip(observations, motions, strict=True):
        if len(observation.poses) < 3:
            continue
        times, measured, predicted = centroid_tracks(observation, motion.middle_poses, grid)
        velocity = np.gradient(predicted, np.maximum.accumulate(times + 1e-9 * np.arange(len(times))), axis=0)
        speed = np.sqrt((velocity**2).sum(axis=1).mean())
        if speed == 0.0:
            continue
        # A constant delay shows in how the residual follows changes of velocity; what merely grows along
        # the push is no delay, so both lose their mean and their trend first.
        residual, motion_now = (_without_trend(values, times) for values in (measured - predicted, velocity))
        scores.append((residual * motion_now).sum() / speed**2 / len(times))
        powers.append((motion_now**2).sum() / speed**2 / len(times))
    if len(scores) < _LEAST_PUSHES:
        return None
    values = -np.array(scores)[:, None]
    sizes = np.abs(values[:, 0])
    limit = OUTLYING * np.median(sizes)
    tempered = values * np.minimum(1.0, limit / np.maximum(sizes, 1e-300))[:, None]
    power = np.array(powers)[:, None]
    test = sign_flip_test(beyond(tempered, power, NEGLIGIBLE["delay"]), rng)
    return described(
        test, tempered, power, ["measured pose behind the predicted one"], "delay",
        "delay of the measured pose", "delay",
    )  # fmt: skip


def _without_trend(values: FloatArray, times: FloatArray) -> FloatArray:
    basis = np.column_stack([np.ones(len(times)), times])
    return values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]


def _track(observation: Observation, motion: Motion, grid: CellGrid) -> _Track | None:
    if len(observation.poses) < 3 or np.isnan(observation.push.tip).any():
        return None
    times, measured, predicted = centroid_tracks(observation, motion.middle_poses, grid)
    even = np.arange(0.0, times[-1], _LAG_STEP)
    if len(even) < 4:
        return None
    push = observation.push
    steps = push.h * np.arange(len(push.tip))
    residual = interpolated(even, times, measured - predicted)
    tip = interpolated(even, steps, push.tip)
    size = np.sqrt((residual**2).sum(axis=1).mean())
    finger = np.gradient(tip, _LAG_STEP, axis=0)
    speed = np.sqrt((finger**2).sum(axis=1).mean())
    if size == 0.0 or speed == 0.0:
        return None
    # Each push counts alike: its residual and its finger's speed are scaled to a mean square of one.
    return _Track(residual / size, finger / speed)


def _memory(tracks: list[_Track], most: int, rng: np.random.Generator) -> Correlation:
    """Autocorrelation; by chance what one push has to do with another, at every lag."""
    B = len(tracks)
    longest = max(len(track.residual) for track in tracks)
    padded = np.zeros((B, longest, 3))
    for b, track in enumerate(tracks):
        padded[b, : len(track.residual)] = track.residual
    total = float((padded**2).sum())
    lags = np.arange(most + 1)
    pairs = np.array(
        [np.einsum("asc,bsc->ab", padded[:, : longest - k], padded[:, k:]) / total for k in lags]
    )
    values = pairs[:, np.arange(B), np.arange(B)].sum(axis=1)
    chance = np.empty((_DRAWS, len(lags)))
    for draw in range(_DRAWS):
        order = rng.permutation(B)
        signs = 1.0 - 2.0 * rng.integers(0, 2, B)
        chance[draw] = (pairs[:, order, np.roll(order, 1)] * signs).sum(axis=1)
    return _bounded("memory", lags, values, chance, skip=1)


def _with_finger(tracks: list[_Track], most: int, name: str, rng: np.random.Generator) -> Correlation:
    lags = np.arange(-most, most + 1)
    per_push = np.zeros((len(tracks), len(lags)))
    for b, track in enumerate(tracks):
        finger = track.finger
        if name == "finger_left":
            finger = np.column_stack([-finger[:, 1], finger[:, 0]])
        n = len(finger)
        for j, k in enumerate(lags):
            if abs(k) >= n:
                continue
            later, now = (slice(k, n), slice(0, n - k)) if k >= 0 else (slice(0, n + k), slice(-k, n))
            per_push[b, j] = (track.residual[later, :2] * finger[now]).sum() / n
    chance = random_signs(_DRAWS, len(tracks), rng) @ per_push / len(tracks)
    return _bounded(name, lags, per_push.mean(axis=0), chance)


def _bounded(
    name: str, lags: NDArray[np.int64], values: FloatArray, chance: FloatArray, skip: int = 0
) -> Correlation:
    """Bounds that hold at all lags (in steps) from `skip` on together."""
    scale = np.sqrt((chance**2).mean(axis=0))
    scale = np.maximum(scale, 1e-12)
    largest = (np.abs(chance) / scale)[:, skip:].max(axis=1)
    found = float((np.abs(values) / scale)[skip:].max())
    p = (1 + int((largest >= found).sum())) / (1 + len(chance))
    return Correlation(name, np.array(_LAG_STEP * lags), values, float(np.quantile(largest, 0.95)) * scale, p)
