"""What the first look finds: an object's footprint, heights and cells, in its own frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.perception.edge_kernels import Shape
from models.perception.footprint import Outline
from models.perception.relief import Relief
from models.perception.table_plane import TablePlane
from models.physics.cell_grid import CellGrid, FloatArray


@dataclass(frozen=True, eq=False)
class SeenObject:
    """An object as the camera saw it at rest, in its own frame.

    The object frame O has its origin at the centroid of the footprint's area, on the table; at the first look
    its axes are parallel to those of W, to the fraction of a degree with which a pose can be measured.

    Attributes:
        grid: cells and outline in O.
        cell_heights: (n,) median height of the object's top over each cell, m.
        first_pose: (3,) x, y, theta of O in W at the first look, measured in the same way as later poses, so
            that their difference is the object's motion; theta is nearly 0.
        outline: points along the rings in O, with the height of the edge.
        rim_heights: (m,) of the object just inside the outline's points, m: smaller where it is rounded.
        inner_points: (k, 2) points inside in O, m, on a square grid.
        inner_heights: (k,) of the object's top there, m.
        inner_slopes: (k, 2) of the top there, along O's axes.
        relief: heights over the whole footprint.
        table: plane of the table in W.
    """

    grid: CellGrid
    cell_heights: FloatArray
    first_pose: FloatArray
    outline: Outline
    rim_heights: FloatArray
    inner_points: FloatArray
    inner_heights: FloatArray
    inner_slopes: FloatArray
    relief: Relief
    table: TablePlane

    @cached_property
    def shape(self) -> Shape:
        """The same for kernels."""
        parts = (
            self.outline.points, self.outline.normals, self.outline.heights, self.rim_heights,
            self.inner_points, self.inner_heights, self.inner_slopes,
        )  # fmt: skip
        return Shape(self.relief.land(self.table), *(np.array(part, float, order="C") for part in parts))
