"""The polygon behind a blurred outline, with no more corners than what was seen asks for.

A picture smoothed with a Gaussian shows an edge where the blurred object has half its height. Along straight
sides that is the edge itself, but it passes inside convex corners and outside concave ones: at 0.8 standard
deviations from a square corner, at 1.7 from one of 45 degrees. `sharp_ring` inverts this. It fits a
polygon whose blurred edge passes through the points seen, and merges corners as long as the misfit stays
within noise. Square corners come out square, straight sides straight, and round ones as polygons, with twice
as many corners if that explains the points better.

The blurred polygon has a closed form. Seen from a point, a polygon is a sum of signed triangles, one for each
side. The part of a wedge of angle phi that lies beyond a line at a distance h, at right angles to one side of
the wedge, is Owen's T(h, tan phi) (Owen, Ann. Math. Stat. 27, 1956). Derivatives by the corners are integrals
of the Gaussian along the sides.
"""

from __future__ import annotations

import numpy as np
import shapely
from scipy.special import ndtr, owens_t
from shapely.geometry import LinearRing, LineString, Polygon

from slipmap.models.geometry import cross
from slipmap.models.physics.cell_grid import FloatArray

_ROOT = np.sqrt(2.0 * np.pi)
_FINEST = 4.0  # noises; half the width of the strip in which points count as a straight side at first
_ALIKE = 2.0 * np.sqrt(np.pi)  # blurs; on so much of the outline, errors of points count as one
_PER_CORNER = 7.0  # by which a corner must lower the misfit to stay: two parameters times ln(30) points
_TENSION = 2.0  # misfit for which the outline becomes a pixel longer: a spike that blur hides is none
# A corner stays near where its fit began, within a standard deviation of so many pixels: on a straight side,
# nothing else holds it.
_LOOSE = 1.0
_STRAY = 1.0  # pixels; points farther off do not count
_FARTHEST = 6.0  # pixels from a side to the corner that replaces it
_PARALLEL = np.sin(np.deg2rad(10.0))
_GENTLE = np.deg2rad(50.0)  # an octagon's corners turn by 45
_STEPS, _SETTLED = 4, 0.03  # of Gauss-Newton at most; pixels
_NEAR = 4.0  # blurs from a side within which points see it
_FEW = 6  # so many corners or fewer are fitted together


def sharp_ring(points: FloatArray, blur: float, noise: float) -> LinearRing:
    """The polygon with the fewest corners whose blurred edge passes through points within their noise.

    Args:
        points: (m, 2) points along the edge in order, evenly spaced, pixels. A ring that crosses itself is
            returned as it is.
        blur: standard deviation of the Gaussian that blurred the picture, pixels.
        noise: standard deviation of a point across the edge, pixels.

    Example:
        >>> import numpy as np
        >>> from slipmap.models.perception.sharp_outline import sharp_ring
        >>> t = np.arange(0.0, 20.0)
        >>> square = np.concatenate([[(x, 0.0) for x in t], [(20.0, y) for y in t],
        ...     [(20.0 - x, 20.0) for x in t], [(0.0, 20.0 - y) for y in t]])
        >>> len(sharp_ring(square, 0.2, 0.1).coords) - 1
        4
    """
    traced = Polygon(points)
    if not traced.is_valid:
        return traced.exterior
    corners = np.array(traced.simplify(_FINEST * noise).exterior.coords)[:-1]
    if not traced.exterior.is_ccw:
        corners = corners[::-1]
    weight = min(traced.length / len(points) / (_ALIKE * blur), 1.0) / noise**2
    edge = _Edge(points, blur, weight)
    return LinearRing(edge.curved(edge.merged(corners)))


