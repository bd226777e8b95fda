"""The pinhole camera, and the table in its depth pictures.

Pixel coordinates are (column, row), integers at the centres of pixels. The camera frame C has x to the right
of the picture, y to its bottom and z along the view; depth is the z coordinate in C, not the distance.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slipmap.models.perception.edge_kernels import Lens
from slipmap.models.physics.cell_grid import FloatArray

DepthImage = NDArray[np.float32]


@dataclass(frozen=True)
class PinholeCamera:
    """Intrinsics of a camera without lens distortion.

    Attributes:
        width, height: picture size, pixels.
        focal_x, focal_y: focal lengths, pixels.
        center_x, center_y: where the optical axis meets the picture, pixels.

    Raises:
        ValueError: a size or focal length is not positive.
    """

    width: int
    height: int
    focal_x: float
    focal_y: float
    center_x: float
    center_y: float

    def __post_init__(self) -> None:
        for name in ("width", "height", "focal_x", "focal_y"):
            if not getattr(self, name) > 0:
                raise ValueError(f"camera: {name} must be positive, got {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class View:
    """A camera at its pose in the world.

    Raises:
        ValueError: X_WC is not a rigid transform.
    """

    camera: PinholeCamera
    X_WC: FloatArray  # (4, 4) pose of the camera in W

    def __post_init__(self) -> None:
        X_WC = np.asarray(self.X_WC, dtype=float)
        if X_WC.shape != (4, 4) or not np.all(np.isfinite(X_WC)):
            raise ValueError(f"camera: X_WC must be a finite (4, 4) matrix, got shape {X_WC.shape}")
        R_WC = X_WC[:3, :3]
        if not np.allclose(R_WC @ R_WC.T, np.eye(3), atol=1e-6) or np.linalg.det(R_WC) < 0:
            raise ValueError("camera: the upper left (3, 3) block of X_WC is not a rotation")
        object.__setattr__(self, "X_WC", X_WC)

    @property
    def p_WC(self) -> FloatArray:
        """(3,) position of the camera in W, m."""
        return self.X_WC[:3, 3]

    @cached_property
    def lens(self) -> Lens:
        """The camera at its pose, for kernels."""
        camera, R_WC = self.camera, np.array(self.X_WC[:3, :3], order="C")
        # Integers would make the kernels compile again.
        focal_x, focal_y = float(camera.focal_x), float(camera.focal_y)
        center_x, center_y = float(camera.center_x), float(camera.center_y)
        return Lens(focal_x, focal_y, center_x, center_y, R_WC, np.array(self.p_WC))

    @cached_property
    def rays(self) -> NDArray[np.float32]:
        """(H, W, 3) directions of the pixels in W, of depth 1: a point is p_WC + depth · ray."""
        camera = self.camera
        x = (np.arange(camera.width) - camera.center_x) / camera.focal_x
        y = (np.arange(camera.height) - camera.center_y) / camera.focal_y
        R_WC = self.X_WC[:3, :3]
        rays = x[None, :, None] * R_WC[:, 0] + y[:, None, None] * R_WC[:, 1] + R_WC[:, 2]
        return rays.astype(np.float32)

    def rays_at(self, pixels: FloatArray) -> FloatArray:
        """(..., 3) directions in W of pixel coordinates (..., 2), of depth 1."""
        camera = self.camera
        x = (pixels[..., 0] - camera.center_x) / camera.focal_x
        y = (pixels[..., 1] - camera.center_y) / camera.focal_y
        return np.stack([x, y, np.ones_like(x)], axis=-1) @ self.X_WC[:3, :3].T

    def project(self, p_W: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixel coordinates (..., 2) and depth (...) of points (..., 3) in W, m.

        Points at or behind the camera have no pixel: NaN.
        """
        camera = self.camera
        p_C = (p_W - self.p_WC) @ self.X_WC[:3, :3]
        depth = p_C[..., 2]
        z = np.where(depth > 1e-6, depth, np.nan)
        u = camera.focal_x * p_C[..., 0] / z + camera.center_x
        v = camera.focal_y * p_C[..., 1] / z + camera.center_y
        return np.stack([u, v], axis=-1), depth

    def checked_depth(self, depth: DepthImage) -> DepthImage:
        """The depth image as (H, W), without a trailing axis of one channel.

        Raises:
            ValueError: the shape is not that of the camera's pictures.
        """
        image = np.asarray(depth, dtype=np.float32)
        if image.ndim == 3 and image.shape[2] == 1:
            image = image[:, :, 0]
        if image.shape != (self.camera.height, self.camera.width):
            raise ValueError(
                f"depth image: expected the camera's {self.camera.height} rows and"
                f" {self.camera.width} columns, got shape {image.shape}"
            )
        return image


