"""Loads of the cells on the table when part of the object lies beyond the table's rim.

Cells beyond the rim carry nothing, and the others carry everything. On an elastic foundation whose stiffness
under each cell is proportional to the cell's mass, a rigid object sinks in by a plane a + b·r, and cell i
carries

    N_i = m_i g φ_i,    φ_i = s_i max(0, a + b·r_i),    Σ N_i = m g,    Σ N_i r_i = m g r_com,

which are the conditions for the minimum of a convex function of a and b,

    F = ½ Σ m_i s_i max(0, a + b·r_i)² - m (a + b·r_com) + ½ m (ε_a (a - 1)² + ε_b L² |b|²).

With all cells supported, a = 1, b = 0 and N_i = m_i g. The share s_i of a cell over the table rises smoothly
from 0 to 1 across the rim, s = t² (3 - 2t), t = ½ + d/W, with the distance d of the cell's centre from the
rim and W = sqrt(5/3) w. With this W a cell's share has the same mean and variance over d as the area of a
square at any angle. For a rectangular table the shares of both directions are multiplied; for a round one of
radius R, d = (R² - ρ²) / 2R at a distance ρ from its centre.

If the supported cells cannot hold the centre of mass, the last term, otherwise too small to show, lets the
loads gather on the cells about which the object tips. The results stay finite and continuous, but a real
tipping body moves differently. `TIPS` records when tipping begins.

The loads are those at the start of a step, so each step keeps its own convex problem.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.compiled import compiled
from slipmap.models.physics.friction import load_gradients
from slipmap.models.physics.kernel_tools import turned
from slipmap.models.physics.newton import LANES, plain_gradients

BLUR = math.sqrt(5.0 / 3.0)
"""W / w: number of cell widths over which a cell's share rises from 0 to 1."""

# ε_a and ε_b: with these a tipping body keeps its weight to a thousandth, and the moments of a stable one are
# off by less than a millionth.
_HOLD_SUM, _HOLD_MOMENTS = 1e-10, 1e-7
# Share of the weight on cells whose contact is misjudged, tolerated at the solution.
_TOLERANCE = 1e-10
_PLAIN_ROUNDS, _ROUNDS = 8, 100

# Entries of `Rim.flags`.
NEAR, TOUCHED, CHANGED = 0, 1, 2
# Entries of `Rim.found`, and of a result's `rim`.
TIPS, REACHED, FIRST_POSE, FIRST_FORCE = 0, 1, 2, 3
RIM_RESULTS = 4
"""Number of entries for a push: time from its start at which the object first tips, s, infinite if never;
whether it came near the rim; the first sampled pose and the first sampled force after that."""

_FAST = {"reassoc", "contract", "arcp", "nsz", "nnan"}


class Rim(NamedTuple):
    """The table under one model in one push, with storage for results; N is n padded to whole lanes."""

    # centre (2), radius, half sides (2), m, cosine and sine of the table's angle; the radius is 0 for a
    # rectangle, the sides are 0 for a disc
    top: tuple[float, float, float, float, float, float, float]
    # round table: largest distance of the object's origin from its centre at which all cells are wholly
    # supported at any angle, m; rectangular table: minus the smallest such distance inside the sides
    room: float
    blur: float  # W, m
    scale: float  # L, m
    center: tuple[float, float]  # of mass, object frame, m
    # rx, ry, mass, plain: (N,) centres, m, masses, kg, and friction loads when all cells are supported, N
    rx: NDArray[np.float64]
    ry: NDArray[np.float64]
    mass: NDArray[np.float64]
    plain: NDArray[np.float64]
    # share, held: (N,) s_i and m_i s_i
    share: NDArray[np.float64]
    held: NDArray[np.float64]
    # factor, load: (N,) φ_i and friction loads, N
    factor: NDArray[np.float64]
    load: NDArray[np.float64]
    plane: NDArray[np.float64]  # (3,) a, b_x, b_y
    at: NDArray[np.float64]  # (4,) pose to which these belong: x, y, cosine and sine
    # (6,) parts of A, the Hessian of F: A_00, the rest of its first row over A_00 (2), and the inverse of the
    # Schur complement (xx, xy, yy)
    parts: NDArray[np.float64]
    # (3,) whether cells may be beyond the rim in this step; in this push so far; whether the rows of the
    # Jacobian that hold the cells' centres were overwritten
    flags: NDArray[np.int64]
    found: NDArray[np.float64]  # (RIM_RESULTS,)
    ones: NDArray[np.float64]  # (N,)
    # (3, N) derivatives of the shares with respect to x, y, θ of the object; like all arrays below, without
    # columns if there is no Jacobian
    by_pose: NDArray[np.float64]
    by_load: NDArray[np.float64]  # (3, N) see `load_gradients`
    # total, moving, pressing: (N,), (N,) and (2, N), see `_weigh`
    total: NDArray[np.float64]
    moving: NDArray[np.float64]
    pressing: NDArray[np.float64]
    # (3, 4) change of the gradient with the right-hand sides of a, b_x, b_y, and with the mass itself; zero
    # while no cells are beyond the rim
    lift: NDArray[np.float64]


