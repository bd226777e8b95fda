"""One convex time step V(x, v, F, M, mu) of the sliding object, and its exact derivative.

Over a step of length h the object's twist v (object frame, at the frame's origin) becomes

    v⁺ = argmin  ½ (v - v*)ᵀ M (v - v*)  +  h Σ_i f_i φ_i(v)  +  ℓ_contact(v)

with the free motion v*, the friction loads f_i = mu_i N_i and norms φ_i of `newton.py`, and the contact of
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

For each friction load f_i the gradient's derivative is h times φ_i's own gradient, less the contact impulse
over Σ f, as the contact's stiffness grows with Σ f; rollouts add it cell by cell.

The last bits of results depend on the order of fields and arguments here: by it the compiler sorts the two
products of a sum, of which one is rounded and the other fused with the addition.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.compiled import compiled
from slipmap.models.physics.contact import (
    SEPARATE,
    SLIDE_BACK,
    SLIDE_FORWARD,
    Cone,
    Contact,
    cone_matrix,
    find_contacts,
    springs,
    stiffening_of,
    stiffening_slope,
)
from slipmap.models.physics.kernel_tools import Turn, joined, turned
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
"""Columns after the n loads: inertia, finger friction, start."""

MAX_EVALUATIONS = 60

# Gaps larger than this, and than what the step can close, are left out of the step, m.
_CONTACT_MARGIN = 1e-3
# Newton stops when the error left is below this speed, m/s, rotation counted at the object's radius.
_VELOCITY_TOLERANCE = 1e-14
# Speeds below this are zero, m/s: subnormal numbers slow a processor down a hundredfold.
_REST = 1e-60
# Relative error of the Hessian that the derivatives may inherit.
_HESSIAN_TOLERANCE = 1e-8


class Frame(NamedTuple):
    """Middle frame of a step, in which its problem is written, and the finger seen from it.

    Attributes:
        cos, sin: of its angle in the world.
        tip_x, tip_y: finger centre in the middle of the step, m.
        speed_x, speed_y: velocity of the finger, m/s.
        spring_x, spring_y: speed at which a finger that bends would straighten within the step if nothing
            held it, m/s; 0 for a rigid one.
    """

    cos: float
    sin: float
    tip_x: float
    tip_y: float
    speed_x: float
    speed_y: float
    spring_x: float
    spring_y: float


class Step(NamedTuple):
    """One step before it is solved.

    Attributes:
        cells: `Cells`, or another class registered with `newton.register_cells`.
        inertia: m, s_x, s_y, J.
        star: momentum of the free motion and of applied forces: p_x, p_y and L about the frame's origin.
        h: its length, s.
        first, second: nearest contact and the next.
        contacts: how many of them there are.
        cone: law of the contacts.
        size: radius of the object, m, at which rotation counts.
        v: twist before it, object frame.
        quarter: `Turn` by h omega / 4.
        frame: its middle frame.
    """

    cells: Any
    inertia: tuple[float, float, float, float]
    star: tuple[float, float, float]
    h: float
    first: Contact
    second: Contact
    contacts: int
    cone: Cone
    size: float
    v: tuple[float, float, float]
    quarter: Turn
    frame: Frame


class Solution(NamedTuple):
    """Solved step: the new twist, the last Newton iteration, and how often the cells were summed over.

    `evaluations` is above `MAX_EVALUATIONS` if the minimum was not reached.
    """

    new: tuple[float, float, float]
    minimum: Minimum
    evaluations: int


@compiled(forceinline=True, fastmath={"contract"})
def free_momentum(inertia, v, cos, sin):  # type: ignore[no-untyped-def]
    """Momentum p_x, p_y, L of the free motion from the last twist v, about the new frame's origin.

    Seen from that frame the linear part turns by -h omega, whose cosine and sine are given; the spin stays.
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
def solve_step(step, start, exact_hessian):  # type: ignore[no-untyped-def]
    """`Solution` of a step: the minimum of its function.

    Newton on the smooth part, with the contact kept exact in every iteration (`solve_with_contacts`). Steps
    that overshoot are left to `_bracketed`. Half the relative change of the Hessian along a Newton step,
    times that step, bounds the error after it: where that is small, nothing needs to be evaluated there.

    Args:
        step: `Step`.
        start: guess of the new twist.
        exact_hessian: whether the inverse Hessian must be that at the solution.
    """
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
    if _size_of(trial, size) < _REST:
        trial = (0.0, 0.0, 0.0)
    return Solution(trial, minimum, evaluations)


