"""Sends commands to the arm at an even rate, from a separate process.

The diagram that makes them also processes pictures and learns, and is late at times. It passes joint angles
to this process with the time on its own clock at which they apply; they are sent slightly later, evenly
spaced.
"""

import gc
import os
import select
import struct
import sys
import time
from collections import deque

import numpy as np
from drake import lcmt_iiwa_command

from slipmap.diagrams.hardware.child import Child, be_ready, have_priority
from slipmap.diagrams.hardware.network import ARM_PERIOD, IIWA_COMMAND, open_lcm
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import ACCELERATION_LIMITS

DELAY = 0.04  # time between making and sending a command, s; the diagram may be late by less without effect
_BRAKING = 0.05  # s; longest time in which the arm comes to rest on its path when it must stop
_SOONEST = 2 * ARM_PERIOD
_SOON = 4 * ARM_PERIOD  # s; braking from a push takes this long within the data sheet's limits
_HARD = 4.5  # emergency acceleration as a multiple of the data sheet's limit for motions
_PAUSE = 1.0  # s; longest time between two angles from the same source
_TOO_MUCH = 1.5  # delays; a longer queue is played faster
_CATCH_UP = 0.05  # share by which it is then faster
_SAMPLE = struct.Struct("<8d")


def braking_time(speed: FloatArray, longest: float) -> float:
    """Time for braking at constant deceleration, s, a whole number of commands.

    The deceleration is the limit of the robot's data sheet for motions if the arm then comes to rest within
    20 ms. Otherwise it comes to rest in 20 ms with up to 4.5 times that limit, or else at 4.5 times the
    limit, but always within the longest time, whatever that demands of the joints.

    Args:
        speed: (7,) of the joints, rad/s.
        longest: s.
    """
    gentle = float((np.abs(speed) / ACCELERATION_LIMITS).max())
    needed = max(min(gentle, _SOON), gentle / _HARD)
    return min(max(ARM_PERIOD * np.ceil(needed / ARM_PERIOD - 1e-9), _SOONEST), longest)


class CommandBuffer:
    """Plays joint angles back in the order and at the pace at which they were made, after a delay.

    If no new ones come, the pace falls smoothly to zero: the arm slows down on its path and waits there. If
    too many are queued, they are played 5 % faster, or skipped while the arm is at rest. After `stop` the
    pace falls to zero for good: the arm brakes along the angles that it already has, which last for the
    delay.

    Args:
        delay: s between making and playing.
    """

    def __init__(self, delay: float = DELAY) -> None:
        self._delay = delay
        self._samples: deque[tuple[float, FloatArray]] = deque()
        self._clock = 0.0  # the source's clock at the angles played now
        self._now = 0.0
        self._pace = 0.0
        self._braking = 0.0  # rate at which the pace falls after `stop`, 1/s

    def stop(self) -> None:
        """Come to rest from the present point of the path; angles added later are not played."""
        if self._braking == 0.0:
            speed = np.zeros(7)
            if len(self._samples) > 1:
                (before, q), (after, further) = self._samples[0], self._samples[1]
                speed = self._pace * (further - q) / (after - before)
            self._braking = max(self._pace, 1e-3) / braking_time(speed, _BRAKING)

    def add(self, time: float, q: FloatArray) -> None:
        """Add angles (7,), rad, that apply at a time of the source's clock, s; times must not decrease.

        After a long pause a new source has started from where the arm rests, so there is no path to
        interpolate.
        """
        if self._samples and self._braking == 0.0 and time > self._samples[-1][0] + _PAUSE:
            self._samples.clear()
        if not self._samples:
            self._clock = time - self._delay
        self._samples.append((time, np.array(q, dtype=float)))

    def at(self, now: float) -> FloatArray | None:
        """Angles (7,) to send at a time, s of any uniform clock, or None before there are any."""
        if not self._samples:
            return None
        passed, self._now = max(now - self._now, 0.0) if self._now else 0.0, now
        newest, clock = self._samples[-1][0], self._clock
        left = newest - self._clock  # still to be played; equals the delay just before more comes
        if self._braking > 0.0:
            slower = max(self._pace - self._braking * passed, 0.0)
            self._clock += min(0.5 * (self._pace + slower) * passed, left)
            self._pace = slower
        elif left > 2 * self._delay and self._rests():
            self._clock = newest - self._delay
        elif left > _TOO_MUCH * self._delay:
            self._clock += (1.0 + _CATCH_UP) * passed
        else:
            # Below half the delay, the pace is proportional to what is left.
            self._clock += min(passed * min(1.0, 2.0 * left / self._delay), left)
        if self._braking == 0.0 and passed > 0.0:
            self._pace = (self._clock - clock) / passed
        while len(self._samples) > 1 and self._samples[1][0] <= self._clock:
            self._samples.popleft()
        return self._between()

    def _rests(self) -> bool:
        first = self._samples[0][1]
        return all(np.abs(q - first).max() < 1e-9 for _, q in self._samples)

    def _between(self) -> FloatArray:
        (before, q), *following = self._samples[0], *list(self._samples)[1:2]
        if not following or self._clock <= before:
            return q
        after, further = following[0]
        share = (self._clock - before) / (after - before)
        return (1.0 - share) * q + share * further


class CommandStream(Child):
    """The process that sends commands; `close` lets the arm come to rest and ends it.

    Args:
        url: see `network.open_lcm`; not `memq://`, which does not reach another process.
    """

    def __init__(self, url: str) -> None:
        super().__init__("the process that sends commands to the arm", _send, url)

    def send(self, time: float, q: FloatArray) -> None:
        """Send joint angles (7,), rad, that apply at a time of the caller's clock, s."""
        self.write(_SAMPLE.pack(time, *q))

    def stop(self) -> None:
        """Let the arm brake at once along the angles that it already has, and hold for good."""
        self.write(_SAMPLE.pack(np.nan, *np.zeros(7)))


def _message(q: FloatArray, now: float) -> bytes:
    command = lcmt_iiwa_command()
    command.utime = round(1e6 * now)
    command.num_joints, command.joint_position = 7, [float(angle) for angle in q]
    return bytes(command.encode())


def _send(url: str) -> None:
    """Send the angles read from standard input until it ends and the arm has come to rest."""
    lcm = open_lcm(url, listens=False)  # otherwise it would also receive all pictures
    buffer = CommandBuffer()
    source, received, ends = sys.stdin.fileno(), b"", np.inf
    have_priority()
    gc.freeze()
    gc.disable()
    be_ready()
    tick = time.monotonic()
    while tick < ends:
        while (left := tick - time.monotonic()) > 0:
            if ends < np.inf:
                time.sleep(left)
            elif select.select([source], [], [], left)[0]:
                data = os.read(source, 1 << 16)
                received += data
                if not data:
                    ends = time.monotonic() + 5 * DELAY
        whole = len(received) // _SAMPLE.size * _SAMPLE.size
        for moment, *q in _SAMPLE.iter_unpack(received[:whole]):
            if np.isnan(moment):
                buffer.stop()
            else:
                buffer.add(moment, np.array(q))
        received = received[whole:]
        now = time.monotonic()
        command = buffer.at(now)
        if command is not None:
            lcm.Publish(IIWA_COMMAND, _message(command, now))
        tick = max(tick + ARM_PERIOD, now)