@compiled()
def rim_of(table, mass, body, cells, cell_width, size, derive):  # type: ignore[no-untyped-def]
    """`Rim` of a model on a table (7,), its `top`.

    Args:
        table: (7,).
        mass: (n,).
        body: m, s_x, s_y, J.
        cells: `Cells` with all of them supported.
        cell_width, size: m.
        derive: whether derivatives are wanted.
    """
    N = cells.rx.shape[0]
    rows, more = np.zeros((6, N)), np.zeros((10, N if derive else 0))
    numbers = np.zeros(13)
    reach2 = 0.0
    for i in range(mass.shape[0]):
        rows[0, i] = mass[i]
        reach2 = max(reach2, cells.rx[i] * cells.rx[i] + cells.ry[i] * cells.ry[i])
    for i in range(N):
        rows[5, i] = 1.0
    found = np.zeros(RIM_RESULTS)
    numbers[0], numbers[3], found[TIPS] = 1.0, math.nan, math.inf
    top = (table[0], table[1], table[2], table[3], table[4], table[5], table[6])
    reach, blur, radius = math.sqrt(reach2), BLUR * cell_width, table[2]
    # From (R² - ρ²) / 2R = W/2 for the farthest cell.
    room = math.sqrt(max(radius * (radius - blur), 0.0)) - reach if radius > 0.0 else -reach - 0.5 * blur
    center = (body[1] / body[0], body[2] / body[0])
    return Rim(
        top, room, blur, size, center, cells.rx, cells.ry, rows[0], cells.load, rows[1],
        rows[2], rows[3], rows[4], numbers[:3], numbers[3:7], numbers[7:], np.zeros(3, np.int64), found,
        rows[5], more[:3], more[3:6], more[6], more[7], more[8:], np.zeros((3, 4)),
    )  # fmt: skip


@compiled(forceinline=True)
def wholly_on(rim, x, y):  # type: ignore[no-untyped-def]
    """Whether all cells of an object with its origin at (x, y), world, are wholly supported at any angle."""
    middle_x, middle_y, radius, half_x, half_y, cos, sin = rim.top
    dx, dy, room = x - middle_x, y - middle_y, rim.room
    if radius > 0.0:
        return room > 0.0 and dx * dx + dy * dy <= room * room
    dx, dy = turned(cos, -sin, dx, dy)
    return abs(dx) <= half_x + room and abs(dy) <= half_y + room


@compiled(forceinline=True, fastmath={"contract"})
def _beyond(top, x, y):  # type: ignore[no-untyped-def]
    """Whether the point (x, y), world, lies beyond the rim."""
    middle_x, middle_y, radius, half_x, half_y, cos, sin = top
    dx, dy = x - middle_x, y - middle_y
    if radius > 0.0:
        return dx * dx + dy * dy > radius * radius
    dx, dy = turned(cos, -sin, dx, dy)
    return abs(dx) > half_x or abs(dy) > half_y


