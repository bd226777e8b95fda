"""One convex time step V(x, v, F, M, mu) of the sliding object, and its exact derivative.

Over a step of length h the object's twist v (object frame, at the frame's origin) becomes

    v⁺ = argmin  ½ (v - v*)ᵀ M (v - v*)  +  h Σ_i f_i φ_i(v)  +  ℓ_contact(v)

with the free motion v*, the friction loads f_i = mu_i N_i and norms φ_i of `friction.py`, and the contact of
`contact.py`. The masses enter through total mass m, first moment s = Σ m_i r_i and second moment
J = Σ m_i (|r_i|² + w²/6) alone: the rigid reduction of the paper's 3n equations.

Everything is written in a frame that moves with the object and is taken at the middle of the step, predicted
from the last twist. Poses move along the exact screw motion of v⁺, so neither the choice of the world frame nor
that of the object frame changes a trajectory.

Derivatives follow from the implicit function theorem: where the gradient g(v⁺, p) of the function above
vanishes, dv⁺/dp = -H⁻¹ ∂g/∂p. The parameters of a rollout are, in this order,

    f_1 … f_n, m, s_x, s_y, J, mu_finger, and the start x, y, θ, v_x, v_y, omega (world pose, object-frame twist).

Where a contact is at the edge between sticking, sliding and apart, derivatives are those of the side on which the
solution was found (one-sided).
"""

from __future__ import annotations

import math

from models.physics.compiled import compiled
from models.physics.contact import CONTACT_COLUMNS, SLIDE_FORWARD, cone_matrix, cone_state, find_contacts
from models.physics.friction import friction_moments

START_COLUMNS = 6
INERTIA_COLUMNS = 4
EXTRA_COLUMNS = INERTIA_COLUMNS + 1 + START_COLUMNS
"""Columns after the n loads: inertia, finger friction, start."""

MAX_EVALUATIONS = 60
CONTACT_MARGIN = 1e-3
"""Gaps larger than this, and than what the step can close, are left out of the step (m)."""

VELOCITY_TOLERANCE = 1e-9
"""Newton stops when its step is below this speed (m/s, rotation counted at the object's radius)."""


@compiled()
def free_momentum(inertia, v, h):  # type: ignore[no-untyped-def]
    """Momentum of the free motion, in the new frame: the linear part turns by -h omega, the spin stays.

    Args:
        inertia: (4,) m, s_x, s_y, J.
        v: (3,) twist of the last step.
        h: step, s.

    Returns:
        p_x, p_y and L about the frame's origin.
    """
    m, sx, sy, J = inertia[0], inertia[1], inertia[2], inertia[3]
    px = m * v[0] - sy * v[2]
    py = m * v[1] + sx * v[2]
    L = sx * v[1] - sy * v[0] + J * v[2]
    c = math.cos(h * v[2])
    s = math.sin(h * v[2])
    qx = c * px + s * py
    qy = -s * px + c * py
    return qx, qy, L + (sx * (qy - py) - sy * (qx - px)) / m


@compiled()
def sinc(x):  # type: ignore[no-untyped-def]
    """The function sin(x)/x and its derivative."""
    if abs(x) < 1e-3:
        x2 = x * x
        return 1.0 - x2 / 6.0 * (1.0 - x2 / 20.0), -x / 3.0 * (1.0 - x2 / 10.0)
    return math.sin(x) / x, (math.cos(x) - math.sin(x) / x) / x


