"""The real cell, or its twin in another process, with the ports of the station.

`HeardCell` receives the messages of arm, gripper and camera; `HardwareInterface` also sends commands.
"""

import time
from collections.abc import Callable, Mapping

import numpy as np
from drake import lcmt_drake_signal, lcmt_iiwa_command, lcmt_schunk_wsg_command
from pydrake import manipulation
from pydrake.common.eigen_geometry import Quaternion
from pydrake.common.value import Value
from pydrake.lcm import DrakeLcmInterface
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import PassThrough
from pydrake.systems.sensors import LcmImageArrayToImages

from slipmap.diagrams.execution.requests import Health
from slipmap.diagrams.hardware import checked_messages, network
from slipmap.diagrams.hardware.command_stream import CommandStream
from slipmap.diagrams.hardware.network import ARM, CAMERA, NEEDED
from slipmap.diagrams.perception.sight import ArmHulls
from slipmap.diagrams.station.arm import IIWA_OUTPUTS, lone_arm
from slipmap.diagrams.station.scenario import Scenario, check_scenario
from slipmap.diagrams.systems.python_system import PythonDiagram, PythonSystem

PATIENCE = 10.0  # time that the cell has to send its first messages, s
OWN = ("health", "iiwa.silence", "abort")  # ports that only a real cell has


class HeardCell(PythonDiagram):
    """The messages of arm, gripper and camera as ports.

    The output ports are those of `Station`, without those that only a simulation has, and `iiwa.silence`,
    which is that of `CheckedMessages`. Messages go to `checked`, which has one `CheckedMessages` per channel,
    named like the channel, and are checked before any part of them is used.

    Args:
        scenario: of the cell; its object is not used.
        clock: for the arm's status, see `CheckedMessages`.
    """

    def __init__(self, scenario: Scenario, clock: Callable[[], float] | None = None) -> None:
        super().__init__()
        check_scenario(scenario)
        builder = DiagramBuilder()
        self.checked = checked_messages.add_checked(
            builder, scenario.camera, (*ARM, *CAMERA), {network.IIWA_STATUS: clock}
        )
        self._export_arm(builder)
        self._export_camera(builder)
        plant, scene_graph, arm = lone_arm(scenario.arm.models, scenario.execution.finger_radius)
        self.arm_hulls = ArmHulls(plant, scene_graph, [arm.iiwa, arm.gripper])
        builder.BuildInto(self)
        self.set_name("heard_cell")

    def _export_arm(self, builder: DiagramBuilder) -> None:
        status = builder.AddSystem(manipulation.IiwaStatusReceiver())
        checked = self.checked[network.IIWA_STATUS]
        builder.Connect(checked.GetOutputPort("message"), status.GetInputPort("lcmt_iiwa_status"))
        for name in IIWA_OUTPUTS:
            builder.ExportOutput(status.GetOutputPort(name), f"iiwa.{name}")
        for name in ("age", "silence"):
            builder.ExportOutput(checked.GetOutputPort(name), f"iiwa.{name}")
        gripper = builder.AddSystem(manipulation.SchunkWsgStatusReceiver())
        message = self.checked[network.GRIPPER_STATUS].GetOutputPort("message")
        builder.Connect(message, gripper.get_status_input_port())
        builder.ExportOutput(gripper.get_state_output_port(), "gripper.state_measured")

    def _export_camera(self, builder: DiagramBuilder) -> None:
        for channel, picture, port in (
            (network.CAMERA_DEPTH, "depth_image", "camera.depth_image"),
            (network.CAMERA_COLOR, "color_image", "camera.rgb_image"),
        ):
            images = builder.AddSystem(LcmImageArrayToImages())
            message = self.checked[channel].GetOutputPort("message")
            builder.Connect(message, images.image_array_t_input_port())
            builder.ExportOutput(images.GetOutputPort(picture), port)
        pose = builder.AddSystem(_PoseReceiver())
        received = self.checked[network.CAMERA_POSE].GetOutputPort("received")
        builder.Connect(received, pose.get_input_port())
        builder.ExportOutput(pose.get_output_port(), "camera.X_WC")
        age = builder.AddSystem(_PictureAge())
        for name, channel, port in (
            ("arm_stamp", network.IIWA_STATUS, "stamp"),
            ("arm_age", network.IIWA_STATUS, "age"),
            ("picture_stamp", network.CAMERA_DEPTH, "stamp"),
            ("picture_age", network.CAMERA_DEPTH, "age"),
        ):
            builder.Connect(self.checked[channel].GetOutputPort(port), age.GetInputPort(name))
        builder.ExportOutput(age.get_output_port(), "camera.age")


