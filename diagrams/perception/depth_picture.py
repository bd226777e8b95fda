"""Depth pictures without a renderer: rays of the pixels are cut with the shapes of the world.

The arm, the table and what stands around are boxes, balls, cylinders and capsules, whose depth along a ray is
a formula; objects are meshes. That takes a tenth of the time in which a renderer in software draws them as
100 000 triangles. What does not move is drawn once.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydrake.common.cpp_param import List
from pydrake.common.value import AbstractValue, Value
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    GeometryId,
    GeometrySet,
    Mesh,
    Role,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.sensors import ImageDepth32F, RgbdSensor

from diagrams.collectable import PythonSystem
from diagrams.perception.camera import FARTHEST, NEAREST, CameraConfig
from diagrams.perception.drawing_kernels import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    draw_solids,
    draw_triangles,
    keep_range,
)
from models.perception.camera import DepthImage
from models.physics.cell_grid import FloatArray


class NotDrawable(ValueError):
    """A shape that only a renderer can draw; the text names it."""


class _Solid(NamedTuple):
    """A shape with a formula; see `draw_solids`."""

    kind: int
    size: FloatArray
    half: FloatArray


class _Surface(NamedTuple):
    """Triangles (m, 3) between corners (n, 3)."""

    corners: FloatArray
    triangles: NDArray[np.int64]


_Placed = tuple[BodyIndex, FloatArray, _Solid | _Surface]


class _Scene:
    """Shapes on some bodies, ready to be drawn."""

    def __init__(self, shapes: Sequence[_Placed]) -> None:
        """Shapes with their bodies and their poses (3, 4) on these."""
        self.bodies = list(dict.fromkeys(body for body, _, _ in shapes))
        rows = [self.bodies.index(body) for body, _, _ in shapes]
        solids = [k for k, (_, _, shape) in enumerate(shapes) if isinstance(shape, _Solid)]
        self._solids = (
            np.array([shapes[k][2][0] for k in solids], dtype=np.int64),
            *(np.array([shapes[k][2][m] for k in solids]).reshape(-1, 3) for m in (1, 2)),
            np.array([shapes[k][1] for k in solids]).reshape(-1, 3, 4),
            np.array([rows[k] for k in solids], dtype=np.int64),
        )
        self._surfaces = [
            (row, np.ascontiguousarray(shape.corners @ X_BG[:, :3].T + X_BG[:, 3]), shape.triangles)
            for row, (_, X_BG, shape) in zip(rows, shapes, strict=True)
            if isinstance(shape, _Surface)
        ]

    def draw(self, image: DepthImage, camera: FloatArray, X_CB: Sequence[RigidTransform]) -> None:
        """Draw into a picture (H, W), m, for poses of `bodies` in the camera's frame."""
        poses = np.array([X.GetAsMatrix34() for X in X_CB]).reshape(-1, 3, 4)
        draw_solids(image, camera, *self._solids, poses)
        for row, corners, triangles in self._surfaces:
            draw_triangles(image, camera, corners, triangles, poses[row])


