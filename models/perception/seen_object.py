"""Results of the first look: an object's footprint, heights and cells, in its own frame.

The border of the object's pixels is a staircase. The heights locate it better: along a line across an edge
they fall from the object's height to the table's, and pass half of it at the edge. Best-fitting straight
lines replace the points found this way. Two distortions of edges in a picture are corrected:

- Blur cuts corners: it passes a square corner at a distance of 0.8 of its standard deviation. A short edge
  between two long ones that meet just outside it becomes their corner.
- An edge with a rounded top seems to lie too far inside, where half the height is reached. Such an edge shows
  in a fall that is wider than blur and the visible flank make it: the fall over a quarter circle of radius r
  has its mean 0.215 r inside the foot, and a standard deviation of 0.223 r.

One picture samples an edge at its pixels alone, so its lines are off by a quarter of a pixel. At each place
where the object rests, they sample it anew. `sharpened` averages the offsets of the outline seen at all of
these places, and fits the polygon whose blurred outline this is. Offsets are measured where the object starts
to rise from the table, which no rounded top moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import cv2
import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d, median_filter
from scipy.spatial import cKDTree
from shapely.geometry import LinearRing, Polygon

from slipmap.models.geometry import cross
from slipmap.models.measurements.trial import Trial
from slipmap.models.objects.footprints import rings_of, without_small_holes
from slipmap.models.objects.images import border_middles, straightened, traced_outline
from slipmap.models.perception.edge_kernels import SPACING, Land, Shape
from slipmap.models.perception.object_mask import Fault, HeightPicture, Heights, Mask
from slipmap.models.perception.pinhole_camera import TablePlane, View, pixel_size
from slipmap.models.perception.sharp_outline import sharp_ring
from slipmap.models.physics.cell_grid import CellGrid, FloatArray

_INSETS = np.array([1.0, 2.0, 3.0])  # pixels inside an edge; the largest height there is the edge's height
_SPECK = 0.01  # of the object's area; smaller holes are noise
_ACROSS = np.arange(-5.0, 4.01, 0.25)  # pixels along a line across the edge, outwards
_FARTHEST = 1.5  # pixels; largest shift of a point
_ROUNDS = 2
_TURNING = 1.5  # points over which the border's direction is averaged
_STRIP = 0.5  # pixels; the half width of the strip in which an edge counts as straight
_SHARPEST = 10.0  # percentile of the falls along a ring that estimates the picture's blur,
_BLUR = 1.1**2, 1.2**2  # within these variances, pixels²
_DOUBT = 1.5e-3  # m pixels²; divided by the edge's height: variance that noise may add to the fall
_QUARTILES = 1.349  # distance between the quartiles of a normal distribution, in standard deviations
_INSIDE = 0.9  # standard deviations from the middle of a rounded fall out to its foot
_MOST_ROUND = 1.0  # pixels²
_CLEAR_FLANK = 0.75  # pixels²; variance of a fall along a flank of 3 pixels
_SUDDEN = 0.25  # of that variance; a smaller one shows no flank
_ALONG = 11  # points of the median filter on the width of the fall
_CUT = 4.0  # pixels; a longer edge is not a cut corner
_CORNER = 1.0  # pixels from the blurred outline to the corner that it cuts
_SQUARE = np.sin(np.deg2rad(30.0))  # blur does not visibly cut flatter corners
_RIM = 0.75  # pixels inside the outline, where the edge's own height is read
_RIPPLE = 4.0  # points of the outline over which its direction is averaged
_SPACING = 1.5  # pixels between points of the outline
_STRAIGHT = 0.15  # pixels; corners that deviate less from the outline are dropped
_NEIGHBOURS = 4  # readings whose median is a height
_FOR_PLANE = 12  # readings to which a plane is fitted at the rim
_WALL, _STEEP = 2.0, 6.0  # a reading lower than a neighbour by more (pixels, slope) is not on the top
_FOOT_POINTS = 300
# The outline is seen in heights cut off at half the height of its lowest edges, within these limits, m.
_LOW, _LOWEST_EDGES = (5e-3, 12e-3), 10.0  # percentile
# A top that is rounded towards its rim falls with the root of the distance to it. A line fitted to heights so
# far inside (m), over that root, gives the rim's: the median over so many points, at least a share of the
# edge's height.
_BESIDE_RIM, _RIM_POINTS, _LEAST_RIM = np.array([2e-3, 3e-3, 4e-3, 5e-3]), 31, 0.4
_SEEN_BLUR = 1.1  # pixels; standard deviation of the blur of heights, a pixel's size and its smoothing
_SCATTER = 0.18  # pixels by which the outline seen at one place deviates, standard deviation
_LOOKS = 6  # pictures of the object at rest whose offsets are averaged; at least as many as start a trial
_ELSEWHERE = np.array([2e-3, 2e-3, np.deg2rad(1.0)])  # m, m, rad; a place farther from the last is another
_SEEN_WELL = 0.9  # of the points seen at the first look
UNSEEN_ANGLE = 1.0  # standard deviation of the angle of an object whose angle cannot be seen, rad
Reason = Literal["", "no object", "occluded", "left the table"] | Fault


@dataclass(frozen=True, eq=False)
class ObservedPose:
    """Pose of the object frame O in W as seen in one picture, or why it could not be seen."""

    # (3,) x, y (m) and theta (rad) of O in W; NaN if not valid. Theta is continuous across poses, beyond ±pi.
    pose: FloatArray
    covariance: FloatArray  # (3, 3) of the pose, m², m rad, rad²; NaN if not valid
    valid: bool  # whether the object was seen
    # empty, or why not: "no object" (none was seen yet, or a different one is seen), "occluded" (the arm
    # hides too much of it), "left the table", or the fault of the picture
    reason: Reason = ""
    time: float = 0.0  # at which the picture was taken, s
    detail: str = ""  # more about the reason, for the reader; may be empty

    @property
    def why(self) -> str:
        """Why the object could not be seen, in words."""
        return self.detail or self.reason or "no picture"

    @staticmethod
    def of(pose: ArrayLike, time: float = 0.0, covariance: FloatArray | None = None) -> ObservedPose:
        """A pose from anywhere, such as a tracker of your own.

        Args:
            pose: (3,) x, y (m) and theta (rad) of O in W. Theta must continue beyond ±pi instead of jumping.
                NaN or infinite numbers, as of a tracker that lost the object, make a missing pose.
            time: at which the object had this pose, s.
            covariance: (3, 3), m², m rad, rad²; zero if None.

        Raises:
            ValueError: another shape.
        """
        spread = np.zeros((3, 3)) if covariance is None else np.asarray(covariance, dtype=float)
        values = np.asarray(pose, dtype=float)
        if values.shape != (3,) or spread.shape != (3, 3):
            raise ValueError(
                "ObservedPose.of: pose must be x, y and theta (3,), covariance (3, 3); got the shapes"
                f" {values.shape} and {spread.shape}"
            )
        if not (np.isfinite(values).all() and np.isfinite(spread).all()):
            return ObservedPose.unseen("no object", time, "the tracker reports no finite pose")
        return ObservedPose(values, spread, True, "", time)

    @staticmethod
    def unseen(reason: Reason, time: float = 0.0, detail: str = "") -> ObservedPose:
        """A missing pose, with the reason."""
        return ObservedPose(np.full(3, np.nan), np.full((3, 3), np.nan), False, reason, time, detail)


def angle_held(trial: Trial) -> bool:
    """Whether the angle is exactly constant over a recorded push, because it could not be seen."""
    return bool(np.ptp(trial.object_pose.values[:, 2]) == 0.0)


@dataclass(frozen=True, eq=False)
class Outline:
    """Points along the object's outline."""

    points: FloatArray  # (m, 2) m
    normals: FloatArray  # (m, 2) unit vectors out of the object
    heights: FloatArray  # (m,) height of the object's edge over the table there, m


