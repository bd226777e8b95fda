"""Compiled rollouts: one push of one model, step by step, with the Jacobian carried along.

`rollout.py` is the door to this file; nothing else needs to call it.

The Jacobian is kept in blocks of `LANES` parameters, flat in memory, with nine rows each:

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
    take_step,
    way_by_spin,
    weighted,
)
from slipmap.models.physics.compiled import address_of, call_compiled, compiled
from slipmap.models.physics.contact import CONTACT_COLUMNS, MAX_CONTACTS, cone_of
from slipmap.models.physics.kernel_arguments import Common, JoinedPushes, ReducedMaps, Results
from slipmap.models.physics.kernel_tools import (
    copy_into,
    evenly_dealt,
    joined,
    push_of,
    results_of,
    turn_by,
    turned,
)
from slipmap.models.physics.newton import LANES, padded_cells
from slipmap.models.physics.step import (
    INERTIA_COLUMNS,
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

_EXTRA_LANES = 16  # room for the parameters after the loads
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
    S = np.zeros((n + _EXTRA_LANES) // LANES * _BLOCK)
    for i in range(n):
        at = i // LANES * _BLOCK + i % LANES
        S[at + 6 * LANES] = cells.rx[i]
        S[at + 7 * LANES] = cells.ry[i]
    for i in range(6):
        column = n + first_start + i
        S[column // LANES * _BLOCK + i * LANES + column % LANES] = 1.0
    return S


@compiled(forceinline=True)
def advance(block, lane, A, minimum, pose, h, gx, gy, gw):  # type: ignore[no-untyped-def]
    """Carry one parameter over one step; (gx, gy, gw) is the direct derivative of the step's gradient."""
    x, y, theta = block[lane], block[lane + LANES], block[lane + 2 * LANES]
    vx, vy, omega = block[lane + 3 * LANES], block[lane + 4 * LANES], block[lane + 5 * LANES]
    gx += A[0] * x + A[1] * y + A[2] * theta + A[3] * vx + A[4] * vy + A[5] * omega
    gy += A[6] * x + A[7] * y + A[8] * theta + A[9] * vx + A[10] * vy + A[11] * omega
    gw += A[12] * x + A[13] * y + A[14] * theta + A[15] * vx + A[16] * vy + A[17] * omega
    vx = -(minimum.xx * gx + minimum.xy * gy + minimum.xw * gw)
    vy = -(minimum.xy * gx + minimum.yy * gy + minimum.yw * gw)
    omega = -(minimum.xw * gx + minimum.yw * gy + minimum.ww * gw)
    block[lane] = x + pose.x_theta * theta + pose.x_vx * vx + pose.x_vy * vy + pose.x_omega * omega
    block[lane + LANES] = y + pose.y_theta * theta + pose.y_vx * vx + pose.y_vy * vy + pose.y_omega * omega
    block[lane + 2 * LANES] = theta + h * omega
    block[lane + 3 * LANES] = vx
    block[lane + 4 * LANES] = vy
    block[lane + 5 * LANES] = omega


