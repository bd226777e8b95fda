"""The block that lets good messages through: what it holds, and how it warns."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
import pytest
from good_messages import HEIGHT, WIDTH, iiwa_status
from pydrake.lcm import DrakeLcm
from pydrake.manipulation import IiwaStatusReceiver
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.hardware.checked_messages import CheckedMessages, MessagePump, rules
from slipmap.diagrams.hardware.network import IIWA_STATUS
from slipmap.diagrams.station.arm import HOME


class Listener:
    """A checked channel in a diagram."""

    def __init__(self, clock: Callable[[], float] | None = None) -> None:
        self.lcm = DrakeLcm("memq://")
        builder = DiagramBuilder()
        builder.AddSystem(MessagePump(self.lcm))
        self.checked = builder.AddSystem(
            CheckedMessages(IIWA_STATUS, rules(WIDTH, HEIGHT)[IIWA_STATUS], clock)
        )
        self.lcm.Subscribe(IIWA_STATUS, self.checked.hear)
        self.receiver = builder.AddSystem(IiwaStatusReceiver())
        builder.Connect(self.checked.GetOutputPort("message"), self.receiver.get_input_port())
        self.simulator = Simulator(builder.Build())
        self.root = self.simulator.get_mutable_context()

    def hear(self, *messages: bytes, until: float) -> None:
        for message in messages:
            self.lcm.Publish(IIWA_STATUS, message)
        self.simulator.AdvanceTo(until)

    def says(self, port: str):
        return self.checked.GetOutputPort(port).Eval(self.checked.GetMyContextFromRoot(self.root))

    def measured(self) -> np.ndarray:
        context = self.receiver.GetMyContextFromRoot(self.root)
        return self.receiver.GetOutputPort("position_measured").Eval(context)


@pytest.fixture
def listener() -> Listener:
    return Listener()


def test_before_the_first_message_the_age_is_infinite(listener):
    listener.hear(b"junk", until=0.1)
    assert listener.says("age")[0] == np.inf
    assert np.isnan(listener.says("stamp")[0])
    assert (listener.measured() == 0).all()


def test_stamp_and_age_are_those_of_the_newest_good_message(listener):
    message = iiwa_status()
    listener.hear(message.encode(), until=0.25)
    message.utime = 1_250_000
    listener.hear(message.encode(), until=0.3)
    assert listener.says("stamp")[0] == 1.25
    assert listener.says("age")[0] == pytest.approx(0.05)
    message.utime = 1_200_000
    message.joint_position_measured = [0.0] * 7
    listener.hear(b"", message.encode(), until=0.5)
    assert listener.says("stamp")[0] == 1.25
    assert listener.says("age")[0] == pytest.approx(0.25)
    np.testing.assert_array_equal(listener.measured(), HOME)
    assert dict(listener.says("received").dropped) == {"cannot be decoded": 1, "stamp goes back": 1}


def test_ages_come_from_stamps_and_slowly_from_when_messages_come(listener):
    message = iiwa_status()
    for k in range(100):
        message.utime = 1_000_000 + 5000 * k
        listener.hear(message.encode(), until=0.005 * (k + 1))
    # The diagram was busy for 30 ms and reads the newest message before its clock goes on.
    message.utime += 35_000
    listener.hear(message.encode(), until=0.505)
    assert listener.says("age")[0] == pytest.approx(-0.025, abs=0.005)
    for k in range(1000):  # from now on its clock stays late
        message.utime += 5000
        listener.hear(message.encode(), until=0.505 + 0.005 * (k + 1))
    assert listener.says("age")[0] == pytest.approx(0.005, abs=1e-4)


def test_silence_is_told_by_the_computers_clock_where_the_diagrams_is_late():
    """The diagram's clock goes at a tenth of the pace; a standstill of the process counts as 10 ms."""
    now = [50.0]
    listener = Listener(clock=lambda: now[0])
    message = iiwa_status()
    listener.hear(message.encode(), until=0.001)
    assert listener.says("silence")[0] == 0.0
    for k in range(8):
        now[0] += 0.005
        listener.hear(until=0.001 + 0.0005 * (k + 1))
    assert listener.says("silence")[0] == pytest.approx(0.04)
    assert listener.says("age")[0] == pytest.approx(0.004, abs=1e-3)
    now[0] += 3.0
    listener.hear(b"junk", until=0.006)
    assert listener.says("silence")[0] == pytest.approx(0.05)
    message.utime += 5000
    now[0] += 0.005
    listener.hear(message.encode(), until=0.007)
    assert listener.says("silence")[0] == 0.0


def test_a_warning_names_channel_and_cause_and_is_not_repeated_for_ever(listener, caplog):
    with caplog.at_level(logging.WARNING):
        for k in range(25):
            listener.hear(b"junk", until=0.01 * (k + 1))
    lines = [record.getMessage() for record in caplog.records]
    assert lines == [f"IIWA_STATUS: message dropped, cannot be decoded ({count} so far)" for count in (1, 10)]
    assert listener.says("received").dropped["cannot be decoded"] == 25


def test_a_context_keeps_what_it_heard(listener):
    listener.hear(iiwa_status().encode(), until=0.1)
    copy = listener.root.Clone()
    message = iiwa_status()
    message.utime = 2_000_000
    listener.hear(message.encode(), until=0.2)
    port = listener.checked.GetOutputPort("stamp")
    assert port.Eval(listener.checked.GetMyContextFromRoot(copy))[0] == 1.0
    assert listener.says("stamp")[0] == 2.0
