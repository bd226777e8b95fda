"""Cell grids from label images: pictures from above in which each pixel names a segment of the object."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from shapely.geometry import LinearRing, Polygon

from models.bounded_files import UnreadableFile
from models.objects.footprints import cells_from_polygon
from models.objects.meshes import LARGEST_EXTENT, SMALLEST_EXTENT
from models.objects.picture_files import read_picture
from models.objects.tracing import traced_outline
from models.physics.cell_grid import CellGrid, FloatArray

IntArray = NDArray[np.int64]

_SPECK = 0.01  # of the object's area


def cells_from_label_image(
    labels: NDArray[np.integer] | str | PathLike[str],
    metres_per_pixel: float,
    *,
    count: int | None = None,
    width: float | None = None,
    background: int = 0,
) -> tuple[CellGrid, IntArray]:
    """Cell grid of the object in a label image, and the segment that each cell belongs to.

    Every pixel that is not background is part of the object. The object frame has its origin at the centroid
    of these pixels; x points to the right in the image and y up, that is, against the rows. The outline is
    that of `traced_outline`. Further pieces and holes below 1 % of the object's area count as noise: pieces
    are dropped, holes filled.

    Args:
        labels: (H, W) whole numbers, or the path of a picture with one channel.
        metres_per_pixel: side of a pixel on the object's surface, m.
        count: wanted number of cells, as in `cells_from_polygon`; or else
        width: side of a cell, m.
        background: label of what is not the object.

    Returns:
        The grid, and segment (n,): the label of most of a cell's object pixels (of equally many, the smallest
        label), or of the nearest object pixel where cells are smaller than pixels.

    Raises:
        ValueError: a file that cannot be read, an image that is not one channel of whole numbers, a scale
            that is not positive or makes the object wider than 5 m or narrower than 1 mm, no object, an
            object in separate pieces, or wrong count or width.
    """
    image, source = _label_array(labels)
    if not (np.isfinite(metres_per_pixel) and metres_per_pixel > 0):
        raise ValueError(f"{source}: metres_per_pixel must be a positive length, got {metres_per_pixel}")
    mask = _largest_piece(image != background, source, background)
    rows, columns = np.nonzero(mask)
    origin = np.array([columns.mean(), rows.mean()])
    scale = np.array([metres_per_pixel, -metres_per_pixel])

    polygon = traced_outline(mask)
    extent = metres_per_pixel * max(int(np.ptp(rows)), int(np.ptp(columns)), 1)
    if not SMALLEST_EXTENT <= extent <= LARGEST_EXTENT:
        raise ValueError(
            f"{source}: with metres_per_pixel = {metres_per_pixel:g} the object measures {extent:.4g} m; it"
            f" must lie between {SMALLEST_EXTENT:g} and {LARGEST_EXTENT:g} m"
        )
    rings = [
        (np.asarray(ring.coords)[:-1] - origin) * scale
        for ring in (polygon.exterior, *(hole for hole in polygon.interiors if _counts(hole, mask)))
    ]
    grid = cells_from_polygon(rings[0], rings[1:], count=count, width=width)
    pixels = (np.column_stack([columns, rows]) - origin) * scale
    return grid, _majority(grid, pixels, image[rows, columns])


def _label_array(labels: NDArray[np.integer] | str | PathLike[str]) -> tuple[IntArray, str]:
    if isinstance(labels, str | PathLike):
        source = f"label image {Path(labels)}"
        try:
            image = read_picture(Path(labels))
        except UnreadableFile as error:
            raise ValueError(f"{source}: {error}") from error
    else:
        source, image = "label image", np.asarray(labels)
    if image.ndim != 2:
        raise ValueError(
            f"{source}: expected one channel (H, W) with a label in each pixel, got shape {image.shape}; "
            f"save labels as a greyscale picture, not in colour"
        )
    if image.dtype != bool and not np.issubdtype(image.dtype, np.integer):
        raise ValueError(f"{source}: labels must be whole numbers, got {image.dtype}")
    return image.astype(np.int64), source


def _largest_piece(mask: NDArray[np.bool_], source: str, background: int) -> NDArray[np.bool_]:
    if not np.any(mask):
        raise ValueError(f"{source}: no object, every pixel has the background label {background}")
    _, piece, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    areas = stats[1:, cv2.CC_STAT_AREA]
    kept = int(np.argmax(areas))
    others = np.delete(areas, kept)
    if len(others) > 0 and others.max() > _SPECK * areas[kept]:
        other = 1 + int(np.argsort(areas, kind="stable")[-2])
        x, y = stats[other, cv2.CC_STAT_LEFT], stats[other, cv2.CC_STAT_TOP]
        raise ValueError(
            f"{source}: the object falls into separate pieces; besides the largest ({areas[kept]} pixels) "
            f"there is one of {others.max()} pixels at column {x}, row {y}. An object is one connected piece "
            f"(pixels that touch in a corner are not connected): join the pieces or set all but "
            f"one to {background}"
        )
    return piece == kept + 1


def _counts(hole: LinearRing, mask: NDArray[np.bool_]) -> bool:
    return Polygon(hole).area > _SPECK * float(mask.sum())


def _majority(grid: CellGrid, pixels: FloatArray, labels: IntArray) -> IntArray:
    names, label = np.unique(labels, return_inverse=True)
    cell = np.asarray(cKDTree(grid.centers).query(pixels)[1])
    inside = np.abs(pixels - grid.centers[cell]).max(axis=1) <= grid.width / 2
    votes = np.zeros((len(grid), len(names)), dtype=int)
    np.add.at(votes, (cell[inside], label[inside]), 1)
    segment = names[np.argmax(votes, axis=1)]
    empty = votes.sum(axis=1) == 0
    if np.any(empty):
        segment[empty] = labels[cKDTree(pixels).query(grid.centers[empty])[1]]
    return segment