@compiled(forceinline=True, fastmath=_FAST)
def _set_shares(top, blur, pose, rx, ry, mass, share, held):  # type: ignore[no-untyped-def]
    """Set the cells' shares and held masses for an object at a pose: x, y, cosine and sine."""
    middle_x, middle_y, radius, half_x, half_y, table_cos, table_sin = top
    x, y, cos, sin = pose
    # From here on in the table's frame.
    dx, dy = turned(table_cos, -table_sin, x - middle_x, y - middle_y)
    cos, sin = turned(table_cos, -table_sin, cos, sin)
    if radius > 0.0:
        per = 0.5 / (radius * blur)
        begin = 0.5 + radius * radius * per
        for i in range(rx.shape[0]):
            px, py = dx + cos * rx[i] - sin * ry[i], dy + sin * rx[i] + cos * ry[i]
            t = min(max(begin - (px * px + py * py) * per, 0.0), 1.0)
            s = t * t * (3.0 - 2.0 * t)
            share[i] = s
            held[i] = mass[i] * s
    else:
        per = 1.0 / blur
        begin_x, begin_y = 0.5 + half_x * per, 0.5 + half_y * per
        for i in range(rx.shape[0]):
            px, py = dx + cos * rx[i] - sin * ry[i], dy + sin * rx[i] + cos * ry[i]
            t = min(max(begin_x - abs(px) * per, 0.0), 1.0)
            u = min(max(begin_y - abs(py) * per, 0.0), 1.0)
            s = t * t * (3.0 - 2.0 * t) * u * u * (3.0 - 2.0 * u)
            share[i] = s
            held[i] = mass[i] * s


@compiled(forceinline=True, fastmath=_FAST)
def _moments(held, rx, ry, a, bx, by):  # type: ignore[no-untyped-def]
    """Sums of m_i s_i times 1, x, y, x², xy, y² over the cells in touch."""
    w = wx = wy = wxx = wxy = wyy = 0.0
    for i in range(held.shape[0]):
        x, y = rx[i], ry[i]
        m = held[i] if a + bx * x + by * y > 0.0 else 0.0
        mx, my = m * x, m * y
        w += m
        wx += mx
        wy += my
        wxx += mx * x
        wxy += mx * y
        wyy += my * y
    return w, wx, wy, wxx, wxy, wyy


@compiled(forceinline=True)
def _solved(parts, v0, v1, v2):  # type: ignore[no-untyped-def]
    """A⁻¹ (v_0, v_1, v_2), from the parts of A."""
    q1, q2 = v1 - parts[1] * v0, v2 - parts[2] * v0
    bx, by = parts[3] * q1 + parts[4] * q2, parts[4] * q1 + parts[5] * q2
    return v0 / parts[0] - parts[1] * bx - parts[2] * by, bx, by


@compiled(forceinline=True)
def _next_plane(held, rx, ry, plane, parts, body, scale):  # type: ignore[no-untyped-def]
    """Minimum a, b_x, b_y of F if the cells in touch stayed the same; sets the parts of A."""
    m, sx, sy = body[0], body[1], body[2]
    w, wx, wy, wxx, wxy, wyy = _moments(held, rx, ry, plane[0], plane[1], plane[2])
    w += _HOLD_SUM * m
    per = 1.0 / w
    ux, uy = wx * per, wy * per
    hold = _HOLD_MOMENTS * m * scale * scale
    xx, xy, yy = wxx - ux * wx + hold, wxy - ux * wy, wyy - uy * wy + hold
    inverse = 1.0 / (xx * yy - xy * xy)
    parts[0], parts[1], parts[2] = w, ux, uy
    parts[3], parts[4], parts[5] = yy * inverse, -xy * inverse, xx * inverse
    return _solved(parts, m + _HOLD_SUM * m, sx, sy)


@compiled(forceinline=True, fastmath=_FAST)
def _set_loads(rx, ry, share, held, plain, factor, load, plane, new):  # type: ignore[no-untyped-def]
    """Set factors and loads at a new plane; returns the mass on cells that the old plane misjudged, kg."""
    a, bx, by = new
    old_a, old_x, old_y = plane[0], plane[1], plane[2]
    wrong = 0.0
    for i in range(rx.shape[0]):
        x, y = rx[i], ry[i]
        depth = a + bx * x + by * y
        pressed = max(depth, 0.0)
        taken = depth if old_a + old_x * x + old_y * y > 0.0 else 0.0
        wrong += held[i] * abs(pressed - taken)
        carried = share[i] * pressed
        factor[i] = carried
        load[i] = plain[i] * carried
    plane[0], plane[1], plane[2] = a, bx, by
    return wrong


