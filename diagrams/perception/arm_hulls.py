"""Where the arm is, as hulls for masking it in depth pictures, from its joint angles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.geometry import Capsule, Cylinder, Ellipsoid, Role, SceneGraph, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex

from models.perception.arm_mask import Hull
from models.physics.cell_grid import FloatArray

_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
_LONGITUDE, _LATITUDE = np.meshgrid(np.linspace(0, 2 * np.pi, 24, endpoint=False), np.linspace(-1.5, 1.5, 13))
_SPHERE = np.column_stack(
    [
        (np.cos(_LONGITUDE) * np.cos(_LATITUDE)).ravel(),
        (np.sin(_LONGITUDE) * np.cos(_LATITUDE)).ravel(),
        np.sin(_LATITUDE).ravel(),
    ]
)


class ArmHulls:
    """Hulls around everything of some model instances that a camera sees, at given joint angles.

    Called with the positions (7,) of the first instance, rad, it returns a list of `Hull`. The other
    instances, such as a gripper, keep their default positions.
    """

    def __init__(
        self, plant: MultibodyPlant, scene_graph: SceneGraph, instances: Sequence[ModelInstanceIndex]
    ) -> None:
        """Collect the shapes with a perception role.

        Args:
            plant: finalized.
            scene_graph: the one that the plant is registered with.
            instances: the arm, then what it carries.

        Raises:
            ValueError: the plant is not finalized, or there are no instances.
        """
        if not plant.is_finalized():
            raise ValueError("arm hulls: finalize the plant first")
        if len(instances) == 0:
            raise ValueError("arm hulls: name at least the model instance of the arm")
        self._plant = plant
        self._context = plant.CreateDefaultContext()  # scratch: every call sets the positions
        self._arm = instances[0]
        inspector = scene_graph.model_inspector()
        self._shapes: list[tuple[BodyIndex, FloatArray, float]] = []
        for instance in instances:
            for body in plant.GetBodyIndices(instance):
                frame = plant.GetBodyFrameIdOrThrow(body)
                for geometry in inspector.GetGeometries(frame, Role.kPerception):
                    X_BG = inspector.GetPoseInFrame(geometry)
                    points, radius = _hull_in_frame(inspector, geometry)
                    self._shapes.append((body, _moved(X_BG, points), radius))

    def __call__(self, q: Any) -> list[Hull]:
        """Hulls in W at joint angles q (7,), rad."""
        context = self._context
        self._plant.SetPositions(context, self._arm, q)
        poses: dict[BodyIndex, RigidTransform] = {}
        hulls = []
        for body, points, radius in self._shapes:
            if body not in poses:
                poses[body] = self._plant.EvalBodyPoseInWorld(context, self._plant.get_body(body))
            hulls.append(Hull(_moved(poses[body], points), radius))
        return hulls


def _hull_in_frame(inspector: Any, geometry: Any) -> tuple[FloatArray, float]:
    """Centres (k, 3) of a shape's balls in the geometry's frame and their radius, m."""
    shape = inspector.GetShape(geometry)
    if isinstance(shape, Sphere):
        return np.zeros((1, 3)), shape.radius()
    if isinstance(shape, Capsule):
        return np.array([[0, 0, -0.5], [0, 0, 0.5]]) * shape.length(), shape.radius()
    if isinstance(shape, Cylinder):
        turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        rim = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(16)]) * shape.radius()
        half = np.array([0, 0, shape.length() / 2])
        return np.concatenate([rim - half, rim + half]), 0.0
    if isinstance(shape, Ellipsoid):
        return _SPHERE * [shape.a(), shape.b(), shape.c()], 0.0
    box = inspector.GetObbInGeometryFrame(geometry)
    if box is None:
        raise ValueError("arm hulls: the arm has a shape without bounds, such as a half space")
    return _moved(box.pose(), _CORNERS * box.half_width()), 0.0


def _moved(X: RigidTransform, points: FloatArray) -> FloatArray:
    return points @ X.rotation().matrix().T + X.translation()
