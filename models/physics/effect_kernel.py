"""Compiled rollouts of the model with effects, whose formulas are called by their address.

The step is that of `kernel.py` with more terms: `EffectCells`, a wrench, scaled inertia, a finger that bends.
What the formulas are evaluated at is in `effect_cells.py`, the Jacobian in `effect_sensitivity.py`.
`slipmap.models.effects.formulas` writes the formulas, `EffectSlider` calls this file.
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
    take_step,
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
    Layout,
    add_contact_slopes,
    advance_memory,
    advance_state,
    blade_slopes,
    empty_blocks,
    fill_force,
    fill_load_slopes,
    fill_other_slopes,
    first_blocks,
    no_contact_slopes,
    set_body_slopes,
    set_contact_scale,
    set_spring_columns,
    store_rows,
    weigh_cells,
)
from slipmap.models.physics.kernel import pose_update
from slipmap.models.physics.kernel_arguments import Common, Formulas, JoinedPushes, ReducedMaps, Results
from slipmap.models.physics.kernel_tools import (
    copy_into,
    evenly_dealt,
    joined,
    push_of,
    results_of,
    turn_by,
    turned,
)
from slipmap.models.physics.newton import padded_cells
from slipmap.models.physics.step import (
    EXTRA_COLUMNS,
    MAX_EVALUATIONS,
    Frame,
    Slopes,
    Step,
    contact_of,
    free_momentum,
    middle_frame,
    step_derivative,
    touching,
)


@compiled()
def _effect_rollout_one(job, common, maps, pushes, formulas, results):  # type: ignore[no-untyped-def]
    """Job number k B + b, as in `kernel.rollout_one`, with the fields of `Formulas`."""
    common, maps = Common(*common), ReducedMaps(*maps)
    pushes, results = JoinedPushes(*pushes), Results(*results)
    formulas = Formulas(*formulas)
    k, b = job // len(pushes.h), job % len(pushes.h)
    push, result = push_of(pushes, k, b), results_of(results, pushes, k, b)
    load, inertia, smoothing, size = maps.load[k], maps.inertia[k], common.smoothing, common.size
    rx, ry, h, tip, wrench, force_step = common.rx, common.ry, push.h, push.tip, push.wrench, push.force_step
    addresses, sizes, parameters = formulas.addresses, formulas.sizes, formulas.parameters[k]

    n = load.shape[0]
    E, P, blade_count, with_cells, with_stretch = sizes[0], sizes[1], sizes[2], sizes[3], sizes[4]
    derive = result.d_poses.shape[2] > 0
    memory_rows = STATE + E
    Y = memory_rows + INERTIA + P
    layout = Layout(E, n, n + EXTRA_COLUMNS + P if derive else 0)
    load_sum = load.sum()
    body = (inertia[0], inertia[1], inertia[2], inertia[3])
    about_center = inertia[3] - (inertia[1] * inertia[1] + inertia[2] * inertia[2]) / inertia[0]
    plain = padded_cells(load, rx, ry, common.cell_width, smoothing[0])
    rows = np.zeros((MAX_CONTACTS, CONTACT_COLUMNS))
    forced = wrench.shape[0] > 0

    c = formulas.constants[b].copy()
    y = np.zeros(Y)  # of which the memory begins at 0
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
    slopes = Slopes(np.zeros((3, 6)), np.zeros((3, EXTRA_COLUMNS)), np.zeros((2, 10)))
    contact_slopes = no_contact_slopes()
    S = first_blocks(layout)
    before = np.zeros_like(S)
    F = empty_blocks(layout.columns, 2)

    q0, v0 = push.start_pose, push.start_twist
    x, yy, theta = q0[0], q0[1], q0[2]
    cos, sin = math.cos(theta), math.sin(theta)
    v = (v0[0], v0[1], v0[2])
    quarter = turn_by(0.25 * h * v[2])
    past = (v, v, v)
    weights = (1.0, 0.0, 0.0)
    evaluations = sample = force_sample = 0
    failed = False
    steps = tip.shape[0] - 1

    for number in range(steps):
        c[0] = (number + 0.5) * h
        y[0], y[1], y[2] = x, yy, theta
        y[3], y[4], y[5] = v
        call_address(addresses[0], (y, c, out, dout))
        if with_cells:
            call_address(addresses[1], (y, c, rx, ry, factor, drag, qxx, qxy, qyy))
            for i in range(n):
                share_of_load[i] = max(factor[i], 0.0)
                loads[i] = load[i] * share_of_load[i]
            drag_moments(drag, rx, ry, common.cell_width, drag_sums)
            if with_stretch:
                longest = longest_axis(qxx, qxy, qyy)
        kappa, compliance = out[INERTIA_FACTOR], out[COMPLIANCE]
        blades = out[BODY_OUTPUTS:].reshape(blade_count, 4)
        cells = EffectCells(
            loads, plain.rx, plain.ry, plain.rho2, plain.eps2, qxx, qxy, qyy, longest, drag_sums, blades
        )
        cone = cone_of(maps.mu[k], smoothing, load_sum, compliance, h)

        half_cos, half_sin = joined(quarter.cos, quarter.sin, quarter.cos, quarter.sin)
        full_cos, full_sin = joined(half_cos, half_sin, half_cos, half_sin)
        free = free_momentum(body, v, full_cos, full_sin)
        added_x, added_y, added_w = h * out[0], h * out[1], h * out[2]
        applied = Applied(0.0, 0.0, 0.0, 0.0)
        if forced:
            applied = applied_impulse(wrench[number], cos, sin, half_cos, half_sin, h)
            added_x += applied.x
            added_y += applied.y
            added_w += applied.spin
        gain = math.hypot(added_x, added_y) / body[0] + size * abs(added_w) / about_center
        count = 0
        frame = Frame(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        bend_x = bend_y = 0.0
        if E > 0:
            bend_x, bend_y = compliance * y[STATE], compliance * y[STATE + 1]
        tip0 = (tip[number, 0] - bend_x, tip[number, 1] - bend_y)
        tip1 = (tip[number + 1, 0] - bend_x, tip[number + 1, 1] - bend_y)
        if not math.isnan(tip0[0]) and not math.isnan(tip1[0]):
            frame = middle_frame(x, yy, cos, sin, quarter, v, h, tip0, tip1)
            frame = bent_frame(frame, bend_x, bend_y, h)
            gain = gain + abs(frame.spring_x) + abs(frame.spring_y)
            count = touching(frame, v, h, common, rows, gain)
        first = contact_of(rows, 0, frame, v, h, cone)
        second = contact_of(rows, 1, frame, v, h, cone)
        star = (kappa * free[0] + added_x, kappa * free[1] + added_y, kappa * free[2] + added_w)
        scaled = (kappa * body[0], kappa * body[1], kappa * body[2], kappa * body[3])
        step = Step(cells, scaled, star, h, first, second, count, cone, size, v, quarter, frame)

        taken = take_step(step, weighted(weights, past), derive, cos, sin)
        new, minimum, solved, way = taken.new, taken.minimum, taken.solved, taken.way
        weights = best_weights(new, past, size)
        past = (new, past[0], past[1])
        evaluations += taken.evaluations
        failed = failed or taken.evaluations > MAX_EVALUATIONS
        force = turned(frame.cos, frame.sin, taken.impulse_x / h, taken.impulse_y / h)
        length, wx, wy = way.length, way.wx, way.wy
        next_x, next_y, next_theta = x + length * wx, yy + length * wy, theta + h * new[2]

        if E > 0:
            after[0], after[1], after[2] = next_x, next_y, next_theta
            after[3], after[4], after[5] = new
            after[6], after[7] = force
            if E > FORCE:
                call_address(addresses[3], (y, c, after, own, down))

        wants_force = force_sample < force_step.shape[0] and force_step[force_sample] == number
        if derive:
            step_derivative(solved, slopes)
            add_applied_turning(slopes.A, applied, h)
            for a in range(3):
                for i in range(INERTIA):
                    slopes.extra[a, i] *= kappa
            set_body_slopes(G, body, new, free, dout, h)
            if blade_count > 0:
                blade_slopes(blades, dout[BODY_OUTPUTS:], new, plain.eps2, h, G)
            load_gradients(cells, new, by_load)
            if with_cells:
                drag_gradients(rx, ry, new, common.cell_width, by_drag)
                stretch_gradients(cells, new, by_stretch)
                weigh_cells(load, factor, h, by_load, by_drag, by_stretch, weighted_load)
                call_address(addresses[2], (y, c, rx, ry, weighted_load, by_drag, by_stretch, G))
            # By the contact's stiffness: through the sum of loads and the finger's compliance.
            set_contact_scale(solved, smoothing[1], load_sum, contact_slopes)
            if E > 0:
                set_spring_columns(solved, (y[STATE], y[STATE + 1]), contact_slopes)
            add_contact_slopes(G, slopes.A, contact_slopes, dout, E > 0)
            copy_into(before, S)
            fill_load_slopes(S, layout, by_load, share_of_load, h, contact_slopes.scale_g)
            fill_other_slopes(S, layout, G, slopes.extra)
            advance_state(S, layout, G, minimum, pose_update(way, h), h)
            if E > 0 or wants_force:
                fill_force(F, S, before, layout, step, force, slopes.force, contact_slopes, dout)
            if E > 0:
                advance_memory(S, before, F, layout, down)

        while sample < push.sample_time.shape[0]:
            at = push.sample_time[sample] - formulas.delay[k]
            if at > (number + 1) * h * (1.0 + 1e-12) and number + 1 < steps:
                break
            share = min(max(at / h - number, 0.0), 1.0)
            result.poses[sample, 0] = x + share * length * wx
            result.poses[sample, 1] = yy + share * length * wy
            result.poses[sample, 2] = theta + share * h * new[2]
            within = 0.0 < at < (number + 1) * h * (1.0 + 1e-9)
            result.rates[sample, 0] = length * wx / h if within else 0.0
            result.rates[sample, 1] = length * wy / h if within else 0.0
            result.rates[sample, 2] = new[2] if within else 0.0
            if derive:
                store_rows(S, before, share, FIXED_ROWS + E, result.d_poses[sample])
            sample += 1
        while force_sample < force_step.shape[0] and force_step[force_sample] == number:
            result.forces[force_sample, 0], result.forces[force_sample, 1] = force
            if derive:
                store_rows(F, F, 1.0, 2, result.d_forces[force_sample])
            force_sample += 1

        if E > 0:
            y[STATE], y[STATE + 1] = force
            for e in range(E - FORCE):
                y[STATE + FORCE + e] = own[e]
        x, yy, theta = next_x, next_y, next_theta
        cos, sin = joined(way.cos, way.sin, way.half_cos, way.half_sin)
        v = new
        quarter = way.quarter

    end = result.end
    end[0], end[1], end[2] = x, yy, theta
    end[3], end[4], end[5] = v
    end[6] = -1.0 if failed else float(evaluations)


@compiled(parallel=True)
def _all_jobs(address, order, common, maps, pushes, formulas, results):  # type: ignore[no-untyped-def]
    for place in prange(len(order)):
        arguments = (order[place], common, maps, pushes, formulas, results)
        call_compiled(_effect_rollout_one, address, arguments)


def effect_rollout_all(
    common: tuple[Any, ...],
    maps: tuple[Any, ...],
    pushes: JoinedPushes,
    formulas: Formulas,
    results: Results,
) -> None:
    """All models times all pushes, on all threads; `common` and `maps` as in `kernel.rollout_one`."""
    arguments = (common, maps, tuple(pushes), tuple(formulas), tuple(results))
    order = evenly_dealt(np.diff(pushes.tip_at), len(results.end))
    _all_jobs(address_of(_effect_rollout_one, (0, *arguments)), order, *arguments)
