"""The Jacobian of a rollout, carried from step to step.

It is stored in blocks of `LANES` parameters, flat in memory, with 9 + E rows each:

    0 … 5   d(state)/d(parameter), with the state x, y, θ (world) and v_x, v_y, omega (object frame)
    6 … 8   direct derivative of the step's gradient with respect to the parameter, `Slopes`; in the plain
            friction model without memory, a load has its cell's centre r_x, r_y there instead
    9 …     d(memory)/d(parameter), of the E entries of memory: see `friction.py`

Since a block is one piece of memory, the compiler sees that its lanes are independent and vectorises over
them. Parameters are in this order, the loads padded to whole blocks:

    f_1 … f_n, m, s_x, s_y, J, mu_finger, and the start x, y, θ (world) and v_x, v_y, omega (object frame);
    the effects' parameters;  in a single step the memory before it, and its drive;
    on a table m_1 … m_n, through shifting loads only, at fixed f, m, s and J.

The blocks of masses are zero, and skipped, until a push comes near the table's rim.

In the functions here S holds the blocks after a step, as far as they are carried over it, and `before` those
before it; F holds blocks of two rows, the Jacobian of the finger's force (world, N) in the step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slipmap.models.physics.compiled import compiled
from slipmap.models.physics.friction import AFTER, FORCE, INERTIA, STATE
from slipmap.models.physics.newton import LANES
from slipmap.models.physics.step import EXTRA_COLUMNS, INERTIA_COLUMNS, way_by_spin

_DIRECT = STATE
FIXED_ROWS = _DIRECT + 3
"""Number of rows of a block before those of memory."""

_BLOCK = FIXED_ROWS * LANES

_SETTLED = 1e-40
"""Derivatives of a resting object's twist below this, in units of each parameter, count as zero."""


class Layout(NamedTuple):
    """Numbers of parameters of a Jacobian, by kind."""

    n: int  # number of loads
    others: int  # number of parameters after them; 0 if no Jacobian is wanted
    memory: int  # E
    effects: int  # number of the effects' parameters
    masses: int  # number of masses, 0 or n


@compiled(forceinline=True)
def pose_update(way, h):  # type: ignore[no-untyped-def]
    """Derivatives of x, then y after a step, in θ before it and v⁺, world; those of θ are 1 and h."""
    x_omega, y_omega = way_by_spin(way, h)
    return (
        -way.length * way.wy, way.length * way.cos, -way.length * way.sin, x_omega,
        way.length * way.wx, way.length * way.sin, way.length * way.cos, y_omega,
    )  # fmt: skip


@compiled(forceinline=True)
def padded(count):  # type: ignore[no-untyped-def]
    """The count rounded up to whole blocks."""
    return (count + LANES - 1) // LANES * LANES


