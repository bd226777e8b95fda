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
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from models.perception.camera import View, pixel_size
from models.perception.footprint import Outline
from models.perception.object_mask import SMOOTHING, HeightPicture
from models.perception.seen_object import SeenObject
from models.physics.cell_grid import FloatArray

_STEP = 0.5  # pixels between readings along a normal
_PREDICTED = 5.0  # pixels from an outline point within which its edge is expected in the picture
_HUBER = 1.0  # pixels
_TINY = 1e-4  # m
_HEIGHT_ERROR = 1.5e-3  # m; a height off by this, where the top is level, counts like an edge a pixel off
_LEAST_SLOPE = 0.05
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
    expected: FloatArray | None = None
    moved = 0.0  # pixels, since the edges' places were predicted
    for k, reach in enumerate(reaches):
        lines = _Lines.at(view, seen, pose)
        if expected is None or moved > _UNCHANGED:
            expected, moved = lines.expected_edges(view, seen, pose), 0.0
        distance = lines.edges(picture, seen, reach) - expected
        found = np.isfinite(distance)
        if found.sum() < 6:
            return fit
        height, slope = _height_residuals(picture, view, seen, pose)
        d = np.concatenate([distance[found], height])
        J = np.concatenate([lines.jacobian[found], slope])
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


def _scale(seen: SeenObject) -> FloatArray:
    """Makes the angle's part of the information comparable with that of the position."""
    size = np.array([1.0, 1.0, 1.0 / np.sqrt(np.mean(np.sum(seen.outline.points**2, axis=1)))])
    return np.outer(size, size)


@dataclass(frozen=True, eq=False)
class _Lines:
    """Lines in the picture across the outline, on which edges are searched.

    Attributes:
        pixels: (m, 2) where the outline's points are projected to.
        normals: (m, 2) unit vectors in the picture, out of the object.
        jacobian: (m, 3) how far the points move along the normals for a change of pose.
    """

    pixels: FloatArray
    normals: FloatArray
    jacobian: FloatArray

    @staticmethod
    def at(view: View, seen: SeenObject, pose: FloatArray) -> _Lines:
        outline, table = seen.outline, seen.table
        arm_W = turned(pose, outline.points)
        points, normals = arm_W + pose[:2], turned(pose, outline.normals)
        height = np.where(is_far(pose, outline, view), seen.rim_heights, outline.heights / 2)
        pixels, du_dx, du_dy = (
            view.project(table.lift(points + aside, height))[0] for aside in ([0, 0], [_TINY, 0], [0, _TINY])
        )
        du_dx, du_dy = (du_dx - pixels) / _TINY, (du_dy - pixels) / _TINY
        # The normal in the picture is at right angles to the outline's tangent there.
        tangent = du_dx * -normals[:, 1:] + du_dy * normals[:, :1]
        across = np.column_stack([tangent[:, 1], -tangent[:, 0]])
        outward = np.sum(across * (du_dx * normals[:, :1] + du_dy * normals[:, 1:]), axis=1)
        across *= (np.sign(outward) / np.linalg.norm(across, axis=1))[:, None]
        along_x, along_y = np.sum(across * du_dx, axis=1), np.sum(across * du_dy, axis=1)
        spin = along_y * arm_W[:, 0] - along_x * arm_W[:, 1]
        return _Lines(pixels, across, np.column_stack([along_x, along_y, spin]))

    def edges(self, picture: HeightPicture, seen: SeenObject, reach: float) -> FloatArray:
        """(m,) where on each line the edge in the picture lies, pixels; NaN if not within reach."""
        offsets = np.arange(-reach, reach + _STEP / 2, _STEP)
        return _falls_through(picture.at(self._points(offsets)), seen.outline.heights / 2, offsets)

    def expected_edges(self, view: View, seen: SeenObject, pose: FloatArray) -> FloatArray:
        """(m,) where on each line the edge should be if the object is at a pose, pixels."""
        offsets = np.arange(-_PREDICTED, _PREDICTED + _STEP / 2, _STEP)
        heights = seen.relief.seen_at(self._points(offsets), pose, seen.table, view)
        smoothed = gaussian_filter1d(heights, SMOOTHING / _STEP, axis=1, mode="nearest")
        return _falls_through(smoothed, seen.outline.heights / 2, offsets)

    def _points(self, offsets: FloatArray) -> FloatArray:
        return self.pixels[:, None, :] + offsets[:, None] * self.normals[:, None, :]


def is_far(pose: FloatArray, outline: Outline, view: View) -> NDArray[np.bool_]:
    """(m,) which points of an outline in O lie on edges that face away from the camera.

    There the top hides the foot, and the edge in the picture is the rim's; elsewhere the flank is seen.
    """
    away = placed(pose, outline.points) - view.p_WC[:2]
    return np.sum(away * turned(pose, outline.normals), axis=1) > 0


def _height_residuals(
    picture: HeightPicture, view: View, seen: SeenObject, pose: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Heights read at sloping points inside less those expected, and their change with the pose.

    Both are scaled such that 1 is as unlikely as an edge one pixel off.
    """
    steep = np.hypot(*seen.inner_slopes.T)
    arm_W, slope = turned(pose, seen.inner_points), turned(pose, seen.inner_slopes)
    pixels = view.project(seen.table.lift(arm_W + pose[:2], seen.inner_heights))[0]
    residual = picture.at(pixels) - seen.inner_heights
    # An object that moves uphill leaves lower places behind.
    change = -np.column_stack([slope, slope[:, 1] * arm_W[:, 0] - slope[:, 0] * arm_W[:, 1]])
    scale = 1 / np.hypot(_HEIGHT_ERROR, steep * pixel_size(view) / 2)
    used = np.isfinite(residual) & (steep > _LEAST_SLOPE)
    return (residual * scale)[used], (change * scale[:, None])[used]


def _falls_through(profile: FloatArray, level: FloatArray, offsets: FloatArray) -> FloatArray:
    """(m,) offset nearest to 0 at which a profile (m, k) falls through its level (m,), NaN if nowhere."""
    over = profile - level[:, None]
    falls = (over[:, :-1] >= 0) & (over[:, 1:] < 0)  # comparisons with NaN are false
    with np.errstate(invalid="ignore", divide="ignore"):
        where = offsets[:-1] + _STEP * over[:, :-1] / (over[:, :-1] - over[:, 1:])
    where = np.where(falls, where, np.inf)
    nearest = where[np.arange(len(where)), np.argmin(np.abs(where), axis=1)]
    return np.where(np.isfinite(nearest), nearest, np.nan)
