"""Compiled kernels of pose tracking, for every point of the outline.

They call no kernel of another file, so Numba recompiles them whenever something in this file changes. A
`picture` is a `HeightPicture`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.compiled import LONE_FOLDER, compiled

SPACING = 1e-3  # distance between the points of a relief, m
SMOOTHING = 1.0  # standard deviation of the Gaussian that averages heights in a picture, pixels
_FAR_AWAY = 1e6  # points of a map; only a nearly level ray goes farther
_LEVEL = 2e-3  # m between the heights at which a ray is compared with the relief
_STEP = 0.5  # pixels between readings along a normal
_PREDICTED = 5.0  # pixels from an outline point within which its edge is expected in the picture
_TINY = 1e-4  # m
_HEIGHT_ERROR = 1.5e-3  # m; on a level top, a height error of this size counts like an edge one pixel off
_LEAST_SLOPE = 0.05
_UNLIKE = 0.005  # m; a point with a larger height error on flat ground does not fit at all
_OUTSIDE = 3.0  # pixels beyond the outline


_REACH = int(4 * SMOOTHING / _STEP + 0.5)
_BELL = np.exp(-0.5 * (np.arange(-_REACH, _REACH + 1) * _STEP / SMOOTHING) ** 2)
_BELL /= _BELL.sum()


class Lens(NamedTuple):
    """A camera at its pose; see `PinholeCamera` and `View`."""

    focal_x: float
    focal_y: float
    center_x: float
    center_y: float
    R_WC: FloatArray
    p_WC: FloatArray


class Land(NamedTuple):
    """The object on a table, as a height map in the object's frame; see `TablePlane` and `Relief`.

    `plane` (3,): slopes and height of the table; `corner` (2,): first point of the map; `heights` (rows,
    columns); `highest`: their maximum.
    """

    plane: FloatArray
    corner: FloatArray
    heights: NDArray[np.float32]
    highest: float


class Shape(NamedTuple):
    """The seen object; see `SeenObject`.

    `points`, `normals` (m, 2), `edges`, `rims` (m,): of the outline; `inner` (k, 2), `tops` (k,), `slopes`
    (k, 2): of the points inside.
    """

    land: Land
    points: FloatArray
    normals: FloatArray
    edges: FloatArray
    rims: FloatArray
    inner: FloatArray
    tops: FloatArray
    slopes: FloatArray


_compiled = compiled(LONE_FOLDER, nogil=True)


@_compiled
def _project(lens, plane, x, y, height):  # type: ignore[no-untyped-def]
    """Pixel of a point over the table; NaN at or behind the camera."""
    dx, dy = x - lens.p_WC[0], y - lens.p_WC[1]
    dz = plane[0] * x + plane[1] * y + plane[2] + height - lens.p_WC[2]
    R = lens.R_WC
    depth = dx * R[0, 2] + dy * R[1, 2] + dz * R[2, 2]
    if depth <= 1e-6:
        return np.nan, np.nan
    u = lens.focal_x * (dx * R[0, 0] + dy * R[1, 0] + dz * R[2, 0]) / depth + lens.center_x
    v = lens.focal_y * (dx * R[0, 1] + dy * R[1, 1] + dz * R[2, 1]) / depth + lens.center_y
    return u, v


@_compiled
def _read(picture, u, v):  # type: ignore[no-untyped-def]
    """Height interpolated between pixels; NaN if one of the four around is missing."""
    x, y = u - picture.first_column, v - picture.first_row
    rows, columns = picture.values.shape
    if not (x >= 0.0 and y >= 0.0 and x < columns - 1 and y < rows - 1):
        return np.nan
    i, j = int(y), int(x)
    below, right = y - i, x - j
    one = (1.0 - right) * picture.values[i, j] + right * picture.values[i, j + 1]
    other = (1.0 - right) * picture.values[i + 1, j] + right * picture.values[i + 1, j + 1]
    return (1.0 - below) * one + below * other


@_compiled
def _within(begin, end, size, number):  # type: ignore[no-untyped-def]
    """First and last of `number` steps from `begin` to `end` that may lie between -0.5 and size - 0.5."""
    if begin == end:
        if -1.0 < begin < size:
            return 0, number
        return number, -1
    one, other = (-0.5 - begin) / (end - begin) * number, (size - 0.5 - begin) / (end - begin) * number
    low, high = max(min(one, other), 0.0), min(max(one, other), float(number))
    if low > high:
        return number, -1
    return int(low), min(int(high) + 1, number)


@_compiled
def _seen(lens, land, c, s, pose, u, v):  # type: ignore[no-untyped-def]
    """Height that a camera without noise sees at a pixel, for an object at a pose with cosine c and sine s.

    The ray is followed from the highest level down until it meets the map.
    """
    rows, columns = land.heights.shape
    a, b = (u - lens.center_x) / lens.focal_x, (v - lens.center_y) / lens.focal_y
    R, p, plane = lens.R_WC, lens.p_WC, land.plane
    ray_x = a * R[0, 0] + b * R[0, 1] + R[0, 2]
    ray_y = a * R[1, 0] + b * R[1, 1] + R[1, 2]
    along = a * R[2, 0] + b * R[2, 1] + R[2, 2] - plane[0] * ray_x - plane[1] * ray_y
    depth = (plane[2] + plane[0] * p[0] + plane[1] * p[1] - p[2]) / along
    # Where the ray meets the table and the highest level, as columns and rows of the map.
    dx, dy = p[0] + depth * ray_x - pose[0], p[1] + depth * ray_y - pose[1]
    x0 = (c * dx + s * dy - land.corner[0]) / SPACING
    y0 = (c * dy - s * dx - land.corner[1]) / SPACING
    rise = land.highest / along
    x1 = x0 + rise * (c * ray_x + s * ray_y) / SPACING
    y1 = y0 + rise * (c * ray_y - s * ray_x) / SPACING
    if not max(abs(x0), abs(x1), abs(y0), abs(y1)) < _FAR_AWAY:
        return 0.0
    number = max(1, int(np.ceil(land.highest / _LEVEL)))
    step = land.highest / number
    # It is over the map only between these levels.
    first, last = _within(x1, x0, columns, number)
    other, end = _within(y1, y0, rows, number)
    first, last = max(first, other), min(last, end)
    right, down = (x0 - x1) / number, (y0 - y1) / number
    before = (first - 1) * step - land.highest
    for k in range(first, last + 1):
        column, row = int(x1 + k * right + 0.5), int(y1 + k * down + 0.5)
        level = land.highest - k * step
        here = -level
        if 0 <= column < columns and 0 <= row < rows:
            here += land.heights[row, column]
        if here >= 0.0:
            if k == 0:
                return land.highest
            # A map that rises by more than one level is a flank: halfway is the best guess.
            part = 0.5 if here > step else here / (here - before)
            return level + part * step
        before = here
    return 0.0


@_compiled
def _is_far(lens, shape, c, s, pose, i):  # type: ignore[no-untyped-def]
    """Whether an outline point lies on an edge that faces away from the camera.

    There the top hides the foot, and the edge in the picture is that of the rim; elsewhere the flank is seen.
    """
    x, y = shape.points[i]
    n, m = shape.normals[i]
    away_x, away_y = c * x - s * y + pose[0] - lens.p_WC[0], s * x + c * y + pose[1] - lens.p_WC[1]
    return away_x * (c * n - s * m) + away_y * (s * n + c * m) > 0.0


@_compiled
def lines_across(lens, shape, pose):  # type: ignore[no-untyped-def]
    """Lines in the picture across the outline, on which edges are searched.

    Returns:
        (m, 7): the pixel of an outline point, the unit vector out of the object there, and the point's motion
        along it per change of x, y and theta.
    """
    lines = np.empty((len(shape.points), 7))
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for i in range(len(lines)):
        x, y = shape.points[i]
        n, m = shape.normals[i]
        arm_x, arm_y = c * x - s * y, s * x + c * y
        normal_x, normal_y = c * n - s * m, s * n + c * m
        height = shape.rims[i] if _is_far(lens, shape, c, s, pose, i) else shape.edges[i] / 2
        at_x, at_y = arm_x + pose[0], arm_y + pose[1]
        u, v = _project(lens, shape.land.plane, at_x, at_y, height)
        ux, vx = _project(lens, shape.land.plane, at_x + _TINY, at_y, height)
        uy, vy = _project(lens, shape.land.plane, at_x, at_y + _TINY, height)
        ux, vx, uy, vy = (ux - u) / _TINY, (vx - v) / _TINY, (uy - u) / _TINY, (vy - v) / _TINY
        # The normal in the picture is at right angles to the outline's tangent there.
        tangent_u, tangent_v = uy * normal_x - ux * normal_y, vy * normal_x - vx * normal_y
        across_u, across_v = tangent_v, -tangent_u
        outward = across_u * (ux * normal_x + uy * normal_y) + across_v * (vx * normal_x + vy * normal_y)
        size = np.sign(outward) / np.hypot(across_u, across_v)
        across_u, across_v = across_u * size, across_v * size
        along_x, along_y = across_u * ux + across_v * vx, across_u * uy + across_v * vy
        lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3] = u, v, across_u, across_v
        lines[i, 4], lines[i, 5], lines[i, 6] = along_x, along_y, along_y * arm_x - along_x * arm_y
    return lines


@_compiled
def _falls_through(profile, level, first):  # type: ignore[no-untyped-def]
    """Offset nearest to 0 at which readings, the first at offset `first`, fall through a level; else NaN."""
    nearest = np.nan
    for j in range(len(profile) - 1):
        over, after = profile[j] - level, profile[j + 1] - level
        if over >= 0.0 and after < 0.0:
            where = first + _STEP * (j + over / (over - after))
            if not abs(where) >= abs(nearest):
                nearest = where
    return nearest


@_compiled
def edges_found(picture, shape, lines, reach):  # type: ignore[no-untyped-def]
    """(m,) position of the picture's edge on each line, pixels; NaN if not within reach."""
    profile = np.empty(int(2 * reach / _STEP + 1.5))
    found = np.empty(len(lines))
    for i in range(len(lines)):
        u, v, across_u, across_v = lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3]
        for j in range(len(profile)):
            offset = _STEP * j - reach
            profile[j] = _read(picture, u + offset * across_u, v + offset * across_v)
        found[i] = _falls_through(profile, shape.edges[i] / 2, -reach)
    return found


