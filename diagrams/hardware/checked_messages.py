"""Validation of the messages on a cell's channels, and their way into a diagram.

Anything on the network can send anything, so no part of a message is used before it has been checked: its
size, finite numbers, values that a cell can have, and its stamp. Only valid messages pass; the others are
counted.
"""

import logging
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import drake
import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, State
from pydrake.systems.lcm import LcmPublisherSystem, _Serializer_

from slipmap.diagrams.hardware import network
from slipmap.diagrams.hardware.message_stream import LARGEST
from slipmap.diagrams.perception.camera import CameraConfig
from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held, weakly
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import POSITION_LIMITS, SPEED_LIMITS, TORQUE_LIMITS

POSE_COORDINATES = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Names of the numbers in a `lcmt_drake_signal` that is a pose: metres, then a unit quaternion."""

ABORT_COORDINATES = ("abort",)
"""Name of the number in a `lcmt_drake_signal` that stops the arm if it is above 0.5."""

_LONGEST_LEAP = 600.0  # s by which a stamp may jump ahead; accepting a later one would block all true ones
_RESTART = 1.0  # s; messages of one sender are never reordered by as much
_STANDSTILL = 0.01  # s; longest silence counted per step, as in a longer one this process was suspended
_CLOCKS = 0.5  # s; time constant for tracking the clock difference; if one clock is slow, ages err by a share
_ANGLE_SLACK = float(np.deg2rad(10.0))  # beyond a joint's limit, for measured angles
_COMMAND_SLACK = 1e-3  # rad, for commanded ones
_FORCE_FACTOR = 5.0  # an impact may exceed what a motor can do
_SPEED_FACTOR = 3.0
_OPENINGS = (-30.0, 300.0)  # mm
_GRIPPER_SPEED = 2000.0  # mm/s
_GRIPPER_FORCE = 500.0  # N
_FARTHEST = 10.0  # of the camera, m
_DEEPEST = 100.0  # of a reading, m

_log = logging.getLogger("slipmap.hardware")


class BadMessage(ValueError):
    """A message that must not be used. Its text is the cause, the same for messages bad in the same way."""


@dataclass(frozen=True)
class Rule:
    """Requirements on the messages of a channel."""

    lcm_type: Any  # generated class of the messages
    stamp: Callable[[Any], int]  # the sender's clock in a message, µs
    check: Callable[[Any], None]  # raises BadMessage; also repacks pictures
    # whether a stamp that goes back by more than `_RESTART` means that the sender was restarted, with a clock
    # that counts from its start
    anew: bool = False
    # whether a valid message is used; others are ignored, and not reported
    used: Callable[[Any], bool] = lambda message: True

    def read(self, data: bytes) -> tuple[Any, float]:
        """Decode and check a message, except for its stamp; also returns the stamp, s of the sender's clock.

        Raises:
            BadMessage: names the cause.
        """
        if len(data) > LARGEST:
            raise BadMessage("too long")
        try:
            message = self.lcm_type.decode(data)
        except Exception as error:  # generated code fails on hostile bytes in many ways
            raise BadMessage("cannot be decoded") from error
        self.check(message)
        return message, 1e-6 * self.stamp(message)


def check_stamp(stamp: float, last: float, anew: bool = False) -> None:
    """Refuse a stamp that cannot follow the last good one, both in s; the last is NaN before the first.

    `anew` is the attribute of the `Rule`.

    Raises:
        BadMessage: names the cause.
    """
    if stamp < 0:
        raise BadMessage("stamp is negative")
    if stamp < last and not (anew and stamp < last - _RESTART):
        raise BadMessage("stamp goes back")
    if stamp > last + _LONGEST_LEAP:
        raise BadMessage(f"stamp leaps ahead by more than {_LONGEST_LEAP:.0f} s")


def rules(width: int, height: int) -> Mapping[str, Rule]:
    """The rule of each channel, with pictures of a size in pixels."""
    depth, color = drake.lcmt_image.PIXEL_FORMAT_DEPTH, drake.lcmt_image.PIXEL_FORMAT_RGBA
    size = (width, height)
    return {
        network.IIWA_STATUS: Rule(drake.lcmt_iiwa_status, _utime, _check_iiwa_status),
        network.IIWA_COMMAND: Rule(drake.lcmt_iiwa_command, _utime, _check_iiwa_command),
        network.GRIPPER_STATUS: Rule(drake.lcmt_schunk_wsg_status, _utime, _check_gripper_status),
        network.GRIPPER_COMMAND: Rule(
            drake.lcmt_schunk_wsg_command, _utime, _check_gripper_command, anew=True
        ),
        network.CAMERA_DEPTH: Rule(
            drake.lcmt_image_array, lambda m: m.header.utime, lambda m: _check_picture(m, depth, size)
        ),
        network.CAMERA_COLOR: Rule(
            drake.lcmt_image_array, lambda m: m.header.utime, lambda m: _check_picture(m, color, size)
        ),
        network.CAMERA_POSE: Rule(drake.lcmt_drake_signal, lambda m: m.timestamp, _check_pose),
        # Anybody may stop the arm, whatever their clock, and nobody may take that back.
        network.ABORT: Rule(
            drake.lcmt_drake_signal, lambda m: 0, _check_abort, used=lambda m: m.val[0] > 0.5
        ),
    }


@dataclass(frozen=True, eq=False)
class Received:
    """State: the newest good message, and counts of good and bad ones."""

    data: bytes = b""  # of the newest good message, re-encoded; empty before the first
    stamp: float = np.nan  # the sender's clock in it, s
    # the diagram's clock minus the sender's when messages arrive, s
    offset: float = -np.inf
    good: int = 0  # number of good messages
    # number of bad ones, by cause
    dropped: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    silence: float = 0.0  # time since a good one was found, by this computer's clock, s
    looked: float = np.nan  # that clock's reading at the last update, s


class CheckedMessages(PythonSystem):
    """Passes valid messages of a channel and warns about others.

    `hear` takes incoming messages, and the next step processes them. The output ports:

    - `message`: the newest good message for Drake's own receivers, all zero before the first.
    - `stamp` (1,): the sender's clock in it, s, NaN before the first.
    - `age` (1,): time since it was sent, s, infinite before the first. It is computed from the stamp, so it
      stays right when a busy diagram reads several messages at once. The difference between the two clocks,
      including the transmission time, is tracked with a time constant of 0.5 s. While the diagram's clock is
      late, the age may be negative.
    - `silence` (1,): time since a good message was found, s, by this computer's clock, so it stays right
      while the diagram's clock is late. Time during which this process was suspended does not count. 0
      without a clock.
    - `received`: `Received`.

    A warning names channel and cause at the 1st, 10th, 100th … message with the same fault. Drake's own
    subscriber would end the process on a message that cannot be decoded.

    Args:
        clock: of this computer, s; None in a simulation, which need not keep up with real time.
    """

    def __init__(self, channel: str, rule: Rule, clock: Callable[[], float] | None = None) -> None:
        super().__init__()
        self._clock = clock
        # Messages not yet processed belong to the network, not to a Context.
        # Bad ones wait apart, so that they cannot displace good ones.
        self._heard: deque[tuple[bytes, float]] = deque(maxlen=16)
        self._bad: deque[BadMessage] = deque(maxlen=16)
        self._channel = channel
        self._rule = rule
        self._serializer = _Serializer_[rule.lcm_type]()
        self._received = self.DeclareAbstractState(held(Received()))
        self.DeclarePerStepUnrestrictedUpdateEvent(self._update)
        own = self.abstract_state_ticket(self._received)
        self.DeclareAbstractOutputPort(
            "message", self._serializer.CreateDefaultValue, self._calc_message, {own}
        )
        self.declare_vector_output("stamp", 1, lambda context: [self.received(context).stamp], {own})
        self.declare_vector_output("age", 1, self._age, {own, self.time_ticket()})
        self.declare_vector_output("silence", 1, lambda context: [self.received(context).silence], {own})
        self.declare_output_of("received", self._received)

    def received(self, context: Context) -> Received:
        """Messages received so far, from this system's Context."""
        return read(context, self._received)

    def hear(self, data: bytes) -> None:
        """Check a received message and keep it for the next step; may be called from another thread."""
        try:
            message, stamp = self._rule.read(data)
        except BadMessage as error:
            self._bad.append(error)
        else:
            if self._rule.used(message):
                self._heard.append((message.encode(), stamp))

    def take(self, context: Context) -> Received:
        """Process the messages received before the diagram runs, in this system's Context."""
        now = self._taken(context)
        replace_held(context.get_mutable_state(), self._received, now)
        return now

    def _update(self, context: Context, state: State) -> EventStatus:
        if not self._heard and not self._bad and self._clock is None:
            return EventStatus.DidNothing()
        before = self.received(context)
        now = self._taken(context)
        if self._clock is not None:
            now = _listened(now, self._clock(), new=now.good > before.good)
        replace_held(state, self._received, now)
        return EventStatus.Succeeded()

    def _taken(self, context: Context) -> Received:
        now = self.received(context)
        while self._bad:
            now = self._without(now, self._bad.popleft())
        while self._heard:
            now = self._after(now, *self._heard.popleft(), context.get_time())
        return now

    def _without(self, now: Received, error: BadMessage) -> Received:
        cause = str(error)
        count = now.dropped.get(cause, 0) + 1
        if np.log10(count).is_integer():
            _log.warning("%s: message dropped, %s (%d so far)", self._channel, cause, count)
        return replace(now, dropped=MappingProxyType({**now.dropped, cause: count}))

    def _after(self, now: Received, data: bytes, stamp: float, time: float) -> Received:
        try:
            check_stamp(stamp, now.stamp, self._rule.anew)
        except BadMessage as error:
            return self._without(now, error)
        offset = time - stamp
        if now.good and stamp >= now.stamp:
            offset = now.offset + (offset - now.offset) * -np.expm1((now.stamp - stamp) / _CLOCKS)
        return replace(now, data=data, stamp=stamp, offset=float(offset), good=now.good + 1)

    def _calc_message(self, context: Context, output: AbstractValue) -> None:
        data = self.received(context).data
        if data:
            self._serializer.Deserialize(data, output)
        else:
            output.SetFrom(self._serializer.CreateDefaultValue())

    def _age(self, context: Context) -> list[float]:
        now = self.received(context)
        return [context.get_time() - now.offset - now.stamp if now.good else np.inf]


