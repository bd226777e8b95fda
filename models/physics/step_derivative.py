"""Partial derivatives of one step at its solution, by the state before it and by what all cells share.

For each friction load f_i the gradient's derivative is h times φ_i's own gradient, less the contact impulse
over Σ f, as the contact's stiffness grows with Σ f; `sensitivity.py` adds it cell by cell.
"""

from __future__ import annotations

from models.physics.compiled import compiled
from models.physics.contact import SEPARATE, SLIDE_BACK, SLIDE_FORWARD, cone_matrix, springs, stiffening_slope
from models.physics.turns import joined, turned


@compiled()
def step_derivative(  # type: ignore[no-untyped-def]
    v, new, h, inertia, cone, frame, quarter, first, second, impulse1, impulse2, A, extra, dforce
):  # fmt: skip
    """Partial derivatives of the step's gradient and of the contact force at the solution.

    Args:
        v: twist before the step.
        new: solution v⁺.
        h: step, s.
        inertia: m, s_x, s_y, J.
        cone: law of the contacts.
        frame: middle `Frame` of the step.
        quarter: `Turn` by h omega / 4.
        first: nearest contact.
        second: next contact.
        impulse1: solved `Impulse` of the first contact, without state where it is absent.
        impulse2: the same of the second.
        A: (3, 6) result: d(gradient)/d(x, y, θ, v_x, v_y, omega).
        extra: (3, n) result, first five columns: d(gradient)/d(m, s_x, s_y, J, mu).
        dforce: (2, 10) result: d(force impulse, middle frame) by x, y, θ, v_x, v_y, omega, then v⁺ (3), then
            mu; for each f_i it is force / Σ f.
    """
    for i in range(3):
        A[i, 0] = A[i, 1] = A[i, 2] = extra[i, 4] = 0.0
    for j in range(10):
        dforce[0, j] = dforce[1, j] = 0.0
    _free_motion(v, new, h, inertia, quarter, A, extra)
    if impulse1.state != SEPARATE:
        _contact(v, new, h, cone, frame, quarter, first, impulse1, A, extra, dforce)
    if impulse2.state != SEPARATE:
        _contact(v, new, h, cone, frame, quarter, second, impulse2, A, extra, dforce)


@compiled(forceinline=True)
def _free_motion(v, new, h, inertia, quarter, A, extra):  # type: ignore[no-untyped-def]
    """Momentum of v⁺ less that of the free motion: linear in the inertia, turned by -h omega."""
    m, sx, sy, J = inertia
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
def _contact(v, new, h, cone, frame, quarter, contact, impulse, A, extra, dforce):  # type: ignore[no-untyped-def]
    """Add one contact's part."""
    y, x = contact.y, contact.x
    cos, sin = frame.cos, frame.sin
    vfx, vfy = frame.speed_x, frame.speed_y
    # To its predicted origin the frame moved by way (w_x, w_y), the last twist's velocity seen from it.
    way = 0.5 * h * quarter.sinc
    wx, wy = turned(quarter.cos, -quarter.sin, v[0], v[1])
    stretch = 0.125 * h * h * quarter.sinc_slope
    common = (v, new, h, cone, frame, contact, impulse, A, dforce)
    bx, by = frame.spring_x, frame.spring_y
    add_column(0, -cos, sin, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, common)
    add_column(1, -sin, -cos, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, common)
    add_column(2, way * wy + frame.tip_y, -way * wx - frame.tip_x, vfy, -vfx, by, -bx, 0.0, 0.0, common)
    add_column(3, -way * quarter.cos, way * quarter.sin, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, common)
    add_column(4, -way * quarter.sin, -way * quarter.cos, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, common)
    half = 0.5 * h
    dpx = half * (0.5 * way * wy + frame.tip_y) - stretch * wx
    dpy = -half * (0.5 * way * wx + frame.tip_x) - stretch * wy
    add_column(5, dpx, dpy, half * vfy, -half * vfx, half * by, -half * bx, -y, x, common)
    _by_new_twist(cone, contact, impulse, dforce)
    if impulse.state == SLIDE_FORWARD or impulse.state == SLIDE_BACK:
        _by_finger_friction(new, cone, contact, impulse, extra, dforce)


@compiled(forceinline=True, fastmath={"contract", "nnan", "nsz"})
def add_column(j, dpx, dpy, dvfx, dvfy, dbx, dby, dux, duy, common):  # type: ignore[no-untyped-def]
    """Add to column j of A and dforce what follows from three changes, all in the middle frame.

    Args:
        j: column.
        dpx: change of the finger's place in the middle of the step, x.
        dpy: the same, y.
        dvfx: change of its velocity, x.
        dvfy: the same, y.
        dbx: change of the speed at which a bent finger would straighten, x.
        dby: the same, y.
        dux: change of the last twist's velocity at the contact, x.
        duy: the same, y.
        common: what all columns share.
    """
    v, new, h, cone, frame, contact, impulse, A, dforce = common
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
def _by_finger_friction(new, cone, contact, impulse, extra, dforce):  # type: ignore[no-untyped-def]
    """Add the change of gradient and force of a sliding contact by mu."""
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
