"""The Jacobian of a rollout, carried from step to step: derivatives of the state by all parameters.

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
from typing import NamedTuple

import numpy as np

from models.physics.around_step import way_by_spin
from models.physics.compiled import compiled
from models.physics.friction import LANES

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
