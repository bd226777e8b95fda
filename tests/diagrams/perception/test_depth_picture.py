"""Pictures whose depth is computed are those that Drake's renderer makes."""

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.perception.camera import CameraConfig, add_camera
from slipmap.diagrams.perception.depth_picture import DepthPicture, add_depth_picture
from slipmap.diagrams.perception.renderer import require_renderer
from slipmap.models.objects.benchmark_objects import BENCHMARK_OBJECTS

SHAPES = {
    "box": Box(0.2, 0.1, 0.3),
    "sphere": Sphere(0.12),
    "ellipsoid": Ellipsoid(0.05, 0.1, 0.2),
    "cylinder": Cylinder(0.07, 0.25),
    "capsule": Capsule(0.06, 0.2),
}
POSES = [
    RigidTransform(RollPitchYaw(0.3, 0.5, 0.2), [0.0, 0.1, 0.3]),
    RigidTransform(RollPitchYaw(1.6, -0.2, 0.9), [0.5, -0.3, 0.1]),  # partly beside the picture
    RigidTransform(RollPitchYaw(0.0, 0.0, 0.0), [-0.2, 0.05, 0.2]),
    RigidTransform([0.0, 0.0, -3.5]),  # too far
    RigidTransform([0.0, 0.0, 0.85]),  # too near
    RigidTransform([0.0, 0.0, 1.5]),  # behind the camera
]


class Scene:
    """A table and one shape on a body, seen by a renderer and by `add_depth_picture`."""

    def __init__(self, shape, config=None):
        require_renderer()
        builder = DiagramBuilder()
        self.config = config or CameraConfig(width=320, height_pixels=240)
        self.plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.01)
        grey = [0.5, 0.5, 0.5, 1.0]
        table = Box(0.8, 0.6, 0.02)
        self.plant.RegisterVisualGeometry(
            self.plant.world_body(), RigidTransform([0, 0, -0.01]), table, "table", grey
        )
        self.body = self.plant.AddRigidBody("body", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        placed = RigidTransform(RollPitchYaw(0.0, 0.4, 0.0), [0.02, 0.0, 0.01])
        self.plant.RegisterVisualGeometry(self.body, placed, shape, "shape", grey)
        self.plant.Finalize()
        self.camera = add_camera(builder, self.plant, scene_graph, self.config)
        self.picture = add_depth_picture(builder, self.plant, scene_graph, self.config, self.camera)
        self.context = builder.Build().CreateDefaultContext()

    def place(self, X_WB):
        self.plant.SetFreeBodyPose(self.plant.GetMyMutableContextFromRoot(self.context), self.body, X_WB)

    def seen(self, port):
        return port.Eval(port.get_system().GetMyContextFromRoot(self.context)).data[:, :, 0].copy()


def share_alike(one, other, off):
    """Share of the pixels that both pictures have in the same way: as depth within `off` m, 0 or inf."""
    with np.errstate(invalid="ignore"):
        return np.mean((one == other) | (np.abs(one - other) < off))


@pytest.mark.parametrize("name", SHAPES)
def test_solids_are_where_a_renderer_has_them(renderer, name):
    scene = Scene(SHAPES[name])
    assert isinstance(scene.picture.get_system(), DepthPicture)
    for X_WB in POSES:
        scene.place(X_WB)
        rendered = scene.seen(scene.camera.depth_image_32F_output_port())
        # A renderer's round shapes have corners; at edges either pixel may be right.
        assert share_alike(scene.seen(scene.picture), rendered, 1e-3) > 0.99, X_WB
        assert share_alike(scene.seen(scene.picture), rendered, 2e-2) > 0.997, X_WB


def test_depth_is_that_of_the_formula(renderer):
    """Straight below the camera, on the top of a ball and on the table beside it."""
    scene = Scene(SHAPES["sphere"], CameraConfig(width=321, height_pixels=241))
    scene.place(RigidTransform([-0.02, 0.0, 0.2]))
    depth = scene.seen(scene.picture)
    assert depth[120, 160] == pytest.approx(1.1 - 0.21 - 0.12, abs=1e-6)
    assert depth[120, 230] == pytest.approx(1.1, abs=1e-6)


@pytest.mark.parametrize("name", BENCHMARK_OBJECTS)
def test_objects_are_where_a_renderer_has_them(world, name):
    context = world.context()
    port = world.camera.depth_image_32F_output_port()
    for pose in ((0.0, 0.0, 0.3), (0.25, -0.2, 2.0)):
        world.place(context, name, pose)
        rendered = port.Eval(world.camera.GetMyContextFromRoot(context)).data[:, :, 0]
        drawn = world.depth(context)
        table = np.isfinite(rendered) & np.isfinite(drawn)
        assert share_alike(drawn[table], rendered[table], 1e-4) > 0.999
        # Nor is it shifted: what is higher than the table has the same middle.
        middles = [np.argwhere(table & (image < 1.098)).mean(axis=0) for image in (drawn, rendered)]
        assert middles[0] == pytest.approx(middles[1], abs=0.05)


def test_what_only_a_renderer_can_draw_is_rendered(renderer):
    scene = Scene(Convex(points=np.diag([0.1, 0.2, 0.3, 0.0])[:3] - 0.05, label="corner"))
    assert scene.picture.get_system() is scene.camera
