"""What the first look saw, kept so that a later process sees the same object in the same frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from models.bounded_files import check_archive
from models.perception.camera import DepthImage, PinholeCamera, View
from models.perception.first_look import first_look
from models.perception.object_mask import Mask
from models.perception.seen_object import SeenObject
from models.physics.cell_grid import FloatArray

LARGEST_FILE = 2**29
"""Bytes, unpacked; pictures are at most 4096 by 4096."""


@dataclass(frozen=True, eq=False)
class FirstPicture:
    """The picture from which an object was cut into cells.

    Attributes:
        depth: (H, W) median of the pictures of the first look, m.
        X_WC: (4, 4) pose of the camera in W.
        blocked: (H, W) pixels that showed the arm.
        cells: wanted number of them.
        noisy, missing: see `PictureHistory`.
    """

    depth: DepthImage
    X_WC: FloatArray
    blocked: Mask
    cells: int
    noisy: bool
    missing: float

    def seen(self, camera: PinholeCamera) -> SeenObject:
        """What the first look found.

        Raises:
            NoTable, ObjectNotSeen, ValueError: see `first_look`.
        """
        return first_look([self.depth], View(camera, self.X_WC), self.cells, self.blocked)

    def save(self, file: IO[bytes]) -> None:
        """Write it, compressed, to a binary file."""
        np.savez_compressed(file, **vars(self))

    @staticmethod
    def load(path: Path) -> FirstPicture:
        """Read what `save` wrote.

        Raises:
            OSError, ValueError, KeyError, BadZipFile: the file cannot be read, or is another.
        """
        check_archive(path, LARGEST_FILE)
        with np.load(path, allow_pickle=False) as file:
            return FirstPicture(
                file["depth"],
                file["X_WC"],
                file["blocked"],
                int(file["cells"]),
                bool(file["noisy"]),
                float(file["missing"]),
            )