@compiled(forceinline=True)
def _place(layout, k, row, rows):  # type: ignore[no-untyped-def]
    """Offset of an entry of the k-th parameter after the loads, in blocks of `rows` rows."""
    return ((padded(layout.n) + k) // LANES * rows + row) * LANES + k % LANES


@compiled()
def empty_blocks(layout, rows):  # type: ignore[no-untyped-def]
    """Blocks of zeros for the parameters of a `Layout`."""
    size = padded(layout.n) + padded(layout.others) + padded(layout.masses) if layout.others > 0 else 0
    return np.zeros(size * rows)


@compiled(forceinline=True)
def set_places(S, layout, rx, ry):  # type: ignore[no-untyped-def]
    """Write the cells' centres into the direct rows of the loads."""
    rows = FIXED_ROWS + layout.memory
    for i in range(layout.n):
        at = i // LANES * rows * LANES + i % LANES
        S[at + _DIRECT * LANES], S[at + (_DIRECT + 1) * LANES] = rx[i], ry[i]


@compiled()
def first_blocks(layout, rx, ry):  # type: ignore[no-untyped-def]
    """Blocks before the first step: the state depends on the start, memory on itself in a single step."""
    rows = FIXED_ROWS + layout.memory
    S = empty_blocks(layout, rows)
    if layout.others == 0:
        return S
    set_places(S, layout, rx, ry)
    for i in range(STATE):
        S[_place(layout, INERTIA_COLUMNS + 1 + i, i, rows)] = 1.0
    given = EXTRA_COLUMNS + layout.effects
    if layout.others > given:
        for e in range(layout.memory):
            S[_place(layout, given + e, FIXED_ROWS + e, rows)] = 1.0
    return S


@compiled(forceinline=True)
def flat(A):  # type: ignore[no-untyped-def]
    """The first six columns of three rows as a tuple, row by row."""
    return (
        A[0, 0], A[0, 1], A[0, 2], A[0, 3], A[0, 4], A[0, 5],
        A[1, 0], A[1, 1], A[1, 2], A[1, 3], A[1, 4], A[1, 5],
        A[2, 0], A[2, 1], A[2, 2], A[2, 3], A[2, 4], A[2, 5],
    )  # fmt: skip


@compiled(forceinline=True)
def _advance(block, lane, A, minimum, pose, h, gx, gy, gw):  # type: ignore[no-untyped-def]
    """Carry one parameter over one step: dv⁺ = -H⁻¹ (∂g + A d(state)), then the pose.

    (gx, gy, gw) is the direct derivative of the step's gradient.
    """
    x, y, theta = block[lane], block[lane + LANES], block[lane + 2 * LANES]
    vx, vy, omega = block[lane + 3 * LANES], block[lane + 4 * LANES], block[lane + 5 * LANES]
    gx += A[0] * x + A[1] * y + A[2] * theta + A[3] * vx + A[4] * vy + A[5] * omega
    gy += A[6] * x + A[7] * y + A[8] * theta + A[9] * vx + A[10] * vy + A[11] * omega
    gw += A[12] * x + A[13] * y + A[14] * theta + A[15] * vx + A[16] * vy + A[17] * omega
    vx = -(minimum.xx * gx + minimum.xy * gy + minimum.xw * gw)
    vy = -(minimum.xy * gx + minimum.yy * gy + minimum.yw * gw)
    omega = -(minimum.xw * gx + minimum.yw * gy + minimum.ww * gw)
    block[lane] = x + pose[0] * theta + pose[1] * vx + pose[2] * vy + pose[3] * omega
    block[lane + LANES] = y + pose[4] * theta + pose[5] * vx + pose[6] * vy + pose[7] * omega
    block[lane + 2 * LANES] = theta + h * omega
    block[lane + 3 * LANES] = vx
    block[lane + 4 * LANES] = vy
    block[lane + 5 * LANES] = omega


@compiled(fastmath={"contract"})
def carry_plain_loads(S, cells, new, h, state, minimum, pose):  # type: ignore[no-untyped-def]
    """Carry the blocks of loads that hold r_x and r_y, in place; `state` is `Slopes.state`."""
    A = flat(state)
    vx, vy, omega = new
    last = state.shape[1] - 1
    fx, fy, fw = state[0, last], state[1, last], state[2, last]
    spin = cells.rho2 * omega
    constant = spin * omega + cells.eps2
    for b in range(cells.rx.shape[0] // LANES):
        block = S[b * _BLOCK : (b + 1) * _BLOCK]
        for lane in range(LANES):
            x = block[lane + _DIRECT * LANES]
            y = block[lane + (_DIRECT + 1) * LANES]
            ux = vx - omega * y
            uy = vy + omega * x
            k = h / math.sqrt(ux * ux + uy * uy + constant)
            gw = k * (x * uy - y * ux + spin) + fw
            _advance(block, lane, A, minimum, pose, h, k * ux + fx, k * uy + fy, gw)


@compiled(fastmath={"contract"})
def set_load_slopes(S, layout, by_load, share, h, state):  # type: ignore[no-untyped-def]
    """Set the direct rows of the loads.

    by_load (3, n) is from `load_gradients`, share (n,) holds the friction factors, not below 0, and `state`
    is `Slopes.state`.
    """
    size = (FIXED_ROWS + layout.memory) * LANES
    for b in range(padded(layout.n) // LANES):
        here = slice(b * LANES, (b + 1) * LANES)
        shares = share[here]
        for a in range(3):
            row = b * size + (_DIRECT + a) * LANES
            direct, slope, by_sum = S[row : row + LANES], by_load[a, here], state[a, state.shape[1] - 1]
            for lane in range(LANES):
                direct[lane] = h * shares[lane] * slope[lane] + by_sum


@compiled(fastmath={"contract"})
def carry_direct(S, first, layout, state, minimum, pose, h):  # type: ignore[no-untyped-def]
    """Carry the blocks from `first` on in place; their direct rows must be set, and are overwritten."""
    A = flat(state)
    memory = layout.memory
    size = (FIXED_ROWS + memory) * LANES
    for b in range(first, S.shape[0] // size):
        block = S[b * size : (b + 1) * size]
        if memory > 0:
            for a in range(3):
                _add_rows(block, _DIRECT + a, state[a], STATE, memory, block, FIXED_ROWS)
        for lane in range(LANES):
            gx = block[lane + _DIRECT * LANES]
            gy = block[lane + (_DIRECT + 1) * LANES]
            gw = block[lane + (_DIRECT + 2) * LANES]
            _advance(block, lane, A, minimum, pose, h, gx, gy, gw)


@compiled()
def twist_is_settled(S, layout):  # type: ignore[no-untyped-def]
    """Whether the rows of the twist are too small to move any pose."""
    size = (FIXED_ROWS + layout.memory) * LANES
    largest = 0.0
    for b in range(S.shape[0] // size):
        for entry in range(b * size + 3 * LANES, b * size + STATE * LANES):
            largest = max(largest, abs(S[entry]))
    return largest < _SETTLED


@compiled(fastmath={"contract"})
def set_other_slopes(S, layout, other):  # type: ignore[no-untyped-def]
    """Set the direct rows of the parameters after the loads."""
    size = (FIXED_ROWS + layout.memory) * LANES
    first = padded(layout.n) // LANES
    for b in range(padded(layout.others) // LANES):
        block = S[(first + b) * size : (first + b + 1) * size]
        for row in range(3):
            for lane in range(LANES):
                block[lane + (_DIRECT + row) * LANES] = other[row, b * LANES + lane]


@compiled(forceinline=True)
def _add_rows(target, row, slopes, first, count, source, begin):  # type: ignore[no-untyped-def]
    """Add `count` rows of a source from `begin` on, times the slopes from `first` on, to a row of a block.

    Each lane has a variable of its own; otherwise the compiler would write and read the row for each slope.
    """
    a = b = c = d = e = f = g = h = 0.0
    for k in range(count):
        slope = slopes[first + k]
        if slope == 0.0:
            continue
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
def fill_force(F, S, before, layout, slopes, frame, force, h):  # type: ignore[no-untyped-def]
    """Fill F, the Jacobian of the finger's force; `force` is that force (world, N)."""
    size = (FIXED_ROWS + layout.memory) * LANES
    first = padded(layout.n) // LANES
    masses = first + padded(layout.others) // LANES
    for b in range(S.shape[0] // size):
        old, new = before[b * size : (b + 1) * size], S[b * size : (b + 1) * size]
        out = F[2 * b * LANES : 2 * (b + 1) * LANES]
        for a in range(2):
            state, by_sum = slopes.state[3 + a], slopes.state[3 + a, slopes.state.shape[1] - 1]
            for lane in range(LANES):
                at = (b - first) * LANES + lane
                direct = slopes.other[3 + a, at] if first <= b < masses else 0.0
                out[a * LANES + lane] = direct if b >= first else by_sum
            _add_rows(out, a, state, 0, STATE, old, 0)
            _add_rows(out, a, slopes.twist[a], 0, 3, new, 3)
            if layout.memory > 0:
                _add_rows(out, a, state, STATE, layout.memory, old, FIXED_ROWS)
        for lane in range(LANES):
            px, py = out[lane], out[lane + LANES]
            turning = old[lane + 2 * LANES] + 0.5 * h * old[lane + 5 * LANES]
            out[lane] = (frame.cos * px - frame.sin * py) / h - force[1] * turning
            out[lane + LANES] = (frame.sin * px + frame.cos * py) / h + force[0] * turning


@compiled(fastmath={"contract"})
def carry_memory(S, before, F, layout, down):  # type: ignore[no-untyped-def]
    """Set the rows of memory from those of state and force.

    down (E - FORCE, Y + AFTER) holds the derivatives of the memory's formulas.
    """
    memory = layout.memory
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
            S[_place(layout, k, row, rows)] += down[e, inertia_at + k]
        for k in range(layout.effects):
            S[_place(layout, EXTRA_COLUMNS + k, row, rows)] += down[e, inertia_at + INERTIA + k]


@compiled(forceinline=True)
def before_masses(S, layout):  # type: ignore[no-untyped-def]
    """Number of entries of blocks S, with as many rows as a state's, before those of the masses."""
    return (padded(layout.n) + padded(layout.others)) * (FIXED_ROWS + layout.memory)


@compiled()
def store_mass_rows(S, before, share, rows, layout, out):  # type: ignore[no-untyped-def]
    """Like `store_rows` from the first row on, for the masses only; out (wanted, n)."""
    masses_at = (padded(layout.n) + padded(layout.others)) * rows
    for i in range(out.shape[0]):
        _store_row(S, before, share, rows, masses_at + i * LANES, out[i])


@compiled()
def store_rows(S, before, share, rows, first, n, out):  # type: ignore[no-untyped-def]
    """Write rows of blocks with `rows` rows each, from row `first` on, into out (wanted, parameters).

    They are interpolated to the fraction `share` (0 to 1) of a step; at 1, `before` is not read. n is the
    number of loads.
    """
    others_at = padded(n) * rows
    for i in range(out.shape[0]):
        row = (first + i) * LANES
        _store_row(S, before, share, rows, row, out[i, :n])
        _store_row(S, before, share, rows, others_at + row, out[i, n:])


@compiled()
def add_rows(F, part, begins, rows, n, out):  # type: ignore[no-untyped-def]
    """Add a part of the rows of blocks with `rows` rows each to out (rows, parameters), or set out to it
    where a sum begins; n is the number of loads."""
    others_at = padded(n) * rows
    for i in range(out.shape[0]):
        if begins:
            out[i] = 0.0
        _add_row(F, part, rows, i * LANES, out[i, :n])
        _add_row(F, part, rows, others_at + i * LANES, out[i, n:])


@compiled(forceinline=True)
def add_mass_rows(F, part, rows, layout, out):  # type: ignore[no-untyped-def]
    """Like `add_rows`, for the masses only; out (rows, n)."""
    masses_at = (padded(layout.n) + padded(layout.others)) * rows
    for i in range(out.shape[0]):
        _add_row(F, part, rows, masses_at + i * LANES, out[i])


@compiled(forceinline=True)
def _add_row(F, part, rows, at, out):  # type: ignore[no-untyped-def]
    """Add a part of one row of as many blocks as `out` spans, starting at `at`."""
    full = out.shape[0] // LANES
    for b in range(full + 1):
        target = out[b * LANES : min(out.shape[0], (b + 1) * LANES)]
        begin = at + b * rows * LANES
        source = F[begin : begin + LANES]
        if b < full:
            for lane in range(LANES):
                target[lane] += part * source[lane]
        else:
            for lane in range(target.shape[0]):
                target[lane] += part * source[lane]


@compiled(forceinline=True)
def _store_row(S, before, share, rows, at, out):  # type: ignore[no-untyped-def]
    """Copy one row of as many blocks as `out` spans, starting at `at`."""
    full = out.shape[0] // LANES
    for b in range(full + 1):
        end = min(out.shape[0], (b + 1) * LANES)
        target = out[b * LANES : end]
        begin = at + b * rows * LANES
        new = S[begin : begin + LANES]
        old = before[begin : begin + LANES]
        if b < full:
            for lane in range(LANES):
                target[lane] = new[lane] if share == 1.0 else old[lane] + share * (new[lane] - old[lane])
        else:
            for lane in range(target.shape[0]):
                target[lane] = new[lane] if share == 1.0 else old[lane] + share * (new[lane] - old[lane])
