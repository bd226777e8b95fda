"""What a camera sees, in a scene graph that is brought up to date only when a picture is taken.

A renderer in the plant's own scene graph would be told the pose of every shape at every step, as contacts
are found there: with the station's eighty shapes that takes as long as the dynamics of the arm.
"""

from __future__ import annotations

from collections.abc import Mapping

from pydrake.common.cpp_param import List
from pydrake.common.value import Value
from pydrake.geometry import FrameId, FramePoseVector, GeometryFrame, GeometrySet, Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, DiagramBuilder

from diagrams.collectable import PythonSystem


def add_picture_scene(builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph) -> SceneGraph:
    """Add a scene graph with a copy of every shape that has a perception role.

    Args:
        builder: of the diagram that the plant is in.
        plant: finalized; nothing may be added to it afterwards.
        scene_graph: the one that the plant is registered with.

    Raises:
        ValueError: the plant is not finalized.
    """
    if not plant.is_finalized():
        raise ValueError("picture scene: finalize the plant first, so that all that can be seen is there")
    scene = builder.AddNamedSystem("picture_scene", SceneGraph())
    source = scene.RegisterSource("pictures")
    inspector = scene_graph.model_inspector()
    shapes = inspector.GetGeometryIds(GeometrySet(inspector.GetAllGeometryIds()), Role.kPerception)
    frames: dict[BodyIndex, FrameId] = {}
    for shape in sorted(shapes, key=lambda shape: shape.get_value()):
        body = plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
        copy = inspector.CloneGeometryInstance(shape)
        if body.index() == plant.world_body().index():
            scene.RegisterAnchoredGeometry(source, copy)
            continue
        if body.index() not in frames:
            frame = GeometryFrame(body.scoped_name().get_full())
            frames[body.index()] = scene.RegisterFrame(source, frame)
        scene.RegisterGeometry(source, frames[body.index()], copy)
    if frames:
        poses = builder.AddNamedSystem("picture_poses", _FramePoses(frames))
        builder.Connect(plant.get_body_poses_output_port(), poses.get_input_port())
        builder.Connect(poses.get_output_port(), scene.get_source_pose_port(source))
    return scene


class _FramePoses(PythonSystem):
    """The poses of some bodies as a scene graph takes them."""

    def __init__(self, frames: Mapping[BodyIndex, FrameId]) -> None:
        super().__init__()
        self._frames = dict(frames)
        poses = self.DeclareAbstractInputPort("body_poses", Value[List[RigidTransform]]())
        self.DeclareAbstractOutputPort(
            "frame_poses", lambda: Value(FramePoseVector()), self._calc, {poses.ticket()}
        )

    def _calc(self, context: Context, output: Value) -> None:
        X_WB = self.get_input_port().Eval(context)
        result = FramePoseVector()
        for body, frame in self._frames.items():
            result.set_value(frame, X_WB[body])
        output.set_value(result)
