"""Distances of the arm from what it must not touch: table, stand, object and itself.

`ArmClearance` covers the arm with balls; `Surroundings` refuses pushes that come too close to something.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Capsule, Cylinder, Role, SceneGraph, Shape, Sphere
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex

from slipmap.diagrams.execution.arm_motion import MotionRefused, Plan
from slipmap.diagrams.perception.sight import moved
from slipmap.diagrams.station.arm import STAND_RADIUS, default_arm_base, lone_arm, stand_head
from slipmap.diagrams.station.table import THICKNESS
from slipmap.models.geometry import seen_from
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.planners.table_push import TablePush

APART = 0.005  # distance that the arm keeps from table and object, except for the finger while it is low, m
_BALLS_APART = 0.5  # spacing along a shape, in its radii
_BALLS_OF_DISC = 12
_FIXED = ("iiwa_link_0", "iiwa_link_1", "iiwa_link_2")  # links that hand and forearm could hit
_NEXT = ("iiwa_link_3", "iiwa_link_4")  # always close to those
_FAR = 0.05  # m; larger distances need not be known
_FINGER = ("left_finger", "right_finger")  # closed, they form the finger that pushes
_EVERY = 0.08  # s between the postures of a push that are checked


@dataclass(frozen=True, eq=False)
class Obstacle:
    """The object as upright boxes, one per cell.

    Raises:
        ValueError: a height or a pose that is not a number, which would seem infinitely far away.
    """

    grid: CellGrid
    heights: FloatArray  # (n,) of the object's top over each cell, m
    pose: FloatArray  # (3,) of the object in the world, m and rad; it lies on the table

    def __post_init__(self) -> None:
        if not (np.isfinite(self.heights).all() and np.isfinite(self.pose).all()):
            raise ValueError("obstacle: the object's heights and pose must be finite")

    def distance(self, points: FloatArray) -> FloatArray:
        """(...) signed distance of points (..., 3) in the world from the nearest box, m."""
        local = seen_from(points, self.pose)
        aside = np.abs(local[..., None, :] - self.grid.centers) - self.grid.width / 2
        above = np.abs(points[..., 2, None] - self.heights / 2) - self.heights / 2
        return np.asarray(_box_distance(np.concatenate([aside, above[..., None]], axis=-1)).min(axis=-1))


class ArmClearance:
    """Distances of the default arm, covered with balls, from table, stand, itself and an object.

    Args:
        table: whose top is at z = 0.
    """

    def __init__(self, table: Table) -> None:
        self._table, self._head = table, stand_head(default_arm_base())
        plant, scene_graph, self._arm = lone_arm()
        self._plant, self._context = plant, plant.CreateDefaultContext()
        self._balls = _balls(plant, scene_graph, (self._arm.iiwa, self._arm.gripper))
        names = np.concatenate(
            [np.full(len(radii), plant.get_body(body).name()) for body, _, radii in self._balls]
        )
        self._radii = np.concatenate([radii for _, _, radii in self._balls])
        self._fixed = np.isin(names, _FIXED)
        self._free = ~self._fixed & ~np.isin(names, _NEXT)
        gripper = [plant.get_body(body).name() for body in plant.GetBodyIndices(self._arm.gripper)]
        self._gripper = np.isin(names, gripper)
        self._finger = np.isin(names, _FINGER)

    def centers(self, q: FloatArray, opening: float) -> FloatArray:
        """(B, 3) centres of the balls in the world at joint angles (7,), rad, and an opening, m."""
        self._plant.SetPositions(self._context, self._arm.iiwa, q)
        self._plant.SetPositions(self._context, self._arm.gripper, np.array([-opening, opening]) / 2)
        placed = []
        for body, points, _ in self._balls:
            X_WB = self._plant.EvalBodyPoseInWorld(self._context, self._plant.get_body(body))
            placed.append(moved(X_WB, points))
        return np.concatenate(placed)

    def of(
        self, q: FloatArray, opening: float, obstacle: Obstacle | None = None, *, holding: bool = False
    ) -> float:
        """Smallest distance at joint angles (7,), rad, and an opening of the gripper, m; negative if inside.

        Args:
            obstacle: the object, if it counts.
            holding: whether the gripper may touch the object.
        """
        moving, centers = ~self._fixed, self.centers(q, opening)
        near = moving & ~self._gripper if holding else moving
        least = self._from_surroundings(centers, moving)
        if obstacle is not None:
            least = min(least, float((obstacle.distance(centers[near]) - self._radii[near]).min()))
        return least

    def of_pushing(
        self, postures: FloatArray, obstacle: Obstacle | None, moved: FloatArray, *, low: bool
    ) -> float:
        """Smallest distance over several postures with the gripper closed, m.

        Args:
            postures: (n, 7) joint angles, rad.
            obstacle: the object at its initial pose, if it counts.
            moved: (n, 2) displacement that it may have undergone since, m; it may also not have moved.
            low: whether the finger may touch table and object.
        """
        counted = ~self._fixed & ~self._finger if low else ~self._fixed
        centers = np.array([self.centers(q, 0.0) for q in postures])
        least = self._from_surroundings(centers, counted)
        if obstacle is not None:
            points, radii = centers[:, counted], self._radii[counted]
            near = points[..., 2] - radii < obstacle.heights.max() + _FAR
            where, ball = np.nonzero(near)
            shift = np.column_stack([moved, np.zeros(len(moved))])[where]
            both = np.array([points[near], points[near] - shift])
            least = min(least, float((obstacle.distance(both) - radii[ball]).min(initial=_FAR)))
        return least

    def _from_surroundings(self, centers: FloatArray, moving: NDArray[np.bool_]) -> float:
        """Smallest distance of the moving parts from table, stand and base; centres are (..., B, 3)."""
        free = self._free & moving
        points, radii = centers[..., moving, :], self._radii[moving]
        apart = np.linalg.norm(centers[..., free, None, :] - centers[..., None, self._fixed, :], axis=-1)
        return min(
            float((self._from_table(points) - radii).min()),
            float((self._from_stand(points) - radii).min()),
            float((apart.min(axis=-1) - self._radii[free]).min() - self._radii[self._fixed].max()),
        )

    def _from_table(self, points: FloatArray) -> FloatArray:
        beside = points[..., :2] - np.asarray(self._table.center)
        above = np.abs(points[..., 2:] + THICKNESS / 2) - THICKNESS / 2
        if self._table.radius is not None:
            aside = np.linalg.norm(beside, axis=-1, keepdims=True) - self._table.radius
        else:
            aside = np.abs(beside) - np.asarray(self._table.size) / 2
        return _box_distance(np.concatenate([aside, above], axis=-1))

    def _from_stand(self, points: FloatArray) -> FloatArray:
        beside, below = points[..., :2] - self._head[:2], np.maximum(points[..., 2] - self._head[2], 0.0)
        return np.asarray(np.sqrt((beside**2).sum(axis=-1) + below**2) - STAND_RADIUS)


def _box_distance(outside: FloatArray) -> FloatArray:
    """(...) signed distance from a box, given signed distances (..., d) from the slabs that form it."""
    return np.asarray(
        np.linalg.norm(np.maximum(outside, 0.0), axis=-1) + np.minimum(outside.max(axis=-1), 0.0)
    )


def _balls(
    plant: MultibodyPlant, scene_graph: SceneGraph, instances: tuple[ModelInstanceIndex, ...]
) -> list[tuple[BodyIndex, FloatArray, FloatArray]]:
    """Per body: centres (b, 3) in its frame and radii (b,) of balls along its collision shapes, m."""
    inspector = scene_graph.model_inspector()
    result = []
    for body in (body for instance in instances for body in plant.GetBodyIndices(instance)):
        centers, radii = [np.zeros((0, 3))], [np.zeros(0)]
        for geometry in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(body), Role.kProximity):
            points, radius = _cover(inspector.GetShape(geometry))
            centers.append(moved(inspector.GetPoseInFrame(geometry), points))
            radii.append(np.full(len(points), radius))
        if len(centers) > 1:
            result.append((body, np.concatenate(centers), np.concatenate(radii)))
    return result


def _cover(shape: Shape) -> tuple[FloatArray, float]:
    """Centres (b, 3) of balls along a shape's z axis, and their radius; along the rim of a thin disc."""
    if isinstance(shape, Sphere):
        return np.zeros((1, 3)), float(shape.radius())
    if isinstance(shape, Cylinder) and shape.length() < shape.radius():
        # Balls of its own radius would stick out of it.
        radius, turn = shape.length() / 2, np.linspace(0.0, 2 * np.pi, _BALLS_OF_DISC, endpoint=False)
        return (shape.radius() - radius) * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn]), radius
    if isinstance(shape, Capsule):
        half = shape.length() / 2
    elif isinstance(shape, Cylinder):
        half = max(shape.length() / 2 - shape.radius(), 0.0)
    else:
        raise ValueError(f"arm clearance: the collision shape {type(shape).__name__} is not supported")
    along = np.linspace(-half, half, max(int(np.ceil(2 * half / (_BALLS_APART * shape.radius()))) + 1, 1))
    return np.column_stack([np.zeros((len(along), 2)), along]), float(shape.radius())


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Table, the arm's own stand and base, and the object."""

    clearance: ArmClearance
    obstacle: Obstacle | None = None  # the object where it lies before the push; None if there is none

    def check(self, plan: Plan, push: TablePush) -> None:
        """Refuse a push during which the arm comes too close to something.

        During the push, the object is checked both at its initial place and displaced as far as the finger
        moved.

        Raises:
            MotionRefused: with the distance and the phase.
        """
        pushing = [phase.mode for phase in plan.phases].index("pushing")
        for number, phase in enumerate(plan.phases):
            times = np.linspace(0.0, phase.duration, max(int(np.ceil(phase.duration / _EVERY)), 4) + 1)
            share = times / phase.duration if number == pushing else np.full_like(times, number > pushing)
            distance = self.clearance.of_pushing(
                phase.trajectory.vector_values(times).T,
                self.obstacle,
                np.outer(share, push.end - push.begin),
                low=0 < number < len(plan.phases) - 1,
            )
            if distance < APART:
                raise MotionRefused(
                    f"while {phase.mode} the arm would come as near as {1e3 * distance:.0f} mm to the object,"
                    f" the table or itself; it must keep {1e3 * APART:.0f} mm"
                )
