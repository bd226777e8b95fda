"""The first look: footprint, heights and cells of an object at rest from depth pictures; and the picture
itself, stored for a later process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import cv2
import numpy as np
import shapely
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from shapely.geometry import Polygon

from slipmap.models.files import check_archive
from slipmap.models.objects.footprints import cells_from_polygon, rings_of
from slipmap.models.perception.edge_kernels import mean_misfits
from slipmap.models.perception.object_mask import (
    HIGHEST,
    LEAST_AREA,
    SMOOTHING,
    HeightPicture,
    Heights,
    Mask,
    least_height,
    object_mask,
    smoothed_heights,
)
from slipmap.models.perception.pinhole_camera import (
    DepthImage,
    PinholeCamera,
    TablePlane,
    View,
    fit_table,
    pixel_size,
)
from slipmap.models.perception.pose_tracking import fit_edges
from slipmap.models.perception.seen_object import (
    Footprint,
    Outline,
    Reason,
    Relief,
    SeenObject,
    footprint,
    outline_of,
    sharpened,
)
from slipmap.models.physics.cell_grid import CellGrid, FloatArray

_OUTLINE_POINTS = 300
_INNER_POINTS = 400
_INSET = 0.006  # m between inner points and the outline, less for narrow objects
_RIM = 1.5e-3  # m
ARM_NEAR = 6  # pixels between object and arm below which the first look waits
_REACHES = (4.0, *(3.0,) * 6)  # pixels
_TURNS = np.linspace(0.0, 2 * np.pi, 23, endpoint=False)  # a prime: no regular cog looks the same at each
_SLIGHT = np.deg2rad(np.linspace(-5.0, 5.0, 5))  # turns that no picture shows
_FOR_AXIS = 300  # readings
_AXIS_OFF = 6e-3  # m; first step of the search for the axis
_CLEARLY = 0.3  # mean square by which the readings stand out; those of round objects have up to 0.17
_HIDDEN = 1.0  # m; height of whatever hides a pixel without a reading
_PROUD, _LOW, _BESIDE = 3.5e-3, 0.3, 0.7  # m, of the object's height, pixels; what stands out less is noise
# Share of a turned object's pixels that stand out, at most, if it counts as round. Cans, plates, rings and
# bowls have up to 0.1, also when they are 3 % longer than wide; a square has 0.3, a box of 1 to 2 has 0.5.
_MOST_PROUD = 0.115
_LARGEST_FILE = 2**29  # bytes, unpacked; pictures are at most 4096 by 4096


class ObjectNotSeen(ValueError):
    """The first look found no object; `reason` as in `ObservedPose`."""

    def __init__(self, reason: Reason, text: str) -> None:
        super().__init__(text)
        self.reason: Reason = reason


def first_look(
    frames: Sequence[DepthImage], view: View, cells: int = 60, blocked: Mask | None = None
) -> SeenObject:
    """Find the object on the table in depth pictures of a scene at rest.

    Args:
        frames: at least one depth image (H, W), m; 0 or NaN where there is no reading, inf beyond the range.
            A pixel's reading is the median over the frames that have one; an odd number is best.
        cells: rough number of cells, see `cells_from_polygon`.
        blocked: (H, W) pixels that show the arm, such as from `draw_hulls`.

    Raises:
        NoTable: there is no table near z = 0 of W.
        ObjectNotSeen: nothing stands on the table; the arm hides part of it; or it reaches beyond the picture
            or is higher than 0.3 m.
        ValueError: there are no frames, or a picture has the wrong size.
    """
    if len(frames) == 0:
        raise ValueError("first look: needs at least one depth image")
    depth = median_depth([view.checked_depth(frame) for frame in frames])
    table, raw, heights, mask = _standing_object(depth, view, blocked)
    traced = footprint(mask, heights, raw, table, view)
    seen = _seen_object(traced, _cloud(mask, raw, depth, view), table, view, cells)
    seen = replace(seen, angle_seen=_angle_shown(mask, raw, heights, table, view))
    # The outline is traced, but poses are fitted to edges. If the first pose is fitted too, the difference
    # between the two methods cancels out of every motion.
    picture = HeightPicture(heights)
    seen = replace(seen, first_pose=fit_edges(picture, view, seen, seen.first_pose, _REACHES).pose)
    poses, pixel = seen.first_pose[None], pixel_size(view)
    ((misfit, _, _),) = mean_misfits(picture, view.lens, seen.shape, poses, pixel, 1)
    return replace(seen, misfit=float(misfit))


def _seen_object(
    seen_W: Footprint, cloud: tuple[FloatArray, FloatArray], table: TablePlane, view: View, cells: int
) -> SeenObject:
    """The object of a footprint, with points (k, 2) on its top and their heights (k,), m."""
    origin = np.asarray(seen_W.polygon.centroid.coords[0])
    polygon, edge = (shapely.transform(part, lambda xy: xy - origin) for part in seen_W[:2])
    grid = cells_from_polygon(*rings_of(polygon), about=cells)
    points, tops = cloud[0] - origin, cloud[1]
    relief = Relief.from_cloud(edge, points, tops, pixel_size(view))
    inner, outline = _inner_points(edge), _outline(edge, seen_W.outline, origin)
    inner_heights, inner_slopes = relief.smooth(inner, SMOOTHING * pixel_size(view))
    return SeenObject(
        grid=grid,
        cell_heights=_heights_of_cells(grid, relief, points, tops),
        first_pose=np.array([*origin, 0.0]),
        outline=outline,
        rim_heights=np.maximum(relief.at(outline.points - _RIM * outline.normals), outline.heights / 2),
        inner_points=inner,
        inner_heights=inner_heights,
        inner_slopes=inner_slopes,
        relief=relief,
        table=table,
    )


def _angle_shown(mask: Mask, raw: Heights, heights: Heights, table: TablePlane, view: View) -> bool:
    """Whether the object, turned about an upright axis, stands out of its own picture.

    Its readings, turned in all directions, are drawn into the picture: they show what the camera would see if
    the object were round. So it does not matter which parts of the object it hides by itself.
    """
    sharp = cv2.medianBlur(np.where(np.isfinite(raw), raw, np.float32(0)), 3)
    rows, columns = np.nonzero(mask & (sharp > 0))
    if len(rows) == 0:
        return True
    # In random order, so that the first of them are spread over the object.
    order = np.random.default_rng(0).permutation(len(rows))
    tops = sharp[rows, columns].astype(float)[order]
    points = table.meet(np.column_stack([columns, rows]).astype(float)[order], tops, view)
    least = min(_PROUD, _LOW * float(np.median(tops)))

    def turned(axis: FloatArray, turns: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
        """Pixels (k, 2) and heights (k,) of the first `count` readings at each of the turns."""
        c, s = np.cos(turns)[:, None], np.sin(turns)[:, None]
        x, y = (points[:count] - axis).T
        at = np.stack([axis[0] + c * x - s * y, axis[1] + s * x + c * y], axis=-1).reshape(-1, 2)
        level = np.tile(tops[:count], len(turns))
        return view.project(table.lift(at, level))[0], level

    picture = HeightPicture(np.where(np.isnan(heights), np.float32(_HIDDEN), sharp))

    def proud(axis: FloatArray) -> float:
        pixels, level = turned(axis, _TURNS, _FOR_AXIS)
        over = level - np.nan_to_num(picture.at(pixels))  # beside the picture nothing hides it
        return float(np.mean(np.clip(over / least, 0.0, 1.0) ** 2))

    middle = points.mean(axis=0)
    best = minimize(
        proud,
        middle,
        method="Nelder-Mead",
        bounds=np.column_stack([points.min(axis=0), points.max(axis=0)]),
        options={"initial_simplex": middle + _AXIS_OFF * np.array([[0, 0], [1, 0], [0, 1]]), "maxfev": 40},
    )
    if best.fun > _CLEARLY:
        return True

    def drawn(turns: FloatArray, count: int) -> Heights:
        pixels, level = turned(best.x, turns, count)
        inside = ((pixels > -0.5) & (pixels < np.array(mask.shape[::-1]) - 0.5)).all(axis=1)
        highest = np.zeros(mask.shape, np.float32)
        column, row = np.rint(pixels[inside]).astype(int).T
        np.maximum.at(highest, (row, column), level[inside].astype(np.float32))
        return cv2.GaussianBlur(highest, (0, 0), SMOOTHING)

    rounded = drawn(_TURNS, (len(tops) + 1) // 2)
    slopes = [cv2.Sobel(rounded, cv2.CV_32F, *along, scale=1 / 8) for along in ((1, 0), (0, 1))]
    tolerance = np.hypot(least, _BESIDE * np.hypot(*slopes))
    out = rounded - drawn(_SLIGHT, len(tops)) > tolerance
    covered = (rounded > least) & ~np.isnan(heights)
    return not covered.any() or bool((out & covered).sum() > _MOST_PROUD * covered.sum())


def object_center(frames: Sequence[DepthImage], view: View, blocked: Mask | None = None) -> FloatArray:
    """(2,) mean column and row of the object's pixels: a quick measure of whether it moves.

    Raises:
        NoTable, ObjectNotSeen: as in `first_look`.
    """
    depth = median_depth([view.checked_depth(frame) for frame in frames])
    *_, mask = _standing_object(depth, view, blocked)
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()])


def _standing_object(
    depth: DepthImage, view: View, blocked: Mask | None
) -> tuple[TablePlane, Heights, Heights, Mask]:
    """The table, raw and smoothed heights (H, W) over it, and the object's pixels, away from the arm."""
    table = fit_table(depth if blocked is None else np.where(blocked, np.float32(0), depth), view)
    raw = table.heights(depth, view)
    heights = smoothed_heights(raw, blocked)
    mask = object_mask(heights, view)
    if mask is None:
        raise ObjectNotSeen(
            "no object",
            f"nothing on the table is higher than the {1e3 * least_height(heights):.0f} mm that this camera"
            f" can distinguish from it and covers more than {1e4 * LEAST_AREA:.0f} cm²",
        )
    size = 2 * ARM_NEAR + 1
    around = cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    high = cv2.medianBlur((raw > HIGHEST).astype(np.uint8), 3) > 0
    if blocked is not None:
        if np.any(around & blocked):
            raise ObjectNotSeen("occluded", "the arm is in front of the object or next to it; move it away")
        high &= ~blocked
    if np.any(around & high):
        raise ObjectNotSeen(
            "no object", f"the object, or something next to it, is higher than {1e3 * HIGHEST:.0f} mm"
        )
    if mask[[0, -1]].any() or mask[:, [0, -1]].any():
        raise ObjectNotSeen("no object", "the object reaches beyond the picture; move it or the camera")
    return table, raw, heights, mask


