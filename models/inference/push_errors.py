"""Errors of the prediction of one push (ADD, position, angle, fit in percent, force), and the noise floor
from sensors or repeated pushes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ellipe, stdtrit

from slipmap.models.geometry import at_centroid, radius_of_gyration, relative, seen_from
from slipmap.models.inference.error_model import SensorNoise
from slipmap.models.inference.observations import Observation
from slipmap.models.measurements.motion import interpolated
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.paper_notation import add


@dataclass(frozen=True)
class Errors:
    """Errors of one prediction of one push; NaN where a number does not exist."""

    final_add: float  # mean distance of the cells at the end, m
    # the same averaged over the compared poses; equal to the final one where only the end was measured
    mean_add: float
    position: float  # distance of the object frame's origin at the end, m
    angle: float  # absolute error of the angle at the end, rad
    # 100 (1 - ‖y - ŷ‖ / ‖y - mean(y)‖) over all poses, with the angle times the cells' radius of gyration;
    # the NRMSE fit of MATLAB's `compare`. 100 is perfect, 0 no better than the mean pose.
    fit: float
    fit_x: float  # the same for x alone; strongly negative where the object hardly moves along x
    fit_y: float  # for y
    fit_theta: float  # for the angle
    force: float  # root mean square of the force error where the finger presses steadily, N
    # the same over the root mean square of the measured force; NaN if that is zero, as where a cable pulls
    # the object away from the finger
    force_share: float
    # root mean square, over all poses and the forces of steady pushing, of the error in standard deviations
    # of the sensor noise; 1 is perfect
    misfit: float


def errors(
    observation: Observation, poses: FloatArray, forces: FloatArray | None, grid: CellGrid, noise: SensorNoise
) -> Errors:
    """Compare predicted poses (S, 3) and forces (T, 2), or None for no forces, with one push."""
    measured = observation.poses
    distance = add(poses, measured, grid.centers)
    force, share = np.nan, np.nan
    used = observation.sliding
    if forces is not None and used.any():
        force, typical = _rms(forces[used] - observation.forces[used]), _rms(observation.forces[used])
        if typical > 0.0:
            share = force / typical
    # Rescale a mean of rows to the noise of a single row.
    missing = 1.0 - (noise.of_means(observation.pose_rows) / noise.of_poses) ** 2
    square = ((poses - measured) / noise.of_poses) ** 2 + missing
    squares = [square.ravel()]
    if forces is not None and used.any():
        squares.append(((forces[used] - observation.forces[used]) ** 2).ravel() / noise.force**2)
    radius = radius_of_gyration(grid)
    scaled, wanted = at_centroid(poses, grid), at_centroid(measured, grid)
    return Errors(
        final_add=float(distance[-1]),
        mean_add=float(distance.mean()),
        position=float(np.hypot(*(poses[-1, :2] - measured[-1, :2]))),
        angle=float(abs(poses[-1, 2] - measured[-1, 2])),
        fit=nrmse_fit(wanted * [1, 1, radius], scaled * [1, 1, radius]),
        fit_x=nrmse_fit(measured[:, :1], poses[:, :1]),
        fit_y=nrmse_fit(measured[:, 1:2], poses[:, 1:2]),
        fit_theta=nrmse_fit(measured[:, 2:], poses[:, 2:]),
        force=force,
        force_share=share,
        misfit=float(np.sqrt(np.concatenate(squares).mean())),
    )


LEAST_MISFIT = 0.25
"""Misfit, in units of the noise, below which pushes count as equally well met. A single pose has less in 2 %
of cases. Without it, a push that touches nothing could outweigh all others in a mean of logarithms."""


@dataclass(frozen=True)
class Paired:
    """Push-by-push comparison of two models' misfits on the same pushes."""

    # geometric mean over pushes of the ratio of the second model's misfit to the first's, so that one push
    # that starts near balance does not decide
    ratio: float
    # lower end of its 90 % interval, from the scatter over pushes (Student's t of the logarithms); 0 with
    # fewer than two pushes
    low: float
    high: float  # upper end; infinite with fewer than two pushes

    @classmethod
    def of(cls, first: FloatArray, second: FloatArray) -> Paired:
        """Compare misfits (L,) of the two models; at least one push."""
        logs = np.log(np.maximum(second, LEAST_MISFIT)) - np.log(np.maximum(first, LEAST_MISFIT))
        mean = float(logs.mean())
        if len(logs) < 2:
            return cls(float(np.exp(mean)), 0.0, float("inf"))
        width = float(stdtrit(len(logs) - 1, 0.95) * logs.std(ddof=1) / np.sqrt(len(logs)))
        return cls(*(float(np.exp(value)) for value in (mean, mean - width, mean + width)))

    @property
    def verdict(self) -> str:
        """Whether the pushes speak for or against the second model: `for`, `against` or `undecided`."""
        if self.high < 1.0:
            return "for"
        return "against" if self.low > 1.0 else "undecided"

    def to_json(self) -> dict[str, float | str | None]:
        """All fields, with null for an unknown end, and the verdict."""
        known = np.isfinite(self.high)
        ends = {"low": self.low if known else None, "high": self.high if known else None}
        return {"ratio": self.ratio, **ends, "verdict": self.verdict}


