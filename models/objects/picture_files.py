"""Pictures from disk: what a file declares is checked before it is believed."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from models.bounded_files import UnreadableFile, read_bounded

LARGEST_FILE = 64 * 2**20
"""Bytes."""

MOST_PIXELS = 50_000_000

_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257  # tags
_SAVE_ANEW = "save it once more, as a greyscale PNG"


def read_picture(path: Path) -> NDArray[Any]:
    """(H, W) or (H, W, channels) of a PNG, BMP, PGM or TIFF file, as stored.

    OpenCV believes what a file declares: it makes room for gigabytes, and takes seconds for it, though the
    file has a few bytes.

    Raises:
        UnreadableFile: no such file, one that is too large, of another kind, or damaged, or more pixels than
            `MOST_PIXELS`.
    """
    content = read_bounded(path, LARGEST_FILE)
    try:
        width, height = _declared_size(content)
    except UnreadableFile:
        raise
    except struct.error as error:
        raise UnreadableFile(
            f"is damaged or cut short: a part goes on beyond its end; {_SAVE_ANEW}"
        ) from error
    except ValueError as error:
        raise UnreadableFile(f"is damaged or cut short ({error}); {_SAVE_ANEW}") from error
    if not 0 < width * height <= MOST_PIXELS:
        raise UnreadableFile(
            f"declares {width} by {height} pixels; a picture may have up to {MOST_PIXELS / 1e6:.0f} million"
        )
    with _opencv_silent():  # what is wrong is told below
        try:
            image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            image = None
    if image is None:
        raise UnreadableFile(f"is damaged, or not a picture that OpenCV can read; {_SAVE_ANEW}")
    return np.asarray(image)


@contextmanager
def _opencv_silent() -> Iterator[None]:
    """OpenCV writes nothing to stderr; versions that cannot be silenced do."""
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
    """Width and height in a file's header.

    Raises:
        UnreadableFile: of another kind.
        ValueError, struct.error: damaged.
    """
    if content.startswith(_PNG):
        return _png_size(content)
    if content.startswith(b"BM"):
        width, height = struct.unpack_from("<ii", content, 18)
        return abs(width), abs(height)
    if re.match(rb"P[25]\s", content):
        numbers = re.match(rb"P[25](?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,9})\s", content)
        if numbers is None:
            raise ValueError("no width and height")
        return int(numbers[1]), int(numbers[2])
    if content[:4] in (b"II*\0", b"MM\0*"):
        return _tiff_size(content, "<" if content.startswith(b"II") else ">")
    raise UnreadableFile(f"not a picture of a kind that is read (PNG, BMP, PGM, TIFF); {_SAVE_ANEW}")


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
    """Of the first picture, of which alone is read."""
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
