"""The depth camera over the table: its parameters and how it comes into a Diagram."""

# Annotations stay objects: Drake's YAML reader looks at them.
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from slipmap.diagrams.perception.renderer import add_picture_scene, require_renderer
from slipmap.models.perception.pinhole_camera import PinholeCamera

RENDERER = "camera_renderer"

NEAREST, FARTHEST = 0.2, 4.0
"""Of depth readings, m."""


@dataclass
class CameraConfig:
    """Camera that looks straight down on the table; defaults see all of a table of radius 0.5 m.

    Attributes:
        height: of the camera over the table, m.
        position: (x, y) of the camera in W, m.
        yaw: turn of the picture about the vertical, rad; at 0 the picture's right is W's x, its top W's y.
        fov_y: field of view from the picture's top to its bottom, rad.
        width, height_pixels: picture size.
        rate: pictures a second, Hz.

    Raises:
        ValueError: a value out of range.
    """

    height: float = 1.1
    position: list[float] = field(default_factory=lambda: [0.0, 0.0])
    yaw: float = 0.0
    fov_y: float = float(np.deg2rad(52.0))
    width: int = 640
    height_pixels: int = 480
    rate: float = 15.0

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Raise ValueError where a field makes no sense."""
        for name, value, low, high in (
            ("height", self.height, 0.3, FARTHEST - 0.1),
            ("fov_y", self.fov_y, 0.05, 2.8),
            ("width", self.width, 16, 4096),
            ("height_pixels", self.height_pixels, 16, 4096),
            ("rate", self.rate, 0.1, 1000.0),
        ):
            if not low <= value <= high:
                raise ValueError(f"camera.{name} must lie between {low} and {high}, got {value}")
        if len(self.position) != 2 or not np.isfinite(self.position).all():
            raise ValueError(f"camera.position must be x and y in m, got {self.position}")
        if not np.isfinite(self.yaw):
            raise ValueError(f"camera.yaw must be finite, got {self.yaw}")

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
        """The camera's intrinsics, for pixel coordinates that are whole numbers at the pixels' centres."""
        center = (self.width - 1) / 2, (self.height_pixels - 1) / 2
        return PinholeCamera(self.width, self.height_pixels, self.focal, self.focal, *center)

    def _camera_info(self) -> CameraInfo:
        # The VTK renderer counts the principal point from the picture's corner, not from the first pixel's
        # centre: with Drake's default centre, (width - 1) / 2, pictures are half a pixel off.
        return CameraInfo(
            self.width, self.height_pixels, self.focal, self.focal, self.width / 2, self.height_pixels / 2
        )


def add_camera(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    config: CameraConfig | None = None,
) -> RgbdSensor:
    """Add a camera that renders colour and depth, fixed in the world.

    The sensor's ports are named `color_image`, `depth_image_32f` and `body_pose_in_world`, which is X_WC. A
    picture is rendered when its port is evaluated, and at most once a time step; whoever reads it sets the
    rate, and sees the state at that very time.

    Args:
        builder: gets the sensor, and a scene graph of its own named `picture_scene` with a renderer named
            `RENDERER`; see `picture_scene`.
        plant: the world, finalized.
        scene_graph: the one that the plant is registered with. What is to be seen needs a perception role,
            which `plant.RegisterVisualGeometry` gives.
        config: by default `CameraConfig()`.

    Raises:
        ValueError: the plant is not finalized.
        RendererUnavailable: the system's libraries for rendering are missing; the text says which packages
            bring them.
    """
    config = config or CameraConfig()
    require_renderer()
    scene = add_picture_scene(builder, plant, scene_graph)
    scene.AddRenderer(RENDERER, MakeRenderEngineVtk(RenderEngineVtkParams(backend="EGL")))
    core = RenderCameraCore(
        RENDERER, config._camera_info(), ClippingRange(0.01, 2 * FARTHEST), RigidTransform()
    )
    sensor: Any = builder.AddNamedSystem(
        "camera",
        RgbdSensor(
            scene.world_frame_id(),
            config.X_WC,
            ColorRenderCamera(core),
            DepthRenderCamera(core, DepthRange(NEAREST, FARTHEST)),
        ),
    )
    builder.Connect(scene.get_query_output_port(), sensor.query_object_input_port())
    return sensor
