"""The objects of the MIT push dataset (Yu, Bauza, Fazeli and Rodriguez, IROS 2016).

Sizes, masses and the placing of the frame are those of the laboratory's own table of shapes, published
with its software (github.com/peterkty/pnpush, pnpush_config/src/config/shape_db.py). All are stainless
steel, 13 mm thick; area, thickness and mass agree on a density of 7.8 to 8.0 g/cm³. The butterfly `butter`
is left out: its outline exists only as a list of measured points there.
"""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from models.measurements.push_dataset import DatasetError
from models.physics.cell_grid import FloatArray

THICKNESS = 0.013  # m
FINGER_RADIUS = 0.00475  # m
_ELLIPSE_CORNERS = 96  # the polygon stays within 0.05 mm of the curve


@dataclass(frozen=True, eq=False)
class MitShape:
    """Outline (k, 2) counter-clockwise in the tracked frame, m, and mass, kg."""

    outline: FloatArray
    mass: float


def mit_shape(name: str, where: str) -> MitShape:
    """A shape of the MIT push dataset by its name there.

    Raises:
        DatasetError: another name.
    """
    if name not in MIT_SHAPES:
        near = get_close_matches(name, MIT_SHAPES, n=1)
        hint = f" Did you mean {near[0]}?" if near else ""
        raise DatasetError(
            f"{where}: no outline is known of {name!r}, only of {', '.join(sorted(MIT_SHAPES))}.{hint}"
            " For another object give a YAML file with the keys object and finger of a dataset.yaml"
        )
    return MIT_SHAPES[name]


def _rectangle(along_x: float, along_y: float) -> FloatArray:
    return 0.5 * np.array(
        [[along_x, along_y], [-along_x, along_y], [-along_x, -along_y], [along_x, -along_y]]
    )


def _triangle(along_x: float, along_y: float) -> FloatArray:
    """Right triangle whose right angle sits where rect1, tracked by the same plate, has its corner."""
    corner = 0.045
    return np.array([[corner, corner], [corner - along_x, corner], [corner, corner - along_y]])


def _ellipse(along_x: float, along_y: float, corners: int = _ELLIPSE_CORNERS) -> FloatArray:
    angle = np.arange(corners) * 2.0 * np.pi / corners
    return 0.5 * np.stack([along_x * np.cos(angle), along_y * np.sin(angle)], axis=1)


MIT_SHAPES = {
    "rect1": MitShape(_rectangle(0.090, 0.090), 0.8374),
    "rect2": MitShape(_rectangle(0.08991, 0.11258), 1.045),
    "rect3": MitShape(_rectangle(0.13501, 0.08994), 1.2508),
    "tri1": MitShape(_triangle(0.12590, 0.12587), 0.8028),
    "tri2": MitShape(_triangle(0.15100, 0.12587), 0.9826),
    "tri3": MitShape(_triangle(0.1765, 0.12561), 1.1326),
    "ellip1": MitShape(_ellipse(0.105, 0.105), 0.8937),
    "ellip2": MitShape(_ellipse(0.105, 0.13089), 1.1104),
    "ellip3": MitShape(_ellipse(0.105, 0.157), 1.3338),
    "hex": MitShape(_ellipse(0.121, 0.121, corners=6), 0.9827),
}