@dataclass(frozen=True, eq=False)
class Relief:
    """Height of the object's top over the points of a square grid in O, 0 outside the footprint."""

    corner: FloatArray  # (2,) the grid's first point in O, m
    heights: NDArray[np.float32]  # (rows, columns) m; rows along y, columns along x, 1 mm apart

    @staticmethod
    def from_cloud(polygon: Polygon, points: FloatArray, tops: FloatArray, pixel: float) -> Relief:
        """Heights inside a footprint in O, from readings (k,) at points (k, 2) about one pixel apart, m."""
        on_top = ~_on_flank(points, tops, pixel)
        points, tops = points[on_top], tops[on_top]
        tree = cKDTree(points)
        x0, y0, x1, y1 = polygon.bounds
        # A margin of one point, so that the distance to the outside is known everywhere.
        x = np.arange(x0 - SPACING, x1 + 2 * SPACING, SPACING)
        y = np.arange(y0 - SPACING, y1 + 2 * SPACING, SPACING)
        grid = np.stack(np.meshgrid(x, y), axis=-1)
        inside = shapely.contains_xy(polygon, grid[..., 0], grid[..., 1])
        heights = np.zeros(inside.shape, np.float32)
        _, index = tree.query(grid[inside], k=min(_NEIGHBOURS, len(points)))
        heights[inside] = np.median(tops[np.asarray(index).reshape(inside.sum(), -1)], axis=1)
        # No reading lies on the rim itself, and a rounded top keeps falling up to it.
        to_rim = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 5) * SPACING
        rim = inside & (to_rim < pixel)
        if len(points) >= _FOR_PLANE and np.any(rim):
            index = np.asarray(tree.query(grid[rim], k=_FOR_PLANE)[1])
            heights[rim] = _on_planes(grid[rim], points[index], tops[index])
        return Relief(np.array([x[0], y[0]]), np.maximum(heights, 0.0))

    def at(self, points: FloatArray) -> FloatArray:
        """Heights (...) of the grid points nearest to points (..., 2) in O, m; 0 outside the grid."""
        nearest = np.rint((points - self.corner) / SPACING).astype(int)
        size = np.array(self.heights.shape[::-1])
        columns, rows = np.moveaxis(np.clip(nearest, 0, size - 1), -1, 0)
        beside = np.any((nearest < 0) | (nearest >= size), axis=-1)
        return np.where(beside, 0.0, self.heights[rows, columns].astype(float))

    def smooth(self, points: FloatArray, window: float) -> tuple[FloatArray, FloatArray]:
        """Heights (k,) at points (k, 2) in O, m, and slopes (k, 2), averaged with a Gaussian.

        `window` is its standard deviation, m; the points must lie farther than that inside the footprint.
        """
        smooth = cv2.GaussianBlur(self.heights, (0, 0), window / SPACING)
        slopes = [cv2.Sobel(smooth, cv2.CV_32F, *axis, scale=1 / (8 * SPACING)) for axis in ((1, 0), (0, 1))]
        read = [Relief(self.corner, field).at(points) for field in (smooth, *slopes)]
        return read[0], np.stack(read[1:], axis=-1)

    def land(self, table: TablePlane) -> Land:
        """The relief on a table, for kernels."""
        plane = np.array([table.slope_x, table.slope_y, table.height])
        heights = np.array(self.heights, np.float32, order="C")
        return Land(plane, np.array(self.corner, dtype=float), heights, float(heights.max()))


