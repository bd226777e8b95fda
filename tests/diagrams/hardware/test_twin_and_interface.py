"""The station and what stands in for it: the same ports, and the same values through every message."""

from __future__ import annotations

import numpy as np
import pytest
from drake import lcmt_iiwa_command
from good_messages import abort
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.hardware import network
from slipmap.diagrams.hardware.interface import OWN, HardwareInterface
from slipmap.diagrams.hardware.twin import CellTwin
from slipmap.diagrams.perception.camera import CameraConfig
from slipmap.diagrams.station.arm import HOME
from slipmap.diagrams.station.scenario import Scenario
from slipmap.diagrams.station.station import TRUTH

pytestmark = pytest.mark.usefixtures("renderer")

RATE = 10.0


class Both:
    """Twin and interface on one network and one clock."""

    def __init__(self) -> None:
        scenario = Scenario(
            camera=CameraConfig(width=160, height_pixels=120, rate=RATE, position=[0.02, 0.01])
        )
        scenario.simulation.time_step = 0.005
        self.lcm = DrakeLcm("memq://")
        builder = DiagramBuilder()
        self.twin = builder.AddSystem(CellTwin(scenario, self.lcm))
        self.interface = builder.AddSystem(HardwareInterface(self.lcm, scenario))
        for index in range(self.interface.num_input_ports()):
            port = self.interface.get_input_port(index)
            builder.ExportInput(port, port.get_name())
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.root = self.simulator.get_mutable_context()
        self.command("iiwa.position", HOME + 0.02)
        self.command("gripper.position", [0.05])
        self.command("gripper.force_limit", [30.0])

    def command(self, port: str, value) -> None:
        self.diagram.GetInputPort(port).FixValue(self.root, value)

    def real(self, port: str):
        return self._says(self.twin.station, port)

    def heard(self, port: str):
        return self._says(self.interface, port)

    def _says(self, system, port: str):
        return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(self.root))


@pytest.fixture(scope="module")
def both() -> Both:
    both = Both()
    both.simulator.AdvanceTo(0.5)
    return both


def names(system, count: str, port: str) -> list[str]:
    ports = (getattr(system, port)(index) for index in range(getattr(system, count)()))
    return [port.get_name() for port in ports]


def test_the_ports_are_the_stations_less_the_truth(both):
    station, interface = both.twin.station, both.interface
    inputs, outputs = ("num_input_ports", "get_input_port"), ("num_output_ports", "get_output_port")
    assert sorted(names(interface, *inputs)) == sorted([*names(station, *inputs), OWN[0]])
    known = [name for name in names(station, *outputs) if not name.startswith(TRUTH)]
    assert sorted(names(interface, *outputs)) == sorted([*known, *OWN[1:]])
    for name in known:
        one, other = interface.GetOutputPort(name), station.GetOutputPort(name)
        assert (one.get_data_type(), one.size()) == (other.get_data_type(), other.size()), name


def test_commands_and_states_of_the_arm_arrive(both):
    np.testing.assert_allclose(both.real("iiwa.position_commanded"), HOME + 0.02, atol=1e-12)
    for port in ("position_commanded", "position_measured", "velocity_estimated", "torque_external"):
        # At rest, so that a message of some milliseconds ago says the same.
        np.testing.assert_allclose(both.heard(f"iiwa.{port}"), both.real(f"iiwa.{port}"), atol=1e-5)
    np.testing.assert_allclose(both.heard("iiwa.position_measured"), HOME + 0.02, atol=1e-4)
    assert 0.0 <= both.heard("iiwa.age")[0] <= network.ARM_PERIOD + 1e-9


def test_the_gripper_opens_as_told(both):
    # Its simulated control keeps swinging by some millimetres.
    assert both.heard("gripper.state_measured")[0] == pytest.approx(0.05, abs=0.01)


