"""The real cell, or its twin in another process, with the ports that the station has."""

from __future__ import annotations

import time
from collections.abc import Mapping

from drake import lcmt_drake_signal, lcmt_iiwa_command, lcmt_schunk_wsg_command
from pydrake.common.value import Value
from pydrake.lcm import DrakeLcmInterface
from pydrake.manipulation import IiwaCommandSender, IiwaControlMode, SchunkWsgCommandSender
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import PassThrough

from diagrams.collectable import PythonDiagram, PythonSystem, weakly
from diagrams.execution.messages import Health
from diagrams.hardware import channels, network
from diagrams.hardware.command_stream import CommandStream
from diagrams.hardware.heard_cell import ARM, CAMERA, NEEDED, HeardCell
from diagrams.hardware.message_pump import MessagePump
from diagrams.hardware.messages import CheckedMessages, Received, publish
from diagrams.hardware.validation import ABORT_COORDINATES, rules
from diagrams.station.scenario import Scenario

PATIENCE = 10.0
"""s that the cell has for its first messages."""

OWN = ("health", "iiwa.silence", "abort")
"""Ports that only a real cell has."""


class HardwareInterface(PythonDiagram):
    """The cell behind an LCM address.

    .. pydrake_system::

        name: HardwareInterface
        input_ports:
        - iiwa.position
        - gripper.position
        - gripper.force_limit
        - health (optional)
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
        - abort

    The ports are those of `Station`, less those that only a simulation has, and `OWN`: `iiwa.silence` (1,),
    s, is that of `CheckedMessages`; `abort` (1,) is 1 once `abort` was called or a message on the channel of
    that name said so. `health` is that of the guard that stands before it: the arm brakes at once when that
    stops it, not only when the commands do that are still to be played. Every message is checked before
    anything of it is used (`CheckedMessages`, one a channel, named like it), and `connect` must be called
    before the simulation begins. A Simulator runs it at `realtime_rate`.

    Args:
        lcm: the address of a cell that runs by itself, see `network.open_lcm`. Then a thread hears messages,
            and a process sends the arm's commands, both however busy the diagram is. Or a connection, such as
            one in memory, that the diagram itself serves at its steps.
        scenario: what the cell is like; of the object nothing is used.

    Raises:
        HardwareError: a malformed address, or no network.
    """

    realtime_rate = 1.0
    """At which a Simulator runs it."""

    def __init__(self, lcm: str | DrakeLcmInterface, scenario: Scenario) -> None:
        super().__init__()
        alone = isinstance(lcm, str)
        self._url = lcm if isinstance(lcm, str) else lcm.get_lcm_url()
        self._lcm = network.open_lcm(lcm) if isinstance(lcm, str) else lcm
        builder = DiagramBuilder()
        if not alone:
            builder.AddSystem(MessagePump(self._lcm))
        clock = time.monotonic if alone else None
        self._heard = builder.AddNamedSystem("heard", HeardCell(scenario, clock))
        self.arm_hulls = self._heard.arm_hulls
        self._checked = self._heard.checked
        self._listeners: list[network.Listener] = []
        rule = rules(scenario.camera.width, scenario.camera.height_pixels)[channels.ABORT]
        self._stop = builder.AddNamedSystem(channels.ABORT, CheckedMessages(channels.ABORT, rule))
        abort = builder.AddSystem(_Abort())
        builder.Connect(self._stop.GetOutputPort("received"), abort.get_input_port())
        builder.ExportOutput(abort.get_output_port(), "abort")
        if not alone:
            for channel, system in {**self._checked, channels.ABORT: self._stop}.items():
                self._lcm.Subscribe(channel, weakly(system.hear))
        for index in range(self._heard.num_output_ports()):
            port = self._heard.get_output_port(index)
            builder.ExportOutput(port, port.get_name())
        self._add_arm_commands(builder, alone)
        self._add_gripper_commands(builder)
        builder.BuildInto(self)
        self.set_name("station")

    def connect(self, root: Context, patience: float = PATIENCE) -> None:
        """Wait for the first messages and let the Context begin with them; then commands may be sent.

        Args:
            root: of the diagram that this one is in.
            patience: longest time to wait, s.

        Raises:
            HardwareError: names the channels that are silent, or what is wrong with what comes.
        """
        self.close()
        if isinstance(self._sender, _StreamSender):
            # Pictures take some ms to check, for which the arm does not wait.
            everyone = {**self._checked, channels.ABORT: self._stop}
            self._listeners = [
                network.Listener(self._url, {name: everyone[name].hear for name in together})
                for together in ((*ARM, channels.ABORT), CAMERA)
            ]
            self._sender.start(self._url)  # before, since it takes a while, and messages shall be fresh
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
                raise channels.HardwareError(self._silence(silent, came, patience))

    def _silence(self, silent: list[str], came: Mapping[str, Received], patience: float) -> str:
        causes = [f"{name}: {', '.join(came[name].dropped)}" for name in silent if came[name].dropped]
        heard = f" ({'; '.join(causes)})" if causes else ""
        return (
            f"no good message on {', '.join(silent)} at {self._url} within {patience:g} s{heard}; see that"
            f" the cell's drivers run there, or start its twin with `slipmap station --lcm '{self._url}'` and"
            " the same scenario"
        )

    def abort(self) -> None:
        """Stop the arm, for good, at the diagram's next step; may be called by another thread."""
        message = lcmt_drake_signal()
        message.dim, message.coord, message.val = 1, list(ABORT_COORDINATES), [1.0]
        self._stop.hear(bytes(message.encode()))

    def close(self) -> None:
        """Let the arm come to rest, send no more commands, and hear no more messages."""
        if isinstance(self._sender, _StreamSender):
            self._sender.stop()
        while self._listeners:
            self._listeners.pop().close()

    def received(self, root: Context) -> dict[str, Received]:
        """What came on each channel until now, and what of it was dropped."""
        return self._heard.received(root)

    def _add_arm_commands(self, builder: DiagramBuilder, alone: bool) -> None:
        self._sender: LeafSystem
        if alone:
            self._sender = builder.AddNamedSystem(f"{channels.IIWA_COMMAND}_stream", _StreamSender())
            builder.ExportInput(self._sender.GetInputPort("health"), "health")
        else:
            unused = builder.AddSystem(PassThrough(Value[object](None)))  # nothing waits to be played
            builder.ExportInput(unused.get_input_port(), "health")
            self._sender = builder.AddSystem(IiwaCommandSender(7, IiwaControlMode.kPositionOnly))
            publisher = publish(
                builder, self._lcm, channels.IIWA_COMMAND, lcmt_iiwa_command, channels.ARM_PERIOD
            )
            builder.Connect(self._sender.get_output_port(), publisher.get_input_port())
        builder.ExportInput(self._sender.GetInputPort("position"), "iiwa.position")

    def _add_gripper_commands(self, builder: DiagramBuilder) -> None:
        sender = builder.AddSystem(SchunkWsgCommandSender())
        publisher = publish(
            builder, self._lcm, channels.GRIPPER_COMMAND, lcmt_schunk_wsg_command, channels.GRIPPER_PERIOD
        )
        builder.Connect(sender.get_output_port(), publisher.get_input_port())
        builder.ExportInput(sender.get_position_input_port(), "gripper.position")
        builder.ExportInput(sender.get_force_limit_input_port(), "gripper.force_limit")


