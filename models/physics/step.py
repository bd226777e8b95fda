"""One convex time step V(x, v, F, M, mu) of the sliding object, and its exact derivative.

Over a step of length h the object's twist v (object frame, at the frame's origin) becomes

    v⁺ = argmin  ½ (v - v*)ᵀ M (v - v*)  +  h Σ_i f_i φ_i(v)  +  ℓ_contact(v)

with the free motion v*, the friction loads f_i = mu_i N_i and norms φ_i of `friction.py`, and the contact of
`contact.py`. The masses enter through total mass m, first moment s = Σ m_i r_i and second moment
J = Σ m_i (|r_i|² + w²/6) alone: the rigid reduction of the paper's 3n equations.

Everything is written in a frame that moves with the object and is taken at the middle of the step, predicted
from the last twist. Poses move along the exact screw motion of v⁺, so neither the choice of the world frame
nor that of the object frame changes a trajectory.

Derivatives follow from the implicit function theorem: where the gradient g(v⁺, p) of the function above
vanishes, dv⁺/dp = -H⁻¹ ∂g/∂p. The parameters of a rollout are, in this order,

    f_1 … f_n, m, s_x, s_y, J, mu_finger, and the start x, y, θ (world) and v_x, v_y, omega (object frame).

Where a contact is at the edge between sticking, sliding and apart, derivatives are those of the side on which
the solution was found (one-sided).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from models.physics.compiled import compiled
from models.physics.contact import Contact, find_contacts, stiffening_of
from models.physics.newton import (
    Minimum,
    minimum_of,
    slope_along,
    smooth_model,
    solve_with_contacts,
    with_contact,
)
from models.physics.turns import turned

START_COLUMNS = 6
INERTIA_COLUMNS = 4
EXTRA_COLUMNS = INERTIA_COLUMNS + 1 + START_COLUMNS
"""Columns after the n loads: inertia, finger friction, start."""

MAX_EVALUATIONS = 60
CONTACT_MARGIN = 1e-3
"""Gaps larger than this, and than what the step can close, are left out of the step (m)."""

VELOCITY_TOLERANCE = 1e-14
"""Newton stops when the error left is below this speed (m/s, rotation counted at the object's radius)."""

REST = 1e-60
"""Speeds below this are zero (m/s): subnormal numbers slow a processor down a hundredfold."""

HESSIAN_TOLERANCE = 1e-8
"""Relative error of the Hessian that the derivatives may inherit."""


class Frame(NamedTuple):
    """Middle frame of a step, in which its problem is written, and the finger seen from it.

    Attributes:
        cos: cosine of its angle in the world.
        sin: the sine.
        tip_x: finger centre in the middle of the step, m.
        tip_y: the same, y.
        speed_x: velocity of the finger, m/s.
        speed_y: the same, y.
        spring_x: speed at which a finger that bends (see `models.effects`) would straighten within the step
            if nothing held it, m/s; 0 for a rigid one.
        spring_y: the same, y.
    """

    cos: float
    sin: float
    tip_x: float
    tip_y: float
    speed_x: float
    speed_y: float
    spring_x: float
    spring_y: float


class Solution(NamedTuple):
    """Solved step: the new twist, the last Newton iteration, and how often the cells were summed over.

    `evaluations` is above `MAX_EVALUATIONS` if the minimum was not reached.
    """

    vx: float
    vy: float
    omega: float
    minimum: Minimum
    evaluations: int


@compiled(forceinline=True, fastmath={"contract"})
def free_momentum(inertia, v, cos, sin):  # type: ignore[no-untyped-def]
    """Momentum of the free motion, in the new frame: the linear part turns by -h omega, the spin stays.

    Args:
        inertia: m, s_x, s_y, J.
        v: twist of the last step.
        cos: cosine of h omega.
        sin: sine of h omega.

    Returns:
        p_x, p_y and L about the frame's origin.
    """
    m, sx, sy, J = inertia
    vx, vy, omega = v
    px = m * vx - sy * omega
    py = m * vy + sx * omega
    L = sx * vy - sy * vx + J * omega
    qx, qy = turned(cos, -sin, px, py)
    return qx, qy, L + (sx * (qy - py) - sy * (qx - px)) / m


@compiled(forceinline=True, fastmath={"contract"})
def _size_of(d, size):  # type: ignore[no-untyped-def]
    """Size of a change of twist as a speed, rotation counted at the radius `size`."""
    return abs(d[0]) + abs(d[1]) + size * abs(d[2])


@compiled(forceinline=True, fastmath={"contract"})
def _change_of_hessian(minimum, bend, d, h, size):  # type: ignore[no-untyped-def]
    """Bound on the relative change of the Hessian along d.

    The third derivative of f φ is at most 3/2 f/φ² along any direction of unit speed, and `bend` is the sum
    of f/φ² over the cells; the trace bounds the inverse Hessian.
    """
    trace = minimum.xx + minimum.yy + size * size * minimum.ww
    return 1.5 * h * bend * trace * _size_of(d, size)


@compiled(forceinline=True, fastmath={"contract"})
def solve_step(cells, inertia, star, h, first, second, count, cone, size, start, exact_hessian):  # type: ignore[no-untyped-def]
    """Minimise the step's function.

    Newton on the smooth part, with the contact kept exact in every iteration (`solve_with_contacts`). Steps
    that overshoot are left to `_bracketed`. Half the relative change of the Hessian along a Newton step,
    times that step, bounds the error after it: where that is small, nothing needs to be evaluated there.

    Args:
        cells: see `Cells`.
        inertia: m, s_x, s_y, J.
        star: momentum of the free motion and of applied forces.
        h: step, s.
        first: nearest contact.
        second: next contact.
        count: number of contacts.
        cone: law of the contacts.
        size: radius of the object, m.
        start: guess of the new twist.
        exact_hessian: whether the inverse Hessian must be that at the solution.

    Returns:
        `Solution`.
    """
    v = start
    model, bend = smooth_model(cells, inertia, star, h, v)
    evaluations = 1
    try_rest = True
    while True:
        minimum = solve_with_contacts(model, v, first, second, count, cone)
        d = (minimum.dx, minimum.dy, minimum.dw)
        trial = (v[0] + d[0], v[1] + d[1], v[2] + d[2])
        change = _change_of_hessian(minimum, bend, d, h, size)
        if 0.5 * change * _size_of(d, size) < VELOCITY_TOLERANCE:
            break
        slope = slope_along(model, v, d, first, second, count, cone)
        trial_model, trial_bend = smooth_model(cells, inertia, star, h, trial)
        evaluations += 1
        new_slope = slope_along(trial_model, trial, d, first, second, count, cone)
        if new_slope > 0.0 and new_slope > -0.5 * slope:
            v, model, bend, evaluations = _bracketed(
                cells, inertia, star, h, first, second, count, cone, size, v, d, slope, new_slope,
                evaluations, try_rest,
            )  # fmt: skip
            try_rest = False
        else:
            v, model, bend = trial, trial_model, trial_bend
        if evaluations > MAX_EVALUATIONS:
            return Solution(v[0], v[1], v[2], minimum, evaluations)
    if exact_hessian and change > HESSIAN_TOLERANCE:
        model, _ = smooth_model(cells, inertia, star, h, trial)
        evaluations += 1
        impulse1, impulse2 = minimum.first, minimum.second
        model = with_contact(model, first, cone, impulse1.state, 0.0, 0.0)
        model = with_contact(model, second, cone, impulse2.state, 0.0, 0.0)
        minimum = minimum_of(model, impulse1, impulse2)
    if _size_of(trial, size) < REST:
        trial = (0.0, 0.0, 0.0)
    return Solution(trial[0], trial[1], trial[2], minimum, evaluations)


@compiled()
def _bracketed(  # type: ignore[no-untyped-def]
    cells, inertia, star, h, first, second, count, cone, size, v, d, slope, high_slope, evaluations, try_rest
):  # fmt: skip
    """Point along d, where the full step overshoots, at which the slope has fallen to half.

    Along a descent direction the slope of a convex function grows, so the minimum is bracketed. An overshoot
    is mostly an object coming to rest, where the sum of norms has its one sharp point: rest is tried first,
    once a step (`try_rest`).

    Returns:
        The twist, the smooth model there and the bound on its change, and the number of evaluations.
    """
    if try_rest:
        rest = (0.0, 0.0, 0.0)
        model, bend = smooth_model(cells, inertia, star, h, rest)
        evaluations += 1
        minimum = solve_with_contacts(model, rest, first, second, count, cone)
        if _size_of((minimum.dx, minimum.dy, minimum.dw), size) < 2.0 * math.sqrt(cells.eps2):
            return rest, model, bend, evaluations
    low, low_slope, high = 0.0, slope, 1.0
    while True:
        secant = low + (high - low) * low_slope / (low_slope - high_slope)
        t = 0.5 * (min(max(secant, low), high) + 0.5 * (low + high))
        trial = (v[0] + t * d[0], v[1] + t * d[1], v[2] + t * d[2])
        model, bend = smooth_model(cells, inertia, star, h, trial)
        evaluations += 1
        new_slope = slope_along(model, trial, d, first, second, count, cone)
        found = abs(new_slope) <= -0.5 * slope or high - low < 1e-9
        if found or evaluations > MAX_EVALUATIONS:
            return trial, model, bend, evaluations
        if new_slope > 0.0:
            high, high_slope = t, new_slope
        else:
            low, low_slope = t, new_slope


@compiled(forceinline=True, fastmath={"contract"})
def middle_frame(x, y, cos, sin, quarter, v, h, tip0, tip1):  # type: ignore[no-untyped-def]
    """`Frame` at the middle of the step, predicted from the last twist.

    Args:
        x: object's origin before the step, world, m.
        y: the same, y.
        cos: cosine of its angle.
        sin: sine of its angle.
        quarter: `Turn` by h omega / 4.
        v: last twist, object frame.
        h: step, s.
        tip0: finger centre at the start of the step, world, m.
        tip1: the same at its end.
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
    return Frame(c, s, tip_x, tip_y, speed_x, speed_y, 0.0, 0.0)


@compiled(forceinline=True, fastmath={"contract"})
def touching(frame, v, h, radius, size, edges, rows, gain):  # type: ignore[no-untyped-def]
    """Find the contacts of a step.

    Args:
        frame: the step's middle frame.
        v: last twist.
        h: step, s.
        radius: finger radius, m.
        size: radius of the object, m.
        edges: (E, 4) outline.
        rows: (MAX_CONTACTS, CONTACT_COLUMNS) room for `find_contacts`.
        gain: most speed that applied forces give any point of the object in the step, m/s.

    Returns:
        Number of contacts; they are in `rows`.
    """
    speeds = abs(frame.speed_x) + abs(frame.speed_y) + _size_of(v, size) + gain
    reach = CONTACT_MARGIN + 2.0 * h * speeds
    far = size + radius + reach
    if frame.tip_x * frame.tip_x + frame.tip_y * frame.tip_y > far * far:
        return 0
    return find_contacts(frame.tip_x, frame.tip_y, radius, reach, edges, rows)


@compiled(forceinline=True, fastmath={"contract"})
def contact_of(rows, k, frame, v, h, cone):  # type: ignore[no-untyped-def]
    """`Contact` of row k of `find_contacts`; its gap is counted back from the predicted half step."""
    nx, ny, x, y, gap = rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4]
    nw = x * ny - y * nx
    tw = x * nx + y * ny
    finger = nx * frame.speed_x + ny * frame.speed_y
    gap += 0.5 * h * (nx * v[0] + ny * v[1] + nw * v[2] - finger)
    stiffening = stiffening_of(gap, cone)
    closing = gap / (h * stiffening) + finger + nx * frame.spring_x + ny * frame.spring_y
    drag = nx * (frame.speed_y + frame.spring_y) - ny * (frame.speed_x + frame.spring_x)
    normal = h * h * stiffening / (cone.give + stiffening * cone.compliance)
    ratio = normal / cone.tangential
    turn, slide = rows[k, 5], rows[k, 6]
    return Contact(nx, ny, x, y, nw, tw, closing, drag, turn, slide, gap, stiffening, normal, ratio)
