"""Direct derivatives of a solved step: of its gradient and of the finger's impulse, the new twist being held.

By the implicit function theorem, where the gradient g(v⁺, p) of the step's function vanishes,
dv⁺/dp = -H⁻¹ ∂g/∂p; `blocks.py` carries that on. Where a contact is at the edge between sticking, sliding and
apart, derivatives are those of the side on which the solution was found (one-sided).

What a step depends on is the state before it and the memory of effects, the loads, and other parameters. For
each load f_i the gradient's derivative is h times φ_i's own gradient, and what the contact's stiffness does,
which grows with Σ f (`by_load_sum`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.compiled import compiled
from slipmap.models.physics.contact import (
    SEPARATE,
    SLIDE_BACK,
    SLIDE_FORWARD,
    STICK,
    Cone,
    Contact,
    cone_matrix,
    springs,
    stiffening_slope,
)
from slipmap.models.physics.friction import COMPLIANCE, FORCE, INERTIA, INERTIA_FACTOR, STATE
from slipmap.models.physics.kernel_tools import Turn, joined, turned
from slipmap.models.physics.newton import Impulse
from slipmap.models.physics.step import EXTRA_COLUMNS, Frame

MU = INERTIA
"""Place of the finger's friction among the parameters after the loads."""


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
    """Direct derivatives of a step's gradient g and of the finger's impulse f (N s, middle frame).

    Attributes:
        state_g: (3, 6 + E + 1) of g by the state before the step, the E entries of memory, and last by the
            compliance of the finger.
        state_f: (2, 6 + E + 1) of f by the same.
        twist_f: (2, 3) of f by v⁺.
        other_g: (3, X) of g by the parameters after the loads.
        other_f: (2, X) of f by the same.
    """

    state_g: NDArray[np.float64]
    state_f: NDArray[np.float64]
    twist_f: NDArray[np.float64]
    other_g: NDArray[np.float64]
    other_f: NDArray[np.float64]


@compiled()
def no_slopes(memory, others):  # type: ignore[no-untyped-def]
    """`Slopes` of zeros, with E entries of memory and room for so many parameters after the loads."""
    state, other = np.zeros((5, STATE + memory + 1)), np.zeros((5, others))
    return Slopes(state[:3], state[3:], np.zeros((2, 3)), other[:3], other[3:])


@compiled(forceinline=True)
def step_derivative(solved, slopes):  # type: ignore[no-untyped-def]
    """Fill in the `Slopes` of a `Solved` step."""
    for a in range(3):
        for k in range(slopes.state_g.shape[1]):
            slopes.state_g[a, k] = 0.0
        slopes.other_g[a, MU] = 0.0
    for a in range(2):
        for k in range(slopes.state_f.shape[1]):
            slopes.state_f[a, k] = 0.0
        slopes.twist_f[a, 0] = slopes.twist_f[a, 1] = slopes.twist_f[a, 2] = slopes.other_f[a, MU] = 0.0
    _free_motion(solved, slopes)
    if solved.impulse1.state != SEPARATE:
        _contact(solved, solved.first, solved.impulse1, slopes)
    if solved.impulse2.state != SEPARATE:
        _contact(solved, solved.second, solved.impulse2, slopes)


@compiled(forceinline=True)
def _free_motion(solved, slopes):  # type: ignore[no-untyped-def]
    """Momentum of v⁺ less that of the free motion: linear in the inertia, turned by -h omega."""
    v, new, h, quarter = solved.v, solved.new, solved.h, solved.quarter
    A, extra = slopes.state_g, slopes.other_g
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
    change = contact_change(solved, contact, impulse, slopes.state_g, slopes.state_f)
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
    _by_new_twist(solved.cone, contact, impulse, slopes.twist_f)
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
def _by_new_twist(cone, contact, impulse, twist_f):  # type: ignore[no-untyped-def]
    """Add the change of the force by v⁺."""
    nx, ny = contact.nx, contact.ny
    dnn, dnt, dtn, dtt = cone_matrix(cone.mu, contact.ratio, impulse.state)
    for j in range(3):
        dn = nx if j == 0 else (ny if j == 1 else contact.nw)
        dt = -ny if j == 0 else (nx if j == 1 else contact.tw)
        dgn = dnn * dn * contact.normal - dnt * dt * cone.tangential
        dgt = dtn * dn * contact.normal - dtt * dt * cone.tangential
        twist_f[0, j] += -nx * dgn - ny * dgt
        twist_f[1, j] += -ny * dgn + nx * dgt


@compiled(forceinline=True)
def _by_finger_friction(new, cone, contact, impulse, slopes):  # type: ignore[no-untyped-def]
    """Add the change of gradient and force of a sliding contact by mu."""
    g, f = slopes.other_g, slopes.other_f
    nx, ny = contact.nx, contact.ny
    sign = 1.0 if impulse.state == SLIDE_FORWARD else -1.0
    _, y_t = springs(contact, cone, new[0], new[1], new[2])
    ratio = contact.ratio
    dgn = ratio * (abs(y_t) - 2.0 * cone.mu * impulse.normal) / (1.0 + cone.mu * cone.mu * ratio)
    dgt = sign * (impulse.normal + cone.mu * dgn)
    dfx = -nx * dgn - ny * dgt
    dfy = -ny * dgn + nx * dgt
    g[0, MU] -= dfx
    g[1, MU] -= dfy
    g[2, MU] -= contact.x * dfy - contact.y * dfx
    f[0, MU] += dfx
    f[1, MU] += dfy