class DepthPicture(PythonSystem):
    """Depth pictures of a plant, without noise.

    .. pydrake_system::

        name: DepthPicture
        input_ports:
        - body_poses
        output_ports:
        - depth_image

    `body_poses` are those of the plant. `depth_image`, an ImageDepth32F, is as Drake's `RgbdSensor` renders
    it: 0 for what is too near, inf for what is too far; edges may lie in the pixel beside.
    """

    def __init__(self, plant: MultibodyPlant, scene_graph: SceneGraph, config: CameraConfig) -> None:
        """Collect the shapes with a perception role.

        Args:
            plant: finalized.
            scene_graph: the one that the plant is registered with.
            config: the camera.

        Raises:
            ValueError: the plant is not finalized.
            NotDrawable: a shape that is neither a simple solid nor a mesh in an OBJ file.
        """
        super().__init__()
        if not plant.is_finalized():
            raise ValueError("depth picture: finalize the plant first, so that all that can be seen is there")
        camera = config.intrinsics
        self._camera = np.array([camera.focal_x, camera.focal_y, camera.center_x, camera.center_y])
        self._X_CW = config.X_WC.inverse()
        fixed = {body.index() for body in plant.GetBodiesWeldedTo(plant.world_body())}
        inspector = scene_graph.model_inspector()
        found = inspector.GetGeometryIds(GeometrySet(inspector.GetAllGeometryIds()), Role.kPerception)
        standing: list[_Placed] = []
        moving: list[_Placed] = []
        for geometry in sorted(found, key=lambda geometry: geometry.get_value()):
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(geometry)).index()
            X_BG = inspector.GetPoseInFrame(geometry).GetAsMatrix34()
            (standing if body in fixed else moving).append((body, X_BG, _drawable(inspector, geometry)))
        background, self._moving = _Scene(standing), _Scene(moving)
        self._background = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
        rest = plant.CreateDefaultContext()
        everything = self._background.copy()
        for scene, image in ((background, self._background), (self._moving, everything)):
            X_WB = [plant.EvalBodyPoseInWorld(rest, plant.get_body(body)) for body in scene.bodies]
            scene.draw(image, self._camera, [self._X_CW @ X for X in X_WB])
        # Nobody sees this one; but what has to be compiled is so now, and no picture of a twin comes late.
        keep_range(everything, NEAREST, FARTHEST)
        poses = self.DeclareAbstractInputPort("body_poses", Value[List[RigidTransform]]())
        self.DeclareAbstractOutputPort(
            "depth_image", lambda: AbstractValue.Make(ImageDepth32F()), self._calc, {poses.ticket()}
        )

    def _calc(self, context: Context, output: Any) -> None:
        X_WB: Any = self.get_input_port().Eval(context)
        height, width = self._background.shape
        picture: Any = ImageDepth32F(width, height)
        image = picture.mutable_data[:, :, 0]
        image[:] = self._background
        self._moving.draw(image, self._camera, [self._X_CW @ X_WB[body] for body in self._moving.bodies])
        keep_range(image, NEAREST, FARTHEST)
        output.set_value(picture)


def add_depth_picture(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    config: CameraConfig,
    camera: RgbdSensor,
) -> OutputPort:
    """Depth pictures of a camera, from a `DepthPicture` if that can draw all that there is to see.

    Args:
        builder: of the diagram that the plant is in; gets a system "depth_picture".
        plant, scene_graph: as of `DepthPicture`.
        config: the camera.
        camera: the same one, from `add_camera`, which renders the pictures otherwise.
    """
    try:
        picture = builder.AddNamedSystem("depth_picture", DepthPicture(plant, scene_graph, config))
    except NotDrawable:
        return camera.depth_image_32F_output_port()
    builder.Connect(plant.get_body_poses_output_port(), picture.get_input_port())
    return picture.get_output_port()


def _drawable(inspector: Any, geometry: GeometryId) -> _Solid | _Surface:
    shape: Shape = inspector.GetShape(geometry)
    if isinstance(shape, Box):
        half = shape.size() / 2
        return _Solid(BOX, half, half)
    if isinstance(shape, Sphere):
        half = np.full(3, shape.radius())
        return _Solid(ELLIPSOID, half, half)
    if isinstance(shape, Ellipsoid):
        half = np.array([shape.a(), shape.b(), shape.c()])
        return _Solid(ELLIPSOID, half, half)
    if isinstance(shape, Cylinder):
        half = np.array([shape.radius(), shape.radius(), shape.length() / 2])
        return _Solid(CYLINDER, half, half)
    if isinstance(shape, Capsule):
        size = np.array([shape.radius(), shape.radius(), shape.length() / 2])
        return _Solid(CAPSULE, size, size + np.array([0.0, 0.0, shape.radius()]))
    if isinstance(shape, Mesh) and shape.extension() == ".obj":
        mesh = _triangles(shape)
        return _Surface(mesh.vertices * shape.scale3(), np.ascontiguousarray(mesh.faces, np.int64))
    raise NotDrawable(f"depth picture: {inspector.GetName(geometry)} is a {type(shape).__name__}")


def _triangles(shape: Mesh) -> Any:
    source = shape.source()
    content = source.path().read_bytes() if source.is_path() else source.in_memory().mesh_file.contents()
    return trimesh.load_mesh(io.BytesIO(content), file_type="obj", process=False, skip_materials=True)