def pixel_size(view: View) -> float:
    """Side of a pixel on the plane z = 0 of W where the camera looks at it, m."""
    camera = view.camera
    return float(view.p_WC[2] / -view.X_WC[2, 2] / np.sqrt(camera.focal_x * camera.focal_y))


SEARCHED = 0.04  # m; the table is searched this far above and below W's z = 0

_SAMPLED = 20_000  # pixels; enough for a plane
_BINS = 40
_ROUNDS = 12
_WIDEST, NARROWEST = 0.012, 0.004  # m; distance of inliers from the plane, from the first to the last round
LEAST_SHARE = 0.02  # of the picture


class NoTable(ValueError):
    """There is no table in the picture. The text says where it was searched."""


@dataclass(frozen=True)
class TablePlane:
    """The table's top z = slope_x x + slope_y y + height in W."""

    # slope_x, slope_y: of a table that is not quite level in W
    slope_x: float = 0.0
    slope_y: float = 0.0
    height: float = 0.0  # at W's origin, m

    def at(self, xy: FloatArray) -> FloatArray:
        """Height (...) of the table at points (..., 2), m."""
        return self.slope_x * xy[..., 0] + self.slope_y * xy[..., 1] + self.height

    def meet(self, pixels: FloatArray, heights: FloatArray | float, view: View) -> FloatArray:
        """x and y in W (..., 2), m, where the rays of pixels (..., 2) reach a height (...) over the table."""
        rays = view.rays_at(pixels)
        normal = np.array([-self.slope_x, -self.slope_y, 1.0])
        depth = (heights + self.height - normal @ view.p_WC) / (rays @ normal)
        return view.p_WC[:2] + depth[..., None] * rays[..., :2]

    def lift(self, xy: FloatArray, heights: FloatArray | float) -> FloatArray:
        """(..., 3) points in W at a height (...) over the table above (..., 2), m."""
        return np.concatenate([xy, (self.at(xy) + heights)[..., None]], axis=-1)

    def heights(
        self, depth: DepthImage, view: View, rows: slice = slice(None), columns: slice = slice(None)
    ) -> NDArray[np.float32]:
        """Height over the table of each pixel of a part of the picture, m; NaN where there is no reading.

        Pixels beyond the camera's range count as far below the table: -inf.
        """
        part = depth[rows, columns]
        # Height is linear in depth along a ray, so one product per pixel is enough.
        normal = np.array([-self.slope_x, -self.slope_y, 1.0])
        along = view.rays[rows, columns] @ normal.astype(np.float32)
        start = np.float32(normal @ view.p_WC - self.height)
        heights = start + part * along
        heights[~(part > 0)] = np.nan
        return heights


def fit_table(depth: DepthImage, view: View) -> TablePlane:
    """Fit the table's plane, from the most frequent height, by least squares on ever closer pixels.

    The fit starts at the most frequent height near z = 0, so the table may fill less than half of the
    picture, as long as nothing else near that height fills more.

    Args:
        depth: (H, W) depth, m; 0 or NaN where there is no reading.
        view: the camera, with z = 0 of W within 40 mm of the table.

    Raises:
        NoTable: too few readings, too few near z = 0, or no plane among them.
    """
    step = max(1, int(np.sqrt(depth.size / _SAMPLED)))
    sampled = depth[::step, ::step].astype(float)
    rays = view.rays[::step, ::step].astype(float)
    seen = np.isfinite(sampled) & (sampled > 0)
    if not (sampled > 0).sum() >= LEAST_SHARE * sampled.size:
        raise NoTable(f"no table: only {(sampled > 0).sum()} of {sampled.size} sampled pixels have a reading")
    points = view.p_WC + sampled[seen][:, None] * rays[seen]
    near = points[np.abs(points[:, 2]) < SEARCHED]
    if len(near) < LEAST_SHARE * sampled.size:
        raise NoTable(
            f"no table: only {len(near)} of {sampled.size} sampled pixels lie within {1e3 * SEARCHED:.0f} mm "
            f"of z = 0 in the world frame; check the camera's pose X_WC and what the camera sees"
        )
    count, border = np.histogram(near[:, 2], bins=_BINS, range=(-SEARCHED, SEARCHED))
    highest = int(np.argmax(count[:-1] + count[1:]))
    plane = np.array([0.0, 0.0, border[highest + 1]])
    columns = np.column_stack([near[:, :2], np.ones(len(near))])
    for width in np.geomspace(_WIDEST, NARROWEST, _ROUNDS):
        close = np.abs(near[:, 2] - columns @ plane) < width
        if close.sum() < LEAST_SHARE * sampled.size:
            raise NoTable(
                "no table: too few of the points near z = 0 in the world frame lie in one plane; check that"
                " the table fills enough of the picture, and the camera's noise"
            )
        plane = np.linalg.lstsq(columns[close], near[close, 2], rcond=None)[0]
    return TablePlane(*(float(value) for value in plane))
