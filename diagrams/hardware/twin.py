"""A twin of the real cell: the simulated station behind the messages of arm, gripper and camera."""

import os
import select
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from drake import lcmt_drake_signal, lcmt_iiwa_status, lcmt_image_array, lcmt_schunk_wsg_status
from pydrake.common.value import AbstractValue, Value
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from pydrake.lcm import DrakeLcmInterface
from pydrake.manipulation import (
    IiwaCommandReceiver,
    IiwaControlMode,
    IiwaStatusSender,
    SchunkWsgCommandReceiver,
    SchunkWsgStatusSender,
)
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, State
from pydrake.systems.lcm import LcmPublisherSystem
from pydrake.systems.primitives import ConstantVectorSource
from pydrake.systems.sensors import ImageToLcmImageArrayT, PixelType

from slipmap.diagrams.hardware import network
from slipmap.diagrams.hardware.checked_messages import (
    POSE_COORDINATES,
    Channels,
    CheckedMessages,
    MessagePump,
    add_checked,
    publish,
)
from slipmap.diagrams.hardware.child import Child, be_ready, have_priority
from slipmap.diagrams.hardware.command_stream import CommandBuffer
from slipmap.diagrams.station.scenario import Scenario
from slipmap.diagrams.station.station import Station, take_fixed_steps
from slipmap.diagrams.systems.python_system import (
    PythonDiagram,
    PythonSystem,
    held,
    read,
    replace_held,
)
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import GRIP_FORCE

LATE = 0.1  # s by which the twin may be late before it stops trying to catch up: a real arm would not hurry
_REPORT_EVERY = 10.0  # s
_PLAYED_LATER = 0.015  # s; messages do not arrive quite evenly


class CellTwin(PythonDiagram):
    """The station, commanded by messages and reporting its state by messages.

    It has no ports; its subsystem `station` is the `Station`. Messages of the arm are sent at 200 Hz, those
    of the gripper at 20 Hz, and compressed pictures with the camera's pose at the camera's rate. Stamps are
    from the diagram's clock. Until commands come, the arm stays in place and the gripper is closed. The arm
    follows commands at the pace at which they were sent, even if this process was late and would otherwise
    see a jump.

    Args:
        arm: whether to include arm and gripper.
        camera: whether to include the camera; rendering is slow, so arm and camera are best kept apart.

    Raises:
        ValueError, RendererUnavailable: as for `Station`.
    """

    def __init__(
        self, scenario: Scenario, lcm: DrakeLcmInterface, *, arm: bool = True, camera: bool = True
    ) -> None:
        super().__init__()
        builder = DiagramBuilder()
        self.station: Station = builder.AddSystem(Station(scenario))
        self.checked = Channels()
        if arm:
            builder.AddSystem(MessagePump(lcm))
            commands = (network.IIWA_COMMAND, network.GRIPPER_COMMAND)
            self.checked = add_checked(builder, scenario.camera, commands)
            self.checked.subscribe(lcm)
            _add_arm(builder, self.station, lcm, self.checked[network.IIWA_COMMAND])
            _add_gripper(builder, self.station, lcm, self.checked[network.GRIPPER_COMMAND])
        if camera:
            self.camera_publishers = _add_camera(builder, self.station, lcm, scenario)
        builder.BuildInto(self)
        self.set_name("cell_twin")


def _add_arm(
    builder: DiagramBuilder, station: Station, lcm: DrakeLcmInterface, commands: CheckedMessages
) -> None:
    receiver = builder.AddSystem(IiwaCommandReceiver(7, IiwaControlMode.kPositionOnly))
    sender = builder.AddSystem(IiwaStatusSender())
    no_torque = builder.AddSystem(ConstantVectorSource(np.zeros(7)))
    status = publish(builder, lcm, network.IIWA_STATUS, lcmt_iiwa_status, network.ARM_PERIOD)
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
    status = publish(builder, lcm, network.GRIPPER_STATUS, lcmt_schunk_wsg_status, network.GRIPPER_PERIOD)
    builder.Connect(commands.GetOutputPort("message"), receiver.GetInputPort("command_message"))
    for name in ("position", "force_limit"):
        builder.Connect(receiver.GetOutputPort(name), station.GetInputPort(f"gripper.{name}"))
    builder.Connect(station.GetOutputPort("gripper.state_measured"), sender.get_state_input_port())
    builder.Connect(sender.get_output_port(), status.get_input_port())