@compiled(fastmath=_FAST)
def _slope(held, rx, ry, plane, body, hold, d, t):  # type: ignore[no-untyped-def]
    """Derivative of F along d (3), at the plane plus t times d; `hold` is ε_b L² m."""
    m = body[0]
    a, bx, by = plane[0] + t * d[0], plane[1] + t * d[1], plane[2] + t * d[2]
    slope = (
        (_HOLD_SUM * (a - 1.0) - 1.0) * m * d[0] + (hold * bx - body[1]) * d[1] + (hold * by - body[2]) * d[2]
    )
    for i in range(rx.shape[0]):
        slope += held[i] * max(a + bx * rx[i] + by * ry[i], 0.0) * (d[0] + d[1] * rx[i] + d[2] * ry[i])
    return slope


@compiled()
def _settle(held, rx, ry, plane, parts, body, scale):  # type: ignore[no-untyped-def]
    """Newton's method with steps that end at the minimum of F along them at the latest."""
    hold = _HOLD_MOMENTS * body[0] * scale * scale
    for _ in range(_ROUNDS):
        new = _next_plane(held, rx, ry, plane, parts, body, scale)
        d = (new[0] - plane[0], new[1] - plane[1], new[2] - plane[2])
        begin = _slope(held, rx, ry, plane, body, hold, d, 0.0)
        if not -begin > 1e-24 * body[0]:
            break
        low, high = 0.0, 1.0
        if _slope(held, rx, ry, plane, body, hold, d, 1.0) > -1e-6 * begin:
            while high - low > 1e-9:
                t = 0.5 * (low + high)
                if _slope(held, rx, ry, plane, body, hold, d, t) > 0.0:
                    high = t
                else:
                    low = t
        plane[0], plane[1], plane[2] = plane[0] + high * d[0], plane[1] + high * d[1], plane[2] + high * d[2]


@compiled(forceinline=True)
def spread_loads(rim, body, x, y, cos, sin):  # type: ignore[no-untyped-def]
    """Set the loads of an object with inertia m, s_x, s_y, J at a pose.

    Uses Newton's method from the last plane. F is quadratic while the same cells stay in touch, so one round
    suffices if these are right. An object that has not moved keeps its loads.
    """
    rx, ry, share, held, plane, parts, at = rim.rx, rim.ry, rim.share, rim.held, rim.plane, rim.parts, rim.at
    if at[0] == x and at[1] == y and at[2] == cos and at[3] == sin:
        return
    at[0], at[1], at[2], at[3] = x, y, cos, sin
    _set_shares(rim.top, rim.blur, (x, y, cos, sin), rx, ry, rim.mass, share, held)
    wrong, attempt = math.inf, 0
    while wrong > _TOLERANCE * body[0] and attempt < _PLAIN_ROUNDS + 2:
        if attempt == _PLAIN_ROUNDS:
            _settle(held, rx, ry, plane, parts, body, rim.scale)
        new = _next_plane(held, rx, ry, plane, parts, body, rim.scale)
        wrong = _set_loads(rx, ry, share, held, rim.plain, rim.factor, rim.load, plane, new)
        attempt += 1


@compiled(forceinline=True)
def note_tipping(rim, x, y, cos, sin, cell_width, time):  # type: ignore[no-untyped-def]
    """Record the time at which the object first tips; call it after `spread_loads`.

    The object tips if its centre of mass lies beyond the rim, since a table is convex. With the centre of
    mass over the table, it tips if the cells in touch cannot balance it to within half a cell width, which
    happens with concave objects.
    """
    if rim.found[TIPS] < math.inf:
        return
    cx, cy = rim.center
    a, bx, by = rim.plane[0], rim.plane[1], rim.plane[2]
    hold = _HOLD_MOMENTS * rim.scale * rim.scale
    beyond = _beyond(rim.top, x + cos * cx - sin * cy, y + sin * cx + cos * cy)
    lever2 = hold * hold * (bx * bx + by * by)
    if beyond or lever2 > 0.25 * cell_width * cell_width or _HOLD_SUM * a > 0.5:
        rim.found[TIPS] = time


