"""Cell grids from label images (top views whose pixels name segments of the object), and subpixel outlines of
pixel masks."""

import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import generate_binary_structure, maximum_filter, minimum_filter
from scipy.spatial import cKDTree
from shapely.geometry import LinearRing, Polygon

from slipmap.models.files import UnreadableFile, read_bounded
from slipmap.models.geometry import cross
from slipmap.models.objects.footprints import cells_from_polygon, rings_of, without_small_holes
from slipmap.models.objects.meshes import LARGEST_EXTENT, SMALLEST_EXTENT
from slipmap.models.physics.cell_grid import CellGrid, FloatArray

IntArray = NDArray[np.int64]
Mask = NDArray[np.bool_]

_LARGEST_FILE = 64 * 2**20  # bytes
_MOST_PIXELS = 50_000_000
_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257  # tags
_SAVE_ANEW = "save it again as a greyscale PNG"
_SPECK = 0.01  # of the object's area
_MOST_BORDER = 0.5  # of the picture's border; only a background covers more of it
_MOST_STRAY = 0.5  # of the object's edge may have labels without an area of their own,
_STRAY_LABELS = 8  # if the object has more of these: they are no labels, but the greys of a soft edge
# Keeps depth and channels, but applies the camera's orientation, which OpenCV does for TIFF files anyway.
_AS_STORED = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR

# Along a straight edge of any direction, the middles of the pixel borders lie in a strip under a pixel wide.
_STRIP = 1.0
_FARTHEST_CORNER = 1.5
_LEAST_TURN = np.sin(np.deg2rad(15.0))


def cells_from_label_image(
    labels: NDArray[np.integer] | str | PathLike[str],
    metres_per_pixel: float,
    *,
    count: int | None = None,
    width: float | None = None,
    background: int = 0,
) -> tuple[CellGrid, IntArray]:
    """Cell grid of the object in a label image, and the segment that each cell belongs to.

    Every pixel that is not background belongs to the object. The object frame has its origin at the centroid
    of these pixels; x points right in the image and y up, against the rows. `traced_outline` gives the
    outline. Further pieces and holes below 1 % of the object's area count as noise: pieces are dropped, holes
    filled.

    Args:
        labels: (H, W) integers, or the path of a picture with one channel.
        metres_per_pixel: side of a pixel on the object's surface, m.
        count: wanted number of cells, as in `cells_from_polygon`. Without it and `width`
            there are about 60.
        width: side of a cell, m.
        background: label of pixels outside the object.

    Returns:
        The grid, and segments (n,): the most frequent label among a cell's object pixels (on a tie the
        smallest label), or that of the nearest object pixel if a cell is smaller than a pixel.

    Raises:
        ValueError: the file cannot be read; the image is not one channel of integers; the scale is not
            positive or makes the object wider than 5 m or narrower than 1 mm; there is no object, or it is in
            separate pieces, covers most of the picture's border or has a soft edge; or count or width is
            wrong.

    Example:
        >>> import numpy as np
        >>> import slipmap
        >>> labels = np.zeros((40, 60), dtype=int)
        >>> labels[10:30, 10:50] = 1
        >>> grid, segments = slipmap.cells_from_label_image(labels, 0.002, count=18)
        >>> len(grid), set(segments.tolist())
        (18, {1})
    """
    image, source = _label_array(labels)
    if not (np.isfinite(metres_per_pixel) and metres_per_pixel > 0):
        raise ValueError(f"{source}: metres_per_pixel must be a positive length, got {metres_per_pixel}")
    mask = _largest_piece(image, source, background)
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
    polygon = without_small_holes(polygon, _SPECK * float(mask.sum()))
    rings = rings_of(shapely.transform(polygon, lambda pixels: (pixels - origin) * scale))
    grid = cells_from_polygon(*rings, count=count, width=width)
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
            f"save the labels as a greyscale picture, not in colour"
        )
    if image.dtype != bool and not np.issubdtype(image.dtype, np.integer):
        raise ValueError(f"{source}: labels must be whole numbers, got {image.dtype}")
    return image.astype(np.int64), source


