"""Pixels in a height picture: those of the object, which stands on the table in one piece, and those of the
arm, drawn as convex hulls around its links."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from slipmap.models.perception.edge_kernels import SMOOTHING
from slipmap.models.perception.pinhole_camera import View, pixel_size
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.compiled import LONE_FOLDER, compiled

Heights = NDArray[np.float32]
Mask = NDArray[np.bool_]

_LOWEST = -0.005  # m; lower readings, beside the table, count as this: how deep the floor is does not matter
_HIGHEST = 0.3  # m; nothing that stands on the table is higher
_LEAST_WEIGHT = 0.3  # of a smoothed pixel's neighbourhood that has readings
LEAST_AREA = 4e-4
"""What a camera takes for an object covers more of the table than this, m²,"""
LEAST_HEIGHT = 4e-3
"""and is higher, m; with much noise, than 4 standard deviations of the table's heights."""
_FAINT, _CLEAR = 2.0, 4.0  # in standard deviations of the table's heights
_FAINTEST = 2e-3  # m; the same for a table seen without noise
_RAGGED = 5  # pixels; what sticks out of an edge by less, and no further along it, is noise
_RIM = 2  # pixels; an edge blurred over less is taken at half its height

_NEAREST = 0.05  # m; what is closer to the camera's plane is drawn as if at this depth, far outside
_FARTHEST_PIXEL = 10_000
_MANY = 8  # balls; of more, only those at the border are drawn
_CIRCLE = np.linspace(0, 2 * np.pi, 24, endpoint=False)
_DISC = np.column_stack([np.cos(_CIRCLE), np.sin(_CIRCLE)])


class HeightPicture(NamedTuple):
    """Smoothed heights (h, w) of a part of a picture from a pixel on, m; NaN where nothing is seen."""

    values: Heights
    first_column: float = 0.0
    first_row: float = 0.0

    def at(self, pixels: FloatArray) -> FloatArray:
        """Heights (a, b) or (a,) at pixel coordinates (a, b, 2) or (a, 2), m; NaN beside missing readings."""
        where = (pixels - np.array([self.first_column, self.first_row])).astype(np.float32)
        flat = where.reshape(len(where), -1, 2)
        read = cv2.remap(
            self.values, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"),
        )  # fmt: skip
        return read.astype(float).reshape(pixels.shape[:-1])


def smoothed_heights(heights: Heights, blocked: Mask | None = None) -> Heights:
    """Heights (h, w) over the table, m, averaged with their neighbours; those the arm blocks are left out.

    NaN is no reading; small gaps are filled, larger ones stay.
    """
    seen = (heights < _HIGHEST) if blocked is None else (heights < _HIGHEST) & ~blocked
    weight = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), SMOOTHING)
    values = np.where(seen, np.maximum(heights, np.float32(_LOWEST)), np.float32(0))
    mean = cv2.GaussianBlur(values, (0, 0), SMOOTHING) / np.maximum(weight, np.float32(_LEAST_WEIGHT))
    mean[weight < _LEAST_WEIGHT] = np.nan
    if blocked is not None:
        mean[blocked] = np.nan
    return mean


def _table_noise(heights: Heights) -> float:
    """Standard deviation of the table's smoothed heights about zero, m, from the middle half of them."""
    table = np.abs(heights[np.abs(heights) < -0.9 * _LOWEST])
    return float(np.median(table) / 0.6745) if len(table) else 0.0


def least_height(heights: Heights) -> float:
    """Height over the table that tells an object from noise, in smoothed heights (H, W), m."""
    return max(LEAST_HEIGHT, _CLEAR * _table_noise(heights))


def object_mask(heights: Heights, view: View) -> Mask | None:
    """(H, W) pixels of the object in smoothed heights (H, W), m; None if nothing stands on the table.

    A pixel belongs to it if it is faintly higher than the table and joined to one that is so clearly; of
    several pieces the largest is the object. Pixels without a reading count if they lie between two of the
    object in their row or column, as on shiny metal; those along one side of it do not: the shadow that a
    tall object casts in stereo. An edge is taken at half the height that the object has beside it.
    """
    noise = _table_noise(heights)
    faint = heights > max(_FAINTEST, _FAINT * noise)
    faint = cv2.medianBlur(faint.astype(np.uint8), 3) > 0
    faint |= between(faint, np.isnan(heights))
    found = _largest_piece(faint, heights > least_height(heights), view)
    if found is None:
        return None
    found = _without_rim(found, heights)
    found = cv2.medianBlur(found.astype(np.uint8), _RAGGED) > 0
    return _largest_piece(found, found, view)