@compiled(forceinline=True, fastmath=_FAST)
def _share_slopes(top, blur, pose, rx, ry, by_x, by_y, by_turn):  # type: ignore[no-untyped-def]
    """Set the derivatives of the shares with respect to x, y, θ at a pose: x, y, cosine and sine."""
    middle_x, middle_y, radius, half_x, half_y, table_cos, table_sin = top
    x, y, cos, sin = pose
    # From here on in the table's frame.
    dx, dy = turned(table_cos, -table_sin, x - middle_x, y - middle_y)
    cos, sin = turned(table_cos, -table_sin, cos, sin)
    if radius > 0.0:
        per = 0.5 / (radius * blur)
        begin = 0.5 + radius * radius * per
        for i in range(rx.shape[0]):
            arm_x, arm_y = cos * rx[i] - sin * ry[i], sin * rx[i] + cos * ry[i]
            px, py = dx + arm_x, dy + arm_y
            t = min(max(begin - (px * px + py * py) * per, 0.0), 1.0)
            slope = -12.0 * t * (1.0 - t) * per
            gx, gy = slope * px, slope * py
            by_x[i] = table_cos * gx - table_sin * gy
            by_y[i] = table_sin * gx + table_cos * gy
            by_turn[i] = gy * arm_x - gx * arm_y
    else:
        per = 1.0 / blur
        begin_x, begin_y = 0.5 + half_x * per, 0.5 + half_y * per
        for i in range(rx.shape[0]):
            arm_x, arm_y = cos * rx[i] - sin * ry[i], sin * rx[i] + cos * ry[i]
            px, py = dx + arm_x, dy + arm_y
            t = min(max(begin_x - abs(px) * per, 0.0), 1.0)
            u = min(max(begin_y - abs(py) * per, 0.0), 1.0)
            gx = -6.0 * t * (1.0 - t) * per * u * u * (3.0 - 2.0 * u)
            gy = -6.0 * u * (1.0 - u) * per * t * t * (3.0 - 2.0 * t)
            gx = gx if px > 0.0 else -gx
            gy = gy if py > 0.0 else -gy
            by_x[i] = table_cos * gx - table_sin * gy
            by_y[i] = table_sin * gx + table_cos * gy
            by_turn[i] = gy * arm_x - gx * arm_y


@compiled(forceinline=True)
def set_share_slopes(rim, x, y, cos, sin):  # type: ignore[no-untyped-def]
    """Set the derivatives of the shares with respect to the pose."""
    d = rim.by_pose
    _share_slopes(rim.top, rim.blur, (x, y, cos, sin), rim.rx, rim.ry, d[0], d[1], d[2])


@compiled(forceinline=True)
def set_gradients(rim, effects, cells, v):  # type: ignore[no-untyped-def]
    """Set the derivatives of friction's gradient at the twist v with respect to the cells' loads."""
    if effects is None:
        plain_gradients(cells, v, rim.by_load)
    else:
        load_gradients(cells, v, rim.by_load)


@compiled(forceinline=True, fastmath=_FAST)
def _weigh(weight, factor, plain, share, mass, rx, ry, plane, total, moving, pressing):  # type: ignore[no-untyped-def]
    """Fill arrays (N,) with products, weight_i φ_i into `total` and weight_i f_i p_i into `moving`.

    pressing[0] gets m_i p_i, pressing[1] gets weight_i f_i s_i of the cells in touch, 0 elsewhere.
    """
    a, bx, by = plane[0], plane[1], plane[2]
    pulled, held = pressing[0], pressing[1]
    for i in range(rx.shape[0]):
        depth = a + bx * rx[i] + by * ry[i]
        pressed = max(depth, 0.0)
        load = weight[i] * plain[i]
        total[i] = weight[i] * factor[i]
        moving[i] = load * pressed
        held[i] = load * share[i] if depth > 0.0 else 0.0
        pulled[i] = mass[i] * pressed


@compiled(forceinline=True, fastmath=_FAST)
def _first_moments(k, row, rx, ry):  # type: ignore[no-untyped-def]
    """Σ k_i n_i (1, x_i, y_i), with n_i from `row`."""
    w = wx = wy = 0.0
    for i in range(rx.shape[0]):
        product = k[i] * row[i]
        w += product
        wx += product * rx[i]
        wy += product * ry[i]
    return w, wx, wy


@compiled(forceinline=True, fastmath=_FAST)
def _by_shares(moving, by_load, by_turn_of):  # type: ignore[no-untyped-def]
    """Σ k_i n_ai s'_i for a = 0, 1, 2: k from `moving` (N,), n from `by_load` (3, N), s' (N,)."""
    first, second, third = by_load[0], by_load[1], by_load[2]
    x = y = w = 0.0
    for i in range(moving.shape[0]):
        k = moving[i] * by_turn_of[i]
        x += k * first[i]
        y += k * second[i]
        w += k * third[i]
    return x, y, w