def _listened(now: Received, clock: float, *, new: bool) -> Received:
    passed = min(max(clock - now.looked, 0.0), _STANDSTILL) if np.isfinite(now.looked) else 0.0
    return replace(now, silence=0.0 if new else now.silence + passed, looked=clock)


class Channels(dict[str, CheckedMessages]):
    """The `CheckedMessages` of some channels, by their names."""

    def received(self, root: Context) -> dict[str, Received]:
        """Messages received on each channel so far, and counts of dropped ones."""
        return {name: system.received(system.GetMyContextFromRoot(root)) for name, system in self.items()}

    def subscribe(self, lcm: DrakeLcmInterface) -> None:
        """Subscribe them to a connection."""
        for name, system in self.items():
            lcm.Subscribe(name, weakly(system.hear))


def add_checked(
    builder: DiagramBuilder,
    camera: CameraConfig,
    channels: Iterable[str],
    clocks: Mapping[str, Callable[[], float] | None] = MappingProxyType({}),
) -> Channels:
    """Add the `CheckedMessages` of some channels, each named like its channel, with clocks for some."""
    rule = rules(camera.width, camera.height_pixels)
    return Channels(
        (name, builder.AddNamedSystem(name, CheckedMessages(name, rule[name], clocks.get(name))))
        for name in channels
    )


