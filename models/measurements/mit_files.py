"""Pushes and objects of the MIT push dataset (Yu, Bauza, Fazeli and Rodriguez, IROS 2016), in JSON or HDF5.

The files do not describe the object. Sizes, masses and the placement of the frame come from the laboratory's
own table of shapes, published with its software (github.com/peterkty/pnpush,
pnpush_config/src/config/shape_db.py). All shapes are stainless steel, 13 mm thick; area, thickness and mass
give a density of 7.8 to 8.0 g/cm³. The butterfly `butter` is left out, since its outline exists there only as
a list of measured points.
"""

import io
import re
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slipmap.models.measurements import parsing
from slipmap.models.measurements.trial import CHANNELS, DatasetError, Role, Trial
from slipmap.models.measurements.trial_tables import COLUMNS, json_tables, trial_from_tables
from slipmap.models.physics.cell_grid import FloatArray

JSON_ENDINGS = (".json",)
HDF5_ENDINGS = (".h5", ".hdf5")
THICKNESS = 0.013  # m
FINGER_RADIUS = 0.00475  # m
_MOST_NUMBERS = 8 * 2**20  # in one HDF5 channel


def read_mit_trial(name: str, role: Role, content: bytes, where: str) -> tuple[Trial, list[str]]:
    """Read one push file; the stored force of the object on the finger is negated to give that on the object.

    Raises:
        DatasetError: see `trial_from_tables`; the arrays `object_pose` and `tip_pose` must be there.
    """
    if Path(name).suffix.lower() in HDF5_ENDINGS:
        tables = _hdf5(content, where)
    else:
        tables = json_tables(parsing.mapping(parsing.parse_json(content, where), where), where)
    if "ft_wrench" in tables:
        tables["ft_wrench"] = tables["ft_wrench"] * np.array([1.0, -1.0, -1.0, -1.0])
    return trial_from_tables(name, role, tables, where)


def named_shape(files: Sequence[Path]) -> str | None:
    """The shape in the file names, as in motion_surface=abs_shape=rect1_v=20.json; refuses different ones."""
    found: dict[str, Path] = {}
    for file in files:
        match = re.search(r"shape=([A-Za-z0-9]+)", file.name)
        if match:
            found.setdefault(match[1], file)
    if len(found) > 1:
        (one, first), (other, second) = sorted(found.items())[:2]
        raise DatasetError(
            f"{first.parent}: {first.name} is about {one}, but {second.name} is about {other}; a dataset has"
            " one object, so put the files of each object into a separate folder"
        )
    return next(iter(found), None)


def surface_warnings(files: Sequence[Path]) -> list[str]:
    """A warning if the file names give more than one surface, since one friction cannot fit them all."""
    surfaces = {match[1] for file in files if (match := re.search(r"surface=([A-Za-z0-9]+)", file.name))}
    if len(surfaces) < 2:
        return []
    return [
        f"{files[0].parent}: the file names give different surfaces, {', '.join(sorted(surfaces))}; their"
        " friction will differ"
    ]


def _hdf5(content: bytes, where: str) -> dict[str, FloatArray]:
    import h5py

    tables: dict[str, FloatArray] = {}
    with parsing.reading(where, "HDF5"), h5py.File(io.BytesIO(content), "r") as file:
        for key in CHANNELS:
            if isinstance(file.get(key, getlink=True), h5py.HardLink):
                tables[key] = _hdf5_table(file[key], f"{where}, {key}")
    return tables


def _hdf5_table(item: object, where: str) -> FloatArray:
    import h5py

    if not isinstance(item, h5py.Dataset) or item.is_virtual or item.external:
        raise DatasetError(f"{where}: must be an array inside the file")
    if item.dtype.kind not in "fiu":
        raise DatasetError(f"{where}: must contain numbers, but has the type {item.dtype}")
    if item.size is not None and item.size > _MOST_NUMBERS:
        raise DatasetError(
            f"{where}: has {item.size} numbers, but a channel may have at most {_MOST_NUMBERS}"
        )
    if item.size == 0:
        return np.empty((0, COLUMNS))
    if item.ndim != 2 or item.shape[1] != COLUMNS:
        raise DatasetError(f"{where}: needs rows of {COLUMNS} columns, but has the shape {item.shape}")
    return np.asarray(item[...], dtype=float)


class MitShape(NamedTuple):
    """Outline (k, 2) counter-clockwise in the tracked frame, m, and mass, kg."""

    outline: FloatArray
    mass: float


def mit_shape(name: str, where: str) -> MitShape:
    """A shape of the MIT push dataset by its name there; refuses other names."""
    if name not in MIT_SHAPES:
        near = get_close_matches(name, MIT_SHAPES, n=1)
        hint = f" Did you mean {near[0]}?" if near else ""
        raise DatasetError(
            f"{where}: the outline of {name!r} is unknown; known are {', '.join(sorted(MIT_SHAPES))}.{hint}"
            " For another object, give a YAML file with the keys object and finger of a dataset.yaml"
        )
    return MIT_SHAPES[name]


def _rectangle(along_x: float, along_y: float) -> FloatArray:
    return 0.5 * np.array(
        [[along_x, along_y], [-along_x, along_y], [-along_x, -along_y], [along_x, -along_y]]
    )


def _triangle(along_x: float, along_y: float) -> FloatArray:
    """Right triangle with its right angle at the corner of rect1, which is tracked by the same plate."""
    corner = 0.045
    return np.array([[corner, corner], [corner - along_x, corner], [corner, corner - along_y]])


def _ellipse(along_x: float, along_y: float, corners: int = 96) -> FloatArray:
    """Ellipse as a polygon; 96 corners stay within 0.05 mm of the curve."""
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
