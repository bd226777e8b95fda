"""Locks an object at rest until the arm is about to touch it, which saves time.

The contacts between the object's feet and the table take half the time of a plant step, even while the arm is
far away. Locking the object's body removes them from the step, and a collision filter avoids searching for
them. The only difference is that the object no longer creeps at less than the stiction tolerance, as Drake's
regularised friction allows.
"""

import numpy as np
from pydrake.common.cpp_param import List
from pydrake.common.value import Value
from pydrake.geometry import CollisionFilterDeclaration, GeometryId, GeometrySet, Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex
from pydrake.systems.framework import Context, DiscreteValues

from slipmap.diagrams.station.sliding_object import BODY, STICTION
from slipmap.diagrams.systems.python_system import PythonSystem
from slipmap.models.physics.cell_grid import FloatArray

PERIOD = 0.02  # s between two checks of the object and the arm

QUIET = 0.2
"""s for which an object must lie still before it is locked; one that starts to tip is faster by then."""

# m within which a part of the arm releases the object; an approaching part does so when it would be within
# `_ROOM` two checks later. A part that accelerates by less than 12 m/s² cannot touch it earlier.
_ROOM = 0.005
_PLACE = 12  # numbers that give the object's pose: its origin, and its axes scaled to its reach, m
_SAME = 1e-9  # m; a locked object that moved by more was placed from outside


class RestWatch(PythonSystem):
    """Watches whether the object lies still and no part of the arm is about to touch it.

    Inputs are the plant's `body_poses` and `body_spatial_velocities`, and `contact_forces`, the generalized
    ones on the arm. It is `at_rest` while the arm is not near, see `_ROOM`, after `QUIET` during which the
    arm touched nothing, no point of the object was faster than the stiction tolerance, and the object was not
    moved from outside. Distances are those of bounding boxes of single shapes along an axis of the object,
    which never exceed the distances between the shapes.

    Args:
        plant, scene_graph: finalized, with the object in it.
        arm: model instances that may come near; the first one moves the others.
    """

    def __init__(self, plant: MultibodyPlant, scene_graph: SceneGraph, arm: list[ModelInstanceIndex]) -> None:
        super().__init__()
        body = plant.GetBodyByName(BODY)
        self._object = body.index()
        corners = np.array([points for _, points in _boxes(plant, scene_graph, self._object)])
        self._reach = float(np.linalg.norm(corners, axis=-1).max())
        self._low, self._high = corners.min(axis=1), corners.max(axis=1)
        parts = [
            box for instance in arm for link in plant.GetBodyIndices(instance)
            for box in _boxes(plant, scene_graph, link)
        ]  # fmt: skip
        self._bodies = [link for link, _ in parts]
        self._corners = np.array([points for _, points in parts])
        self.DeclareAbstractInputPort("body_poses", Value[List[RigidTransform]]())
        self.DeclareAbstractInputPort("body_spatial_velocities", Value[List[SpatialVelocity]]())
        self.DeclareVectorInputPort("contact_forces", plant.num_velocities(arm[0]))
        # Time at rest, s; whether the arm is near, 1 or 0; pose at the last check, m; separation between each
        # part of the arm and each of the object along each axis of the object, m. A single number would hide
        # a part that approaches behind another.
        self.DeclareDiscreteState(2 + _PLACE + 3 * len(self._corners) * len(self._low))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._look)

    def at_rest(self, context: Context) -> bool:
        """Whether the object lies still and no part of the arm is about to touch it."""
        state = context.get_discrete_state_vector()
        return bool(state.GetAtIndex(0) > QUIET and not state.GetAtIndex(1))

    def _look(self, context: Context, values: DiscreteValues) -> None:
        V_WO = self.GetInputPort("body_spatial_velocities").Eval(context)[self._object]
        fastest = np.linalg.norm(V_WO.translational()) + self._reach * np.linalg.norm(V_WO.rotational())
        before = context.get_discrete_state_vector().value()
        if fastest >= STICTION or self.GetInputPort("contact_forces").Eval(context).any():
            values.set_value(np.zeros(len(before)))
            return
        X_WB = self.GetInputPort("body_poses").Eval(context)
        still_for, place_before, apart_before = before[0], before[2 : 2 + _PLACE], before[2 + _PLACE :]
        X_WO = X_WB[self._object]
        axes = self._reach * X_WO.rotation().matrix()
        place = np.column_stack([X_WO.translation(), axes]).ravel()
        moved = still_for > 0 and np.abs(place - place_before).max() > fastest * PERIOD + _SAME
        apart = self._apart(X_WB)
        later = apart - 2 * np.maximum(apart_before - apart, 0.0)
        near = later.reshape(-1, 3).max(axis=1).min() < _ROOM
        values.set_value(np.concatenate([[0.0 if moved else still_for + PERIOD, near], place, apart]))

    def _apart(self, X_WB: list[RigidTransform]) -> FloatArray:
        """Separation between each part of the arm and each of the object along each of its axes, m."""
        X_OW = X_WB[self._object].inverse()
        pose = {link: (X_OW @ X_WB[link]).GetAsMatrix34() for link in set(self._bodies)}
        X_OL = np.array([pose[link] for link in self._bodies])
        points = self._corners @ X_OL[:, :, :3].transpose(0, 2, 1) + X_OL[:, None, :, 3]
        low, high = points.min(axis=1)[:, None], points.max(axis=1)[:, None]
        return np.maximum(low - self._high, self._low - high).ravel()


