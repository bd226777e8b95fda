"""Named tuples of the arguments and results of the compiled kernels.

In a call from Python, Numba needs about a microsecond to recognise a named tuple and no time for a plain one.
So kernels take plain tuples and restore the names themselves: `Common(*common)`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    # tip, wrench: as in `Push`; a push without a wrench has no rows there
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