def publish(
    builder: DiagramBuilder, lcm: DrakeLcmInterface, channel: str, lcm_type: Any, period: float
) -> LcmPublisherSystem:
    """Add a publisher of Drake's messages to a channel, named like the channel.

    If `lcm` is a system of the diagram, pydrake never frees the diagram.
    """
    serializer = _Serializer_[lcm_type]()
    return builder.AddNamedSystem(
        f"{channel}_publisher", LcmPublisherSystem(channel, serializer, lcm, publish_period=period)
    )


class MessagePump(PythonSystem):
    """Makes a connection call its Python subscribers at each step of a diagram.

    It replaces Drake's `LcmInterfaceSystem`, which calls them from within `Simulator.AdvanceTo`. There
    pydrake has released the interpreter lock, and it allocates Python memory for a message before it
    reacquires the lock. If another thread runs Python at that moment, such as the one that processes
    pictures, the process crashes.

    Add it before the systems that process the messages, so that they get them in the same step. It has no
    ports.
    """

    def __init__(self, lcm: DrakeLcmInterface) -> None:
        super().__init__()
        self._lcm = lcm
        self.DeclarePerStepUnrestrictedUpdateEvent(self._hear)

    def _hear(self, context: Any, state: Any) -> EventStatus:
        self._lcm.HandleSubscriptions(0)
        return EventStatus.DidNothing()


def _utime(message: Any) -> int:
    return int(message.utime)


def _check_iiwa_status(message: drake.lcmt_iiwa_status) -> None:
    if message.num_joints != 7:
        raise BadMessage("does not have 7 joints")
    angles, slack = POSITION_LIMITS, _ANGLE_SLACK
    _check_vector("measured angles", message.joint_position_measured, angles + slack)
    _check_vector("commanded angles", message.joint_position_commanded, angles + slack)
    _check_vector("speeds", message.joint_velocity_estimated, _SPEED_FACTOR * SPEED_LIMITS)
    for name in ("measured", "commanded", "external"):
        torques = getattr(message, f"joint_torque_{name}")
        _check_vector(f"{name} torques", torques, _FORCE_FACTOR * TORQUE_LIMITS)


