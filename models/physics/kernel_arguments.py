"""What the compiled kernels take and fill in, by name.

Numba needs about a microsecond to recognise a named tuple in a call from Python, and none for a plain one. So
kernels are handed plain tuples, and give the fields their names again: `Common(*common)`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Common(NamedTuple):
    """What all hypotheses and pushes have in common: object, finger and smoothing."""

    # rx, ry: (n,) cell centres, object frame, m
    rx: FloatArray
    ry: FloatArray
    cell_width: float  # w, m
    edges: FloatArray  # (E, 4) outline, the object to the left
    radius: float  # finger radius, m
    size: float  # largest distance of an outline corner from the object frame's origin, m
    smoothing: FloatArray  # (4,) slip speed ε, stick_speed, penetration, relaxation; see `Smoothing`


class ReducedMaps(NamedTuple):
    """K hypotheses, as far as a step depends on them."""

    load: FloatArray  # (K, n) friction loads f_i, N
    inertia: FloatArray  # (K, 4) m, s_x, s_y, J
    mu: FloatArray  # (K,) finger friction
    mass: FloatArray  # (K, n) of the cells, kg; without columns where no table is given


class JoinedPushes(NamedTuple):
    """B pushes end to end; `*_at` (B + 1,) are the offsets at which they begin."""

    h: FloatArray  # (B,) steps, s
    # tip, wrench: as in `Push`; a push without a wrench has no rows there
    tip: FloatArray
    tip_at: IntArray
    wrench: FloatArray
    wrench_at: IntArray
    # start_poses, start_twists: (K, B, 3) world; object frame
    start_poses: FloatArray
    start_twists: FloatArray
    # sample_step, sample_fraction: (S,) ascending steps in whose course poses are wanted; place in it
    sample_step: IntArray
    sample_fraction: FloatArray
    sample_time: FloatArray  # (S,) the same as times from the start of the push, s
    sample_at: IntArray
    force_step: IntArray  # (T,) ascending steps whose contact force is wanted
    force_at: IntArray


class Formulas(NamedTuple):
    """Compiled formulas of effects and what they are evaluated at besides the state."""

    addresses: IntArray  # (4,) of the functions body, cells, cell slopes, memory
    # (6,) numbers of memory entries, parameters, blades; whether cells are changed; whether Q is; number of
    # pyramids
    sizes: IntArray
    constants: FloatArray  # (B, CONSTANTS), see there; of the first the time before the first step
    parameters: FloatArray  # (K, P) of the effects
    delay: FloatArray  # (K,) of the tracker, s; empty for none


class Results(NamedTuple):
    """What rollouts of K hypotheses under B pushes fill in."""

    poses: FloatArray  # (K, S, 3) world
    # (K, S, 3) velocity of the poses, zero where the tracker's delay reaches beyond the push; for a
    # derivative by the delay alone, else without samples
    rates: FloatArray
    forces: FloatArray  # (K, T, 2) of the finger on the object, world, N
    d_poses: FloatArray  # (K, S, 3, P) derivatives, or P = 0 for none
    d_forces: FloatArray  # (K, T, 2, P) the same
    # (K, B, 7) last pose, last twist (object frame), and the number of evaluations, negative if a step did
    # not converge
    end: FloatArray
    rim: FloatArray  # (K, B, RIM_RESULTS), see there; without entries where no table is given
    # (K, S, 3, n) derivatives by the cells' masses, the friction loads and the inertia being held, of the
    # poses after a push first came near the rim; without entries where no table is given
    mass_poses: FloatArray
    mass_forces: FloatArray  # (K, T, 2, n) the same


def empty_results(
    models: int, pushes: JoinedPushes, columns: int, rates: bool, rim: int = 0, masses: int = 0
) -> Results:
    """Room for the results of K models.

    Args:
        models: K.
        pushes: that are simulated.
        columns: P, 0 for no derivatives.
        rates: whether these are wanted.
        rim: entries of `rim`.
        masses: n where derivatives by the cells' masses are wanted.
    """
    K, B, S, T = models, len(pushes.h), pushes.sample_at[-1], pushes.force_at[-1]
    poses, forces, end = np.empty((K, S, 3)), np.empty((K, T, 2)), np.empty((K, B, 7))
    d_poses, d_forces = np.empty((K, S, 3, columns)), np.empty((K, T, 2, columns))
    by_mass = np.empty((K, S, 3, masses)), np.empty((K, T, 2, masses))
    rates_room = np.empty((K, S if rates else 0, 3))
    return Results(poses, rates_room, forces, d_poses, d_forces, end, np.empty((K, B, rim)), *by_mass)
