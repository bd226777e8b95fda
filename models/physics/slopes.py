"""Direct derivatives of a solved step: of its gradient and of the finger's impulse, at fixed v⁺.

By the implicit function theorem, where the gradient g(v⁺, p) of the step's function vanishes,
dv⁺/dp = -H⁻¹ ∂g/∂p; `blocks.py` carries that on. If a contact is on the border between sticking, sliding and
separation, the derivatives are one-sided: those of the side on which the solution was found.

A step depends on the state before it, the memory of effects, the loads, and other parameters. For each load
f_i the derivative of the gradient is h times the gradient of φ_i, plus the effect of the contact's stiffness,
which grows with Σ f.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.compiled import compiled
from slipmap.models.physics.contact import (
    SEPARATE,
    SLIDE_FORWARD,
    STICK,
    Cone,
    Contact,
    springs,
    stiffening_slope,
)
from slipmap.models.physics.friction import (
    COMPLIANCE,
    FINGER_SETTLING,
    FORCE,
    INERTIA,
    INERTIA_FACTOR,
    LEAN,
    STATE,
)
from slipmap.models.physics.kernel_tools import Turn, joined, turned
from slipmap.models.physics.newton import Minimum
from slipmap.models.physics.step import EXTRA_COLUMNS, Applied, Frame, Way

MU = INERTIA
"""Index of the finger's friction among the parameters after the loads."""


class Taken(NamedTuple):
    """A solved step; attributes without a comment as in `Step`."""

    v: tuple[float, float, float]
    h: float
    inertia: tuple[float, float, float, float]
    cone: Cone
    frame: Frame
    quarter: Turn
    first: Contact
    second: Contact
    new: tuple[float, float, float]  # twist v⁺ after the step
    minimum: Minimum  # see `Solution`
    free: tuple[float, float, float]  # momentum of the free motion
    applied: Applied  # applied forces of the push
    impulse: tuple[float, float]  # of the finger on the object, middle frame, N s
    way: Way  # see `Way`
    evaluations: int  # see `Solution`


class Slopes(NamedTuple):
    """Direct derivatives: three rows of the gradient, then two of the impulse (N s, middle frame)."""

    # (5, 6 + E + 2) with respect to the state before the step, the E entries of memory, the compliance of the
    # finger, and the sum of loads through the contact's stiffness
    state: NDArray[np.float64]
    other: NDArray[np.float64]  # (5, X) with respect to the parameters after the loads
    twist: NDArray[np.float64]  # (2, 3) of the impulse with respect to v⁺


@compiled()
def no_slopes(memory, others):  # type: ignore[no-untyped-def]
    """`Slopes` of zeros, for E = `memory` and X = `others`."""
    return Slopes(np.zeros((5, STATE + memory + 2)), np.zeros((5, others)), np.zeros((2, 3)))


@compiled(forceinline=True)
def contact_at(taken, k):  # type: ignore[no-untyped-def]
    """`Contact` k, 0 or 1, of a `Taken` step, and its `Impulse`; an absent contact is in state SEPARATE."""
    return (taken.first, taken.minimum.first) if k == 0 else (taken.second, taken.minimum.second)


@compiled(forceinline=True)
def finger_impulse(first, second, minimum):  # type: ignore[no-untyped-def]
    """Impulse of the finger on the object through two contacts (N s), middle frame."""
    impulse1, impulse2 = minimum.first, minimum.second
    x = -first.nx * impulse1.normal - first.ny * impulse1.tangential
    x -= second.nx * impulse2.normal + second.ny * impulse2.tangential
    y = first.nx * impulse1.tangential - first.ny * impulse1.normal
    y += second.nx * impulse2.tangential - second.ny * impulse2.normal
    return x, y


