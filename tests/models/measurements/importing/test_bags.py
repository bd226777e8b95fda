"""Topics of ROS 1 and ROS 2 bags and of MCAP files, without ROS; packed chunks do not explode."""

import json

import numpy as np
import pytest
from tables import POSE, SETUP, TIME, TIP

from slipmap.models.measurements import DatasetError
from slipmap.models.measurements.importing import import_dataset
from slipmap.models.measurements.importing.bags import read_bag

START = 1_700_000_000
SAYS = "object_pose: {part: /block}\ntip_pose: {part: /tip}\nft_wrench: {part: /ft}\n"


def check(tmp_path, file, says=SAYS):
    (tmp_path / "s.yaml").write_text(SETUP + says)
    (trial,) = import_dataset(file, tmp_path / "s.yaml", tell=lambda text: None).trials
    assert trial.object_pose.values == pytest.approx(POSE + np.array([0, 0, 0.3]), abs=1e-9)
    assert trial.object_pose.time == pytest.approx(TIME, abs=1e-6)
    assert trial.tip_pose.values == pytest.approx(TIP, abs=1e-9)
    assert trial.ft_wrench.values[:, 0] == pytest.approx(2.0 * (POSE[:, 0] > 0))


def ros_rows(store, first):
    """Topic, kind, stamp in ns and message of each row."""
    kinds = store.types
    point, quaternion = kinds["geometry_msgs/msg/Point"], kinds["geometry_msgs/msg/Quaternion"]
    vector = kinds["geometry_msgs/msg/Vector3"]

    def header(time):
        stamp = kinds["builtin_interfaces/msg/Time"](START + int(time), round(1e9 * (time % 1.0)))
        more = {"seq": 0} if first else {}
        return kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="world", **more)

    for k, time in enumerate(TIME.tolist()):
        half = 0.5 * (POSE[k, 2] + 0.3)
        pose = kinds["geometry_msgs/msg/Pose"](
            point(*POSE[k, :2], 0.03), quaternion(0.0, 0.0, np.sin(half), np.cos(half))
        )
        tip = kinds["geometry_msgs/msg/Point"](*TIP[k], 0.01)
        force = kinds["geometry_msgs/msg/Wrench"](
            vector(2.0 * (POSE[k, 0] > 0), 0.0, 0.0), vector(0.0, 0.0, 0.0)
        )
        stamp = START * 10**9 + round(1e9 * time) + 12_000_000  # of reception, which is late
        yield "/block", kinds["geometry_msgs/msg/PoseStamped"](header(time), pose), stamp
        yield "/tip", kinds["geometry_msgs/msg/PointStamped"](header(time), tip), stamp
        yield "/ft", kinds["geometry_msgs/msg/WrenchStamped"](header(time), force), stamp


def bag_of(tmp_path, first, packed=False, plugin="SQLITE3", mode="NONE"):
    pytest.importorskip("rosbags")
    from rosbags.rosbag1 import Writer as BagWriter
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer as FolderWriter
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    path = tmp_path / ("a.bag" if first else "a")
    writer = BagWriter(path) if first else FolderWriter(path, version=9, storage_plugin=StoragePlugin[plugin])
    if packed:
        writer.set_compression(BagWriter.CompressionFormat.BZ2)
    elif mode != "NONE":
        writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, message, stamp in ros_rows(store, first):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            data = store.serialize_ros1(message, kind) if first else store.serialize_cdr(message, kind)
            writer.write(connections[topic], stamp, data)
    return path


def test_a_bag_of_ros_1(tmp_path):
    check(tmp_path, bag_of(tmp_path, first=True, packed=True))


def test_a_bag_of_ros_2(tmp_path):
    check(tmp_path, bag_of(tmp_path, first=False))


@pytest.mark.parametrize("mode", ["NONE", "STORAGE"])
def test_mcap_of_ros_2(tmp_path, mode):
    pytest.importorskip("mcap")
    folder = bag_of(tmp_path, first=False, plugin="MCAP", mode=mode)
    check(tmp_path, folder)
    (alone,) = folder.glob("*.mcap")
    alone.rename(tmp_path / "alone.mcap")
    check(tmp_path, tmp_path / "alone.mcap")


def test_a_chunk_that_explodes_is_refused(tmp_path, monkeypatch):
    path = bag_of(tmp_path, first=True, packed=True)
    monkeypatch.setattr("slipmap.models.measurements.importing.bags._LARGEST_CHUNK", 1000)
    with pytest.raises(DatasetError, match="unpacks to more than 1000"):
        read_bag(path, "a.bag")


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
def test_a_packed_bag_of_ros_2(tmp_path, mode):
    check(tmp_path, bag_of(tmp_path, first=False, mode=mode))


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
def test_a_packed_bag_of_ros_2_that_explodes_is_refused(tmp_path, monkeypatch, mode):
    path = bag_of(tmp_path, first=False, mode=mode)
    monkeypatch.setattr("slipmap.models.measurements.importing.bags._LARGEST_CHUNK", 20)
    if mode == "FILE":
        packed = max(file.stat().st_size for file in path.iterdir())
        monkeypatch.setattr("slipmap.models.measurements.importing.bags.LARGEST_FILE", packed)
    with pytest.raises(DatasetError, match="unpacks to more than"):
        read_bag(path, "a")


def test_mcap_in_json(tmp_path):
    pytest.importorskip("mcap")
    from mcap.writer import Writer

    with open(tmp_path / "a.mcap", "wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {}
        for name in ("block", "tip", "ft"):
            schema = writer.register_schema(f"lab.{name}", "jsonschema", b"{}")
            channels[name] = writer.register_channel(f"/{name}", "json", schema)
        for k, time in enumerate(TIME.tolist()):
            half = 0.5 * (POSE[k, 2] + 0.3)
            place = dict(zip("xyz", (*POSE[k, :2].tolist(), 0.03), strict=True))
            turn = {"x": 0, "y": 0, "z": np.sin(half), "w": np.cos(half)}
            stamp = {"sec": START + int(time), "nsec": round(1e9 * (time % 1.0))}
            force = {"x": 2.0 * float(POSE[k, 0] > 0), "y": 0.0}
            rows = {
                "block": {"timestamp": stamp, "pose": {"position": place, "orientation": turn}},
                "tip": {"timestamp": stamp, "position": {"x": TIP[k, 0], "y": TIP[k, 1]}},
                "ft": {"timestamp": stamp, "force": force, "names": ["a", "b"]},
            }
            for name, row in rows.items():
                writer.add_message(channels[name], 5, json.dumps(row).encode(), 5)
        writer.finish()
    check(tmp_path, tmp_path / "a.mcap")


def test_a_topic_that_is_not_there(tmp_path):
    path = bag_of(tmp_path, first=True)
    (tmp_path / "s.yaml").write_text(SETUP + "object_pose: {part: /blok}\ntip_pose: {part: /tip}\n")
    with pytest.raises(DatasetError, match=r"no part '/blok'; there are"):
        import_dataset(path, tmp_path / "s.yaml")