def export_outputs(builder: DiagramBuilder, system: Diagram) -> None:
    """Export all output ports of a part of a diagram under their own names."""
    for index in range(system.num_output_ports()):
        port = system.get_output_port(index)
        builder.ExportOutput(port, port.get_name())


class _PoseReceiver(PythonSystem):
    def __init__(self) -> None:
        super().__init__()
        self.declare_inputs("received")
        self.declare_output("pose", self._pose, {self.all_input_ports_ticket()}, Value(RigidTransform()))

    def _pose(self, context: Context) -> RigidTransform:
        data = self.input(context, "received").data
        if not data:
            return RigidTransform()
        numbers = np.array(lcmt_drake_signal.decode(data).val)
        return RigidTransform(Quaternion(numbers[3:] / np.linalg.norm(numbers[3:])), numbers[:3])


_SAME_CLOCK = 1.0  # s; stamps of arm and camera that differ by more come from different clocks


class _PictureAge(PythonSystem):
    """Age of the newest picture since it was taken.

    The arm's newest status gives the sender's present clock, so rendering and the transmission of a large
    message count as part of the age. If the camera has another clock, it is the time since the picture
    arrived.
    """

    def __init__(self) -> None:
        super().__init__()
        for name in ("arm_stamp", "arm_age", "picture_stamp", "picture_age"):
            self.DeclareVectorInputPort(name, 1)
        self.declare_vector_output("age", 1, self._age, {self.all_input_ports_ticket()})

    def _age(self, context: Context) -> list[float]:
        arm_stamp, arm_age, picture_stamp, since = (
            float(self.get_input_port(index).Eval(context)[0]) for index in range(4)
        )
        age = arm_stamp + arm_age - picture_stamp
        if not abs(age - since) < _SAME_CLOCK:
            age = since
        return [max(age, 0.0)]