@dataclass(frozen=True, eq=False)
class SeenObject:
    """An object as the camera saw it at rest, in its own frame.

    The object frame O has its origin on the table at the centroid of the footprint. At the first look its
    axes are parallel to those of W, to the fraction of a degree to which a pose can be measured.
    """

    grid: CellGrid  # cells and outline in O
    cell_heights: FloatArray  # (n,) median height of the object's top over each cell, m
    # (3,) x, y, theta of O in W at the first look, measured in the same way as later poses, so that their
    # difference is the object's motion; theta is nearly 0
    first_pose: FloatArray
    outline: Outline  # points along the rings in O, with the height of the edge
    # (m,) height of the object just inside the outline's points, m: smaller where it is rounded
    rim_heights: FloatArray
    inner_points: FloatArray  # (k, 2) points inside the footprint in O, m, on a square grid
    inner_heights: FloatArray  # (k,) height of the object's top there, m
    inner_slopes: FloatArray  # (k, 2) slopes of the top there, along O's axes
    relief: Relief  # heights over the whole footprint
    table: TablePlane  # plane of the table in W
    angle_seen: bool = True  # whether pictures show the angle; that of a round object is held
    # mean misfit in its own picture, see `mean_misfits`, caused by details finer than pixels
    misfit: float = 0.0

    @cached_property
    def shape(self) -> Shape:
        """The object, for kernels."""
        parts = (
            self.outline.points, self.outline.normals, self.outline.heights, self.rim_heights,
            self.inner_points, self.inner_heights, self.inner_slopes,
        )  # fmt: skip
        return Shape(self.relief.land(self.table), *(np.array(part, float, order="C") for part in parts))

    @cached_property
    def foot(self) -> Foot:
        """The outline's points as `sharpened` moves them."""
        polygon = self.grid.polygon
        low = float(np.clip(np.percentile(self.outline.heights, _LOWEST_EDGES) / 2, *_LOW))
        nearest, rings = cKDTree(self.outline.points), []
        at_rim = np.linalg.pinv(np.column_stack([np.ones(len(_BESIDE_RIM)), np.sqrt(_BESIDE_RIM)]))[0]
        for k, ring in enumerate((polygon.exterior, *polygon.interiors)):
            points, normals = _points_along(ring, outer=k == 0, spacing=polygon.length / _FOOT_POINTS)
            beside = [_along_ring(self.relief.at(points - d * normals)[:, None]) for d in _BESIDE_RIM]
            least = _LEAST_RIM * self.outline.heights[nearest.query(points)[1]]
            rims = np.clip(at_rim @ beside, np.minimum(least, beside[0]), beside[0])
            rims = median_filter(rims, min(_RIM_POINTS, len(rims)), mode="wrap")
            rings.append((points, normals, np.full(len(points), low), rims))
        points, normals, edges, rims = (np.concatenate(part) for part in zip(*rings, strict=True))
        shape = self.shape._replace(points=points, normals=normals, edges=edges, rims=rims)
        return Foot(shape, low, tuple(len(ring[0]) for ring in rings))