def test_commands_that_come_late_are_followed_at_the_pace_of_their_stamps():
    both = Both()
    both.command("iiwa.position", HOME)
    both.simulator.AdvanceTo(0.2)
    message = lcmt_iiwa_command()
    # 0.1 s of motion were not heard of; the next that is heard bears that in its stamp.
    message.utime, message.num_joints, message.joint_position = 300_000, 7, list(HOME + 0.1)
    both.command("iiwa.position", HOME + 0.1)
    both.lcm.Publish(network.IIWA_COMMAND, message.encode())
    wanted = []
    for k in range(30):
        both.simulator.AdvanceTo(0.2025 + 0.005 * k)
        wanted.append(both.real("iiwa.position_commanded")[0] - HOME[0])
    assert 0.0 < np.diff(wanted).max() < 1.1 * 0.005  # 1 rad/s, not a leap
    assert wanted[-1] > 0.09


def test_pictures_and_their_place_arrive(both):
    sent = both.twin.station
    context = both.twin.station.GetMyContextFromRoot(both.root)
    assert both.heard("camera.X_WC").IsNearlyEqualTo(both.real("camera.X_WC"), 1e-12)
    picture = (np.floor(RATE * both.root.get_time() + 1e-6) + 1) / RATE
    both.simulator.AdvanceTo(picture - 1e-4)
    assert both.heard("camera.age")[0] == pytest.approx(1.0 / RATE, abs=0.01)
    both.simulator.AdvanceTo(picture + 1e-4)
    np.testing.assert_array_equal(both.heard("camera.depth_image").data, both.real("camera.depth_image").data)
    assert (
        both.heard("camera.rgb_image").data.shape
        == sent.GetOutputPort("camera.rgb_image").Eval(context).data.shape
    )
    assert both.heard("camera.age")[0] < 0.02


def test_junk_on_every_channel_changes_nothing_and_is_counted(both):
    before = both.heard("iiwa.position_measured").copy()
    picture = both.heard("camera.depth_image").data.copy()
    sides = (both.interface._heard.checked, both.twin.checked)
    for channel in (name for side in sides for name in side):
        both.lcm.Publish(channel, b"junk")
    both.simulator.AdvanceTo(both.root.get_time() + 0.02)
    for side in sides:
        for channel, came in side.received(both.root).items():
            assert dict(came.dropped) == {"cannot be decoded": 1}, channel
    np.testing.assert_allclose(both.heard("iiwa.position_measured"), before, atol=1e-5)
    np.testing.assert_array_equal(both.heard("camera.depth_image").data, picture)


def test_a_message_or_a_call_aborts_and_bad_ones_do_not(both):
    assert both.heard("abort")[0] == 0.0
    message = abort()
    message.val = [np.nan]
    for data in (b"junk", message.encode()):
        both.lcm.Publish(network.ABORT, data)
    both.simulator.AdvanceTo(both.root.get_time() + 0.01)
    assert both.heard("abort")[0] == 0.0
    both.lcm.Publish(network.ABORT, abort().encode())
    both.simulator.AdvanceTo(both.root.get_time() + 0.01)
    assert both.heard("abort")[0] == 1.0
    other = Both()
    other.interface.abort()
    other.simulator.AdvanceTo(0.01)
    assert other.heard("abort")[0] == 1.0


def test_a_stop_by_hand_stays_whatever_follows_it():
    both, released = Both(), abort()
    released.val = [0.0]
    both.lcm.Publish(network.ABORT, released.encode())
    both.simulator.AdvanceTo(0.01)
    assert both.heard("abort")[0] == 0.0
    both.interface.abort()
    for message in (released.encode(), b"junk"):  # more than wait for a busy diagram
        for _ in range(20):
            both.interface._stop.hear(message)
    for until in (0.02, 0.03):
        both.simulator.AdvanceTo(until)
        assert both.heard("abort")[0] == 1.0
        both.lcm.Publish(network.ABORT, released.encode())


def test_a_silent_cell_is_told_with_its_channels():
    lcm = DrakeLcm("memq://")
    interface = HardwareInterface(lcm, Scenario())
    lcm.Publish(network.GRIPPER_STATUS, b"junk")
    with pytest.raises(network.HardwareError) as error:
        interface.connect(interface.CreateDefaultContext(), patience=0.05)
    assert "IIWA_STATUS, SCHUNK_WSG_STATUS, CAMERA_DEPTH, CAMERA_POSE" in str(error.value)
    assert "SCHUNK_WSG_STATUS: cannot be decoded" in str(error.value)
    assert "slipmap station --lcm" in str(error.value)
