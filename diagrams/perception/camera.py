"""The depth camera above the table: its parameters, and adding it to a Diagram.

A renderer in the plant's own scene graph would get the pose of every shape at every step, because contacts
are computed there: for the station's eighty shapes that takes as long as the dynamics of the arm. So the
camera has its own scene graph, which is updated only when a picture is taken.
"""

# Annotations stay objects, because Drake's YAML reader inspects them.
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake import geometry
from pydrake.common.cpp_param import List
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from slipmap.diagrams.perception.renderer import require_renderer
from slipmap.diagrams.systems.python_system import PythonSystem
from slipmap.models.perception.pinhole_camera import PinholeCamera
from slipmap.models.settings import CheckedSettings, within

NEAREST, FARTHEST = 0.2, 4.0  # range of depth readings, m


@dataclass
class CameraConfig(CheckedSettings):
    """Camera that looks straight down on the table; by default it sees all of a table of radius 0.5 m."""

    _section = "camera."

    height: float = within(1.1, 0.3, FARTHEST - 0.1)  # of the camera above the table, m
    position: list[float] = field(default_factory=lambda: [0.0, 0.0])  # (x, y) of the camera in W, m
    # rotation of the picture about the vertical, rad; at 0 the picture's right is W's x, its top W's y
    yaw: float = within(0.0, -6.2832, 6.2832)
    # vertical field of view of the picture, rad
    fov_y: float = within(float(np.deg2rad(52.0)), 0.05, 2.8)
    # width, height_pixels: picture size
    width: int = within(640, 16, 4096)
    height_pixels: int = within(480, 16, 4096)
    rate: float = within(15.0, 0.1, 1000.0)  # pictures per second, Hz

    def check(self) -> None:
        """Raise ValueError for an invalid field."""
        super().check()
        if len(self.position) != 2 or not np.isfinite(self.position).all():
            raise ValueError(f"camera.position must be x and y in m, got {self.position}")

    @property
    def X_WC(self) -> RigidTransform:
        """Pose of the camera: x to the picture's right, y to its bottom, z along the view."""
        R_WC = RotationMatrix.MakeZRotation(self.yaw) @ RotationMatrix(np.diag([1.0, -1.0, -1.0]))
        p_WC: Any = np.array([*self.position, self.height])
        return RigidTransform(R_WC, p_WC)

    @property
    def focal(self) -> float:
        """Focal length, pixels."""
        return self.height_pixels / 2 / float(np.tan(self.fov_y / 2))

    @property
    def intrinsics(self) -> PinholeCamera:
        """The camera's intrinsics, for pixel coordinates that are integers at pixel centres."""
        center = (self.width - 1) / 2, (self.height_pixels - 1) / 2
        return PinholeCamera(self.width, self.height_pixels, self.focal, self.focal, *center)

    def _camera_info(self) -> CameraInfo:
        # The VTK renderer measures the principal point from the picture's corner, not from the centre of the
        # first pixel: with Drake's default, (width - 1) / 2, pictures are off by half a pixel.
        return CameraInfo(
            self.width, self.height_pixels, self.focal, self.focal, self.width / 2, self.height_pixels / 2
        )


def add_camera(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: geometry.SceneGraph,
    config: CameraConfig | None = None,
) -> RgbdSensor:
    """Add a camera that renders colour and depth, fixed in the world.

    The sensor's ports are named `color_image`, `depth_image_32f` and `body_pose_in_world`, which is X_WC. A
    picture is rendered when its port is evaluated, at most once per time step; the reader determines the rate
    and sees the state at that time.

    Args:
        builder: gets the sensor and its scene graph, named `picture_scene`.
        plant, scene_graph: the world, finalized; nothing may be added to it afterwards. Visible shapes need a
            perception role, which `plant.RegisterVisualGeometry` gives them.

    Raises:
        ValueError: the plant is not finalized.
        RendererUnavailable: system libraries for rendering are missing; the text names the packages that
            provide them.
    """
    config = config or CameraConfig()
    require_renderer()
    scene, renderer = _add_picture_scene(builder, plant, scene_graph), "camera_renderer"
    scene.AddRenderer(renderer, geometry.MakeRenderEngineVtk(geometry.RenderEngineVtkParams(backend="EGL")))
    core = geometry.RenderCameraCore(
        renderer, config._camera_info(), geometry.ClippingRange(0.01, 2 * FARTHEST), RigidTransform()
    )
    sensor: Any = builder.AddNamedSystem(
        "camera",
        RgbdSensor(
            scene.world_frame_id(),
            config.X_WC,
            geometry.ColorRenderCamera(core),
            geometry.DepthRenderCamera(core, geometry.DepthRange(NEAREST, FARTHEST)),
        ),
    )
    builder.Connect(scene.get_query_output_port(), sensor.query_object_input_port())
    return sensor


def _add_picture_scene(
    builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: geometry.SceneGraph
) -> geometry.SceneGraph:
    if not plant.is_finalized():
        raise ValueError("picture scene: finalize the plant first, so that all visible shapes are there")
    scene = builder.AddNamedSystem("picture_scene", geometry.SceneGraph())
    source = scene.RegisterSource("pictures")
    inspector = scene_graph.model_inspector()
    shapes = inspector.GetGeometryIds(
        geometry.GeometrySet(inspector.GetAllGeometryIds()), geometry.Role.kPerception
    )
    frames: dict[BodyIndex, geometry.FrameId] = {}
    for shape in sorted(shapes, key=lambda shape: shape.get_value()):
        body = plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
        copy = inspector.CloneGeometryInstance(shape)
        if body.index() == plant.world_body().index():
            scene.RegisterAnchoredGeometry(source, copy)
            continue
        if body.index() not in frames:
            frame = geometry.GeometryFrame(body.scoped_name().get_full())
            frames[body.index()] = scene.RegisterFrame(source, frame)
        scene.RegisterGeometry(source, frames[body.index()], copy)
    if frames:
        poses = builder.AddNamedSystem("picture_poses", _FramePoses(frames))
        builder.Connect(plant.get_body_poses_output_port(), poses.get_input_port())
        builder.Connect(poses.get_output_port(), scene.get_source_pose_port(source))
    return scene


class _FramePoses(PythonSystem):
    def __init__(self, frames: Mapping[BodyIndex, geometry.FrameId]) -> None:
        super().__init__()
        self._frames = dict(frames)
        poses = self.DeclareAbstractInputPort("body_poses", Value[List[RigidTransform]]())
        self.DeclareAbstractOutputPort(
            "frame_poses", lambda: Value(geometry.FramePoseVector()), self._calc, {poses.ticket()}
        )

    def _calc(self, context: Context, output: Value) -> None:
        X_WB = self.get_input_port().Eval(context)
        result = geometry.FramePoseVector()
        for body, frame in self._frames.items():
            result.set_value(frame, X_WB[body])
        output.set_value(result)
