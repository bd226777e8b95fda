"""The true object: what an experiment hides and the simulated world needs."""

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry import Polygon

from slipmap.models.objects import meshes
from slipmap.models.objects.images import cells_from_label_image
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Maps

DEFAULT_CELLS = 60
DEFAULT_MU_FINGER = 0.3
_PALETTE = ("#4c78a8", "#f58518", "#54a24b", "#e45756", "#72b7b2", "#b279a2", "#9d755d", "#eeca3b")


@dataclass(frozen=True, eq=False)
class Block:
    """Part of the object that a finger can touch: an upright prism on the table."""

    outline: Polygon  # footprint, may be concave and have holes, object frame, m
    height: float  # m


@dataclass(frozen=True, eq=False)
class TrueObject:
    """An object's true maps, shape and looks. The object frame has z = 0 at the underside, z up.

    Raises:
        ValueError: arrays do not fit the grid, or numbers are out of range; names the cell.
    """

    name: str  # used in messages and in the scene
    grid: CellGrid  # n cells and the outline
    labels: NDArray[np.int64]  # (n,) region of each cell, from 0
    mass: FloatArray  # (n,) kg
    mu: FloatArray  # (n,) friction coefficients with the table
    mu_finger: float  # friction coefficient with the finger
    height: FloatArray  # (n,) of the object over each cell, m
    mesh: meshes.trimesh.Trimesh  # shape that cameras see, object frame, m, with a colour on each face
    colors: FloatArray  # (R, 4) red, green, blue, opacity of each region, 0 to 1
    blocks: tuple[Block, ...]  # shape that can be touched; together they cover the outline

    def __post_init__(self) -> None:
        n = len(self.grid)
        for what, unit, low in (("mass", "kg", True), ("mu", "", False), ("height", "m", True)):
            values = np.ascontiguousarray(getattr(self, what), dtype=float)
            if values.shape != (n,):
                raise ValueError(f"{self.name}: {what} has shape {values.shape}, the grid has {n} cells")
            bad = np.flatnonzero(~np.isfinite(values) | (values <= 0 if low else values < 0))
            if len(bad):
                raise ValueError(
                    f"{self.name}: {what} of cell {bad[0]} is {values[bad[0]]} {unit}; it must be finite and "
                    f"{'positive' if low else 'not negative'}"
                )
            object.__setattr__(self, what, values)
        if not (np.isfinite(self.mu_finger) and self.mu_finger >= 0):
            raise ValueError(f"{self.name}: mu_finger must be finite and not negative, got {self.mu_finger}")
        labels = np.asarray(self.labels, dtype=np.int64)
        if labels.shape != (n,) or labels.min() < 0 or labels.max() >= len(self.colors):
            raise ValueError(
                f"{self.name}: labels must give each of {n} cells one of {len(self.colors)} regions, from 0"
            )
        object.__setattr__(self, "labels", labels)
        base = float(self.mesh.bounds[0, 2])
        if abs(base) > 1e-6:
            raise ValueError(f"{self.name}: the mesh's lowest point must be at z = 0, is at {base:.4g} m")

    @property
    def maps(self) -> Maps:
        """The truth as one hypothesis of the cell-grid model."""
        return Maps(self.mass, self.mu, np.array([self.mu_finger]))

    @property
    def total_mass(self) -> float:
        """Total mass, kg."""
        return float(self.mass.sum())

    @property
    def center_of_mass(self) -> FloatArray:
        """(3,) centre of mass, object frame, m; each cell counts as an upright box of its height."""
        r = np.column_stack([self.grid.centers, self.height / 2])
        return self.mass @ r / self.total_mass


def object_from_mesh(
    path: str | PathLike[str],
    mass: float,
    mu: float,
    *,
    mu_finger: float = DEFAULT_MU_FINGER,
    count: int = DEFAULT_CELLS,
    up: ArrayLike | None = None,
    metres_per_unit: float | None = None,
) -> TrueObject:
    """A user's object of one material, from a mesh file.

    The mesh rests on its lowest point. Mass is distributed over the cells in proportion to the object's
    height there, as in a solid body; friction is uniform.

    Args:
        path: a file that trimesh can load.
        mass: total mass, kg.
        mu, mu_finger: friction coefficients with the table and with the finger.
        count, up, metres_per_unit: as in `cells_from_mesh`.

    Raises:
        ValueError: the file cannot be used (see `cells_from_mesh`), the mesh is flat, or mass or friction is
            out of range.
    """
    source = f"mesh {Path(path)}"
    _positive(mass, f"{source}: mass", "kg")
    mesh = meshes.upright_mesh(path, up, metres_per_unit)
    try:
        grid = meshes.cells_from_mesh(mesh, count=count)
        height = cell_heights(mesh, grid)
    except ValueError as error:
        raise ValueError(f"{source}: {str(error).removeprefix('mesh: ')}") from error
    thin = np.flatnonzero(height <= 0)
    if len(thin):
        raise ValueError(
            f"{source}: it is flat over {len(thin)} of {len(grid)} cells; mass is distributed by height, so"
            " the object needs some thickness everywhere"
        )
    colors = _region_colors(1)
    return TrueObject(
        name=Path(path).stem,
        grid=grid,
        labels=np.zeros(len(grid), dtype=np.int64),
        mass=mass * height / height.sum(),
        mu=np.full(len(grid), mu),
        mu_finger=mu_finger,
        height=height,
        mesh=meshes.plainly_coloured(mesh, colors[0]),
        colors=colors,
        blocks=(Block(grid.polygon, float(height.max())),),
    )