@compiled(forceinline=True, fastmath={"contract"})
def _smooth_part(step, v):  # type: ignore[no-untyped-def]
    return smooth_model(step.cells, step.inertia, step.star, step.h, v)


@compiled(forceinline=True, fastmath={"contract"})
def _slope(step, model, v, d):  # type: ignore[no-untyped-def]
    return slope_along(model, v, d, step.first, step.second, step.contacts, step.cone)


@compiled()
def _bracketed(step, v, d, slope, high_slope, evaluations, try_rest):  # type: ignore[no-untyped-def]
    """Point along d, where the full step overshoots, at which the slope has fallen to half.

    Along a descent direction the slope of a convex function grows, so the minimum is bracketed. An overshoot
    is mostly an object coming to rest, where the sum of norms has its one sharp point: rest is tried first,
    once a step (`try_rest`).

    Returns:
        The twist, the smooth model there and the bound on its change, and the number of evaluations.
    """
    if try_rest:
        rest = (0.0, 0.0, 0.0)
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


@compiled(forceinline=True, fastmath={"contract"})
def middle_frame(x, y, cos, sin, quarter, v, h, tip0, tip1):  # type: ignore[no-untyped-def]
    """`Frame` at the middle of the step, predicted from the last twist.

    Args:
        x, y: object's origin before the step, world, m.
        cos, sin: of its angle.
        quarter: `Turn` by h omega / 4.
        v: last twist, object frame.
        h: step, s.
        tip0, tip1: finger centre at the start of the step and at its end, world, m.
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
def touching(frame, v, h, common, rows, gain):  # type: ignore[no-untyped-def]
    """Number of contacts of a step, which are written into rows (MAX_CONTACTS, CONTACT_COLUMNS).

    `gain` is the most speed, m/s, that applied forces give any point of the object in the step.
    """
    speeds = abs(frame.speed_x) + abs(frame.speed_y) + _size_of(v, common.size) + gain
    reach = _CONTACT_MARGIN + 2.0 * h * speeds
    far = common.size + common.radius + reach
    if frame.tip_x * frame.tip_x + frame.tip_y * frame.tip_y > far * far:
        return 0
    return find_contacts(frame.tip_x, frame.tip_y, common.radius, reach, common.edges, rows)


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


class Solved(NamedTuple):
    """A solved step, as its derivatives need it; attributes as in `Step`, and

    Attributes:
        new: solution v⁺.
        impulse1, impulse2: solved `Impulse` of the two contacts, without state where one is absent.
    """

    v: tuple[float, float, float]
    new: tuple[float, float, float]
    h: float
    inertia: tuple[float, float, float, float]
    cone: Cone
    frame: Frame
    quarter: Turn
    first: Contact
    second: Contact
    impulse1: Impulse
    impulse2: Impulse


@compiled(forceinline=True)
def solved_step(step, new, minimum):  # type: ignore[no-untyped-def]
    """`Solved` of a step whose solution v⁺ is known, with the `Minimum` there."""
    return Solved(
        step.v, new, step.h, step.inertia, step.cone, step.frame, step.quarter, step.first, step.second,
        minimum.first, minimum.second,
    )  # fmt: skip


class Slopes(NamedTuple):
    """Partial derivatives of a solved step, filled in by `step_derivative`.

    Attributes:
        A: (3, 6) d(gradient)/d(x, y, θ, v_x, v_y, omega).
        extra: (3, …) first five columns: d(gradient)/d(m, s_x, s_y, J, mu).
        force: (2, 10) d(force impulse, middle frame) by x, y, θ, v_x, v_y, omega, then v⁺ (3), then mu; for
            each f_i it is force / Σ f.
    """

    A: NDArray[np.float64]
    extra: NDArray[np.float64]
    force: NDArray[np.float64]


@compiled()
def step_derivative(solved, slopes):  # type: ignore[no-untyped-def]
    """Fill in the `Slopes` of a `Solved` step."""
    for i in range(3):
        slopes.A[i, 0] = slopes.A[i, 1] = slopes.A[i, 2] = slopes.extra[i, 4] = 0.0
    for j in range(10):
        slopes.force[0, j] = slopes.force[1, j] = 0.0
    _free_motion(solved, slopes)
    if solved.impulse1.state != SEPARATE:
        _contact(solved, solved.first, solved.impulse1, slopes)
    if solved.impulse2.state != SEPARATE:
        _contact(solved, solved.second, solved.impulse2, slopes)


@compiled(forceinline=True)
def _free_motion(solved, slopes):  # type: ignore[no-untyped-def]
    """Momentum of v⁺ less that of the free motion: linear in the inertia, turned by -h omega."""
    v, new, h, quarter = solved.v, solved.new, solved.h, solved.quarter
    A, extra = slopes.A, slopes.extra
    m, sx, sy, J = solved.inertia
    half_cos, half_sin = joined(quarter.cos, quarter.sin, quarter.cos, quarter.sin)
    c, s = joined(half_cos, half_sin, half_cos, half_sin)
    px = m * v[0] - sy * v[2]
    py = m * v[1] + sx * v[2]
    qx, qy = turned(c, -s, px, py)
    centre_x, centre_y = sx / m, sy / m
    for j in range(4):  # m, s_x, s_y, J
        dpx = v[0] if j == 0 else (-v[2] if j == 2 else 0.0)
        dpy = v[1] if j == 0 else (v[2] if j == 1 else 0.0)
        dL = v[1] if j == 1 else (-v[0] if j == 2 else (v[2] if j == 3 else 0.0))
        dcx = -centre_x / m if j == 0 else (1.0 / m if j == 1 else 0.0)
        dcy = -centre_y / m if j == 0 else (1.0 / m if j == 2 else 0.0)
        dqx, dqy = turned(c, -s, dpx, dpy)
        dL_free = dL + dcx * (qy - py) - dcy * (qx - px) + centre_x * (dqy - dpy) - centre_y * (dqx - dpx)
        npx = new[0] if j == 0 else (-new[2] if j == 2 else 0.0)
        npy = new[1] if j == 0 else (new[2] if j == 1 else 0.0)
        nL = new[1] if j == 1 else (-new[0] if j == 2 else (new[2] if j == 3 else 0.0))
        extra[0, j] = npx - dqx
        extra[1, j] = npy - dqy
        extra[2, j] = nL - dL_free
    for j in range(3):  # v_x, v_y, omega
        dpx = m if j == 0 else (-sy if j == 2 else 0.0)
        dpy = m if j == 1 else (sx if j == 2 else 0.0)
        dL = -sy if j == 0 else (sx if j == 1 else J)
        dqx, dqy = turned(c, -s, dpx, dpy)
        if j == 2:
            dqx += h * qy
            dqy -= h * qx
        A[0, 3 + j] = -dqx
        A[1, 3 + j] = -dqy
        A[2, 3 + j] = -(dL + centre_x * (dqy - dpy) - centre_y * (dqx - dpx))


@compiled(forceinline=True)
def contact_change(solved, contact, impulse, A, dforce):  # type: ignore[no-untyped-def]
    """What `add_column` needs of one contact of a `Solved` step, and the arrays that it adds to."""
    return solved.v, solved.new, solved.h, solved.cone, solved.frame, contact, impulse, A, dforce


@compiled(forceinline=True)
def _contact(solved, contact, impulse, slopes):  # type: ignore[no-untyped-def]
    """Add one contact's part."""
    h, v, quarter, frame = solved.h, solved.v, solved.quarter, solved.frame
    y, x = contact.y, contact.x
    cos, sin = frame.cos, frame.sin
    vfx, vfy = frame.speed_x, frame.speed_y
    # To its predicted origin the frame moved by way (w_x, w_y), the last twist's velocity seen from it.
    way = 0.5 * h * quarter.sinc
    wx, wy = turned(quarter.cos, -quarter.sin, v[0], v[1])
    stretch = 0.125 * h * h * quarter.sinc_slope
    change = contact_change(solved, contact, impulse, slopes.A, slopes.force)
    bx, by = frame.spring_x, frame.spring_y
    none = (0.0, 0.0)
    add_column(0, (-cos, sin), none, none, none, change)
    add_column(1, (-sin, -cos), none, none, none, change)
    place = (way * wy + frame.tip_y, -way * wx - frame.tip_x)
    add_column(2, place, (vfy, -vfx), (by, -bx), none, change)
    add_column(3, (-way * quarter.cos, way * quarter.sin), none, none, (1.0, 0.0), change)
    add_column(4, (-way * quarter.sin, -way * quarter.cos), none, none, (0.0, 1.0), change)
    half = 0.5 * h
    dpx = half * (0.5 * way * wy + frame.tip_y) - stretch * wx
    dpy = -half * (0.5 * way * wx + frame.tip_x) - stretch * wy
    add_column(5, (dpx, dpy), (half * vfy, -half * vfx), (half * by, -half * bx), (-y, x), change)
    _by_new_twist(solved.cone, contact, impulse, slopes.force)
    if impulse.state == SLIDE_FORWARD or impulse.state == SLIDE_BACK:
        _by_finger_friction(solved.new, solved.cone, contact, impulse, slopes)


