"""Compiled rollouts: one push of one model, step by step, with the Jacobian carried along.

`rollout.py` is the door to this file; nothing else needs to call it.

They are kept in blocks of `LANES` parameters, flat in memory, with nine rows each:

    0 … 5   d(state)/d(parameter), the state being x, y, θ (world) and v_x, v_y, omega (object frame)
    6, 7    where the parameter is a load: the cell's centre r_x, r_y
    6 … 8   where it is another: the direct derivative of the step's gradient

The loads fill the first blocks (with the cells that fill up), the other parameters, from m to the start's
omega, the last two. As a block is one piece of memory, the compiler sees that its lanes are independent and
computes them at once.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import prange

from slipmap.models.physics.around_step import (
    Applied,
    add_applied_turning,
    applied_impulse,
    best_weights,
    finger_impulse,
    way_by_spin,
    way_of,
    weighted,
)
from slipmap.models.physics.compiled import address_of, call_compiled, compiled
from slipmap.models.physics.contact import CONTACT_COLUMNS, MAX_CONTACTS, cone_of
from slipmap.models.physics.kernel_tools import copy_into, evenly_dealt, joined, turn_by, turned
from slipmap.models.physics.newton import LANES, padded_cells
from slipmap.models.physics.step import (
    EXTRA_COLUMNS,
    INERTIA_COLUMNS,
    MAX_EVALUATIONS,
    Frame,
    contact_of,
    free_momentum,
    middle_frame,
    solve_step,
    step_derivative,
    touching,
)

# The Jacobian of a rollout, carried from step to step: derivatives of the state by all parameters.


EXTRA_LANES = 16
"""Room for the parameters after the loads."""

_BLOCK = 9 * LANES


class PoseUpdate(NamedTuple):
    """Derivatives of x and y after a step by θ before it and by v⁺, world frame; those of θ are 1 and h."""

    x_theta: float
    x_vx: float
    x_vy: float
    x_omega: float
    y_theta: float
    y_vx: float
    y_vy: float
    y_omega: float


@compiled(forceinline=True)
def pose_update(way, h):  # type: ignore[no-untyped-def]
    """`PoseUpdate` of the way of a step."""
    x_omega, y_omega = way_by_spin(way, h)
    return PoseUpdate(
        -way.length * way.wy, way.length * way.cos, -way.length * way.sin, x_omega,
        way.length * way.wx, way.length * way.sin, way.length * way.cos, y_omega,
    )  # fmt: skip


@compiled()
def first_blocks(cells, first_start):  # type: ignore[no-untyped-def]
    """Blocks before the first step: only the start depends on parameters, those from `first_start` on."""
    n = cells.rx.shape[0]
    S = np.zeros((n + EXTRA_LANES) // LANES * _BLOCK)
    for i in range(n):
        at = i // LANES * _BLOCK + i % LANES
        S[at + 6 * LANES] = cells.rx[i]
        S[at + 7 * LANES] = cells.ry[i]
    for i in range(6):
        column = n + first_start + i
        S[column // LANES * _BLOCK + i * LANES + column % LANES] = 1.0
    return S


@compiled(forceinline=True)
def advance(block, lane, A, inverse, pose, h, gx, gy, gw):  # type: ignore[no-untyped-def]
    """One parameter over one step; (gx, gy, gw) is the direct derivative of the step's gradient."""
    x, y, theta = block[lane], block[lane + LANES], block[lane + 2 * LANES]
    vx, vy, omega = block[lane + 3 * LANES], block[lane + 4 * LANES], block[lane + 5 * LANES]
    gx += A[0] * x + A[1] * y + A[2] * theta + A[3] * vx + A[4] * vy + A[5] * omega
    gy += A[6] * x + A[7] * y + A[8] * theta + A[9] * vx + A[10] * vy + A[11] * omega
    gw += A[12] * x + A[13] * y + A[14] * theta + A[15] * vx + A[16] * vy + A[17] * omega
    ixx, ixy, ixw, iyy, iyw, iww = inverse
    vx = -(ixx * gx + ixy * gy + ixw * gw)
    vy = -(ixy * gx + iyy * gy + iyw * gw)
    omega = -(ixw * gx + iyw * gy + iww * gw)
    block[lane] = x + pose.x_theta * theta + pose.x_vx * vx + pose.x_vy * vy + pose.x_omega * omega
    block[lane + LANES] = y + pose.y_theta * theta + pose.y_vx * vx + pose.y_vy * vy + pose.y_omega * omega
    block[lane + 2 * LANES] = theta + h * omega
    block[lane + 3 * LANES] = vx
    block[lane + 4 * LANES] = vy
    block[lane + 5 * LANES] = omega


