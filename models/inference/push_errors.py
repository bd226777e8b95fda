"""How far a prediction is off, push by push: ADD, position, angle, fit in percent, force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from models.inference.centroid import at_centroid, radius_of_gyration
from models.inference.observations import Observation
from models.inference.predicted_motion import PredictedMotion
from models.physics.cell_grid import CellGrid, FloatArray
from models.physics.paper_notation import add


@dataclass(frozen=True)
class Errors:
    """Errors of one prediction of one push; NaN where a number does not exist.

    Attributes:
        final_add: mean distance of the cells at the end, m.
        mean_add: the same averaged over the compared poses; the final one where only the end was measured.
        position: distance of the object frame's origin at the end, m.
        angle: absolute error of the angle at the end, rad.
        fit: 100 (1 - ‖y - ŷ‖ / ‖y - mean(y)‖) over all poses, the angle weighed with the cells' radius of
            gyration; the NRMSE fit of MATLAB's `compare`. 100 is perfect, 0 as good as the mean pose.
        fit_x: the same for x alone; strongly negative where the object hardly moves along x.
        fit_y: for y.
        fit_theta: for the angle.
        force: root mean square of the force error where the finger presses steadily, N.
        force_share: the same over the root mean square of the measured force.
    """

    final_add: float
    mean_add: float
    position: float
    angle: float
    fit: float
    fit_x: float
    fit_y: float
    fit_theta: float
    force: float
    force_share: float

    def to_json(self) -> dict[str, float]:
        """All numbers by name."""
        return asdict(self)


def errors(observation: Observation, poses: FloatArray, forces: FloatArray | None, grid: CellGrid) -> Errors:
    """Compare predicted poses (S, 3) and forces (T, 2) with one push; no forces where None."""
    measured = observation.poses
    distance = add(poses, measured, grid.centers)
    force, share = np.nan, np.nan
    used = observation.sliding
    if forces is not None and used.any():
        force = _rms(forces[used] - observation.forces[used])
        share = force / _rms(observation.forces[used])
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
    )


def resting_errors(observation: Observation, grid: CellGrid) -> Errors:
    """The baseline of an object that does not move."""
    still = np.broadcast_to(observation.push.start_pose, observation.poses.shape)
    return errors(observation, still, None, grid)


def motion_errors(
    observations: Sequence[Observation], motions: Sequence[PredictedMotion], grid: CellGrid
) -> list[Errors]:
    """Errors of the judged prediction of each push."""
    return [
        errors(observation, motion.middle_poses(grid), motion.mean_forces, grid)
        for observation, motion in zip(observations, motions, strict=True)
    ]


def nrmse_fit(measured: FloatArray, predicted: FloatArray) -> float:
    """Fit in percent of predicted rows (S, c); NaN where the measured rows do not vary (one row)."""
    spread = float(np.linalg.norm(measured - measured.mean(axis=0)))
    if spread == 0.0:
        return float("nan")
    return 100.0 * (1.0 - float(np.linalg.norm(measured - predicted)) / spread)


def _rms(vectors: FloatArray) -> float:
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))