@compiled(fastmath={"contract"})
def propagate(S, step, new, minimum, slopes, pose, wrench):  # type: ignore[no-untyped-def]
    """Carry the blocks S over one step, in place: dv⁺ = -H⁻¹ (∂g + A d(state)), then the pose.

    `wrench` is the impulse of the contact over Σ f, about the frame's origin.
    """
    A = flat(slopes.A)
    extra, cells, h = slopes.extra, step.cells, step.h
    vx, vy, omega = new
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
            advance(block, lane, A, minimum, pose, h, k * ux - fx, k * uy - fy, gw)
    for b in range(_EXTRA_LANES // LANES):
        block = S[(blocks + b) * _BLOCK : (blocks + b + 1) * _BLOCK]
        for row in range(3):
            for lane in range(LANES):
                block[lane + (6 + row) * LANES] = extra[row, b * LANES + lane]
        for lane in range(LANES):
            gx, gy, gw = block[lane + 6 * LANES], block[lane + 7 * LANES], block[lane + 8 * LANES]
            advance(block, lane, A, minimum, pose, h, gx, gy, gw)


@compiled(forceinline=True)
def flat(A):  # type: ignore[no-untyped-def]
    """The first six columns of three rows as numbers, row by row."""
    return (
        A[0, 0], A[0, 1], A[0, 2], A[0, 3], A[0, 4], A[0, 5],
        A[1, 0], A[1, 1], A[1, 2], A[1, 3], A[1, 4], A[1, 5],
        A[2, 0], A[2, 1], A[2, 2], A[2, 3], A[2, 4], A[2, 5],
    )  # fmt: skip


@compiled()
def store_pose(S, before, share, n, out):  # type: ignore[no-untyped-def]
    """Write d(pose)/d(parameters) at the place `share` (0 to 1) of a step into out (3, P).

    `before` holds the blocks before the step, and is not read where share is 1; n is the number of loads.
    """
    extra_at = (n + LANES - 1) // LANES * _BLOCK
    for i in range(3):
        _store_row(S, before, share, i * LANES, out[i, :n])
        _store_row(S, before, share, extra_at + i * LANES, out[i, n:])


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
def store_force(S, before, n, step, force, wrench, dforce, out):  # type: ignore[no-untyped-def]
    """Write d(force)/d(parameters) of a step into out (2, P).

    `force` is the impulse of the finger in the world frame, N s; `wrench` that over Σ f in the middle frame.
    """
    frame, h = step.frame, step.h
    extra_at = (n + LANES - 1) // LANES * LANES
    for j in range(out.shape[1]):
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
        out[0, j] = (frame.cos * px - frame.sin * py - force[1] * turning) / h
        out[1, j] = (frame.sin * px + frame.cos * py + force[0] * turning) / h


@compiled()
def rollout_one(job, common, maps, pushes, results):  # type: ignore[no-untyped-def]
    """Job number k B + b: push b of model k.

    Args:
        job: its number.
        common: fields of `Common`.
        maps: fields of `ReducedMaps`.
        pushes: fields of `JoinedPushes`.
        results: fields of `Results`, where those of the push are filled in.
    """
    common, maps = Common(*common), ReducedMaps(*maps)
    pushes, results = JoinedPushes(*pushes), Results(*results)
    k, b = job // len(pushes.h), job % len(pushes.h)
    push, result = push_of(pushes, k, b), results_of(results, pushes, k, b)
    load, inertia, smoothing, size = maps.load[k], maps.inertia[k], common.smoothing, common.size
    h, tip, wrench = push.h, push.tip, push.wrench
    sample_step, force_step = push.sample_step, push.force_step
    n = load.shape[0]
    derive = result.d_poses.shape[2] > 0
    cells = padded_cells(load, common.rx, common.ry, common.cell_width, smoothing[0])
    load_sum = load.sum()
    cone = cone_of(maps.mu[k], smoothing, load_sum, 0.0, h)
    body = (inertia[0], inertia[1], inertia[2], inertia[3])
    rows = np.zeros((MAX_CONTACTS, CONTACT_COLUMNS))
    forced = wrench.shape[0] > 0
    about_center = inertia[3] - (inertia[1] * inertia[1] + inertia[2] * inertia[2]) / inertia[0]

    slopes = Slopes(np.zeros((3, 6)), np.zeros((3, _EXTRA_LANES)), np.zeros((2, 10)))
    S = first_blocks(cells, INERTIA_COLUMNS + 1) if derive else np.zeros(0)
    before = np.zeros_like(S)

    q0, v0 = push.start_pose, push.start_twist
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

    for i in range(tip.shape[0] - 1):
        half_cos, half_sin = joined(quarter.cos, quarter.sin, quarter.cos, quarter.sin)
        full_cos, full_sin = joined(half_cos, half_sin, half_cos, half_sin)
        star_x, star_y, star_w = free_momentum(body, v, full_cos, full_sin)
        applied = Applied(0.0, 0.0, 0.0, 0.0)
        gain = 0.0
        if forced:
            applied = applied_impulse(wrench[i], cos, sin, half_cos, half_sin, h)
            star_x += applied.x
            star_y += applied.y
            star_w += applied.spin
            gain = math.hypot(applied.x, applied.y) / body[0] + size * abs(applied.spin) / about_center
        count = 0
        frame = Frame(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        tip0 = (tip[i, 0], tip[i, 1])
        tip1 = (tip[i + 1, 0], tip[i + 1, 1])
        if not math.isnan(tip0[0]) and not math.isnan(tip1[0]):
            frame = middle_frame(x, y, cos, sin, quarter, v, h, tip0, tip1)
            count = touching(frame, v, h, common, rows, gain)
        first = contact_of(rows, 0, frame, v, h, cone)
        second = contact_of(rows, 1, frame, v, h, cone)
        star = (star_x, star_y, star_w)
        step = Step(cells, body, star, h, first, second, count, cone, size, v, quarter, frame)

        taken = take_step(step, weighted(weights, past), derive, cos, sin)
        new, minimum, way = taken.new, taken.minimum, taken.way
        weights = best_weights(new, past, size)
        past = (new, past[0], past[1])
        evaluations += taken.evaluations
        failed = failed or taken.evaluations > MAX_EVALUATIONS
        world_force = turned(frame.cos, frame.sin, taken.impulse_x, taken.impulse_y)
        length, wx, wy = way.length, way.wx, way.wy

        first_sample = sample
        needs_before = False
        while sample < sample_step.shape[0] and sample_step[sample] == i:
            share = push.sample_fraction[sample]
            result.poses[sample, 0] = x + share * length * wx
            result.poses[sample, 1] = y + share * length * wy
            result.poses[sample, 2] = theta + share * h * new[2]
            needs_before = needs_before or share < 1.0
            sample += 1
        wants_force = force_sample < force_step.shape[0] and force_step[force_sample] == i

        if derive:
            step_derivative(taken.solved, slopes)
            add_applied_turning(slopes.A, applied, h)
            if needs_before or wants_force:
                copy_into(before, S)
            moment = first.nw * minimum.first.normal - first.tw * minimum.first.tangential
            moment += second.nw * minimum.second.normal - second.tw * minimum.second.tangential
            share_of_load = (taken.impulse_x / load_sum, taken.impulse_y / load_sum, -moment / load_sum)
            propagate(S, step, new, minimum, slopes, pose_update(way, h), share_of_load)
            for s in range(first_sample, sample):
                store_pose(S, before, push.sample_fraction[s], n, result.d_poses[s])

        while force_sample < force_step.shape[0] and force_step[force_sample] == i:
            result.forces[force_sample, 0] = world_force[0] / h
            result.forces[force_sample, 1] = world_force[1] / h
            if derive:
                store_force(
                    S,
                    before,
                    n,
                    step,
                    world_force,
                    share_of_load,
                    slopes.force,
                    result.d_forces[force_sample],
                )
            force_sample += 1

        x += length * wx
        y += length * wy
        theta += h * new[2]
        cos, sin = joined(way.cos, way.sin, way.half_cos, way.half_sin)
        v = new
        quarter = way.quarter

    end = result.end
    end[0], end[1], end[2] = x, y, theta
    end[3], end[4], end[5] = v
    end[6] = -1.0 if failed else float(evaluations)


@compiled(parallel=True)
def _all_jobs(address, order, common, maps, pushes, results):  # type: ignore[no-untyped-def]
    for place in prange(len(order)):
        call_compiled(rollout_one, address, (order[place], common, maps, pushes, results))


def rollout_all(
    common: tuple[Any, ...], maps: tuple[Any, ...], pushes: JoinedPushes, results: Results
) -> None:
    """All models times all pushes, on all threads; `common` and `maps` as in `rollout_one`."""
    arguments = (common, maps, tuple(pushes), tuple(results))
    # A single job is not worth waking the other threads.
    if results.end.size == 7:
        rollout_one(0, *arguments)
    else:
        order = evenly_dealt(np.diff(pushes.tip_at), len(results.end))
        _all_jobs(address_of(rollout_one, (0, *arguments)), order, *arguments)
