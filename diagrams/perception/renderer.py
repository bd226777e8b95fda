"""Whether this machine can render depth pictures, found out before Drake takes the process down with it.

A renderer in the plant's own scene graph would be told the pose of every shape at every step, as contacts
are found there: with the station's eighty shapes that takes as long as the dynamics of the arm.
"""

from __future__ import annotations

import functools
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

from pydrake.common.cpp_param import List
from pydrake.common.value import Value
from pydrake.geometry import FrameId, FramePoseVector, GeometryFrame, GeometrySet, Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, DiagramBuilder

from slipmap.diagrams.perception.system_libraries import RENDER, RENDERING_PACKAGES
from slipmap.diagrams.systems.python_system import PythonSystem

_PATIENCE = 60.0  # s; a picture takes half a second
_NEAR = 1e-3  # m


class RendererUnavailable(RuntimeError):
    """Depth pictures cannot be rendered here. The text is one paragraph that says what to install."""


@functools.cache
def require_renderer() -> None:
    """Render one small picture in a process of its own; the answer is kept.

    A missing or broken OpenGL library does not raise an error in Drake: the process dies. A trial in another
    process turns that into an exception.

    Raises:
        RendererUnavailable: the trial failed.
    """
    command = [sys.executable, "-c", RENDER]
    try:
        result = subprocess.run(
            command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL, timeout=_PATIENCE
        )
    except subprocess.TimeoutExpired:
        raise RendererUnavailable(_advice(f"no picture after {_PATIENCE:.0f} s")) from None
    if result.returncode != 0:
        lines = result.stderr.strip().splitlines()
        raise RendererUnavailable(_advice(lines[-1] if lines else f"exit code {result.returncode}"))


def render_one_picture() -> None:
    """Render a wall and look whether it is where it should be; where libraries are missing, this may end the
    process.

    Raises:
        RuntimeError: the picture shows something else.
    """
    from pydrake.geometry import (
        Box,
        ClippingRange,
        ColorRenderCamera,
        DepthRange,
        DepthRenderCamera,
        GeometryInstance,
        MakePhongIllustrationProperties,
        MakeRenderEngineVtk,
        PerceptionProperties,
        RenderCameraCore,
        RenderEngineVtkParams,
        SceneGraph,
    )
    from pydrake.math import RigidTransform
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.sensors import CameraInfo, RgbdSensor

    builder = DiagramBuilder()
    scene_graph: Any = builder.AddSystem(SceneGraph())
    scene_graph.AddRenderer("trial", MakeRenderEngineVtk(RenderEngineVtkParams()))
    thickness, away = 0.1, 1.0
    wall = GeometryInstance(
        RigidTransform([0.0, 0.0, away + thickness / 2]), Box(9.0, 9.0, thickness), "wall"
    )
    wall.set_perception_properties(
        PerceptionProperties(MakePhongIllustrationProperties([0.5, 0.5, 0.5, 1.0]))
    )
    scene_graph.RegisterAnchoredGeometry(scene_graph.RegisterSource("trial"), wall)
    core = RenderCameraCore("trial", CameraInfo(8, 8, 1.0), ClippingRange(0.01, 10.0), RigidTransform())
    sensor: Any = builder.AddSystem(
        RgbdSensor(
            scene_graph.world_frame_id(),
            RigidTransform(),
            ColorRenderCamera(core),
            DepthRenderCamera(core, DepthRange(0.1, 5.0)),
        )
    )
    builder.Connect(scene_graph.get_query_output_port(), sensor.query_object_input_port())
    diagram = builder.Build()
    context = sensor.GetMyContextFromRoot(diagram.CreateDefaultContext())
    depth = sensor.depth_image_32F_output_port().Eval(context).data
    if not (abs(depth - away) < _NEAR).all():
        raise RuntimeError(f"a wall {away} m away is seen at {depth.min():.3f} to {depth.max():.3f} m")


def _advice(reason: str) -> str:
    return (
        f"the camera cannot render pictures on this machine ({reason}). Rendering without a display needs "
        f"EGL and a software or hardware OpenGL driver; on Debian and Ubuntu install them with `sudo apt-get "
        f"install {' '.join(RENDERING_PACKAGES)}`, elsewhere with the packages that hold libEGL, Mesa's"
        " drivers and GLib"
    )


# What a camera sees, in a scene graph that is brought up to date only when a picture is taken.


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