def _add_camera(
    builder: DiagramBuilder, station: Station, lcm: DrakeLcmInterface, scenario: Scenario
) -> dict[str, LcmPublisherSystem]:
    """Add the camera's publishers and return them by channel."""
    period = 1.0 / scenario.camera.rate
    result = {}
    for channel, port, pixels, every in (
        (network.CAMERA_DEPTH, "camera.depth_image", PixelType.kDepth32F, period),
        (network.CAMERA_COLOR, "camera.rgb_image", PixelType.kRgba8U, max(network.COLOR_PERIOD, period)),
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
        f"{network.CAMERA_POSE}_publisher",
        LcmPublisherSystem.Make(network.CAMERA_POSE, lcmt_drake_signal, lcm, publish_period=period),
    )
    builder.Connect(station.GetOutputPort("camera.X_WC"), pose.get_input_port())
    builder.Connect(pose.get_output_port(), publisher.get_input_port())
    return {**result, network.CAMERA_POSE: publisher}


class _Paced(PythonSystem):
    """Plays commands at the pace of their stamps; before the first, passes angles through."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareVectorInputPort("position", 7)
        self.DeclareVectorInputPort("stamp", 1)
        self._played = self.DeclareAbstractState(held((CommandBuffer(_PLAYED_LATER), np.nan, None)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(network.ARM_PERIOD, 0.0, self._play)
        after = {self.abstract_state_ticket(self._played), self.GetInputPort("position").ticket()}
        self.declare_vector_output("paced", 7, self._paced, after)

    def _play(self, context: Context, state: State) -> EventStatus:
        before, last, _ = read(context, self._played)
        buffer = deepcopy(before)
        stamp = float(self.GetInputPort("stamp").Eval(context)[0])
        if np.isfinite(stamp) and stamp != last:
            buffer.add(stamp, self.GetInputPort("position").Eval(context))
        # Its time must exceed 0, which it takes to mean that it was never called.
        q = buffer.at(1.0 + context.get_time())
        replace_held(state, self._played, (buffer, stamp, q))
        return EventStatus.Succeeded()

    def _paced(self, context: Context) -> FloatArray:
        q = read(context, self._played)[2]
        return self.GetInputPort("position").Eval(context) if q is None else q


class _PoseSender(PythonSystem):
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


class TwinCamera(Child):
    """The twin's camera in a separate process, so that rendering does not delay the arm."""

    def __init__(self, scenario: Scenario, url: str) -> None:
        what = "the process that renders pictures"
        super().__init__(what, _take_pictures, url, yaml_dump_typed(scenario))

    def take(self, time: float, positions: FloatArray) -> None:
        """Request a picture of the plant at some positions, stamped with a time, s; earlier requests not yet
        started are dropped."""
        self.write(np.array([time, *positions], "<f8").tobytes())


def _take_pictures(url: str, scenario: str) -> None:
    source = sys.stdin.fileno()
    settings: Scenario = yaml_load_typed(schema=Scenario, data=scenario)
    twin = CellTwin(settings, network.open_lcm(url, listens=False), arm=False)
    root = Simulator(twin).get_mutable_context()
    plant = twin.station.plant
    state = plant.GetMyMutableContextFromRoot(root)
    size, color_due = 8 * (1 + plant.num_positions()), 0.0
    twin.station.GetOutputPort("camera.depth_image").Eval(twin.station.GetMyContextFromRoot(root))
    be_ready()
    while frame := _read(source, size):
        while select.select([source], [], [], 0.0)[0] and (newer := _read(source, size)):
            frame = newer
        time, *positions = np.frombuffer(frame, "<f8")
        root.SetTime(time)
        plant.SetPositions(state, np.array(positions))
        for channel, publisher in twin.camera_publishers.items():
            if channel == network.CAMERA_COLOR:
                if time < color_due:
                    continue
                color_due = time + network.COLOR_PERIOD
            publisher.ForcedPublish(publisher.GetMyContextFromRoot(root))


