"""Rollouts with effects for all models and all pushes, on all threads; `effect_kernel.py` makes one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange

from models.physics.addresses import address_of, call_compiled
from models.physics.compiled import compiled
from models.physics.effect_kernel import effect_rollout
from models.physics.job_order import evenly_dealt


@compiled()
def _effect_rollout_one(  # type: ignore[no-untyped-def]
    job, load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h, tip, tip_at,
    wrench, wrench_at, q0, v0, sample_time, sample_at, delay, force_step, force_at,
    addresses, sizes, constants, parameters, memory0,
    pose_out, rate_out, force_out, dpose_out, dforce_out, end_out,
):  # fmt: skip
    pushes = h.shape[0]
    k = job // pushes
    b = job % pushes
    s0, s1 = sample_at[b], sample_at[b + 1]
    f0, f1 = force_at[b], force_at[b + 1]
    effect_rollout(
        load[k], rx, ry, inertia[k], mu[k], cell_width, edges, radius, size, smoothing, h[b],
        tip[tip_at[b] : tip_at[b + 1]], wrench[wrench_at[b] : wrench_at[b + 1]], q0[k, b], v0[k, b],
        sample_time[s0:s1], delay[k], force_step[f0:f1],
        addresses, sizes, constants[b], parameters[k], memory0,
        pose_out[k, s0:s1], rate_out[k, s0:s1], force_out[k, f0:f1], dpose_out[k, s0:s1],
        dforce_out[k, f0:f1], end_out[k, b],
    )  # fmt: skip


@compiled(parallel=True)
def _all_jobs(  # type: ignore[no-untyped-def]
    address, order, load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h, tip, tip_at,
    wrench, wrench_at, q0, v0, sample_time, sample_at, delay, force_step, force_at,
    addresses, sizes, constants, parameters, memory0,
    pose_out, rate_out, force_out, dpose_out, dforce_out, end_out,
):  # fmt: skip
    for place in prange(len(order)):
        call_compiled(
            _effect_rollout_one, address,
            (
                order[place], load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h,
                tip, tip_at, wrench, wrench_at, q0, v0, sample_time, sample_at, delay, force_step, force_at,
                addresses, sizes, constants, parameters, memory0,
                pose_out, rate_out, force_out, dpose_out, dforce_out, end_out,
            ),
        )  # fmt: skip


def effect_rollout_all(*arguments: Any) -> None:
    """All models times all pushes, on all threads; arguments as in `kernel.rollout_one` and `effect_rollout`.

    Shapes: delay (K,), constants (B, CONSTANTS), parameters (K, P), rate_out (K, S, 3).
    """
    load, tip_at = arguments[0], arguments[12]
    order = evenly_dealt(np.diff(tip_at), len(load))
    _all_jobs(address_of(_effect_rollout_one, (0, *arguments)), order, *arguments)
