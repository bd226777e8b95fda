"""Compiled rollouts of the model with effects, whose formulas are called by their address.

The step is that of `kernel.py` with more terms (`EffectCells`, a wrench, scaled inertia, a finger that
bends). What the formulas are evaluated at, y, joins

    the state before the step: x, y, θ (world), v_x, v_y, omega (object frame);
    memory: nothing, or the last force of the finger on the object (world, N) and the effects' own numbers;
    m, s_x, s_y, J;  and the effects' parameters.

Sensitivities are kept as rows of the state and memory over columns of parameters: loads, m, s_x, s_y, J,
finger friction, start (6), effects. `models.effects.program` writes the formulas, `models.effects.slider` is
the door to this file.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from models.physics.addresses import call_address
from models.physics.compiled import compiled
from models.physics.contact import CONTACT_COLUMNS, MAX_CONTACTS, Cone
from models.physics.effect_cells import EffectCells, cell_gradients, drag_moments
from models.physics.effect_derivative import add_contact_scale, add_spring_columns, blade_slopes
from models.physics.friction import SPIN_RADIUS
from models.physics.prediction import best_weights, weighted
from models.physics.step import (
    EXTRA_COLUMNS,
    INERTIA_COLUMNS,
    MAX_EVALUATIONS,
    Frame,
    contact_of,
    free_momentum,
    middle_frame,
    solve_step,
    touching,
)
from models.physics.step_derivative import step_derivative
from models.physics.turns import joined, turn_by, turned

BODY_OUTPUTS = 8
"""Wrench (middle frame: 2 forces, torque about the origin), q_xx, q_xy, q_yy, inertia factor, compliance of
the finger (m/N); each blade adds F, b_x, b_y, b_omega."""

CONSTANTS = 11
"""Time in the middle of the step, h, order of the push in the experiment, gravity, cell width, the cells'
centroid (2), the inverse of their second moments about it (xx, xy, yy; 1/m²), and their number."""

STATE = 6
FORCE = 2
INERTIA = 4
AFTER = 8
"""What memory is renewed from besides y: x, y, θ, v_x, v_y, omega after the step and the force in it."""


@compiled()
def effect_rollout(  # type: ignore[no-untyped-def]
    load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h, tip, wrench, q0, v0,
    sample_time, delay, force_step, addresses, sizes, constants, parameters, memory0,
    pose_out, rate_out, force_out, dpose_out, dforce_out, end_out,
):  # fmt: skip
    """One push of one model with effects; arguments that `kernel.rollout` has too are described there.

    Args:
        sample_time: (S,) times at which poses are wanted, s, ascending.
        delay: taken from them, s.
        addresses: (4,) of the functions body, cells, cell slopes, memory.
        sizes: (5,) numbers of memory entries, parameters, blades; whether cells are changed; whether Q is.
        constants: (CONSTANTS,), see there; the first is filled in here.
        parameters: (P,) of the effects.
        memory0: (E,) memory before the first step.
        rate_out: (S, 3) result, velocity of the pose, zero where `delay` reaches beyond the push.
        dpose_out: (S, 3, n + EXTRA_COLUMNS + P) result, or no columns.
        dforce_out: (T, 2, the same) result.
    """
    n = load.shape[0]
    E, P, blade_count, with_cells, with_stretch = sizes[0], sizes[1], sizes[2], sizes[3], sizes[4]
    derive = dpose_out.shape[2] > 0
    memory_rows = STATE + E
    Y = memory_rows + INERTIA + P
    columns = n + EXTRA_COLUMNS + P
    load_sum = load.sum()
    give, creep = smoothing[2] / load_sum, smoothing[1] / load_sum
    body = (inertia[0], inertia[1], inertia[2], inertia[3])
    about_center = inertia[3] - (inertia[1] * inertia[1] + inertia[2] * inertia[2]) / inertia[0]
    rho2, eps2 = (SPIN_RADIUS * cell_width) ** 2, smoothing[0] * smoothing[0]
    rows = np.zeros((MAX_CONTACTS, CONTACT_COLUMNS))
    applied = wrench.shape[0] > 0

    c = constants.copy()
    y = np.zeros(Y)
    y[STATE:memory_rows] = memory0
    y[memory_rows : memory_rows + INERTIA] = inertia
    y[memory_rows + INERTIA :] = parameters
    out = np.zeros(BODY_OUTPUTS + 4 * blade_count)
    dout = np.zeros((BODY_OUTPUTS + 4 * blade_count, Y))
    factor = np.ones(n)
    drag = np.zeros(n)
    drag_sums = np.zeros(4)
    loads = load.copy()
    after = np.zeros(AFTER)
    own = np.zeros(max(0, E - FORCE))
    down = np.zeros((max(0, E - FORCE), Y + AFTER))

    by_load = np.zeros((3, n))
    by_drag = np.zeros((3, n))
    by_stretch = np.zeros((3, 3))
    weighted_load = np.zeros((3, n))
    G = np.zeros((3, Y))
    A = np.zeros((3, 6))
    extra = np.zeros((3, EXTRA_COLUMNS))
    dforce = np.zeros((2, 10))
    spring_A = np.zeros((3, 3))
    spring_force = np.zeros((2, 3))
    scale_g = np.zeros((3, 2))
    scale_f = np.zeros((2, 2))
    T = np.zeros((memory_rows, columns if derive else 0))
    new_T = np.zeros_like(T)
    direct = np.zeros((3, columns if derive else 0))
    if derive:
        for k in range(6):
            T[k, n + INERTIA_COLUMNS + 1 + k] = 1.0

    x, yy, theta = q0[0], q0[1], q0[2]
    cos, sin = math.cos(theta), math.sin(theta)
    v = (v0[0], v0[1], v0[2])
    quarter = turn_by(0.25 * h * v[2])
    past = (v, v, v)
    weights = (1.0, 0.0, 0.0)
    evaluations = 0
    failed = False
    sample = 0
    force_sample = 0
    steps = tip.shape[0] - 1

    for step in range(steps):
        c[0] = (step + 0.5) * h
        y[0], y[1], y[2] = x, yy, theta
        y[3], y[4], y[5] = v
        call_address(addresses[0], (y, c, out, dout))
        if with_cells:
            call_address(addresses[1], (y, c, rx, ry, factor, drag))
            for i in range(n):
                loads[i] = load[i] * max(factor[i], 0.0)
            drag_moments(drag, rx, ry, cell_width, drag_sums)
        kappa, compliance = out[6], out[7]
        blades = out[BODY_OUTPUTS:].reshape(blade_count, 4)
        cells = EffectCells(loads, rx, ry, rho2, eps2, out[3], out[4], out[5], drag_sums, blades)
        # 1/R_n and 1/R_t of the contact, as in `kernel.rollout`, in series with the finger's own give.
        normal = h * h / (give + compliance)
        tangential = h * h / (h * creep + compliance)
        cone = Cone(mu, normal, tangential, normal / tangential)

        half_cos, half_sin = joined(quarter.cos, quarter.sin, quarter.cos, quarter.sin)
        full_cos, full_sin = joined(half_cos, half_sin, half_cos, half_sin)
        free_x, free_y, free_w = free_momentum(body, v, full_cos, full_sin)
        added_x, added_y, added_w = h * out[0], h * out[1], h * out[2]
        lever_x = lever_y = turning = 0.0
        if applied:
            cc, ss = joined(cos, sin, half_cos, half_sin)
            fx, fy = turned(cc, -ss, wrench[step, 0], wrench[step, 1])
            px, py = wrench[step, 2], wrench[step, 3]
            lever_x, lever_y, turning = h * fx, h * fy, -h * (px * fx + py * fy)
            added_x += lever_x
            added_y += lever_y
            added_w += h * (px * fy - py * fx + wrench[step, 4])
        gain = math.hypot(added_x, added_y) / body[0] + size * abs(added_w) / about_center
        count = 0
        frame = Frame(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        bend_x = bend_y = 0.0
        if E > 0:
            bend_x, bend_y = compliance * y[STATE], compliance * y[STATE + 1]
        tip0 = (tip[step, 0] - bend_x, tip[step, 1] - bend_y)
        tip1 = (tip[step + 1, 0] - bend_x, tip[step + 1, 1] - bend_y)
        if not math.isnan(tip0[0]) and not math.isnan(tip1[0]):
            frame = middle_frame(x, yy, cos, sin, quarter, v, h, tip0, tip1)
            spring_x, spring_y = turned(frame.cos, -frame.sin, bend_x / h, bend_y / h)
            frame = Frame(
                frame.cos, frame.sin, frame.tip_x, frame.tip_y, frame.speed_x, frame.speed_y,
                spring_x, spring_y,
            )  # fmt: skip
            count = touching(frame, v, h, radius, size, edges, rows, gain + abs(spring_x) + abs(spring_y))
        first = contact_of(rows, 0, frame, v, h)
        second = contact_of(rows, 1, frame, v, h)
        star = (kappa * free_x + added_x, kappa * free_y + added_y, kappa * free_w + added_w)
        scaled = (kappa * body[0], kappa * body[1], kappa * body[2], kappa * body[3])

        start = weighted(weights, past)
        solution = solve_step(cells, scaled, star, h, first, second, count, cone, size, start, derive)
        new = (solution.vx, solution.vy, solution.omega)
        weights = best_weights(new, past, size)
        past = (new, past[0], past[1])
        minimum = solution.minimum
        evaluations += solution.evaluations
        failed = failed or solution.evaluations > MAX_EVALUATIONS

        impulse1, impulse2 = minimum.first, minimum.second
        force_x = -first.nx * impulse1.normal - first.ny * impulse1.tangential
        force_x -= second.nx * impulse2.normal + second.ny * impulse2.tangential
        force_y = first.nx * impulse1.tangential - first.ny * impulse1.normal
        force_y += second.nx * impulse2.tangential - second.ny * impulse2.normal
        world_x, world_y = turned(frame.cos, frame.sin, force_x / h, force_y / h)

        next_quarter = turn_by(0.25 * h * new[2])
        half_cos, half_sin = joined(next_quarter.cos, next_quarter.sin, next_quarter.cos, next_quarter.sin)
        mid_cos, mid_sin = joined(cos, sin, half_cos, half_sin)
        wx, wy = turned(mid_cos, mid_sin, new[0], new[1])
        length = h * next_quarter.sinc * next_quarter.cos
        next_x, next_y, next_theta = x + length * wx, yy + length * wy, theta + h * new[2]

        if E > 0:
            after[0], after[1], after[2] = next_x, next_y, next_theta
            after[3], after[4], after[5] = new
            after[6], after[7] = world_x, world_y
            if E > FORCE:
                call_address(addresses[3], (y, c, after, own, down))

        if derive:
            step_derivative(
                v, new, h, scaled, cone, frame, quarter, first, second, impulse1, impulse2, A, extra, dforce
            )  # fmt: skip
            for row, lever in enumerate((lever_y, -lever_x, turning)):
                A[row, 2] -= lever
                A[row, 5] -= 0.5 * h * lever
            extra[:, :INERTIA] *= kappa
            cell_gradients(cells, new, cell_width, by_load, by_drag, by_stretch)
            # What the wrench, the inertia factor, Q and the blades do to the gradient, by y.
            momentum = (
                body[0] * new[0] - body[2] * new[2] - free_x,
                body[0] * new[1] + body[1] * new[2] - free_y,
                body[1] * new[1] - body[2] * new[0] + body[3] * new[2] - free_w,
            )
            for a in range(3):
                for k in range(Y):
                    G[a, k] = momentum[a] * dout[6, k] - h * dout[a, k]
                if with_stretch:
                    for q in range(3):
                        for k in range(Y):
                            G[a, k] += h * by_stretch[a, q] * dout[3 + q, k]
            if blade_count > 0:
                blade_slopes(blades, dout[BODY_OUTPUTS:], new, eps2, h, G)
            if with_cells:
                for i in range(n):
                    share = h * load[i] if factor[i] > 0.0 else 0.0
                    for a in range(3):
                        weighted_load[a, i] = share * by_load[a, i]
                        by_drag[a, i] *= h
                call_address(addresses[2], (y, c, rx, ry, weighted_load, by_drag, G))
            for a in range(3):
                for k in range(6):
                    G[a, k] += A[a, k]

            # The contact, by its stiffness: through the sum of loads and through the finger's compliance.
            add_contact_scale(
                first, second, impulse1, impulse2, cone, new, h, give, creep, load_sum, scale_g, scale_f
            )
            for a in range(3):
                for k in range(Y):
                    G[a, k] += scale_g[a, 1] * dout[7, k]
            if E > 0:
                # The finger bends by compliance times the last force; columns: force x, force y, compliance.
                last = (y[STATE], y[STATE + 1])
                add_spring_columns(
                    v, new, h, cone, frame, first, second, impulse1, impulse2, last, compliance,
                    spring_A, spring_force,
                )  # fmt: skip
                for a in range(3):
                    G[a, STATE] += spring_A[a, 0]
                    G[a, STATE + 1] += spring_A[a, 1]
                    for k in range(Y):
                        G[a, k] += spring_A[a, 2] * dout[7, k]

            for a in range(3):
                for i in range(n):
                    direct[a, i] = h * max(factor[i], 0.0) * by_load[a, i] + scale_g[a, 0]
                for k in range(INERTIA):
                    direct[a, n + k] = extra[a, k] + G[a, memory_rows + k]
                direct[a, n + INERTIA] = extra[a, INERTIA]
                direct[a, n + INERTIA + 1 : n + EXTRA_COLUMNS] = 0.0
                for k in range(P):
                    direct[a, n + EXTRA_COLUMNS + k] = G[a, memory_rows + INERTIA + k]
                for k in range(memory_rows):
                    slope = G[a, k]
                    if slope != 0.0:
                        for j in range(columns):
                            direct[a, j] += slope * T[k, j]
            ixx, ixy, ixw = minimum.xx, minimum.xy, minimum.xw
            iyy, iyw, iww = minimum.yy, minimum.yw, minimum.ww
            slope = next_quarter.sinc_slope * next_quarter.cos - next_quarter.sinc * next_quarter.sin
            slope *= 0.25 * h * h
            bend = 0.5 * h * length
            to_x, to_y = slope * wx - bend * wy, slope * wy + bend * wx
            for j in range(columns):
                gx, gy, gw = direct[0, j], direct[1, j], direct[2, j]
                dvx = -(ixx * gx + ixy * gy + ixw * gw)
                dvy = -(ixy * gx + iyy * gy + iyw * gw)
                dw = -(ixw * gx + iyw * gy + iww * gw)
                dtheta = T[2, j]
                new_T[0, j] = T[0, j] + length * (-wy * dtheta + mid_cos * dvx - mid_sin * dvy) + to_x * dw
                new_T[1, j] = T[1, j] + length * (wx * dtheta + mid_sin * dvx + mid_cos * dvy) + to_y * dw
                new_T[2, j] = dtheta + h * dw
                new_T[3, j] = dvx
                new_T[4, j] = dvy
                new_T[5, j] = dw
            if E > 0:
                _force_rows(
                    T, new_T, n, P, frame, h, (world_x, world_y), dforce, spring_force, scale_f, dout,
                    new_T, STATE, E,
                )  # fmt: skip
                for e in range(E - FORCE):
                    target = new_T[STATE + FORCE + e]
                    target[:] = 0.0
                    for k in range(memory_rows):
                        if down[e, k] != 0.0:
                            for j in range(columns):
                                target[j] += down[e, k] * T[k, j]
                    for k in range(INERTIA):
                        target[n + k] += down[e, memory_rows + k]
                    for k in range(P):
                        target[n + EXTRA_COLUMNS + k] += down[e, memory_rows + INERTIA + k]
                    for k in range(AFTER):
                        if down[e, Y + k] != 0.0:
                            for j in range(columns):
                                target[j] += down[e, Y + k] * new_T[k, j]

        while sample < sample_time.shape[0]:
            at = sample_time[sample] - delay
            if at > (step + 1) * h * (1.0 + 1e-12) and step + 1 < steps:
                break
            share = min(max(at / h - step, 0.0), 1.0)
            pose_out[sample, 0] = x + share * length * wx
            pose_out[sample, 1] = yy + share * length * wy
            pose_out[sample, 2] = theta + share * h * new[2]
            within = 0.0 < at < (step + 1) * h * (1.0 + 1e-9)
            rate_out[sample, 0] = length * wx / h if within else 0.0
            rate_out[sample, 1] = length * wy / h if within else 0.0
            rate_out[sample, 2] = new[2] if within else 0.0
            if derive:
                for i in range(3):
                    for j in range(columns):
                        dpose_out[sample, i, j] = T[i, j] + share * (new_T[i, j] - T[i, j])
            sample += 1
        while force_sample < force_step.shape[0] and force_step[force_sample] == step:
            force_out[force_sample, 0] = world_x
            force_out[force_sample, 1] = world_y
            if derive:
                _force_rows(
                    T, new_T, n, P, frame, h, (world_x, world_y), dforce, spring_force, scale_f, dout,
                    dforce_out[force_sample], 0, E,
                )  # fmt: skip
            force_sample += 1

        if derive:
            T, new_T = new_T, T
        if E > 0:
            y[STATE], y[STATE + 1] = world_x, world_y
            for e in range(E - FORCE):
                y[STATE + FORCE + e] = own[e]
        x, yy, theta = next_x, next_y, next_theta
        cos, sin = joined(mid_cos, mid_sin, half_cos, half_sin)
        v = new
        quarter = next_quarter

    end_out[0], end_out[1], end_out[2] = x, yy, theta
    end_out[3], end_out[4], end_out[5] = v
    end_out[6] = -1.0 if failed else float(evaluations)


@compiled()
def _force_rows(T, new_T, n, P, frame, h, force, dforce, spring_force, scale_f, dout, out, at, E):  # type: ignore[no-untyped-def]
    """Write the derivatives of the finger's force (world, N) by all columns into rows `at` and `at` + 1 of
    out."""
    for j in range(out.shape[1]):
        px = py = 0.0
        if j < n:
            px, py = scale_f[0, 0], scale_f[1, 0]
        elif j == n + INERTIA:
            px, py = dforce[0, 9], dforce[1, 9]
        # The compliance may depend on any of the formula's arguments.
        through = 0.0
        for k in range(STATE + E):
            through += dout[7, k] * T[k, j]
        if n <= j < n + INERTIA:
            through += dout[7, STATE + E + j - n]
        elif j >= n + EXTRA_COLUMNS:
            through += dout[7, STATE + E + INERTIA + j - n - EXTRA_COLUMNS]
        px += (scale_f[0, 1] + spring_force[0, 2]) * through
        py += (scale_f[1, 1] + spring_force[1, 2]) * through
        for k in range(STATE):
            px += dforce[0, k] * T[k, j]
            py += dforce[1, k] * T[k, j]
        for k in range(min(E, FORCE)):
            px += spring_force[0, k] * T[STATE + k, j]
            py += spring_force[1, k] * T[STATE + k, j]
        for k in range(3):
            px += dforce[0, 6 + k] * new_T[3 + k, j]
            py += dforce[1, 6 + k] * new_T[3 + k, j]
        turning = T[2, j] + 0.5 * h * T[5, j]
        out[at, j] = (frame.cos * px - frame.sin * py) / h - force[1] * turning
        out[at + 1, j] = (frame.sin * px + frame.cos * py) / h + force[0] * turning


@compiled(parallel=True)
def effect_rollout_all(  # type: ignore[no-untyped-def]
    load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h, tip, tip_at,
    wrench, wrench_at, q0, v0, sample_time, sample_at, delay, force_step, force_at,
    addresses, sizes, constants, parameters, memory0,
    pose_out, rate_out, force_out, dpose_out, dforce_out, end_out,
):  # fmt: skip
    """All models times all pushes, on all threads; arguments as in `kernel.rollout_one` and `effect_rollout`.

    Shapes: delay (K,), constants (B, CONSTANTS), parameters (K, P), rate_out (K, S, 3).
    """
    pushes = h.shape[0]
    for job in prange(load.shape[0] * pushes):
        k = job // pushes
        b = job % pushes
        s0, s1 = sample_at[b], sample_at[b + 1]
        f0, f1 = force_at[b], force_at[b + 1]
        effect_rollout(
            load[k], rx, ry, inertia[k], mu[k], cell_width, edges, radius, size, smoothing, h[b],
            tip[tip_at[b] : tip_at[b + 1]], wrench[wrench_at[b] : wrench_at[b + 1]], q0[k, b], v0[k, b],
            sample_time[s0:s1], delay[k], force_step[f0:f1],
            addresses, sizes, constants[b], parameters[k], memory0,
            pose_out[k, s0:s1], rate_out[k, s0:s1], force_out[k, f0:f1], dpose_out[k, s0:s1],
            dforce_out[k, f0:f1], end_out[k, b],
        )  # fmt: skip


__all__ = ["BODY_OUTPUTS", "CONSTANTS", "effect_rollout_all"]
