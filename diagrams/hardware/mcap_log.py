"""Logs of messages in MCAP format, which viewers such as Foxglove open.

Every message is stored as received, under its channel's name with the encoding `lcm`; `slipmap replay` reads
these. Messages of arm, gripper and camera are also stored as JSON, under names that start with a slash, with
schemas that viewers know.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import IO, Any

import drake

from slipmap.diagrams.hardware import network
from slipmap.diagrams.hardware.checked_messages import BadMessage, unpacked
from slipmap.diagrams.hardware.message_stream import LARGEST, BadLog, Event
from slipmap.models.files import BadInput

_RAW = "lcm"
_STAMP = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_NUMBERS = {"type": "array", "items": {"type": "number"}}
_PLACE = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_TURN = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyzw"}}
_SCHEMAS: Mapping[str, tuple[str, dict[str, Any]]] = {
    "/arm": ("slipmap.Arm", {"position": _NUMBERS, "commanded": _NUMBERS, "external_torque": _NUMBERS}),
    "/gripper": ("slipmap.Gripper", {"width": {"type": "number"}, "force": {"type": "number"}}),
    "/camera": (
        "foxglove.FrameTransform",
        {"parent_frame_id": {"type": "string"}, "child_frame_id": {"type": "string"}, "translation": _PLACE,
         "rotation": _TURN},
    ),
    "/depth": (
        "foxglove.RawImage",
        {"frame_id": {"type": "string"}, "width": {"type": "integer"}, "height": {"type": "integer"},
         "encoding": {"type": "string"}, "step": {"type": "integer"},
         "data": {"type": "string", "contentEncoding": "base64"}},
    ),
}  # fmt: skip
"""Channels for viewers: name, name of the schema, and its fields in addition to `timestamp`."""


class McapLog:
    """A log for writing; it must be ended by `close`, or viewers have to repair it.

    Args:
        file: opened for writing bytes.

    Raises:
        BadInput: the library mcap is not installed.
    """

    def __init__(self, file: IO[bytes]) -> None:
        try:
            from mcap.writer import Writer
        except ImportError:
            raise _missing(file.name) from None
        self.name = file.name
        self._writer = Writer(file)
        self._writer.start("slipmap")
        self._channels: dict[str, int] = {}
        self._count = 0

    def write(self, event: Event) -> None:
        """Add an event as received, and its JSON for viewers."""
        self._add(event.channel, _RAW, 0, event, event.data)
        self._count += 1
        with suppress(BadMessage, ValueError, IndexError):  # whatever came is kept above
            for name, content in _seen(event):
                kind, fields = _SCHEMAS[name]
                if name not in self._channels:
                    described = {"type": "object", "properties": {"timestamp": _STAMP, **fields}}
                    schema = self._writer.register_schema(kind, "jsonschema", json.dumps(described).encode())
                else:
                    schema = 0
                self._add(name, "json", schema, event, json.dumps(content).encode())

    def _add(self, name: str, encoding: str, schema: int, event: Event, data: bytes) -> None:
        if name not in self._channels:
            self._channels[name] = self._writer.register_channel(name, encoding, schema)
        time = 1000 * event.utime
        self._writer.add_message(self._channels[name], time, data, time, self._count)

    def close(self) -> None:
        """Write the end of the log."""
        self._writer.finish()


def _seen(event: Event) -> Iterator[tuple[str, dict[str, Any]]]:
    """Names and JSON contents that viewers see of a message."""
    if event.channel == network.IIWA_STATUS:
        arm = drake.lcmt_iiwa_status.decode(event.data)
        yield (
            "/arm",
            {
                "timestamp": _stamp(arm.utime),
                "position": list(arm.joint_position_measured),
                "commanded": list(arm.joint_position_commanded),
                "external_torque": list(arm.joint_torque_external),
            },
        )
    elif event.channel == network.GRIPPER_STATUS:
        gripper = drake.lcmt_schunk_wsg_status.decode(event.data)
        yield (
            "/gripper",
            {
                "timestamp": _stamp(gripper.utime),
                "width": 1e-3 * gripper.actual_position_mm,
                "force": gripper.actual_force,
            },
        )
    elif event.channel == network.CAMERA_POSE:
        pose = drake.lcmt_drake_signal.decode(event.data)
        x, y, z, qw, qx, qy, qz = pose.val
        yield (
            "/camera",
            {
                "timestamp": _stamp(pose.timestamp),
                "parent_frame_id": "world",
                "child_frame_id": "camera",
                "translation": {"x": x, "y": y, "z": z},
                "rotation": {"x": qx, "y": qy, "z": qz, "w": qw},
            },
        )
    elif event.channel == network.CAMERA_DEPTH:
        message = drake.lcmt_image_array.decode(event.data)
        (image,) = message.images
        pixels = unpacked(image, min(image.row_stride * image.height, LARGEST))
        yield (
            "/depth",
            {
                "timestamp": _stamp(message.header.utime),
                "frame_id": "camera",
                "width": image.width,
                "height": image.height,
                "encoding": "32FC1",
                "step": image.row_stride,
                "data": base64.b64encode(pixels).decode(),
            },
        )


def _stamp(utime: int) -> dict[str, int]:
    return {"sec": utime // 1_000_000, "nsec": 1000 * (utime % 1_000_000)}


class McapReader:
    """The events of a log in order, like those of `LogReader`.

    Attributes:
        cut_off: whether the log ends within a record, like that of a killed process.
    """

    def __init__(self, file: IO[bytes], name: str) -> None:
        self._file, self._name = file, name
        self.cut_off = False

    def __iter__(self) -> Iterator[Event]:
        """Events until the log ends.

        Raises:
            BadLog: it is not a log, damaged, or has no LCM messages.
            BadInput: the library mcap is not installed.
        """
        try:
            from mcap.exceptions import EndOfFile, McapError
            from mcap.reader import NonSeekingReader
        except ImportError:
            raise _missing(self._name) from None
        count = 0
        messages = NonSeekingReader(self._file).iter_messages(log_time_order=False)
        while True:
            try:
                _, channel, message = next(messages)
            except StopIteration:
                break
            except EndOfFile:
                self.cut_off = True
                break
            except (McapError, ValueError, OverflowError, MemoryError, EOFError, LookupError) as error:
                raise BadLog(f"{self._name}: is not an MCAP log, or is damaged ({error})") from error
            except Exception as error:  # of the libraries that unpack chunks
                raise BadLog(f"{self._name}: is damaged ({error}); copy the file again") from error
            if channel.message_encoding == _RAW:
                yield Event(count, message.log_time // 1000, channel.topic, message.data)
                count += 1
        if count == 0 and not self.cut_off:
            raise BadLog(f"{self._name}: has no LCM messages; give a log of `slipmap record --log`")


def _missing(name: str) -> BadInput:
    return BadInput(f"{name}: MCAP needs the library mcap; install it with `pip install 'slipmap[import]'`")