class Foot(NamedTuple):
    """The outline where the object meets the table."""

    shape: Shape  # with its points, normals, heights of the lowest part of the edge, and of the rim
    low: float  # height above which that part is cut off, m
    sizes: tuple[int, ...]  # number of points on each ring, the exterior first


@dataclass(frozen=True, eq=False)
class Rests:
    """Offsets of the outline seen at the places where the object rested.

    Offsets (m,) are those of the points of `SeenObject.foot` along their normals, m, NaN where nothing is
    seen, rounded to whole micrometres, as they are kept in files.
    """

    offsets: tuple[FloatArray, ...]  # at each place, averaged over its looks
    place: FloatArray  # (3,) pose of O in W at the last place
    looks: tuple[FloatArray, ...] = ()  # offsets so far at that place, empty once they are averaged
    complete: bool = True  # whether they are

    def wants(self, pose: FloatArray) -> bool:
        """Whether another look at an object at a pose (3,) counts."""
        return not self.complete or bool((np.abs(pose - self.place) > _ELSEWHERE).any())

    def with_look(self, pose: FloatArray, offsets: FloatArray) -> Rests:
        """With another look at the object, at a pose (3,); one from which much is hidden does not count."""
        # A place is complete once the object has rested there; while it slides slowly, it begins anew. Less
        # than half would take the noise of poses at rest for sliding.
        limit = _ELSEWHERE if self.complete else _ELSEWHERE / 2.0
        if (np.abs(pose - self.place) > limit).any():
            return replace(self, place=pose, looks=(), complete=False).with_look(pose, offsets)
        if np.isfinite(offsets).sum() < _SEEN_WELL * np.isfinite(self.offsets[0]).sum():
            return self
        looks = (*self.looks, offsets)
        if len(looks) < _LOOKS:
            return replace(self, looks=looks)
        return Rests((*self.offsets, mean_offsets(looks)), self.place)


