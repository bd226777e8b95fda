"""The Jacobian of a rollout with effects, carried from step to step.

As in `kernel.py` it is kept in blocks of `LANES` parameters, flat in memory, with 9 + E rows each:

    0 … 5   d(state)/d(parameter)
    6 … 8   direct derivative of the step's gradient by the parameter
    9 …     d(memory)/d(parameter), of the E entries of memory

Parameters are in the order in which they are given out: loads, m, s_x, s_y, J, finger friction, start (6),
effects. In the functions here

    S, before    are the blocks after a step, as far as they are carried over it, and before it;
    G (3, Y)     is the derivative of the step's gradient by what formulas are evaluated at;
    dout         (BODY_OUTPUTS + …, Y) that of the body formulas;
    F            blocks of two rows, the Jacobian of the finger's force (world, N) in the step;
    down         (E - FORCE, Y + AFTER) derivatives of the memory formulas.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
from slipmap.models.physics.kernel import advance, flat
from slipmap.models.physics.newton import LANES
from slipmap.models.physics.step import EXTRA_COLUMNS, add_column, contact_change

_DIRECT = STATE

FIXED_ROWS = _DIRECT + 3
"""Rows of a block besides those of memory, which follow them."""


class Layout(NamedTuple):
    """How many parameters a Jacobian has, and of which kinds.

    Attributes:
        memory: E.
        n: number of cells.
        columns: number of parameters, 0 where no Jacobian is wanted.
    """

    memory: int
    n: int
    columns: int


class ContactSlopes(NamedTuple):
    """Derivatives of a step's gradient g (3) and of the contact's impulse f (2, middle frame) at fixed v⁺.

    Attributes:
        scale_g: (3, 2) by Σ f and by the finger's compliance, through the contact's stiffness.
        scale_f: (2, 2) the same.
        spring_g: (3, 3) by the last force (world, two columns) and by the compliance: these bend the finger.
        spring_f: (2, 3) the same.
    """

    scale_g: NDArray[np.float64]
    scale_f: NDArray[np.float64]
    spring_g: NDArray[np.float64]
    spring_f: NDArray[np.float64]


@compiled()
def no_contact_slopes():  # type: ignore[no-untyped-def]
    """`ContactSlopes` of zeros."""
    return ContactSlopes(np.zeros((3, 2)), np.zeros((2, 2)), np.zeros((3, 3)), np.zeros((2, 3)))


@compiled(forceinline=True)
def _place(column, row, rows):  # type: ignore[no-untyped-def]
    """Where an entry is in blocks of so many rows."""
    return (column // LANES * rows + row) * LANES + column % LANES


@compiled()
def empty_blocks(columns, rows):  # type: ignore[no-untyped-def]
    """Room for so many columns."""
    return np.zeros((columns + LANES - 1) // LANES * rows * LANES)


@compiled()
def first_blocks(layout):  # type: ignore[no-untyped-def]
    """Blocks before the first step: the state is the start's; none where no Jacobian is wanted."""
    rows = FIXED_ROWS + layout.memory
    S = empty_blocks(layout.columns, rows)
    if layout.columns > 0:
        for k in range(STATE):
            S[_place(layout.n + INERTIA + 1 + k, k, rows)] = 1.0
    return S