@compiled(forceinline=True)
def set_step_slopes(taken, load_sum, slopes):  # type: ignore[no-untyped-def]
    """Set the `Slopes` of a `Taken` step with a rigid finger and no effects."""
    state, other, twist = slopes
    for a in range(5):
        for k in range(state.shape[1]):
            state[a, k] = 0.0
        other[a, MU] = 0.0
    _set_free_motion(taken, state, other)
    # Applied forces keep their direction in the world.
    applied = taken.applied
    for a, lever in enumerate((applied.y, -applied.x, applied.turning)):
        state[a, 2] -= lever
        state[a, 5] -= 0.5 * taken.h * lever
    for j in range(3):
        twist[0, j] = twist[1, j] = 0.0
    for k in range(2):
        if contact_at(taken, k)[1].state != SEPARATE:
            _add_contact(taken, k, load_sum, state, other, twist)


@compiled(forceinline=True)
def _set_free_motion(taken, state, other):  # type: ignore[no-untyped-def]
    """Set the slopes of v⁺'s momentum minus the free motion's: linear in the inertia, turned by -h omega."""
    v, new, h, quarter = taken.v, taken.new, taken.h, taken.quarter
    m, sx, sy, J = taken.inertia
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
        other[0, j] = npx - dqx
        other[1, j] = npy - dqy
        other[2, j] = nL - dL_free
    for j in range(3):  # v_x, v_y, omega
        dpx = m if j == 0 else (-sy if j == 2 else 0.0)
        dpy = m if j == 1 else (sx if j == 2 else 0.0)
        dL = -sy if j == 0 else (sx if j == 1 else J)
        dqx, dqy = turned(c, -s, dpx, dpy)
        if j == 2:
            dqx += h * qy
            dqy -= h * qx
        state[0, 3 + j] = -dqx
        state[1, 3 + j] = -dqy
        state[2, 3 + j] = -(dL + centre_x * (dqy - dpy) - centre_y * (dqx - dpx))


@compiled(forceinline=True)
def _add_contact(taken, k, load_sum, state, other, twist):  # type: ignore[no-untyped-def]
    """Add the slopes of contact k, whose impulse grows with the sum of loads."""
    contact, impulse = contact_at(taken, k)
    h, v, new, cone, quarter, frame = taken.h, taken.v, taken.new, taken.cone, taken.quarter, taken.frame
    y, x = contact.y, contact.x
    cos, sin = frame.cos, frame.sin
    vfx, vfy = frame.speed_x, frame.speed_y
    # The frame moved to its predicted origin by way (w_x, w_y), the last twist's velocity in that frame.
    way = 0.5 * h * quarter.sinc
    wx, wy = turned(quarter.cos, -quarter.sin, v[0], v[1])
    stretch = 0.125 * h * h * quarter.sinc_slope
    bx, by = frame.spring_x, frame.spring_y
    none = (0.0, 0.0)
    _add_change(state, 0, k, taken, (-cos, sin), none, none, none)
    _add_change(state, 1, k, taken, (-sin, -cos), none, none, none)
    place = (way * wy + frame.tip_y, -way * wx - frame.tip_x)
    _add_change(state, 2, k, taken, place, (vfy, -vfx), (by, -bx), none)
    _add_change(state, 3, k, taken, (-way * quarter.cos, way * quarter.sin), none, none, (1.0, 0.0))
    _add_change(state, 4, k, taken, (-way * quarter.sin, -way * quarter.cos), none, none, (0.0, 1.0))
    half = 0.5 * h
    dpx = half * (0.5 * way * wy + frame.tip_y) - stretch * wx
    dpy = -half * (0.5 * way * wx + frame.tip_x) - stretch * wy
    _add_change(state, 5, k, taken, (dpx, dpy), (half * vfy, -half * vfx), (half * by, -half * bx), (-y, x))
    _, y_t = springs(contact, cone, new[0], new[1], new[2])
    for j in range(3):
        dn = contact.nx if j == 0 else (contact.ny if j == 1 else contact.nw)
        dt = -contact.ny if j == 0 else (contact.nx if j == 1 else contact.tw)
        dyn, dyt = contact.normal * dn, -cone.tangential * dt
        dgn, dgt = _impulse_change(contact, impulse, cone, y_t, dyn, dyt, 0.0, 0.0)
        twist[0, j] -= contact.nx * dgn + contact.ny * dgt
        twist[1, j] -= contact.ny * dgn - contact.nx * dgt
    dgn, dgt = _impulse_change(contact, impulse, cone, y_t, 0.0, 0.0, 0.0, 1.0)
    _add_impulse(other, MU, contact, dgn, dgt)
    last = state.shape[1] - 1
    _add_impulse(state, last, contact, impulse.normal / load_sum, impulse.tangential / load_sum)