def mean_offsets(looks: Sequence[FloatArray]) -> FloatArray:
    """(m,) mean of offsets (m,), without those that are NaN, m; rounded to whole micrometres."""
    seen = np.isfinite(looks)
    total = np.where(seen, looks, 0.0).sum(axis=0)
    count = seen.sum(axis=0)
    return np.where(count > 0, np.round(1e6 * total / np.maximum(count, 1)) * 1e-6, np.nan)


def sharpened(seen: SeenObject, offsets: Sequence[FloatArray], pixel: float) -> CellGrid:
    """The object's cells with the outline, corners sharp, that all places where the object rested show.

    Args:
        offsets: (m,) at each place, as in `Rests`; none leave the outline as it is.
        pixel: side of a pixel on the table, m.
    """
    if not offsets:
        return seen.grid
    foot = seen.foot
    shift = np.clip(np.nan_to_num(mean_offsets(offsets)), -_FARTHEST * pixel, _FARTHEST * pixel)
    points = (foot.shape.points + shift[:, None] * foot.shape.normals) / pixel
    # Next to corners, points may have passed each other.
    rings = [_simple(Polygon(ring)).exterior for ring in np.split(points, np.cumsum(foot.sizes)[:-1])]
    noise = _SCATTER / np.sqrt(len(offsets))
    lines = [sharp_ring(np.array(ring.coords)[:-1], _SEEN_BLUR, noise) for ring in rings]
    polygon = _simple(Polygon(lines[0], lines[1:]))
    # Whole micrometres are the same on every processor.
    exterior, holes = rings_of(shapely.transform(polygon, lambda corners: np.round(corners * pixel, 6)))
    return replace(seen.grid, exterior=exterior, holes=holes)


class Ring(NamedTuple):
    """One ring of an object in the picture: corners (k, 2), column and row."""

    edge: LinearRing  # where the picture has half the object's height, as a tracker sees it
    foot: LinearRing  # where the object ends, farther out if its edge is rounded


class Footprint(NamedTuple):
    """Area of the table that an object covers, in W, m."""

    polygon: Polygon  # where the object ends
    edge: Polygon  # where the picture shows its edge, farther inside if that is rounded
    outline: Outline  # points along the rings of `edge`


def footprint(mask: Mask, heights: Heights, raw: Heights, plane: TablePlane, view: View) -> Footprint:
    """Outline in W, and the height of its edges, of the object whose pixels are a mask (H, W), in one piece.

    `contour` gives the outline in the picture. Each of its points is mapped to the world at the height at
    which the object is seen there, not at the table's: a top 100 mm high, seen 0.4 m off the axis, would
    otherwise appear shifted by 40 mm. `heights` (H, W) are smoothed, `raw` ones keep sharp edges, m. Where
    the camera looks at a flank, that is upright, or hidden below the rim, as a bowl's is.
    """
    pictures = HeightPicture(heights), HeightPicture(raw)
    rings = contour(mask, pictures[0], plane, view)
    overhung = _overhung(rings[0].edge, pictures[0], plane, view)
    feet, edges = (
        [_in_world(ring, k == 0, *pictures, plane, view, overhung) for k, ring in enumerate(side)]
        for side in ([ring.foot for ring in rings], [ring.edge for ring in rings])
    )
    parts = ([getattr(edge, name) for edge in edges] for name in ("points", "normals", "heights"))
    return Footprint(_polygon(feet, view), _polygon(edges, view), Outline(*map(np.concatenate, parts)))