@compiled(fastmath={"contract"})
def propagate(S, A_matrix, extra, inverse, pose, cells, v, h, wrench):  # type: ignore[no-untyped-def]
    """Carry the blocks over one step, in place: dv⁺ = -H⁻¹ (∂g + A d(state)), then the pose.

    Args:
        S: blocks.
        A_matrix: (3, 6) d(gradient)/d(state).
        extra: (3, EXTRA_LANES) d(gradient)/d(parameters after the loads).
        inverse: upper triangle of H⁻¹.
        pose: `PoseUpdate`.
        cells: `Cells`.
        v: twist after the step.
        h: step, s.
        wrench: impulse of the contact over Σ f, about the frame's origin.
    """
    A = (
        A_matrix[0, 0], A_matrix[0, 1], A_matrix[0, 2], A_matrix[0, 3], A_matrix[0, 4], A_matrix[0, 5],
        A_matrix[1, 0], A_matrix[1, 1], A_matrix[1, 2], A_matrix[1, 3], A_matrix[1, 4], A_matrix[1, 5],
        A_matrix[2, 0], A_matrix[2, 1], A_matrix[2, 2], A_matrix[2, 3], A_matrix[2, 4], A_matrix[2, 5],
    )  # fmt: skip
    vx, vy, omega = v
    fx, fy, fw = wrench
    spin = cells.rho2 * omega
    constant = spin * omega + cells.eps2
    blocks = cells.rx.shape[0] // LANES
    for b in range(blocks):
        block = S[b * _BLOCK : (b + 1) * _BLOCK]
        for lane in range(LANES):
            x = block[lane + 6 * LANES]
            y = block[lane + 7 * LANES]
            ux = vx - omega * y
            uy = vy + omega * x
            k = h / math.sqrt(ux * ux + uy * uy + constant)
            gw = k * (x * uy - y * ux + spin) - fw
            advance(block, lane, A, inverse, pose, h, k * ux - fx, k * uy - fy, gw)
    for b in range(EXTRA_LANES // LANES):
        block = S[(blocks + b) * _BLOCK : (blocks + b + 1) * _BLOCK]
        for row in range(3):
            for lane in range(LANES):
                block[lane + (6 + row) * LANES] = extra[row, b * LANES + lane]
        for lane in range(LANES):
            gx, gy, gw = block[lane + 6 * LANES], block[lane + 7 * LANES], block[lane + 8 * LANES]
            advance(block, lane, A, inverse, pose, h, gx, gy, gw)


@compiled()
def store_pose(S, before, share, n, out, sample):  # type: ignore[no-untyped-def]
    """Write d(pose)/d(parameters) at the place `share` (0 to 1) of a step into row `sample` of out (S, 3, P).

    Args:
        S: blocks after the step.
        before: blocks before the step; not read where share is 1.
        share: place in the step.
        n: number of loads.
        out: result.
        sample: row of it.
    """
    extra_at = (n + LANES - 1) // LANES * _BLOCK
    for i in range(3):
        row = out[sample, i]
        _store_row(S, before, share, i * LANES, row[:n])
        _store_row(S, before, share, extra_at + i * LANES, row[n:])


@compiled(forceinline=True)
def _store_row(S, before, share, at, out):  # type: ignore[no-untyped-def]
    """Copy one row of as many blocks as `out` holds, the first one at `at`."""
    full = out.shape[0] // LANES
    for b in range(full + 1):
        end = min(out.shape[0], (b + 1) * LANES)
        target = out[b * LANES : end]
        new = S[at + b * _BLOCK : at + b * _BLOCK + LANES]
        old = before[at + b * _BLOCK : at + b * _BLOCK + LANES]
        if b < full:
            for lane in range(LANES):
                target[lane] = new[lane] if share == 1.0 else old[lane] + share * (new[lane] - old[lane])
        else:
            for lane in range(target.shape[0]):
                target[lane] = new[lane] if share == 1.0 else old[lane] + share * (new[lane] - old[lane])


@compiled()
def store_force(S, before, n, frame, h, force, wrench, dforce, out, sample):  # type: ignore[no-untyped-def]
    """Write d(force)/d(parameters) of a step into row `sample` of out (T, 2, P).

    Args:
        S: blocks after the step.
        before: blocks before the step.
        n: number of loads.
        frame: middle frame of the step.
        h: step, s.
        force: impulse of the finger, world frame, N s.
        wrench: impulse over Σ f in the middle frame.
        dforce: (2, 10), see `step_derivative`.
        out: result.
        sample: row of it.
    """
    extra_at = (n + LANES - 1) // LANES * LANES
    for j in range(out.shape[2]):
        column = j if j < n else extra_at + j - n
        at = column // LANES * _BLOCK + column % LANES
        px = 0.0
        py = 0.0
        if j < n:
            px, py = wrench[0], wrench[1]
        elif j == n + 4:
            px, py = dforce[0, 9], dforce[1, 9]
        for i in range(6):
            px += dforce[0, i] * before[at + i * LANES]
            py += dforce[1, i] * before[at + i * LANES]
        for i in range(3):
            px += dforce[0, 6 + i] * S[at + (3 + i) * LANES]
            py += dforce[1, 6 + i] * S[at + (3 + i) * LANES]
        turning = before[at + 2 * LANES] + 0.5 * h * before[at + 5 * LANES]
        out[sample, 0, j] = (frame.cos * px - frame.sin * py - force[1] * turning) / h
        out[sample, 1, j] = (frame.sin * px + frame.cos * py + force[0] * turning) / h


@compiled(inline="always")
def rollout(  # type: ignore[no-untyped-def]
    load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h, tip, wrench, q0, v0,
    sample_step, sample_fraction, force_step, pose_out, force_out, dpose_out, dforce_out, end_out,
):  # fmt: skip
    """One push of one model.

    Args:
        load: (n,) friction loads, N.
        rx: (n,) cell centres x, m.
        ry: (n,) cell centres y, m.
        inertia: (4,) m, s_x, s_y, J.
        mu: finger friction.
        cell_width: w, m.
        edges: (E, 4) outline.
        radius: finger radius, m.
        size: largest distance of an outline corner from the object frame's origin, m.
        smoothing: (4,) slip speed ε, stick_speed, penetration, relaxation.
        h: step, s.
        tip: (N + 1, 2) finger centre at the ends of the steps, world, m; NaN rows mean no finger.
        wrench: (N, 5) or (0, 5): force (world, N), its point (object frame, m) and a torque (N m).
        q0: (3,) first pose, world.
        v0: (3,) first twist, object frame.
        sample_step: (S,) ascending steps in whose course a pose is wanted.
        sample_fraction: (S,) place in that step, 0 to 1.
        force_step: (T,) ascending steps whose contact force is wanted.
        pose_out: (S, 3) result, world pose.
        force_out: (T, 2) result, force of the finger on the object, world, N.
        dpose_out: (S, 3, P) result, or an array with P = 0 for none.
        dforce_out: (T, 2, P) result, or P = 0.
        end_out: (7,) result: last pose, last twist (object frame), and the number of evaluations, negative
            if a step did not converge.
    """
    n = load.shape[0]
    derive = dpose_out.shape[2] > 0
    cells = padded_cells(load, rx, ry, cell_width, smoothing[0])
    load_sum = load.sum()
    cone = cone_of(mu, smoothing, load_sum, 0.0, h)
    body = (inertia[0], inertia[1], inertia[2], inertia[3])
    rows = np.zeros((MAX_CONTACTS, CONTACT_COLUMNS))
    forced = wrench.shape[0] > 0
    about_center = inertia[3] - (inertia[1] * inertia[1] + inertia[2] * inertia[2]) / inertia[0]

    A = np.zeros((3, 6))
    extra = np.zeros((3, EXTRA_LANES))
    dforce = np.zeros((2, 10))
    S = first_blocks(cells, INERTIA_COLUMNS + 1) if derive else np.zeros(0)
    before = np.zeros_like(S)

    x, y, theta = q0[0], q0[1], q0[2]
    cos, sin = math.cos(theta), math.sin(theta)
    v = (v0[0], v0[1], v0[2])
    quarter = turn_by(0.25 * h * v[2])
    past = (v, v, v)
    weights = (1.0, 0.0, 0.0)
    evaluations = 0
    failed = False
    sample = 0
    force_sample = 0

    for step in range(tip.shape[0] - 1):
        half_cos, half_sin = joined(quarter.cos, quarter.sin, quarter.cos, quarter.sin)
        full_cos, full_sin = joined(half_cos, half_sin, half_cos, half_sin)
        star_x, star_y, star_w = free_momentum(body, v, full_cos, full_sin)
        applied = Applied(0.0, 0.0, 0.0, 0.0)
        gain = 0.0
        if forced:
            applied = applied_impulse(wrench[step], cos, sin, half_cos, half_sin, h)
            star_x += applied.x
            star_y += applied.y
            star_w += applied.spin
            gain = math.hypot(applied.x, applied.y) / body[0] + size * abs(applied.spin) / about_center
        count = 0
        frame = Frame(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        tip0 = (tip[step, 0], tip[step, 1])
        tip1 = (tip[step + 1, 0], tip[step + 1, 1])
        if not math.isnan(tip0[0]) and not math.isnan(tip1[0]):
            frame = middle_frame(x, y, cos, sin, quarter, v, h, tip0, tip1)
            count = touching(frame, v, h, radius, size, edges, rows, gain)
        first = contact_of(rows, 0, frame, v, h, cone)
        second = contact_of(rows, 1, frame, v, h, cone)
        star = (star_x, star_y, star_w)

        start = weighted(weights, past)
        solution = solve_step(cells, body, star, h, first, second, count, cone, size, start, derive)
        new = (solution.vx, solution.vy, solution.omega)
        weights = best_weights(new, past, size)
        past = (new, past[0], past[1])
        minimum = solution.minimum
        evaluations += solution.evaluations
        failed = failed or solution.evaluations > MAX_EVALUATIONS

        # Impulse of the finger, about the origin of the middle frame.
        impulse1, impulse2 = minimum.first, minimum.second
        force_x, force_y = finger_impulse(first, second, impulse1, impulse2)
        world_force = turned(frame.cos, frame.sin, force_x, force_y)
        way = way_of(new, cos, sin, h)
        length, wx, wy = way.length, way.wx, way.wy

        first_sample = sample
        needs_before = False
        while sample < sample_step.shape[0] and sample_step[sample] == step:
            share = sample_fraction[sample]
            pose_out[sample, 0] = x + share * length * wx
            pose_out[sample, 1] = y + share * length * wy
            pose_out[sample, 2] = theta + share * h * new[2]
            needs_before = needs_before or share < 1.0
            sample += 1
        wants_force = force_sample < force_step.shape[0] and force_step[force_sample] == step

        if derive:
            step_derivative(
                v, new, h, body, cone, frame, quarter, first, second, impulse1, impulse2, A, extra, dforce
            )  # fmt: skip
            add_applied_turning(A, applied, h)
            if needs_before or wants_force:
                copy_into(before, S)
            inverse = (minimum.xx, minimum.xy, minimum.xw, minimum.yy, minimum.yw, minimum.ww)
            moment = first.nw * impulse1.normal - first.tw * impulse1.tangential
            moment += second.nw * impulse2.normal - second.tw * impulse2.tangential
            share_of_load = (force_x / load_sum, force_y / load_sum, -moment / load_sum)
            propagate(S, A, extra, inverse, pose_update(way, h), cells, new, h, share_of_load)
            for k in range(first_sample, sample):
                store_pose(S, before, sample_fraction[k], n, dpose_out, k)

        while force_sample < force_step.shape[0] and force_step[force_sample] == step:
            force_out[force_sample, 0] = world_force[0] / h
            force_out[force_sample, 1] = world_force[1] / h
            if derive:
                store_force(
                    S, before, n, frame, h, world_force, share_of_load, dforce, dforce_out, force_sample
                )  # fmt: skip
            force_sample += 1

        x += length * wx
        y += length * wy
        theta += h * new[2]
        cos, sin = joined(way.cos, way.sin, way.half_cos, way.half_sin)
        v = new
        quarter = way.quarter

    end_out[0], end_out[1], end_out[2] = x, y, theta
    end_out[3], end_out[4], end_out[5] = v
    end_out[6] = -1.0 if failed else float(evaluations)


@compiled()
def rollout_one(  # type: ignore[no-untyped-def]
    job, load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h, tip, tip_at,
    wrench, wrench_at, q0, v0, sample_step, sample_fraction, sample_at, force_step, force_at,
    pose_out, force_out, dpose_out, dforce_out, end_out,
):  # fmt: skip
    """Job number k B + b: push b of model k.

    Arrays of pushes are joined end to end, `*_at` (B + 1,) are offsets. Shapes: load (K, n), inertia (K, 4),
    mu (K,), q0 and v0 (K, B, 3), pose_out (K, S, 3), dpose_out (K, S, 3, P), end_out (K, B, 7); the others as
    in `rollout`.
    """
    pushes = h.shape[0]
    k = job // pushes
    b = job % pushes
    s0, s1 = sample_at[b], sample_at[b + 1]
    f0, f1 = force_at[b], force_at[b + 1]
    rollout(
        load[k], rx, ry, inertia[k], mu[k], cell_width, edges, radius, size, smoothing, h[b],
        tip[tip_at[b] : tip_at[b + 1]], wrench[wrench_at[b] : wrench_at[b + 1]], q0[k, b], v0[k, b],
        sample_step[s0:s1], sample_fraction[s0:s1], force_step[f0:f1],
        pose_out[k, s0:s1], force_out[k, f0:f1], dpose_out[k, s0:s1], dforce_out[k, f0:f1], end_out[k, b],
    )  # fmt: skip


@compiled(parallel=True)
def _all_jobs(  # type: ignore[no-untyped-def]
    address, order, load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h, tip, tip_at,
    wrench, wrench_at, q0, v0, sample_step, sample_fraction, sample_at, force_step, force_at,
    pose_out, force_out, dpose_out, dforce_out, end_out,
):  # fmt: skip
    for place in prange(len(order)):
        call_compiled(
            rollout_one, address,
            (
                order[place], load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h,
                tip, tip_at, wrench, wrench_at, q0, v0, sample_step, sample_fraction, sample_at,
                force_step, force_at, pose_out, force_out, dpose_out, dforce_out, end_out,
            ),
        )  # fmt: skip


def rollout_all(*arguments: Any) -> None:
    """All models times all pushes, on all threads; arguments as in `rollout_one`, without the job."""
    load, tip_at = arguments[0], arguments[12]
    order = evenly_dealt(np.diff(tip_at), len(load))
    _all_jobs(address_of(rollout_one, (0, *arguments)), order, *arguments)


__all__ = ["EXTRA_COLUMNS", "rollout_all", "rollout_one"]
