"""The paper's notation: poses with three numbers per cell, and the distance between two of them.

Song and Boularias (IROS 2020, section III) write the pose of an object of n cells as

    x = [p_x¹, p_y¹, θ¹, …, p_xⁿ, p_yⁿ, θⁿ]ᵀ.

The cells are rigidly joined, so x follows from the planar pose q = (x, y, θ) of the object frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from slipmap.models.geometry import rotated
from slipmap.models.physics.cell_grid import FloatArray, checked_points


def cell_poses(q: ArrayLike, centers: ArrayLike) -> FloatArray:
    """Pose vector x of the paper: p^i = (x, y) + R(θ) r_i and θ^i = θ.

    Args:
        q: (…, 3) planar pose of the object frame: x, y in m, θ in rad.
        centers: (n, 2) cell centres r_i in the object frame, m.

    Returns:
        (…, 3n) p_x, p_y, θ of each cell, world frame.
    """
    pose, r = checked_triple(q, "pose q"), checked_points(centers, "cell centres")
    position = pose[..., None, :2] + rotated(r, pose[..., 2, None])
    angle = np.broadcast_to(pose[..., 2, None, None], (*position.shape[:-1], 1))
    per_cell = np.concatenate([position, angle], axis=-1)
    return np.ascontiguousarray(per_cell).reshape(*per_cell.shape[:-2], -1)


def add(q_a: ArrayLike, q_b: ArrayLike, centers: ArrayLike) -> FloatArray:
    """Mean distance between the cells' positions in two poses (ADD), 1/n Σ_i |p^i(q_a) - p^i(q_b)|.

    Args:
        q_a: (…, 3) planar poses.
        q_b: (…, 3) planar poses; leading axes broadcast.
        centers: (n, 2) cell centres in the object frame, m.

    Returns:
        (…,) distances, m.
    """
    difference = cell_poses(q_a, centers) - cell_poses(q_b, centers)
    difference = difference.reshape(*difference.shape[:-1], -1, 3)
    return np.hypot(difference[..., 0], difference[..., 1]).mean(axis=-1)


def checked_triple(values: ArrayLike, what: str) -> FloatArray:
    """The values as a float array (…, 3), checked to be finite.

    Raises:
        ValueError: the last axis is not 3, or an entry is not finite; the message begins with `what`.
    """
    array = np.asarray(values, dtype=float)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"{what}: expected three numbers along the last axis, got shape {array.shape}")
    if not np.all(np.isfinite(array)):
        row = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{what}: entry {row} is not finite: {array[row]}")
    return array
