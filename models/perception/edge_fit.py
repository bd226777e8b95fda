"""The pose at which the object's outline lies on the edges in a depth picture.

Points along the outline are projected into the picture; along the normal of each, the heights are searched
for the place at which they fall through half the edge's height. So are the heights that the camera would see
of the object at the present pose, and Gauss-Newton moves the pose until the two places agree. This is RAPID
(Harris and Stennett, BMVC 1990) with depth for brightness, and with the edges' places predicted from the
object's relief: what the camera takes for an edge of a tall or rounded object depends on where it stands.
Slopes inside the outline tell of the pose as well: heights read there are compared with the relief's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.perception.camera import View, pixel_size
from models.perception.edge_kernels import (
    Heights,
    Land,
    Lens,
    Shape,
    edges_expected,
    edges_found,
    heights_off,
    lines_across,
    mean_misfits,
)
from models.perception.object_mask import HeightPicture
from models.perception.seen_object import SeenObject
from models.physics.cell_grid import FloatArray

_HUBER = 1.0  # pixels
_SETTLED = 0.02  # pixels
_UNCHANGED = 0.3  # pixels; after a smaller move, edges are expected where they were on their lines
# Neighbouring points read the same pixels: a point every pixel, pixels smoothed over three.
_CORRELATED = 4.0


@dataclass(frozen=True, eq=False)
class EdgeFit:
    """Result of a fit.

    Attributes:
        pose: (3,) x, y, theta of O in W.
        covariance: (3, 3), from the scatter of the edges about the fitted outline; infinite if the edges
            that were found do not determine the pose.
        found: share of the outline's points with an edge within reach.
        scatter: root mean square distance of these edges from the outline, pixels.
    """

    pose: FloatArray
    covariance: FloatArray
    found: float
    scatter: float


def load_kernels() -> None:
    """Compile what a fit calls, or load it: before the first picture, which should not have to wait."""
    points, numbers, map_of_nothing = np.zeros((1, 2)), np.zeros(1), np.zeros((2, 2), np.float32)
    lens = Lens(1.0, 1.0, 0.0, 0.0, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    land = Land(np.zeros(3), np.zeros(2), map_of_nothing, 0.0)
    shape = Shape(land, points, points, numbers, numbers, points, numbers, points)
    picture, pose = Heights(map_of_nothing, 0.0, 0.0), np.zeros(3)
    lines = lines_across(lens, shape, pose)
    edges_expected(lens, shape, pose, lines)
    edges_found(picture, shape, lines, 1.0)
    heights_off(picture, lens, shape, pose, 1.0)
    mean_misfits(picture, lens, shape, pose[None], 1.0, 1)


def placed(pose: FloatArray, points: FloatArray) -> FloatArray:
    """Points (..., 2) of O in W."""
    return turned(pose, points) + pose[:2]


def turned(pose: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (..., 2) of O in W."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return vectors @ np.array([[c, s], [-s, c]])


def fit_edges(
    picture: HeightPicture, view: View, seen: SeenObject, start: FloatArray, reaches: Sequence[float]
) -> EdgeFit:
    """Fit the outline to the edges in a picture, from a pose near by.

    Args:
        picture: smoothed heights, NaN where the arm is.
        view: the camera.
        seen: the object.
        start: (3,) pose to start from.
        reaches: how far edges are searched, pixels: one step of Gauss-Newton each.
    """
    pose = np.array(start, dtype=float)
    fit = EdgeFit(pose, np.full((3, 3), np.inf), 0.0, np.inf)
    heights, lens, shape, pixel = picture.for_kernels, view.lens, seen.shape, pixel_size(view)
    expected: FloatArray | None = None
    moved = 0.0  # pixels, since the edges' places were predicted
    for k, reach in enumerate(reaches):
        lines = lines_across(lens, shape, pose)
        if expected is None or moved > _UNCHANGED:
            expected, moved = edges_expected(lens, shape, pose, lines), 0.0
        distance = edges_found(heights, shape, lines, reach) - expected
        found = np.isfinite(distance)
        if found.sum() < 6:
            return fit
        off = heights_off(heights, lens, shape, pose, pixel)
        off = off[np.isfinite(off[:, 0])]
        d = np.concatenate([distance[found], off[:, 0]])
        J = np.concatenate([lines[found, 4:], off[:, 1:]])
        weight = np.minimum(1.0, max(_HUBER, reach / 4) / np.maximum(np.abs(d), 1e-9))
        information = J.T @ (weight[:, None] * J)
        if np.linalg.cond(information * _scale(seen)) > 1e8:
            return fit
        step = np.linalg.solve(information, J.T @ (weight * d))
        pose = pose + step
        change = float(np.abs(J @ step).max())
        moved += change
        scatter = float(np.sqrt(np.sum(weight * d * d) / weight.sum()))
        fit = EdgeFit(
            pose,
            _CORRELATED * scatter**2 * np.linalg.inv(information),
            float(found.mean()),
            scatter,
        )
        if change < _SETTLED and moved <= _UNCHANGED and all(later >= reach for later in reaches[k + 1 :]):
            break
    return fit


def misfits(
    picture: HeightPicture, view: View, seen: SeenObject, poses: FloatArray, every: int = 1
) -> FloatArray:
    """How badly heights inside, and the table outside, agree with a picture.

    Args:
        picture, view, seen: as of `fit_edges`.
        poses: (k, 3) of O in W.
        every: which points are looked at: each, each second, …

    Returns:
        (k, 2): 0 is perfect, 1 fits nowhere; and the share of the points inside that are seen.
    """
    poses = np.array(poses, dtype=float)
    return mean_misfits(picture.for_kernels, view.lens, seen.shape, poses, pixel_size(view), every)


def _scale(seen: SeenObject) -> FloatArray:
    """Makes the angle's part of the information comparable with that of the position."""
    size = np.array([1.0, 1.0, 1.0 / np.sqrt(np.mean(np.sum(seen.outline.points**2, axis=1)))])
    return np.outer(size, size)