def outline_of(polygon: Polygon, spacing: float) -> tuple[FloatArray, FloatArray]:
    """Points (m, 2) about `spacing` apart along all rings of a polygon, and outward normals (m, 2)."""
    parts = [_points_along(polygon.exterior, outer=True, spacing=spacing)]
    parts += [_points_along(ring, outer=False, spacing=spacing) for ring in polygon.interiors]
    points, normals = zip(*parts, strict=True)
    return np.concatenate(points), np.concatenate(normals)


def contour(mask: Mask, heights: HeightPicture, plane: TablePlane, view: View) -> list[Ring]:
    """Rings of the object, the exterior first, without openings below 1 % of the object's area.

    The mask (H, W) has the object's pixels, in one piece; the heights are smoothed; the plane is the table's.
    """
    rings = []
    for k, points in enumerate(border_middles(mask)[0]):
        if k and Polygon(points).area <= _SPECK * mask.sum():
            continue
        for _ in range(_ROUNDS):
            normals = _normals(points, outer=k == 0)
            shift = _crossings(points, normals, heights, (0.5,))[0]
            points = points + np.clip(np.nan_to_num(shift), -_FARTHEST, _FARTHEST)[:, None] * normals
        normals = _normals(points, outer=k == 0)
        inside = _INSIDE * np.sqrt(np.clip(_roundness(points, normals, heights, plane, view), 0, _MOST_ROUND))
        rings.append(Ring(_cornered(points), _cornered(points + inside[:, None] * normals)))
    if all(Polygon(side[0], side[1:]).is_valid for side in zip(*rings, strict=True)):
        return rings
    # Too small for fitted lines: a few pixels wide.
    traced = without_small_holes(traced_outline(mask), _SPECK * mask.sum())
    return [Ring(ring, ring) for ring in (traced.exterior, *traced.interiors)]


def _polygon(rings: list[Outline], view: View) -> Polygon:
    shape = _simple(Polygon(rings[0].points, [ring.points for ring in rings[1:]]))
    return _simple(shape.simplify(_STRAIGHT * pixel_size(view)))


def _simple(shape: shapely.Geometry) -> Polygon:
    """The largest part of a shape whose rings may have crossed themselves by a pixel."""
    valid = shapely.make_valid(shape, method="structure", keep_collapsed=False)
    parts = [part for part in shapely.get_parts(valid) if isinstance(part, Polygon)]
    return max(parts, key=lambda part: part.area)


def _in_world(
    ring: LinearRing,
    outer: bool,
    smoothed: HeightPicture,
    sharp: HeightPicture,
    plane: TablePlane,
    view: View,
    overhung: bool,
) -> Outline:
    pixels, normals = _along_border(ring, outer)
    edge = _edge_heights(pixels, normals, smoothed)
    rim = sharp.at(pixels - _RIM * normals)
    rim = _along_ring(np.where(np.isfinite(rim), rim, edge)[:, None])  # upright, unless seen to be rounded
    foot = plane.meet(pixels, 0.0, view)
    beyond = plane.meet(pixels + normals, 0.0, view) - foot
    outward = beyond / np.linalg.norm(beyond, axis=1, keepdims=True)
    # On the far side the top hides the foot, and the edge lies on the ray past the rim. On the near side the
    # flank is seen, and the outline is at half its height.
    far = np.sum((foot - view.p_WC[:2]) * outward, axis=1) > 0
    seen_at = np.where(far | overhung, np.maximum(rim, edge / 2), edge / 2)
    return Outline(plane.meet(pixels, seen_at, view), outward, edge)


def _along_border(ring: LinearRing, outer: bool) -> tuple[FloatArray, FloatArray]:
    """Points (m, 2) along a ring in the picture, and outward normals (m, 2)."""
    pixels, normals = _points_along(ring, outer=outer, begin=0.0)
    # The side that an edge faces must not change with every ripple of the traced outline.
    return pixels, _smooth_directions(normals, _RIPPLE)