def _read(source: int, size: int) -> bytes:
    """Read `size` bytes, or none if the input ends earlier."""
    data = b""
    while len(data) < size:
        part = os.read(source, size - len(data))
        if not part:
            return b""
        data += part
    return data


@dataclass(frozen=True)
class TwinReport:
    """Status of the twin."""

    simulated: float  # s of simulated time
    behind: float  # s by which it is behind real time since the start
    pace: float  # simulated over real time since the previous report
    commands: int  # good commands to the arm since the previous report
    dropped: Mapping[str, Mapping[str, int]]  # messages dropped so far, by channel and cause


def report_words(report: TwinReport) -> str:
    """Status of a twin in one line."""
    if report.simulated == 0.0:
        return "running; Ctrl-C ends it"
    text = f"{report.simulated:.0f} s: {100 * report.pace:.0f} % of real time, {report.behind:.2f} s behind"
    if report.pace < 0.98:
        text += " (a larger simulation.time_step in the scenario helps)"
    return f"{text}; {report.commands} commands to the arm since the last line{dropped_words(report)}"


def dropped_words(report: TwinReport) -> str:
    """Dropped messages and causes, to continue a sentence; empty if there are none."""
    causes = [
        f"{channel} {count} times ({cause})"
        for channel, dropped in report.dropped.items()
        for cause, count in dropped.items()
    ]
    return f"; dropped: {', '.join(causes)}" if causes else ""


def run_twin(
    scenario: Scenario, url: str, report: Callable[[TwinReport], None] = lambda report: None
) -> TwinReport:
    """Run the twin until Ctrl-C, and report its status.

    Run it in a separate process, which gets real-time priority if the system allows it, because a cell does
    not wait for its driver.

    Args:
        url: see `network.open_lcm`.
        report: called at the start and every 10 s.

    Raises:
        HardwareError: see `network.open_lcm`.
        ValueError, RendererUnavailable: as for `Station`.
    """
    lcm = network.open_lcm(url)
    twin = CellTwin(scenario, lcm, camera=False)
    with closing(TwinCamera(scenario, url)) as camera:
        have_priority()
        return _run(twin, camera, 1.0 / scenario.camera.rate, report)


def _run(
    twin: CellTwin, camera: TwinCamera, period: float, report: Callable[[TwinReport], None]
) -> TwinReport:
    simulator = Simulator(twin)
    take_fixed_steps(simulator)
    simulator.set_target_realtime_rate(1.0)
    simulator.Initialize()
    root = simulator.get_mutable_context()
    plant = twin.station.plant
    state = plant.GetMyContextFromRoot(root)
    started = time.monotonic()
    pictures = 0
    last = TwinReport(0.0, 0.0, 1.0, 0, {})
    spoke, good, given_up = started, 0, 0.0

    def reported(now: float) -> TwinReport:
        received = twin.checked.received(root)
        simulated = root.get_time()
        return TwinReport(
            simulated,
            max(now - started - simulated, 0.0),
            (simulated - last.simulated) / max(now - spoke, 1e-9),
            received[network.IIWA_COMMAND].good - good,
            {channel: came.dropped for channel, came in received.items() if came.dropped},
        )

    def monitor(context: Context) -> EventStatus:
        nonlocal pictures, last, spoke, good, given_up
        simulated = context.get_time()
        twin.station.after_step(root)
        if simulated >= pictures * period - 1e-9:
            pictures += 1
            camera.take(simulated, plant.GetPositions(state))
        now = time.monotonic()
        if now - started - simulated - given_up > LATE:
            given_up = now - started - simulated
            simulator.ResetStatistics()  # it measures real time from here on
        if now - spoke > _REPORT_EVERY:
            last = reported(now)
            spoke, good = now, twin.checked.received(root)[network.IIWA_COMMAND].good
            report(last)
        return EventStatus.DidNothing()

    simulator.set_monitor(monitor)
    report(last)
    with suppress(KeyboardInterrupt):
        simulator.AdvanceTo(float("inf"))
    return reported(time.monotonic())
