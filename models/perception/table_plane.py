"""The table in a depth image: a plane, fitted so that what stands on it does not matter."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slipmap.models.perception.pinhole_camera import DepthImage, View
from slipmap.models.physics.cell_grid import FloatArray

SEARCHED = 0.04  # m; the table is looked for this far above and below W's z = 0

_SAMPLED = 20_000  # pixels; enough for a plane
_BINS = 40
_ROUNDS = 12
_WIDEST, NARROWEST = 0.012, 0.004  # m; what belongs to the table, from the first to the last round
LEAST_SHARE = 0.02  # of the picture


class NoTable(ValueError):
    """There is no table in the picture. The text says where it was looked for."""


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
        """x and y in W (..., 2), m, where the rays of pixels (..., 2) pass a height (...) over the table."""
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

        What lies beyond the camera's range is far below the table: -inf.
        """
        part = depth[rows, columns]
        # Height is linear in depth along a ray, so one product a pixel is enough.
        normal = np.array([-self.slope_x, -self.slope_y, 1.0])
        along = view.rays[rows, columns] @ normal.astype(np.float32)
        start = np.float32(normal @ view.p_WC - self.height)
        heights = start + part * along
        heights[~(part > 0)] = np.nan
        return heights


def fit_table(depth: DepthImage, view: View) -> TablePlane:
    """Plane of the table, from the level of most pixels, then least squares on ever closer ones.

    The most frequent height near z = 0 starts the fit, so the table may fill less than half of the picture,
    as long as nothing else near that height fills more.

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
                "no table: too few of the points near z = 0 in the world frame lie in one plane: see whether"
                " the"
                " table fills enough of the picture, and the camera's noise"
            )
        plane = np.linalg.lstsq(columns[close], near[close, 2], rcond=None)[0]
    return TablePlane(*(float(value) for value in plane))
