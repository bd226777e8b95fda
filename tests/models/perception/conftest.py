"""A camera over a table with boxes on it: exact pictures, from rays that meet boxes, without a renderer."""

from collections.abc import Callable, Sequence
from functools import cache
from itertools import product

import numpy as np
import pytest

from slipmap.models.perception.pinhole_camera import PinholeCamera, View

ABOVE = [[1.0, 0, 0, 0.02], [0, -1, 0, -0.01], [0, 0, -1, 1.1], [0, 0, 0, 1]]  # X_WC of a camera
SLANTED = [[0, 0.8, -0.6, 0.72], [1, 0, 0, 0], [0, -0.6, -0.8, 0.96], [0, 0, 0, 1]]  # by 37°
Box = tuple[float, float, float, float, float]  # x0, y0, x1, y1, height, object frame, m


@cache
def _rays(view: View) -> np.ndarray:
    return view.rays.astype(float)


@cache
def _empty_table(view: View, radius: float) -> np.ndarray:
    depth = -view.p_WC[2] / _rays(view)[..., 2]
    ground = view.p_WC + depth[..., None] * _rays(view)
    depth[np.hypot(ground[..., 0], ground[..., 1]) > radius] = np.inf
    return depth


class Scene:
    """Depth pictures of an object made of boxes, at a pose on a table at z = 0."""

    def __init__(self, X_WC: Sequence[Sequence[float]] = ABOVE) -> None:
        self.view = View(PinholeCamera(640, 480, 492.0, 492.0, 319.5, 239.5), np.array(X_WC))

    @property
    def rays(self) -> np.ndarray:
        """Directions of the pixels."""
        return _rays(self.view)

    def depth(self, boxes: Sequence[Box], pose: Sequence[float], table_radius: float = 0.5) -> np.ndarray:
        rays, start = self.rays, self.view.p_WC
        depth = _empty_table(self.view, table_radius).copy()
        c, s = np.cos(pose[2]), np.sin(pose[2])
        R_OW = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        p_WO = np.array([pose[0], pose[1], 0])
        begin = R_OW @ (start - p_WO)
        for x0, y0, x1, y1, height in boxes:
            ends = np.array(list(product((x0, x1), (y0, y1), (0.0, height))))
            there = self.around(ends @ R_OW + p_WO)
            along = rays[there] @ R_OW.T
            low, high = (
                (np.array([x0, y0, 0.0]) - begin) / along,
                (np.array([x1, y1, height]) - begin) / along,
            )
            enter, leave = np.minimum(low, high).max(axis=-1), np.maximum(low, high).min(axis=-1)
            depth[there] = np.where((enter < leave) & (enter < depth[there]), enter, depth[there])
        return depth.astype(np.float32)

    def around(self, p_W: np.ndarray) -> tuple[slice, slice]:
        """Rows and columns of the picture with all that lies between points, (n, 3), m."""
        pixels, _ = self.view.project(p_W)
        size = self.view.camera.width, self.view.camera.height
        (u0, v0), (u1, v1) = (
            np.clip(np.floor(at).astype(int), 0, size)
            for at in (pixels.min(axis=0) - 1, pixels.max(axis=0) + 2)
        )
        return slice(v0, v1), slice(u0, u1)

    def noisy(self, depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        noisy = depth + 1.5e-3 * rng.standard_normal(depth.shape)
        noisy[rng.random(depth.shape) < 0.01] = 0.0
        return noisy.astype(np.float32)


@pytest.fixture(scope="session")
def scene() -> Scene:
    return Scene()


@pytest.fixture(scope="session")
def slanted() -> Scene:
    return Scene(SLANTED)


@pytest.fixture(scope="session")
def look(scene: Scene) -> Callable[..., object]:
    """First look at an object of boxes at a pose, with noise."""
    from slipmap.models.perception.first_look import first_look

    def seen(boxes: Sequence[Box], pose: Sequence[float], seed: int = 0, **options: object) -> object:
        rng = np.random.default_rng(seed)
        depth = scene.depth(boxes, pose)
        return first_look([scene.noisy(depth, rng) for _ in range(9)], scene.view, **options)

    return seen