def blurred(points: FloatArray, chain: FloatArray, blur: float) -> tuple[FloatArray, FloatArray]:
    """What the sides between corners add to the height of a blurred polygon, as a share of the object's.

    All sides together give 1 deep inside and 0 far outside. Chains with the same ends differ as the polygons
    do, so that one may replace the other.

    Args:
        points: (m, 2).
        chain: (k, 2) corners, counter-clockwise; the first again as the last for a whole polygon.
        blur: standard deviation of the Gaussian.

    Returns:
        (m,), and its derivatives (m, k, 2) by the corners.
    """
    sides = np.diff(chain, axis=0)
    length = np.maximum(np.linalg.norm(sides, axis=1), 1e-9)
    along = sides / length[:, None]
    outward = np.column_stack([along[:, 1], -along[:, 0]])
    to_start = chain[:-1] - points[:, None]
    begin = np.sum(to_start * along, axis=-1) / blur
    end = begin + length / blur
    inside = np.sum(to_start * outward, axis=-1) / blur
    depth = np.maximum(np.abs(inside), 1e-9)
    wedge = (np.arctan2(end, depth) - np.arctan2(begin, depth)) / (2.0 * np.pi)
    beyond = owens_t(depth, end / depth) - owens_t(depth, begin / depth)
    value = np.sum(np.where(inside < 0.0, -1.0, 1.0) * (wedge - beyond), axis=1)
    # A side that moves outwards adds the Gaussian along it, times how far each of its points moves.
    across = np.exp(-0.5 * inside**2) / (_ROOT * blur)
    whole = ndtr(end) - ndtr(begin)
    moment = (np.exp(-0.5 * begin**2) - np.exp(-0.5 * end**2)) / _ROOT
    at_end = (moment - begin * whole) * (blur / length)
    change = np.zeros((len(points), len(chain), 2))
    change[:, :-1] += (across * (whole - at_end))[..., None] * outward
    change[:, 1:] += (across * at_end)[..., None] * outward
    return value, change


