"""Compiled rollouts: one push of one model, step by step, with the Jacobian carried along.

`rollout.py` is the door to this file; nothing else needs to call it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import prange

from models.physics.addresses import address_of, call_compiled
from models.physics.around_step import (
    Applied,
    add_applied_turning,
    applied_impulse,
    finger_impulse,
    way_of,
)
from models.physics.arrays import copy_into
from models.physics.compiled import compiled
from models.physics.contact import CONTACT_COLUMNS, MAX_CONTACTS, cone_of
from models.physics.friction import padded_cells
from models.physics.job_order import evenly_dealt
from models.physics.prediction import best_weights, weighted
from models.physics.sensitivity import (
    EXTRA_LANES,
    first_blocks,
    pose_update,
    propagate,
    store_force,
    store_pose,
)
from models.physics.step import (
    EXTRA_COLUMNS,
    INERTIA_COLUMNS,
    MAX_EVALUATIONS,
    Frame,
    contact_of,
    free_momentum,
    middle_frame,
    solve_step,
    touching,
)
from models.physics.step_derivative import step_derivative
from models.physics.turns import joined, turn_by, turned


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
