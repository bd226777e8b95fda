"""Messages that are to be believed, and one for each reason not to believe it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from drake import lcmt_image_array
from good_messages import GOOD, HEIGHT, WIDTH, depth_picture, depths, pack
from pydrake.systems.lcm import _Serializer_
from pydrake.systems.sensors import LcmImageArrayToImages

from slipmap.diagrams.hardware import network
from slipmap.diagrams.hardware.checked_messages import BadMessage, check_stamp, rules

RULES = rules(WIDTH, HEIGHT)


@pytest.mark.parametrize("channel", GOOD)
def test_good_messages_come_with_their_stamp(channel):
    message, stamp = RULES[channel].read(GOOD[channel]().encode())
    assert stamp == (0.0 if channel == network.ABORT else 1.0)  # anybody may abort, by whatever clock
    assert type(message) is RULES[channel].lcm_type


@pytest.mark.parametrize("packed", [True, False])
def test_drakes_receiver_gets_all_pixels(packed):
    message, _ = RULES[network.CAMERA_DEPTH].read(depth_picture(packed=packed).encode())
    serializer = _Serializer_[lcmt_image_array]()
    value = serializer.CreateDefaultValue()
    serializer.Deserialize(message.encode(), value)
    receiver = LcmImageArrayToImages()
    context = receiver.CreateDefaultContext()
    receiver.get_input_port().FixValue(context, value)
    picture = receiver.GetOutputPort("depth_image").Eval(context)
    np.testing.assert_array_equal(picture.data[:, :, 0], depths())


@pytest.mark.parametrize("channel", GOOD)
@pytest.mark.parametrize(
    "damage", [lambda b: b"", lambda b: b[:-1], lambda b: b"x" * 8 + b[8:], lambda b: b[:9]]
)
def test_what_cannot_be_decoded_is_dropped(channel, damage):
    with pytest.raises(BadMessage, match="cannot be decoded"):
        RULES[channel].read(damage(GOOD[channel]().encode()))


@pytest.mark.parametrize("channel", GOOD)
def test_random_bytes_never_do_harm(channel):
    rng = np.random.default_rng(0)
    good = bytearray(GOOD[channel]().encode())
    for _ in range(300):
        data = bytearray(good)
        for place in rng.integers(8, len(data), size=4):
            data[place] = rng.integers(256)
        try:
            message, _ = RULES[channel].read(bytes(data))
        except BadMessage:
            continue
        assert len(message.encode()) > 8  # else Drake's own decoding, which ends the process at a flaw


def set_first(name: str, value: float) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        values = list(getattr(message, name))
        values[0] = value
        setattr(message, name, values)

    return change


def set_field(name: str, value: Any) -> Callable[[Any], None]:
    return lambda message: setattr(message, name, value)


def set_image(name: str, value: Any) -> Callable[[Any], None]:
    return lambda message: setattr(message.images[0], name, value)


def six_joints(message: Any) -> None:
    message.num_joints = 6
    for name in message.__slots__:
        if name.startswith("joint"):
            setattr(message, name, list(getattr(message, name))[:6])


def no_pictures(message: Any) -> None:
    message.num_images, message.images = 0, []


def six_numbers(message: Any) -> None:
    message.dim, message.coord, message.val = 6, message.coord[:6], message.val[:6]


def torques(message: Any) -> None:
    message.num_torques, message.joint_torque = 7, [0.0] * 7


def bomb(message: Any) -> None:
    image = message.images[0]
    image.data, image.compression_method = bytes(50_000_000), 0
    pack(message)


def spoilt_bytes(message: Any) -> None:
    image = message.images[0]
    image.data = b"no zlib stream"
    image.size = len(image.data)


def depth(place: int, value: float) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        pixels = depths()
        pixels.flat[place] = value
        message.images = depth_picture(pixels).images

    return change


STATUS, COMMAND, DEPTH = network.IIWA_STATUS, network.IIWA_COMMAND, network.CAMERA_DEPTH


@pytest.mark.parametrize(
    ("channel", "change", "cause"),
    [
        (STATUS, six_joints, "7 joints"),
        (STATUS, set_first("joint_position_measured", np.nan), "measured angles: not finite"),
        (STATUS, set_first("joint_position_measured", 4.0), "measured angles: far out"),
        (STATUS, set_first("joint_position_commanded", -np.inf), "commanded angles: not finite"),
        (STATUS, set_first("joint_velocity_estimated", 9.0), "speeds: far out"),
        (STATUS, set_first("joint_torque_external", 1e5), "external torques: far out"),
        (STATUS, set_first("joint_torque_measured", np.nan), "measured torques: not finite"),
        (COMMAND, six_joints, "7 joints"),
        (COMMAND, torques, "torques"),
        (COMMAND, set_first("joint_position", 3.0), "angles: far out"),
        (COMMAND, set_first("joint_position", np.inf), "angles: not finite"),
        (network.GRIPPER_STATUS, set_field("actual_position_mm", np.nan), "opening: not finite"),
        (network.GRIPPER_STATUS, set_field("actual_speed_mm_per_s", 1e6), "speed: far out"),
        (network.GRIPPER_STATUS, set_field("actual_force", np.inf), "force: not finite"),
        (network.GRIPPER_COMMAND, set_field("target_position_mm", 1e4), "opening: far out"),
        (network.GRIPPER_COMMAND, set_field("force", -1.0), "force: far out"),
        (network.CAMERA_POSE, six_numbers, "not a pose"),
        (network.CAMERA_POSE, set_first("val", np.nan), "pose: not finite"),
        (network.CAMERA_POSE, set_first("val", 20.0), "pose: far out"),
        (network.CAMERA_POSE, set_field("val", [0.0] * 7), "quaternion"),
        (network.CAMERA_POSE, set_field("coord", list("abcdefg")), "not a pose"),
        (network.ABORT, set_first("val", np.nan), "abort: not finite"),
        (network.ABORT, set_first("val", 2.0), "abort: far out"),
        (network.ABORT, set_field("coord", ["stop"]), "not one number named abort"),
        (DEPTH, no_pictures, "not have exactly one picture"),
        (DEPTH, set_image("width", WIDTH + 1), f"not {WIDTH} by {HEIGHT}"),
        (DEPTH, set_image("height", -HEIGHT), f"not {WIDTH} by {HEIGHT}"),
        (DEPTH, set_image("row_stride", 4), "bytes"),
        (DEPTH, set_image("pixel_format", 3), "not depth"),
        (DEPTH, set_image("channel_type", 7), "not depth"),
        (DEPTH, set_image("bigendian", True), "not depth"),
        (DEPTH, set_image("compression_method", 3), "other than zlib"),
        (DEPTH, set_image("compression_method", 0), "bytes"),
        (DEPTH, spoilt_bytes, "cannot be decompressed"),
        (DEPTH, bomb, "bytes"),
        (DEPTH, depth(5, np.nan), "impossible depths"),
        (DEPTH, depth(5, -0.1), "impossible depths"),
        (DEPTH, depth(5, 1e6), "impossible depths"),
        (network.CAMERA_COLOR, set_image("pixel_format", 1), "not RGBA"),
    ],
)
def test_bad_messages_are_dropped_with_their_cause(channel, change, cause):
    message = GOOD[channel]()
    change(message)
    with pytest.raises(BadMessage, match=cause):
        RULES[channel].read(message.encode())


@pytest.mark.parametrize(
    ("stamp", "last", "cause"),
    [(1.0, 1.000001, "goes back"), (700.0, 99.9, "leaps ahead"), (-1e-6, np.nan, "negative")],
)
def test_stamps_that_go_back_or_leap_are_refused(stamp, last, cause):
    with pytest.raises(BadMessage, match=cause):
        check_stamp(stamp, last)


def test_a_gripper_may_be_told_by_a_program_started_anew():
    assert RULES[network.GRIPPER_COMMAND].anew and not RULES[network.IIWA_COMMAND].anew
    check_stamp(0.0, 200.0, anew=True)
    with pytest.raises(BadMessage, match="goes back"):
        check_stamp(199.5, 200.0, anew=True)


@pytest.mark.parametrize(("stamp", "last"), [(0.0, np.nan), (1e9, np.nan), (5.0, 5.0), (600.0, 1.0)])
def test_other_stamps_are_taken(stamp, last):
    check_stamp(stamp, last)
