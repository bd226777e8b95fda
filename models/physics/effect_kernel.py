"""Compiled rollouts of the model with effects, whose formulas are called by their address.

The step is that of `kernel.py` with more terms (`EffectCells`, a wrench, scaled inertia, a finger that
bends). What the formulas are evaluated at is in `effect_layout.py`, the Jacobian in `effect_sensitivity.py`.
`slipmap.models.effects.program` writes the formulas, `effect_jobs.py` calls this file for many models and pushes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import prange

from slipmap.models.physics.around_step import (
    Applied,
    add_applied_turning,
    applied_impulse,
    bent_frame,
    best_weights,
    finger_impulse,
    way_of,
    weighted,
)
from slipmap.models.physics.compiled import address_of, call_address, call_compiled, compiled
from slipmap.models.physics.contact import CONTACT_COLUMNS, MAX_CONTACTS, cone_of
from slipmap.models.physics.effect_cells import (
    AFTER,
    BODY_OUTPUTS,
    COMPLIANCE,
    FORCE,
    INERTIA,
    INERTIA_FACTOR,
    STATE,
    STRETCH,
    EffectCells,
    drag_gradients,
    drag_moments,
    load_gradients,
    longest_axis,
    stretch_gradients,
)
from slipmap.models.physics.effect_sensitivity import (
    FIXED_ROWS,
    add_contact_scale,
    add_contact_slopes,
    add_spring_columns,
    advance_memory,
    advance_state,
    blade_slopes,
    empty_blocks,
    fill_force,
    fill_load_slopes,
    fill_other_slopes,
    first_blocks,
    set_body_slopes,
    store_rows,
    weigh_cells,
)
from slipmap.models.physics.kernel import pose_update
from slipmap.models.physics.kernel_tools import copy_into, evenly_dealt, joined, turn_by, turned
from slipmap.models.physics.newton import padded_cells
from slipmap.models.physics.step import (
    EXTRA_COLUMNS,
    MAX_EVALUATIONS,
    Frame,
    contact_of,
    free_momentum,
    middle_frame,
    solve_step,
    step_derivative,
    touching,
)


@compiled(inline="always")
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
    columns = n + EXTRA_COLUMNS + P if derive else 0
    load_sum = load.sum()
    body = (inertia[0], inertia[1], inertia[2], inertia[3])
    about_center = inertia[3] - (inertia[1] * inertia[1] + inertia[2] * inertia[2]) / inertia[0]
    plain = padded_cells(load, rx, ry, cell_width, smoothing[0])
    rows = np.zeros((MAX_CONTACTS, CONTACT_COLUMNS))
    forced = wrench.shape[0] > 0

    c = constants.copy()
    y = np.zeros(Y)
    copy_into(y[STATE:memory_rows], memory0)
    copy_into(y[memory_rows : memory_rows + INERTIA], inertia)
    copy_into(y[memory_rows + INERTIA :], parameters)
    out = np.zeros(BODY_OUTPUTS + 4 * blade_count)
    dout = np.zeros((BODY_OUTPUTS + 4 * blade_count, Y))
    factor = np.ones(n)
    share_of_load = np.ones_like(plain.rx)
    drag = np.zeros(n)
    drag_sums = np.zeros(4)
    loads = plain.load
    after = np.zeros(AFTER)
    own = np.zeros(max(0, E - FORCE))
    down = np.zeros((max(0, E - FORCE), Y + AFTER))
    by_load = np.zeros((3, plain.rx.shape[0]))
    by_drag = np.zeros((3, n))
    by_stretch = np.zeros((STRETCH, 3, n if with_stretch else 0))
    qxx, qxy, qyy = np.ones_like(plain.rx), np.zeros_like(plain.rx), np.ones_like(plain.rx)
    longest = 1.0
    weighted_load = np.zeros((3, n))
    G = np.zeros((3, Y))
    A = np.zeros((3, 6))
    extra = np.zeros((3, EXTRA_COLUMNS))
    dforce = np.zeros((2, 10))
    spring_A = np.zeros((3, 3))
    spring_force = np.zeros((2, 3))
    scale_g = np.zeros((3, 2))
    scale_f = np.zeros((2, 2))
    slopes = np.zeros((2, memory_rows))
    S = first_blocks(E, n, columns)
    before = np.zeros_like(S)
    F = empty_blocks(columns, 2)

    x, yy, theta = q0[0], q0[1], q0[2]
    cos, sin = math.cos(theta), math.sin(theta)
    v = (v0[0], v0[1], v0[2])
    quarter = turn_by(0.25 * h * v[2])
    past = (v, v, v)
    weights = (1.0, 0.0, 0.0)
    evaluations = sample = force_sample = 0
    failed = False
    steps = tip.shape[0] - 1

    for step in range(steps):
        c[0] = (step + 0.5) * h
        y[0], y[1], y[2] = x, yy, theta
        y[3], y[4], y[5] = v
        call_address(addresses[0], (y, c, out, dout))
        if with_cells:
            call_address(addresses[1], (y, c, rx, ry, factor, drag, qxx, qxy, qyy))
            for i in range(n):
                share_of_load[i] = max(factor[i], 0.0)
                loads[i] = load[i] * share_of_load[i]
            drag_moments(drag, rx, ry, cell_width, drag_sums)
            if with_stretch:
                longest = longest_axis(qxx, qxy, qyy)
        kappa, compliance = out[INERTIA_FACTOR], out[COMPLIANCE]
        blades = out[BODY_OUTPUTS:].reshape(blade_count, 4)
        cells = EffectCells(
            loads, plain.rx, plain.ry, plain.rho2, plain.eps2, qxx, qxy, qyy, longest, drag_sums, blades
        )
        cone = cone_of(mu, smoothing, load_sum, compliance, h)

        half_cos, half_sin = joined(quarter.cos, quarter.sin, quarter.cos, quarter.sin)
        full_cos, full_sin = joined(half_cos, half_sin, half_cos, half_sin)
        free = free_momentum(body, v, full_cos, full_sin)
        added_x, added_y, added_w = h * out[0], h * out[1], h * out[2]
        applied = Applied(0.0, 0.0, 0.0, 0.0)
        if forced:
            applied = applied_impulse(wrench[step], cos, sin, half_cos, half_sin, h)
            added_x += applied.x
            added_y += applied.y
            added_w += applied.spin
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
            frame = bent_frame(frame, bend_x, bend_y, h)
            gain = gain + abs(frame.spring_x) + abs(frame.spring_y)
            count = touching(frame, v, h, radius, size, edges, rows, gain)
        first = contact_of(rows, 0, frame, v, h, cone)
        second = contact_of(rows, 1, frame, v, h, cone)
        star = (kappa * free[0] + added_x, kappa * free[1] + added_y, kappa * free[2] + added_w)
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
        force_x, force_y = finger_impulse(first, second, impulse1, impulse2)
        force = turned(frame.cos, frame.sin, force_x / h, force_y / h)
        way = way_of(new, cos, sin, h)
        length, wx, wy = way.length, way.wx, way.wy
        next_x, next_y, next_theta = x + length * wx, yy + length * wy, theta + h * new[2]

        if E > 0:
            after[0], after[1], after[2] = next_x, next_y, next_theta
            after[3], after[4], after[5] = new
            after[6], after[7] = force
            if E > FORCE:
                call_address(addresses[3], (y, c, after, own, down))

        wants_force = force_sample < force_step.shape[0] and force_step[force_sample] == step
        if derive:
            step_derivative(
                v, new, h, scaled, cone, frame, quarter, first, second, impulse1, impulse2, A, extra, dforce
            )  # fmt: skip
            add_applied_turning(A, applied, h)
            for a in range(3):
                for k in range(INERTIA):
                    extra[a, k] *= kappa
            set_body_slopes(G, body, new, free, dout, h)
            if blade_count > 0:
                blade_slopes(blades, dout[BODY_OUTPUTS:], new, plain.eps2, h, G)
            load_gradients(cells, new, by_load)
            if with_cells:
                drag_gradients(rx, ry, new, cell_width, by_drag)
                stretch_gradients(cells, new, by_stretch)
                weigh_cells(load, factor, h, by_load, by_drag, by_stretch, weighted_load)
                call_address(addresses[2], (y, c, rx, ry, weighted_load, by_drag, by_stretch, G))
            # By the contact's stiffness: through the sum of loads and the finger's compliance.
            add_contact_scale(
                first, second, impulse1, impulse2, cone, new, h, smoothing[1], load_sum, scale_g, scale_f
            )
            if E > 0:
                last = (y[STATE], y[STATE + 1])
                add_spring_columns(
                    v, new, h, cone, frame, first, second, impulse1, impulse2, last, compliance,
                    spring_A, spring_force,
                )  # fmt: skip
            add_contact_slopes(G, A, scale_g, spring_A, dout, E > 0)
            copy_into(before, S)
            scale = (scale_g[0, 0], scale_g[1, 0], scale_g[2, 0])
            fill_load_slopes(S, by_load, share_of_load, E, h, scale)
            fill_other_slopes(S, G, E, n, columns, extra)
            inverse = (minimum.xx, minimum.xy, minimum.xw, minimum.yy, minimum.yw, minimum.ww)
            advance_state(S, G, E, inverse, pose_update(way, h), h)
            if E > 0 or wants_force:
                fill_force(
                    F, S, before, E, n, columns, frame, h, force, dforce, spring_force, scale_f, dout, slopes
                )  # fmt: skip
            if E > 0:
                advance_memory(S, before, F, down, E, n, columns)

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
                store_rows(S, before, share, FIXED_ROWS + E, dpose_out[sample])
            sample += 1
        while force_sample < force_step.shape[0] and force_step[force_sample] == step:
            force_out[force_sample, 0], force_out[force_sample, 1] = force
            if derive:
                store_rows(F, F, 1.0, 2, dforce_out[force_sample])
            force_sample += 1

        if E > 0:
            y[STATE], y[STATE + 1] = force
            for e in range(E - FORCE):
                y[STATE + FORCE + e] = own[e]
        x, yy, theta = next_x, next_y, next_theta
        cos, sin = joined(way.cos, way.sin, way.half_cos, way.half_sin)
        v = new
        quarter = way.quarter

    end_out[0], end_out[1], end_out[2] = x, yy, theta
    end_out[3], end_out[4], end_out[5] = v
    end_out[6] = -1.0 if failed else float(evaluations)


# Rollouts with effects for all models and all pushes, on all threads; `effect_kernel.py` makes one.


@compiled()
def _effect_rollout_one(  # type: ignore[no-untyped-def]
    job, load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h, tip, tip_at,
    wrench, wrench_at, q0, v0, sample_time, sample_at, delay, force_step, force_at,
    addresses, sizes, constants, parameters, memory0,
    pose_out, rate_out, force_out, dpose_out, dforce_out, end_out,
):  # fmt: skip
    pushes = h.shape[0]
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


@compiled(parallel=True)
def _all_jobs(  # type: ignore[no-untyped-def]
    address, order, load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h, tip, tip_at,
    wrench, wrench_at, q0, v0, sample_time, sample_at, delay, force_step, force_at,
    addresses, sizes, constants, parameters, memory0,
    pose_out, rate_out, force_out, dpose_out, dforce_out, end_out,
):  # fmt: skip
    for place in prange(len(order)):
        call_compiled(
            _effect_rollout_one, address,
            (
                order[place], load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h,
                tip, tip_at, wrench, wrench_at, q0, v0, sample_time, sample_at, delay, force_step, force_at,
                addresses, sizes, constants, parameters, memory0,
                pose_out, rate_out, force_out, dpose_out, dforce_out, end_out,
            ),
        )  # fmt: skip


def effect_rollout_all(*arguments: Any) -> None:
    """All models times all pushes, on all threads; arguments as in `kernel.rollout_one` and `effect_rollout`.

    Shapes: delay (K,), constants (B, CONSTANTS), parameters (K, P), rate_out (K, S, 3).
    """
    load, tip_at = arguments[0], arguments[12]
    order = evenly_dealt(np.diff(tip_at), len(load))
    _all_jobs(address_of(_effect_rollout_one, (0, *arguments)), order, *arguments)