@compiled(forceinline=True, fastmath={"contract", "nnan", "nsz"})
def add_column(j, place, speed, spring, twist, change):  # type: ignore[no-untyped-def]
    """Add to column j of A and dforce what follows from four changes (x, y), all in the middle frame.

    Args:
        j: column.
        place, speed: change of the finger's place in the middle of the step, and of its velocity.
        spring: of the speed at which a bent finger would straighten.
        twist: of the last twist's velocity at the contact.
        change: see `contact_change`.
    """
    v, new, h, cone, frame, contact, impulse, A, dforce = change
    dpx, dpy = place
    dvfx, dvfy = speed
    dbx, dby = spring
    dux, duy = twist
    gamma_n, gamma_t = impulse.normal, impulse.tangential
    nx, ny, x, y = contact.nx, contact.ny, contact.x, contact.y
    tx, ty = -ny, nx
    vfx, vfy = frame.speed_x, frame.speed_y
    dnn, dnt, dtn, dtt = cone_matrix(cone.mu, contact.ratio, impulse.state)
    fx = -nx * gamma_n + tx * gamma_t
    fy = -ny * gamma_n + ty * gamma_t
    bx, by = frame.spring_x, frame.spring_y
    slip_x = vfx + bx - new[0] + new[2] * y
    slip_y = vfy + by - new[1] - new[2] * x
    # Half of the velocity with which the gap was closing before the step.
    half_x, half_y = 0.5 * (v[0] - v[2] * y - vfx), 0.5 * (v[1] + v[2] * x - vfy)
    along = tx * dpx + ty * dpy
    turn, slide = contact.turn * along, contact.slide * along
    dnx, dny, dtx, dty = turn * tx, turn * ty, -turn * nx, -turn * ny
    drx, dry = slide * tx, slide * ty
    dux, duy = 0.5 * (dux - v[2] * dry - dvfx), 0.5 * (duy + v[2] * drx - dvfy)
    dgap = nx * dpx + ny * dpy + h * (dnx * half_x + dny * half_y + nx * dux + ny * duy)
    dsx, dsy = dvfx + dbx + new[2] * dry, dvfy + dby - new[2] * drx
    dopening = dnx * slip_x + dny * slip_y + nx * dsx + ny * dsy
    dyt = (dtx * slip_x + dty * slip_y + tx * dsx + ty * dsy) * cone.tangential
    # Damping grows with the depth: dnormal is its change of 1/R_n.
    more = stiffening_slope(contact.gap, cone) * dgap / contact.stiffening
    dnormal = contact.normal * contact.normal * cone.give * more / (h * h * contact.stiffening)
    y_n, y_t = springs(contact, cone, new[0], new[1], new[2])
    dyn = y_n * dnormal / contact.normal
    dyn += contact.normal * ((contact.gap * more - dgap) / (h * contact.stiffening) - dopening)
    dgn = dnn * dyn + dnt * dyt
    dgt = dtn * dyn + dtt * dyt
    if impulse.state == SLIDE_FORWARD or impulse.state == SLIDE_BACK:
        by_ratio = _by_ratio(cone, contact, impulse, y_t) * dnormal / cone.tangential
        dgn += by_ratio
        dgt += by_ratio * (cone.mu if impulse.state == SLIDE_FORWARD else -cone.mu)
    dfx = -dnx * gamma_n - nx * dgn + dtx * gamma_t + tx * dgt
    dfy = -dny * gamma_n - ny * dgn + dty * gamma_t + ty * dgt
    A[0, j] -= dfx
    A[1, j] -= dfy
    A[2, j] -= x * dfy - y * dfx + drx * fy - dry * fx
    dforce[0, j] += dfx
    dforce[1, j] += dfy


