"""What is done with every pixel of a mask, in machine code.

All of it stands in one file, so that numba compiles it anew whenever something in it changes.
"""

import numpy as np

from models.physics.compiled import LONE_FOLDER, compiled


@compiled(LONE_FOLDER, nogil=True)
def between(mask, missing):  # type: ignore[no-untyped-def]
    """Missing pixels in runs, along rows or columns, that end at the mask on both sides.

    Args:
        mask, missing: (H, W) pixels of a kind, and those of which nothing is known.

    Returns:
        (H, W).
    """
    height, width = mask.shape
    found = np.zeros((height, width), np.bool_)
    above = np.full(width, -1)  # last row in each column that is known, if it is of the mask
    for row in range(height):
        left = -1
        for column in range(width):
            if missing[row, column]:
                continue
            if mask[row, column]:
                if left >= 0:
                    found[row, left + 1 : column] = True
                if above[column] >= 0:
                    found[above[column] + 1 : row, column] = True
                left, above[column] = column, row
            else:
                left, above[column] = -1, -1
    return found