class Hold:
    """Locks the object in a plant's Context and filters its contacts with fixed bodies.

    Args:
        plant, scene_graph: finalized, with the object in it and final collision filters.
    """

    def __init__(self, plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
        inspector = scene_graph.model_inspector()
        self._object = plant.GetBodyByName(BODY).index()
        own = plant.GetCollisionGeometriesForBody(plant.get_body(self._object))
        fixed = [
            shape for other in plant.GetBodiesWeldedTo(plant.world_body())
            for shape in plant.GetCollisionGeometriesForBody(other)
        ]  # fmt: skip
        partners: dict[tuple[GeometryId, ...], list[GeometryId]] = {}
        for shape in own:
            touched = tuple(other for other in fixed if not inspector.CollisionFiltered(shape, other))
            partners.setdefault(touched, []).append(shape)
        self._apart, self._together = CollisionFilterDeclaration(), CollisionFilterDeclaration()
        for touched, shapes in partners.items():
            if touched:
                self._apart.ExcludeBetween(GeometrySet(shapes), GeometrySet(list(touched)))
                self._together.AllowBetween(GeometrySet(shapes), GeometrySet(list(touched)))

    def set(self, plant: MultibodyPlant, scene_graph: SceneGraph, root: Context, held: bool) -> None:
        """Lock or unlock the object, unless it is in that state already.

        Args:
            plant, scene_graph: the same ones, not stored here so that Python can free them.
            root: Context of the diagram that they are in.
            held: whether to lock it.
        """
        body = plant.get_body(self._object)
        if held == body.is_locked(plant.GetMyContextFromRoot(root)):
            return
        state = plant.GetMyMutableContextFromRoot(root)
        contacts = scene_graph.collision_filter_manager(scene_graph.GetMyMutableContextFromRoot(root))
        if held:
            plant.SetVelocities(state, body.model_instance(), np.zeros(6))
            body.Lock(state)
            contacts.Apply(self._apart)
        else:
            body.Unlock(state)
            contacts.Apply(self._together)


def _boxes(
    plant: MultibodyPlant, scene_graph: SceneGraph, link: BodyIndex
) -> list[tuple[BodyIndex, FloatArray]]:
    """Shapes of a body that can touch the arm, as (8, 3) corners of bounding boxes in the body's frame, m."""
    inspector = scene_graph.model_inspector()
    result = []
    for shape in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(link), Role.kProximity):
        if "_foot_" in inspector.GetName(shape):
            continue  # within the object's blocks
        box = inspector.GetObbInGeometryFrame(shape)
        X_BX = inspector.GetPoseInFrame(shape) @ box.pose()
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
        result.append((link, (X_BX @ (signs * box.half_width()).T).T))
    return result
