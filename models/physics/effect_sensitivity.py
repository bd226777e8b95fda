"""The Jacobian of a rollout with effects, carried from step to step.

It is kept as rows T of the state and memory over columns of parameters: loads, m, s_x, s_y, J, finger
friction, start (6), effects. G (3, Y) is the derivative of a step's gradient by what the formulas are
evaluated at (`effect_layout.py`), `direct` (3, columns) that by the parameters.
"""

from __future__ import annotations

import numpy as np

from models.physics.compiled import compiled
from models.physics.effect_layout import AFTER, FORCE, INERTIA, STATE
from models.physics.step import EXTRA_COLUMNS


@compiled()
def first_rows(memory_rows, n, columns):  # type: ignore[no-untyped-def]
    """T before the first step: the state is the start's; no columns where no Jacobian is wanted."""
    T = np.zeros((memory_rows, columns))
    if columns > 0:
        for k in range(STATE):
            T[k, n + INERTIA + 1 + k] = 1.0
    return T


@compiled(forceinline=True)
def set_body_slopes(G, body, new, free, dout, h, by_stretch, with_stretch):  # type: ignore[no-untyped-def]
    """Set G to what the wrench, the inertia factor and Q do to the gradient.

    Args:
        G: (3, Y) result.
        body: m, s_x, s_y, J without the inertia factor.
        new: twist after the step.
        free: momentum of the free motion.
        dout: (BODY_OUTPUTS + …, Y) derivatives of the body formulas.
        h: step, s.
        by_stretch: (3, 3) gradient by q_xx, q_xy, q_yy.
        with_stretch: whether Q changes.
    """
    momentum = (
        body[0] * new[0] - body[2] * new[2] - free[0],
        body[0] * new[1] + body[1] * new[2] - free[1],
        body[1] * new[1] - body[2] * new[0] + body[3] * new[2] - free[2],
    )
    for a in range(3):
        for k in range(G.shape[1]):
            G[a, k] = momentum[a] * dout[6, k] - h * dout[a, k]
        if with_stretch:
            for q in range(3):
                for k in range(G.shape[1]):
                    G[a, k] += h * by_stretch[a, q] * dout[3 + q, k]


@compiled(forceinline=True)
def weigh_cells(load, factor, h, by_load, by_drag, weighted_load):  # type: ignore[no-untyped-def]
    """What friction factors and drags of the cells do to the gradient: by_drag (3, n) in place, weighted_load
    (3, n) from by_load, zero where a factor was cut at 0."""
    for i in range(load.shape[0]):
        share = h * load[i] if factor[i] > 0.0 else 0.0
        for a in range(3):
            weighted_load[a, i] = share * by_load[a, i]
            by_drag[a, i] *= h


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
            G[a, k] += scale_g[a, 1] * dout[7, k]
    if bends:
        for a in range(3):
            G[a, STATE] += spring_A[a, 0]
            G[a, STATE + 1] += spring_A[a, 1]
            for k in range(G.shape[1]):
                G[a, k] += spring_A[a, 2] * dout[7, k]


@compiled(forceinline=True)
def fill_direct(direct, G, T, h, factor, by_load, scale_g, extra, memory_rows):  # type: ignore[no-untyped-def]
    """Derivative of the step's gradient by all parameters, through the state before the step as well.

    Args:
        direct: (3, columns) result.
        G: (3, Y) by what the formulas are evaluated at.
        T: (memory_rows, columns) Jacobian before the step.
        h: step, s.
        factor: (n,) friction factors.
        by_load: (3, n) gradient by load.
        scale_g: (3, 2) see `add_contact_scale`.
        extra: (3, …) gradient by inertia and finger friction.
        memory_rows: number of state and memory entries.
    """
    n, columns = factor.shape[0], direct.shape[1]
    for a in range(3):
        for i in range(n):
            direct[a, i] = h * max(factor[i], 0.0) * by_load[a, i] + scale_g[a, 0]
        for k in range(INERTIA):
            direct[a, n + k] = extra[a, k] + G[a, memory_rows + k]
        direct[a, n + INERTIA] = extra[a, INERTIA]
        direct[a, n + INERTIA + 1 : n + EXTRA_COLUMNS] = 0.0
        for k in range(columns - n - EXTRA_COLUMNS):
            direct[a, n + EXTRA_COLUMNS + k] = G[a, memory_rows + INERTIA + k]
        for k in range(memory_rows):
            slope = G[a, k]
            if slope != 0.0:
                for j in range(columns):
                    direct[a, j] += slope * T[k, j]


@compiled(forceinline=True)
def advance_state(T, new_T, direct, minimum, way, by_spin, h):  # type: ignore[no-untyped-def]
    """Rows of the state after a step.

    Args:
        T: Jacobian before the step.
        new_T: result.
        direct: (3, columns) see `fill_direct`.
        minimum: with the inverse Hessian.
        way: of the step.
        by_spin: see `way_by_spin`.
        h: step, s.
    """
    length, wx, wy, mid_cos, mid_sin = way.length, way.wx, way.wy, way.cos, way.sin
    ixx, ixy, ixw = minimum.xx, minimum.xy, minimum.xw
    iyy, iyw, iww = minimum.yy, minimum.yw, minimum.ww
    to_x, to_y = by_spin
    for j in range(direct.shape[1]):
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


@compiled(forceinline=True)
def advance_memory(T, new_T, down, n, memory_rows):  # type: ignore[no-untyped-def]
    """Rows of the effects' own memory after a step, from those of state and force.

    Args:
        T: Jacobian before the step.
        new_T: Jacobian after it, result.
        down: (E - FORCE, Y + AFTER) derivatives of the memory formulas.
        n: number of cells.
        memory_rows: number of state and memory entries.
    """
    columns = T.shape[1]
    Y = down.shape[1] - AFTER
    for e in range(down.shape[0]):
        target = new_T[STATE + FORCE + e]
        target[:] = 0.0
        for k in range(memory_rows):
            if down[e, k] != 0.0:
                for j in range(columns):
                    target[j] += down[e, k] * T[k, j]
        for k in range(INERTIA):
            target[n + k] += down[e, memory_rows + k]
        for k in range(columns - n - EXTRA_COLUMNS):
            target[n + EXTRA_COLUMNS + k] += down[e, memory_rows + INERTIA + k]
        for k in range(AFTER):
            if down[e, Y + k] != 0.0:
                for j in range(columns):
                    target[j] += down[e, Y + k] * new_T[k, j]


@compiled(forceinline=True)
def store_pose(T, new_T, share, out):  # type: ignore[no-untyped-def]
    """Fill out (3, columns) with the Jacobian of the pose at a share of the step."""
    for i in range(3):
        for j in range(T.shape[1]):
            out[i, j] = T[i, j] + share * (new_T[i, j] - T[i, j])


@compiled()
def force_rows(  # type: ignore[no-untyped-def]
    T, new_T, n, frame, h, force, dforce, spring_force, scale_f, dout, out, at
):  # fmt: skip
    """Write the Jacobian of the finger's force (world, N) into rows `at` and `at` + 1 of out.

    Args:
        T: Jacobian before the step.
        new_T: Jacobian after it, as far as the state.
        n: number of cells.
        frame: middle frame of the step.
        h: step, s.
        force: of the finger, world, N.
        dforce: (2, 10) see `step_derivative`.
        spring_force: (2, 3) see `add_spring_columns`.
        scale_f: (2, 2) see `add_contact_scale`.
        dout: (BODY_OUTPUTS + …, Y) derivatives of the body formulas.
        out: result.
        at: row of it.
    """
    E = T.shape[0] - STATE
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