@compiled(forceinline=True)
def add_applied_turning(A, applied, h):  # type: ignore[no-untyped-def]
    """Add to A, the gradient's by the state, what follows as given forces keep their direction."""
    for row, lever in enumerate((applied.y, -applied.x, applied.turning)):
        A[row, 2] -= lever
        A[row, 5] -= 0.5 * h * lever


@compiled(forceinline=True)
def by_load_sum(solved, load_sum):  # type: ignore[no-untyped-def]
    """Derivatives of g (3) and of f (2) by Σ f at a rigid finger: the contact's impulse grows with it."""
    first, second, impulse1, impulse2 = solved.first, solved.second, solved.impulse1, solved.impulse2
    x, y = finger_impulse(solved)
    moment = first.nw * impulse1.normal - first.tw * impulse1.tangential
    moment += second.nw * impulse2.normal - second.tw * impulse2.tangential
    x, y = x / load_sum, y / load_sum
    return -x, -y, moment / load_sum, x, y


@compiled(forceinline=True)
def finger_impulse(solved):  # type: ignore[no-untyped-def]
    """Impulse of the finger on the object (N s), middle frame."""
    first, second, impulse1, impulse2 = solved.first, solved.second, solved.impulse1, solved.impulse2
    x = -first.nx * impulse1.normal - first.ny * impulse1.tangential
    x -= second.nx * impulse2.normal + second.ny * impulse2.tangential
    y = first.nx * impulse1.tangential - first.ny * impulse1.normal
    y += second.nx * impulse2.tangential - second.ny * impulse2.normal
    return x, y


@compiled(forceinline=True)
def _by_stiffness(contact, impulse, cone, v, dnormal, dtangential):  # type: ignore[no-untyped-def]
    """Change of γ_n and γ_t if 1/R_n and 1/R_t change by dnormal and dtangential."""
    if impulse.state == SEPARATE:
        return 0.0, 0.0
    y_n, y_t = springs(contact, cone, v[0], v[1], v[2])
    dy_n = y_n * dnormal / contact.normal
    dy_t = y_t * dtangential / cone.tangential
    if impulse.state == STICK:
        return dy_n, dy_t
    slope = cone.mu if impulse.state == SLIDE_FORWARD else -cone.mu
    dratio = contact.ratio * (dnormal / contact.normal - dtangential / cone.tangential)
    share = 1.0 / (1.0 + cone.mu * cone.mu * contact.ratio)
    dgn = share * (
        dy_n + slope * (dratio * y_t + contact.ratio * dy_t) - cone.mu * cone.mu * dratio * impulse.normal
    )
    return dgn, slope * dgn


@compiled()
def by_stiffness(solved, by_sum, stick_speed, load_sum):  # type: ignore[no-untyped-def]
    """Derivatives of g (3) and of f (2) by Σ f (`by_sum`), or by the finger's compliance, through stiffness.

    With 1/R_n = h²/(give/s + C), s the contact's stiffening by damping, and 1/R_t = h²/(h creep + C), where
    give and creep = stick_speed / Σ f fall with the sum of loads.
    """
    h, cone = solved.h, solved.cone
    by_creep = -cone.tangential * cone.tangential / (h * h)
    x = y = w = 0.0
    for k in range(2):
        contact = solved.first if k == 0 else solved.second
        impulse = solved.impulse1 if k == 0 else solved.impulse2
        by_give = -contact.normal * contact.normal / (h * h)
        dn, dt = by_give, by_creep
        if by_sum:
            dn *= -cone.give / (contact.stiffening * load_sum)
            dt *= -h * stick_speed / (load_sum * load_sum)
        dgn, dgt = _by_stiffness(contact, impulse, cone, solved.new, dn, dt)
        x += contact.nx * dgn + contact.ny * dgt
        y += contact.ny * dgn - contact.nx * dgt
        w += contact.nw * dgn - contact.tw * dgt
    return x, y, w, -x, -y


@compiled()
def add_bending(solved, last, by_compliance, slopes):  # type: ignore[no-untyped-def]
    """Add to `slopes` what bends the finger: the last force (world, N), with which memory begins, and the
    compliance, with its slopes (5) through stiffness.

    It stands compliance · force off its record and would straighten within the step.
    """
    h, frame, compliance = solved.h, solved.frame, solved.cone.compliance
    g, f = slopes.state_g, slopes.state_f
    column = g.shape[1] - 1
    for a in range(3):
        g[a, column] += by_compliance[a]
    for a in range(2):
        f[a, column] += by_compliance[3 + a]
    none = (0.0, 0.0)
    for k in range(2):
        contact = solved.first if k == 0 else solved.second
        impulse = solved.impulse1 if k == 0 else solved.impulse2
        if impulse.state == SEPARATE:
            continue
        change = contact_change(solved, contact, impulse, g, f)
        for j in range(FORCE + 1):
            bends = j == FORCE
            fx = last[0] if bends else (compliance if j == 0 else 0.0)
            fy = last[1] if bends else (compliance if j == 1 else 0.0)
            dx, dy = turned(frame.cos, -frame.sin, fx, fy)
            add_column(column if bends else STATE + j, (-dx, -dy), none, (dx / h, dy / h), none, change)