@compiled(forceinline=True)
def _by_ratio(cone, contact, impulse, y_t):  # type: ignore[no-untyped-def]
    """Change of a sliding contact's γ_n by R_t / R_n."""
    mu = cone.mu
    return mu * (abs(y_t) - mu * impulse.normal) / (1.0 + mu * mu * contact.ratio)


@compiled(forceinline=True)
def _by_new_twist(cone, contact, impulse, dforce):  # type: ignore[no-untyped-def]
    """Add the change of the force by v⁺."""
    nx, ny = contact.nx, contact.ny
    dnn, dnt, dtn, dtt = cone_matrix(cone.mu, contact.ratio, impulse.state)
    for j in range(3):
        dn = nx if j == 0 else (ny if j == 1 else contact.nw)
        dt = -ny if j == 0 else (nx if j == 1 else contact.tw)
        dgn = dnn * dn * contact.normal - dnt * dt * cone.tangential
        dgt = dtn * dn * contact.normal - dtt * dt * cone.tangential
        dforce[0, 6 + j] += -nx * dgn - ny * dgt
        dforce[1, 6 + j] += -ny * dgn + nx * dgt


@compiled(forceinline=True)
def _by_finger_friction(new, cone, contact, impulse, slopes):  # type: ignore[no-untyped-def]
    """Add the change of gradient and force of a sliding contact by mu."""
    extra, dforce = slopes.extra, slopes.force
    nx, ny = contact.nx, contact.ny
    sign = 1.0 if impulse.state == SLIDE_FORWARD else -1.0
    _, y_t = springs(contact, cone, new[0], new[1], new[2])
    ratio = contact.ratio
    dgn = ratio * (abs(y_t) - 2.0 * cone.mu * impulse.normal) / (1.0 + cone.mu * cone.mu * ratio)
    dgt = sign * (impulse.normal + cone.mu * dgn)
    dfx = -nx * dgn - ny * dgt
    dfy = -ny * dgn + nx * dgt
    extra[0, 4] -= dfx
    extra[1, 4] -= dfy
    extra[2, 4] -= contact.x * dfy - contact.y * dfx
    dforce[0, 9] += dfx
    dforce[1, 9] += dfy