class _Edge:
    """Points (m, 2) along a blurred edge. A chain of corners (k, 2) whose ends are the same is a ring."""

    def __init__(self, points: FloatArray, blur: float, weight: float) -> None:
        self.points, self.blur, self.weight = points, blur, weight
        self.places = shapely.points(points)
        self.scale = _ROOT * blur  # from a share of the height to pixels across a straight edge

    def merged(self, corners: FloatArray) -> FloatArray:
        """Fitted corners (k, 2), merged as long as that leaves no more than noise."""
        ring = self.fitted(self.points, _closed(corners))
        height = blurred(self.points, ring, self.blur)[0]
        known: dict[bytes, tuple[float, FloatArray]] = {}
        while len(ring) > 4:
            turned = [np.roll(ring[:-1], -k, axis=0) for k in range(len(ring) - 1)]
            # What one side becomes concerns the two on either side of it; a short ring is fitted as a whole.
            whole = len(ring) - 1 <= _FEW
            chains = [_closed(one) if whole else one[:6] for one in turned]
            for chain in chains:
                if chain.tobytes() not in known:
                    known[chain.tobytes()] = self.one_less(chain, height)
            losses = [known[chain.tobytes()][0] for chain in chains]
            k = int(np.argmin(losses))
            if losses[k] > _PER_CORNER:
                break
            fewer = known[chains[k].tobytes()][1]
            for sign, chain in ((-1.0, chains[k]), (1.0, fewer)):
                height = height + sign * blurred(self.points, chain, self.blur)[0]
            ring = fewer if whole else _closed(np.concatenate([fewer, turned[k][6:]]))
        return ring[:-1]

    def curved(self, corners: FloatArray) -> FloatArray:
        """Corners (k, 2) with twice as many where gentle ones follow each other, if that explains more."""
        rings = _closed(corners), self.fitted(self.points, _closed(_cut_where_gentle(corners)))
        heights = (blurred(self.points, ring, self.blur)[0] for ring in rings)
        costs = [
            self.misfit(each) + _TENSION * LineString(ring).length
            for each, ring in zip(heights, rings, strict=True)
        ]
        return rings[int(np.argmin(costs))][:-1]

    def one_less(self, chain: FloatArray, height: FloatArray) -> tuple[float, FloatArray]:
        """Misfit added if the third side of a chain (k, 2) becomes a corner, and the fitted chain (k - 1, 2).

        `height` (m,) is the share that the whole polygon has at the points.
        """
        line = LineString(chain)
        near = shapely.distance(line, self.places) < _NEAR * self.blur
        points = self.points[near]
        others = height[near] - blurred(points, chain, self.blur)[0]
        start = np.vstack([chain[:2], _meeting(chain[1], chain[2], chain[3], chain[4]), chain[4:]])
        fewer = self.fitted(points, start, others)
        after = others + blurred(points, fewer, self.blur)[0]
        longer = LineString(fewer).length - line.length
        return self.misfit(after) - self.misfit(height[near]) + _TENSION * longer, fewer

    def misfit(self, height: FloatArray) -> float:
        """Misfit of points at which the blurred polygon has shares (m,) of the height, instead of a half."""
        off = self.scale * (height - 0.5)
        return self.weight * float(np.sum(np.minimum(off**2, _STRAY**2)))

    def fitted(self, points: FloatArray, chain: FloatArray, others: FloatArray | float = 0.0) -> FloatArray:
        """The chain (k, 2) with its corners fitted to points by Gauss-Newton; different ends stay.

        `others` is what the rest of the ring adds to the height at the points.
        """
        closed = np.array_equal(chain[0], chain[-1])
        start = corners = chain[:-1] if closed else chain[1:-1]
        for _ in range(_STEPS):
            height, change = blurred(points, chain, self.blur)
            along = np.diff(chain, axis=0)
            along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
            if closed:
                change[:, 0] += change[:, -1]
                change, longer = change[:, :-1], np.roll(along, 1, axis=0) - along
            else:
                change, longer = change[:, 1:-1], along[:-1] - along[1:]
            off, slope = self.scale * (height + others - 0.5), self.scale * change.reshape(len(points), -1)
            slope[np.abs(off) > _STRAY] = 0.0
            information = self.weight * slope.T @ slope + np.eye(slope.shape[1]) / _LOOSE**2
            pull = self.weight * slope.T @ off + 0.5 * _TENSION * longer.ravel()
            step = -np.linalg.solve(information, pull + (corners - start).ravel() / _LOOSE**2)
            corners = corners + np.clip(step, -1.0, 1.0).reshape(-1, 2)
            chain = _closed(corners) if closed else np.vstack([chain[:1], corners, chain[-1:]])
            if np.abs(step).max() < _SETTLED:
                break
        return chain


def _closed(corners: FloatArray) -> FloatArray:
    return np.vstack([corners, corners[:1]])


def _cut_where_gentle(corners: FloatArray) -> FloatArray:
    """Corners (k, 2) of which gentle ones in a row, turning the same way, are cut a quarter side away."""
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    length = np.linalg.norm(after, axis=1)
    turn = np.arctan2(cross(before, after), np.sum(before * after, axis=1))
    gentle = np.where(np.abs(turn) < _GENTLE, np.sign(turn), 0.0)
    curve = (gentle * np.roll(gentle, -1) > 0.0) | (gentle * np.roll(gentle, 1) > 0.0)
    cut = np.minimum(length, np.roll(length, 1)) / 4.0
    back, on = -before / np.roll(length, 1)[:, None], after / length[:, None]
    both = np.stack([corners + cut[:, None] * back, corners + cut[:, None] * on], axis=1)
    return np.concatenate([both[k] if curve[k] else corners[k : k + 1] for k in range(len(corners))])


def _meeting(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    """(2,) where the lines through a, b and c, d meet, or the middle of b and c if they meet far away."""
    u, v = b - a, d - c
    turn = cross(u, v)
    if abs(turn) > _PARALLEL * np.linalg.norm(u) * np.linalg.norm(v):
        corner = b + cross(c - b, v) / turn * u
        if min(np.linalg.norm(corner - b), np.linalg.norm(corner - c)) < _FARTHEST:
            return corner
    return (b + c) / 2