def _points_along(
    ring: LinearRing, *, outer: bool, spacing: float = _SPACING, begin: float = 0.5
) -> tuple[FloatArray, FloatArray]:
    """Points along a ring and outward normals; on each side the first is `begin` spacings from a corner."""
    corners = np.asarray(ring.coords)[:-1, :2]
    if ring.is_ccw != outer:
        corners = corners[::-1]  # the object lies to the left
    points, normals = [], []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        length = float(np.hypot(*(b - a)))
        if length == 0:
            continue
        number = max(1, round(length / spacing))
        share = (np.arange(number) + begin) / number
        points.append(a + share[:, None] * (b - a))
        normals.append(np.tile(np.array([b[1] - a[1], a[0] - b[0]]) / length, (number, 1)))
    return np.concatenate(points), np.concatenate(normals)


def _edge_heights(points: FloatArray, normals: FloatArray, heights: HeightPicture) -> FloatArray:
    """(m,) height of the object next to points (m, 2) of its border with outward normals, m."""
    return _along_ring(heights.at(points[:, None, :] - _INSETS[:, None] * normals[:, None, :]))


def _along_ring(heights: FloatArray) -> FloatArray:
    """(m,) largest of heights (m, k) at each point of a ring, smoothed along it; missing ones count as 0."""
    highest = np.nanmax(np.column_stack([heights, np.zeros(len(heights))]), axis=1)
    return median_filter(highest, size=min(9, len(highest)), mode="wrap")


def _normals(points: FloatArray, *, outer: bool) -> FloatArray:
    """(m, 2) unit vectors out of the object at the points of a ring."""
    along = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    along = _smooth_directions(along, _TURNING)
    sense = 1.0 if LinearRing(points).is_ccw == outer else -1.0
    return sense * np.column_stack([along[:, 1], -along[:, 0]])


def _smooth_directions(vectors: FloatArray, over: float) -> FloatArray:
    """(m, 2) unit vectors, averaged along a ring over about `over` points."""
    smooth = gaussian_filter1d(vectors, min(over, len(vectors) / 8), axis=0, mode="wrap")
    return smooth / np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-9)


def _crossings(
    points: FloatArray, normals: FloatArray, heights: HeightPicture, levels: tuple[float, ...]
) -> FloatArray:
    """(levels, m) pixels outwards from each point to where the height falls below shares of the edge's.

    The crossing nearest to the point counts; NaN if there is none.
    """
    edge = np.maximum(_edge_heights(points, normals, heights), 1e-4)
    fall = heights.at(points[:, None, :] + _ACROSS[:, None] * normals[:, None, :]) / edge[:, None]
    found = np.empty((len(levels), len(points)))
    for row, level in zip(found, levels, strict=True):
        above, below = fall[:, :-1] - level, fall[:, 1:] - level
        crosses = (above >= 0) & (below < 0)
        share = np.divide(above, above - below, out=np.zeros_like(above), where=crosses)
        place = np.where(crosses, _ACROSS[:-1] + share * np.diff(_ACROSS), np.inf)
        nearest = np.abs(place).argmin(axis=1)
        row[:] = place[np.arange(len(points)), nearest]
    return np.where(np.isfinite(found), found, np.nan)


def _roundness(
    points: FloatArray, normals: FloatArray, heights: HeightPicture, plane: TablePlane, view: View
) -> FloatArray:
    """(m,) variance of the fall in excess of blur and an upright flank, pixels²; 0 where unknown."""
    fall, flank = _falls(points, normals, heights, plane, view)
    variance = fall - flank
    known = np.isfinite(variance)
    blur = np.clip(np.percentile(variance[known], _SHARPEST), *_BLUR) if known.any() else _BLUR[0]
    top = _edge_heights(points, normals, heights)
    excess = np.where(known, variance - blur - _DOUBT / np.maximum(top, 1e-3), 0.0)
    return median_filter(excess, size=min(_ALONG, len(points)), mode="wrap")


def _overhung(ring: LinearRing, heights: HeightPicture, plane: TablePlane, view: View) -> bool:
    """Whether heights fall at once, as at the rim of a bowl, where they would fall along an upright flank."""
    fall, flank = _falls(*_along_border(ring, True), heights, plane, view)
    clear = np.isfinite(fall) & (flank > _CLEAR_FLANK)
    return bool(clear.any() and np.median((fall[clear] - _BLUR[0]) / flank[clear]) < _SUDDEN)