def _largest_piece(labels: IntArray, source: str, background: int) -> Mask:
    mask = labels != background
    if not np.any(mask):
        raise ValueError(f"{source}: no object, every pixel has the background label {background}")
    border = np.concatenate([mask[[0, -1]].ravel(), mask[1:-1, [0, -1]].ravel()])
    if border.mean() > _MOST_BORDER and np.ptp(labels) > 0:  # one label may fill a picture cut to the object
        rim = np.concatenate([labels[[0, -1]].ravel(), labels[1:-1, [0, -1]].ravel()])
        label = int(np.bincount(rim[border] - rim.min()).argmax() + rim.min())
        raise ValueError(
            f"{source}: the object covers {100 * border.mean():.0f} % of the picture's border, like a"
            f" background. If {label} is the background, give background={label}; otherwise leave a margin of"
            f" the background label {background} around the object"
        )
    _, piece, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    areas = stats[1:, cv2.CC_STAT_AREA]
    kept = int(np.argmax(areas))
    others = np.delete(areas, kept)
    if len(others) > 0 and others.max() > _SPECK * areas[kept]:
        other = 1 + int(np.argsort(areas, kind="stable")[-2])
        x, y = stats[other, cv2.CC_STAT_LEFT], stats[other, cv2.CC_STAT_TOP]
        raise ValueError(
            f"{source}: the object is in separate pieces; besides the largest ({areas[kept]} pixels) "
            f"there is one of {others.max()} pixels at column {x}, row {y}. An object must be one connected "
            f"piece (pixels that touch only at a corner are not connected): join the pieces or set all but "
            f"one to {background}"
        )
    mask = piece == kept + 1
    if (greys := _soft_edge(labels, mask)) > 0:
        raise ValueError(
            f"{source}: the object's edge is made of {greys} values without an area of their own, as in a"
            f" soft mask or a photograph; give its pixels one value (one for each segment), all others"
            f" {background}"
        )
    return mask


def _soft_edge(labels: IntArray, mask: Mask) -> int:
    """Number of labels of an object that fill no 2 by 2 pixels, if its edge is lined by them, else 0."""
    uniform = mask & (minimum_filter(labels, 2) == maximum_filter(labels, 2))
    stray = mask & ~maximum_filter(uniform, 2, origin=-1)
    inside = minimum_filter(mask, footprint=generate_binary_structure(2, 1), mode="constant")
    edge = mask & ~inside
    greys = len(np.unique(labels[stray]))
    return greys if greys > _STRAY_LABELS and (stray & edge).sum() > _MOST_STRAY * edge.sum() else 0


def openings(labels: NDArray[np.integer], background: int = 0) -> int:
    """Number of openings of any size in the object of a label image (H, W)."""
    number, pieces = cv2.connectedComponents((labels == background).astype(np.uint8), connectivity=8)
    border = np.concatenate([pieces[[0, -1]].ravel(), pieces[:, [0, -1]].ravel()])
    return int(number - 1 - len(set(border.tolist()) - {0}))


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


def traced_outline(mask: Mask) -> Polygon:
    """Outline, with holes, of one connected piece of pixels (neighbours share a side).

    The outline runs between the pixels, through the middles of the borders between object and background.
    Least-squares lines replace the staircases of oblique edges, so that normals are those of the object's
    edges and not of the pixels; corners lie where these lines meet. Objects only a few pixels wide keep the
    borders of their pixels.

    Args:
        mask: (H, W) pixels of the object.

    Returns:
        Polygon in pixel coordinates (column, row); integers are the centres of pixels.
    """
    rings, borders = border_middles(mask)
    stairs = Polygon(rings[0], rings[1:])
    coarse = stairs.simplify(_STRIP)
    assert isinstance(coarse, Polygon)
    kept = (coarse.exterior, *coarse.interiors)
    straight = [straightened(points, corners) for points, corners in zip(rings, kept, strict=True)]
    polygon = Polygon(straight[0], straight[1:])
    # Good lines keep the area: a larger difference means edges off by a tenth of a pixel on average.
    if polygon.is_valid and abs(polygon.area - mask.sum()) < 0.1 * stairs.length:
        return polygon
    exact = borders.simplify(0.0)
    assert isinstance(exact, Polygon)
    return exact


def border_middles(mask: Mask) -> tuple[list[FloatArray], Polygon]:
    """Middles of the borders of one piece of pixels (H, W), one pixel apart, and the borders themselves.

    Returns:
        Rings of points (m, 2), the exterior first, (column, row); and the exact outline of the pixels.
    """
    step = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, first = np.nonzero(step == 1)
    last = np.nonzero(step == -1)[1]
    # The union of the rows' runs follows the borders exactly; unit steps along it give their middles.
    runs = shapely.box(first - 0.5, row - 0.5, last - 0.5, row + 0.5)
    borders = shapely.unary_union(runs).segmentize(1.0)
    assert isinstance(borders, Polygon)
    rings = []
    for ring in (borders.exterior, *borders.interiors):
        corners = np.asarray(ring.coords)
        rings.append((corners[:-1] + corners[1:]) / 2)
    return rings, borders