@compiled(forceinline=True)
def set_body_slopes(G, body, new, free, dout, h):  # type: ignore[no-untyped-def]
    """Set G (3, Y), the gradient's by what formulas are evaluated at, to that of wrench and inertia factor.

    `body` is m, s_x, s_y, J without the inertia factor, `free` the momentum of the free motion.
    """
    momentum = (
        body[0] * new[0] - body[2] * new[2] - free[0],
        body[0] * new[1] + body[1] * new[2] - free[1],
        body[1] * new[1] - body[2] * new[0] + body[3] * new[2] - free[2],
    )
    for a in range(3):
        for k in range(G.shape[1]):
            G[a, k] = momentum[a] * dout[INERTIA_FACTOR, k] - h * dout[a, k]


@compiled()
def blade_slopes(blades, dblades, v, eps2, h, G):  # type: ignore[no-untyped-def]
    """Add to G the derivative of Σ_k h F w/φ b, with w = b·v and φ = sqrt(w² + ε²).

    Blades (k, 4) are F and b, dblades (4 k, Y) their derivatives, v is the twist after the step.
    """
    for k in range(blades.shape[0]):
        force = blades[k, 0]
        along = blades[k, 1] * v[0] + blades[k, 2] * v[1] + blades[k, 3] * v[2]
        inverse = 1.0 / math.sqrt(along * along + eps2)
        ratio = along * inverse
        curve = force * eps2 * inverse * inverse * inverse
        for j in range(G.shape[1]):
            dx, dy, dw = dblades[4 * k + 1, j], dblades[4 * k + 2, j], dblades[4 * k + 3, j]
            common = dblades[4 * k, j] * ratio + curve * (v[0] * dx + v[1] * dy + v[2] * dw)
            G[0, j] += h * (common * blades[k, 1] + force * ratio * dx)
            G[1, j] += h * (common * blades[k, 2] + force * ratio * dy)
            G[2, j] += h * (common * blades[k, 3] + force * ratio * dw)


@compiled()
def add_formula_slopes(slopes, G, dout, kappa):  # type: ignore[no-untyped-def]
    """Add to `slopes` what formulas do to a step with the inertia factor kappa.

    G (3, Y) is the derivative of the gradient by what they are evaluated at, dout (…, Y) that of the body's
    formulas.
    """
    known = slopes.state_g.shape[1] - 1
    effects = G.shape[1] - known - INERTIA
    bends = known > STATE  # else no formula holds the last force, and there is no compliance
    for a in range(5 if bends else 3):
        row, share = (a, 1.0) if a < 3 else (a - 3, 0.0)
        state = slopes.state_g[row] if a < 3 else slopes.state_f[row]
        other = slopes.other_g[row] if a < 3 else slopes.other_f[row]
        stiff = state[known]
        for k in range(known):
            state[k] += share * G[row, k] + stiff * dout[COMPLIANCE, k]
        for k in range(INERTIA):
            direct = share * G[row, known + k] + stiff * dout[COMPLIANCE, known + k]
            other[k] = share * kappa * other[k] + direct
        for k in range(effects):
            at = known + INERTIA + k
            other[EXTRA_COLUMNS + k] = share * G[row, at] + stiff * dout[COMPLIANCE, at]


@compiled()
def set_input_slopes(solved, applied, row, at, slopes):  # type: ignore[no-untyped-def]
    """Set the columns of what drives a step, from `at` on: given force (world, N), its point (object frame,
    m), torque (N m), finger before and after the step (world, m).

    `row` (5,) holds the first three, `applied` is its `Applied`.
    """
    h, c, s = solved.h, solved.frame.cos, solved.frame.sin
    px, py = row[2], row[3]
    g, f = slopes.other_g, slopes.other_f
    g[0, at], g[1, at], g[2, at] = -h * c, h * s, h * (px * s + py * c)
    g[0, at + 1], g[1, at + 1], g[2, at + 1] = -h * s, -h * c, h * (py * s - px * c)
    g[2, at + 2], g[2, at + 3], g[2, at + 4] = -applied.y, applied.x, -h
    none = (0.0, 0.0)
    for k in range(2):
        contact = solved.first if k == 0 else solved.second
        impulse = solved.impulse1 if k == 0 else solved.impulse2
        if impulse.state == SEPARATE:
            continue
        change = contact_change(solved, contact, impulse, g, f)
        for j in range(4):
            x, y = (c, -s) if j % 2 == 0 else (s, c)
            pace = (-1.0 if j < 2 else 1.0) / h
            add_column(at + 5 + j, (0.5 * x, 0.5 * y), (pace * x, pace * y), none, none, change)
