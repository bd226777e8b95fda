"""A good message for each channel, to be spoilt."""

from __future__ import annotations

import zlib

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

from slipmap.diagrams.hardware import network
from slipmap.diagrams.station.arm import HOME

WIDTH, HEIGHT = 20, 12


def iiwa_status() -> lcmt_iiwa_status:
    message = lcmt_iiwa_status()
    message.utime, message.num_joints = 1_000_000, 7
    message.joint_position_measured = list(HOME)
    message.joint_position_commanded = list(HOME)
    message.joint_position_ipo = [0.0] * 7
    message.joint_velocity_estimated = [0.1] * 7
    for name in ("measured", "commanded", "external"):
        setattr(message, f"joint_torque_{name}", [1.0] * 7)
    return message


def iiwa_command() -> lcmt_iiwa_command:
    message = lcmt_iiwa_command()
    message.utime, message.num_joints, message.joint_position = 1_000_000, 7, list(HOME)
    return message


def gripper_status() -> lcmt_schunk_wsg_status:
    message = lcmt_schunk_wsg_status()
    message.utime, message.actual_position_mm = 1_000_000, 20.0
    message.actual_force, message.actual_speed_mm_per_s = 3.0, -5.0
    return message


def gripper_command() -> lcmt_schunk_wsg_command:
    message = lcmt_schunk_wsg_command()
    message.utime, message.target_position_mm, message.force = 1_000_000, 30.0, 40.0
    return message


def camera_pose() -> lcmt_drake_signal:
    message = lcmt_drake_signal()
    message.dim, message.timestamp = 7, 1_000_000
    message.coord = ["x", "y", "z", "qw", "qx", "qy", "qz"]
    message.val = [0.1, 0.2, 1.1, 0.0, 1.0, 0.0, 0.0]
    return message


def abort() -> lcmt_drake_signal:
    message = lcmt_drake_signal()
    message.dim, message.coord, message.val = 1, ["abort"], [1.0]
    return message


def depths() -> np.ndarray:
    image = np.linspace(0.5, 1.5, WIDTH * HEIGHT, dtype="<f4").reshape(HEIGHT, WIDTH)
    image[0, 0], image[0, 1] = 0.0, np.inf  # no reading, and too far
    return image


def depth_picture(pixels: np.ndarray | None = None, packed: bool = True) -> lcmt_image_array:
    data = (depths() if pixels is None else pixels).astype("<f4").tobytes()
    message = _picture(lcmt_image.PIXEL_FORMAT_DEPTH, lcmt_image.CHANNEL_TYPE_FLOAT32, data)
    if packed:
        pack(message)
    return message


def color_picture() -> lcmt_image_array:
    data = np.arange(4 * WIDTH * HEIGHT, dtype=np.uint8).tobytes()
    return _picture(lcmt_image.PIXEL_FORMAT_RGBA, lcmt_image.CHANNEL_TYPE_UINT8, data)


def pack(message: lcmt_image_array) -> None:
    image = message.images[0]
    image.data = zlib.compress(image.data)
    image.size = len(image.data)
    image.compression_method = lcmt_image.COMPRESSION_METHOD_ZLIB


def _picture(pixel_format: int, channel_type: int, data: bytes) -> lcmt_image_array:
    image = lcmt_image()
    image.width, image.height, image.row_stride = WIDTH, HEIGHT, 4 * WIDTH
    image.pixel_format, image.channel_type = pixel_format, channel_type
    image.data, image.size = data, len(data)
    message = lcmt_image_array()
    message.num_images, message.images = 1, [image]
    message.header.utime = 1_000_000
    return message


GOOD = {
    network.IIWA_STATUS: iiwa_status,
    network.IIWA_COMMAND: iiwa_command,
    network.GRIPPER_STATUS: gripper_status,
    network.GRIPPER_COMMAND: gripper_command,
    network.CAMERA_DEPTH: depth_picture,
    network.CAMERA_COLOR: color_picture,
    network.CAMERA_POSE: camera_pose,
    network.ABORT: abort,
}