@compiled(forceinline=True)
def _impulse_change(contact, impulse, cone, y_t, dyn, dyt, dratio, dmu):  # type: ignore[no-untyped-def]
    """Change of γ_n and γ_t with the springs' impulses, R_t / R_n and mu, in an unchanged state."""
    if impulse.state == SEPARATE:
        return 0.0, 0.0
    if impulse.state == STICK:
        return dyn, dyt
    mu, ratio, normal = cone.mu, contact.ratio, impulse.normal
    sign = 1.0 if impulse.state == SLIDE_FORWARD else -1.0
    change = dyn + sign * mu * ratio * dyt + mu * (abs(y_t) - mu * normal) * dratio
    change += ratio * (abs(y_t) - 2.0 * mu * normal) * dmu
    change *= 1.0 / (1.0 + mu * mu * ratio)
    return change, sign * (mu * change + normal * dmu)


@compiled(forceinline=True)
def _add_impulse(target, j, contact, dgn, dgt):  # type: ignore[no-untyped-def]
    """Add a change of a contact's γ_n and γ_t to column j of slopes (5, …)."""
    dfx = -contact.nx * dgn - contact.ny * dgt
    dfy = contact.nx * dgt - contact.ny * dgn
    target[0, j] -= dfx
    target[1, j] -= dfy
    target[2, j] += contact.nw * dgn - contact.tw * dgt
    target[3, j] += dfx
    target[4, j] += dfy


@compiled(forceinline=True, fastmath={"contract", "nnan", "nsz"})
def _add_change(target, j, k, taken, place, speed, spring, twist):  # type: ignore[no-untyped-def]
    """Add the effect at contact k of four changes (x, y), all in the middle frame.

    Args:
        target, j: slopes (5, …) and the column to add to.
        k: 0 or 1.
        taken: `Taken`.
        place, speed: changes of the finger's position at mid-step, and of its velocity.
        spring: change of the velocity with which a bent finger would straighten.
        twist: change of the last twist's velocity at the contact.
    """
    v, new, h, cone, frame = taken.v, taken.new, taken.h, taken.cone, taken.frame
    contact, impulse = contact_at(taken, k)
    dpx, dpy = place
    dvfx, dvfy = speed
    dbx, dby = spring
    dux, duy = twist
    gamma_n, gamma_t = impulse.normal, impulse.tangential
    nx, ny, x, y = contact.nx, contact.ny, contact.x, contact.y
    tx, ty = -ny, nx
    vfx, vfy = frame.speed_x, frame.speed_y
    fx = -nx * gamma_n + tx * gamma_t
    fy = -ny * gamma_n + ty * gamma_t
    bx, by = frame.spring_x, frame.spring_y
    slip_x = vfx + bx - new[0] + new[2] * y
    slip_y = vfy + by - new[1] - new[2] * x
    # Half the velocity with which the gap was closing before the step.
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
    dgn, dgt = _impulse_change(contact, impulse, cone, y_t, dyn, dyt, dnormal / cone.tangential, 0.0)
    dfx, dfy = dtx * gamma_t - dnx * gamma_n, dty * gamma_t - dny * gamma_n
    target[0, j] -= dfx
    target[1, j] -= dfy
    target[2, j] -= x * dfy - y * dfx + drx * fy - dry * fx
    target[3, j] += dfx
    target[4, j] += dfy
    _add_impulse(target, j, contact, dgn, dgt)


