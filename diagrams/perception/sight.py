"""Visibility of an object past the arm: the camera's view, hulls around the arm, and what they hide."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Capsule, Cylinder, Ellipsoid, Role, SceneGraph, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex
from pydrake.systems.framework import Context

from slipmap.diagrams.systems.python_system import PythonSystem
from slipmap.models.geometry import placed
from slipmap.models.perception.object_mask import Hull, draw_hulls
from slipmap.models.perception.pinhole_camera import PinholeCamera, View
from slipmap.models.perception.seen_object import SeenObject
from slipmap.models.physics.cell_grid import FloatArray


def moved(X: RigidTransform, points: FloatArray) -> FloatArray:
    """Transform points (k, 3) of a frame with pose X into the frame in which X is given."""
    return points @ X.rotation().matrix().T + X.translation()


@lru_cache(maxsize=4)
def view_from(camera: PinholeCamera, X_WC: bytes) -> View:
    """The view of a camera, cached because its rays take a while to compute.

    Args:
        X_WC: bytes of its (4, 4) pose.
    """
    return View(camera, np.frombuffer(X_WC).reshape(4, 4))


class Sight:
    """The camera's view of the table while the arm rests.

    Args:
        hulls: around the arm where it rests, see `ArmHulls`.
    """

    def __init__(self, view: View, hulls: Sequence[Hull]) -> None:
        self._view = view
        self._hidden = draw_hulls(hulls, view)

    def share(self, seen: SeenObject, pose: FloatArray) -> float:
        """Share of an object's cells that are in the picture and not hidden by the arm, at a pose (3,)."""
        places = placed(seen.grid.centers, pose)
        pixels, _ = self._view.project(seen.table.lift(places, seen.cell_heights))
        column, row = np.round(pixels).astype(int).T
        height, width = self._hidden.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        clear = ~self._hidden[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        return float((inside & clear).mean())


class ArmAside(PythonSystem):
    """Whether the whole object can be seen past the arm.

    Inputs: `arm_position` (7,) rad; `X_WC`, of the camera; `object_pose`, an `ObservedPose`; `seen_object`, a
    `SeenObject` or None. The output `aside` is a bool: whether all cells of the object, at its last pose, are
    in the picture and none is hidden by the arm; False while it is not seen.

    Args:
        arm_hulls: hulls around the arm for joint angles (7,), rad, such as `ArmHulls`.
    """

    def __init__(self, camera: PinholeCamera, arm_hulls: Callable[[FloatArray], Sequence[Hull]]) -> None:
        super().__init__()
        self._camera, self._arm_hulls = camera, arm_hulls
        self._arm = self.DeclareVectorInputPort("arm_position", 7)
        self._X_WC = self.DeclareAbstractInputPort("X_WC", Value(RigidTransform()))
        self._pose = self.DeclareAbstractInputPort("object_pose", Value[object](None))
        self._seen = self.DeclareAbstractInputPort("seen_object", Value[object](None))
        inputs = {port.ticket() for port in (self._arm, self._X_WC, self._pose, self._seen)}
        self.declare_output("aside", self._aside, inputs)

    def _aside(self, context: Context) -> bool:
        pose, seen = self._pose.Eval(context), self._seen.Eval(context)
        if seen is None or not pose.valid:
            return False
        view = view_from(self._camera, self._X_WC.Eval(context).GetAsMatrix4().tobytes())
        sight = Sight(view, self._arm_hulls(np.asarray(self._arm.Eval(context))))
        return sight.share(seen, pose.pose) == 1.0


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
    """Hulls around all visible shapes of some model instances, at given joint angles.

    Called with the positions (7,) of the first instance, rad, it returns a list of `Hull`. The other
    instances, such as a gripper, keep their default positions.

    Args:
        plant, scene_graph: finalized.
        instances: the arm, followed by whatever it carries.

    Raises:
        ValueError: the plant is not finalized, or there are no instances.
    """

    def __init__(
        self, plant: MultibodyPlant, scene_graph: SceneGraph, instances: Sequence[ModelInstanceIndex]
    ) -> None:
        if not plant.is_finalized():
            raise ValueError("arm hulls: finalize the plant first")
        if len(instances) == 0:
            raise ValueError("arm hulls: name at least the model instance of the arm")
        self._plant = plant
        self._context = plant.CreateDefaultContext()  # scratch: every call sets the positions
        self._arm = instances[0]
        inspector = scene_graph.model_inspector()
        self._shapes: list[tuple[BodyIndex, FloatArray, float]] = []
        for body in (body for instance in instances for body in plant.GetBodyIndices(instance)):
            frame = plant.GetBodyFrameIdOrThrow(body)
            for geometry in inspector.GetGeometries(frame, Role.kPerception):
                points, radius = _hull_in_frame(inspector, geometry)
                self._shapes.append((body, moved(inspector.GetPoseInFrame(geometry), points), radius))

    def __call__(self, q: Any) -> list[Hull]:
        """Hulls in W at joint angles q (7,), rad."""
        context = self._context
        self._plant.SetPositions(context, self._arm, q)
        poses: dict[BodyIndex, RigidTransform] = {}
        hulls = []
        for body, points, radius in self._shapes:
            if body not in poses:
                poses[body] = self._plant.EvalBodyPoseInWorld(context, self._plant.get_body(body))
            hulls.append(Hull(moved(poses[body], points), radius))
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
    return moved(box.pose(), _CORNERS * box.half_width()), 0.0