@compiled()
def invert_symmetric(H, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric positive definite 3x3 matrix given by its upper triangle."""
    a, b, c, d, e, f = H[0, 0], H[0, 1], H[0, 2], H[1, 1], H[1, 2], H[2, 2]
    c00 = d * f - e * e
    c01 = c * e - b * f
    c02 = b * e - c * d
    scale = 1.0 / (a * c00 + b * c01 + c * c02)
    inverse[0, 0] = c00 * scale
    inverse[0, 1] = inverse[1, 0] = c01 * scale
    inverse[0, 2] = inverse[2, 0] = c02 * scale
    inverse[1, 1] = (a * f - c * c) * scale
    inverse[1, 2] = inverse[2, 1] = (b * c - a * e) * scale
    inverse[2, 2] = (a * d - b * b) * scale


@compiled()
def evaluate_smooth(load, rx, ry, rho2, eps2, inertia, star, h, v, g, H):  # type: ignore[no-untyped-def]
    """Gradient (into g) and Hessian (into H) at v of inertia and base friction, all but the contact."""
    m, sx, sy, J = inertia[0], inertia[1], inertia[2], inertia[3]
    vx, vy, omega = v[0], v[1], v[2]
    _, a, ax, ay, arr, bxx, bxy, byy, bxw, byw, bww = friction_moments(
        load, rx, ry, vx, vy, omega, rho2, eps2
    )
    spin = arr + rho2 * a
    g[0] = m * vx - sy * omega - star[0] + h * (a * vx - ay * omega)
    g[1] = m * vy + sx * omega - star[1] + h * (a * vy + ax * omega)
    g[2] = sx * vy - sy * vx + J * omega - star[2] + h * (ax * vy - ay * vx + spin * omega)
    H[0, 0] = m + h * (a - bxx)
    H[0, 1] = -h * bxy
    H[0, 2] = -sy - h * (ay + bxw)
    H[1, 1] = m + h * (a - byy)
    H[1, 2] = sx + h * (ax - byw)
    H[2, 2] = J + h * (spin - bww)


@compiled()
def spring_impulses(contacts, k, v, vf, h, stiffness):  # type: ignore[no-untyped-def]
    """y_n and y_t of contact k if the object moves with v; `stiffness` holds 1/R_n and 1/R_t."""
    nx, ny, x, y = contacts[k, 0], contacts[k, 1], contacts[k, 2], contacts[k, 3]
    ux = v[0] - v[2] * y
    uy = v[1] + v[2] * x
    y_n = (nx * ux + ny * uy - contacts[k, 4] / h) * stiffness[0]
    y_t = (-ny * (vf[0] - ux) + nx * (vf[1] - uy)) * stiffness[1]
    return y_n, y_t


@compiled()
def contact_slope(contacts, count, v, vf, h, mu, stiffness, d):  # type: ignore[no-untyped-def]
    """Derivative of the contact's energy at v along d."""
    slope = 0.0
    for k in range(count):
        y_n, y_t = spring_impulses(contacts, k, v, vf, h, stiffness)
        ratio = stiffness[0] / stiffness[1]
        nn, nt, tn, tt = cone_matrix(mu, ratio, cone_state(y_n, y_t, mu, ratio))
        nx, ny, x, y = contacts[k, 0], contacts[k, 1], contacts[k, 2], contacts[k, 3]
        dx = d[0] - d[2] * y
        dy = d[1] + d[2] * x
        slope += (nn * y_n + nt * y_t) * (nx * dx + ny * dy) - (tn * y_n + tt * y_t) * (nx * dy - ny * dx)
    return slope


@compiled()
def solve_with_contacts(g, H, v, contacts, count, vf, h, mu, stiffness, total, inverse, d):  # type: ignore[no-untyped-def]
    """Minimise the quadratic model (g, H) of the smooth part around v plus the exact contact energy.

    In each combination of contact states the problem is a linear one. The states of the last candidate are
    tried first; as the minimum is unique, going through all combinations finds it if those run in a circle.

    Fills d (the way from v to the minimum), `inverse` (of the Hessian with contacts), and the impulses and
    states of `contacts`.
    """
    ratio = stiffness[0] / stiffness[1]
    if count == 0:
        invert_symmetric(H, inverse)
        for i in range(3):
            d[i] = -(inverse[i, 0] * g[0] + inverse[i, 1] * g[1] + inverse[i, 2] * g[2])
        return
    combinations = 4**count
    guess = 0
    for k in range(count):
        y_n, y_t = spring_impulses(contacts, k, v, vf, h, stiffness)
        guess += cone_state(y_n, y_t, mu, ratio) * 4**k
    best = -1
    best_error = math.inf
    followed = 5
    for attempt in range(followed + combinations + 1):
        last = attempt == followed + combinations
        if last:
            combination = best
        elif attempt < followed:
            combination = guess
        else:
            combination = attempt - followed
        _solve_states(combination, g, H, v, contacts, count, vf, h, mu, ratio, stiffness, total, inverse, d)
        if last:
            return
        guess = 0
        error = 0.0
        scale = 0.0
        for k in range(count):
            state = (combination // 4**k) % 4
            y_n, y_t = spring_impulses(contacts, k, v, vf, h, stiffness)
            dn, dt = _spring_changes(contacts, k, d, stiffness)
            y_n += dn
            y_t += dt
            true_state = cone_state(y_n, y_t, mu, ratio)
            guess += true_state * 4**k
            nn, nt, tn, tt = cone_matrix(mu, ratio, state)
            contacts[k, 7] = nn * y_n + nt * y_t
            contacts[k, 8] = tn * y_n + tt * y_t
            contacts[k, 9] = state
            nn, nt, tn, tt = cone_matrix(mu, ratio, true_state)
            error += abs(contacts[k, 7] - nn * y_n - nt * y_t) + abs(contacts[k, 8] - tn * y_n - tt * y_t)
            scale += abs(contacts[k, 7]) + abs(contacts[k, 8])
        if guess == combination or error <= 1e-13 * scale:
            return
        if error < best_error:
            best_error = error
            best = combination


@compiled()
def _spring_changes(contacts, k, d, stiffness):  # type: ignore[no-untyped-def]
    """Change of y_n and y_t of contact k when the twist changes by d."""
    nx, ny, x, y = contacts[k, 0], contacts[k, 1], contacts[k, 2], contacts[k, 3]
    ux = d[0] - d[2] * y
    uy = d[1] + d[2] * x
    return (nx * ux + ny * uy) * stiffness[0], (ny * ux - nx * uy) * stiffness[1]


@compiled()
def _solve_states(combination, g, H, v, contacts, count, vf, h, mu, ratio, stiffness, total, inverse, d):  # type: ignore[no-untyped-def]
    """Minimum d of the quadratic model while the contacts keep the states of `combination`."""
    g0, g1, g2 = g[0], g[1], g[2]
    for i in range(3):
        for j in range(i, 3):
            total[i, j] = H[i, j]
    for k in range(count):
        nn, nt, tn, tt = cone_matrix(mu, ratio, (combination // 4**k) % 4)
        y_n, y_t = spring_impulses(contacts, k, v, vf, h, stiffness)
        gamma_n = nn * y_n + nt * y_t
        gamma_t = tn * y_n + tt * y_t
        nx, ny, x, y = contacts[k, 0], contacts[k, 1], contacts[k, 2], contacts[k, 3]
        tx, ty = -ny, nx
        nw = x * ny - y * nx
        tw = x * ty - y * tx
        g0 += nx * gamma_n - tx * gamma_t
        g1 += ny * gamma_n - ty * gamma_t
        g2 += nw * gamma_n - tw * gamma_t
        hnn = nn * stiffness[0]
        hnt = -nt * stiffness[1]
        htt = tt * stiffness[1]
        total[0, 0] += hnn * nx * nx + 2.0 * hnt * nx * tx + htt * tx * tx
        total[0, 1] += hnn * nx * ny + hnt * (nx * ty + tx * ny) + htt * tx * ty
        total[0, 2] += hnn * nx * nw + hnt * (nx * tw + tx * nw) + htt * tx * tw
        total[1, 1] += hnn * ny * ny + 2.0 * hnt * ny * ty + htt * ty * ty
        total[1, 2] += hnn * ny * nw + hnt * (ny * tw + ty * nw) + htt * ty * tw
        total[2, 2] += hnn * nw * nw + 2.0 * hnt * nw * tw + htt * tw * tw
    invert_symmetric(total, inverse)
    for i in range(3):
        d[i] = -(inverse[i, 0] * g0 + inverse[i, 1] * g1 + inverse[i, 2] * g2)


@compiled()
def solve_step(  # type: ignore[no-untyped-def]
    load, rx, ry, rho2, eps2, inertia, mu, star, h, stiffness, vf, contacts, count, size, v, g, H, total, inverse, trial, d
):  # fmt: skip
    """Minimise the step's function from the start value in v.

    Newton on the smooth part, with the contact kept exact in every iteration (`solve_with_contacts`): the
    contact's narrow valleys then cost no evaluation of the cells. Along a descent direction the slope of a convex
    function grows; where the full step overshoots, the minimum is bracketed. An overshoot is mostly an object
    coming to rest, where the sum of norms has its one sharp point: rest is then tried first.

    Returns:
        Number of evaluations of the cells; above `MAX_EVALUATIONS` if the minimum was not reached.
    """
    evaluate_smooth(load, rx, ry, rho2, eps2, inertia, star, h, v, g, H)
    evaluations = 1
    rest_tried = False
    while True:
        solve_with_contacts(g, H, v, contacts, count, vf, h, mu, stiffness, total, inverse, d)
        if abs(d[0]) + abs(d[1]) + size * abs(d[2]) < VELOCITY_TOLERANCE:
            for i in range(3):
                v[i] += d[i]
            return evaluations
        slope = g[0] * d[0] + g[1] * d[1] + g[2] * d[2]
        slope += contact_slope(contacts, count, v, vf, h, mu, stiffness, d)
        low, high = 0.0, 1.0
        low_slope, high_slope = slope, 0.0
        t = 1.0
        while True:
            if evaluations >= MAX_EVALUATIONS:
                return MAX_EVALUATIONS + 1
            for i in range(3):
                trial[i] = v[i] + t * d[i]
            evaluate_smooth(load, rx, ry, rho2, eps2, inertia, star, h, trial, g, H)
            evaluations += 1
            new_slope = g[0] * d[0] + g[1] * d[1] + g[2] * d[2]
            new_slope += contact_slope(contacts, count, trial, vf, h, mu, stiffness, d)
            if abs(new_slope) <= -0.5 * slope or (t == 1.0 and new_slope <= 0.0) or high - low < 1e-9:
                break
            if not rest_tried:
                rest_tried = True
                for i in range(3):
                    trial[i] = 0.0
                evaluate_smooth(load, rx, ry, rho2, eps2, inertia, star, h, trial, g, H)
                evaluations += 1
                solve_with_contacts(g, H, trial, contacts, count, vf, h, mu, stiffness, total, inverse, d)
                if abs(d[0]) + abs(d[1]) + size * abs(d[2]) < 2.0 * math.sqrt(eps2):
                    break
                # Not at rest: back to the direction from v.
                evaluate_smooth(load, rx, ry, rho2, eps2, inertia, star, h, v, g, H)
                evaluations += 1
                solve_with_contacts(g, H, v, contacts, count, vf, h, mu, stiffness, total, inverse, d)
            if new_slope > 0.0:
                high, high_slope = t, new_slope
            else:
                low, low_slope = t, new_slope
            secant = low + (high - low) * low_slope / (low_slope - high_slope)
            t = 0.5 * (min(max(secant, low), high) + 0.5 * (low + high))
        for i in range(3):
            v[i] = trial[i]


@compiled()
def place_finger(q, v, h, tip0, tip1, radius, size, edges, contacts, frame, vf):  # type: ignore[no-untyped-def]
    """Middle frame of the step and the contacts seen from it.

    Fills `frame` with cos and sin of its angle, its origin and the tip in it, `vf` with the finger's velocity in it, and
    `contacts` with normal, point and the gap that the step would end with if the object stood still,
    counted from the predicted half step.

    Returns:
        Number of contacts.
    """
    beta = 0.5 * h * v[2]
    value, _ = sinc(0.5 * beta)
    c = math.cos(q[2] + 0.5 * beta)
    s = math.sin(q[2] + 0.5 * beta)
    frame[2] = q[0] + 0.5 * h * value * (c * v[0] - s * v[1])
    frame[3] = q[1] + 0.5 * h * value * (s * v[0] + c * v[1])
    c = math.cos(q[2] + beta)
    s = math.sin(q[2] + beta)
    frame[0] = c
    frame[1] = s
    dx = 0.5 * (tip0[0] + tip1[0]) - frame[2]
    dy = 0.5 * (tip0[1] + tip1[1]) - frame[3]
    frame[4] = c * dx + s * dy
    frame[5] = -s * dx + c * dy
    wx = (tip1[0] - tip0[0]) / h
    wy = (tip1[1] - tip0[1]) / h
    vf[0] = c * wx + s * wy
    vf[1] = -s * wx + c * wy
    reach = CONTACT_MARGIN + 2.0 * h * (abs(vf[0]) + abs(vf[1]) + abs(v[0]) + abs(v[1]) + size * abs(v[2]))
    if math.sqrt(frame[4] * frame[4] + frame[5] * frame[5]) > size + radius + reach:
        return 0
    count = find_contacts(frame[4], frame[5], radius, reach, edges, contacts)
    for k in range(count):
        nx, ny, x, y = contacts[k, 0], contacts[k, 1], contacts[k, 2], contacts[k, 3]
        contacts[k, 4] += 0.5 * h * (nx * (vf[0] + v[0] - v[2] * y) + ny * (vf[1] + v[1] + v[2] * x))
    return count


@compiled()
def step_derivative(  # type: ignore[no-untyped-def]
    q, v, vnew, h, inertia, mu, stiffness, vf, frame, contacts, count, A, extra, force, dforce
):
    """Partial derivatives of the step's gradient and of the contact force at the solution.

    Args:
        q: (3,) pose before the step.
        v: (3,) twist before the step.
        vnew: (3,) solution.
        h: step, s.
        inertia: (4,) m, s_x, s_y, J.
        mu: finger friction.
        stiffness: (2,) 1/R_n and 1/R_t, kg.
        vf: (2,) finger velocity in the middle frame.
        frame: (6,) as filled by `place_finger`.
        contacts: (…, CONTACT_COLUMNS) with the solved impulses.
        count: number of contacts.
        A: (3, 6) result: d(gradient)/d(x, y, θ, v_x, v_y, omega).
        extra: (3, 5) result: d(gradient)/d(m, s_x, s_y, J, mu).
        force: (3,) result: wrench impulse of the finger on the object, middle frame, about its origin.
        dforce: (2, 10) result: d(force impulse, middle frame) by x, y, θ, v_x, v_y, omega, then v⁺ (3), then mu;
            for each f_i it is force / Σ f.
    """
    m, sx, sy = inertia[0], inertia[1], inertia[2]
    # Free motion: linear in the inertia, turned by -h omega.
    c = math.cos(h * v[2])
    s = math.sin(h * v[2])
    px = m * v[0] - sy * v[2]
    py = m * v[1] + sx * v[2]
    qx = c * px + s * py
    qy = -s * px + c * py
    for j in range(4):  # m, s_x, s_y, J
        dpx = v[0] if j == 0 else (-v[2] if j == 2 else 0.0)
        dpy = v[1] if j == 0 else (v[2] if j == 1 else 0.0)
        dL = v[1] if j == 1 else (-v[0] if j == 2 else (v[2] if j == 3 else 0.0))
        dcx = -sx / (m * m) if j == 0 else (1.0 / m if j == 1 else 0.0)
        dcy = -sy / (m * m) if j == 0 else (1.0 / m if j == 2 else 0.0)
        dqx = c * dpx + s * dpy
        dqy = -s * dpx + c * dpy
        dLstar = dL + dcx * (qy - py) - dcy * (qx - px) + (sx * (dqy - dpy) - sy * (dqx - dpx)) / m
        npx = vnew[0] if j == 0 else (-vnew[2] if j == 2 else 0.0)
        npy = vnew[1] if j == 0 else (vnew[2] if j == 1 else 0.0)
        nL = vnew[1] if j == 1 else (-vnew[0] if j == 2 else (vnew[2] if j == 3 else 0.0))
        extra[0, j] = npx - dqx
        extra[1, j] = npy - dqy
        extra[2, j] = nL - dLstar
    for j in range(3):  # v_x, v_y, omega
        dpx = m if j == 0 else (-sy if j == 2 else 0.0)
        dpy = m if j == 1 else (sx if j == 2 else 0.0)
        dL = -sy if j == 0 else (sx if j == 1 else inertia[3])
        dqx = c * dpx + s * dpy
        dqy = -s * dpx + c * dpy
        if j == 2:
            dqx += h * qy
            dqy -= h * qx
        for i in range(3):
            A[i, j] = 0.0
        A[0, 3 + j] = -dqx
        A[1, 3 + j] = -dqy
        A[2, 3 + j] = -(dL + (sx * (dqy - dpy) - sy * (dqx - dpx)) / m)
    for i in range(3):
        extra[i, 4] = 0.0
        force[i] = 0.0
    for j in range(10):
        dforce[0, j] = 0.0
        dforce[1, j] = 0.0
    if count == 0:
        return

    inverse_rn = stiffness[0]
    inverse_rt = stiffness[1]
    ratio = inverse_rn / inverse_rt
    cm, sm = frame[0], frame[1]
    half = 0.25 * h * v[2]
    value, slope = sinc(half)
    ch = math.cos(half)
    sh = math.sin(half)
    # Velocity of the frame's predicted origin, seen from the middle frame.
    wx = ch * v[0] + sh * v[1]
    wy = -sh * v[0] + ch * v[1]
    for k in range(count):
        gamma_n, gamma_t = contacts[k, 7], contacts[k, 8]
        if gamma_n == 0.0 and gamma_t == 0.0:
            continue
        nx, ny, x, y = contacts[k, 0], contacts[k, 1], contacts[k, 2], contacts[k, 3]
        turn, slide = contacts[k, 5], contacts[k, 6]
        tx, ty = -ny, nx
        slip_x = vf[0] - vnew[0] + vnew[2] * y
        slip_y = vf[1] - vnew[1] - vnew[2] * x
        state = int(contacts[k, 9])
        dnn, dnt, dtn, dtt = cone_matrix(mu, ratio, state)
        fx = -nx * gamma_n + tx * gamma_t
        fy = -ny * gamma_n + ty * gamma_t
        force[0] += fx
        force[1] += fy
        force[2] += x * fy - y * fx
        # Velocity of finger and predicted object at the contact, and of the step's motion against both.
        ux = 0.5 * (vf[0] + v[0] - v[2] * y) - (vnew[0] - vnew[2] * y)
        uy = 0.5 * (vf[1] + v[1] + v[2] * x) - (vnew[1] + vnew[2] * x)
        for j in range(6):
            dox = 1.0 if j == 0 else 0.0
            doy = 1.0 if j == 1 else 0.0
            dtheta = 1.0 if j == 2 else 0.0
            dvx = 1.0 if j == 3 else 0.0
            dvy = 1.0 if j == 4 else 0.0
            domega = 1.0 if j == 5 else 0.0
            dbeta = 0.5 * h * domega
            dtheta_m = dtheta + dbeta
            turned = dtheta + 0.5 * dbeta
            # d(origin of the middle frame), in that frame.
            gx = cm * dox + sm * doy
            gy = -sm * dox + cm * doy
            gx += 0.5 * h * (0.5 * slope * dbeta * wx - value * turned * wy + value * (ch * dvx + sh * dvy))
            gy += 0.5 * h * (0.5 * slope * dbeta * wy + value * turned * wx + value * (-sh * dvx + ch * dvy))
            dpx = -gx + dtheta_m * frame[5]
            dpy = -gy - dtheta_m * frame[4]
            dvfx = dtheta_m * vf[1]
            dvfy = -dtheta_m * vf[0]
            along = tx * dpx + ty * dpy
            dnx, dny = turn * along * tx, turn * along * ty
            dtx, dty = -turn * along * nx, -turn * along * ny
            drx, dry = slide * along * tx, slide * along * ty
            dux = 0.5 * (dvfx + dvx - domega * y - v[2] * dry) + vnew[2] * dry
            duy = 0.5 * (dvfy + dvy + domega * x + v[2] * drx) - vnew[2] * drx
            dgap = nx * dpx + ny * dpy + h * (dnx * ux + dny * uy + nx * dux + ny * duy)
            dslip = (
                dtx * slip_x + dty * slip_y + tx * (dvfx + vnew[2] * dry) + ty * (dvfy - vnew[2] * drx)
            )
            dyn = -dgap * inverse_rn / h
            dyt = dslip * inverse_rt
            dgn = dnn * dyn + dnt * dyt
            dgt = dtn * dyn + dtt * dyt
            dfx = -dnx * gamma_n - nx * dgn + dtx * gamma_t + tx * dgt
            dfy = -dny * gamma_n - ny * dgn + dty * gamma_t + ty * dgt
            A[0, j] -= dfx
            A[1, j] -= dfy
            A[2, j] -= x * dfy - y * dfx + drx * fy - dry * fx
            dforce[0, j] += dfx
            dforce[1, j] += dfy
        for j in range(3):  # v⁺
            dn = nx if j == 0 else (ny if j == 1 else x * ny - y * nx)
            dt = tx if j == 0 else (ty if j == 1 else x * ty - y * tx)
            dgn = dnn * dn * inverse_rn - dnt * dt * inverse_rt
            dgt = dtn * dn * inverse_rn - dtt * dt * inverse_rt
            dforce[0, 6 + j] += -nx * dgn + tx * dgt
            dforce[1, 6 + j] += -ny * dgn + ty * dgt
        if state >= SLIDE_FORWARD:
            sign = 1.0 if state == SLIDE_FORWARD else -1.0
            _, y_t = spring_impulses(contacts, k, vnew, vf, h, stiffness)
            dgn = ratio * (abs(y_t) - 2.0 * mu * gamma_n) / (1.0 + mu * mu * ratio)
            dgt = sign * (gamma_n + mu * dgn)
            dfx = -nx * dgn + tx * dgt
            dfy = -ny * dgn + ty * dgt
            extra[0, 4] -= dfx
            extra[1, 4] -= dfy
            extra[2, 4] -= x * dfy - y * dfx
            dforce[0, 9] += dfx
            dforce[1, 9] += dfy


__all__ = [
    "CONTACT_COLUMNS",
    "EXTRA_COLUMNS",
    "free_momentum",
    "place_finger",
    "sinc",
    "solve_step",
    "step_derivative",
]
