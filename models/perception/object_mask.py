"""The pixels of the object: what stands on the table, in one piece, and is not the arm."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from models.perception.camera import View, pixel_size
from models.perception.edge_kernels import SMOOTHING
from models.perception.edge_kernels import Heights as KernelHeights
from models.perception.mask_kernels import between
from models.physics.cell_grid import FloatArray

Heights = NDArray[np.float32]
Mask = NDArray[np.bool_]

LOWEST = -0.005  # m; lower readings, beside the table, count as this: how deep the floor is does not matter
HIGHEST = 0.3  # m; nothing that stands on the table is higher


_LEAST_WEIGHT = 0.3  # of a smoothed pixel's neighbourhood that has readings
_LEAST_AREA = 4e-4  # m²
_FAINT, _CLEAR = 2.0, 4.0  # in standard deviations of the table's heights
_FAINTEST, _CLEAREST = 2e-3, 4e-3  # m; the same for a table seen without noise
_RAGGED = 5  # pixels; what sticks out of an edge by less, and no further along it, is noise
_RIM = 2  # pixels; an edge blurred over less is taken at half its height


def smoothed_heights(heights: Heights, blocked: Mask | None = None) -> Heights:
    """Heights averaged with their neighbours; small gaps are filled, larger ones and the arm stay NaN.

    Args:
        heights: (h, w) over the table, m; NaN where there is no reading.
        blocked: (h, w) pixels to leave out: the arm.
    """
    seen = (heights < HIGHEST) if blocked is None else (heights < HIGHEST) & ~blocked
    weight = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), SMOOTHING)
    values = np.where(seen, np.maximum(heights, np.float32(LOWEST)), np.float32(0))
    mean = cv2.GaussianBlur(values, (0, 0), SMOOTHING) / np.maximum(weight, np.float32(_LEAST_WEIGHT))
    mean[weight < _LEAST_WEIGHT] = np.nan
    if blocked is not None:
        mean[blocked] = np.nan
    return mean


def table_noise(heights: Heights) -> float:
    """Standard deviation of the table's smoothed heights about zero, m, from the middle half of them."""
    table = np.abs(heights[np.abs(heights) < -0.9 * LOWEST])
    return float(np.median(table) / 0.6745) if len(table) else 0.0


def object_mask(heights: Heights, view: View) -> Mask | None:
    """(H, W) pixels of the object, or None if nothing stands on the table.

    A pixel belongs to it if it is faintly higher than the table and joined to one that is so clearly; of
    several pieces the largest is the object. Pixels without a reading count if they lie between two of the
    object in their row or column, as on shiny metal; those along one side of it do not: the shadow that a
    tall object casts in stereo. An edge is taken at half the height that the object has beside it.

    Args:
        heights: (H, W) smoothed heights of the whole picture, m.
        view: the camera.
    """
    noise = table_noise(heights)
    faint = heights > max(_FAINTEST, _FAINT * noise)
    faint = cv2.medianBlur(faint.astype(np.uint8), 3) > 0
    faint |= between(faint, np.isnan(heights))
    found = _largest_piece(faint, heights > max(_CLEAREST, _CLEAR * noise), view)
    if found is None:
        return None
    found = _without_rim(found, heights)
    found = cv2.medianBlur(found.astype(np.uint8), _RAGGED) > 0
    return _largest_piece(found, found, view)


def _largest_piece(mask: Mask, seeds: Mask, view: View) -> Mask | None:
    number, pieces, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    area = stats[:, cv2.CC_STAT_AREA].astype(float)
    area[0] = 0.0
    area[np.bincount(pieces[seeds], minlength=number) == 0] = 0.0
    largest = int(np.argmax(area))
    if area[largest] * pixel_size(view) ** 2 < _LEAST_AREA:
        return None
    return pieces == largest


def _without_rim(mask: Mask, heights: Heights) -> Mask:
    """The mask less the pixels by its border that are lower than half the height beside them."""
    filled = np.where(mask & np.isfinite(heights), heights, np.float32(0))
    size = 2 * _RIM + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    low = filled < cv2.dilate(filled, disc) / 2
    border = cv2.erode(mask.astype(np.uint8), disc, borderType=cv2.BORDER_CONSTANT, borderValue=1) == 0
    return mask & ~(low & border & np.isfinite(heights))


class HeightPicture:
    """Smoothed heights of a part of the picture, read between its pixels."""

    def __init__(self, heights: Heights, first_column: int = 0, first_row: int = 0) -> None:
        self._heights = heights
        self._origin = np.array([first_column, first_row], dtype=float)

    @property
    def for_kernels(self) -> KernelHeights:
        """The same for kernels."""
        return KernelHeights(self._heights, *map(float, self._origin))

    def at(self, pixels: FloatArray) -> FloatArray:
        """Heights (a, b) or (a,) at pixel coordinates (a, b, 2) or (a, 2), m; NaN beside missing readings."""
        where = (pixels - self._origin).astype(np.float32)
        flat = where.reshape(len(where), -1, 2)
        read = cv2.remap(
            self._heights,
            flat[..., 0],
            flat[..., 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        )
        return read.astype(float).reshape(pixels.shape[:-1])
