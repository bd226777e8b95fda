"""The rest of the paper's notation, as a reference: vectors with three numbers a cell, and their reduction.

Song and Boularias (IROS 2020, section III) write the pose of an object of n cells as

    x = [p_x¹, p_y¹, θ¹, …, p_xⁿ, p_yⁿ, θⁿ]ᵀ,

its velocity and the generalised force in the same order. The cells are rigidly joined, so x follows from the
planar pose q = (x, y, θ) of the object frame in the world, and the velocity ẋ from q and the twist
v = (v_x, v_y, omega), given in the object frame at its origin. All 3n vectors here are in the world frame.

The paper prints the diagonal of its mass matrix with the inertia first, [I_1, M_1, M_1, …], although its
pose has the angle last. Multiplied as printed, the inertia would meet p_x. Here every 3n vector and diagonal
has the order of the pose, so the mass matrix is [M_1, M_1, I_1, …].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from slipmap.models.geometry import rotated
from slipmap.models.physics.cell_grid import FloatArray, checked_points
from slipmap.models.physics.paper_notation import add as add, cell_poses as cell_poses, checked_triple

_NEIGHBOUR = 1.2  # cell widths; diagonal neighbours are 1.41 apart


def cell_velocities(v: ArrayLike, q: ArrayLike, centers: ArrayLike) -> FloatArray:
    """Velocity vector ẋ of the paper: ṗ^i = R(θ) (v_x - omega r_iy, v_y + omega r_ix) and θ̇^i = omega.

    Args:
        v: (…, 3) twist in the object frame at its origin: m/s, m/s, rad/s.
        q: (…, 3) planar pose; only its angle matters. Leading axes of v and q broadcast.
        centers: (n, 2) cell centres in the object frame, m.

    Returns:
        (…, 3n) ṗ_x, ṗ_y, θ̇ of each cell, world frame.
    """
    twist, pose = checked_triple(v, "twist v"), checked_triple(q, "pose q")
    r = checked_points(centers, "cell centres")
    omega = twist[..., 2, None]
    body = np.stack([twist[..., 0, None] - omega * r[:, 1], twist[..., 1, None] + omega * r[:, 0]], axis=-1)
    velocity = rotated(body, pose[..., 2, None])
    spin = np.broadcast_to(omega[..., None], (*velocity.shape[:-1], 1))
    return _flat(np.concatenate([velocity, spin], axis=-1))


def mass_matrix_diagonal(mass: ArrayLike, width: float) -> FloatArray:
    """Diagonal of the mass matrix, [M_1, M_1, I_1, …, M_n, M_n, I_n] with I_i = M_i w² / 6.

    The order is that of the pose vector, not the printed one (see the head of this file).

    Args:
        mass: (…, n) mass of each cell, kg.
        width: side w of a cell, m.

    Returns:
        (…, 3n) kg, kg, kg m².

    Raises:
        ValueError: a mass that is negative or not finite, or a width that is not positive.
    """
    m = _cell_values(mass, "mass")
    w = _checked_width(width)
    return _flat(m[..., None] * np.array([1.0, 1.0, w**2 / 6]))


def friction_diagonal(mu: ArrayLike) -> FloatArray:
    """Diagonal of the friction matrix, [mu_1, mu_1, mu_1, …, mu_n, mu_n, mu_n].

    Args:
        mu: (…, n) friction coefficient of each cell.

    Returns:
        (…, 3n) without unit.

    Raises:
        ValueError: a coefficient that is negative or not finite.
    """
    return np.repeat(_cell_values(mu, "friction coefficient"), 3, axis=-1)


def rigid_reduction(q: ArrayLike, centers: ArrayLike) -> FloatArray:
    """Matrix J(q) (3n, 3) with ẋ = J v for every twist v.

    With M = diag(mass_matrix_diagonal), Jᵀ M J is the exact 3 × 3 mass matrix in the object frame,

        [[m, 0, -s_y], [0, m, s_x], [-s_y, s_x, Σ m_i (|r_i|² + w²/6)]],   m = Σ m_i,   s = Σ m_i r_i,

    whatever the pose, and Jᵀ F the wrench of a 3n force vector on the object, in the object frame at its
    origin.

    Args:
        q: (3,) planar pose; only its angle matters.
        centers: (n, 2) cell centres in the object frame, m.
    """
    pose = _one_pose(q)
    return np.ascontiguousarray(cell_velocities(np.eye(3), pose, centers).T)


def wrench_on_cell(cell: int, f: ArrayLike, tau: float, n: int) -> FloatArray:
    """Force vector F of the paper, [f_x¹, f_y¹, tau¹, …], zero except on one cell.

    Args:
        cell: index of the cell, 0 to n - 1.
        f: (2,) force at the cell's centre, world frame, N.
        tau: torque about the cell's centre, N m.
        n: number of cells.

    Returns:
        (3n,) force vector.

    Raises:
        ValueError: a cell that does not exist, or a force that is not two finite numbers.
    """
    if not 0 <= cell < n:
        raise ValueError(f"force vector: cell must be from 0 to {n - 1}, got {cell}")
    wrench = checked_triple(np.append(np.asarray(f, dtype=float), tau), "force and torque")
    force = np.zeros((n, 3))
    force[cell] = wrench
    return force.ravel()


def planar_wrench(force: ArrayLike, q: ArrayLike, centers: ArrayLike) -> FloatArray:
    """Wrench of a 3n force vector on the whole object, Jᵀ F.

    Args:
        force: (3n,) force vector, world frame.
        q: (3,) planar pose.
        centers: (n, 2) cell centres in the object frame, m.

    Returns:
        (3,) f_x, f_y in N and torque about the object frame's origin in N m, object frame; its product with
        the twist v is the power F · ẋ.

    Raises:
        ValueError: a force vector of another length.
    """
    J = rigid_reduction(q, centers)
    F = np.asarray(force, dtype=float)
    if F.shape != (len(J),):
        raise ValueError(f"force vector: expected ({len(J)},) for {len(J) // 3} cells, got shape {F.shape}")
    return J.T @ F


def joints(centers: ArrayLike, width: float) -> NDArray[np.intp]:
    """Pairs of cells that are joined: (e, 2) indices.

    All cells that share a side; where these leave the object in parts (cells that meet in a corner, or thin
    parts that no cell's centre hit), the shortest further pairs that connect them.
    """
    r, w = checked_points(centers, "cell centres"), _checked_width(width)
    pairs = cKDTree(r).query_pairs(_NEIGHBOUR * w, output_type="ndarray")
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    while True:
        graph = csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(r), len(r)))
        parts, part = connected_components(graph, directed=False)
        if parts == 1:
            return pairs
        near, far = np.flatnonzero(part == part[0]), np.flatnonzero(part != part[0])
        distance, k = (np.asarray(a) for a in cKDTree(r[far]).query(r[near]))
        closest = int(np.argmin(distance))
        pairs = np.vstack([pairs, [near[closest], far[k[closest]]]])


def equality_jacobian(q: ArrayLike, centers: ArrayLike, width: float) -> csr_array:
    """Constraint Jacobian Je (3e, 3n) of the rigid joints between neighbouring cells: Je ẋ = 0.

    The paper leaves the dynamics of a step to its predecessor (reference [17] there), in which every cell is
    a body and equality constraints hold neighbours together. At a joint of cells i and j, c is the middle
    between their centres (the middle of the side they share). There both have the same velocity, and both
    turn at the same rate:

        ṗ^i + θ̇^i × (c - p^i) - ṗ^j - θ̇^j × (c - p^j) = 0,        θ̇^i - θ̇^j = 0.

    Je ẋ = 0 holds for every rigid motion and for no other: the rank is 3n - 3. Joints that close a loop add
    rows that depend on the others.

    Args:
        q: (3,) planar pose; only its angle matters.
        centers: (n, 2) cell centres in the object frame, m.
        width: side w of a cell, m.

    Returns:
        Sparse (3e, 3n): two rows of velocity (m/s) and one of spin (rad/s) for each of the e `joints`.
    """
    pose, r = _one_pose(q), checked_points(centers, "cell centres")
    pairs = joints(r, width)
    e, n = len(pairs), len(r)
    half = rotated((r[pairs[:, 1]] - r[pairs[:, 0]]) / 2, pose[2])  # c - p^i = -(c - p^j)
    row = 3 * np.arange(e)
    entries = []
    for cell, sign in ((pairs[:, 0], 1.0), (pairs[:, 1], -1.0)):
        column = 3 * cell
        for axis in range(3):
            entries.append((row + axis, column + axis, np.full(e, sign)))
        # sign² = 1: the lever turns round together with the sign.
        entries.append((row, column + 2, -half[:, 1]))
        entries.append((row + 1, column + 2, half[:, 0]))
    i, j, value = (np.concatenate(part) for part in zip(*entries, strict=True))
    return csr_array((value, (i, j)), shape=(3 * e, 3 * n))


def _flat(per_cell: FloatArray) -> FloatArray:
    """(…, n, 3) to (…, 3n)."""
    return np.ascontiguousarray(per_cell).reshape(*per_cell.shape[:-2], -1)


def _one_pose(q: ArrayLike) -> FloatArray:
    pose = checked_triple(q, "pose q")
    if pose.shape != (3,):
        raise ValueError(f"pose q: expected one pose (3,), got shape {pose.shape}")
    return pose


def _cell_values(values: ArrayLike, what: str) -> FloatArray:
    array = np.asarray(values, dtype=float)
    if array.ndim == 0:
        raise ValueError(f"{what}: expected one value a cell along the last axis, got a single number")
    wrong = ~(np.isfinite(array) & (array >= 0))
    if np.any(wrong):
        row = tuple(int(k) for k in np.argwhere(wrong)[0])
        raise ValueError(f"{what}: must be finite and not negative, cell {row[-1]} has {array[row]}")
    return array


def _checked_width(width: float) -> float:
    if not (np.isfinite(width) and width > 0):
        raise ValueError(f"cell width must be a positive length in m, got {width}")
    return float(width)
