"""What a cell says by messages, as ports; nothing is sent."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from drake import lcmt_drake_signal
from pydrake.common.eigen_geometry import Quaternion
from pydrake.common.value import AbstractValue, Value
from pydrake.geometry import SceneGraph
from pydrake.manipulation import IiwaStatusReceiver, SchunkWsgStatusReceiver
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder
from pydrake.systems.sensors import LcmImageArrayToImages

from diagrams.collectable import PythonDiagram, PythonSystem
from diagrams.hardware import channels
from diagrams.hardware.messages import CheckedMessages, Received
from diagrams.hardware.validation import rules
from diagrams.perception.arm_hulls import ArmHulls
from diagrams.station.arm import add_arm
from diagrams.station.scenario import Scenario

SAME_CLOCK = 1.0
"""s by which arm and camera may seem apart; if they are more, their stamps are of different clocks."""

ARM = (channels.IIWA_STATUS, channels.GRIPPER_STATUS)
CAMERA = (channels.CAMERA_DEPTH, channels.CAMERA_POSE, channels.CAMERA_COLOR)
NEEDED = (*ARM, channels.CAMERA_DEPTH, channels.CAMERA_POSE)
"""Channels without which nothing can be done."""


class HeardCell(PythonDiagram):
    """What arm, gripper and camera say.

    .. pydrake_system::

        name: HeardCell
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
        - iiwa.silence
        - camera.age

    The ports are those of `Station` of the same names; `iiwa.silence` is that of `CheckedMessages`. Whoever
    hears messages hands them to `checked`, one `CheckedMessages` a channel and named like it, which checks
    each before anything of it is used.

    Args:
        scenario: what the cell is like; of the object nothing is used.
        clock: see `CheckedMessages`, for the arm's status.
    """

    def __init__(self, scenario: Scenario, clock: Callable[[], float] | None = None) -> None:
        super().__init__()
        builder = DiagramBuilder()
        rule = rules(scenario.camera.width, scenario.camera.height_pixels)
        self.checked: dict[str, CheckedMessages] = {
            channel: builder.AddNamedSystem(
                channel,
                CheckedMessages(channel, rule[channel], clock if channel == channels.IIWA_STATUS else None),
            )
            for channel in (*ARM, *CAMERA)
        }
        self._export_arm(builder)
        self._export_camera(builder)
        self.arm_hulls = _arm_hulls(scenario)
        builder.BuildInto(self)
        self.set_name("heard_cell")

    def received(self, root: Context) -> dict[str, Received]:
        """What came on each channel until now, and what of it was dropped."""
        return {
            name: system.received(system.GetMyContextFromRoot(root)) for name, system in self.checked.items()
        }

    def _export_arm(self, builder: DiagramBuilder) -> None:
        status = builder.AddSystem(IiwaStatusReceiver())
        checked = self.checked[channels.IIWA_STATUS]
        builder.Connect(checked.GetOutputPort("message"), status.GetInputPort("lcmt_iiwa_status"))
        for name in ("position_commanded", "position_measured", "velocity_estimated", "torque_external"):
            builder.ExportOutput(status.GetOutputPort(name), f"iiwa.{name}")
        for name in ("age", "silence"):
            builder.ExportOutput(checked.GetOutputPort(name), f"iiwa.{name}")
        gripper = builder.AddSystem(SchunkWsgStatusReceiver())
        message = self.checked[channels.GRIPPER_STATUS].GetOutputPort("message")
        builder.Connect(message, gripper.get_status_input_port())
        builder.ExportOutput(gripper.get_state_output_port(), "gripper.state_measured")

    def _export_camera(self, builder: DiagramBuilder) -> None:
        for channel, picture, port in (
            (channels.CAMERA_DEPTH, "depth_image", "camera.depth_image"),
            (channels.CAMERA_COLOR, "color_image", "camera.rgb_image"),
        ):
            images = builder.AddSystem(LcmImageArrayToImages())
            message = self.checked[channel].GetOutputPort("message")
            builder.Connect(message, images.image_array_t_input_port())
            builder.ExportOutput(images.GetOutputPort(picture), port)
        pose = builder.AddSystem(_PoseReceiver())
        received = self.checked[channels.CAMERA_POSE].GetOutputPort("received")
        builder.Connect(received, pose.get_input_port())
        builder.ExportOutput(pose.get_output_port(), "camera.X_WC")
        age = builder.AddSystem(_PictureAge())
        for name, channel, port in (
            ("arm_stamp", channels.IIWA_STATUS, "stamp"),
            ("arm_age", channels.IIWA_STATUS, "age"),
            ("picture_stamp", channels.CAMERA_DEPTH, "stamp"),
            ("picture_age", channels.CAMERA_DEPTH, "age"),
        ):
            builder.Connect(self.checked[channel].GetOutputPort(port), age.GetInputPort(name))
        builder.ExportOutput(age.get_output_port(), "camera.age")


def _arm_hulls(scenario: Scenario) -> ArmHulls:
    plant, scene_graph = MultibodyPlant(1e-3), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    arm = add_arm(plant, models=scenario.arm.models)
    plant.Finalize()
    return ArmHulls(plant, scene_graph, [arm.iiwa, arm.gripper])


class _PoseReceiver(PythonSystem):
    """A pose from seven named numbers; the identity before they came."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareAbstractInputPort("received", Value[object](None))
        self.DeclareAbstractOutputPort("pose", lambda: Value(RigidTransform()), self._calc)

    def _calc(self, context: Context, output: AbstractValue) -> None:
        data = self.get_input_port().Eval(context).data
        pose = RigidTransform()
        if data:
            numbers = np.array(lcmt_drake_signal.decode(data).val)
            pose = RigidTransform(Quaternion(numbers[3:] / np.linalg.norm(numbers[3:])), numbers[:3])
        output.set_value(pose)


class _PictureAge(PythonSystem):
    """How long ago the newest picture was taken.

    The arm's newest status tells what the sender's clock shows now, so that neither rendering nor a large
    message's way counts. Where the camera has another clock, it is the time since the picture came.
    """

    def __init__(self) -> None:
        super().__init__()
        for name in ("arm_stamp", "arm_age", "picture_stamp", "picture_age"):
            self.DeclareVectorInputPort(name, 1)
        self.DeclareVectorOutputPort("age", 1, self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        arm_stamp, arm_age, picture_stamp, since = (
            float(self.get_input_port(index).Eval(context)[0]) for index in range(4)
        )
        age = arm_stamp + arm_age - picture_stamp
        if not abs(age - since) < SAME_CLOCK:
            age = since
        output.SetFromVector([max(age, 0.0)])
