"""An object on the table, pushed by a round finger that moves as prescribed: the test bed of the station."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from pydrake.geometry import AddContactMaterial, ProximityProperties, Role
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction
from pydrake.multibody.tree import PdControllerGains, PrismaticJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.station.arm import lone_arm
from slipmap.diagrams.station.finger_contact import push_with_balls
from slipmap.diagrams.station.hidden_effects import HiddenEffectsConfig, add_hidden_effects
from slipmap.diagrams.station.sliding_object import (
    BODY,
    FINGER_FRICTION,
    add_sliding_object,
    plant_config,
    resting_pose,
    sink_of,
)
from slipmap.diagrams.station.table import ROUND_TABLE, TABLE_FRICTION, add_table
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.objects.true_object import TrueObject

FINGER_RADIUS = 0.008
FINGER_HEIGHT = 0.002
"""Of the end of the upright round finger above the table, m."""


class TestBed:
    """A diagram with table and object, and a finger if wanted. `add` puts in more before `build`."""

    __test__ = False

    def __init__(
        self,
        true_object: TrueObject,
        *,
        time_step: float = 2.5e-3,
        table: Table = ROUND_TABLE,
        finger: bool = False,
        hidden: HiddenEffectsConfig | None = None,
    ) -> None:
        self.builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlant(plant_config(time_step), self.builder)
        self.time_step = time_step
        add_table(self.plant, table)
        add_sliding_object(self.plant, true_object, TABLE_FRICTION)
        self.finger = None
        if finger:
            self._add_finger(true_object)
        self.plant.Finalize()
        self.body, self.sink = self.plant.GetBodyByName(BODY), sink_of(true_object)
        if hidden is not None:
            add_hidden_effects(self.builder, self.plant, true_object, hidden)
        self.simulator: Simulator | None = None

    def start(self, pose: np.ndarray, tip: np.ndarray | None = None) -> None:
        """Object at rest at pose (x, y, angle), finger at tip (2,), time zero."""
        if self.simulator is None:
            self.simulator = Simulator(self.builder.Build())
        simulator = self.simulator
        context = simulator.get_mutable_context()
        context.SetTime(0.0)
        simulator.get_system().SetDefaultContext(context)
        self.context = self.plant.GetMyMutableContextFromRoot(context)
        if self.finger is not None:
            self.plant.SetPositions(self.context, self.finger, tip)
            self._command(tip, np.zeros(2))
        self.plant.SetFreeBodyPose(self.context, self.body, resting_pose(*pose, sink=self.sink))
        simulator.Initialize()

    def follow(self, tip: np.ndarray, h: float) -> np.ndarray:
        """Poses (N + 1, 3) while the finger follows tip (N + 1, 2), a row each h."""
        assert self.simulator is not None
        poses = [self.pose]
        for before, after in pairwise(tip):
            self._command(after, (after - before) / h)
            self.simulator.AdvanceTo(len(poses) * h)
            poses.append(self.pose)
        return np.array(poses)

    def advance(self, duration: float) -> None:
        assert self.simulator is not None
        self.simulator.AdvanceTo(self.simulator.get_context().get_time() + duration)

    @property
    def X_WO(self) -> RigidTransform:
        return self.plant.EvalBodyPoseInWorld(self.context, self.body)

    @property
    def pose(self) -> np.ndarray:
        """x, y, angle."""
        return np.array([*self.X_WO.translation()[:2], RollPitchYaw(self.X_WO.rotation()).yaw_angle()])

    def _command(self, position: np.ndarray, velocity: np.ndarray) -> None:
        port = self.plant.get_desired_state_input_port(self.finger)
        port.FixValue(self.context, np.concatenate([position, velocity]))

    def _add_finger(self, true_object: TrueObject) -> None:
        plant = self.plant
        self.finger = plant.AddModelInstance("finger")
        inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.02)
        carriage = plant.AddRigidBody("carriage", self.finger, inertia)
        finger = plant.AddRigidBody("finger", self.finger, inertia)
        for name, parent, child, axis in (
            ("finger_x", plant.world_frame(), carriage.body_frame(), [1.0, 0.0, 0.0]),
            ("finger_y", carriage.body_frame(), finger.body_frame(), [0.0, 1.0, 0.0]),
        ):
            joint = plant.AddJoint(PrismaticJoint(name, parent, child, np.array(axis)))
            actuator = plant.AddJointActuator(name, joint)
            actuator.set_controller_gains(PdControllerGains(p=1e7, d=1e5))
        contact = ProximityProperties()
        friction = CoulombFriction(FINGER_FRICTION, FINGER_FRICTION)
        AddContactMaterial(dissipation=20.0, point_stiffness=1e8, friction=friction, properties=contact)
        # The shapes of one half of the gripper's finger, which points downwards.
        gripper, scene_graph, arm = lone_arm()
        pin = gripper.GetFrameByName("left_finger", arm.gripper)
        X_PT = gripper.GetFrameByName("tip").CalcPose(gripper.CreateDefaultContext(), pin)
        X_FP = RigidTransform(RollPitchYaw(np.pi, 0, 0), [0, 0, FINGER_HEIGHT]) @ X_PT.inverse()
        inspector = scene_graph.model_inspector()
        frame = gripper.GetBodyFrameIdOrThrow(pin.body().index())
        shapes, center = {}, np.zeros(3)
        for shape in inspector.GetGeometries(frame, Role.kProximity):
            X_FG = X_FP @ inspector.GetPoseInFrame(shape)
            name = inspector.GetName(shape).split("::")[-1]
            shapes[name] = plant.RegisterCollisionGeometry(
                finger, X_FG, inspector.GetShape(shape), name, contact
            )
            if name == "left_end":
                center = X_FG.translation()
        push_with_balls(
            plant, true_object, [(finger, center)], FINGER_RADIUS, contact, instead_of=[shapes["left_end"]]
        )
