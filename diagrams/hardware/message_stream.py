"""Messages as they come, heard by a process of its own, which misses none while this one is busy.

It is started as `python -m diagrams.hardware.message_stream URL CHANNEL …`, writes events as a log has them
to its standard output, and sends nothing.
"""

from __future__ import annotations

import io
import os
import select
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial
from typing import cast

from diagrams.hardware.channels import HardwareError
from diagrams.hardware.child import Child, be_ready, have_priority
from diagrams.hardware.message_log import Event, LogReader
from diagrams.hardware.network import open_lcm

TICK = "slipmap.tick"
"""Channel of empty events that come every `TICKS` s, so that whoever reads wakes when nothing is heard."""

TICKS = 0.5
"""s between two of them."""

_LOOK_EVERY = 3e-4  # s

WAITING = 400_000_000
"""Bytes of messages that may wait for a busy reader; more are left out, which shows in their numbers."""


class MessageStream:
    """The process that hears messages; `close` ends it.

    Args:
        url: see `network.open_lcm`; not `memq://`, which another process does not hear.
        heard: channels.

    Raises:
        HardwareError: see `network.open_lcm`, or it could not be started.
    """

    def __init__(self, url: str, heard: Sequence[str]) -> None:
        open_lcm(url)  # whatever is wrong with address or network is told here
        self._child = Child("the process that hears messages", __name__, url, *heard)
        self._child.wait_until_ready()

    def __iter__(self) -> Iterator[Event]:
        """Events without end, those of `TICK` among them.

        Raises:
            HardwareError: the process has ended.
        """
        pipe = io.BufferedReader(cast(io.RawIOBase, self._child.output), 1 << 20)
        yield from LogReader(pipe, "the process that hears messages")
        raise HardwareError("the process that hears messages has ended; start anew")

    def close(self) -> None:
        """End the process."""
        self._child.close()


class _Waiting:
    """Events between the network and the pipe."""

    def __init__(self) -> None:
        self._events: deque[bytes] = deque()
        self._size = self._count = 0
        self._changed = threading.Condition()

    def add(self, channel: str, data: bytes) -> None:
        now = time.time_ns() // 1000
        with self._changed:
            if self._size + len(data) <= WAITING:
                event = Event(self._count, now, channel, data).encode()
                self._events.append(event)
                self._size += len(event)
                self._changed.notify()
            self._count += channel != TICK

    def next(self) -> bytes:
        with self._changed:
            while not self._events:
                self._changed.wait()
            event = self._events.popleft()
            self._size -= len(event)
        return event


def main(url: str, *heard: str) -> None:
    """Write what is heard to the standard output until the input ends."""
    waiting = _Waiting()
    lcm = open_lcm(url)
    for name in heard:
        lcm.Subscribe(name, partial(waiting.add, name))

    def write() -> None:
        with suppress(OSError):  # nobody reads any more
            while True:
                left = memoryview(waiting.next())
                while left:
                    left = left[os.write(sys.stdout.fileno(), left) :]

    be_ready()
    threading.Thread(target=write, daemon=True).start()
    have_priority()  # LCM keeps one message of a channel until it is asked for
    ticked = time.monotonic()
    while not select.select([sys.stdin], [], [], 0.0)[0]:
        if not lcm.HandleSubscriptions(0):  # waiting inside of it would keep the other thread waiting
            time.sleep(_LOOK_EVERY)
        if time.monotonic() - ticked > TICKS:
            ticked = time.monotonic()
            waiting.add(TICK, b"")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except HardwareError as failure:
        sys.exit(f"slipmap: {failure}")
