"""Logs of raw messages, in the format of LCM's own `lcm-logger`.

An event is a header of 28 bytes, big-endian (sync word, number, µs since 1970 at which it was received,
lengths), then the channel's name and the message: https://lcm-proj.github.io/lcm/content/log-file-format.html.
Drake has a class for such files, but not in Python.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO, Any

LARGEST = 40_000_000
"""Bytes of a message; pictures are at most 4096 by 4096 when packed."""

_HEADER = struct.Struct(">IqqII")
_SYNC = 0xEDA1DA01
_LONGEST_NAME = 63  # of a channel, with LCM


class BadLog(ValueError):
    """A log that cannot be read. The text names the file, the place, and what to do."""


@dataclass(frozen=True)
class Event:
    """A message as it was received.

    Attributes:
        number: of the event, from 0.
        utime: µs since 1970 at which it was received.
        channel: its name.
        data: as received; it may be anything.
    """

    number: int
    utime: int
    channel: str
    data: bytes

    def encode(self) -> bytes:
        """The event as it stands in a log."""
        name = self.channel.encode()
        header = _HEADER.pack(_SYNC, self.number, self.utime, len(name), len(self.data))
        return b"".join((header, name, self.data))


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
