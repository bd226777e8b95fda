"""Pose tracking: the object's pose in a new depth picture, or the reason why it cannot be determined.

Points along the outline are projected into the picture. Along the normal of each, the measured heights are
searched for the place where they fall through half the edge's height, and so are the heights that the camera
would see of the object at the present pose. Gauss-Newton moves the pose until the two places agree. This is
RAPID (Harris and Stennett, BMVC 1990) with depth in place of brightness, and with edges predicted from the
object's relief, since the visible edge of a tall or rounded object depends on where it stands. Slopes inside
the outline constrain the pose too: heights measured there are compared with the relief.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from slipmap.models.geometry import angle_between, placed
from slipmap.models.perception import edge_kernels
from slipmap.models.perception.object_mask import (
    HeightPicture,
    Heights,
    Mask,
    least_height,
    object_mask,
    smoothed_heights,
)
from slipmap.models.perception.pinhole_camera import DepthImage, View, pixel_size
from slipmap.models.perception.seen_object import UNSEEN_ANGLE, ObservedPose, SeenObject
from slipmap.models.physics.cell_grid import FloatArray

_HUBER = 1.0  # pixels
_SETTLED = 0.02  # pixels
_UNCHANGED = 0.3  # pixels; after a smaller move, edges are expected at the same place on their lines
# Neighbouring points share pixels: there is a point per pixel, and pixels are smoothed over three.
_CORRELATED = 4.0

_NEAR_REACHES = (8.0, 5.0, *(3.0,) * 8)  # pixels
_FAR_REACHES = (20.0, 14.0, 9.0, 6.0, 4.0, *(3.0,) * 8)
_OFFSET = 3.0  # pixels; the outline is sought so far from where it was taken to be
_MARGIN = 28  # pixels around the object that are searched when it has hardly moved
# First places to try if it is not there: as far as it may have moved between two pictures.
_BESIDE = np.stack(
    np.meshgrid(np.arange(-60, 61, 30) * 1e-3, np.arange(-60, 61, 30) * 1e-3, np.deg2rad([-8.0, 0.0, 8.0])),
    axis=-1,
).reshape(-1, 3)
_MARGIN_BESIDE = 60  # pixels
_REFINED_BESIDE = 2
_BESIDE_REACHES = (20.0, 14.0, 9.0, 6.0, 4.0, 3.0, 3.0)
_DIRECTIONS = 72  # tried in a search of the whole table
_REFINED = 6  # of these
_AGAIN, _AT_PLACE = 10, 1e-3  # fits at most until the place moves by less, m
_APART = np.deg2rad(12.0)
# If little of the object is seen and its centre lies elsewhere, the search runs along the part that is seen.
_WHOLE, _SHIFTS = 0.85, np.arange(-80, 81, 20) * 1e-3  # m
# Largest mean misfit of an accepted pose: 0 is perfect, 1 fits nowhere. True poses have 0.03 to 0.08. A
# handle with its head under the arm has 0.08 to 0.1 when placed 40 mm off along itself, 0.06 when 10 mm off.
_GOOD = 0.08
# Details finer than pixels give a misfit in the object's own picture; the part beyond this is subtracted.
_FINE = 0.01
# No other pose is tried if nearly all inner points are seen, or if most are and misfit and standard
# deviations are small, unless something stands beside the outline: an end of the object that is left over.
_SEEN_CLEARLY, _MOSTLY_SEEN = 0.95, 0.6
_FITS_CLEARLY, _KNOWN_CLEARLY, _ALONE_CLEARLY = 0.053, 1.2e-3, 0.02
_AS_GOOD = 0.02  # insignificant difference of misfit
_LEAST_FOUND = 0.35  # of the outline
_LEAST_SEEN = 0.4  # of the inner points
# Without the last pose as a guide, one part of the object may fit another: half a handle fits either way.
_LEAST_FOUND_ANYWHERE = 0.75
_LEAST_SEEN_ANYWHERE = 0.9
# These suffice if the object at that pose covers everything that is seen on the table: a part mistaken for
# another farther along leaves its own end uncovered.
_LEAST_SEEN_COVERING, _LEAST_FOUND_COVERING, _MOST_UNCOVERED = 0.6, 0.6, 0.03
_AROUND = np.ones((7, 7), np.uint8)  # pixels; edges are blurred
_LEAST_AREA_ANYWHERE = 0.5  # of the footprint; with fewer pixels, too little of the object is seen
_SURE = np.array([2e-3, 2e-3, np.deg2rad(2.0)])  # standard deviations beyond which a pose is not known
# Error that averaging more edges does not remove, since the outline itself was measured.
_FLOOR = np.diag(np.array([3e-4, 3e-4, np.deg2rad(0.06)]) ** 2)


def track(
    depth: DepthImage,
    view: View,
    seen: SeenObject,
    previous: FloatArray,
    blocked: Mask | None = None,
    time: float = 0.0,
) -> ObservedPose:
    """Pose of an object in a new picture.

    The outline is fitted to the picture's edges from the previous pose. Unless the outline and the heights
    inside clearly agree with the picture, it is also fitted from places around it, and the best fit is taken.
    If no pose agrees, the whole table is searched in all directions; then the object must be seen nearly
    whole, or for the most part with nothing seen beside it. Of equally good poses, which a symmetric object
    has, the one turned least from the previous pose is taken.

    Args:
        depth: (H, W) m; 0 or NaN where there is no reading, inf beyond the range.
        seen: the object, from `first_look`.
        previous: (3,) last known pose.
        blocked: (H, W) pixels that show the arm.
        time: of the picture, s; passed on.

    Raises:
        ValueError: the picture has the wrong size, or the previous pose is not finite.
    """
    search = _Search(view.checked_depth(depth), view, seen, blocked)
    if not np.all(np.isfinite(previous)):
        raise ValueError(f"tracking: the previous pose must be finite, got {previous}")
    previous = np.asarray(previous, dtype=float)
    near = search.near(previous)
    if near is not None and near.clear:
        return near.observed(time)
    tried = [found for found in (near, search.beside(previous)) if found is not None]
    best = min(tried, key=lambda candidate: candidate.misfit, default=None)
    if best is not None and best.good:
        return best.observed(time)
    raw = seen.table.heights(search.image, view)
    heights = smoothed_heights(raw, blocked)
    mask = object_mask(heights, view)
    hidden = search.hidden_share(heights, previous) > 1 - _LEAST_SEEN
    if mask is None and hidden:
        return ObservedPose.unseen("occluded", time)
    if mask is None:
        least = 1e3 * least_height(heights)
        detail = f"it left the table, or is too flat to be seen: nothing is higher than {least:.0f} mm"
        return ObservedPose.unseen("left the table", time, detail)
    anywhere = None
    if search.area(mask) > _LEAST_AREA_ANYWHERE:
        anywhere = search.anywhere(heights, mask, previous)
        if anywhere is not None and (anywhere.unmistakable or search.covers(anywhere, mask)):
            return anywhere.observed(time)
    around = cv2.dilate(mask.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
    if hidden or (blocked is not None and np.any(around & blocked)):
        return ObservedPose.unseen("occluded", time)
    if np.any(around & (raw < -0.05)):  # tilts over the edge
        return ObservedPose.unseen("left the table", time)
    tried = [found for found in (*tried, anywhere) if found is not None]
    misfit = min((found.misfit for found in tried), default=1.0)
    detail = (
        f"the object on the table does not fit the outline from the first look (misfit {misfit:.2f},"
        f" {_GOOD} is"
        " allowed); it is a different object, or pictures are too noisy"
        if misfit >= _GOOD
        else "the object's pose is uncertain: too little of it is seen, or pixels are too coarse for it"
    )
    return ObservedPose.unseen("no object", time, detail)


def outline_offsets(
    depth: DepthImage, view: View, seen: SeenObject, pose: FloatArray, blocked: Mask | None = None
) -> FloatArray:
    """(m,) distances outwards at which a picture shows the points of `SeenObject.foot`, m; NaN if hidden.

    Args:
        depth, blocked: (H, W), as for `track`.
        pose: (3,) of O in W.
    """
    shape, low, _ = seen.foot
    picture = _Search(view.checked_depth(depth), view, seen, blocked).around(pose, _MARGIN, low)
    if picture is None:
        return np.full(len(shape.points), np.nan)
    lines = edge_kernels.lines_across(view.lens, shape, pose)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    outward = shape.normals @ np.array([[c, s], [-s, c]])
    return edge_kernels.edges_found(picture, shape, lines, _OFFSET) / np.sum(lines[:, 4:6] * outward, axis=1)


class EdgeFit(NamedTuple):
    """Result of a fit."""

    pose: FloatArray  # (3,) x, y, theta of O in W
    # (3, 3), from the scatter of the edges about the fitted outline; infinite if the edges found do not
    # determine the pose
    covariance: FloatArray
    found: float  # share of the outline's points with an edge within reach


def fit_edges(
    picture: HeightPicture, view: View, seen: SeenObject, start: FloatArray, reaches: Sequence[float]
) -> EdgeFit:
    """Fit the outline to the edges in a picture, from a nearby pose; an angle that cannot be seen is held.

    Args:
        picture: smoothed heights, NaN where the arm is.
        view, seen: the camera and the object.
        start: (3,) pose to start from.
        reaches: search distance for edges in each Gauss-Newton step, pixels.
    """
    pose = np.array(start, dtype=float)
    fit = EdgeFit(pose, np.full((3, 3), np.inf), 0.0)
    free = slice(3 if seen.angle_seen else 2)
    lens, shape, pixel = view.lens, seen.shape, pixel_size(view)
    # Makes the information on the angle comparable with that on the position.
    size = np.array([1.0, 1.0, 1.0 / np.sqrt(np.mean(np.sum(seen.outline.points**2, axis=1)))])
    scale = np.outer(size, size)[free, free]
    expected: FloatArray | None = None
    moved = 0.0  # pixels, since the edges' places were predicted
    for k, reach in enumerate(reaches):
        lines = edge_kernels.lines_across(lens, shape, pose)
        if expected is None or moved > _UNCHANGED:
            expected, moved = edge_kernels.edges_expected(lens, shape, pose, lines), 0.0
        distance = edge_kernels.edges_found(picture, shape, lines, reach) - expected
        found = np.isfinite(distance)
        if found.sum() < 6:
            return fit
        off = edge_kernels.heights_off(picture, lens, shape, pose, pixel)
        off = off[np.isfinite(off[:, 0])]
        d = np.concatenate([distance[found], off[:, 0]])
        J = np.concatenate([lines[found, 4:], off[:, 1:]])[:, free]
        weight = np.minimum(1.0, max(_HUBER, reach / 4) / np.maximum(np.abs(d), 1e-9))
        information = J.T @ (weight[:, None] * J)
        if np.linalg.cond(information * scale) > 1e8:
            return fit
        step = np.linalg.solve(information, J.T @ (weight * d))
        pose = pose.copy()
        pose[free] += step
        change = float(np.abs(J @ step).max())
        moved += change
        scatter = float(np.sqrt(np.sum(weight * d * d) / weight.sum()))  # pixels
        covariance = np.diag([0.0, 0.0, UNSEEN_ANGLE**2])
        covariance[free, free] = _CORRELATED * scatter**2 * np.linalg.inv(information)
        fit = EdgeFit(pose, covariance, float(found.mean()))
        if change < _SETTLED and moved <= _UNCHANGED and all(later >= reach for later in reaches[k + 1 :]):
            break
    return fit


def load_kernels() -> None:
    """Compile or load the kernels of a fit, so that the first picture need not wait for them."""
    points, numbers, map_of_nothing = np.zeros((1, 2)), np.zeros(1), np.zeros((2, 2), np.float32)
    lens = edge_kernels.Lens(1.0, 1.0, 0.0, 0.0, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    land = edge_kernels.Land(np.zeros(3), np.zeros(2), map_of_nothing, 0.0)
    shape = edge_kernels.Shape(land, points, points, numbers, numbers, points, numbers, points)
    picture, pose = HeightPicture(map_of_nothing), np.zeros(3)
    lines = edge_kernels.lines_across(lens, shape, pose)
    edge_kernels.edges_expected(lens, shape, pose, lines)
    edge_kernels.edges_found(picture, shape, lines, 1.0)
    edge_kernels.heights_off(picture, lens, shape, pose, 1.0)
    edge_kernels.mean_misfits(picture, lens, shape, pose[None], 1.0, 1)


class _Candidate(NamedTuple):
    fit: EdgeFit
    misfit: float  # in excess of that in the object's own picture
    seen: float  # share of the inner points that are not hidden
    beside: float  # share of the outline's points beside which something stands on the table
    known: slice  # of the pose: x and y, and the angle if it can be seen

    @property
    def good(self) -> bool:
        deviation = np.sqrt(np.diag(self.fit.covariance))[self.known]
        return (
            self.misfit < _GOOD
            and self.seen > _LEAST_SEEN
            and self.fit.found > _LEAST_FOUND
            and bool(np.all(deviation < _SURE[self.known]))
        )

    @property
    def clear(self) -> bool:
        deviation = float(np.sqrt(np.diag(self.fit.covariance)[:2].max()))
        sure = self.misfit < _FITS_CLEARLY and deviation < _KNOWN_CLEARLY
        enough = self.seen > _SEEN_CLEARLY or (self.seen > _MOSTLY_SEEN and sure)
        return self.good and enough and self.beside < _ALONE_CLEARLY

    @property
    def unmistakable(self) -> bool:
        return self.good and self.seen > _LEAST_SEEN_ANYWHERE and self.fit.found > _LEAST_FOUND_ANYWHERE

    def observed(self, time: float) -> ObservedPose:
        return ObservedPose(self.fit.pose, self.fit.covariance + _FLOOR, True, "", time)


class _Search(NamedTuple):
    """Search for an object in a depth picture (H, W), m, in which the arm may hide parts of it."""

    image: DepthImage
    view: View
    seen: SeenObject
    blocked: Mask | None

    def near(self, previous: FloatArray) -> _Candidate | None:
        """The best pose near the previous one, or None if it lies outside the picture."""
        picture = self.around(previous, _MARGIN)
        return None if picture is None else self._fitted(picture, previous, _NEAR_REACHES)

    def beside(self, previous: FloatArray) -> _Candidate | None:
        """The best pose from starts around the previous one; a fast object may be far from it."""
        picture = self.around(previous, _MARGIN_BESIDE)
        if picture is None:
            return None
        starts = previous + (_BESIDE if self.seen.angle_seen else _BESIDE[_BESIDE[:, 2] == 0])
        off, share, _ = self._misfits(picture, starts, every=3).T
        likely = np.argsort(np.where(share > _LEAST_SEEN, off, np.inf), kind="stable")
        candidates = [self._fitted(picture, starts[k], _BESIDE_REACHES) for k in likely[:_REFINED_BESIDE]]
        best = min(candidates, key=lambda candidate: candidate.misfit)
        return self._fitted(picture, best.fit.pose, _NEAR_REACHES)

    def anywhere(self, heights: Heights, mask: Mask, previous: FloatArray) -> _Candidate | None:
        """The best pose on the table, or None if the object's pixels suggest none."""
        picture = HeightPicture(heights)
        rows, columns = np.nonzero(mask & np.isfinite(heights))
        pixels = np.column_stack([columns, rows]).astype(float)
        shown = self.seen.table.meet(pixels, heights[rows, columns].astype(float), self.view)
        middles = shown.mean(axis=0)[None]
        if self.area(mask) < _WHOLE:
            middles = middles + _SHIFTS[:, None] * _longest_axis(shown)
        angles = previous[2] + np.pi * (2 * np.arange(_DIRECTIONS) / _DIRECTIONS - 1)
        if not self.seen.angle_seen:
            angles = previous[2:]
        apart = _APART if self.seen.angle_seen else -1.0

        def fitted(places: FloatArray, reaches: Sequence[float]) -> list[_Candidate]:
            """Fits from the likeliest directions at some places (p, 2)."""
            starts = np.array([[*place, angle] for place in places for angle in angles])
            off, _, _ = self._misfits(picture, starts, every=3).T
            chosen: list[FloatArray] = []
            for k in np.argsort(off, kind="stable"):
                if all(abs(angle_between(starts[k][2], other[2])) > apart for other in chosen):
                    chosen.append(starts[k])
                if len(chosen) == _REFINED:
                    break
            every = [self._fitted(picture, start, reaches) for start in chosen]
            return [one for one in every if np.all(np.isfinite(one.fit.covariance))]

        candidates = fitted(middles, _FAR_REACHES)
        if not candidates:
            return None
        # Few fits from afar settle. Where the best one does, a symmetric object fits the other way round too.
        best = self._settled(picture, min(candidates, key=lambda candidate: candidate.misfit))
        candidates = [best, *candidates, *fitted(best.fit.pose[None, :2], _NEAR_REACHES)]
        least = min(candidate.misfit for candidate in candidates)
        alike = [candidate for candidate in candidates if candidate.misfit <= least + _AS_GOOD]
        best = min(alike, key=lambda candidate: abs(candidate.fit.pose[2] - previous[2]))
        return self._settled(picture, best)

    def _settled(self, picture: HeightPicture, found: _Candidate) -> _Candidate:
        """A pose, fitted again until it stays where it is."""
        for _ in range(_AGAIN):
            before, found = found, self._fitted(picture, found.fit.pose, _NEAR_REACHES)
            if np.hypot(*(found.fit.pose - before.fit.pose)[:2]) < _AT_PLACE:
                break
        return found

    def area(self, mask: Mask) -> float:
        """Area of the pixels that show an object, relative to that of the footprint."""
        return float(mask.sum() * pixel_size(self.view) ** 2 / self.seen.grid.polygon.area)

    def covers(self, candidate: _Candidate, mask: Mask) -> bool:
        """Whether most of the object is seen and it covers, at a pose, all pixels that show an object."""
        found = candidate.fit.found > _LEAST_FOUND_COVERING
        if not (candidate.good and candidate.seen > _LEAST_SEEN_COVERING and found):
            return False
        inside = np.zeros(mask.shape, np.uint8)
        for heights in (0.0, self.seen.outline.heights):
            pixels = self._pixels(self.seen.outline.points, heights, candidate.fit.pose)
            cv2.fillPoly(inside, [np.round(pixels).astype(np.int32)], 1)
        uncovered = mask & (cv2.dilate(inside, _AROUND) == 0)
        return bool(uncovered.sum() < _MOST_UNCOVERED * mask.sum())

    def hidden_share(self, heights: Heights, pose: FloatArray) -> float:
        """Share of the inner points of an object at a pose that the picture does not show."""
        inner = self._pixels(self.seen.inner_points, self.seen.inner_heights, pose)
        return float(np.mean(np.isnan(HeightPicture(heights).at(inner))))

    def _pixels(self, points: FloatArray, heights: FloatArray | float, pose: FloatArray) -> FloatArray:
        """(m, 2) pixel coordinates of points (m, 2) of the object at a pose."""
        return self.view.project(self.seen.table.lift(placed(points, pose), heights))[0]

    def around(self, pose: FloatArray, margin: int, highest: float = np.inf) -> HeightPicture | None:
        """The part of the picture around the object at a pose, with a margin in pixels; None if outside.

        Higher readings than `highest` count as that high, m.
        """
        outline = self.seen.outline
        pixels = np.concatenate(
            [self._pixels(outline.points, height, pose) for height in (0.0, float(outline.heights.max()))]
        )
        if not np.all(np.isfinite(pixels)):
            return None
        first = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - margin, 0)
        last = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + margin, self.image.shape[::-1])
        if np.any(last - first < 2):
            return None
        rows, columns = slice(first[1], last[1]), slice(first[0], last[0])
        heights = self.seen.table.heights(self.image, self.view, rows, columns)
        part = None if self.blocked is None else self.blocked[rows, columns]
        return HeightPicture(smoothed_heights(heights, part, highest), *map(float, first))

    def _fitted(self, picture: HeightPicture, start: FloatArray, reaches: Sequence[float]) -> _Candidate:
        fit = fit_edges(picture, self.view, self.seen, start, reaches)
        ((off, share, beside),) = self._misfits(picture, fit.pose[None])
        own = max(self.seen.misfit - _FINE, 0.0)
        known = slice(3 if self.seen.angle_seen else 2)
        return _Candidate(fit, float(off) - own, float(share), float(beside), known)

    def _misfits(self, picture: HeightPicture, poses: FloatArray, every: int = 1) -> FloatArray:
        """See `mean_misfits`; poses (k, 3)."""
        return edge_kernels.mean_misfits(
            picture, self.view.lens, self.seen.shape, poses, pixel_size(self.view), every
        )


def _longest_axis(points: FloatArray) -> FloatArray:
    """(2,) unit vector along which points (k, 2) spread most."""
    _, axes = np.linalg.eigh(np.cov(points.T))
    return np.asarray(axes[:, -1])
