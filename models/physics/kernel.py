"""Compiled rollouts: one push of one model, step by step, with the Jacobian carried along.

`rollout.py` is the door to this file; nothing else needs to call it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from models.physics.compiled import compiled
from models.physics.contact import CONTACT_COLUMNS, MAX_CONTACTS
from models.physics.friction import SPIN_RADIUS
from models.physics.step import (
    EXTRA_COLUMNS,
    MAX_EVALUATIONS,
    free_momentum,
    place_finger,
    sinc,
    solve_step,
    step_derivative,
)


@compiled(fastmath={"contract"})
def _propagate(S, A, Hinv, extra, load, rx, ry, dforce, fw, out_force, v, h, wx, wy, phi, want_force):  # type: ignore[no-untyped-def]
    """Carry d(state)/d(parameters) over one step.

    S holds rows x, y, θ (world), v_x, v_y, omega (object frame). `phi` bundles ρ², ε² and the constants of
    the pose update; `fw` bundles the contact impulse over Σ f and the turn of the middle frame.
    """
    n = load.shape[0]
    columns = S.shape[1]
    rho2, eps2, ct, st, s1, d1 = phi[0], phi[1], phi[2], phi[3], phi[4], phi[5]
    vx, vy, omega = v[0], v[1], v[2]
    a00, a01, a02, a03, a04, a05 = A[0, 0], A[0, 1], A[0, 2], A[0, 3], A[0, 4], A[0, 5]
    a10, a11, a12, a13, a14, a15 = A[1, 0], A[1, 1], A[1, 2], A[1, 3], A[1, 4], A[1, 5]
    a20, a21, a22, a23, a24, a25 = A[2, 0], A[2, 1], A[2, 2], A[2, 3], A[2, 4], A[2, 5]
    i00, i01, i02, i11, i12, i22 = (
        Hinv[0, 0],
        Hinv[0, 1],
        Hinv[0, 2],
        Hinv[1, 1],
        Hinv[1, 2],
        Hinv[2, 2],
    )
    spin = rho2 * omega
    constant = rho2 * omega * omega + eps2
    fx, fy, ft = fw[0], fw[1], fw[2]
    cm, sm = fw[3], fw[4]
    fx_world, fy_world = fw[5], fw[6]
    half = 0.5 * h
    for j in range(columns):
        if j < n:
            x = rx[j]
            y = ry[j]
            ux = vx - omega * y
            uy = vy + omega * x
            k = h / math.sqrt(ux * ux + uy * uy + constant)
            g0 = k * ux - fx
            g1 = k * uy - fy
            g2 = k * (x * uy - y * ux + spin) - ft
        else:
            e = j - n
            if e < extra.shape[1]:
                g0 = extra[0, e]
                g1 = extra[1, e]
                g2 = extra[2, e]
            else:
                g0 = 0.0
                g1 = 0.0
                g2 = 0.0
        s0 = S[0, j]
        s1_ = S[1, j]
        s2 = S[2, j]
        s3 = S[3, j]
        s4 = S[4, j]
        s5 = S[5, j]
        g0 += a00 * s0 + a01 * s1_ + a02 * s2 + a03 * s3 + a04 * s4 + a05 * s5
        g1 += a10 * s0 + a11 * s1_ + a12 * s2 + a13 * s3 + a14 * s4 + a15 * s5
        g2 += a20 * s0 + a21 * s1_ + a22 * s2 + a23 * s3 + a24 * s4 + a25 * s5
        d0 = -(i00 * g0 + i01 * g1 + i02 * g2)
        d1_ = -(i01 * g0 + i11 * g1 + i12 * g2)
        d2 = -(i02 * g0 + i12 * g1 + i22 * g2)
        if want_force:
            px = (
                dforce[0, 0] * s0
                + dforce[0, 1] * s1_
                + dforce[0, 2] * s2
                + dforce[0, 3] * s3
                + dforce[0, 4] * s4
                + dforce[0, 5] * s5
                + dforce[0, 6] * d0
                + dforce[0, 7] * d1_
                + dforce[0, 8] * d2
            )
            py = (
                dforce[1, 0] * s0
                + dforce[1, 1] * s1_
                + dforce[1, 2] * s2
                + dforce[1, 3] * s3
                + dforce[1, 4] * s4
                + dforce[1, 5] * s5
                + dforce[1, 6] * d0
                + dforce[1, 7] * d1_
                + dforce[1, 8] * d2
            )
            if j < n:
                px += fx
                py += fy
            elif j == n + 4:
                px += dforce[0, 9]
                py += dforce[1, 9]
            dtheta_m = s2 + half * s5
            out_force[0, j] = (cm * px - sm * py - fy_world * dtheta_m) / h
            out_force[1, j] = (sm * px + cm * py + fx_world * dtheta_m) / h
        # Pose: origin += h sinc(half omega) R(θ + half omega) v⁺, all of the new twist.
        turned = s2 + half * d2
        S[0, j] = s0 + h * (s1 * (ct * d0 - st * d1_) + d1 * half * d2 * wx - s1 * turned * wy)
        S[1, j] = s1_ + h * (s1 * (st * d0 + ct * d1_) + d1 * half * d2 * wy + s1 * turned * wx)
        S[2, j] = s2 + h * d2
        S[3, j] = d0
        S[4, j] = d1_
        S[5, j] = d2


@compiled()
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
        smoothing: (3,) slip speed ε, stick_speed, penetration.
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
    columns = dpose_out.shape[2]
    derive = columns > 0
    eps2 = smoothing[0] * smoothing[0]
    rho2 = (SPIN_RADIUS * cell_width) ** 2
    load_sum = 0.0
    for i in range(n):
        load_sum += load[i]
    # 1/R_n and 1/R_t of the contact, see `Smoothing`.
    stiffness = np.array([h * h * load_sum / smoothing[2], h * load_sum / smoothing[1]])

    q = q0.copy()
    v = v0.copy()
    vold = np.empty(3)
    g = np.empty(3)
    d = np.empty(3)
    trial = np.empty(3)
    H = np.zeros((3, 3))
    total = np.zeros((3, 3))
    Hinv = np.zeros((3, 3))
    star = np.empty(3)
    contacts = np.zeros((MAX_CONTACTS, CONTACT_COLUMNS))
    frame = np.empty(6)
    vf = np.zeros(2)
    force = np.zeros(3)
    A = np.zeros((3, 6))
    extra = np.zeros((3, 5))
    dforce = np.zeros((2, 10))
    fw = np.zeros(7)
    phi = np.zeros(6)
    S = np.zeros((6, columns))
    if derive:
        for j in range(6):
            S[j, n + 5 + j] = 1.0
    last_force = np.zeros((2, columns))
    evaluations = 0
    failed = False
    sample = 0
    force_sample = 0

    for step in range(tip.shape[0] - 1):
        finger = not math.isnan(tip[step, 0]) and not math.isnan(tip[step + 1, 0])
        for i in range(3):
            vold[i] = v[i]
        star[0], star[1], star[2] = free_momentum(inertia, v, h)
        count = 0
        if finger:
            count = place_finger(q, v, h, tip[step], tip[step + 1], radius, size, edges, contacts, frame, vf)
        if wrench.shape[0] > 0:
            angle = q[2] + 0.5 * h * v[2]
            c = math.cos(angle)
            s = math.sin(angle)
            bx = c * wrench[step, 0] + s * wrench[step, 1]
            by = -s * wrench[step, 0] + c * wrench[step, 1]
            star[0] += h * bx
            star[1] += h * by
            star[2] += h * (wrench[step, 2] * by - wrench[step, 3] * bx + wrench[step, 4])
        used = solve_step(
            load, rx, ry, rho2, eps2, inertia, mu, star, h, stiffness, vf, contacts, count, size, v, g, H, total, Hinv,
            trial, d,
        )  # fmt: skip
        if used > MAX_EVALUATIONS:
            failed = True
        evaluations += used

        force[0] = 0.0
        force[1] = 0.0
        for k in range(count):
            force[0] += -contacts[k, 0] * contacts[k, 7] - contacts[k, 1] * contacts[k, 8]
            force[1] += -contacts[k, 1] * contacts[k, 7] + contacts[k, 0] * contacts[k, 8]
        if finger:
            fw[3] = frame[0]
            fw[4] = frame[1]
        fw[5] = fw[3] * force[0] - fw[4] * force[1]
        fw[6] = fw[4] * force[0] + fw[3] * force[1]

        half = 0.5 * h * v[2]
        value, slope = sinc(half)
        ct = math.cos(q[2] + half)
        st = math.sin(q[2] + half)
        wx = ct * v[0] - st * v[1]
        wy = st * v[0] + ct * v[1]

        first = sample
        while sample < sample_step.shape[0] and sample_step[sample] == step:
            a = sample_fraction[sample]
            pose_out[sample, 0] = q[0] + a * h * value * wx
            pose_out[sample, 1] = q[1] + a * h * value * wy
            pose_out[sample, 2] = q[2] + a * h * v[2]
            if derive:
                for i in range(3):
                    for j in range(columns):
                        dpose_out[sample, i, j] = (1.0 - a) * S[i, j]
            sample += 1

        if derive:
            step_derivative(
                q, vold, v, h, inertia, mu, stiffness, vf, frame, contacts, count, A, extra, force, dforce
            )  # fmt: skip
            if wrench.shape[0] > 0:
                tx = h * by
                ty = -h * bx
                tt = h * (wrench[step, 2] * -bx - wrench[step, 3] * by)
                for j in (2, 5):
                    share = 1.0 if j == 2 else 0.5 * h
                    A[0, j] -= share * tx
                    A[1, j] -= share * ty
                    A[2, j] -= share * tt
            fw[0] = force[0] / load_sum
            fw[1] = force[1] / load_sum
            fw[2] = force[2] / load_sum
            phi[0] = rho2
            phi[1] = eps2
            phi[2] = ct
            phi[3] = st
            phi[4] = value
            phi[5] = slope
            want_force = force_sample < force_step.shape[0] and force_step[force_sample] == step
            _propagate(
                S, A, Hinv, extra, load, rx, ry, dforce, fw, last_force, v, h, wx, wy, phi, want_force
            )
            for k in range(first, sample):
                a = sample_fraction[k]
                for i in range(3):
                    for j in range(columns):
                        dpose_out[k, i, j] += a * S[i, j]

        while force_sample < force_step.shape[0] and force_step[force_sample] == step:
            force_out[force_sample, 0] = fw[5] / h
            force_out[force_sample, 1] = fw[6] / h
            if derive:
                for i in range(2):
                    for j in range(columns):
                        dforce_out[force_sample, i, j] = last_force[i, j]
            force_sample += 1

        q[0] += h * value * wx
        q[1] += h * value * wy
        q[2] += h * v[2]

    for i in range(3):
        end_out[i] = q[i]
        end_out[3 + i] = v[i]
    end_out[6] = -1.0 if failed else float(evaluations)


@compiled()
def rollout_one(  # type: ignore[no-untyped-def]
    job, load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h, tip, tip_at, wrench, wrench_at, q0, v0,
    sample_step, sample_fraction, sample_at, force_step, force_at, pose_out, force_out, dpose_out, dforce_out, end_out,
):  # fmt: skip
    """Job number k B + b: push b of model k.

    Arrays of pushes are joined end to end, `*_at` (B + 1,) are offsets. Shapes: load (K, n), inertia (K, 4),
    mu (K,), q0 and v0 (K, B, 3), pose_out (K, S, 3), dpose_out (K, S, 3, P), end_out (K, B, 7); the others as in
    `rollout`.
    """
    pushes = h.shape[0]
    k = job // pushes
    b = job % pushes
    s0, s1 = sample_at[b], sample_at[b + 1]
    f0, f1 = force_at[b], force_at[b + 1]
    rollout(
        load[k], rx, ry, inertia[k], mu[k], cell_width, edges, radius, size, smoothing, h[b],
        tip[tip_at[b] : tip_at[b + 1]], wrench[wrench_at[b] : wrench_at[b + 1]], q0[k, b], v0[k, b],
        sample_step[s0:s1], sample_fraction[s0:s1], force_step[f0:f1], pose_out[k, s0:s1], force_out[k, f0:f1],
        dpose_out[k, s0:s1], dforce_out[k, f0:f1], end_out[k, b],
    )  # fmt: skip


@compiled(parallel=True)
def rollout_all(  # type: ignore[no-untyped-def]
    load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h, tip, tip_at, wrench, wrench_at, q0, v0,
    sample_step, sample_fraction, sample_at, force_step, force_at, pose_out, force_out, dpose_out, dforce_out, end_out,
):  # fmt: skip
    """All models times all pushes, on all threads; arguments as in `rollout_one`."""
    for job in prange(load.shape[0] * h.shape[0]):
        rollout_one(
            job, load, rx, ry, inertia, mu, cell_width, edges, radius, size, smoothing, h, tip, tip_at, wrench, wrench_at,
            q0, v0, sample_step, sample_fraction, sample_at, force_step, force_at, pose_out, force_out, dpose_out,
            dforce_out, end_out,
        )  # fmt: skip


__all__ = ["EXTRA_COLUMNS", "rollout_all", "rollout_one"]