def _falls(
    points: FloatArray, normals: FloatArray, heights: HeightPicture, plane: TablePlane, view: View
) -> tuple[FloatArray, FloatArray]:
    """(m,) variances of the fall across an edge, NaN where unknown, and of an upright flank, pixels²."""
    outside, inside = _crossings(points, normals, heights, (0.25, 0.75))
    foot = plane.meet(points, 0.0, view)
    beyond = plane.meet(points + normals, 0.0, view) - foot
    pixel = np.linalg.norm(beyond, axis=1)
    towards_camera = np.sum((view.p_WC[:2] - foot) * beyond, axis=1) / pixel
    top = _edge_heights(points, normals, heights)
    flank = np.maximum(towards_camera, 0.0) * top / (view.p_WC[2] - top) / pixel
    return ((outside - inside) / _QUARTILES) ** 2, flank**2 / 12


def _cornered(points: FloatArray) -> LinearRing:
    """The ring of straight lines fitted to points (m, 2), with the corners restored that blur has cut."""
    polygon = Polygon(points)
    if not polygon.is_valid:
        return polygon.exterior
    kept = polygon.simplify(_STRIP)
    assert isinstance(kept, Polygon)
    corners = list(straightened(points, kept.exterior))
    passed = cKDTree(points)
    while len(corners) > 4:
        restored = _with_a_corner_more(np.array(corners), passed)
        if restored is None:
            break
        corners = restored
    return LinearRing(corners)


def _with_a_corner_more(corners: FloatArray, passed: cKDTree) -> list[FloatArray] | None:
    """Corners (k, 2) with the shortest cut replaced by one corner, or None if there is no cut.

    `passed` holds the points to which the lines were fitted.
    """
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    for k in np.argsort(lengths):
        if lengths[k] > _CUT:
            return None
        before, after = (k - 1) % len(corners), (k + 1) % len(corners)
        a, b = sides[before] / lengths[before], sides[after] / lengths[after]
        turn = cross(a, b)
        if abs(turn) < _SQUARE:
            continue
        onwards, backwards = cross(sides[k], b) / turn, -cross(sides[k], a) / turn
        if onwards < 0 or backwards < 0:
            continue
        corner = corners[k] + onwards * a
        if passed.query(corner)[0] < _CORNER:
            restored = list(corners)
            restored[k] = corner
            del restored[after]
            return restored
    return None


def _on_flank(points: FloatArray, tops: FloatArray, pixel: float) -> NDArray[np.bool_]:
    """(k,) whether readings lie on an upright side: much higher ones are right next to them."""
    distance, index = (np.asarray(a) for a in cKDTree(points).query(points, k=min(6, len(points))))
    rise = tops[index.reshape(len(points), -1)] - tops[:, None]
    beside = distance.reshape(len(points), -1) < 1.5 * pixel
    flank = np.any(beside & (rise > np.maximum(_WALL * pixel, _STEEP * distance.reshape(rise.shape))), axis=1)
    return flank if not np.all(flank) else np.zeros_like(flank)


def _on_planes(at: FloatArray, points: FloatArray, tops: FloatArray) -> FloatArray:
    """(m,) heights at (m, 2) on planes fitted to points (m, k, 2) of heights (m, k), within their range."""
    middle = points.mean(axis=1)
    arm = points - middle[:, None]
    mean = tops.mean(axis=1)
    spread = np.einsum("mki,mkj->mij", arm, arm) + 1e-12 * np.eye(2)
    moment = np.einsum("mki,mk->mi", arm, tops - mean[:, None])
    slope = np.linalg.solve(spread, moment[..., None])[..., 0]
    plane = mean + np.sum(slope * (at - middle), axis=1)
    return np.clip(plane, tops.min(axis=1), tops.max(axis=1))