def median_depth(frames: Sequence[DepthImage]) -> DepthImage:
    """Median of each pixel's readings, m; 0 where no frame has one, inf where most are beyond the range.

    A mean would turn jittering edges into slopes. Of two middle readings the nearer one is taken.
    """
    stack = np.stack(frames)
    stack[~(stack > 0)] = np.nan  # sorts to the end
    stack.sort(axis=0)
    count = np.sum(~np.isnan(stack), axis=0)
    middle = np.take_along_axis(stack, np.maximum(count - 1, 0)[None] // 2, axis=0)[0]
    return np.where(count > 0, middle, np.float32(0))


def _cloud(mask: Mask, heights: Heights, depth: DepthImage, view: View) -> tuple[FloatArray, FloatArray]:
    """Points (k, 2) of the object's pixels in W, each at its own depth, and their heights (k,), m."""
    used = mask & np.isfinite(heights) & np.isfinite(depth) & (depth > 0)
    xy = view.p_WC[:2] + depth[used][:, None].astype(float) * view.rays[used][:, :2]
    return xy, heights[used].astype(float)


def _heights_of_cells(grid: CellGrid, relief: Relief, cloud: FloatArray, tops: FloatArray) -> FloatArray:
    cell = np.asarray(cKDTree(grid.centers).query(cloud)[1])
    inside = np.abs(cloud - grid.centers[cell]).max(axis=1) <= grid.width / 2
    heights = relief.at(grid.centers)
    for k in np.unique(cell[inside]):
        heights[k] = np.median(tops[inside & (cell == k)])
    return heights


def _inner_points(polygon: Polygon) -> FloatArray:
    inset = min(_INSET, polygon.area / polygon.length / 2)
    inner = polygon.buffer(-inset)
    if inner.is_empty:
        return np.array(polygon.representative_point().coords)
    x0, y0, x1, y1 = inner.bounds
    step = np.sqrt(inner.area / _INNER_POINTS)
    x, y = np.meshgrid(np.arange(x0 + step / 2, x1, step), np.arange(y0 + step / 2, y1, step))
    within = shapely.contains_xy(inner, x.ravel(), y.ravel())
    points = np.column_stack([x.ravel(), y.ravel()])[within]
    return points if len(points) else np.array(inner.representative_point().coords)


def _outline(polygon: Polygon, traced: Outline, origin: FloatArray) -> Outline:
    points, normals = outline_of(polygon, polygon.length / _OUTLINE_POINTS)
    nearest = np.asarray(cKDTree(traced.points - origin).query(points)[1])
    return Outline(points, normals, traced.heights[nearest])


@dataclass(frozen=True, eq=False)
class FirstPicture:
    """The picture from which an object's cells were made."""

    depth: DepthImage  # (H, W) median of the pictures of the first look, m
    X_WC: FloatArray  # (4, 4) pose of the camera in W
    blocked: Mask  # (H, W) pixels that showed the arm
    cells: int  # wanted number of cells
    # noisy, missing: see `PictureHistory`
    noisy: bool
    missing: float

    def seen(self, camera: PinholeCamera) -> SeenObject:
        """Repeat the first look. Raises NoTable, ObjectNotSeen, ValueError as `first_look` does."""
        return first_look([self.depth], View(camera, self.X_WC), self.cells, self.blocked)

    def grid(self, camera: PinholeCamera, offsets: Sequence[FloatArray]) -> CellGrid:
        """The object's cells after it has rested at more places, see `sharpened`. Raises like `seen`."""
        return sharpened(self.seen(camera), offsets, pixel_size(View(camera, self.X_WC)))

    def save(self, file: IO[bytes]) -> None:
        """Write the picture, compressed, to a binary file."""
        np.savez_compressed(file, **vars(self))

    @staticmethod
    def load(path: Path) -> FirstPicture:
        """Read what `save` wrote.

        Raises:
            OSError, ValueError, KeyError, BadZipFile: the file cannot be read, or is of another kind.
        """
        check_archive(path, _LARGEST_FILE)
        with np.load(path, allow_pickle=False) as file:
            depth, X_WC, blocked = (file[name] for name in ("depth", "X_WC", "blocked"))
            return FirstPicture(
                depth, X_WC, blocked, int(file["cells"]), bool(file["noisy"]), float(file["missing"])
            )
