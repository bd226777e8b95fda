"""What a message must be to be believed: sizes, finite numbers, values that a cell can have, and its stamp.

Whoever can send to the network can send anything, so nothing of a message is used before it was checked.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from drake import (
    lcmt_drake_signal,
    lcmt_iiwa_command,
    lcmt_iiwa_status,
    lcmt_image,
    lcmt_image_array,
    lcmt_schunk_wsg_command,
    lcmt_schunk_wsg_status,
)

from slipmap.diagrams.hardware import channels
from slipmap.diagrams.hardware.message_stream import LARGEST
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import POSITION_LIMITS, SPEED_LIMITS, TORQUE_LIMITS

POSE_COORDINATES = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Names of the numbers of a `lcmt_drake_signal` that is a pose: metres, then a unit quaternion."""

ABORT_COORDINATES = ("abort",)
"""Name of the number of a `lcmt_drake_signal` that stops the arm where it is above 0.5."""

LONGEST_LEAP = 600.0
"""s by which a stamp may be later than the one before; a later one would shut out all true ones after it."""

RESTART = 1.0
"""s; messages of one sender are not mixed up by as much."""

_ANGLE_SLACK = float(np.deg2rad(10.0))  # over a joint's limit, for measured angles
_COMMAND_SLACK = 1e-3  # rad, for commanded ones
_FORCE_FACTOR = 5.0  # a blow may exceed what a motor can do
_SPEED_FACTOR = 3.0
_OPENINGS = (-30.0, 300.0)  # mm
_GRIPPER_SPEED = 2000.0  # mm/s
_GRIPPER_FORCE = 500.0  # N
_FARTHEST = 10.0  # of the camera, m
_DEEPEST = 100.0  # of a reading, m


class BadMessage(ValueError):
    """A message that is not to be used. `str` is the cause, the same for messages bad in the same way."""


@dataclass(frozen=True)
class Rule:
    """What messages of a channel must be.

    Attributes:
        lcm_type: generated class of the messages.
        stamp: the sender's clock in a message, µs.
        check: raises BadMessage; pictures are packed anew by it.
        anew: whether a stamp that goes back by more than `RESTART` is that of a sender started anew, whose
            clock tells how long it has been running.
    """

    lcm_type: Any
    stamp: Callable[[Any], int]
    check: Callable[[Any], None]
    anew: bool = False

    def read(self, data: bytes) -> tuple[Any, float]:
        """A message that may be believed, but for its stamp, and the stamp, s of the sender's clock.

        Args:
            data: as received.

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

    `anew` is that of the `Rule`.

    Raises:
        BadMessage: names the cause.
    """
    if stamp < 0:
        raise BadMessage("stamp is negative")
    if stamp < last and not (anew and stamp < last - RESTART):
        raise BadMessage("stamp goes back")
    if stamp > last + LONGEST_LEAP:
        raise BadMessage(f"stamp leaps ahead by more than {LONGEST_LEAP:.0f} s")


def rules(width: int, height: int) -> Mapping[str, Rule]:
    """The rule of each channel.

    Args:
        width, height: of the camera's pictures, pixels.
    """
    depth, color = lcmt_image.PIXEL_FORMAT_DEPTH, lcmt_image.PIXEL_FORMAT_RGBA
    size = (width, height)
    return {
        channels.IIWA_STATUS: Rule(lcmt_iiwa_status, _utime, _check_iiwa_status),
        channels.IIWA_COMMAND: Rule(lcmt_iiwa_command, _utime, _check_iiwa_command),
        channels.GRIPPER_STATUS: Rule(lcmt_schunk_wsg_status, _utime, _check_gripper_status),
        channels.GRIPPER_COMMAND: Rule(lcmt_schunk_wsg_command, _utime, _check_gripper_command, anew=True),
        channels.CAMERA_DEPTH: Rule(
            lcmt_image_array, lambda m: m.header.utime, lambda m: _check_picture(m, depth, size)
        ),
        channels.CAMERA_COLOR: Rule(
            lcmt_image_array, lambda m: m.header.utime, lambda m: _check_picture(m, color, size)
        ),
        channels.CAMERA_POSE: Rule(lcmt_drake_signal, lambda m: m.timestamp, _check_pose),
        # Anybody may stop the arm, by whatever clock.
        channels.ABORT: Rule(lcmt_drake_signal, lambda m: 0, _check_abort),
    }


def _utime(message: Any) -> int:
    return int(message.utime)


