"""What a camera without noise sees of an object: the ray of each pixel, as pose tracking follows it."""

import numpy as np
from numba import njit

from slipmap.models.perception.edge_kernels import _seen


@njit
def _all_seen(lens, land, pose, pixels):
    seen = np.empty(len(pixels))
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for k in range(len(pixels)):
        seen[k] = _seen(lens, land, c, s, pose, pixels[k, 0], pixels[k, 1])
    return seen


def heights_seen(relief, pixels, pose, table, view):
    """Heights (...) at pixel coordinates (..., 2), m, of an object with a relief at a pose (3,)."""
    flat = np.array(pixels, dtype=float).reshape(-1, 2)
    seen = _all_seen(view.lens, relief.land(table), np.array(pose, dtype=float), flat)
    return seen.reshape(pixels.shape[:-1])
