"""The stream of incoming messages, and logs of them in the format of LCM's own `lcm-logger`.

A separate process receives the messages, so that none is missed while this one is busy, and passes them on as
a log.

An event is a header of 28 bytes, big-endian (sync word, number, time of reception in µs since 1970, lengths),
followed by the channel's name and the message: https://lcm-proj.github.io/lcm/content/log-file-format.html.
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
from typing import IO, Any, cast

from slipmap.diagrams.hardware.child import Child, be_ready, have_priority
from slipmap.diagrams.hardware.network import HardwareError, open_lcm
from slipmap.models.files import BadInput

LARGEST = 40_000_000  # largest message, bytes; compressed pictures have at most 4096 by 4096 pixels
TICK = "slipmap.tick"  # channel of empty events every 0.5 s, which wake the reader when no messages come
_TICKS = 0.5  # s between two of them
_LOOK_EVERY = 3e-4  # s
_WAITING = 400_000_000  # bytes that may wait for a busy reader; more are dropped, as the event numbers show
_HEADER = struct.Struct(">IqqII")
_SYNC = 0xEDA1DA01
_LONGEST_NAME = 63  # of a channel in LCM


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
        """The event in the format of a log."""
        name = self.channel.encode()
        header = _HEADER.pack(_SYNC, self.number, self.utime, len(name), len(self.data))
        return b"".join((header, name, self.data))


class LcmLog:
    """A log in the format of LCM's logger. Args: file: opened for writing bytes."""

    def __init__(self, file: IO[bytes]) -> None:
        self.name = file.name
        self._file, self.count = file, 0

    def write(self, event: Event) -> None:
        """Add an event, numbered by its place in the log."""
        self._file.write(replace(event, number=self.count).encode())
        self.count += 1


class LogReader:
    """The events of a log in order.

    Attributes:
        cut_off: whether the log ends within an event, like that of a killed process.

    Args:
        file: opened for reading bytes; its `read` returns less than requested only at the end.
        name: for messages.
    """

    def __init__(self, file: IO[bytes] | Any, name: str) -> None:
        self._file, self._name = file, name
        self.cut_off = False

    def __iter__(self) -> Iterator[Event]:
        """Events until the log ends.

        Raises:
            BadLog: it is not a log, or damaged.
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
                raise self._foreign() if count == 0 else self._damaged(count, place, "no event starts there")
            if not 0 < name_length <= _LONGEST_NAME or length > LARGEST or number < 0 or utime < 0:
                raise self._damaged(count, place, "the event's header has impossible numbers")
            body = self._file.read(name_length + length)
            if len(body) < name_length + length:
                self.cut_off = True
                return
            try:
                channel = body[:name_length].decode()
            except UnicodeDecodeError as error:
                raise self._damaged(count, place, "the channel's name is not text") from error
            yield Event(number, utime, channel, body[name_length:])
            count += 1
            place += _HEADER.size + len(body)

    def _foreign(self) -> BadLog:
        return BadLog(
            f"{self._name}: is not an LCM log; give one written by `slipmap record --log` or by `lcm-logger`"
        )

    def _damaged(self, count: int, place: int, why: str) -> BadLog:
        return BadLog(
            f"{self._name}: is damaged after {count} messages, at byte {place}: {why}; copy the file again,"
            f" or keep the intact part with `head -c {place}`"
        )


class MessageStream(Child):
    """The process that receives messages; `close` ends it.

    Args:
        url: see `network.open_lcm`; not `memq://`, which does not reach another process.
        heard: channels.

    Raises:
        HardwareError: see `network.open_lcm`, or the process could not be started.
    """

    def __init__(self, url: str, heard: Sequence[str]) -> None:
        open_lcm(url)  # raises here whatever is wrong with address or network
        super().__init__("the process that receives messages", _hear, url, *heard)

    def __iter__(self) -> Iterator[Event]:
        """Endless events, including those of `TICK`.

        Raises:
            HardwareError: the process has ended.
        """
        pipe = io.BufferedReader(cast(io.RawIOBase, self.output), 1 << 20)
        yield from LogReader(pipe, "the process that receives messages")
        raise HardwareError("the process that receives messages has ended; start again")


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
        with suppress(OSError):  # the reader has gone
            while True:
                left = memoryview(waiting.next())
                while left:
                    left = left[os.write(sys.stdout.fileno(), left) :]

    be_ready()
    threading.Thread(target=write, daemon=True).start()
    have_priority()  # LCM keeps only one message per channel until it is read
    ticked = time.monotonic()
    while not select.select([sys.stdin], [], [], 0.0)[0]:
        if not lcm.HandleSubscriptions(0):  # waiting inside it would block the other thread
            time.sleep(_LOOK_EVERY)
        if time.monotonic() - ticked > _TICKS:
            ticked = time.monotonic()
            waiting.add(TICK, b"")