@compiled(forceinline=True)
def set_body_slopes(G, body, new, free, dout, h):  # type: ignore[no-untyped-def]
    """Set G to what the wrench and the inertia factor do to the gradient.

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


@compiled(forceinline=True)
def weigh_cells(load, factor, h, by_load, by_drag, by_stretch, weighted_load):  # type: ignore[no-untyped-def]
    """What friction factors, drags and Q of the cells do to the gradient.

    by_drag (3, n) and by_stretch (3, 3, n or none) are scaled in place; weighted_load (3, n) is set from
    by_load, to zero where a factor was cut at 0.
    """
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
def add_contact_slopes(G, A, contact, dout, bends):  # type: ignore[no-untyped-def]
    """Add to G what the state does without effects (A), the compliance, and the last force if it `bends`."""
    scale, spring = contact.scale_g, contact.spring_g
    for a in range(3):
        for k in range(STATE):
            G[a, k] += A[a, k]
    for a in range(3):
        for k in range(G.shape[1]):
            G[a, k] += scale[a, 1] * dout[COMPLIANCE, k]
    if bends:
        for a in range(3):
            G[a, STATE] += spring[a, 0]
            G[a, STATE + 1] += spring[a, 1]
            for k in range(G.shape[1]):
                G[a, k] += spring[a, 2] * dout[COMPLIANCE, k]


@compiled(fastmath={"contract"})
def fill_load_slopes(S, layout, by_load, share, h, scale_g):  # type: ignore[no-untyped-def]
    """Set the direct rows of the loads: derivative of the step's gradient by them, the state being held.

    It does so for the cells that fill up as well; `fill_other_slopes` is called afterwards. by_load (3, …) is
    that of `load_gradients`, share (…,) the friction factors, not below 0.
    """
    size = (FIXED_ROWS + layout.memory) * LANES
    scale = (scale_g[0, 0], scale_g[1, 0], scale_g[2, 0])
    for b in range(share.shape[0] // LANES):
        here = slice(b * LANES, (b + 1) * LANES)
        shares = share[here]
        for a in range(3):
            row = b * size + (_DIRECT + a) * LANES
            direct, slope = S[row : row + LANES], by_load[a, here]
            for lane in range(LANES):
                direct[lane] = h * shares[lane] * slope[lane] + scale[a]


@compiled()
def fill_other_slopes(S, layout, G, extra):  # type: ignore[no-untyped-def]
    """Set the direct rows of all other parameters; `extra` is that of `Slopes`."""
    n = layout.n
    rows, inertia_at = FIXED_ROWS + layout.memory, STATE + layout.memory
    for a in range(3):
        row = _DIRECT + a
        for k in range(INERTIA):
            S[_place(n + k, row, rows)] = extra[a, k] + G[a, inertia_at + k]
        S[_place(n + INERTIA, row, rows)] = extra[a, INERTIA]
        for j in range(n + INERTIA + 1, n + EXTRA_COLUMNS):
            S[_place(j, row, rows)] = 0.0
        for k in range(layout.columns - n - EXTRA_COLUMNS):
            S[_place(n + EXTRA_COLUMNS + k, row, rows)] = G[a, inertia_at + INERTIA + k]


@compiled(fastmath={"contract"})
def advance_state(S, layout, G, minimum, pose, h):  # type: ignore[no-untyped-def]
    """Carry the rows of the state over a step, in place; the direct rows are used up."""
    A = flat(G)
    memory = layout.memory
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
            advance(block, lane, A, minimum, pose, h, gx, gy, gw)


@compiled(forceinline=True)
def _add_rows(target, row, slopes, first, count, source, begin):  # type: ignore[no-untyped-def]
    """Add to a row of a block `count` rows of a source from `begin` on, times the slopes from `first` on.

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
def fill_force(F, S, before, layout, step, force, dforce, contact, dout):  # type: ignore[no-untyped-def]
    """Fill F; `force` is that of the finger (world, N), `dforce` that of `Slopes`."""
    memory, n, columns = layout
    frame, h, scale_f, spring_f = step.frame, step.h, contact.scale_f, contact.spring_f
    size, inertia_at = (FIXED_ROWS + memory) * LANES, STATE + memory
    slopes = np.zeros((2, STATE + memory))
    bends = False
    for a in range(2):
        # The compliance may depend on any of the formula's arguments.
        stiff = scale_f[a, 1] + spring_f[a, 2]
        for k in range(STATE + memory):
            slopes[a, k] = stiff * dout[COMPLIANCE, k]
            if STATE <= k < STATE + FORCE:
                slopes[a, k] += spring_f[a, k - STATE]
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
def advance_memory(S, before, F, layout, down):  # type: ignore[no-untyped-def]
    """Set the rows of memory after a step, from those of state and force."""
    memory, n, columns = layout
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
    """Copy the first rows of blocks into out (rows wanted, columns), at the place `share` of the step."""
    for i in range(out.shape[0]):
        for b in range((out.shape[1] + LANES - 1) // LANES):
            at = (b * rows + i) * LANES
            target = out[i, b * LANES : min(out.shape[1], (b + 1) * LANES)]
            for lane in range(target.shape[0]):
                old = before[at + lane]
                target[lane] = old + share * (S[at + lane] - old)


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
def set_contact_scale(solved, stick_speed, load_sum, slopes):  # type: ignore[no-untyped-def]
    """Set the derivatives of the contact's part by the sum of loads and by the finger's compliance.

    With 1/R_n = h²/(give/s + C), s the contact's stiffening by damping, and 1/R_t = h²/(h creep + C), where
    give and creep = stick_speed / Σ f fall with the sum of loads.
    """
    h, cone, scale_g, scale_f = solved.h, solved.cone, slopes.scale_g, slopes.scale_f
    scale_g[:, :] = 0.0
    scale_f[:, :] = 0.0
    by_creep = -cone.tangential * cone.tangential / (h * h)
    creep = stick_speed / load_sum
    for k in range(2):
        contact = solved.first if k == 0 else solved.second
        impulse = solved.impulse1 if k == 0 else solved.impulse2
        by_give = -contact.normal * contact.normal / (h * h)
        give = cone.give / contact.stiffening
        for column in range(2):
            if column == 0:
                dn, dt = -by_give * give / load_sum, -by_creep * h * creep / load_sum
            else:
                dn, dt = by_give, by_creep
            dgn, dgt = _by_stiffness(contact, impulse, cone, solved.new, dn, dt)
            scale_g[0, column] += contact.nx * dgn + contact.ny * dgt
            scale_g[1, column] += contact.ny * dgn - contact.nx * dgt
            scale_g[2, column] += contact.nw * dgn - contact.tw * dgt
            scale_f[0, column] -= contact.nx * dgn + contact.ny * dgt
            scale_f[1, column] += contact.nx * dgt - contact.ny * dgn


@compiled()
def set_spring_columns(solved, last, slopes):  # type: ignore[no-untyped-def]
    """Set the derivatives by the last force and by the compliance that bent the finger with it.

    The bent finger stands compliance · force off its record and would straighten within the step. `last` is
    the last force on the object, world, N.
    """
    h, frame, compliance = solved.h, solved.frame, solved.cone.compliance
    slopes.spring_g[:, :] = 0.0
    slopes.spring_f[:, :] = 0.0
    none = (0.0, 0.0)
    for k in range(2):
        contact = solved.first if k == 0 else solved.second
        impulse = solved.impulse1 if k == 0 else solved.impulse2
        if impulse.state == SEPARATE:
            continue
        change = contact_change(solved, contact, impulse, slopes.spring_g, slopes.spring_f)
        for j in range(3):
            fx = compliance if j == 0 else (last[0] if j == 2 else 0.0)
            fy = compliance if j == 1 else (last[1] if j == 2 else 0.0)
            dx = frame.cos * fx + frame.sin * fy
            dy = frame.cos * fy - frame.sin * fx
            add_column(j, (-dx, -dy), none, (dx / h, dy / h), none, change)
