"""Sensor noise that lasts from row to row, found while objects rest.

A tracker that filters its rows, or a tag whose pose drifts, errs by much the same in neighbouring rows.
Differences of neighbouring rows then show a small part of the noise. Before the finger comes and after it has
gone the object rests, and poses change by noise alone. With white noise of variance w² and lasting noise of
variance s² and memory τ, rows k apart differ by the variance 2 (w² + s² (1 - exp(-k/τ))).

It is estimated from differences over long distances in rows, without the few rests in which the object
creeps, slides on, or is touched earlier than its outline says: those with far larger differences than the
median rest. A rest much shorter than τ cannot tell s; τ then counts as no longer than the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from slipmap.models.measurements.motion import interpolated, rounding_noise, white_noise
from slipmap.models.measurements.push_dataset import Setup, gaps
from slipmap.models.measurements.trial import Trial, finger_path, pose_times
from slipmap.models.physics.cell_grid import FloatArray

_CLEAR = 2e-3  # m from the outline, farther than clocks and frames are usually off
_STANDING = 5e-4  # m; a finger that stays so close to its last place stands
_SHORTEST = 10  # rows of a rest
_FEWEST = 5  # rests
_SIGNIFICANCE = 3.5  # standard errors of white noise
_UNLIKE = 9.0  # times the median mean square of rests; of sound ones with two numbers, one in 500 is above it
_DISTANCE = 2.0 / 3.0  # of the rests' length
_SHORTEST_MEMORY, _LONGEST_MEMORY = 0.05, 1.0 / _DISTANCE  # τ in multiples of the distance
_ENOUGH = 30
"""Fewest poses of a push from which noise is estimated. In simulated pushes of so many it comes out up to
50 % too large, in pushes of ten three times too large, because motion between poses is taken for noise."""


@dataclass(frozen=True)
class Lasting:
    """How much of a sensor's noise lasts from row to row."""

    share: float = 0.0  # of the variance
    memory: float = 1.0  # τ, rows

    def independent(self, rows: ArrayLike) -> FloatArray:
        """Number of independent rows whose mean is as good as that of so many consecutive rows."""
        n = np.asarray(rows, dtype=float)
        if not self.share:
            return n
        kept = np.exp(-1.0 / self.memory)
        # 1/n² Σ_ij kept^|i - j|, the variance of the mean of the lasting part.
        lasting = (1.0 + kept) / (1.0 - kept) / n - 2.0 * kept * (1.0 - kept**n) / (n * (1.0 - kept)) ** 2
        return np.asarray(1.0 / ((1.0 - self.share) / n + self.share * lasting))

    def changing(self, rows: float) -> float:
        """Share of the variance by which rows so far apart differ."""
        return 1.0 - self.share * float(np.exp(-rows / self.memory))


NONE_LASTS = Lasting()


@dataclass(frozen=True)
class PoseNoise:
    """Noise of one row of the poses."""

    # standard deviations of x and y each, m, and of θ, rad
    position: float
    angle: float
    # how much of it lasts from row to row; nothing where it is declared
    lasting_position: Lasting = NONE_LASTS
    lasting_angle: Lasting = NONE_LASTS
    # whether no push has enough poses for an estimate, so that the noise is the least possible
    assumed: bool = False

    def of_changes(self, rows: float) -> tuple[float, float]:
        """The deviations without what rows so far apart have in common, m and rad."""
        return (
            self.position * float(np.sqrt(self.lasting_position.changing(rows))),
            self.angle * float(np.sqrt(self.lasting_angle.changing(rows))),
        )


def noise_of_poses(setup: Setup, trials: Sequence[Trial]) -> PoseNoise:
    """Noise of the poses: as declared, otherwise from the scatter of neighbouring rows, their rounding, and
    the scatter while the object rests."""
    position, angle = setup.noise.position, setup.noise.angle
    if position is not None and angle is not None:
        return PoseNoise(position, angle)
    of_position = of_angle = NONE_LASTS
    dense = [trial.object_pose.values for trial in trials if len(trial.object_pose.time) >= _ENOUGH]
    typical = np.median([white_noise(poses) for poses in dense] or np.zeros((1, 3)), axis=0)
    typical = np.maximum(typical, rounding_noise(dense))
    rests = [rest for trial in trials for rest in rests_of(setup, trial)]
    # A sensor that repeats rows appears to have no noise.
    if position is None:
        white = float(np.hypot(typical[0], typical[1]) / np.sqrt(2.0))
        position, of_position = lasting_noise([rest[:, :2] for rest in rests], white, 1e-4)
    if angle is None:
        angle, of_angle = lasting_noise([rest[:, 2:] for rest in rests], float(typical[2]), 1e-3)
    return PoseNoise(position, angle, of_position, of_angle, assumed=not dense)