def resting_errors(observation: Observation, grid: CellGrid, noise: SensorNoise) -> Errors:
    """Errors of the baseline of an object that does not move."""
    still = np.broadcast_to(observation.push.start_pose, observation.poses.shape)
    return errors(observation, still, None, grid, noise)


def nrmse_fit(measured: FloatArray, predicted: FloatArray) -> float:
    """Fit in percent of predicted rows (S, c); NaN if the measured rows do not vary (one row)."""
    spread = float(np.linalg.norm(measured - measured.mean(axis=0)))
    if spread == 0.0:
        return float("nan")
    return 100.0 * (1.0 - float(np.linalg.norm(measured - predicted)) / spread)


def _rms(vectors: FloatArray) -> float:
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))


@dataclass(frozen=True)
class NoiseFloor:
    """Error below which two models cannot be told apart."""

    add: float  # ADD at the end of a push, m
    source: str  # `repeats`, `declared noise` or `estimated noise`
    repeats: int  # number of pushes that have a repeat
    groups: tuple[tuple[str, ...], ...]  # names of pushes that repeat each other


def noise_floor(observations: Sequence[Observation], noise: SensorNoise, grid: CellGrid) -> NoiseFloor | None:
    """Scatter of repeated pushes if there are any, otherwise `pose_floor`.

    Repeats take precedence because they include unintended differences from push to push.
    """
    groups = repeated_pushes(observations)
    if not groups:
        return pose_floor(noise, grid)
    scatter = [value for group in groups for value in _scatter([observations[b] for b in group], grid)]
    names = tuple(tuple(observations[b].trial for b in group) for group in groups)
    return NoiseFloor(float(np.mean(scatter)), "repeats", len(scatter), names)


def pose_floor(noise: SensorNoise, grid: CellGrid) -> NoiseFloor | None:
    """ADD due to the noise of one pose; None where that noise is only assumed.

    A cell at r is displaced by n + ν ẑ × r, n with standard deviation σ along each axis, ν with τ. Across r
    its variance is λ = σ² + τ² |r|², along r it is σ²; the mean length of such a vector is
    √(2 λ / π) E(1 − σ² / λ), with E the complete elliptic integral of the second kind.
    """
    if noise.assumed:
        return None
    across = noise.position**2 + noise.angle**2 * (grid.centers**2).sum(axis=1)
    lengths = np.sqrt(2.0 * across / np.pi) * ellipe(1.0 - noise.position**2 / np.maximum(across, 1e-300))
    return NoiseFloor(float(lengths.mean()), "declared noise" if noise.declared else "estimated noise", 0, ())


def repeated_pushes(observations: Sequence[Observation]) -> list[list[int]]:
    """Groups of two or more pushes that repeat each other: the finger tracks, seen from the object's start
    pose, never differ by more than 1.5 mm, nor the durations by more than 5 %.

    Each push joins the first group whose first push it repeats.
    """
    groups: list[list[int]] = []
    tracks = [_track(observation) for observation in observations]
    durations = [observation.push.h * (len(observation.push.tip) - 1) for observation in observations]

    def repeats(b: int, first: int) -> bool:
        one, other = tracks[b], tracks[first]
        if one is None or other is None:
            return False
        if max(durations[b], durations[first]) > 1.05 * min(durations[b], durations[first]):
            return False
        return bool(np.hypot(*(other - one).T).max() < 1.5e-3)

    for b in range(len(observations)):
        group = next((group for group in groups if repeats(b, group[0])), None)
        if group is None:
            groups.append([b])
        else:
            group.append(b)
    return [group for group in groups if len(group) > 1]


def _track(observation: Observation) -> FloatArray | None:
    """(21, 2) finger track as seen from the object's start pose, at even times; None without a finger."""
    push = observation.push
    if np.isnan(push.tip).any() or push.start_twist.any():
        return None
    rows = np.linspace(0, len(push.tip) - 1, 21)
    tip = interpolated(rows, np.arange(len(push.tip)), push.tip)
    return seen_from(tip, push.start_pose)


def _scatter(group: list[Observation], grid: CellGrid) -> FloatArray:
    """(n,) ADD of each end pose, seen from its start, to the group's mean; unbiased for small groups."""
    poses = np.array([relative(one.push.start_pose, one.poses[-1]) for one in group])
    return add(poses, poses.mean(axis=0), grid.centers) * np.sqrt(len(group) / (len(group) - 1))