@compiled()
def _add_shift(  # type: ignore[no-untyped-def]
    rx, ry, by_load, by_pose, moving, pressing, parts, plane, hold, h, lift, state
):
    """Compute the sums of `add_share_slopes`."""
    for a in range(3):
        w, wx, wy = _first_moments(pressing[1], by_load[a], rx, ry)
        m0, m1, m2 = _solved(parts, h * w, h * wx, h * wy)
        lift[a, 0], lift[a, 1], lift[a, 2] = m0, m1, m2
        lift[a, 3] = m0 * _HOLD_SUM * (plane[0] - 1.0) + hold * (m1 * plane[1] + m2 * plane[2])
    for k in range(3):
        q, qx, qy = _first_moments(pressing[0], by_pose[k], rx, ry)
        change = _by_shares(moving, by_load, by_pose[k])
        for a in range(3):
            state[a, k] += h * change[a] - lift[a, 0] * q - lift[a, 1] * qx - lift[a, 2] * qy


@compiled(forceinline=True)
def add_share_slopes(rim, weight, h, state):  # type: ignore[no-untyped-def]
    """Add the effect of the pose through the loads to `Slopes.state`; sets `lift` and `total`.

    With W = h Σ weight_i f_i s_i n_i (1, r_i)ᵀ over the cells in touch, n_i the derivative of the gradient
    with respect to the load, and p_i = max(0, a + b·r_i), the step's gradient changes with the shares by

        h Σ weight_i f_i p_i n_i ds_i - W A⁻¹ Σ m_i p_i (1, r_i) ds_i,

    and with the mass of cell i, at fixed friction loads m_i mu_i g, by W A⁻¹ ((1 - φ_i) (1, r_i) - e) with
    e = (ε_a (a - 1), ε_b L² b).

    Args:
        rim: `Rim` with `by_load` and `by_pose` set.
        weight: (N,) factors of effects on the loads.
        h: step, s.
        state: `Slopes.state`.
    """
    rx, ry, plane = rim.rx, rim.ry, rim.plane
    _weigh(
        weight, rim.factor, rim.plain, rim.share, rim.mass, rx, ry, plane, rim.total, rim.moving, rim.pressing
    )  # fmt: skip
    hold = _HOLD_MOMENTS * rim.scale * rim.scale
    _add_shift(
        rx, ry, rim.by_load, rim.by_pose, rim.moving, rim.pressing, rim.parts, plane, hold, h, rim.lift, state
    )  # fmt: skip


@compiled(forceinline=True)
def thin_drag(rim, drag):  # type: ignore[no-untyped-def]
    """Scale drag (n,) by the supported share of each cell."""
    if rim is not None and rim.flags[NEAR] != 0:
        for i in range(drag.shape[0]):
            drag[i] *= rim.share[i]


@compiled(forceinline=True)
def add_drag_slopes(rim, drag, by_drag, state):  # type: ignore[no-untyped-def]
    """Add the effect of the pose through the shares of drag, and scale by_drag (3, n) by the shares."""
    if rim is not None and rim.flags[NEAR] != 0:
        for a in range(3):
            for i in range(drag.shape[0]):
                share = rim.share[i]
                if share > 0.0:
                    for k in range(3):
                        state[a, k] += by_drag[a, i] * drag[i] / share * rim.by_pose[k, i]
                by_drag[a, i] *= share


@compiled(forceinline=True, fastmath={"contract"})
def mass_slopes(rx, ry, factor, lift, block):  # type: ignore[no-untyped-def]
    """Set three rows (3 * LANES,) to the gradient's derivatives with respect to cell masses (LANES,)."""
    for a in range(3):
        m0, m1, m2, e = lift[a, 0], lift[a, 1], lift[a, 2], lift[a, 3]
        row = block[a * LANES : (a + 1) * LANES]
        for lane in range(LANES):
            row[lane] = (1.0 - factor[lane]) * (m0 + m1 * rx[lane] + m2 * ry[lane]) - e


@compiled(forceinline=True)
def clear_lift(lift):  # type: ignore[no-untyped-def]
    """Set `lift` to zero: away from the rim, masses do not shift loads."""
    for a in range(3):
        for k in range(4):
            lift[a, k] = 0.0
