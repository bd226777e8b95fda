"""The Jacobian of a rollout with effects, carried from step to step.

As in `sensitivity.py` it is kept in blocks of `LANES` parameters, flat in memory, with 9 + E rows each:

    0 … 5   d(state)/d(parameter)
    6 … 8   direct derivative of the step's gradient by the parameter
    9 …     d(memory)/d(parameter), of the E entries of memory

Parameters are in the order in which they are given out: loads, m, s_x, s_y, J, finger friction, start (6),
effects. G (3, Y) is the derivative of a step's gradient by what the formulas are evaluated at
(`effect_layout.py`).
"""

from __future__ import annotations

import math

import numpy as np

from slipmap.models.physics.compiled import compiled
from slipmap.models.physics.contact import SEPARATE, SLIDE_FORWARD, STICK, springs
from slipmap.models.physics.effect_cells import (
    AFTER,
    COMPLIANCE,
    FORCE,
    INERTIA,
    INERTIA_FACTOR,
    STATE,
    STRETCH,
)
from slipmap.models.physics.kernel import advance
from slipmap.models.physics.newton import LANES
from slipmap.models.physics.step import EXTRA_COLUMNS, add_column

_DIRECT = STATE

FIXED_ROWS = _DIRECT + 3
"""Rows of a block besides those of memory, which follow them."""


