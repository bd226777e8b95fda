"""Pixels of the object and of the arm in a height picture, and checks whether a depth picture is valid.

The object stands on the table in one piece; the arm is drawn as convex hulls around its links. A camera may
stop, repeat a picture, or send half of one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from slipmap.models.perception.edge_kernels import SMOOTHING
from slipmap.models.perception.pinhole_camera import DepthImage, View, pixel_size
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.compiled import LONE_FOLDER, compiled

Heights = NDArray[np.float32]
Mask = NDArray[np.bool_]

_LOWEST = -0.005  # m; lower readings, beside the table, are raised to this: the floor's depth does not matter
HIGHEST = 0.3  # m; higher readings do not count as an object
_LEAST_WEIGHT = 0.3  # share of a smoothed pixel's neighbourhood that must have readings
LEAST_AREA = 4e-4  # an object must cover more of the table than this, m²
LEAST_HEIGHT = 4e-3
"""An object must be higher than this, m, and than 4 standard deviations of the table's heights."""
_FAINT, _CLEAR = 2.0, 4.0  # in standard deviations of the table's heights
_FAINTEST = 2e-3  # m; lower bound of the faint threshold, for a table seen without noise
_RAGGED = 5  # pixels; smaller protrusions of an edge are noise
_RIM = 2  # pixels; an edge blurred over less is placed at half its height

_NEAREST = 0.05  # m; parts closer to the camera's plane are drawn at this depth, far outside the picture
_FARTHEST_PIXEL = 10_000
_MANY = 8  # balls; of a larger number only those at the border are drawn
_CIRCLE = np.linspace(0, 2 * np.pi, 24, endpoint=False)
_DISC = np.column_stack([np.cos(_CIRCLE), np.sin(_CIRCLE)])


class HeightPicture(NamedTuple):
    """Smoothed heights (h, w) of part of a picture, starting at some pixel, m; NaN where nothing is seen."""

    values: Heights
    first_column: float = 0.0
    first_row: float = 0.0

    def at(self, pixels: FloatArray) -> FloatArray:
        """Heights (a, b) or (a,) at pixel coordinates (a, b, 2) or (a, 2), m; NaN near missing readings."""
        where = (pixels - np.array([self.first_column, self.first_row])).astype(np.float32)
        flat = where.reshape(len(where), -1, 2)
        read = cv2.remap(
            self.values, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"),
        )  # fmt: skip
        return read.astype(float).reshape(pixels.shape[:-1])


def smoothed_heights(heights: Heights, blocked: Mask | None = None, highest: float = np.inf) -> Heights:
    """Heights (h, w) over the table, m, averaged with their neighbours, without pixels that the arm blocks.

    NaN means no reading; small gaps are filled, larger ones stay. Objects higher than `highest`, m, count as
    that high.
    """
    seen = (heights < HIGHEST) if blocked is None else (heights < HIGHEST) & ~blocked
    weight = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), SMOOTHING)
    values = np.where(seen, np.clip(heights, np.float32(_LOWEST), np.float32(highest)), np.float32(0))
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
    """Least height over the table that separates an object from noise in smoothed heights (H, W), m."""
    return max(LEAST_HEIGHT, _CLEAR * _table_noise(heights))


def object_mask(heights: Heights, view: View) -> Mask | None:
    """(H, W) pixels of the object in smoothed heights (H, W), m; None if nothing stands on the table.

    A pixel belongs to the object if it is at least faintly higher than the table and connected to one that is
    clearly higher; of several pieces the largest is the object. Pixels without a reading count if they lie
    between two object pixels in their row or column, as on shiny metal. Those along one side of the object do
    not: they are the stereo shadow of a tall object. An edge is placed at half the height of the object next
    to it.
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
    """Convex hull of balls: two make a capsule, eight corners with radius 0 a box."""

    points: FloatArray  # (k, 3) the balls' centres in W, m
    radius: float  # of the balls, m


def draw_hulls(hulls: Sequence[Hull], view: View, margin: float = 0.008) -> Mask:
    """(H, W) pixels that may show one of the hulls.

    Args:
        hulls: around the arm's links and anything it holds.
        margin: added around each, m, for jitter of readings and small errors of the arm's pose.
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
    # Off the axis a ball looks like an ellipse, longer by the secant of the angle; this disc covers it.
    secant = np.hypot(1.0, np.hypot(p_C[:, 0], p_C[:, 1]) / depth)
    radius = np.repeat([hull.radius + margin for hull in hulls], sizes) * focal / depth * secant
    low = np.minimum.reduceat(center - radius[:, None], first[:-1])
    high = np.maximum.reduceat(center + radius[:, None], first[:-1])
    beside = (high < -1.0).any(axis=1) | (low > [camera.width, camera.height]).any(axis=1)
    for hull in np.flatnonzero(~behind & ~beside):
        balls = np.arange(first[hull], first[hull + 1])
        if sizes[hull] > _MANY:  # balls surrounded by others are not at the border
            balls = balls[cv2.convexHull(center[balls].astype(np.float32), returnPoints=False).ravel()]
        discs = center[balls, None] + radius[balls, None, None] * _DISC
        corners = np.round(np.clip(discs, -_FARTHEST_PIXEL, _FARTHEST_PIXEL)).astype(np.int32)
        cv2.fillConvexPoly(picture, cv2.convexHull(corners.reshape(-1, 2)), 255)
    return picture > 0


