"""Logs of messages in MCAP format, which viewers such as Foxglove open.

Every message is stored as received, under its channel's name with the encoding `lcm`; `slipmap replay` reads
these. Messages of arm, gripper and camera are also stored as JSON, under names that start with a slash, with
schemas that viewers know.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator, Mapping
from typing import IO, Any, NamedTuple

import drake

from slipmap.diagrams.hardware import network
from slipmap.diagrams.hardware.checked_messages import unpacked
from slipmap.diagrams.hardware.message_stream import LARGEST, BadLog, Event
from slipmap.models.files import BadInput

_RAW = "lcm"
_STAMP = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_NUMBERS = {"type": "array", "items": {"type": "number"}}
_PLACE = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_TURN = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyzw"}}
_TEXT = {"type": "string"}


class _View(NamedTuple):
    """What viewers see of the messages of a channel."""

    name: str
    schema: str
    decode: Callable[[bytes], Any]
    fields: Mapping[
        str, tuple[dict[str, Any], Callable[[Any], Any]]
    ]  # JSON schema, and value in what is decoded

    def content(self, data: bytes) -> bytes | None:
        """JSON of a message; None for one that is damaged or has numbers that JSON lacks, such as NaN."""
        try:
            decoded = self.decode(data)
            content = {name: value(decoded) for name, (_, value) in self.fields.items()}
            return json.dumps(content, allow_nan=False).encode()
        except Exception:  # generated code fails on hostile bytes in many ways
            return None


def _stamp(utime: int) -> dict[str, int]:
    return {"sec": utime // 1_000_000, "nsec": 1000 * (utime % 1_000_000)}


def _pose(data: bytes) -> Any:
    """A signal of time and place, quaternion with the real part first."""
    pose = drake.lcmt_drake_signal.decode(data)
    x, y, z, qw, qx, qy, qz = pose.val
    return pose.timestamp, {"x": x, "y": y, "z": z}, {"x": qx, "y": qy, "z": qz, "w": qw}


def _depth(data: bytes) -> Any:
    """Time, image and its unpacked pixels."""
    message = drake.lcmt_image_array.decode(data)
    (image,) = message.images
    pixels = unpacked(image, min(image.row_stride * image.height, LARGEST))
    return message.header.utime, image, base64.b64encode(pixels).decode()


_VIEWS = {
    network.IIWA_STATUS: _View("/arm", "slipmap.Arm", drake.lcmt_iiwa_status.decode, {
        "timestamp": (_STAMP, lambda arm: _stamp(arm.utime)),
        "position": (_NUMBERS, lambda arm: list(arm.joint_position_measured)),
        "commanded": (_NUMBERS, lambda arm: list(arm.joint_position_commanded)),
        "external_torque": (_NUMBERS, lambda arm: list(arm.joint_torque_external)),
    }),
    network.GRIPPER_STATUS: _View("/gripper", "slipmap.Gripper", drake.lcmt_schunk_wsg_status.decode, {
        "timestamp": (_STAMP, lambda gripper: _stamp(gripper.utime)),
        "width": ({"type": "number"}, lambda gripper: 1e-3 * gripper.actual_position_mm),
        "force": ({"type": "number"}, lambda gripper: gripper.actual_force),
    }),
    network.CAMERA_POSE: _View("/camera", "foxglove.FrameTransform", _pose, {
        "timestamp": (_STAMP, lambda pose: _stamp(pose[0])),
        "parent_frame_id": (_TEXT, lambda pose: "world"),
        "child_frame_id": (_TEXT, lambda pose: "camera"),
        "translation": (_PLACE, lambda pose: pose[1]),
        "rotation": (_TURN, lambda pose: pose[2]),
    }),
    network.CAMERA_DEPTH: _View("/depth", "foxglove.RawImage", _depth, {
        "timestamp": (_STAMP, lambda depth: _stamp(depth[0])),
        "frame_id": (_TEXT, lambda depth: "camera"),
        "width": ({"type": "integer"}, lambda depth: depth[1].width),
        "height": ({"type": "integer"}, lambda depth: depth[1].height),
        "encoding": (_TEXT, lambda depth: "32FC1"),
        "step": ({"type": "integer"}, lambda depth: depth[1].row_stride),
        "data": ({"type": "string", "contentEncoding": "base64"}, lambda depth: depth[2]),
    }),
}  # fmt: skip


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
        self.count = 0

    def write(self, event: Event) -> None:
        """Add an event as received, and its JSON for viewers."""
        self._add(event.channel, _RAW, 0, event, event.data)
        self.count += 1
        view = _VIEWS.get(event.channel)
        content = None if view is None else view.content(event.data)
        if view is None or content is None:  # whatever came is kept above
            return
        schema = 0
        if view.name not in self._channels:
            fields = {name: described for name, (described, _) in view.fields.items()}
            described = json.dumps({"type": "object", "properties": fields}).encode()
            schema = self._writer.register_schema(view.schema, "jsonschema", described)
        self._add(view.name, "json", schema, event, content)

    def _add(self, name: str, encoding: str, schema: int, event: Event, data: bytes) -> None:
        if name not in self._channels:
            self._channels[name] = self._writer.register_channel(name, encoding, schema)
        time = 1000 * event.utime
        self._writer.add_message(self._channels[name], time, data, time, self.count)

    def close(self) -> None:
        """Write the end of the log."""
        self._writer.finish()


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
