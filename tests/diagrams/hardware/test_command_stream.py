"""Commands that are made unevenly are sent evenly."""

from __future__ import annotations

import time

import numpy as np
import pytest
from drake import lcmt_iiwa_command

from slipmap.diagrams.hardware.command_stream import DELAY, CommandBuffer, CommandStream
from slipmap.diagrams.hardware.network import ARM_PERIOD, IIWA_COMMAND, HardwareError, open_lcm


def path(time: float) -> np.ndarray:
    """(7,) a joint motion that never rests."""
    return np.sin(time + np.arange(7.0))


def played(
    made: list[tuple[float, float]], until: float, still: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """When, and what; of angles made at (wall, diagram) times."""
    buffer, waiting, times, commands = CommandBuffer(), list(made), [], []
    for now in np.arange(1.0, until, ARM_PERIOD):
        while waiting and waiting[0][0] <= now:
            moment = waiting.pop(0)[1]
            buffer.add(moment, path(0.0 if still else moment))
        command = buffer.at(now)
        if command is not None:
            times.append(now)
            commands.append(command)
    return np.array(times), np.array(commands)


def even(begin: float, end: float, wall: float) -> list[tuple[float, float]]:
    return [(wall + t - begin, t) for t in np.arange(begin, end, ARM_PERIOD)]


def test_even_commands_come_later_and_are_else_the_same():
    times, commands = played(even(5.0, 7.0, wall=1.0), until=2.9)
    expected = np.array([path(max(5.0 + t - 1.0 - DELAY, 5.0)) for t in times])
    np.testing.assert_allclose(commands, expected, atol=2e-5)  # a line between two angles


def test_a_short_wait_of_the_maker_is_not_felt():
    late = 0.4 * DELAY  # half the delay is left; then the rest of it comes at once
    made = even(5.0, 6.0, wall=1.0) + [(max(w, 2.0 + late), t) for w, t in even(6.0, 7.0, wall=2.0)]
    _, commands = played(made, until=2.9)
    np.testing.assert_allclose(commands, played(even(5.0, 7.0, wall=1.0), until=2.9)[1], atol=1e-4)


def test_after_a_long_wait_the_arm_has_slowed_down_on_its_path_and_goes_on_without_a_leap():
    wait = 0.7
    made = even(5.0, 6.0, wall=1.0) + even(6.0, 9.0, wall=2.0 + wait)
    times, commands = played(made, until=5.0)
    on_path = 5.0 + np.unwrap(np.arctan2(commands[:, 0], np.cos(0.0) * path_cosine(commands)))
    pace = np.diff(on_path) / ARM_PERIOD
    np.testing.assert_allclose(commands, np.sin(on_path[:, None] - 5.0 + np.arange(7.0)), atol=1e-4)
    assert pace.min() > -1e-6
    assert pace.max() < 1.06
    resting = (times > 2.2) & (times < 2.0 + wait)
    assert pace[resting[1:]].max() < 0.01
    slowing = np.diff(pace)[(times[2:] > 1.9) & (times[2:] < 2.0 + wait)]
    assert slowing.min() > -0.35  # not from full speed to nothing at once


def test_an_arm_that_is_to_stop_brakes_at_once_on_its_path():
    """The next 40 ms of it are known, and no more is played than half the time of braking."""
    buffer, pace, times = CommandBuffer(), [], np.arange(1.0, 1.4, ARM_PERIOD)
    for now in times:
        if now < 1.2:
            buffer.add(4.0 + now, path(4.0 + now))
        if abs(now - 1.2) < 1e-9:
            buffer.stop()
            buffer.add(9.0, path(9.0))  # what comes later is not played
        q = buffer.at(now)
        pace.append(np.arctan2(q[0], path_cosine(q[None])[0]) + 2 * np.pi)
    speed = np.diff(pace) / ARM_PERIOD
    stopping = times[1:] > 1.2 - 1e-9
    assert speed[~stopping][-5:] == pytest.approx(1.0, abs=1e-3)
    braking = 0.03  # at 1 rad/s and up to 4.5 times 8.6 rad/s², a whole number of commands
    expected = np.maximum(1.0 - (times[1:][stopping] - 1.2 + 0.5 * ARM_PERIOD) / braking, 0.0)
    assert speed[stopping] == pytest.approx(expected, abs=0.06)
    assert speed[times[1:] > 1.2 + braking] == pytest.approx(0.0, abs=1e-9)


def path_cosine(commands: np.ndarray) -> np.ndarray:
    """Of the angle whose sine is the first column, from the second: sin(a+1) = sin a cos 1 + cos a sin 1."""
    return (commands[:, 1] - commands[:, 0] * np.cos(1.0)) / np.sin(1.0)


def test_what_waits_is_skipped_while_the_arm_is_at_rest():
    buffer = CommandBuffer()
    for moment in np.arange(5.0, 9.0, ARM_PERIOD):  # four seconds at once
        buffer.add(moment, path(9.0))
    buffer.at(1.0)
    for wall, moment in even(9.0, 9.5, wall=1.0):
        buffer.add(moment, path(moment))
        command = buffer.at(wall)
    lag = 9.0 + wall - 1.0 - np.linspace(0.0, 3 * DELAY, 1000)
    best = np.abs(np.sin(lag[:, None] + np.arange(7.0)) - command).max(axis=1).argmin()
    assert 0.5 * DELAY < np.linspace(0.0, 3 * DELAY, 1000)[best] < 1.6 * DELAY


def test_the_process_sends_what_it_is_told_and_ends_with_its_input():
    url = "udpm://239.255.76.67:7731?ttl=0"
    lcm, heard = open_lcm(url), []
    lcm.Subscribe(IIWA_COMMAND, lambda data: heard.append(lcmt_iiwa_command.decode(data)))
    lcm.HandleSubscriptions(0)
    stream = CommandStream(url)
    start = time.monotonic()
    while (now := time.monotonic() - start) < 0.3:
        stream.send(now, path(now))
        lcm.HandleSubscriptions(2)
    stream.close()
    lcm.HandleSubscriptions(10)
    assert len(heard) > 30
    assert [(m.num_joints, m.num_torques) for m in heard] == [(7, 0)] * len(heard)
    assert (np.diff([m.utime for m in heard]) > 0).all()
    np.testing.assert_allclose(heard[0].joint_position, path(0.0), atol=0.05)
    with pytest.raises(HardwareError, match="ended"):
        for _ in range(3):
            stream.send(1.0, path(1.0))


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("udpm://239.255.76.67", "must look like"),
        ("tcpq://localhost:7000", "must look like"),
        ("udpm://239.255.76.67:7667?ttl=x", "whole numbers"),
        ("udpm://239.255.76.67:7667?transmit_only=true", "the only options"),
        ("udpm://10.0.0.1:7667", "multicast"),
    ],
)
def test_addresses_that_are_none_are_refused(url, why):
    with pytest.raises(HardwareError, match=why):
        open_lcm(url)


def test_messages_stay_here_unless_a_ttl_is_written():
    assert "ttl=0" in open_lcm("udpm://239.255.76.67:7732").get_lcm_url()
    assert "ttl=1" in open_lcm("udpm://239.255.76.67:7732?ttl=1").get_lcm_url()


def test_who_goes_on_after_a_pause_is_not_kept_waiting():
    """The arm rests a hair off where it was told to be, and whoever comes next begins there."""
    buffer = CommandBuffer()
    for now in np.arange(0.0, 0.5, ARM_PERIOD):
        buffer.add(now, np.zeros(7))
        buffer.at(1.0 + now)
    for now in np.arange(0.5, 40.0, ARM_PERIOD):
        buffer.at(1.0 + now)
    for now in np.arange(40.0, 40.5, ARM_PERIOD):
        wanted = np.full(7, 1e-4 + 0.2 * (now - 40.0))
        buffer.add(now, wanted)
        played = buffer.at(1.0 + now)
    assert np.abs(played - wanted).max() < 0.2 * 2 * DELAY
