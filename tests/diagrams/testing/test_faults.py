"""What each fault makes of the messages of a channel, message by message."""

from __future__ import annotations

import sys
import time
import zlib

import numpy as np
import pytest
from drake import lcmt_iiwa_status, lcmt_image_array
from pydrake.lcm import DrakeLcm

from slipmap.diagrams.hardware import network
from slipmap.diagrams.hardware.checked_messages import rules
from slipmap.diagrams.testing.faults import KINDS, Fault, Link, Relay, RelayProcess
from slipmap.diagrams.testing.twins import free_url
from tests.diagrams.hardware import good_messages

PERIOD = 0.005
AT = 0.1  # s; the fault begins with the message 20


def status(k: int) -> bytes:
    """The message number k: a joint that turns at 1 rad/s."""
    message = good_messages.iiwa_status()
    message.utime = round(1e6 * k * PERIOD)
    message.joint_position_measured = [k * PERIOD, *[0.0] * 6]
    return bytes(message.encode())


def picture(k: int) -> bytes:
    """All of its pixels are 1 + k / 100 m."""
    shape = (good_messages.HEIGHT, good_messages.WIDTH)
    message = good_messages.depth_picture(np.full(shape, 1 + k / 100))
    message.header.utime = 1000 * k
    return bytes(message.encode())


def come(fault: Fault, make=status, count: int = 60) -> list[tuple[float, bytes]]:
    """When what comes out of a link with a fault from `AT` on."""
    link, result = Link(fault.channel), []
    for k in range(count):
        now = k * PERIOD
        if k == 20:
            link.order(fault, now)
        through = link.through(make(k), now)
        result += [(now, data) for data in (*link.due(now), *([] if through is None else [through]))]
    return result


def angles(messages) -> np.ndarray:
    """(n, 3) time, stamp and angle."""
    decoded = [(now, lcmt_iiwa_status.decode(data)) for now, data in messages]
    return np.array([(now, 1e-6 * m.utime, m.joint_position_measured[0]) for now, m in decoded])


def pixels(data: bytes) -> np.ndarray:
    image = lcmt_image_array.decode(data).images[0]
    raw = zlib.decompress(image.data) if image.compression_method else bytes(image.data)
    return np.frombuffer(raw, "<f4").reshape(image.height, image.width)


def test_before_and_after_a_fault_messages_pass_as_they_are():
    messages = come(Fault("status", "stop", seconds=0.048))
    assert [data for _, data in messages] == [status(k) for k in (*range(20), *range(30, 60))]


def test_a_fault_begins_as_late_as_it_is_told_to():
    assert len(come(Fault("status", "stop", after=0.1))) == 40


def test_a_fault_has_begun_once_it_has_spoilt_a_message():
    link, jump = Link(network.IIWA_STATUS), Fault("status", "jump", 0.1, after=0.05)
    for fault, ordered in (
        (Fault("status", "stop", after=0.2), 0.0),  # another takes its place before it can begin
        (jump, 0.1),
        (Fault("status", "stop", seconds=0.001), 0.201),  # no message comes meanwhile
    ):
        link.order(fault, ordered)
        for k in range(20):
            link.through(status(k), round(ordered, 1) + PERIOD * k)
    assert link.begun == [jump]


def test_late_messages_come_with_their_own_stamps():
    rows = angles(come(Fault("status", "delay", 0.03)))[20:]
    assert rows[:, 0] - rows[:, 1] == pytest.approx(0.03, abs=PERIOD + 1e-9)
    assert np.all(np.diff(rows[:, 1]) > 0)


def test_a_repeated_message_has_new_stamps_and_the_old_angle():
    rows = angles(come(Fault("status", "repeat")))[20:]
    assert rows[:, 1] == pytest.approx(rows[:, 0])
    assert np.ptp(rows[:, 2]) == 0.0 and rows[0, 2] == pytest.approx(AT - PERIOD)


def test_a_jump_moves_the_measured_angle_alone():
    rows = angles(come(Fault("status", "jump", 0.3)))
    assert rows[:20, 2] == pytest.approx(rows[:20, 1])
    assert rows[20:, 2] == pytest.approx(rows[20:, 1] + 0.3)


