"""One convex time step V(x, v, F, M, mu) of the sliding object.

Over a step of length h the object's twist v (object frame, at the frame's origin) becomes

    v⁺ = argmin  ½ (v - v*)ᵀ M (v - v*)  +  h Σ_i f_i φ_i(v)  +  ℓ_contact(v)

with the free motion v*, the friction loads f_i = mu_i N_i and norms φ_i of `newton.py`, and the contact of
`contact.py`. The masses enter only through the total mass m, the first moment s = Σ m_i r_i and the second
moment J = Σ m_i (|r_i|² + w²/6): the rigid reduction of the paper's 3n equations.

Everything is written in a frame that moves with the object, at the middle of the step as predicted from the
last twist. Poses move along the exact screw motion of v⁺, so neither the choice of the world frame nor that
of the object frame changes a trajectory.

`kernel.py` holds the sequence of these computations, `slopes.py` the derivatives.

The last bits of results depend on the order of fields and arguments here: the compiler uses it to order the
two products of a sum, one of which is rounded and the other fused with the addition.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from slipmap.models.physics.compiled import compiled
from slipmap.models.physics.contact import (
    SEPARATE,
    Cone,
    Contact,
    find_contacts,
    stiffening_of,
)
from slipmap.models.physics.kernel_tools import Turn, joined, turn_by, turned
from slipmap.models.physics.newton import (
    Impulse,
    Minimum,
    minimum_of,
    slope_along,
    smooth_model,
    solve_with_contacts,
    with_contact,
)

INERTIA_COLUMNS = 4
EXTRA_COLUMNS = INERTIA_COLUMNS + 1 + 6
"""Number of columns after the n loads: inertia, finger friction, start."""

MAX_EVALUATIONS = 300
"""Sums over the cells in a step. A push takes two or three; where blades and rest meet, over a hundred."""

# A step ignores gaps that exceed what it can close by more than this, m.
_CONTACT_MARGIN = 1e-3
# Newton stops when the remaining error is below this speed, m/s, rotation counted at the object's radius.
_VELOCITY_TOLERANCE = 1e-14
# Speeds below this are set to zero, m/s: subnormal numbers slow a processor down a hundredfold.
_SLOWEST = 1e-60
REST = (0.0, 0.0, 0.0)
# Relative error allowed in the Hessian from which derivatives follow.
_HESSIAN_TOLERANCE = 1e-8


class Frame(NamedTuple):
    """Middle frame of a step, in which its problem is written, with the finger in that frame."""

    # cos, sin: of its angle in the world
    cos: float
    sin: float
    # tip_x, tip_y: finger centre in the middle of the step, m
    tip_x: float
    tip_y: float
    # speed_x, speed_y: velocity of the finger, m/s
    speed_x: float
    speed_y: float
    # spring_x, spring_y: velocity with which a free bent finger would straighten, m/s; 0 for a rigid finger
    spring_x: float
    spring_y: float
    rolling: float  # speed of the surface of a finger that turns, counterclockwise, m/s


class Applied(NamedTuple):
    """Impulse of applied forces in a step, middle frame."""

    # x, y: N s
    x: float
    y: float
    turning: float  # derivative of its moment about the origin with respect to the object's angle, N m s
    spin: float  # its moment about the origin, N m s


class Step(NamedTuple):
    """The problem of one step, unsolved."""

    cells: Any  # `Cells`, or another class registered with `newton.register_cells`
    inertia: tuple[float, float, float, float]  # m, s_x, s_y, J
    # momentum of the free motion and of applied forces: p_x, p_y and L about the frame's origin
    star: tuple[float, float, float]
    h: float  # length of the step, s
    # first, second: the nearest contact and the next
    first: Contact
    second: Contact
    contacts: int  # number of contacts
    cone: Cone  # law of the contacts
    size: float  # radius of the object, m, at which rotation counts
    v: tuple[float, float, float]  # twist before the step, object frame
    quarter: Turn  # `Turn` by h omega / 4
    frame: Frame  # middle frame


class Way(NamedTuple):
    """Motion of the pose in a step: along the screw of v⁺, by h sinc(h omega/2) R(θ + h omega/2) v⁺."""

    quarter: Turn  # `Turn` by h omega/4
    # half_cos, half_sin: of h omega/2
    half_cos: float
    half_sin: float
    # cos, sin: of the angle halfway
    cos: float
    sin: float
    # wx, wy: direction times speed, world
    wx: float
    wy: float
    length: float  # h sinc(h omega/2), s


class Solution(NamedTuple):
    """Solved step: the new twist, the last Newton iteration, and the number of sums over the cells.

    `evaluations` is above `MAX_EVALUATIONS` if the minimum was not reached.
    """

    new: tuple[float, float, float]
    minimum: Minimum
    evaluations: int


@compiled(forceinline=True, fastmath={"contract"})
def free_momentum(inertia, v, cos, sin):  # type: ignore[no-untyped-def]
    """Momentum p_x, p_y, L of the free motion from the last twist v, about the new frame's origin.

    In that frame the linear part turns by -h omega, with `cos` and `sin` of h omega; the spin stays.
    """
    m, sx, sy, J = inertia
    vx, vy, omega = v
    px = m * vx - sy * omega
    py = m * vy + sx * omega
    L = sx * vy - sy * vx + J * omega
    qx, qy = turned(cos, -sin, px, py)
    return qx, qy, L + (sx * (qy - py) - sy * (qx - px)) / m


@compiled(forceinline=True, fastmath={"contract"})
def middle_frame(x, y, cos, sin, quarter, v, h, tip0, tip1, rolling):  # type: ignore[no-untyped-def]
    """`Frame` at the middle of the step, predicted from the last twist.

    Args:
        x, y: the object's origin before the step, world, m.
        cos, sin: of the object's angle then.
        quarter: `Turn` by h omega / 4.
        v: last twist, object frame.
        h: step, s.
        tip0, tip1: finger centre at the start of the step and at its end, world, m.
        rolling: see `Frame`.
    """
    half_cos = quarter.cos * quarter.cos - quarter.sin * quarter.sin
    half_sin = 2.0 * quarter.cos * quarter.sin
    c, s = turned(cos, sin, quarter.cos, quarter.sin)
    wx, wy = turned(c, s, v[0], v[1])
    half_way = 0.5 * h * quarter.sinc
    c, s = turned(cos, sin, half_cos, half_sin)
    dx = 0.5 * (tip0[0] + tip1[0]) - x - half_way * wx
    dy = 0.5 * (tip0[1] + tip1[1]) - y - half_way * wy
    tip_x, tip_y = turned(c, -s, dx, dy)
    speed_x, speed_y = turned(c, -s, (tip1[0] - tip0[0]) / h, (tip1[1] - tip0[1]) / h)
    return Frame(c, s, tip_x, tip_y, speed_x, speed_y, 0.0, 0.0, rolling)


@compiled(forceinline=True)
def bent_frame(frame, bend_x, bend_y, settling):  # type: ignore[no-untyped-def]
    """The `Frame` with a finger bend_x, bend_y (world, m) off its recorded place.

    `settling` is its time constant, s.
    """
    x, y = turned(frame.cos, -frame.sin, bend_x / settling, bend_y / settling)
    speed_x, speed_y = frame.speed_x, frame.speed_y
    return Frame(frame.cos, frame.sin, frame.tip_x, frame.tip_y, speed_x, speed_y, x, y, frame.rolling)


@compiled(forceinline=True)
def applied_impulse(row, cos, sin, h):  # type: ignore[no-untyped-def]
    """`Applied` of one row of a push's wrenches.

    Args:
        row: (5,) force (world, N), its point (object frame, m) and a torque (N m).
        cos, sin: of the middle frame's angle.
        h: step, s.
    """
    fx, fy = turned(cos, -sin, row[0], row[1])
    px, py = row[2], row[3]
    return Applied(h * fx, h * fy, -h * (px * fx + py * fy), h * (px * fy - py * fx + row[4]))


@compiled(forceinline=True, fastmath={"contract"})
def touching(frame, v, h, common, rows, gain):  # type: ignore[no-untyped-def]
    """Write the contacts of a step into rows (MAX_CONTACTS, CONTACT_COLUMNS); returns their number.

    `gain` is the largest speed, m/s, that applied forces give any point of the object in the step.
    """
    speeds = abs(frame.speed_x) + abs(frame.speed_y) + _size_of(v, common.size) + gain
    reach = _CONTACT_MARGIN + 2.0 * h * speeds
    far = common.size + common.radius + reach
    if frame.tip_x * frame.tip_x + frame.tip_y * frame.tip_y > far * far:
        return 0
    return find_contacts(frame.tip_x, frame.tip_y, common.radius, reach, common.edges, rows)


@compiled(forceinline=True, fastmath={"contract"})
def contact_of(rows, k, frame, v, h, cone):  # type: ignore[no-untyped-def]
    """`Contact` from row k of `find_contacts`, with the gap taken back from mid-step to the start."""
    nx, ny, x, y, gap = rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4]
    nw = x * ny - y * nx
    tw = x * nx + y * ny
    finger = nx * frame.speed_x + ny * frame.speed_y
    gap += 0.5 * h * (nx * v[0] + ny * v[1] + nw * v[2] - finger)
    stiffening = stiffening_of(gap, cone)
    closing = gap / (h * stiffening) + finger + nx * frame.spring_x + ny * frame.spring_y
    drag = nx * (frame.speed_y + frame.spring_y) - ny * (frame.speed_x + frame.spring_x) - frame.rolling
    normal = h * h * stiffening / (cone.give + stiffening * cone.compliance)
    ratio = normal / cone.tangential
    turn, slide = rows[k, 5], rows[k, 6]
    return Contact(nx, ny, x, y, nw, tw, closing, drag, turn, slide, gap, stiffening, normal, ratio)


@compiled(forceinline=True, fastmath={"contract"})
def weighted(weights, past):  # type: ignore[no-untyped-def]
    """Guess of the next twist: weighted sum of the last three, the newest first.

    In a smooth push it saves Newton's second evaluation.
    """
    a, b, c = weights
    last, second, third = past
    return (
        a * last[0] + b * second[0] + c * third[0],
        a * last[1] + b * second[1] + c * third[1],
        a * last[2] + b * second[2] + c * third[2],
    )


@compiled(forceinline=True, fastmath={"contract"})
def best_weights(new, past, size):  # type: ignore[no-untyped-def]
    """Weights of the extrapolation that would have come nearest to `new`, for the next step.

    The candidates are polynomials of order 0 to 2 through the last twists. `size` is the object's radius, m,
    at which rotation counts.
    """
    constant = (1.0, 0.0, 0.0)
    linear = (2.0, -1.0, 0.0)
    quadratic = (3.0, -3.0, 1.0)
    best, nearest = constant, _distance(new, past[0], size)
    for weights in (linear, quadratic):
        error = _distance(new, weighted(weights, past), size)
        if error < nearest:
            best, nearest = weights, error
    return best


@compiled(forceinline=True)
def _distance(a, b, size):  # type: ignore[no-untyped-def]
    return abs(a[0] - b[0]) + abs(a[1] - b[1]) + size * abs(a[2] - b[2])


@compiled(forceinline=True, fastmath={"contract"})
def _size_of(d, size):  # type: ignore[no-untyped-def]
    """Size of a change of twist as a speed, rotation counted at the radius `size`."""
    return abs(d[0]) + abs(d[1]) + size * abs(d[2])


@compiled(forceinline=True, fastmath={"contract"})
def _change_of_hessian(minimum, bend, d, h, size):  # type: ignore[no-untyped-def]
    """Bound on the relative change of the Hessian along d.

    Along any direction of unit speed the third derivative of f φ is at most 3/2 f/φ². `bend` is the sum of
    f/φ² over the cells, and the trace bounds the inverse Hessian.
    """
    trace = minimum.xx + minimum.yy + size * size * minimum.ww
    return 1.5 * h * bend * trace * _size_of(d, size)


@compiled(forceinline=True, fastmath={"contract"})
def solve_step(step, start, exact_hessian, settled):  # type: ignore[no-untyped-def]
    """`Solution` of a step: the minimum of its function.

    Newton's method on the smooth part, with exact contact in every iteration (`solve_with_contacts`).
    `_bracketed` shortens steps that overshoot. Half the relative change of the Hessian along a Newton step,
    times that step, bounds the error after it: if the bound is small, the end point needs no evaluation.

    Args:
        step: `Step`.
        start: guess of the new twist.
        exact_hessian: whether the inverse Hessian must be the one at the solution.
        settled: whether an object that stays at rest needs no inverse Hessian.
    """
    if settled and step.contacts == 0 and start == REST and step.star == REST:
        none = Impulse(SEPARATE, 0.0, 0.0)
        return Solution(start, Minimum(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, none, none), 0)
    size = step.size
    v = start
    model, bend = _smooth_part(step, v)
    evaluations = 1
    try_rest = True
    while True:
        minimum = solve_with_contacts(model, v, step.first, step.second, step.contacts, step.cone)
        d = (minimum.dx, minimum.dy, minimum.dw)
        trial = (v[0] + d[0], v[1] + d[1], v[2] + d[2])
        change = _change_of_hessian(minimum, bend, d, step.h, size)
        if 0.5 * change * _size_of(d, size) < _VELOCITY_TOLERANCE:
            break
        slope = _slope(step, model, v, d)
        trial_model, trial_bend = _smooth_part(step, trial)
        evaluations += 1
        new_slope = _slope(step, trial_model, trial, d)
        if new_slope > 0.0 and new_slope > -0.5 * slope:
            v, model, bend, evaluations = _bracketed(step, v, d, slope, new_slope, evaluations, try_rest)
            try_rest = False
        else:
            v, model, bend = trial, trial_model, trial_bend
        if evaluations > MAX_EVALUATIONS:
            return Solution(v, minimum, evaluations)
    if exact_hessian and change > _HESSIAN_TOLERANCE:
        model, _ = _smooth_part(step, trial)
        evaluations += 1
        impulse1, impulse2 = minimum.first, minimum.second
        model = with_contact(model, step.first, step.cone, impulse1.state, 0.0, 0.0)
        model = with_contact(model, step.second, step.cone, impulse2.state, 0.0, 0.0)
        minimum = minimum_of(model, impulse1, impulse2)
    if _size_of(trial, size) < _SLOWEST:
        trial = REST
    return Solution(trial, minimum, evaluations)


@compiled(forceinline=True, fastmath={"contract"})
def _smooth_part(step, v):  # type: ignore[no-untyped-def]
    return smooth_model(step.cells, step.inertia, step.star, step.h, v)


@compiled(forceinline=True, fastmath={"contract"})
def _slope(step, model, v, d):  # type: ignore[no-untyped-def]
    return slope_along(model, v, d, step.first, step.second, step.contacts, step.cone)


@compiled()
def _bracketed(step, v, d, slope, high_slope, evaluations, try_rest):  # type: ignore[no-untyped-def]
    """Point along d at which the slope has fallen to half, for a full step that overshoots.

    Along a descent direction the slope of a convex function grows, so the minimum is bracketed. An overshoot
    usually means that the object comes to rest, the one sharp point of the sum of norms: rest is tried first,
    once per step (`try_rest`).

    Returns:
        The twist, the smooth model there and the bound on its change, and the number of evaluations.
    """
    if try_rest:
        rest = REST
        model, bend = _smooth_part(step, rest)
        evaluations += 1
        minimum = solve_with_contacts(model, rest, step.first, step.second, step.contacts, step.cone)
        way = (minimum.dx, minimum.dy, minimum.dw)
        if _size_of(way, step.size) < 2.0 * math.sqrt(step.cells.eps2):
            return rest, model, bend, evaluations
    low, low_slope, high = 0.0, slope, 1.0
    while True:
        secant = low + (high - low) * low_slope / (low_slope - high_slope)
        t = 0.5 * (min(max(secant, low), high) + 0.5 * (low + high))
        trial = (v[0] + t * d[0], v[1] + t * d[1], v[2] + t * d[2])
        model, bend = _smooth_part(step, trial)
        evaluations += 1
        new_slope = _slope(step, model, trial, d)
        found = abs(new_slope) <= -0.5 * slope or high - low < 1e-9
        if found or evaluations > MAX_EVALUATIONS:
            return trial, model, bend, evaluations
        if new_slope > 0.0:
            high, high_slope = t, new_slope
        else:
            low, low_slope = t, new_slope


@compiled(forceinline=True)
def way_of(new, cos, sin, h):  # type: ignore[no-untyped-def]
    """`Way` of the twist v⁺, starting at the angle with the given cosine and sine."""
    quarter = turn_by(0.25 * h * new[2])
    half_cos, half_sin = joined(quarter.cos, quarter.sin, quarter.cos, quarter.sin)
    c, s = joined(cos, sin, half_cos, half_sin)
    wx, wy = turned(c, s, new[0], new[1])
    return Way(quarter, half_cos, half_sin, c, s, wx, wy, h * quarter.sinc * quarter.cos)


@compiled(forceinline=True)
def way_by_spin(way, h):  # type: ignore[no-untyped-def]
    """Derivatives of x and y after the step with respect to omega."""
    # Derivative of sinc(α) = sinc(α/2) cos(α/2) with respect to omega, for α = h omega/2.
    slope = way.quarter.sinc_slope * way.quarter.cos - way.quarter.sinc * way.quarter.sin
    slope *= 0.25 * h * h
    bend = 0.5 * h * way.length
    return slope * way.wx - bend * way.wy, slope * way.wy + bend * way.wx