def _largest_piece(mask: Mask, seeds: Mask, view: View) -> Mask | None:
    number, pieces, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    area = stats[:, cv2.CC_STAT_AREA].astype(float)
    area[0] = 0.0
    area[np.bincount(pieces[seeds], minlength=number) == 0] = 0.0
    largest = int(np.argmax(area))
    if area[largest] * pixel_size(view) ** 2 < LEAST_AREA:
        return None
    return pieces == largest


def _without_rim(mask: Mask, heights: Heights) -> Mask:
    """The mask less the pixels by its border that are lower than half the height beside them."""
    filled = np.where(mask & np.isfinite(heights), heights, np.float32(0))
    size = 2 * _RIM + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    low = filled < cv2.dilate(filled, disc) / 2
    border = cv2.erode(mask.astype(np.uint8), disc, borderType=cv2.BORDER_CONSTANT, borderValue=1) == 0
    return mask & ~(low & border & np.isfinite(heights))


class Hull(NamedTuple):
    """Convex hull of balls: two make a capsule, the eight corners with radius 0 a box."""

    points: FloatArray  # (k, 3) the balls' centres in W, m
    radius: float  # of the balls, m


def draw_hulls(hulls: Sequence[Hull], view: View, margin: float = 0.008) -> Mask:
    """(H, W) pixels that may show one of the hulls.

    Args:
        hulls: around the arm's links and whatever it holds.
        margin: added around each, m; for the readings' jitter and small errors of the arm's pose.
    """
    camera, picture = view.camera, np.zeros((view.camera.height, view.camera.width), np.uint8)
    if not hulls:
        return picture > 0
    focal = max(camera.focal_x, camera.focal_y)
    sizes = [len(hull.points) for hull in hulls]
    first = np.concatenate([[0], np.cumsum(sizes)])
    p_C = (np.concatenate([hull.points for hull in hulls]) - view.p_WC) @ view.X_WC[:3, :3]
    behind = np.maximum.reduceat(p_C[:, 2], first[:-1]) < _NEAREST
    depth = np.maximum(p_C[:, 2], _NEAREST)
    center = np.column_stack(
        [
            camera.focal_x * p_C[:, 0] / depth + camera.center_x,
            camera.focal_y * p_C[:, 1] / depth + camera.center_y,
        ]
    )
    # Off the axis a ball looks like an ellipse, longer by the secant of the angle: a disc that covers it.
    secant = np.hypot(1.0, np.hypot(p_C[:, 0], p_C[:, 1]) / depth)
    radius = np.repeat([hull.radius + margin for hull in hulls], sizes) * focal / depth * secant
    low = np.minimum.reduceat(center - radius[:, None], first[:-1])
    high = np.maximum.reduceat(center + radius[:, None], first[:-1])
    beside = (high < -1.0).any(axis=1) | (low > [camera.width, camera.height]).any(axis=1)
    for hull in np.flatnonzero(~behind & ~beside):
        balls = np.arange(first[hull], first[hull + 1])
        if sizes[hull] > _MANY:  # those in the middle of the others are not at the border
            balls = balls[cv2.convexHull(center[balls].astype(np.float32), returnPoints=False).ravel()]
        discs = center[balls, None] + radius[balls, None, None] * _DISC
        corners = np.round(np.clip(discs, -_FARTHEST_PIXEL, _FARTHEST_PIXEL)).astype(np.int32)
        cv2.fillConvexPoly(picture, cv2.convexHull(corners.reshape(-1, 2)), 255)
    return picture > 0


@compiled(LONE_FOLDER, nogil=True)
def between(mask, missing):  # type: ignore[no-untyped-def]
    """(H, W) missing pixels in runs, along rows or columns, that end at the mask on both sides."""
    height, width = mask.shape
    found = np.zeros((height, width), np.bool_)
    above = np.full(width, -1)  # last row in each column that is known, if it is of the mask
    for row in range(height):
        left = -1
        for column in range(width):
            if missing[row, column]:
                continue
            if mask[row, column]:
                if left >= 0:
                    found[row, left + 1 : column] = True
                if above[column] >= 0:
                    found[above[column] + 1 : row, column] = True
                left, above[column] = column, row
            else:
                left, above[column] = -1, -1
    return found
