"""Arm, drivers, executor and a box on a table, built once."""

from dataclasses import dataclass

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Box, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.execution.arm_motion import FingerKinematics
from slipmap.diagrams.execution.push_executor import PushExecutor
from slipmap.diagrams.execution.requests import ActivePush
from slipmap.diagrams.station.arm import HOME, add_arm, add_arm_drivers, arm_model

TIME_STEP = 0.002
SAMPLE = 0.01
BOX = np.array([0.1, 0.14, 0.06])
BOX_MASS = 1.0
FINGERS = ("left_finger", "right_finger")


@dataclass(frozen=True)
class Sample:
    time: float
    status: object
    command: np.ndarray
    measured: np.ndarray
    tip: np.ndarray  # in the plant
    tip_pose: RigidTransform  # as the executor says
    tip_force: np.ndarray  # as the executor says
    contact_force: np.ndarray  # in the plant, of the finger on whatever it touches
    torque_external: np.ndarray
    box: np.ndarray


class Rig:
    def __init__(self):
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=TIME_STEP, discrete_contact_approximation="lagged")
        self.plant, _ = AddMultibodyPlant(config, builder)
        self.arm = add_arm(self.plant)
        self._add_table_and_box()
        self.plant.Finalize()
        add_arm_drivers(builder, self.plant, self.arm)
        builder.ExportOutput(self.plant.get_contact_results_output_port(), "contacts")
        station = builder.Build()

        builder = DiagramBuilder()
        self.station = builder.AddNamedSystem("station", station)
        self.executor = builder.AddNamedSystem("executor", PushExecutor(arm_model(), HOME))
        builder.Connect(
            self.executor.GetOutputPort("gripper.position"), station.GetInputPort("gripper.position")
        )
        self._connect_command(builder)
        for name in ("iiwa.position_measured", "iiwa.torque_external"):
            builder.Connect(station.GetOutputPort(name), self.executor.GetInputPort(name))
        for name in ("push", "abort"):
            builder.ExportInput(self.executor.GetInputPort(name), name)
        self.diagram = builder.Build()
        self.kinematics = FingerKinematics(arm_model())

    def _connect_command(self, builder):
        name = "iiwa.position"
        builder.Connect(self.executor.GetOutputPort(name), self.station.GetInputPort(name))

    def _add_table_and_box(self):
        friction = CoulombFriction(0.5, 0.5)
        self.plant.RegisterCollisionGeometry(
            self.plant.world_body(), RigidTransform([0, 0, -0.5]), Box(2, 2, 1), "table", friction
        )
        body = self.plant.AddRigidBody(
            "box", self.plant.AddModelInstance("box"), SpatialInertia.SolidBoxWithMass(BOX_MASS, *BOX)
        )
        # Feet carry it, so that the block itself does not rub on the table.
        self.plant.RegisterCollisionGeometry(
            body, RigidTransform(), Box(*(BOX - [0, 0, 0.008])), "block", friction
        )
        for x in (-0.045, 0.045):
            for y in (-0.065, 0.065):
                foot = RigidTransform([x, y, -BOX[2] / 2 + 0.005])
                self.plant.RegisterCollisionGeometry(body, foot, Sphere(0.005), f"foot{x}{y}", friction)
        self.plant.SetDefaultFloatingBaseBodyPose(body, RigidTransform([0, 0, BOX[2] / 2]))
        self.box = body

    def start(self, push=None, push_id=1, at=HOME):
        simulator = Simulator(self.diagram)
        context = simulator.get_mutable_context()
        station = self.station.GetMyMutableContextFromRoot(context)
        self.station.GetInputPort("gripper.force_limit").FixValue(station, [40.0])
        self.plant.SetPositions(self.plant.GetMyMutableContextFromRoot(context), self.arm.iiwa, at)
        self.request(simulator, push, push_id)
        self.abort(simulator, False)
        return simulator

    def request(self, simulator, push, push_id):
        value = None if push is None else ActivePush(push_id, push)
        self.diagram.GetInputPort("push").FixValue(simulator.get_mutable_context(), Value[object](value))

    def abort(self, simulator, value):
        self.diagram.GetInputPort("abort").FixValue(simulator.get_mutable_context(), Value[object](value))

    def sample(self, simulator):
        context = simulator.get_context()
        executor = self.executor.GetMyContextFromRoot(context)
        station = self.station.GetMyContextFromRoot(context)
        plant = self.plant.GetMyContextFromRoot(context)
        out = {
            name: self.executor.GetOutputPort(name).Eval(executor)
            for name in ("status", "iiwa.position", "tip_pose", "tip_force")
        }
        return Sample(
            context.get_time(),
            out["status"],
            out["iiwa.position"].copy(),
            self.station.GetOutputPort("iiwa.position_measured").Eval(station).copy(),
            self.plant.get_frame(self.arm.tip).CalcPoseInWorld(plant).translation(),
            RigidTransform(out["tip_pose"]),  # what comes from a port changes with it
            out["tip_force"].copy(),
            self._contact_force(station),
            self.station.GetOutputPort("iiwa.torque_external").Eval(station).copy(),
            self.plant.EvalBodyPoseInWorld(plant, self.box).translation(),
        )

    def _contact_force(self, station):
        results = self.station.GetOutputPort("contacts").Eval(station)
        force = np.zeros(3)
        for k in range(results.num_point_pair_contacts()):
            contact = results.point_pair_contact_info(k)
            # The force acts on B.
            if self.plant.get_body(contact.bodyA_index()).name() in FINGERS:
                force += contact.contact_force()
            elif self.plant.get_body(contact.bodyB_index()).name() in FINGERS:
                force -= contact.contact_force()
        return force

    def run(self, simulator, until, longest=20.0):
        """Samples until a condition on them holds."""
        log = [self.sample(simulator)]
        while not until(log[-1]):
            now = simulator.get_context().get_time()
            assert now < longest, f"still {log[-1].status} after {now} s"
            simulator.AdvanceTo(round(now / SAMPLE + 1) * SAMPLE)
            log.append(self.sample(simulator))
        return log


def done(push_id=1):
    return lambda sample: sample.status.push_id == push_id and sample.status.mode in ("home", "refused")
