"""A twin of the real cell: the simulated station behind the messages that arm, gripper and camera send."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
from drake import lcmt_drake_signal, lcmt_iiwa_status, lcmt_image_array, lcmt_schunk_wsg_status
from pydrake.common.value import AbstractValue, Value
from pydrake.lcm import DrakeLcmInterface
from pydrake.manipulation import (
    IiwaCommandReceiver,
    IiwaControlMode,
    IiwaStatusSender,
    SchunkWsgCommandReceiver,
    SchunkWsgStatusSender,
)
from pydrake.math import RigidTransform
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    EventStatus,
    State,
)
from pydrake.systems.lcm import LcmPublisherSystem
from pydrake.systems.primitives import ConstantVectorSource
from pydrake.systems.sensors import ImageToLcmImageArrayT, PixelType

from diagrams.collectable import PythonDiagram, PythonSystem, weakly
from diagrams.hardware import channels
from diagrams.hardware.command_stream import CommandBuffer
from diagrams.hardware.message_pump import MessagePump
from diagrams.hardware.messages import CheckedMessages, Received, publish
from diagrams.hardware.validation import POSE_COORDINATES, rules
from diagrams.station.scenario import Scenario
from diagrams.station.station import Station
from diagrams.systems.held import held, read, replace_held
from models.robots import GRIP_FORCE

_PLAYED_LATER = 0.015  # s; messages do not come quite evenly


class CellTwin(PythonDiagram):
    """The station that is told by messages what to do, and says by messages what it does.

    It has no ports; its subsystem `station` is the `Station`. Messages of the arm are sent at 200 Hz, of the
    gripper at 20 Hz, pictures at the camera's rate, packed, with where they were taken from. The stamps are
    the diagram's clock. Until commands come the arm stays as it is, and the gripper is closed. The arm
    follows commands at the pace at which they were sent, also where this process was late and would see a
    leap.

    Args:
        scenario: what the cell is like.
        lcm: where messages come and go.
        arm: whether arm and gripper take part.
        camera: whether the camera does; rendering takes so long that arm and camera are best kept apart.

    Raises:
        ValueError, RendererUnavailable: as `Station`.
    """

    def __init__(
        self, scenario: Scenario, lcm: DrakeLcmInterface, *, arm: bool = True, camera: bool = True
    ) -> None:
        super().__init__()
        builder = DiagramBuilder()
        self.station: Station = builder.AddSystem(Station(scenario))
        self._checked: dict[str, CheckedMessages] = {}
        if arm:
            builder.AddSystem(MessagePump(lcm))
            rule = rules(scenario.camera.width, scenario.camera.height_pixels)
            self._checked = {
                channel: builder.AddNamedSystem(channel, CheckedMessages(channel, rule[channel]))
                for channel in (channels.IIWA_COMMAND, channels.GRIPPER_COMMAND)
            }
            for channel, system in self._checked.items():
                lcm.Subscribe(channel, weakly(system.hear))
            _add_arm(builder, self.station, lcm, self._checked[channels.IIWA_COMMAND])
            _add_gripper(builder, self.station, lcm, self._checked[channels.GRIPPER_COMMAND])
        if camera:
            self.camera_publishers = _add_camera(builder, self.station, lcm, scenario)
        builder.BuildInto(self)
        self.set_name("cell_twin")

    def received(self, root: Context) -> dict[str, Received]:
        """What came on each channel until now, and what of it was dropped."""
        return {
            name: system.received(system.GetMyContextFromRoot(root)) for name, system in self._checked.items()
        }


def _add_arm(
    builder: DiagramBuilder, station: Station, lcm: DrakeLcmInterface, commands: CheckedMessages
) -> None:
    receiver = builder.AddSystem(IiwaCommandReceiver(7, IiwaControlMode.kPositionOnly))
    sender = builder.AddSystem(IiwaStatusSender())
    no_torque = builder.AddSystem(ConstantVectorSource(np.zeros(7)))
    status = publish(builder, lcm, channels.IIWA_STATUS, lcmt_iiwa_status, channels.ARM_PERIOD)
    measured = station.GetOutputPort("iiwa.position_measured")
    builder.Connect(commands.GetOutputPort("message"), receiver.GetInputPort("lcmt_iiwa_command"))
    builder.Connect(measured, receiver.GetInputPort("position_measured"))
    paced = builder.AddSystem(_Paced())
    builder.Connect(receiver.GetOutputPort("position"), paced.GetInputPort("position"))
    builder.Connect(commands.GetOutputPort("stamp"), paced.GetInputPort("stamp"))
    builder.Connect(paced.get_output_port(), station.GetInputPort("iiwa.position"))
    builder.Connect(measured, sender.GetInputPort("position_measured"))
    for name in ("position_commanded", "velocity_estimated", "torque_external"):
        builder.Connect(station.GetOutputPort(f"iiwa.{name}"), sender.GetInputPort(name))
    builder.Connect(no_torque.get_output_port(), sender.GetInputPort("torque_commanded"))
    builder.Connect(sender.get_output_port(), status.get_input_port())


def _add_gripper(
    builder: DiagramBuilder, station: Station, lcm: DrakeLcmInterface, commands: CheckedMessages
) -> None:
    receiver = builder.AddSystem(SchunkWsgCommandReceiver(initial_position=0.0, initial_force=GRIP_FORCE / 2))
    sender = builder.AddSystem(SchunkWsgStatusSender())
    status = publish(builder, lcm, channels.GRIPPER_STATUS, lcmt_schunk_wsg_status, channels.GRIPPER_PERIOD)
    builder.Connect(commands.GetOutputPort("message"), receiver.GetInputPort("command_message"))
    for name in ("position", "force_limit"):
        builder.Connect(receiver.GetOutputPort(name), station.GetInputPort(f"gripper.{name}"))
    builder.Connect(station.GetOutputPort("gripper.state_measured"), sender.get_state_input_port())
    builder.Connect(sender.get_output_port(), status.get_input_port())


def _add_camera(
    builder: DiagramBuilder, station: Station, lcm: DrakeLcmInterface, scenario: Scenario
) -> dict[str, LcmPublisherSystem]:
    """Returns the publishers by their channels."""
    period = 1.0 / scenario.camera.rate
    result = {}
    for channel, port, pixels, every in (
        (channels.CAMERA_DEPTH, "camera.depth_image", PixelType.kDepth32F, period),
        (channels.CAMERA_COLOR, "camera.rgb_image", PixelType.kRgba8U, max(channels.COLOR_PERIOD, period)),
    ):
        packer = ImageToLcmImageArrayT(do_compress=True)
        image = packer.DeclareImageInputPort[pixels]("camera")
        builder.AddNamedSystem(f"{channel}_packer", packer)
        publisher = publish(builder, lcm, channel, lcmt_image_array, every)
        builder.Connect(station.GetOutputPort(port), image)
        builder.Connect(packer.image_array_t_msg_output_port(), publisher.get_input_port())
        result[channel] = publisher
    pose = builder.AddSystem(_PoseSender())
    publisher = builder.AddNamedSystem(
        f"{channels.CAMERA_POSE}_publisher",
        LcmPublisherSystem.Make(channels.CAMERA_POSE, lcmt_drake_signal, lcm, publish_period=period),
    )
    builder.Connect(station.GetOutputPort("camera.X_WC"), pose.get_input_port())
    builder.Connect(pose.get_output_port(), publisher.get_input_port())
    return {**result, channels.CAMERA_POSE: publisher}


class _Paced(PythonSystem):
    """Commands at the pace of their stamps; before the first, angles as they come."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareVectorInputPort("position", 7)
        self.DeclareVectorInputPort("stamp", 1)
        self._played = self.DeclareAbstractState(held((CommandBuffer(_PLAYED_LATER), np.nan, None)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(channels.ARM_PERIOD, 0.0, self._play)
        self.DeclareVectorOutputPort("paced", 7, self._calc)

    def _play(self, context: Context, state: State) -> EventStatus:
        before, last, _ = read(context, self._played)
        buffer = deepcopy(before)
        stamp = float(self.GetInputPort("stamp").Eval(context)[0])
        if np.isfinite(stamp) and stamp != last:
            buffer.add(stamp, self.GetInputPort("position").Eval(context))
        # It counts from above 0, which to it means that it was never asked.
        q = buffer.at(1.0 + context.get_time())
        replace_held(state, self._played, (buffer, stamp, q))
        return EventStatus.Succeeded()

    def _calc(self, context: Context, output: BasicVector) -> None:
        q = read(context, self._played)[2]
        output.SetFromVector(self.GetInputPort("position").Eval(context) if q is None else q)


class _PoseSender(PythonSystem):
    """A pose as seven named numbers."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareAbstractInputPort("pose", Value(RigidTransform()))
        self.DeclareAbstractOutputPort("message", lambda: Value(lcmt_drake_signal()), self._calc)

    def _calc(self, context: Context, output: AbstractValue) -> None:
        X: RigidTransform = self.get_input_port().Eval(context)
        message = lcmt_drake_signal()
        message.dim = len(POSE_COORDINATES)
        message.coord = list(POSE_COORDINATES)
        message.val = [*map(float, X.translation()), *map(float, X.rotation().ToQuaternion().wxyz())]
        message.timestamp = round(1e6 * context.get_time())
        output.set_value(message)