def straightened(points: FloatArray, kept: LinearRing) -> FloatArray:
    """Corners (k, 2) of the lines that best fit the stretches of a ring (m, 2) between its kept points."""
    where = {tuple(point): k for k, point in enumerate(points)}
    corners = np.asarray(kept.coords)[:-1]
    index = [where[tuple(corner)] for corner in corners]
    if (np.diff(index) % len(points)).sum() > len(points):  # kept points run the other way round
        corners, index = corners[::-1], index[::-1]
    lines = []
    for begin, end in zip(index, index[1:] + index[:1], strict=True):
        stretch = points[(begin + np.arange((end - begin) % len(points) + 1)) % len(points)]
        inner = stretch[1:-1] if len(stretch) > 5 else stretch[[0, -1]]
        middle = inner.mean(axis=0)
        direction = np.linalg.svd(inner - middle, full_matrices=False)[2][0]
        backwards = direction @ (stretch[-1] - stretch[0]) < 0
        lines.append((middle, -direction if backwards else direction))
    result = []
    for corner, (p, d), (q, e) in zip(corners, lines[-1:] + lines[:-1], lines, strict=True):
        turn = cross(d, e)
        projected = (p + d * (d @ (corner - p)) + q + e * (e @ (corner - q))) / 2
        if abs(turn) > _LEAST_TURN:
            meeting = p + d * (cross(q - p, e) / turn)
            if np.linalg.norm(meeting - corner) <= _FARTHEST_CORNER:
                projected = meeting
        result.append(projected)
    return np.array(result)


def read_picture(path: Path) -> NDArray[Any]:
    """Read (H, W) or (H, W, channels) from a PNG, BMP, PGM or TIFF file, in the orientation it states.

    The declared size is checked first: OpenCV trusts it and would spend seconds allocating gigabytes for a
    file of a few bytes.

    Raises:
        UnreadableFile: the file is missing, too large, of another kind or damaged, or declares more than 50
            million pixels.
    """
    content = read_bounded(path, _LARGEST_FILE)
    try:
        width, height = _declared_size(content)
    except UnreadableFile:
        raise
    except struct.error as error:
        raise UnreadableFile(
            f"is damaged or cut short: a part extends beyond its end; {_SAVE_ANEW}"
        ) from error
    except ValueError as error:
        raise UnreadableFile(f"is damaged or cut short ({error}); {_SAVE_ANEW}") from error
    if not 0 < width * height <= _MOST_PIXELS:
        raise UnreadableFile(
            f"declares {width} by {height} pixels; a picture may have up to {_MOST_PIXELS / 1e6:.0f} million"
        )
    with _opencv_silent():  # the error below says what is wrong
        try:
            image = cv2.imdecode(np.frombuffer(content, np.uint8), _AS_STORED)
        except cv2.error:
            image = None
    if image is None:
        raise UnreadableFile(f"is damaged, or not a picture that OpenCV can read; {_SAVE_ANEW}")
    return np.asarray(image)


@contextmanager
def _opencv_silent() -> Iterator[None]:
    """Keep OpenCV from writing to stderr, in versions that can be silenced."""
    log = getattr(cv2.utils, "logging", None)
    if log is None:
        yield
        return
    loud = log.getLogLevel()
    log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        log.setLogLevel(loud)


def _declared_size(content: bytes) -> tuple[int, int]:
    """Width and height from a file's header.

    Raises:
        UnreadableFile: the file is of another kind.
        ValueError, struct.error: the file is damaged.
    """
    if content.startswith(_PNG):
        return _png_size(content)
    if content.startswith(b"BM"):
        width, height = struct.unpack_from("<ii", content, 18)
        return abs(width), abs(height)
    if re.match(rb"P[25]\s", content):
        numbers = re.match(rb"P[25](?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})\s", content)
        if numbers is None:
            raise ValueError("no width and height")
        return int(numbers[1]), int(numbers[2])
    if content[:4] in (b"II*\0", b"MM\0*"):
        return _tiff_size(content, "<" if content.startswith(b"II") else ">")
    raise UnreadableFile(f"not a picture of a supported kind (PNG, BMP, PGM, TIFF); {_SAVE_ANEW}")


def _png_size(content: bytes) -> tuple[int, int]:
    place, ended = len(_PNG), False
    while not ended:
        (length,) = struct.unpack_from(">I", content, place)
        (checksum,) = struct.unpack_from(">I", content, place + 8 + length)
        if zlib.crc32(content[place + 4 : place + 8 + length]) != checksum:
            raise ValueError(f"wrong checksum of the part at byte {place}")
        ended = content[place + 4 : place + 8] == b"IEND"
        place += 12 + length
    if content[12:16] != b"IHDR":
        raise ValueError("no header")
    width, height = struct.unpack_from(">II", content, 16)
    return width, height


def _tiff_size(content: bytes, order: str) -> tuple[int, int]:
    """Width and height of the first picture, the only one that is read."""
    (directory,) = struct.unpack_from(f"{order}I", content, 4)
    (count,) = struct.unpack_from(f"{order}H", content, directory)
    found: dict[int, int] = {}
    for place in range(directory + 2, directory + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(f"{order}HH", content, place)
        if tag in (_TIFF_WIDTH, _TIFF_HEIGHT):
            found.setdefault(
                tag, struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", content, place + 8)[0]
            )
    if len(found) < 2:
        raise ValueError("no width and height")
    return found[_TIFF_WIDTH], found[_TIFF_HEIGHT]