def test_messages_that_go_back_are_those_before():
    rows = angles(come(Fault("status", "back")))
    assert rows[20:, 1] == pytest.approx(rows[:20, 1][::-1])  # and then there are none


@pytest.mark.parametrize(
    ("kind", "expected"), [("zeros", 0.0), ("nans", np.nan), ("torn", 1.19), ("freeze", 1.19)]
)
def test_pictures_are_spoilt_in_their_band(kind, expected):
    band = (0.25, 0.5) if kind != "freeze" else (0.0, 1.0)
    _, data = come(Fault("pictures", kind, band=band), picture, 21)[-1]
    rows = pixels(data)
    spoilt = slice(3, 6) if kind != "freeze" else slice(None)
    np.testing.assert_allclose(rows[spoilt], expected, rtol=1e-6)
    if kind != "freeze":
        np.testing.assert_allclose(np.delete(rows, spoilt, axis=0), 1.2, rtol=1e-6)
    assert lcmt_image_array.decode(data).header.utime == 20_000


def test_a_spoilt_picture_is_still_one_that_can_be_unpacked():
    """Unless its numbers cannot be; those are dropped before anything looks at them."""
    rule = rules(good_messages.WIDTH, good_messages.HEIGHT)["CAMERA_DEPTH"]
    for kind in ("zeros", "torn", "freeze"):
        rule.read(come(Fault("pictures", kind), picture, 21)[-1][1])


def test_the_relay_passes_on_all_that_a_cell_says_and_hears():
    cell, driver = DrakeLcm("memq://"), DrakeLcm("memq://")
    relay = Relay(cell, driver, lambda: 0.0)
    come: list[str] = []
    ways = (cell, driver, (*network.ARM, *network.CAMERA, network.ABORT)), (
        driver, cell, (network.IIWA_COMMAND, network.GRIPPER_COMMAND)
    )  # fmt: skip
    for sends, hears, channels in ways:
        for channel in channels:
            hears.Subscribe(channel, lambda data, channel=channel: come.append(channel))
            sends.Publish(channel, b"anything")
        for side in (sends, hears):
            side.HandleSubscriptions(0)
        assert sorted(come) == sorted(channels)
        come.clear()
    relay.flush()


def test_the_relays_process_tells_which_faults_have_begun():
    beyond, driver = free_url(), free_url()
    stop, later = Fault("status", "stop", band=(0.0, 0.5)), Fault("pictures", "stop", after=1e4)
    relay, cell = RelayProcess(beyond, driver), network.open_lcm(beyond)
    try:
        assert relay.begun == []
        for fault in (stop, later):
            relay.order(fault)
        deadline = time.monotonic() + 10.0
        while not relay.begun and time.monotonic() < deadline:
            cell.Publish(network.IIWA_STATUS, status(0))
            cell.Publish(network.CAMERA_DEPTH, b"anything")
            time.sleep(0.01)
        assert relay.begun == [stop]
    finally:
        relay.close()


def test_unknown_faults_are_told_with_what_there_is():
    with pytest.raises(ValueError, match="status, pictures, arm, gripper"):
        Fault("camera", "stop")
    with pytest.raises(ValueError, match="stop, delay, repeat, jump, back"):
        Fault("status", "freeze")
    with pytest.raises(ValueError, match="band"):
        Fault("pictures", "zeros", band=(0.5, 0.2))
    with pytest.raises(ValueError, match="before it was sent"):
        Fault("status", "delay", -0.1)
    assert all(Fault(of, kind, 0.1).channel for of, kinds in KINDS.items() for kind in kinds)


def test_few_pictures_are_kept():
    """An hour has 18 000 of them, each of some hundred kilobytes."""
    link = Link(Fault("pictures", "torn").channel)
    first = picture(0)
    held_by = sys.getrefcount(first)
    link.through(first, 0.0)
    assert sys.getrefcount(first) > held_by
    for k in range(1, 4):
        link.through(picture(k), 0.1 * k)
    assert sys.getrefcount(first) == held_by
