"""Messages as they come, and logs of them as LCM's own `lcm-logger` writes them.

A process of its own hears the messages, which misses none while this one is busy, and hands them on as a log.

An event is a header of 28 bytes, big-endian (sync word, number, µs since 1970 at which it was received,
lengths), then the channel's name and the message: https://lcm-proj.github.io/lcm/content/log-file-format.html.
Drake has a class for such files, but not in Python.
"""

import io
import os
import select
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import IO, Any, Protocol, cast

from slipmap.diagrams.hardware.child import Child, be_ready, have_priority
from slipmap.diagrams.hardware.network import HardwareError, open_lcm
from slipmap.models.files import BadInput

LARGEST = 40_000_000
"""Bytes of a message; pictures are at most 4096 by 4096 when packed."""

TICK = "slipmap.tick"
"""Channel of empty events that come every 0.5 s, so that whoever reads wakes when nothing is heard."""

_TICKS = 0.5  # s between two of them
_LOOK_EVERY = 3e-4  # s
_WAITING = 400_000_000  # bytes that may wait for a busy reader; more are left out, as their numbers show
_HEADER = struct.Struct(">IqqII")
_SYNC = 0xEDA1DA01
_LONGEST_NAME = 63  # of a channel, with LCM


class BadLog(BadInput, ValueError):
    """A log that cannot be read. The text names the file, the place, and what to do."""


@dataclass(frozen=True)
class Event:
    """A message as it was received."""

    number: int  # of the event, from 0
    utime: int  # µs since 1970 at which it was received
    channel: str
    data: bytes  # as received; it may be anything

    def encode(self) -> bytes:
        """The event as it stands in a log."""
        name = self.channel.encode()
        header = _HEADER.pack(_SYNC, self.number, self.utime, len(name), len(self.data))
        return b"".join((header, name, self.data))


class EventLog(Protocol):
    """Where events go as they came."""

    name: str  # of the file

    def write(self, event: Event) -> None:
        """Add an event; its number is that in the log."""


class LcmLog:
    """A log as LCM's logger writes it. Args: file: opened for writing bytes."""

    def __init__(self, file: IO[bytes]) -> None:
        self.name = file.name
        self._file, self._count = file, 0

    def write(self, event: Event) -> None:
        """Add an event."""
        self._file.write(replace(event, number=self._count).encode())
        self._count += 1


class LogReader:
    """The events of a log, one after the other.

    Attributes:
        cut_off: whether the log ends in the midst of an event, as that of a killed process does.

    Args:
        file: opened for reading bytes; its `read` returns less than asked for at its end alone.
        name: for messages.
    """

    def __init__(self, file: IO[bytes] | Any, name: str) -> None:
        self._file, self._name = file, name
        self.cut_off = False

    def __iter__(self) -> Iterator[Event]:
        """Events until the log ends.

        Raises:
            BadLog: it is no log, or damaged.
        """
        count, place = 0, 0
        while header := self._file.read(_HEADER.size):
            if len(header) < _HEADER.size:
                if count == 0 and not _SYNC.to_bytes(4, "big").startswith(header[:4]):
                    raise self._foreign()
                self.cut_off = True
                return
            sync, number, utime, name_length, length = _HEADER.unpack(header)
            if sync != _SYNC:
                raise self._foreign() if count == 0 else self._damaged(count, place, "no event begins there")
            if not 0 < name_length <= _LONGEST_NAME or length > LARGEST or number < 0 or utime < 0:
                raise self._damaged(count, place, "the event's header has numbers that cannot be")
            body = self._file.read(name_length + length)
            if len(body) < name_length + length:
                self.cut_off = True
                return
            try:
                channel = body[:name_length].decode()
            except UnicodeDecodeError as error:
                raise self._damaged(count, place, "the channel's name is no text") from error
            yield Event(number, utime, channel, body[name_length:])
            count += 1
            place += _HEADER.size + len(body)

    def _foreign(self) -> BadLog:
        return BadLog(
            f"{self._name}: is no LCM log; give one that `slipmap record --log` or LCM's `lcm-logger` wrote"
        )

    def _damaged(self, count: int, place: int, why: str) -> BadLog:
        return BadLog(
            f"{self._name}: is damaged after {count} messages, at byte {place}: {why}; copy the file anew, or"
            f" keep what is whole with `head -c {place}`"
        )


class MessageStream(Child):
    """The process that hears messages; `close` ends it.

    Args:
        url: see `network.open_lcm`; not `memq://`, which another process does not hear.

    Raises:
        HardwareError: see `network.open_lcm`, or it could not be started.
    """

    def __init__(self, url: str, heard: Sequence[str]) -> None:
        open_lcm(url)  # raises here whatever is wrong with address or network
        super().__init__("the process that hears messages", _hear, url, *heard)

    def __iter__(self) -> Iterator[Event]:
        """Events without end, those of `TICK` among them.

        Raises:
            HardwareError: the process has ended.
        """
        pipe = io.BufferedReader(cast(io.RawIOBase, self.output), 1 << 20)
        yield from LogReader(pipe, "the process that hears messages")
        raise HardwareError("the process that hears messages has ended; start anew")


class _Waiting:
    """Events between the network and the pipe."""

    def __init__(self) -> None:
        self._events: deque[bytes] = deque()
        self._size = self._count = 0
        self._changed = threading.Condition()

    def add(self, channel: str, data: bytes) -> None:
        now = time.time_ns() // 1000
        with self._changed:
            if self._size + len(data) <= _WAITING:
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


def _hear(url: str, *heard: str) -> None:
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
        if time.monotonic() - ticked > _TICKS:
            ticked = time.monotonic()
            waiting.add(TICK, b"")
