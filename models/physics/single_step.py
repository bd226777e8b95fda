"""One step of the model, with or without effects, and its derivatives by everything it depends on.

Rollouts (`kernel.py`, `effect_kernel.py`) carry derivatives by parameters and start along; a single step is
for whoever steps the model from outside, and wants it differentiated by what drives it too. The state is

    x, y, θ (world), v_x, v_y, omega (object frame), the finger's last force (world, N), the effects' memory,

and the columns of its Jacobian are, in this order,

    f_1 … f_n, m, s_x, s_y, J, mu_finger, x, y, θ, v_x, v_y, omega, the effects' parameters (as in a rollout),
    last force, memory, wrench (force in the world, its point, a torque), finger before and after (world).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.around_step import (
    Applied,
    add_applied_turning,
    bent_frame,
    take_step,
    way_by_spin,
)
from slipmap.models.physics.compiled import call_address, compiled
from slipmap.models.physics.contact import CONTACT_COLUMNS, MAX_CONTACTS, SEPARATE, cone_of
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
    blade_slopes,
    no_contact_slopes,
    set_body_slopes,
    set_contact_scale,
    set_spring_columns,
    weigh_cells,
)
from slipmap.models.physics.kernel_arguments import Common, Formulas, ReducedMaps
from slipmap.models.physics.kernel_tools import add_columns, copy_into, joined, turn_by, turned
from slipmap.models.physics.newton import SPIN_RADIUS
from slipmap.models.physics.step import (
    EXTRA_COLUMNS,
    MAX_EVALUATIONS,
    Frame,
    Slopes,
    Step,
    add_column,
    contact_change,
    contact_of,
    free_momentum,
    middle_frame,
    step_derivative,
    touching,
)

INPUTS = 9
"""Columns of what drives the step: wrench (5), finger before and after the step (4)."""


class Drive(NamedTuple):
    """What drives a single step.

    Attributes:
        h: its length, s.
        tip: (2, 2) finger before and after the step, world, m; NaN for no finger.
        wrench: (5,) force (world, N), its point (object frame, m) and a torque (N m).
    """

    h: float
    tip: NDArray[np.float64]
    wrench: NDArray[np.float64]


@compiled(inline="always")
def _single_step(model, common, maps, formulas, drive, state, next_out, jacobian_out):  # type: ignore[no-untyped-def]
    """One step of a model by its number; see `single_steps`."""
    h, tip, wrench = drive
    load, inertia, smoothing, size = maps.load[model], maps.inertia[model], common.smoothing, common.size
    rx, ry, cell_width = common.rx, common.ry, common.cell_width
    addresses, sizes, constants = formulas.addresses, formulas.sizes, formulas.constants[0]
    n = load.shape[0]
    E, P, blade_count, with_cells, with_stretch = sizes[0], sizes[1], sizes[2], sizes[3], sizes[4]
    own = max(0, E - FORCE)
    after_memory = STATE + E
    Y = after_memory + INERTIA + P
    y = np.zeros(Y)
    copy_into(y[:after_memory], state[:after_memory])
    copy_into(y[after_memory : after_memory + INERTIA], inertia)
    copy_into(y[after_memory + INERTIA :], formulas.parameters[model])
    out = np.zeros(BODY_OUTPUTS + 4 * blade_count)
    dout = np.zeros((BODY_OUTPUTS + 4 * blade_count, Y))
    factor, drag, drag_sums = np.ones(n), np.zeros(n), np.zeros(4)
    loads = load.copy()
    qxx, qxy, qyy, longest = np.ones(n), np.zeros(n), np.ones(n), 1.0
    call_address(addresses[0], (y, constants, out, dout))
    if with_cells:
        call_address(addresses[1], (y, constants, rx, ry, factor, drag, qxx, qxy, qyy))
        for i in range(n):
            loads[i] = load[i] * max(factor[i], 0.0)
        drag_moments(drag, rx, ry, cell_width, drag_sums)
        if with_stretch:
            longest = longest_axis(qxx, qxy, qyy)
    kappa, compliance = out[INERTIA_FACTOR], out[COMPLIANCE]
    blades = out[BODY_OUTPUTS:].reshape(blade_count, 4)
    eps2 = smoothing[0] * smoothing[0]
    rho2 = (SPIN_RADIUS * cell_width) ** 2
    cells = EffectCells(loads, rx, ry, rho2, eps2, qxx, qxy, qyy, longest, drag_sums, blades)
    load_sum = load.sum()
    cone = cone_of(maps.mu[model], smoothing, load_sum, compliance, h)
    body = (inertia[0], inertia[1], inertia[2], inertia[3])
    about_center = inertia[3] - (inertia[1] * inertia[1] + inertia[2] * inertia[2]) / inertia[0]

    x, yy, theta = state[0], state[1], state[2]
    cos, sin = math.cos(theta), math.sin(theta)
    v = (state[3], state[4], state[5])
    quarter = turn_by(0.25 * h * v[2])
    half_cos, half_sin = joined(quarter.cos, quarter.sin, quarter.cos, quarter.sin)
    full_cos, full_sin = joined(half_cos, half_sin, half_cos, half_sin)
    free_x, free_y, free_w = free_momentum(body, v, full_cos, full_sin)
    cc, ss = joined(cos, sin, half_cos, half_sin)
    fx, fy = turned(cc, -ss, wrench[0], wrench[1])
    px, py = wrench[2], wrench[3]
    added_x, added_y = h * (out[0] + fx), h * (out[1] + fy)
    added_w = h * (out[2] + px * fy - py * fx + wrench[4])
    gain = math.hypot(added_x, added_y) / body[0] + size * abs(added_w) / about_center
    rows = np.zeros((MAX_CONTACTS, CONTACT_COLUMNS))
    count = 0
    frame = Frame(cc, ss, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    bend_x = compliance * y[STATE] if E > 0 else 0.0
    bend_y = compliance * y[STATE + 1] if E > 0 else 0.0
    if not math.isnan(tip[0, 0]) and not math.isnan(tip[1, 0]):
        tip0 = (tip[0, 0] - bend_x, tip[0, 1] - bend_y)
        tip1 = (tip[1, 0] - bend_x, tip[1, 1] - bend_y)
        frame = middle_frame(x, yy, cos, sin, quarter, v, h, tip0, tip1)
        frame = bent_frame(frame, bend_x, bend_y, h)
        gain = gain + abs(frame.spring_x) + abs(frame.spring_y)
        count = touching(frame, v, h, common, rows, gain)
    first = contact_of(rows, 0, frame, v, h, cone)
    second = contact_of(rows, 1, frame, v, h, cone)
    star = (kappa * free_x + added_x, kappa * free_y + added_y, kappa * free_w + added_w)
    scaled = (kappa * body[0], kappa * body[1], kappa * body[2], kappa * body[3])
    derive = jacobian_out.shape[1] > 0
    step = Step(cells, scaled, star, h, first, second, count, cone, size, v, quarter, frame)
    taken = take_step(step, v, derive, cos, sin)
    new, minimum, solved, way = taken.new, taken.minimum, taken.solved, taken.way
    world_x, world_y = turned(frame.cos, frame.sin, taken.impulse_x / h, taken.impulse_y / h)
    length, wx, wy = way.length, way.wx, way.wy
    next_out[0], next_out[1], next_out[2] = x + length * wx, yy + length * wy, theta + h * new[2]
    next_out[3], next_out[4], next_out[5] = new
    next_out[6], next_out[7] = world_x, world_y
    down = np.zeros((own, Y + AFTER))
    if own > 0:
        remembered = np.zeros(own)
        call_address(addresses[3], (y, constants, next_out[:AFTER].copy(), remembered, down))
        copy_into(next_out[AFTER : AFTER + own], remembered)
    failed = taken.evaluations > MAX_EVALUATIONS
    next_out[AFTER + own] = -1.0 if failed else float(taken.evaluations)
    if not derive:
        return

    # Direct derivatives of the step's gradient g and of the finger's impulse f at fixed v⁺: first by y (with
    # the state and the memory), then sorted into the columns.
    slopes = Slopes(np.zeros((3, 6)), np.zeros((3, EXTRA_COLUMNS)), np.zeros((2, 10)))
    step_derivative(solved, slopes)
    A, extra, dforce = slopes
    lever_x, lever_y = h * fx, h * fy
    add_applied_turning(A, Applied(lever_x, lever_y, -h * (px * fx + py * fy), 0.0), h)
    by_load = np.zeros((3, n))
    load_gradients(cells, new, by_load)
    G, F = np.zeros((3, Y)), np.zeros((2, Y))
    set_body_slopes(G, body, new, (free_x, free_y, free_w), dout, h)
    if blade_count > 0:
        blade_slopes(blades, dout[BODY_OUTPUTS:], new, eps2, h, G)
    if with_cells:
        by_drag, weighted_load = np.zeros((3, n)), np.zeros((3, n))
        drag_gradients(rx, ry, new, cell_width, by_drag)
        by_stretch = np.zeros((STRETCH, 3, n if with_stretch else 0))
        stretch_gradients(cells, new, by_stretch)
        weigh_cells(load, factor, h, by_load, by_drag, by_stretch, weighted_load)
        call_address(addresses[2], (y, constants, rx, ry, weighted_load, by_drag, by_stretch, G))
    contact_slopes = no_contact_slopes()
    scale_g, scale_f, spring_g, spring_f = contact_slopes
    set_contact_scale(solved, smoothing[1], load_sum, contact_slopes)
    if E > 0:
        set_spring_columns(solved, (y[STATE], y[STATE + 1]), contact_slopes)
        add_columns(G, STATE, spring_g, FORCE)
        add_columns(F, STATE, spring_f, FORCE)
    for k in range(Y):
        for a in range(3):
            G[a, k] += (scale_g[a, 1] + spring_g[a, 2]) * dout[COMPLIANCE, k]
        for a in range(2):
            F[a, k] += (scale_f[a, 1] + spring_f[a, 2]) * dout[COMPLIANCE, k]
    add_columns(G, 0, A, STATE)
    add_columns(F, 0, dforce, STATE)

    columns = n + EXTRA_COLUMNS + P + FORCE + own + INPUTS
    at_state = n + INERTIA + 1
    at_effects = n + EXTRA_COLUMNS
    at_memory = at_effects + P
    at_wrench = at_memory + FORCE + own
    at_tip = at_wrench + 5
    g, f = np.zeros((3, columns)), np.zeros((2, columns))
    place = np.zeros(Y, dtype=np.int64)
    for k in range(STATE):
        place[k] = at_state + k
    for k in range(E):
        place[STATE + k] = at_memory + k
    for k in range(INERTIA):
        place[after_memory + k] = n + k
    for k in range(P):
        place[after_memory + INERTIA + k] = at_effects + k
    for a in range(3):
        for i in range(n):
            g[a, i] = h * max(factor[i], 0.0) * by_load[a, i] + scale_g[a, 0]
        for k in range(Y):
            g[a, place[k]] = G[a, k]
        for k in range(INERTIA):
            g[a, n + k] += kappa * extra[a, k]
        g[a, n + INERTIA] = extra[a, INERTIA]
    for a in range(2):
        f[a, :n] = scale_f[a, 0]
        for k in range(Y):
            f[a, place[k]] = F[a, k]
        f[a, n + INERTIA] = dforce[a, 9]
    g[0, at_wrench], g[1, at_wrench], g[2, at_wrench] = -h * cc, h * ss, h * (px * ss + py * cc)
    g[0, at_wrench + 1], g[1, at_wrench + 1] = -h * ss, -h * cc
    g[2, at_wrench + 1] = h * (py * ss - px * cc)
    g[2, at_wrench + 2], g[2, at_wrench + 3], g[2, at_wrench + 4] = -lever_y, lever_x, -h
    tip_g, tip_f = np.zeros((3, 4)), np.zeros((2, 4))
    none = (0.0, 0.0)
    for i in range(2):
        contact = first if i == 0 else second
        impulse = minimum.first if i == 0 else minimum.second
        if impulse.state != SEPARATE:
            change = contact_change(solved, contact, impulse, tip_g, tip_f)
            c, s = frame.cos, frame.sin
            for end in range(2):
                sign = (-1.0 if end == 0 else 1.0) / h
                add_column(2 * end, (0.5 * c, -0.5 * s), (sign * c, -sign * s), none, none, change)
                add_column(2 * end + 1, (0.5 * s, 0.5 * c), (sign * s, sign * c), none, none, change)
    add_columns(g, at_tip, tip_g, INPUTS - 5)
    add_columns(f, at_tip, tip_f, INPUTS - 5)

    # Implicit function theorem: dv⁺ = -H⁻¹ dg; then the pose, the force and the memory.
    to_x, to_y = way_by_spin(way, h)
    J = jacobian_out
    for j in range(columns):
        gx, gy, gw = g[0, j], g[1, j], g[2, j]
        dvx = -(minimum.xx * gx + minimum.xy * gy + minimum.xw * gw)
        dvy = -(minimum.xy * gx + minimum.yy * gy + minimum.yw * gw)
        dw = -(minimum.xw * gx + minimum.yw * gy + minimum.ww * gw)
        dx = 1.0 if j == at_state else 0.0
        dy = 1.0 if j == at_state + 1 else 0.0
        dtheta = 1.0 if j == at_state + 2 else 0.0
        J[0, j] = dx + length * (-wy * dtheta + way.cos * dvx - way.sin * dvy) + to_x * dw
        J[1, j] = dy + length * (wx * dtheta + way.sin * dvx + way.cos * dvy) + to_y * dw
        J[2, j] = dtheta + h * dw
        J[3, j], J[4, j], J[5, j] = dvx, dvy, dw
        dfx = f[0, j] + dforce[0, 6] * dvx + dforce[0, 7] * dvy + dforce[0, 8] * dw
        dfy = f[1, j] + dforce[1, 6] * dvx + dforce[1, 7] * dvy + dforce[1, 8] * dw
        frame_turn = dtheta + (0.5 * h if j == at_state + 5 else 0.0)
        J[6, j] = (frame.cos * dfx - frame.sin * dfy) / h - world_y * frame_turn
        J[7, j] = (frame.sin * dfx + frame.cos * dfy) / h + world_x * frame_turn
    for e in range(own):
        for j in range(columns):
            J[AFTER + e, j] = 0.0
            for k in range(AFTER):
                J[AFTER + e, j] += down[e, Y + k] * J[k, j]
        for k in range(Y):
            J[AFTER + e, place[k]] += down[e, k]


@compiled()
def single_steps(common, maps, formulas, drive, state, next_out, jacobian_out):  # type: ignore[no-untyped-def]
    """One step of K models, one after the other: waking other threads takes longer than the steps.

    Args:
        common: fields of `Common`.
        maps: fields of `ReducedMaps`.
        formulas: fields of `Formulas`; its constants have one row, with the time in the middle of the step.
        drive: fields of `Drive`.
        state: (K, Z) before the step, Z = 8 + the effects' own memory.
        next_out: (K, Z + 1) result: state after the step, and the number of evaluations, negative if the step
            was not solved.
        jacobian_out: (K, Z, columns) result, or an array without columns for none.
    """
    common, maps, formulas, drive = Common(*common), ReducedMaps(*maps), Formulas(*formulas), Drive(*drive)
    for k in range(len(state)):
        _single_step(k, common, maps, formulas, drive, state[k], next_out[k], jacobian_out[k])
