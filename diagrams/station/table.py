"""The table, round or rectangular with its top at z = 0 of the world, and the floor below it."""

import numpy as np
from pydrake.geometry import Box, Convex, Cylinder, Shape
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody, SpatialInertia

from slipmap.diagrams.station.sliding_object import DISC, table_contact
from slipmap.models.measurements.push_dataset import Table

HEIGHT = 0.72  # height of the table top above the floor, m
TABLE_FRICTION = 0.6  # friction coefficient of the table's own geometry
THICKNESS = 0.03  # thickness of the table top, m
ROUND_TABLE = Table("round", (0.0, 0.0), radius=0.5)  # the table of the paper's experiments
_SIDES = 360  # of the prism that represents a round top
_COVER = 0.002  # m; upper layer of the top
_FLOOR = (8.0, 8.0, 0.2)  # m
_TOP = (0.84, 0.82, 0.78, 1.0)
_WOOD = (0.47, 0.34, 0.22, 1.0)
_METAL = (0.25, 0.26, 0.28, 1.0)
_GROUND = (0.38, 0.40, 0.43, 1.0)


def add_table(
    plant: MultibodyPlant, table: Table = ROUND_TABLE, friction: float = TABLE_FRICTION
) -> ModelInstanceIndex:
    """Add a table and the floor, fixed to the world, in a model instance named "table".

    Drake reports contacts between a cylinder's rim and a convex body with wrong normals: a block that tips
    over a round table's rim would be thrown off. A round top is therefore a prism with 360 sides, plus a
    cylinder that only the many feet of `add_sliding_object` touch, for which it is accurate and fast.

    Args:
        plant: registered with a scene graph, not finalized.
        friction: friction coefficient of the table's own geometry (the object's feet compensate for it).

    Raises:
        ValueError: a friction that is not positive.
    """
    if not friction > 0:
        raise ValueError(f"table: friction must be positive, got {friction}")
    instance = plant.AddModelInstance("table")
    body = plant.AddRigidBody("table", instance, SpatialInertia.SolidBoxWithMass(20.0, 1.0, 1.0, HEIGHT))
    plant.WeldFrames(plant.world_frame(), body.body_frame(), RigidTransform(np.array([*table.center, 0.0])))
    contact = table_contact(friction)
    plate = _plate(table, THICKNESS)
    top = plate if table.shape == "rectangle" else _prism(plate)
    plant.RegisterCollisionGeometry(body, _down(THICKNESS / 2), top, "top", contact)
    if table.shape == "round":
        disc = plant.AddRigidBody(DISC, instance, SpatialInertia.SolidBoxWithMass(1.0, 1.0, 1.0, THICKNESS))
        plant.WeldFrames(body.body_frame(), disc.body_frame())
        plant.RegisterCollisionGeometry(disc, _down(THICKNESS / 2), plate, DISC, contact)
    floor, below = Box(*_FLOOR), _down(HEIGHT + _FLOOR[2] / 2)
    plant.RegisterCollisionGeometry(body, below, floor, "floor", contact)
    plant.RegisterVisualGeometry(body, below, floor, "floor", _GROUND)
    plant.RegisterVisualGeometry(body, _down(_COVER / 2), _plate(table, _COVER), "cover", _TOP)
    board = _plate(table, THICKNESS - _COVER, 5e-4)
    plant.RegisterVisualGeometry(body, _down((THICKNESS + _COVER) / 2), board, "board", _WOOD)
    _add_legs(plant, body, table)
    return instance


def _plate(table: Table, thickness: float, inset: float = 0.0) -> Shape:
    if table.shape == "round":
        assert table.radius is not None  # see Table
        return Cylinder(table.radius - inset, thickness)
    assert table.size is not None
    return Box(table.size[0] - 2 * inset, table.size[1] - 2 * inset, thickness)


def _prism(cylinder: Cylinder) -> Convex:
    """An upright prism whose sides cross the cylinder's circle, with an error of 0.02 mm at 0.5 m."""
    turn = 2 * np.pi * np.arange(_SIDES) / _SIDES
    radius = cylinder.radius() / np.sqrt(np.cos(np.pi / _SIDES))
    ring = radius * np.array([np.cos(turn), np.sin(turn)])
    half = cylinder.length() / 2
    ends = [np.vstack([ring, np.full(_SIDES, z)]) for z in (-half, half)]
    return Convex(points=np.hstack(ends), label="round table")


def _add_legs(plant: MultibodyPlant, body: RigidBody, table: Table) -> None:
    length = HEIGHT - THICKNESS
    middle = THICKNESS + length / 2
    if table.radius is not None:
        foot = 0.55 * table.radius
        plant.RegisterVisualGeometry(body, _down(middle), Cylinder(0.04, length), "column", _METAL)
        plant.RegisterVisualGeometry(body, _down(HEIGHT - 0.01), Cylinder(foot, 0.02), "foot", _METAL)
    elif table.size is not None:
        x, y = (side / 2 - min(0.05, side / 4) for side in table.size)
        for index, place in enumerate(((x, y), (-x, y), (-x, -y), (x, -y))):
            X_TL = RigidTransform(np.array([*place, -middle]))
            plant.RegisterVisualGeometry(body, X_TL, Box(0.05, 0.05, length), f"leg_{index}", _METAL)


def _down(depth: float) -> RigidTransform:
    return RigidTransform(np.array([0.0, 0.0, -depth]))