@compiled()
def add_compliance(taken, compliance, lean, stick_speed, load_sum, state):  # type: ignore[no-untyped-def]
    """Add the slopes of a bending finger, and recompute those with respect to the sum of loads.

    1/R_n = h²/(give/s + C h/τ), with the contact's stiffening s by damping, and 1/R_t = h²/(h creep + C h/τ),
    where give and creep = stick_speed / Σ f fall with the sum of loads. The lean (world, N), an entry of
    memory, bends the finger by C · lean off its recorded place; free, it straightens with time constant τ.
    """
    h, cone, frame, new = taken.h, taken.cone, taken.frame, taken.new
    settling = max(h, FINGER_SETTLING)
    by_compliance, by_sum = state.shape[1] - 2, state.shape[1] - 1
    none = (0.0, 0.0)
    for a in range(5):
        state[a, by_sum] = 0.0
    for k in range(2):
        contact, impulse = contact_at(taken, k)
        if impulse.state == SEPARATE:
            continue
        y_n, y_t = springs(contact, cone, new[0], new[1], new[2])
        # Relative changes of 1/R_n and 1/R_t.
        normal, tangential = -contact.normal / (h * settling), -cone.tangential / (h * settling)
        for column in (by_compliance, by_sum):
            if column == by_sum:
                normal *= -cone.give * settling / (h * contact.stiffening * load_sum)
                tangential *= -settling * stick_speed / (load_sum * load_sum)
            dratio = contact.ratio * (normal - tangential)
            dyn, dyt = y_n * normal, y_t * tangential
            dgn, dgt = _impulse_change(contact, impulse, cone, y_t, dyn, dyt, dratio, 0.0)
            _add_impulse(state, column, contact, dgn, dgt)
        for j in range(FORCE + 1):
            bends = j == FORCE
            bx = lean[0] if bends else (compliance if j == 0 else 0.0)
            by = lean[1] if bends else (compliance if j == 1 else 0.0)
            dx, dy = turned(frame.cos, -frame.sin, bx, by)
            column = by_compliance if bends else LEAN + j
            _add_change(state, column, k, taken, (-dx, -dy), none, (dx / settling, dy / settling), none)


@compiled(forceinline=True)
def set_body_slopes(G, body, new, free, dout, h):  # type: ignore[no-untyped-def]
    """Set G (3, Y), the gradient's derivative with respect to y, to the part of wrench and inertia factor.

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

    Blades (k, 4) hold F and b, dblades (4 k, Y) their derivatives; v is the twist after the step.
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
    """Add to `slopes` the contribution of formulas to a step with the inertia factor kappa.

    G (3, Y) and dout (…, Y) are the derivatives of the gradient and of the body's outputs with respect to y.
    """
    known = slopes.state.shape[1] - 2
    for a in range(5):
        state, other, stiff = slopes.state[a], slopes.other[a], slopes.state[a, known]
        for k in range(INERTIA):
            other[k] = kappa * other[k] if a < 3 else 0.0
        for k in range(G.shape[1]):
            change = stiff * dout[COMPLIANCE, k]
            if a < 3:
                change += G[a, k]
            if k < known:
                state[k] += change
            elif k < known + INERTIA:
                other[k - known] += change
            else:
                other[EXTRA_COLUMNS + k - known - INERTIA] = change


@compiled()
def set_input_slopes(taken, row, at, other):  # type: ignore[no-untyped-def]
    """Set the columns of a step's drive, from `at` on.

    They are the applied force (world, N), its point (object frame, m), torque (N m), and the finger before
    and after the step (world, m); `row` (5,) holds the first three.
    """
    h, c, s, applied = taken.h, taken.frame.cos, taken.frame.sin, taken.applied
    px, py = row[2], row[3]
    other[0, at], other[1, at], other[2, at] = -h * c, h * s, h * (px * s + py * c)
    other[0, at + 1], other[1, at + 1], other[2, at + 1] = -h * s, -h * c, h * (py * s - px * c)
    other[2, at + 2], other[2, at + 3], other[2, at + 4] = -applied.y, applied.x, -h
    none = (0.0, 0.0)
    for k in range(2):
        if contact_at(taken, k)[1].state == SEPARATE:
            continue
        for j in range(4):
            x, y = (c, -s) if j % 2 == 0 else (s, c)
            pace = (-1.0 if j < 2 else 1.0) / h
            _add_change(other, at + 5 + j, k, taken, (0.5 * x, 0.5 * y), (pace * x, pace * y), none, none)
