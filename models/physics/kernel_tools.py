"""What kernels share: named tuples of arguments and results, copies of arrays, small rotations, and jobs,
each a push of a model.

In a call from Python, Numba needs about a microsecond to recognise a named tuple and no time for a plain one.
So kernels take plain tuples and restore the names themselves: `Common(*common)`.

Numba's own slice assignments include code that formats shapes for an error message, which takes three seconds
to compile for each kind of assignment.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.compiled import compiled

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Common(NamedTuple):
    """Object, finger and smoothing, common to all hypotheses and pushes."""

    # rx, ry: (n,) cell centres, object frame, m
    rx: FloatArray
    ry: FloatArray
    cell_width: float  # w, m
    edges: FloatArray  # (E, 4) outline, the object to the left
    radius: float  # finger radius, m
    size: float  # largest distance of an outline corner from the object frame's origin, m
    smoothing: FloatArray  # (4,) slip speed ε, stick_speed, penetration, relaxation; see `Smoothing`


class ReducedMaps(NamedTuple):
    """K hypotheses, reduced to what a step depends on."""

    load: FloatArray  # (K, n) friction loads f_i, N
    inertia: FloatArray  # (K, 4) m, s_x, s_y, J
    mu: FloatArray  # (K,) finger friction
    mass: FloatArray  # (K, n) cell masses, kg; without columns if there is no table


class JoinedPushes(NamedTuple):
    """B pushes end to end; `*_at` (B + 1,) are the offsets at which each begins."""

    h: FloatArray  # (B,) steps, s
    # tip, wrench: as in `Push`, with `tip_angle` as the tip's third column; a push without a wrench has no
    # rows there
    tip: FloatArray
    tip_at: IntArray
    wrench: FloatArray
    wrench_at: IntArray
    # start_poses, start_twists: (K, B, 3) world; object frame
    start_poses: FloatArray
    start_twists: FloatArray
    # sample_step, sample_fraction: (S,) ascending steps in which poses are wanted, and the fraction of each
    sample_step: IntArray
    sample_fraction: FloatArray
    sample_time: FloatArray  # (S,) the same as times from the start of the push, s
    sample_at: IntArray
    # force_first, force_last: (T,) ascending first and last steps over which each contact force is a mean
    force_first: IntArray
    force_last: IntArray
    force_at: IntArray


class Formulas(NamedTuple):
    """Compiled formulas of effects, and their arguments besides the state."""

    addresses: IntArray  # (4,) addresses of the functions body, cells, cell slopes, memory
    # (7,) number of memory entries, of parameters, of blades; whether cells change; whether Q changes; number
    # of pyramids; whether the finger bends
    sizes: IntArray
    constants: FloatArray  # (B, CONSTANTS), see there; the first is the time before the first step
    parameters: FloatArray  # (K, P) of the effects
    delay: FloatArray  # (K,) of the tracker, s; empty if there is none


class Results(NamedTuple):
    """Results of rollouts of K hypotheses under B pushes."""

    poses: FloatArray  # (K, S, 3) world
    # (K, S, 3) velocity of the poses, zero where the tracker's delay reaches beyond the push; used only for
    # the derivative with respect to the delay, else without samples
    rates: FloatArray
    forces: FloatArray  # (K, T, 2) of the finger on the object, world, N
    d_poses: FloatArray  # (K, S, 3, P) derivatives, or P = 0 for none
    d_forces: FloatArray  # (K, T, 2, P) the same
    # (K, B, 7) last pose, last twist (object frame), and the number of evaluations, negative if a step did
    # not converge
    end: FloatArray
    rim: FloatArray  # (K, B, RIM_RESULTS), see there; without entries if there is no table
    # (K, S, 3, n) derivatives with respect to the cell masses at fixed friction loads and inertia, of the
    # poses after a push first came near the rim; without entries if there is no table
    mass_poses: FloatArray
    mass_forces: FloatArray  # (K, T, 2, n) the same


def empty_results(
    models: int, pushes: JoinedPushes, columns: int, rates: bool, rim: int = 0, masses: int = 0
) -> Results:
    """Allocate the results of K models.

    Args:
        models: K.
        pushes: the pushes to simulate.
        columns: P, 0 for no derivatives.
        rates: whether `rates` are wanted.
        rim: number of entries of `rim`.
        masses: n if derivatives with respect to the cell masses are wanted, else 0.
    """
    K, B, S, T = models, len(pushes.h), pushes.sample_at[-1], pushes.force_at[-1]
    poses, forces, end = np.empty((K, S, 3)), np.empty((K, T, 2)), np.empty((K, B, 7))
    d_poses, d_forces = np.empty((K, S, 3, columns)), np.empty((K, T, 2, columns))
    by_mass = np.empty((K, S, 3, masses)), np.empty((K, T, 2, masses))
    rates_room = np.empty((K, S if rates else 0, 3))
    return Results(poses, rates_room, forces, d_poses, d_forces, end, np.empty((K, B, rim)), *by_mass)


@compiled(forceinline=True)
def copy_into(target, source):  # type: ignore[no-untyped-def]
    """Copy (n,) numbers.

    Raises:
        ValueError: the lengths differ.
    """
    if target.shape[0] != source.shape[0]:
        raise ValueError("copy_into: lengths differ")
    for i in range(source.shape[0]):
        target[i] = source[i]


_SMALL = 0.1  # rad; up to this angle the series below are exact to rounding


class Turn(NamedTuple):
    """Rotation by an angle α, typically hundredths of a radian in a step."""

    # cos, sin: of α
    cos: float
    sin: float
    # sinc, sinc_slope: sin(α)/α and its derivative with respect to α
    sinc: float
    sinc_slope: float


@compiled(forceinline=True, fastmath={"contract"})
def turn_by(angle):  # type: ignore[no-untyped-def]
    """The `Turn` by an angle in rad, from power series if it is small."""
    z = angle * angle
    if z > _SMALL * _SMALL:
        c = math.cos(angle)
        s = math.sin(angle)
        return Turn(c, s, s / angle, (c - s / angle) / angle)
    c = 1.0 + z * (-1 / 2 + z * (1 / 24 + z * (-1 / 720 + z * (1 / 40320))))
    sinc = 1.0 + z * (-1 / 6 + z * (1 / 120 + z * (-1 / 5040 + z * (1 / 362880))))
    slope = angle * (-1 / 3 + z * (1 / 30 + z * (-1 / 840 + z * (1 / 45360 - z * (1 / 3991680)))))
    return Turn(c, angle * sinc, sinc, slope)


@compiled(forceinline=True, fastmath={"contract"})
def joined(c1, s1, c2, s2):  # type: ignore[no-untyped-def]
    """Cosine and sine of the sum of two angles, from those of each."""
    return c1 * c2 - s1 * s2, s1 * c2 + c1 * s2


@compiled(forceinline=True, fastmath={"contract"})
def turned(c, s, x, y):  # type: ignore[no-untyped-def]
    """The vector (x, y) turned by the angle with cosine c and sine s."""
    return c * x - s * y, s * x + c * y


class OnePush(NamedTuple):
    """One push of one model; attributes as in `JoinedPushes`."""

    h: float
    tip: FloatArray
    wrench: FloatArray
    start_pose: FloatArray
    start_twist: FloatArray
    sample_step: IntArray
    sample_fraction: FloatArray
    sample_time: FloatArray
    force_first: IntArray
    force_last: IntArray


@compiled(forceinline=True)
def push_of(pushes, k, b):  # type: ignore[no-untyped-def]
    """`OnePush` b of model k."""
    samples = slice(pushes.sample_at[b], pushes.sample_at[b + 1])
    forces = slice(pushes.force_at[b], pushes.force_at[b + 1])
    return OnePush(
        pushes.h[b],
        pushes.tip[pushes.tip_at[b] : pushes.tip_at[b + 1]],
        pushes.wrench[pushes.wrench_at[b] : pushes.wrench_at[b + 1]],
        pushes.start_poses[k, b],
        pushes.start_twists[k, b],
        pushes.sample_step[samples],
        pushes.sample_fraction[samples],
        pushes.sample_time[samples],
        pushes.force_first[forces],
        pushes.force_last[forces],
    )


@compiled(forceinline=True)
def results_of(results, pushes, k, b):  # type: ignore[no-untyped-def]
    """`Results` of push b of model k only, without their first axes."""
    samples = slice(pushes.sample_at[b], pushes.sample_at[b + 1])
    forces = slice(pushes.force_at[b], pushes.force_at[b + 1])
    return Results(
        results.poses[k, samples],
        results.rates[k, samples],
        results.forces[k, forces],
        results.d_poses[k, samples],
        results.d_forces[k, forces],
        results.end[k, b],
        results.rim[k, b],
        results.mass_poses[k, samples],
        results.mass_forces[k, forces],
    )


@compiled()
def step_of(time, h, steps):  # type: ignore[no-untyped-def]
    """Index of the step of length h in which a time falls, and the fraction of that step (0 to 1)."""
    step = min(max(math.ceil(time / h - 1e-9) - 1, 0), steps - 1)
    return step, min(max(time / h - step, 0.0), 1.0)


def evenly_dealt(steps: NDArray[np.int64], models: int, threads: int | None = None) -> NDArray[np.int64]:
    """Jobs k B + b of models times pushes, ordered so that each thread gets equally long work.

    A parallel loop gives each thread one run of consecutive jobs. With ten pushes in the order of their
    recording, one of two threads idled for an eighth of the time.

    Args:
        steps: (B,) number of steps of each push.
        models: K.
        threads: number of threads; Numba's if None.
    """
    threads = numba.get_num_threads() if threads is None else threads
    longest_first = np.argsort(-np.tile(steps, models), kind="stable")
    turn, seat = np.divmod(np.arange(len(longest_first)), threads)
    # Dealt back and forth, since the first thread in a turn gets the longest job.
    hand = np.where(turn % 2 == 0, seat, threads - 1 - seat)
    return longest_first[np.argsort(hand, kind="stable")]
