"""Where strips meet the table, against shapely."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from shapely import affinity
from shapely.ops import nearest_points

from slipmap.models.measurements.push_dataset import Table
from slipmap.planners.grasps import first_on_table, towards_table

ROUND = Table("round", (0.1, -0.05), radius=0.5)
RECTANGLE = Table("rectangle", (0.1, 0.05), size=(0.8, 0.6))
TABLES = pytest.mark.parametrize("table", [ROUND, RECTANGLE], ids=["round", "rectangle"])


def table_top(table: Table) -> shapely.Polygon:
    if table.shape == "round":
        return shapely.Point(*table.center).buffer(table.radius, quad_segs=2000)
    x, y = np.asarray(table.size) / 2
    return affinity.translate(shapely.box(-x, -y, x, y), *table.center)


def in_object(shape: shapely.Geometry, pose: np.ndarray) -> shapely.Geometry:
    moved = affinity.translate(shape, -pose[0], -pose[1])
    return affinity.rotate(moved, -pose[2], origin=(0, 0), use_radians=True)


@TABLES
def test_strip_meets_the_table_where_its_intersection_begins(table: Table) -> None:
    rng = np.random.default_rng(0)
    angle, offset = rng.uniform(-np.pi, np.pi, 20), rng.uniform(-0.4, 0.4, 20)
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    poses = np.column_stack([rng.uniform(-0.7, 0.7, (15, 2)), rng.uniform(-4, 4, 15)])
    found = first_on_table(direction, offset, poses, table, 0.02)
    for pose, row in zip(poses, found, strict=True):
        top = in_object(table_top(table), pose)
        for k in range(20):
            along_x = affinity.rotate(top, -angle[k], origin=(0, 0), use_radians=True)
            part = along_x & shapely.box(-9, offset[k] - 0.02, 9, offset[k] + 0.02)
            expected = np.inf if part.is_empty else part.bounds[0]
            assert row[k] == pytest.approx(expected, abs=1e-5)
    assert 0.1 < np.isfinite(found).mean() < 1.0


@TABLES
def test_cosine_to_the_nearest_point_of_the_table(table: Table) -> None:
    rng = np.random.default_rng(1)
    angle, offset, at = rng.uniform(-4, 4, 30), rng.uniform(-0.1, 0.1, 30), rng.uniform(-0.1, 0.1, 30)
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    pose = np.array([0.8, 0.5, 0.7])
    top = in_object(table_top(table), pose)
    cosine = towards_table(direction, offset, at, pose[None], table)[0]
    for k in range(30):
        along = direction[k]
        point = at[k] * along + offset[k] * np.array([-along[1], along[0]])
        nearest = np.array(nearest_points(top, shapely.Point(point))[0].coords[0]) - point
        assert cosine[k] == pytest.approx(along @ nearest / np.linalg.norm(nearest), abs=1e-3)
