"""A camera over a round table with one of the six objects, rendered with noise."""

import numpy as np
import pytest
from pydrake.geometry import Cylinder, Mesh
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.perception.camera import CameraConfig, add_camera
from slipmap.diagrams.perception.cell_perception import CellPerception
from slipmap.diagrams.perception.depth_noise import DepthNoise
from slipmap.diagrams.perception.depth_picture import add_depth_picture
from slipmap.models.objects.benchmark_objects import BENCHMARK_OBJECTS, benchmark_object
from slipmap.models.perception.pinhole_camera import View

FAR_AWAY = RigidTransform([0.0, 0.0, -20.0])


class World:
    """The six objects without weight: each lies where it is put, the others out of sight."""

    def __init__(self, folder) -> None:
        self.config = CameraConfig()
        self.view = View(self.config.intrinsics, self.config.X_WC.GetAsMatrix4())
        builder = DiagramBuilder()
        self.plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.01)
        self.plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])
        top = RigidTransform([0, 0, -0.01])
        grey = [0.5, 0.5, 0.5, 1.0]
        self.plant.RegisterVisualGeometry(self.plant.world_body(), top, Cylinder(0.5, 0.02), "table", grey)
        for name in BENCHMARK_OBJECTS:
            path = folder / f"{name}.obj"
            benchmark_object(name).mesh.export(path, include_normals=True)
            body = self.plant.AddRigidBody(name, SpatialInertia.SolidSphereWithMass(1.0, 0.1))
            self.plant.RegisterVisualGeometry(body, RigidTransform(), Mesh(str(path)), name, grey)
        self.plant.Finalize()
        self.camera = add_camera(builder, self.plant, scene_graph, self.config)
        self.noise = builder.AddSystem(DepthNoise())
        self.perception = builder.AddSystem(CellPerception(cells=40))
        self.picture = add_depth_picture(builder, self.plant, scene_graph, self.config, self.camera)
        builder.Connect(self.picture, self.noise.get_input_port())
        builder.Connect(self.noise.get_output_port(), self.perception.GetInputPort("depth_image"))
        builder.Connect(self.camera.body_pose_in_world_output_port(), self.perception.GetInputPort("X_WC"))
        self.diagram = builder.Build()

    def context(self):
        context = self.diagram.CreateDefaultContext()
        self.place(context, None, (0, 0, 0))
        return context

    def simulator(self, context):
        simulator = Simulator(self.diagram, context)
        simulator.Initialize()
        return simulator

    def place(self, context, name, pose) -> None:
        state = self.plant.GetMyMutableContextFromRoot(context)
        for other in BENCHMARK_OBJECTS:
            X_WO = FAR_AWAY
            if other == name:
                X_WO = RigidTransform(RotationMatrix.MakeZRotation(pose[2]), [pose[0], pose[1], 0.0])
            self.plant.SetFreeBodyPose(state, self.plant.GetBodyByName(other), X_WO)

    def depth(self, context) -> np.ndarray:
        system = self.picture.get_system()
        return self.picture.Eval(system.GetMyContextFromRoot(context)).data[:, :, 0].copy()

    def output(self, context, name):
        return self.perception.GetOutputPort(name).Eval(self.perception.GetMyContextFromRoot(context))


@pytest.fixture(scope="session")
def world(renderer, tmp_path_factory) -> World:
    return World(tmp_path_factory.mktemp("objects"))
