"""The arm in the picture: convex hulls around its links, drawn where the camera sees them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from models.perception.camera import View
from models.perception.object_mask import Mask
from models.physics.cell_grid import FloatArray

_NEAREST = 0.05  # m; what is closer to the camera's plane is drawn as if at this depth, far outside
_FARTHEST_PIXEL = 10_000
_MANY = 8  # balls; of more, only those at the border are drawn
_CIRCLE = np.linspace(0, 2 * np.pi, 24, endpoint=False)
_DISC = np.column_stack([np.cos(_CIRCLE), np.sin(_CIRCLE)])


class Hull(NamedTuple):
    """Convex hull of balls: two make a capsule, the eight corners with radius 0 a box.

    Attributes:
        points: (k, 3) the balls' centres in W, m.
        radius: of the balls, m.
    """

    points: FloatArray
    radius: float


def draw_hulls(hulls: Sequence[Hull], view: View, margin: float = 0.008) -> Mask:
    """(H, W) pixels that may show one of the hulls.

    Args:
        hulls: around the arm's links and whatever it holds.
        view: the camera.
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