def object_from_labels(
    path: str | PathLike[str],
    metres_per_pixel: float,
    mass: Mapping[int, float],
    mu: Mapping[int, float],
    *,
    height: float = 0.03,
    mu_finger: float = DEFAULT_MU_FINGER,
    count: int = DEFAULT_CELLS,
    background: int = 0,
) -> TrueObject:
    """A user's object of several materials, from a picture whose pixels name its segments.

    Args:
        path: picture with one channel.
        metres_per_pixel: side of a pixel, m.
        mass: label: total mass of the segment, kg, shared equally by its cells.
        mu: label: friction coefficient of the segment with the table.
        height: of the object, m.
        mu_finger: friction coefficient with the finger.
        count: wanted number of cells.
        background: label of pixels outside the object.

    Raises:
        ValueError: the picture cannot be used (see `cells_from_label_image`), or the labels of mass or
            friction are not those of the cells; names the file and the labels.
    """
    source = f"label image {Path(path)}"
    _positive(height, f"{source}: height", "m")
    grid, segments = cells_from_label_image(path, metres_per_pixel, count=count, background=background)
    names, labels = np.unique(segments, return_inverse=True)
    listed = ", ".join(str(name) for name in names)
    for what, values in (("mass", mass), ("mu", mu)):
        if set(values) != set(names.tolist()):
            raise ValueError(
                f"{source}: {what} must be given for the labels {listed} that occur in cells, got "
                f"{', '.join(str(key) for key in sorted(values)) or 'none'}"
            )
    share = np.array([mass[int(name)] for name in names]) / np.bincount(labels)
    colors = _region_colors(len(names))
    regions = _regions(grid, labels)
    edge = min(0.1 * height, 0.1 * grid.width)
    solids = [
        (meshes.lofted(part, meshes.rounded(height, edge)), colors[label])
        for label, region in enumerate(regions)
        for part in region
    ]
    return TrueObject(
        name=Path(path).stem,
        grid=grid,
        labels=labels,
        mass=share[labels],
        mu=np.array([mu[int(name)] for name in names])[labels],
        mu_finger=mu_finger,
        height=np.full(len(grid), height),
        mesh=meshes.coloured(solids),
        colors=colors,
        blocks=(Block(grid.polygon, height),),
    )


def cell_heights(mesh: meshes.trimesh.Trimesh, grid: CellGrid) -> FloatArray:
    """(n,) height of a mesh at each cell's centre, m, or at the nearest cell centre that the mesh covers."""
    height = meshes.height_over(mesh, grid.centers)
    covered = np.flatnonzero(np.isfinite(height))
    if len(covered) == 0:
        raise ValueError("mesh: covers no cell centre; are mesh and cells in the same frame?")
    apart = np.linalg.norm(grid.centers[:, None] - grid.centers[covered], axis=2)
    return height[covered[np.argmin(apart, axis=1)]]


def _regions(grid: CellGrid, labels: NDArray[np.int64]) -> list[list[Polygon]]:
    """Parts of the outline that are nearest to the cells of each label."""
    # In a square grid four Voronoi regions meet at every corner; moved a little, three do, which suits GEOS.
    moved = grid.centers + 1e-4 * grid.width * np.random.default_rng(0).uniform(-1, 1, grid.centers.shape)
    nearest = shapely.get_parts(
        shapely.voronoi_polygons(
            shapely.multipoints(moved), extend_to=grid.polygon.buffer(grid.width), ordered=True
        )
    )
    regions = []
    for label in range(int(labels.max()) + 1):
        union = shapely.union_all([nearest[cell] for cell in np.flatnonzero(labels == label)])
        parts = shapely.get_parts(shapely.intersection(union, grid.polygon))
        regions.append([p for p in parts if isinstance(p, Polygon) and p.area > 1e-3 * grid.width**2])
    return regions


def _region_colors(count: int) -> FloatArray:
    """(count, 4) distinct colours for regions; they repeat after eight."""
    codes = [_PALETTE[k % len(_PALETTE)] for k in range(count)]
    return np.array([[*(int(code[k : k + 2], 16) / 255 for k in (1, 3, 5)), 1.0] for code in codes])


def _positive(value: float, what: str, unit: str) -> None:
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"{what} must be positive, got {value} {unit}")
