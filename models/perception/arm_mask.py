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
    camera = view.camera
    focal = max(camera.focal_x, camera.focal_y)
    picture = np.zeros((camera.height, camera.width), np.uint8)
    for hull in hulls:
        p_C = (np.asarray(hull.points, dtype=float) - view.p_WC) @ view.X_WC[:3, :3]
        depth = p_C[:, 2]
        if np.all(depth < _NEAREST):
            continue
        depth = np.maximum(depth, _NEAREST)
        center = np.column_stack(
            [
                camera.focal_x * p_C[:, 0] / depth + camera.center_x,
                camera.focal_y * p_C[:, 1] / depth + camera.center_y,
            ]
        )
        # Off the axis a ball looks like an ellipse, longer by the secant of the angle: a disc that covers it.
        secant = np.hypot(1.0, np.hypot(p_C[:, 0], p_C[:, 1]) / depth)
        radius = (hull.radius + margin) * focal / depth * secant
        discs = center[:, None] + radius[:, None, None] * _DISC
        first, last = discs.min(axis=(0, 1)), discs.max(axis=(0, 1))
        if (last < -1.0).any() or (first > [camera.width, camera.height]).any():
            continue  # none of it is in the picture
        corners = np.clip(discs.reshape(-1, 2), -_FARTHEST_PIXEL, _FARTHEST_PIXEL)
        cv2.fillConvexPoly(picture, cv2.convexHull(np.round(corners).astype(np.int32)), 255)
    return picture > 0
