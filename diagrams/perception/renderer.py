"""Checks whether this machine can render depth pictures, before Drake would crash the process."""

import functools
import subprocess
import sys
from typing import Any

from pydrake import geometry
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from slipmap.diagrams.perception.system_libraries import RENDER, RENDERING_PACKAGES
from slipmap.models.files import BadInput

_PATIENCE = 60.0  # s; a picture takes half a second
_NEAR = 1e-3  # m


class RendererUnavailable(BadInput, RuntimeError):
    """Depth pictures cannot be rendered on this machine. The text, one paragraph, says what to install."""


@functools.cache
def require_renderer() -> None:
    """Render one small picture in a separate process; the result is cached.

    With a missing or broken OpenGL library, Drake does not raise an error: the process dies. A trial in
    another process turns that into an exception.

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
    """Render a wall and check its depth; if libraries are missing, this may end the process.

    Raises:
        RuntimeError: the picture shows something else.
    """
    builder = DiagramBuilder()
    scene_graph: Any = builder.AddSystem(geometry.SceneGraph())
    scene_graph.AddRenderer("trial", geometry.MakeRenderEngineVtk(geometry.RenderEngineVtkParams()))
    thickness, away = 0.1, 1.0
    wall = geometry.GeometryInstance(
        RigidTransform([0.0, 0.0, away + thickness / 2]), geometry.Box(9.0, 9.0, thickness), "wall"
    )
    wall.set_perception_properties(
        geometry.PerceptionProperties(geometry.MakePhongIllustrationProperties([0.5, 0.5, 0.5, 1.0]))
    )
    scene_graph.RegisterAnchoredGeometry(scene_graph.RegisterSource("trial"), wall)
    core = geometry.RenderCameraCore(
        "trial", CameraInfo(8, 8, 1.0), geometry.ClippingRange(0.01, 10.0), RigidTransform()
    )
    sensor: Any = builder.AddSystem(
        RgbdSensor(
            scene_graph.world_frame_id(),
            RigidTransform(),
            geometry.ColorRenderCamera(core),
            geometry.DepthRenderCamera(core, geometry.DepthRange(0.1, 5.0)),
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
        f"install {' '.join(RENDERING_PACKAGES)}`, elsewhere with the packages that contain libEGL, Mesa's"
        " drivers and GLib"
    )