@compiled(LONE_FOLDER, nogil=True)
def between(mask, missing):  # type: ignore[no-untyped-def]
    """(H, W) missing pixels in runs, along rows or columns, with the mask at both ends."""
    height, width = mask.shape
    found = np.zeros((height, width), np.bool_)
    above = np.full(width, -1)  # last known row in each column if it is in the mask, else -1
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


Fault = Literal["", "no picture", "old picture", "torn picture", "corrupt picture"]
REMEMBERED = 4  # number of earlier pictures with whose rows those of a new one are compared
_SPAN = (0.05, 20.0)  # m; finite readings outside are invalid
_USABLE = 30  # readings that make a row worth comparing
_TORN = 0.02  # share of the rows
_CORRUPT = 0.1  # share of the pixels without a reading, beyond the usual share
_SPOILT = 0.01  # the same for a picture in which the object is not found


@dataclass(frozen=True, eq=False)
class PictureHistory:
    """Knowledge from earlier pictures."""

    # row sums (H,) of the newest valid pictures, at most `REMEMBERED`
    recent: tuple[NDArray[np.uint64], ...] = ()
    taken: float = 0.0  # time of the newest one, s
    # whether no two pictures of this camera share a row, so that one that does is not new
    noisy: bool = False
    missing: float = 1.0  # usual share of pixels without a reading

    def learned(self, frames: Sequence[DepthImage], blocked: Mask | None) -> PictureHistory:
        """The history, with the noise learned from pictures (H, W) of a scene at rest.

        Two pictures of a camera without noise share rows wherever nothing moves.
        """
        noisy = any(
            not (_row_sums(one) == _row_sums(other))[_usable(one)].any() for one, other in pairwise(frames)
        )
        return replace(self, noisy=noisy, missing=float(np.mean([missing(f, blocked) for f in frames])))

    def judged(
        self, image: DepthImage, taken: float, now: float, oldest: float, blocked: Mask | None
    ) -> tuple[Fault, bool, PictureHistory]:
        """The fault of a picture, whether it is new, and the history with it.

        Args:
            image: (H, W) m, as from `readings`.
            taken: its time according to the sender, s.
            now: the time now, s.
            oldest: age beyond which a picture is too old, s.
            blocked: (H, W) pixels that show the arm.
        """
        sums, usable = _row_sums(image), _usable(image)
        same = [(sums == other)[usable] for other in self.recent] if self.noisy else []
        new = taken > self.taken + 1e-6 or not self.recent
        if new and not any(len(rows) and rows.all() for rows in same):
            if any(rows.mean() > _TORN for rows in same if len(rows)):
                return "torn picture", True, self
            if missing(image, blocked) > self.missing + _CORRUPT:
                return "corrupt picture", True, self
            return "", True, replace(self, recent=(*self.recent, sums)[-REMEMBERED:], taken=taken)
        return ("old picture" if now - self.taken > oldest else ""), False, self

    def spoilt(self, image: DepthImage, blocked: Mask | None) -> bool:
        """Whether missing readings may explain why an object is not found."""
        return missing(image, blocked) > self.missing + _SPOILT


def readings(image: DepthImage) -> DepthImage:
    """A copy (H, W) of a depth picture, m; invalid readings become 0, inf means beyond the range."""
    low, high = _SPAN
    possible = (image >= low) & ((image <= high) | np.isposinf(image))
    return np.where(possible, image, np.float32(0))


def missing(image: DepthImage, blocked: Mask | None) -> float:
    """Share of pixels without a reading among those that do not show the arm."""
    empty = image == 0 if blocked is None else (image == 0)[~blocked]
    return float(empty.mean()) if empty.size else 1.0


def _row_sums(image: DepthImage) -> NDArray[np.uint64]:
    """(H,) hash of each row of a picture, practically unique."""
    bits = np.ascontiguousarray(image, dtype=np.float32).view(np.uint32).astype(np.uint64)
    weights = np.random.default_rng(0).integers(1, 2**63, size=bits.shape[1], dtype=np.uint64)
    return np.asarray(bits @ (2 * weights + 1))  # modulo 2^64


def _usable(image: DepthImage) -> NDArray[np.bool_]:
    """(H,) rows with enough readings to be worth comparing."""
    return np.asarray((np.isfinite(image) & (image > 0)).sum(axis=1) >= _USABLE)
