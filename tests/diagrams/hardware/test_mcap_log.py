"""Logs as MCAP: every message comes back as it was, and viewers see arm, gripper and camera."""

from __future__ import annotations

import base64
import io
import json

import numpy as np
import pytest
from good_messages import HEIGHT, WIDTH, camera_pose, depth_picture, depths, gripper_status, iiwa_status

from slipmap.diagrams.hardware import network
from slipmap.diagrams.hardware.mcap_log import McapLog, McapReader
from slipmap.diagrams.hardware.message_stream import BadLog, Event
from slipmap.diagrams.station.arm import HOME

pytest.importorskip("mcap")

EVENTS = [
    Event(number, 1_700_000_000_000_000 + 5000 * number, channel, data)
    for number, (channel, data) in enumerate(
        (
            (network.IIWA_STATUS, iiwa_status().encode()),
            (network.GRIPPER_STATUS, gripper_status().encode()),
            (network.CAMERA_POSE, camera_pose().encode()),
            (network.CAMERA_DEPTH, depth_picture().encode()),
            (network.IIWA_STATUS, b"junk"),
            ("ELSE", b""),
            (network.IIWA_STATUS, iiwa_status().encode()),
        )
    )
]


class Named(io.BytesIO):
    name = "log.mcap"


def written(events=EVENTS):
    file = Named()
    log = McapLog(file)
    for event in events:
        log.write(event)
    log.close()
    return file.getvalue()


def events(data):
    reader = McapReader(io.BytesIO(data), "log.mcap")
    return list(reader), reader.cut_off


def test_what_was_written_is_read():
    assert events(written()) == (EVENTS, False)


def test_viewers_see_arm_gripper_and_camera():
    from mcap.reader import make_reader

    seen = {}
    for schema, channel, message in make_reader(io.BytesIO(written())).iter_messages():
        if channel.message_encoding == "json":
            assert schema.encoding == "jsonschema"
            document = json.loads(message.data)
            described = json.loads(schema.data)
            assert document.keys() == described["properties"].keys()
            assert document["timestamp"] == {"sec": 1, "nsec": 0}
            seen.setdefault((channel.topic, schema.name), []).append(document)
    assert {topic for topic, _ in seen} == {"/arm", "/gripper", "/camera", "/depth"}
    assert seen["/arm", "slipmap.Arm"][1]["position"] == pytest.approx(HOME)
    assert seen["/gripper", "slipmap.Gripper"][0]["width"] == pytest.approx(0.02)
    (transform,) = seen["/camera", "foxglove.FrameTransform"]
    assert transform["translation"] == {"x": 0.1, "y": 0.2, "z": 1.1}
    assert transform["rotation"] == {"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0}
    (picture,) = seen["/depth", "foxglove.RawImage"]
    assert (picture["width"], picture["height"], picture["step"]) == (WIDTH, HEIGHT, 4 * WIDTH)
    pixels = np.frombuffer(base64.b64decode(picture["data"]), "<f4").reshape(HEIGHT, WIDTH)
    assert np.array_equal(pixels, depths())


def test_messages_that_are_damaged_or_not_finite_are_kept_and_not_shown():
    """JSON has no NaN, and viewers refuse it."""
    messages = (
        (network.IIWA_STATUS, iiwa_status()),
        (network.GRIPPER_STATUS, gripper_status()),
        (network.CAMERA_POSE, camera_pose()),
        (network.CAMERA_DEPTH, depth_picture()),
    )
    bad = [
        (channel, message.encode()[:length])
        for channel, message in messages
        for length in range(0, min(len(message.encode()), 600), 7)
    ]
    for number in (np.nan, np.inf):
        for channel, message in messages[:2]:
            if channel == network.IIWA_STATUS:
                message.joint_position_measured = [number, *HOME[1:]]
            else:
                message.actual_force = number
            bad.append((channel, message.encode()))
    came = [Event(number, 1000 * number, *event) for number, event in enumerate(bad)]
    data = written(came)
    assert events(data) == (came, False)
    assert topics(data) == {network.IIWA_STATUS, network.GRIPPER_STATUS, *network.CAMERA[:2]}
    assert topics(written([*came, *EVENTS])) > topics(data)


def topics(data):
    from mcap.reader import make_reader

    return {channel.topic for _, channel, _ in make_reader(io.BytesIO(data)).iter_messages()}


def test_a_log_that_is_cut_off_or_damaged_is_read_or_refused_in_one_paragraph():
    whole = written()
    rng = np.random.default_rng(0)
    for number in range(200):
        data = bytearray(whole)
        if number % 2:
            data = data[: rng.integers(1, len(data))]
        else:
            data[rng.integers(0, len(data))] = rng.integers(256)
        try:
            found, _ = events(bytes(data))
        except BadLog as error:
            assert "\n" not in str(error) and "log.mcap" in str(error)
        else:
            assert len(found) <= len(EVENTS)


def test_a_log_of_others_is_refused():
    with pytest.raises(BadLog, match="has no LCM messages"):
        events(written([]))
    with pytest.raises(BadLog, match="is not an MCAP log"):
        events(b"no log at all, but long enough for a header")