class _Abort(PythonSystem):
    """Whether the newest message says that the arm is to be stopped; not before the first."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareAbstractInputPort("received", Value[object](None))
        self.DeclareVectorOutputPort("abort", 1, self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        data = self.get_input_port().Eval(context).data
        output.SetFromVector([lcmt_drake_signal.decode(data).val[0] if data else 0.0])


class _StreamSender(PythonSystem):
    """Hands the arm's commands to the process that sends them."""

    def __init__(self) -> None:
        super().__init__()
        self._stream: CommandStream | None = None
        self.DeclareVectorInputPort("position", 7)
        self.DeclareAbstractInputPort("health", Value[object](None))
        self.DeclarePeriodicPublishEvent(channels.ARM_PERIOD, 0.0, self._send)

    def start(self, url: str) -> None:
        """Start the process."""
        self.stop()
        self._stream = CommandStream(url)

    def stop(self) -> None:
        """End it."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _send(self, context: Context) -> EventStatus:
        if self._stream is None:
            raise channels.HardwareError("hardware: call `connect` before the simulation begins")
        port = self.GetInputPort("health")
        health: Health | None = port.Eval(context) if port.HasValue(context) else None
        if health is not None and health.mode == "stopped" and not health.back:
            self._stream.stop()
        else:
            self._stream.send(context.get_time(), self.GetInputPort("position").Eval(context))
        return EventStatus.Succeeded()