@_compiled
def edges_expected(lens, shape, pose, lines):  # type: ignore[no-untyped-def]
    """(m,) expected position of the edge on each line for an object at a pose, pixels."""
    number, half = int(2 * _PREDICTED / _STEP + 1.5), len(_BELL) // 2
    c, s = np.cos(pose[2]), np.sin(pose[2])
    profile, smooth = np.empty(number), np.empty(number)
    expected = np.empty(len(lines))
    for i in range(len(lines)):
        u, v, across_u, across_v = lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3]
        for j in range(number):
            offset = _STEP * j - _PREDICTED
            at_u, at_v = u + offset * across_u, v + offset * across_v
            profile[j] = _seen(lens, shape.land, c, s, pose, at_u, at_v)
        for j in range(number):
            total = 0.0
            for k in range(len(_BELL)):
                total += _BELL[k] * profile[min(max(j + k - half, 0), number - 1)]
            smooth[j] = total
        expected[i] = _falls_through(smooth, shape.edges[i] / 2, -_PREDICTED)
    return expected


@_compiled
def heights_off(picture, lens, shape, pose, pixel):  # type: ignore[no-untyped-def]
    """Measured minus expected heights at sloping points inside, and their change with the pose.

    Args:
        pixel: side of a pixel on the table, m.

    Returns:
        (k, 4), both scaled so that 1 is as unlikely as an edge one pixel off; NaN where there is no reading
        or the top is level.
    """
    off = np.full((len(shape.inner), 4), np.nan)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for i in range(len(off)):
        along, aside = shape.slopes[i]
        steep = np.hypot(along, aside)
        if steep <= _LEAST_SLOPE:
            continue
        x, y = shape.inner[i]
        arm_x, arm_y = c * x - s * y, s * x + c * y
        u, v = _project(lens, shape.land.plane, arm_x + pose[0], arm_y + pose[1], shape.tops[i])
        # If the object moves uphill along its slope, the height at a fixed place falls.
        slope_x, slope_y = c * along - s * aside, s * along + c * aside
        scale = 1.0 / np.hypot(_HEIGHT_ERROR, steep * pixel / 2)
        off[i, 0] = scale * (_read(picture, u, v) - shape.tops[i])
        off[i, 1], off[i, 2] = -scale * slope_x, -scale * slope_y
        off[i, 3] = -scale * (slope_y * arm_x - slope_x * arm_y)
    return off