def lasting_noise(rests: Sequence[FloatArray], white: float, least: float) -> tuple[float, Lasting]:
    """Standard deviation of the noise of a sensor, and how much of it lasts.

    Args:
        rests: rows (T, c) of c channels with the same noise, one array a rest.
        white: the deviation that neighbouring rows show.
        least: smallest deviation that counts; the larger of the two is returned where rests show no more.
    """
    unchanged = max(white, least), NONE_LASTS
    lengths = np.sort([len(rest) for rest in rests if len(rest) > _SHORTEST])
    if len(lengths) < _FEWEST:
        return unchanged
    # At least half of the rests, and enough of them, are so long.
    length = int(lengths[min(len(lengths) // 2, len(lengths) - _FEWEST)])
    apart = int(_DISTANCE * length)
    square, count = _half_mean_square(rests, apart)
    if square <= max(white, least) ** 2 * (1.0 + _SIGNIFICANCE / np.sqrt(count)) ** 2:
        return unchanged
    # Outliers are in the differences of neighbours as well, noise that lasts hardly is.
    near, _ = _half_mean_square(rests, 1)
    if square <= near * (1.0 + _SIGNIFICANCE / np.sqrt(count)) ** 2:
        return unchanged
    by_far = square - white**2
    by_half = _half_mean_square(rests, apart // 2)[0] - white**2
    # exp(-k/2τ) from the growth between half the distance k and all of it.
    limits = np.exp(-0.5 / np.array([_SHORTEST_MEMORY, _LONGEST_MEMORY]))
    kept = float(np.clip(by_far / max(by_half, 1e-3 * by_far) - 1.0, *limits))
    lasting = by_far / (1.0 - kept**2)
    total = white**2 + lasting
    return float(np.sqrt(total)), Lasting(lasting / total, -0.5 * apart / float(np.log(kept)))


def _half_mean_square(rests: Sequence[FloatArray], apart: int) -> tuple[float, int]:
    """Half the mean square of differences of rows so far apart, and the number of differences, without rests
    that are unlike most others."""
    squares = [0.5 * (rest[apart:] - rest[:-apart]) ** 2 for rest in rests if len(rest) > apart]
    means = np.array([one.mean() for one in squares])
    alike = np.concatenate(
        [one.ravel() for one, mean in zip(squares, means, strict=True) if mean <= _UNLIKE * np.median(means)]
    )
    return float(alike.mean()), len(alike)


def rests_of(setup: Setup, trial: Trial) -> list[FloatArray]:
    """Poses (T, 3) of the rests before the finger comes near and after it has left or stopped.

    Of the second only the later half counts: an object that was struck slides on for a while.
    """
    if trial.ends_only or not trial.finger_near(setup.reach) or trial.initial_velocity().any():
        return []
    poses = trial.object_pose.values
    times = pose_times(trial)
    path_times, path = finger_path(trial)
    tips = interpolated(times, path_times, path)
    few = min(5, len(poses))
    first, last = np.median(poses[:few], axis=0), np.median(poses[-few:], axis=0)
    near = np.flatnonzero(gaps(setup, tips, first) < _CLEAR)
    before = poses[: near[0]] if len(near) else poses[:0]
    moving = np.hypot(*(tips - tips[-1]).T) > _STANDING
    busy = np.flatnonzero((gaps(setup, tips, last) < _CLEAR) & moving)
    begun = int(busy[-1]) + 1 if len(busy) else len(poses)
    after = poses[(begun + len(poses) + 1) // 2 :]
    return [rest for rest in (before, after) if len(rest)]