def _check_iiwa_command(message: drake.lcmt_iiwa_command) -> None:
    if message.num_joints != 7:
        raise BadMessage("does not have 7 joints")
    if message.num_torques != 0:
        raise BadMessage("has torques, but the arm only takes angles")
    _check_vector("angles", message.joint_position, POSITION_LIMITS + _COMMAND_SLACK)


def _check_gripper_status(message: drake.lcmt_schunk_wsg_status) -> None:
    _check_number("opening", message.actual_position_mm, *_OPENINGS)
    _check_number("speed", message.actual_speed_mm_per_s, -_GRIPPER_SPEED, _GRIPPER_SPEED)
    _check_number("force", message.actual_force, -_GRIPPER_FORCE, _GRIPPER_FORCE)


def _check_gripper_command(message: drake.lcmt_schunk_wsg_command) -> None:
    _check_number("opening", message.target_position_mm, *_OPENINGS)
    _check_number("force", message.force, 0.0, _GRIPPER_FORCE)


def _check_pose(message: drake.lcmt_drake_signal) -> None:
    if tuple(message.coord) != POSE_COORDINATES or len(message.val) != len(POSE_COORDINATES):
        raise BadMessage(f"is not a pose: {', '.join(POSE_COORDINATES)}")
    limits = np.array([_FARTHEST] * 3 + [1.0 + 1e-6] * 4)
    _check_vector("pose", message.val, limits)
    if abs(np.linalg.norm(message.val[3:]) - 1.0) > 1e-3:
        raise BadMessage("quaternion is not of length 1")


def _check_abort(message: drake.lcmt_drake_signal) -> None:
    if tuple(message.coord) != ABORT_COORDINATES or len(message.val) != len(ABORT_COORDINATES):
        raise BadMessage("is not one number named abort")
    _check_number("abort", message.val[0], 0.0, 1.0)


def _check_picture(message: drake.lcmt_image_array, pixel_format: int, size: tuple[int, int]) -> None:
    if len(message.images) != 1:
        raise BadMessage("does not have exactly one picture")
    image, (width, height) = message.images[0], size
    if (image.width, image.height) != size:
        raise BadMessage(f"picture is not {width} by {height} pixels")
    depth = pixel_format == drake.lcmt_image.PIXEL_FORMAT_DEPTH
    channel = drake.lcmt_image.CHANNEL_TYPE_FLOAT32 if depth else drake.lcmt_image.CHANNEL_TYPE_UINT8
    if (image.pixel_format, image.channel_type, bool(image.bigendian)) != (pixel_format, channel, False):
        raise BadMessage(f"picture is not {'depth in 32 bit floats' if depth else 'RGBA in bytes'}")
    pixels = unpacked(image, 4 * width * height)
    if image.row_stride != 4 * width or len(pixels) != 4 * width * height:
        raise BadMessage("picture has the wrong number of bytes for its size")
    if depth:
        readings = np.frombuffer(pixels, "<f4")
        finite = readings[np.isfinite(readings)]
        # 0 means no reading, and infinity a reading beyond the range.
        if np.isnan(readings).any() or readings.min() < 0 or finite.max(initial=0.0) > _DEEPEST:
            raise BadMessage("picture has impossible depths")
    # Drake 1.51 reads only a quarter of the pixels of an uncompressed depth picture.
    image.data = zlib.compress(pixels, 0)
    image.size, image.compression_method = len(image.data), drake.lcmt_image.COMPRESSION_METHOD_ZLIB


def unpacked(image: drake.lcmt_image, size: int) -> bytes:
    """Pixels of a picture, decompressed; never more than one byte beyond `size`, whatever was sent."""
    if image.compression_method == drake.lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED:
        return bytes(image.data)
    if image.compression_method != drake.lcmt_image.COMPRESSION_METHOD_ZLIB:
        raise BadMessage("picture is compressed by something other than zlib")
    try:
        return zlib.decompressobj().decompress(image.data, size + 1)
    except zlib.error as error:
        raise BadMessage("picture cannot be decompressed") from error


def _check_vector(name: str, values: Any, limits: FloatArray) -> None:
    array = np.asarray(values, dtype=float)
    if array.shape != limits.shape:
        raise BadMessage(f"{name}: not {len(limits)} numbers")
    if not np.isfinite(array).all():
        raise BadMessage(f"{name}: not finite")
    if (np.abs(array) > limits).any():
        raise BadMessage(f"{name}: far out of limits")


def _check_number(name: str, value: float, low: float, high: float) -> None:
    if not np.isfinite(value):
        raise BadMessage(f"{name}: not finite")
    if not low <= value <= high:
        raise BadMessage(f"{name}: far out of limits")