@_compiled
def _mean_misfit(picture, lens, shape, pose, pixel, every):  # type: ignore[no-untyped-def]
    """See `mean_misfits`."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    total, number, visible, looked, outside, over = 0.0, 0, 0, 0, 0, 0
    for i in range(0, len(shape.inner), every):
        looked += 1
        x, y = shape.inner[i]
        u, v = _project(
            lens, shape.land.plane, c * x - s * y + pose[0], s * x + c * y + pose[1], shape.tops[i]
        )
        read = _read(picture, u, v)
        if not np.isnan(read):
            visible += 1
            # On a steep wall, as inside a bowl, edges that scatter by a pixel change the height as much.
            steep = np.hypot(shape.slopes[i, 0], shape.slopes[i, 1])
            unlike = np.hypot(_UNLIKE, steep * pixel)
            total += min(abs(read - shape.tops[i]) / unlike, 1.0) ** 2
    number += visible
    for i in range(0, len(shape.points), every):
        outside += 1
        x = shape.points[i, 0] + _OUTSIDE * pixel * shape.normals[i, 0]
        y = shape.points[i, 1] + _OUTSIDE * pixel * shape.normals[i, 1]
        # Past the top on the far side and in front of the foot on the near side lies the table.
        height = shape.rims[i] if _is_far(lens, shape, c, s, pose, i) else 0.0
        u, v = _project(lens, shape.land.plane, c * x - s * y + pose[0], s * x + c * y + pose[1], height)
        read = _read(picture, u, v)
        if not np.isnan(read):
            number += 1
            expected = _seen(lens, shape.land, c, s, pose, u, v)
            unlike = min(max((read - expected) / _UNLIKE, 0.0), 1.0)
            total += unlike**2
            over += unlike == 1.0
    return (
        total / number if number else 1.0,
        visible / looked if looked else np.nan,
        over / outside if outside else 0.0,
    )


@_compiled
def mean_misfits(picture, lens, shape, poses, pixel, every):  # type: ignore[no-untyped-def]
    """Misfit of the heights inside and the table outside to a picture, at each of the poses (k, 3).

    Args:
        pixel: side of a pixel on the table, m.
        every: use every point (1), every second point (2), …

    Returns:
        (k, 3): misfit from 0 to 1, the share of the inner points that are seen, and the share of the
        outline's points beside which something stands on the table.
    """
    result = np.empty((len(poses), 3))
    for k in range(len(poses)):
        result[k, 0], result[k, 1], result[k, 2] = _mean_misfit(picture, lens, shape, poses[k], pixel, every)
    return result