def _check_iiwa_status(message: lcmt_iiwa_status) -> None:
    if message.num_joints != 7:
        raise BadMessage("has not 7 joints")
    angles, slack = POSITION_LIMITS, _ANGLE_SLACK
    _check_vector("measured angles", message.joint_position_measured, angles + slack)
    _check_vector("commanded angles", message.joint_position_commanded, angles + slack)
    _check_vector("speeds", message.joint_velocity_estimated, _SPEED_FACTOR * SPEED_LIMITS)
    for name in ("measured", "commanded", "external"):
        torques = getattr(message, f"joint_torque_{name}")
        _check_vector(f"{name} torques", torques, _FORCE_FACTOR * TORQUE_LIMITS)


def _check_iiwa_command(message: lcmt_iiwa_command) -> None:
    if message.num_joints != 7:
        raise BadMessage("has not 7 joints")
    if message.num_torques != 0:
        raise BadMessage("has torques, and the arm takes angles alone")
    _check_vector("angles", message.joint_position, POSITION_LIMITS + _COMMAND_SLACK)


def _check_gripper_status(message: lcmt_schunk_wsg_status) -> None:
    _check_number("opening", message.actual_position_mm, *_OPENINGS)
    _check_number("speed", message.actual_speed_mm_per_s, -_GRIPPER_SPEED, _GRIPPER_SPEED)
    _check_number("force", message.actual_force, -_GRIPPER_FORCE, _GRIPPER_FORCE)


def _check_gripper_command(message: lcmt_schunk_wsg_command) -> None:
    _check_number("opening", message.target_position_mm, *_OPENINGS)
    _check_number("force", message.force, 0.0, _GRIPPER_FORCE)


def _check_pose(message: lcmt_drake_signal) -> None:
    if tuple(message.coord) != POSE_COORDINATES or len(message.val) != len(POSE_COORDINATES):
        raise BadMessage(f"is not a pose: {', '.join(POSE_COORDINATES)}")
    limits = np.array([_FARTHEST] * 3 + [1.0 + 1e-6] * 4)
    _check_vector("pose", message.val, limits)
    if abs(np.linalg.norm(message.val[3:]) - 1.0) > 1e-3:
        raise BadMessage("quaternion has not the length 1")


def _check_abort(message: lcmt_drake_signal) -> None:
    if tuple(message.coord) != ABORT_COORDINATES or len(message.val) != len(ABORT_COORDINATES):
        raise BadMessage("is not one number named abort")
    _check_number("abort", message.val[0], 0.0, 1.0)


def _check_picture(message: lcmt_image_array, pixel_format: int, size: tuple[int, int]) -> None:
    if len(message.images) != 1:
        raise BadMessage("has not one picture")
    image, (width, height) = message.images[0], size
    if (image.width, image.height) != size:
        raise BadMessage(f"picture is not {width} by {height} pixels")
    depth = pixel_format == lcmt_image.PIXEL_FORMAT_DEPTH
    channel = lcmt_image.CHANNEL_TYPE_FLOAT32 if depth else lcmt_image.CHANNEL_TYPE_UINT8
    if (image.pixel_format, image.channel_type, bool(image.bigendian)) != (pixel_format, channel, False):
        raise BadMessage(f"picture is not {'depth in 32 bit floats' if depth else 'RGBA in bytes'}")
    pixels = _unpacked(image, 4 * width * height)
    if image.row_stride != 4 * width or len(pixels) != 4 * width * height:
        raise BadMessage("picture has not as many bytes as its size asks for")
    if depth:
        readings = np.frombuffer(pixels, "<f4")
        finite = readings[np.isfinite(readings)]
        # 0 is no reading, and infinity one beyond the range.
        if np.isnan(readings).any() or readings.min() < 0 or finite.max(initial=0.0) > _DEEPEST:
            raise BadMessage("picture has depths that cannot be")
    # Drake 1.51 takes a quarter of the pixels of a depth picture that is not packed at all.
    image.data = zlib.compress(pixels, 0)
    image.size, image.compression_method = len(image.data), lcmt_image.COMPRESSION_METHOD_ZLIB


def _unpacked(image: lcmt_image, size: int) -> bytes:
    """Pixels of a picture; never more than one byte over their proper size, whatever is packed."""
    if image.compression_method == lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED:
        return bytes(image.data)
    if image.compression_method != lcmt_image.COMPRESSION_METHOD_ZLIB:
        raise BadMessage("picture is packed in another way than with zlib")
    try:
        return zlib.decompressobj().decompress(image.data, size + 1)
    except zlib.error as error:
        raise BadMessage("picture cannot be unpacked") from error


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