class HardwareInterface(PythonDiagram):
    """The cell at an LCM address.

    The ports are those of `Station`, without those that only a simulation has, and `OWN`: `iiwa.silence`
    (1,), s, is that of `CheckedMessages`; `abort` (1,) is 1 once `abort` was called or a message on the
    channel of that name requested it, whatever follows. The optional input `health` is that of the guard in
    front of the cell: with it, the arm brakes as soon as the guard stops it, without waiting for queued
    commands.

    Every message is checked before any part of it is used (one `CheckedMessages` per channel, named like it).
    Call `connect` before the simulation starts. A Simulator runs it at `realtime_rate`.

    Args:
        lcm: address of a cell that runs on its own, see `network.open_lcm`. A thread then receives messages
            and a process sends the arm's commands, however busy the diagram is. Or a connection, such as one
            in memory, which the diagram itself serves at its steps.
        scenario: of the cell; its object is not used.

    Raises:
        HardwareError: a malformed address, or no network.
    """

    realtime_rate = 1.0

    def __init__(self, lcm: str | DrakeLcmInterface, scenario: Scenario) -> None:
        super().__init__()
        alone = isinstance(lcm, str)
        self._url = lcm if isinstance(lcm, str) else lcm.get_lcm_url()
        self._lcm = network.open_lcm(lcm) if isinstance(lcm, str) else lcm
        builder = DiagramBuilder()
        if not alone:
            builder.AddSystem(checked_messages.MessagePump(self._lcm))
        clock = time.monotonic if alone else None
        self._heard = builder.AddNamedSystem("heard", HeardCell(scenario, clock))
        self.arm_hulls = self._heard.arm_hulls
        self._checked = self._heard.checked
        self._listeners: list[network.Listener] = []
        self._stop = checked_messages.add_checked(builder, scenario.camera, [network.ABORT])[network.ABORT]
        abort = builder.AddSystem(_Abort())
        builder.Connect(self._stop.GetOutputPort("received"), abort.get_input_port())
        builder.ExportOutput(abort.get_output_port(), "abort")
        self._everyone = checked_messages.Channels({**self._checked, network.ABORT: self._stop})
        if not alone:
            self._everyone.subscribe(self._lcm)
        export_outputs(builder, self._heard)
        self._add_arm_commands(builder, alone)
        self._add_gripper_commands(builder)
        builder.BuildInto(self)
        self.set_name("station")

    def connect(self, root: Context, patience: float = PATIENCE) -> None:
        """Wait for the first messages and start the Context with them; then commands may be sent.

        Args:
            root: Context of the diagram that this one is in.
            patience: longest time to wait, s.

        Raises:
            HardwareError: names the silent channels, or the faults of their messages.
        """
        self.close()
        if isinstance(self._sender, _StreamSender):
            # Pictures take some ms to check; the arm must not wait for them.
            self._listeners = [
                network.Listener(self._url, {name: self._everyone[name].hear for name in together})
                for together in ((*ARM, network.ABORT), CAMERA)
            ]
            self._sender.start(self._url)  # first, because it takes a while and messages should be fresh
        contexts = {name: system.GetMyMutableContextFromRoot(root) for name, system in self._checked.items()}
        deadline = time.monotonic() + patience
        while True:
            if self._listeners:
                time.sleep(0.01)
            else:
                self._lcm.HandleSubscriptions(20)
            came = {name: system.take(contexts[name]) for name, system in self._checked.items()}
            silent = [name for name in NEEDED if not came[name].good]
            if not silent:
                return
            if time.monotonic() > deadline:
                raise network.HardwareError(self._silence(silent, came, patience))

    def _silence(
        self, silent: list[str], came: Mapping[str, checked_messages.Received], patience: float
    ) -> str:
        causes = [f"{name}: {', '.join(came[name].dropped)}" for name in silent if came[name].dropped]
        heard = f" ({'; '.join(causes)})" if causes else ""
        return (
            f"no valid message on {', '.join(silent)} at {self._url} within {patience:g} s{heard}; check that"
            f" the cell's drivers are running, or start its twin with `slipmap station --lcm '{self._url}'`"
            " and the same scenario"
        )

    def abort(self) -> None:
        """Stop the arm for good at the diagram's next step; may be called from another thread."""
        message = lcmt_drake_signal()
        message.dim, message.coord, message.val = 1, list(checked_messages.ABORT_COORDINATES), [1.0]
        self._stop.hear(bytes(message.encode()))

    def close(self) -> None:
        """Let the arm come to rest, and stop sending commands and receiving messages."""
        if isinstance(self._sender, _StreamSender):
            self._sender.stop()
        while self._listeners:
            self._listeners.pop().close()

    def _add_arm_commands(self, builder: DiagramBuilder, alone: bool) -> None:
        self._sender: LeafSystem
        if alone:
            self._sender = builder.AddNamedSystem(f"{network.IIWA_COMMAND}_stream", _StreamSender())
            builder.ExportInput(self._sender.GetInputPort("health"), "health")
        else:
            unused = builder.AddSystem(PassThrough(Value[object](None)))  # no commands are queued
            builder.ExportInput(unused.get_input_port(), "health")
            self._sender = builder.AddSystem(
                manipulation.IiwaCommandSender(7, manipulation.IiwaControlMode.kPositionOnly)
            )
            publisher = checked_messages.publish(
                builder, self._lcm, network.IIWA_COMMAND, lcmt_iiwa_command, network.ARM_PERIOD
            )
            builder.Connect(self._sender.get_output_port(), publisher.get_input_port())
        builder.ExportInput(self._sender.GetInputPort("position"), "iiwa.position")

    def _add_gripper_commands(self, builder: DiagramBuilder) -> None:
        sender = builder.AddSystem(manipulation.SchunkWsgCommandSender())
        publisher = checked_messages.publish(
            builder, self._lcm, network.GRIPPER_COMMAND, lcmt_schunk_wsg_command, network.GRIPPER_PERIOD
        )
        builder.Connect(sender.get_output_port(), publisher.get_input_port())
        builder.ExportInput(sender.get_position_input_port(), "gripper.position")
        builder.ExportInput(sender.get_force_limit_input_port(), "gripper.force_limit")


class _Abort(PythonSystem):
    """Whether a message has requested a stop of the arm: only such messages arrive, and the newest stays."""

    def __init__(self) -> None:
        super().__init__()
        self.declare_inputs("received")
        self.declare_vector_output("abort", 1, self._abort, {self.all_input_ports_ticket()})

    def _abort(self, context: Context) -> list[float]:
        return [1.0 if self.input(context, "received").good else 0.0]


class _StreamSender(PythonSystem):
    def __init__(self) -> None:
        super().__init__()
        self._stream: CommandStream | None = None
        self.DeclareVectorInputPort("position", 7)
        self.DeclareAbstractInputPort("health", Value[object](None))
        self.DeclarePeriodicPublishEvent(network.ARM_PERIOD, 0.0, self._send)

    def start(self, url: str) -> None:
        self.stop()
        self._stream = CommandStream(url)

    def stop(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _send(self, context: Context) -> EventStatus:
        if self._stream is None:
            raise network.HardwareError("hardware: call `connect` before the simulation starts")
        port = self.GetInputPort("health")
        health: Health | None = port.Eval(context) if port.HasValue(context) else None
        if health is not None and health.mode == "stopped" and not health.back:
            self._stream.stop()
        else:
            self._stream.send(context.get_time(), self.GetInputPort("position").Eval(context))
        return EventStatus.Succeeded()
