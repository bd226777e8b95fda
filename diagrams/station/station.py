"""The simulated robot cell, with the ports of the real one."""

import numpy as np
from pydrake.common.cpp_param import List
from pydrake.common.value import AbstractValue, Value
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource

from slipmap.diagrams.perception.camera import add_camera
from slipmap.diagrams.perception.depth_noise import DepthNoise
from slipmap.diagrams.perception.depth_picture import add_depth_picture
from slipmap.diagrams.perception.sight import ArmHulls
from slipmap.diagrams.station.arm import add_arm, add_arm_drivers
from slipmap.diagrams.station.finger_contact import push_with_gripper
from slipmap.diagrams.station.hidden_effects import LatePictures, add_hidden_effects
from slipmap.diagrams.station.placement import check_placement
from slipmap.diagrams.station.rest import Hold, RestWatch
from slipmap.diagrams.station.scenario import Scenario, check_scenario
from slipmap.diagrams.station.sliding_object import (
    BODY,
    add_sliding_object,
    connect_motion,
    plant_config,
    resting_pose,
    sink_of,
)
from slipmap.diagrams.station.table import add_table
from slipmap.diagrams.systems.python_system import DRAWN_EVERY, PythonDiagram, PythonSystem

TRUTH = "truth."  # prefix of the ports that only a simulation has


class Station(PythonDiagram):
    """Arm with gripper, table, object and depth camera.

    .. pydrake_system::

        name: Station
        input_ports:
        - iiwa.position
        - gripper.position
        - gripper.force_limit
        output_ports:
        - iiwa.position_commanded
        - iiwa.position_measured
        - iiwa.velocity_estimated
        - iiwa.torque_external
        - gripper.state_measured
        - camera.depth_image
        - camera.rgb_image
        - camera.X_WC
        - iiwa.age
        - camera.age
        - truth.object_pose
        - truth.contact_results

    The ports of arm and gripper are those of `add_arm_drivers`. Pictures include the camera's noise;
    `camera.X_WC` is a `RigidTransform`. `iiwa.age` (1,) and `camera.age` (1,) are the ages of the arm's state
    and of the picture, s: zero in a simulation. `truth.object_pose` is X_WO.

    Raises:
        ScenarioError: settings that a scenario file could not have.
        ValueError: an object or a surface that cannot be made.
        RendererUnavailable: this machine cannot render pictures.

    Example:
        >>> import slipmap
        >>> station = slipmap.Station(slipmap.Scenario())
        >>> station.HasOutputPort("camera.depth_image")
        True
    """

    def __init__(self, scenario: Scenario, meshcat: Meshcat | None = None) -> None:
        super().__init__()
        check_scenario(scenario)
        builder = DiagramBuilder()
        self.true_object = scenario.object.make()
        check_placement(scenario, self.true_object)
        plant, scene_graph = AddMultibodyPlant(plant_config(scenario.simulation.time_step), builder)
        plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -scenario.gravity])
        add_table(plant, scenario.table.make(), scenario.table.friction)
        add_sliding_object(plant, self.true_object, scenario.table.friction)
        radius = scenario.execution.finger_radius
        self.arm = add_arm(plant, models=scenario.arm.models, finger_radius=radius)
        body = plant.GetBodyByName(BODY)
        x, y, degrees = scenario.object.pose
        X_WO = resting_pose(x, y, float(np.radians(degrees)), sink=sink_of(self.true_object))
        plant.SetDefaultFloatingBaseBodyPose(body, X_WO)
        push_with_gripper(plant, self.true_object, self.arm)
        plant.Finalize()
        self.plant = plant
        self.arm_hulls = ArmHulls(plant, scene_graph, [self.arm.iiwa, self.arm.gripper])
        add_hidden_effects(builder, plant, self.true_object, scenario.hidden)
        add_arm_drivers(builder, plant, self.arm)
        watch = RestWatch(plant, scene_graph, [self.arm.iiwa, self.arm.gripper])
        self._rest_watch, self._scene_graph = builder.AddNamedSystem("rest_watch", watch), scene_graph
        connect_motion(builder, plant, watch)
        touched = plant.get_generalized_contact_forces_output_port(self.arm.iiwa)
        builder.Connect(touched, watch.GetInputPort("contact_forces"))
        self._hold = Hold(plant, scene_graph)
        _export_camera(builder, plant, scene_graph, scenario)
        for name in ("iiwa.age", "camera.age"):
            age = builder.AddNamedSystem(name, ConstantVectorSource(np.zeros(1)))
            builder.ExportOutput(age.get_output_port(), name)
        pose = builder.AddNamedSystem("object_pose", _BodyPose(body.index()))
        builder.Connect(plant.get_body_poses_output_port(), pose.get_input_port())
        builder.ExportOutput(pose.get_output_port(), f"{TRUTH}object_pose")
        builder.ExportOutput(plant.get_contact_results_output_port(), f"{TRUTH}contact_results")
        if meshcat is not None:
            params = MeshcatVisualizerParams(role=Role.kIllustration, publish_period=DRAWN_EVERY)
            MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
        builder.BuildInto(self)
        self.set_name("station")

    def after_step(self, root: Context) -> None:
        """Lock the object while it lies still and nothing is near it; see `rest`.

        Call it after each step of a simulator, with the Context of the diagram that the station is in.
        Without it, a simulation is slower.
        """
        at_rest = self._rest_watch.at_rest(self._rest_watch.GetMyContextFromRoot(root))
        self._hold.set(self.plant, self._scene_graph, root, at_rest)


def take_fixed_steps(simulator: Simulator) -> None:
    """Integrate a station's continuous state, which is the arm's control, without error control.

    It is the integral of an error that changes little between two steps of the plant; each further evaluation
    would recompute everything that is commanded to the arm.
    """
    ResetIntegratorFromFlags(simulator, "explicit_euler", 0.005)


def _export_camera(
    builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph, scenario: Scenario
) -> None:
    camera = add_camera(builder, plant, scene_graph, scenario.camera)
    noise = builder.AddNamedSystem("depth_noise", DepthNoise(scenario.depth_noise, scenario.camera.rate))
    depth = add_depth_picture(builder, plant, scene_graph, scenario.camera, camera)
    builder.Connect(depth, noise.get_input_port())
    pictures, latency = noise, scenario.hidden.sensor_latency.latency
    if latency:
        pictures = builder.AddNamedSystem("late_pictures", LatePictures(latency, 1.0 / scenario.camera.rate))
        builder.Connect(noise.get_output_port(), pictures.get_input_port())
    builder.ExportOutput(pictures.get_output_port(), "camera.depth_image")
    builder.ExportOutput(camera.GetOutputPort("color_image"), "camera.rgb_image")
    place = builder.AddNamedSystem(
        "camera_pose", ConstantValueSource(AbstractValue.Make(scenario.camera.X_WC))
    )
    builder.ExportOutput(place.get_output_port(), "camera.X_WC")


class _BodyPose(PythonSystem):
    def __init__(self, body: BodyIndex) -> None:
        super().__init__()
        poses = self.DeclareAbstractInputPort("body_poses", Value[List[RigidTransform]]())
        self.declare_output(
            "X_WO",
            lambda context: self.get_input_port().Eval(context)[body],
            {poses.ticket()},
            Value(RigidTransform()),
        )