@compiled(forceinline=True)
def _place(column, row, rows):  # type: ignore[no-untyped-def]
    """Where an entry is in blocks of so many rows."""
    return (column // LANES * rows + row) * LANES + column % LANES


@compiled()
def empty_blocks(columns, rows):  # type: ignore[no-untyped-def]
    """Room for so many columns."""
    return np.zeros((columns + LANES - 1) // LANES * rows * LANES)


@compiled()
def first_blocks(memory, n, columns):  # type: ignore[no-untyped-def]
    """Blocks before the first step: the state is the start's; none where no Jacobian is wanted."""
    rows = FIXED_ROWS + memory
    S = empty_blocks(columns, rows)
    if columns > 0:
        for k in range(STATE):
            S[_place(n + INERTIA + 1 + k, k, rows)] = 1.0
    return S


@compiled(forceinline=True)
def set_body_slopes(G, body, new, free, dout, h):  # type: ignore[no-untyped-def]
    """Set G to what the wrench and the inertia factor do to the gradient.

    Args:
        G: (3, Y) result.
        body: m, s_x, s_y, J without the inertia factor.
        new: twist after the step.
        free: momentum of the free motion.
        dout: (BODY_OUTPUTS + …, Y) derivatives of the body formulas.
        h: step, s.
    """
    momentum = (
        body[0] * new[0] - body[2] * new[2] - free[0],
        body[0] * new[1] + body[1] * new[2] - free[1],
        body[1] * new[1] - body[2] * new[0] + body[3] * new[2] - free[2],
    )
    for a in range(3):
        for k in range(G.shape[1]):
            G[a, k] = momentum[a] * dout[INERTIA_FACTOR, k] - h * dout[a, k]


@compiled(forceinline=True)
def weigh_cells(load, factor, h, by_load, by_drag, by_stretch, weighted_load):  # type: ignore[no-untyped-def]
    """What friction factors, drags and Q of the cells do to the gradient: by_drag (3, n) and by_stretch (3,
    3, n or none) in place, weighted_load (3, n) from by_load, zero where a factor was cut at 0."""
    for i in range(load.shape[0]):
        share = h * load[i] if factor[i] > 0.0 else 0.0
        for a in range(3):
            weighted_load[a, i] = share * by_load[a, i]
            by_drag[a, i] *= h
    for q in range(STRETCH):
        for a in range(3):
            for i in range(by_stretch.shape[2]):
                by_stretch[q, a, i] *= h


@compiled(forceinline=True)
def add_contact_slopes(G, A, scale_g, spring_A, dout, bends):  # type: ignore[no-untyped-def]
    """Add what the state before the step does without effects, the finger's compliance, and the last force.

    Args:
        G: (3, Y) changed in place.
        A: (3, 6) see `step_derivative`.
        scale_g: (3, 2) see `add_contact_scale`.
        spring_A: (3, 3) see `add_spring_columns`.
        dout: (BODY_OUTPUTS + …, Y) derivatives of the body formulas.
        bends: whether there is a last force.
    """
    for a in range(3):
        for k in range(STATE):
            G[a, k] += A[a, k]
    for a in range(3):
        for k in range(G.shape[1]):
            G[a, k] += scale_g[a, 1] * dout[COMPLIANCE, k]
    if bends:
        for a in range(3):
            G[a, STATE] += spring_A[a, 0]
            G[a, STATE + 1] += spring_A[a, 1]
            for k in range(G.shape[1]):
                G[a, k] += spring_A[a, 2] * dout[COMPLIANCE, k]


@compiled(fastmath={"contract"})
def fill_load_slopes(S, by_load, share, memory, h, scale):  # type: ignore[no-untyped-def]
    """Set the direct rows of the loads: derivative of the step's gradient by them, the state being held.

    It does so for the cells that fill up as well; `fill_other_slopes` is called afterwards.

    Args:
        S: blocks, changed in place.
        by_load: (3, …) see `load_gradients`, of cells filled up to a multiple of `LANES`.
        share: (…,) friction factors, not below 0.
        memory: E.
        h: step, s.
        scale: (3,) gradient by the sum of loads, through the contact's stiffness.
    """
    size = (FIXED_ROWS + memory) * LANES
    for b in range(share.shape[0] // LANES):
        here = slice(b * LANES, (b + 1) * LANES)
        shares = share[here]
        for a in range(3):
            row = b * size + (_DIRECT + a) * LANES
            direct, slope = S[row : row + LANES], by_load[a, here]
            for lane in range(LANES):
                direct[lane] = h * shares[lane] * slope[lane] + scale[a]


@compiled()
def fill_other_slopes(S, G, memory, n, columns, extra):  # type: ignore[no-untyped-def]
    """Set the direct rows of all other parameters.

    Args:
        S: blocks, changed in place.
        G: (3, Y) by what the formulas are evaluated at.
        memory: E.
        n: number of cells.
        columns: number of parameters.
        extra: (3, …) gradient by inertia and finger friction.
    """
    rows, inertia_at = FIXED_ROWS + memory, STATE + memory
    for a in range(3):
        row = _DIRECT + a
        for k in range(INERTIA):
            S[_place(n + k, row, rows)] = extra[a, k] + G[a, inertia_at + k]
        S[_place(n + INERTIA, row, rows)] = extra[a, INERTIA]
        for j in range(n + INERTIA + 1, n + EXTRA_COLUMNS):
            S[_place(j, row, rows)] = 0.0
        for k in range(columns - n - EXTRA_COLUMNS):
            S[_place(n + EXTRA_COLUMNS + k, row, rows)] = G[a, inertia_at + INERTIA + k]


@compiled(fastmath={"contract"})
def advance_state(S, G, memory, inverse, pose, h):  # type: ignore[no-untyped-def]
    """Carry the rows of the state over a step, in place; the direct rows are used up.

    Args:
        S: blocks.
        G: (3, Y) derivative of the step's gradient by state and memory, and more.
        memory: E.
        inverse: upper triangle of the inverse Hessian.
        pose: `PoseUpdate`.
        h: step, s.
    """
    A = (
        G[0, 0], G[0, 1], G[0, 2], G[0, 3], G[0, 4], G[0, 5],
        G[1, 0], G[1, 1], G[1, 2], G[1, 3], G[1, 4], G[1, 5],
        G[2, 0], G[2, 1], G[2, 2], G[2, 3], G[2, 4], G[2, 5],
    )  # fmt: skip
    size = (FIXED_ROWS + memory) * LANES
    for b in range(S.shape[0] // size):
        block = S[b * size : (b + 1) * size]
        if memory > 0:
            for a in range(3):
                _add_rows(block, _DIRECT + a, G[a], STATE, memory, block, FIXED_ROWS)
        for lane in range(LANES):
            gx = block[lane + _DIRECT * LANES]
            gy = block[lane + (_DIRECT + 1) * LANES]
            gw = block[lane + (_DIRECT + 2) * LANES]
            advance(block, lane, A, inverse, pose, h, gx, gy, gw)


@compiled(forceinline=True)
def _add_rows(target, row, slopes, first, count, source, begin):  # type: ignore[no-untyped-def]
    """Add to a row of a block the `count` rows of another, or of the same, from `begin` on, times the slopes
    from `first` on.

    The lanes have names of their own, or the compiler would write and read the row for each slope.
    """
    a = b = c = d = e = f = g = h = 0.0
    for k in range(count):
        slope = slopes[first + k]
        at = (begin + k) * LANES
        a += slope * source[at]
        b += slope * source[at + 1]
        c += slope * source[at + 2]
        d += slope * source[at + 3]
        e += slope * source[at + 4]
        f += slope * source[at + 5]
        g += slope * source[at + 6]
        h += slope * source[at + 7]
    at = row * LANES
    target[at] += a
    target[at + 1] += b
    target[at + 2] += c
    target[at + 3] += d
    target[at + 4] += e
    target[at + 5] += f
    target[at + 6] += g
    target[at + 7] += h


@compiled(fastmath={"contract"})
def fill_force(  # type: ignore[no-untyped-def]
    F, S, before, memory, n, columns, frame, h, force, dforce, spring_force, scale_f, dout, slopes
):  # fmt: skip
    """Fill F, blocks of two rows, with the Jacobian of the finger's force (world, N).

    Args:
        F: result.
        S: blocks after the step, as far as the state.
        before: blocks before it.
        memory: E.
        n: number of cells.
        columns: number of parameters.
        frame: middle frame of the step.
        h: step, s.
        force: of the finger, world, N.
        dforce: (2, 10) see `step_derivative`.
        spring_force: (2, 3) see `add_spring_columns`.
        scale_f: (2, 2) see `add_contact_scale`.
        dout: (BODY_OUTPUTS + …, Y) derivatives of the body formulas.
        slopes: (2, 6 + E) room for numbers.
    """
    size, inertia_at = (FIXED_ROWS + memory) * LANES, STATE + memory
    bends = False
    for a in range(2):
        # The compliance may depend on any of the formula's arguments.
        stiff = scale_f[a, 1] + spring_force[a, 2]
        for k in range(STATE + memory):
            slopes[a, k] = stiff * dout[COMPLIANCE, k]
            if STATE <= k < STATE + FORCE:
                slopes[a, k] += spring_force[a, k - STATE]
            bends = bends or slopes[a, k] != 0.0
        for i in range(n):
            F[_place(i, a, 2)] = scale_f[a, 0]
        for k in range(INERTIA):
            F[_place(n + k, a, 2)] = stiff * dout[COMPLIANCE, inertia_at + k]
        F[_place(n + INERTIA, a, 2)] = dforce[a, 9]
        for j in range(n + INERTIA + 1, n + EXTRA_COLUMNS):
            F[_place(j, a, 2)] = 0.0
        for k in range(columns - n - EXTRA_COLUMNS):
            F[_place(n + EXTRA_COLUMNS + k, a, 2)] = stiff * dout[COMPLIANCE, inertia_at + INERTIA + k]
    for b in range(S.shape[0] // size):
        old, new = before[b * size : (b + 1) * size], S[b * size : (b + 1) * size]
        out = F[2 * b * LANES : 2 * (b + 1) * LANES]
        for a in range(2):
            _add_rows(out, a, dforce[a], 0, STATE, old, 0)
            _add_rows(out, a, dforce[a], STATE, 3, new, 3)
            if bends:
                _add_rows(out, a, slopes[a], 0, STATE, old, 0)
                _add_rows(out, a, slopes[a], STATE, memory, old, FIXED_ROWS)
        for lane in range(LANES):
            px, py = out[lane], out[lane + LANES]
            turning = old[lane + 2 * LANES] + 0.5 * h * old[lane + 5 * LANES]
            out[lane] = (frame.cos * px - frame.sin * py) / h - force[1] * turning
            out[lane + LANES] = (frame.sin * px + frame.cos * py) / h + force[0] * turning


@compiled(fastmath={"contract"})
def advance_memory(S, before, F, down, memory, n, columns):  # type: ignore[no-untyped-def]
    """Rows of memory after a step, from those of state and force.

    Args:
        S: blocks, whose state has been carried over the step.
        before: blocks before the step.
        F: blocks of the force in the step, see `fill_force`.
        down: (E - FORCE, Y + AFTER) derivatives of the memory formulas.
        memory: E.
        n: number of cells.
        columns: number of parameters.
    """
    rows = FIXED_ROWS + memory
    size, inertia_at = rows * LANES, STATE + memory
    Y = down.shape[1] - AFTER
    for b in range(S.shape[0] // size):
        old, new = before[b * size : (b + 1) * size], S[b * size : (b + 1) * size]
        force = F[2 * b * LANES : 2 * (b + 1) * LANES]
        new[FIXED_ROWS * LANES :] = 0.0
        for lane in range(FORCE * LANES):
            new[FIXED_ROWS * LANES + lane] = force[lane]
        for e in range(down.shape[0]):
            row = FIXED_ROWS + FORCE + e
            _add_rows(new, row, down[e], 0, STATE, old, 0)
            _add_rows(new, row, down[e], STATE, memory, old, FIXED_ROWS)
            _add_rows(new, row, down[e], Y, STATE, new, 0)
            _add_rows(new, row, down[e], Y + STATE, FORCE, force, 0)
    for e in range(down.shape[0]):
        row = FIXED_ROWS + FORCE + e
        for k in range(INERTIA):
            S[_place(n + k, row, rows)] += down[e, inertia_at + k]
        for k in range(columns - n - EXTRA_COLUMNS):
            S[_place(n + EXTRA_COLUMNS + k, row, rows)] += down[e, inertia_at + INERTIA + k]


@compiled()
def store_rows(S, before, share, rows, out):  # type: ignore[no-untyped-def]
    """Copy the first rows of blocks into out (rows wanted, columns), at a share of the step.

    Args:
        S: blocks after the step.
        before: blocks before it.
        share: place in the step, 0 to 1.
        rows: of a block.
        out: result.
    """
    for i in range(out.shape[0]):
        for b in range((out.shape[1] + LANES - 1) // LANES):
            at = (b * rows + i) * LANES
            target = out[i, b * LANES : min(out.shape[1], (b + 1) * LANES)]
            for lane in range(target.shape[0]):
                old = before[at + lane]
                target[lane] = old + share * (S[at + lane] - old)


# Partial derivatives of a step's gradient by what effects add to it: blades, and a finger that bends.


@compiled()
def blade_slopes(blades, dblades, v, eps2, h, G):  # type: ignore[no-untyped-def]
    """Add to G (3, Y) the derivative of Σ_k h F w/φ b, with w = b·v and φ = sqrt(w² + ε²).

    Args:
        blades: (k, 4) F, b.
        dblades: (4 k, Y) their derivatives.
        v: twist after the step.
        eps2: ε².
        h: step, s.
        G: (3, Y).
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
def add_contact_scale(  # type: ignore[no-untyped-def]
    first, second, impulse1, impulse2, cone, v, h, stick_speed, load_sum, scale_g, scale_f
):  # fmt: skip
    """Derivatives of the contact's part by the sum of loads and by the finger's compliance, at fixed v⁺.

    With 1/R_n = h²/(give/s + C), s the contact's stiffening by damping, and 1/R_t = h²/(h creep + C), where
    give and creep = stick_speed / Σ f fall with the sum of loads.

    Args:
        first: nearest contact.
        second: next contact.
        impulse1: solved `Impulse` of the first.
        impulse2: the same of the second.
        cone: law of the contacts.
        v: twist after the step.
        h: step, s.
        stick_speed: see `Smoothing`, m/s.
        load_sum: Σ f, N.
        scale_g: (3, 2) result, gradient by Σ f and by C.
        scale_f: (2, 2) result, impulse on the object (middle frame) by the same.
    """
    scale_g[:, :] = 0.0
    scale_f[:, :] = 0.0
    by_creep = -cone.tangential * cone.tangential / (h * h)
    creep = stick_speed / load_sum
    for k in range(2):
        contact = first if k == 0 else second
        impulse = impulse1 if k == 0 else impulse2
        by_give = -contact.normal * contact.normal / (h * h)
        give = cone.give / contact.stiffening
        for column in range(2):
            if column == 0:
                dn, dt = -by_give * give / load_sum, -by_creep * h * creep / load_sum
            else:
                dn, dt = by_give, by_creep
            dgn, dgt = _by_stiffness(contact, impulse, cone, v, dn, dt)
            scale_g[0, column] += contact.nx * dgn + contact.ny * dgt
            scale_g[1, column] += contact.ny * dgn - contact.nx * dgt
            scale_g[2, column] += contact.nw * dgn - contact.tw * dgt
            scale_f[0, column] -= contact.nx * dgn + contact.ny * dgt
            scale_f[1, column] += contact.nx * dgt - contact.ny * dgn


@compiled()
def add_spring_columns(  # type: ignore[no-untyped-def]
    v, new, h, cone, frame, first, second, impulse1, impulse2, last, compliance, A, dforce
):  # fmt: skip
    """Derivatives by the last force (world, two columns) and by the compliance that bent the finger with it.

    The bent finger stands compliance · force off its record and would straighten within the step.

    Args:
        v: twist before the step.
        new: twist after it.
        h: step, s.
        cone: law of the contacts.
        frame: middle frame, with the finger as bent.
        first: nearest contact.
        second: next contact.
        impulse1: solved `Impulse` of the first.
        impulse2: the same of the second.
        last: last force on the object, world, N.
        compliance: C, m/N.
        A: (3, 3) result, gradient.
        dforce: (2, 3) result, impulse in the middle frame.
    """
    A[:, :] = 0.0
    dforce[:, :] = 0.0
    for k in range(2):
        contact = first if k == 0 else second
        impulse = impulse1 if k == 0 else impulse2
        if impulse.state == SEPARATE:
            continue
        common = (v, new, h, cone, frame, contact, impulse, A, dforce)
        for j in range(3):
            fx = compliance if j == 0 else (last[0] if j == 2 else 0.0)
            fy = compliance if j == 1 else (last[1] if j == 2 else 0.0)
            dx = frame.cos * fx + frame.sin * fy
            dy = frame.cos * fy - frame.sin * fx
            add_column(j, -dx, -dy, 0.0, 0.0, dx / h, dy / h, 0.0, 0.0, common)
