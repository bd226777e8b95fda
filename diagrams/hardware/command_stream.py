"""Commands to the arm at an even rate, from a process of their own.

The diagram that makes them also looks at pictures and learns, and is late at times. It hands this process
joint angles and the time on its own clock at which they hold; they are sent a little later, evenly.
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

DELAY = 0.04
"""s by which commands are sent later than the diagram makes them; by less it may be late without effect."""

_BRAKING = 0.05  # s in which the arm comes to rest on its path when it is to stop, if need be
_SOONEST = 2 * ARM_PERIOD
_SOON = 4 * ARM_PERIOD  # s; in a push the finger brakes so long by the data sheet
_HARD = 4.5  # times the acceleration that the data sheet allows for motions, in an emergency
_PAUSE = 1.0  # s between two angles of one and the same maker, at most
_TOO_MUCH = 1.5  # delays; what is more than that is played faster
_CATCH_UP = 0.05  # of the pace
_SAMPLE = struct.Struct("<8d")


def braking_time(speed: FloatArray, longest: float) -> float:
    """Time for even braking, s, a whole number of commands.

    At the acceleration that the robot's data sheet allows for motions where the arm then rests within 20 ms;
    within 20 ms where that takes up to 4.5 times as much; else at 4.5 times as much, but within the longest
    time, whatever that asks of the joints.

    Args:
        speed: (7,) of the joints, rad/s.
        longest: s.
    """
    gentle = float((np.abs(speed) / ACCELERATION_LIMITS).max())
    needed = max(min(gentle, _SOON), gentle / _HARD)
    return min(max(ARM_PERIOD * np.ceil(needed / ARM_PERIOD - 1e-9), _SOONEST), longest)


class CommandBuffer:
    """Plays joint angles back in the order and at the pace at which they were made, a little later.

    Where none come, the pace falls evenly to nothing: the arm slows down on its path, and waits there. Where
    more wait than should, they are played 5 % faster, or skipped while the arm is at rest. After `stop` the
    pace falls to nothing for good: the arm brakes on what it got before, which lasts for the delay.

    Args:
        delay: s between making and playing.
    """

    def __init__(self, delay: float = DELAY) -> None:
        self._delay = delay
        self._samples: deque[tuple[float, FloatArray]] = deque()
        self._clock = 0.0  # of whoever makes the angles, as far as they are played
        self._now = 0.0
        self._pace = 0.0
        self._braking = 0.0  # of the pace, 1/s, once it is to stop

    def stop(self) -> None:
        """Come to rest from where the path is played now; what is added is not played any more."""
        if self._braking == 0.0:
            speed = np.zeros(7)
            if len(self._samples) > 1:
                (before, q), (after, further) = self._samples[0], self._samples[1]
                speed = self._pace * (further - q) / (after - before)
            self._braking = max(self._pace, 1e-3) / braking_time(speed, _BRAKING)

    def add(self, time: float, q: FloatArray) -> None:
        """Angles (7,), rad, that hold at a time of the maker's clock, s; not before those that were added.

        After a pause somebody else began where the arm rests: there is no way between to be played.
        """
        if self._samples and self._braking == 0.0 and time > self._samples[-1][0] + _PAUSE:
            self._samples.clear()
        if not self._samples:
            self._clock = time - self._delay
        self._samples.append((time, np.array(q, dtype=float)))

    def at(self, now: float) -> FloatArray | None:
        """Angles (7,) to be sent at a time, s of any even clock, or None before there are some."""
        if not self._samples:
            return None
        passed, self._now = max(now - self._now, 0.0) if self._now else 0.0, now
        newest, clock = self._samples[-1][0], self._clock
        left = newest - self._clock  # still to be played; the delay, just before more of it comes
        if self._braking > 0.0:
            slower = max(self._pace - self._braking * passed, 0.0)
            self._clock += min(0.5 * (self._pace + slower) * passed, left)
            self._pace = slower
        elif left > 2 * self._delay and self._rests():
            self._clock = newest - self._delay
        elif left > _TOO_MUCH * self._delay:
            self._clock += (1.0 + _CATCH_UP) * passed
        else:
            # The pace goes with what is left, from half the delay on.
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
        url: see `network.open_lcm`; not `memq://`, which another process does not hear.
    """

    def __init__(self, url: str) -> None:
        super().__init__("the process that sends commands to the arm", _send, url)

    def send(self, time: float, q: FloatArray) -> None:
        """Have joint angles (7,), rad, sent that hold at a time of the caller's clock, s."""
        self.write(_SAMPLE.pack(time, *q))

    def stop(self) -> None:
        """Let the arm brake at once on what it got before, and hold, for good."""
        self.write(_SAMPLE.pack(np.nan, *np.zeros(7)))


def _message(q: FloatArray, now: float) -> bytes:
    command = lcmt_iiwa_command()
    command.utime = round(1e6 * now)
    command.num_joints, command.joint_position = 7, [float(angle) for angle in q]
    return bytes(command.encode())


def _send(url: str) -> None:
    """Send what comes in on the standard input until it ends and the arm has come to rest."""
    lcm = open_lcm(url, listens=False)  # or it would also receive all pictures
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
