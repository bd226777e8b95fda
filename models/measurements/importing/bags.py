"""Read topics of ROS 1 bags, ROS 2 bags and MCAP files as tables, without an installation of ROS.

A message's fields become columns such as `pose.position.x`; transforms of /tf become parts
`/tf/<child frame>`. The clock is that of the messages' own stamps, or of their reception if they have none.
"""

from __future__ import annotations

import json
from bz2 import BZ2Decompressor
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

from slipmap.models.measurements import parsing
from slipmap.models.measurements.importing.source import (
    LARGEST_FILE,
    MOST_NUMBERS,
    Column,
    Source,
    check_size,
    missing_library,
)
from slipmap.models.measurements.trial import DatasetError

BAG_ENDINGS = (".bag", ".db3", ".mcap")

_LARGEST_CHUNK = 2**28  # bytes of an unpacked chunk; recorders make chunks of about 1 MB
_PART = 2**20  # bytes unpacked at a time
_LONGEST_ARRAY = 32  # most numbers of a field that become columns
_DEEPEST = 8
_NO_POSES = ("Image", "CompressedImage", "PointCloud", "PointCloud2", "LaserScan", "Log", "DiagnosticArray",
             "CameraInfo", "Markers", "MarkerArray", "OccupancyGrid")  # fmt: skip
"""Kinds of long messages without a pose."""

_Message = tuple[str, float, Any]
"""A part, the time of reception of the message, s, and its content."""


def read_bag(path: Path, where: str, wanted: Collection[str] = ()) -> list[Source]:
    """The topics of a bag: only the wanted ones, or all that may hold poses or forces if none are named.

    Raises:
        DatasetError: a library is not installed, or the bag is broken or too large.
    """
    for file in path.iterdir() if path.is_dir() else [path]:
        check_size(file, where)
    topics = {f"/{part.strip('/').split('/')[0]}" if _of_tf(part) else part for part in wanted}
    messages = _mcap if path.suffix.lower() == ".mcap" else _ros
    tables: dict[str, _Rows] = {}
    try:
        numbers = 0
        for part, received, message in messages(path, where, topics):
            for name, content in _transforms(part, message):
                if wanted and name not in wanted and part not in wanted:
                    continue
                row = dict(_flat(content))
                numbers += len(row)
                if numbers > MOST_NUMBERS:
                    raise DatasetError(
                        f"{where}: has more than {MOST_NUMBERS} numbers; name the topics with `part`"
                    )
                tables.setdefault(name, _Rows()).add(_stamp(row) or received, row)
    except DatasetError:
        raise
    except Exception as error:  # the libraries can raise anything on bytes that are not a bag
        raise DatasetError(
            f"{where}: not readable as a bag ({parsing.shown_error(error)}); was it cut short?"
        ) from None
    found = [Source(where, part, rows.columns(), np.array(rows.time)) for part, rows in tables.items()]
    if not found:
        raise DatasetError(f"{where}: has no messages{' on ' + ', '.join(sorted(wanted)) if wanted else ''}")
    return [source for source in found if source.columns]


def _of_tf(part: str) -> bool:
    return part.strip("/").split("/")[0] in ("tf", "tf_static")


class _Rows:
    """Rows of a topic whose fields may vary."""

    def __init__(self) -> None:
        self.time: list[float] = []
        self._cells: dict[str, list[float]] = {}

    def add(self, time: float, row: Mapping[str, float]) -> None:
        """Add the next row."""
        for name in row:
            if name not in self._cells:
                self._cells[name] = [float("nan")] * len(self.time)
        for name, cells in self._cells.items():
            cells.append(row.get(name, float("nan")))
        self.time.append(time)

    def columns(self) -> dict[str, Column]:
        """Columns (T,) of each field, in the order of the message."""
        return {name: np.array(cells) for name, cells in self._cells.items()}


def _transforms(part: str, message: Any) -> Iterator[tuple[str, Any]]:
    """The message, or each transform of /tf under the name of its frame."""
    listed = _field(message, "transforms")
    if listed is None or not _of_tf(part):
        yield part, message
        return
    for transform in listed:
        yield f"{part}/{str(_field(transform, 'child_frame_id')).strip('/')}", transform


def _field(message: Any, name: str) -> Any:
    return message.get(name) if isinstance(message, dict) else getattr(message, name, None)


def _stamp(row: Mapping[str, float]) -> float:
    """The message's own time, s; 0 if it has none."""
    for name in ("header.stamp", "timestamp", "stamp"):
        if f"{name}.sec" in row:
            parts = (row.get(f"{name}.{part}", 0.0) for part in ("nanosec", "nsec", "nsecs"))
            return row[f"{name}.sec"] + 1e-9 * max(parts)
    return 0.0


def _flat(message: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, float]]:
    """Numbers of a message, by the path of field names."""
    if isinstance(message, bool | int | float | np.number):
        yield prefix[:-1], float(message)
    elif isinstance(message, np.ndarray | list | tuple):
        if len(message) <= _LONGEST_ARRAY and depth < _DEEPEST:
            for number, value in enumerate(message):
                yield from _flat(value, f"{prefix}{number}.", depth + 1)
    elif depth < _DEEPEST:
        for name, value in _named(message):
            yield from _flat(value, f"{prefix}{name}.", depth + 1)


def _named(message: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(message, dict):
        yield from message.items()
    elif is_dataclass(message):
        for field in fields(message):
            if not field.name.isupper() and field.name != "__msgtype__":
                yield field.name, getattr(message, field.name)


def _ros(path: Path, where: str, topics: Collection[str]) -> Iterator[_Message]:
    """Messages of a ROS 1 bag, or of a ROS 2 folder or database."""
    try:
        from rosbags.rosbag1 import Reader as BagReader
        from rosbags.rosbag2 import Reader as FolderReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise missing_library(where, "rosbags") from None
    first = path.suffix.lower() == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.LATEST)
    with ExitStack() as stack:
        place, unpacked = stack.enter_context(_unpacked(path, where))
        bag = stack.enter_context((BagReader if first else FolderReader)(place))
        if first:
            bag.chunks = {place: _bounded(chunk, where) for place, chunk in bag.chunks.items()}
        chosen = []
        for connection in bag.connections:
            kind = connection.msgtype
            if (connection.topic in topics) if topics else kind.rpartition("/")[2] not in _NO_POSES:
                definition = connection.msgdef.data
                if kind not in store.types and definition:
                    try:
                        _define(store, definition, kind)
                    except Exception:  # a definition that rosbags cannot read
                        continue
                if kind in store.types:
                    chosen.append(connection)
        read = store.deserialize_ros1 if first else store.deserialize_cdr
        if not chosen:
            return
        for connection, received, raw in bag.messages(chosen):
            yield connection.topic, 1e-9 * received, read(unpacked(raw), connection.msgtype)


def _define(store: Any, definition: str, kind: str) -> None:
    """Add a kind of message, and the kinds in it, to a store of types."""
    from rosbags.typesys import get_types_from_msg

    types = get_types_from_msg(definition, kind)
    store.register({name: value for name, value in types.items() if name not in store.types})


@contextmanager
def _unpacked(path: Path, where: str) -> Iterator[tuple[Path, Callable[[bytes], bytes]]]:
    """A ROS 2 bag, with zstd compression removed where whole files have it, and a function that unpacks its
    messages; rosbags would unpack without a bound."""
    mode = ""
    about: dict[str, Any] = {}
    if path.is_dir():
        _, about = parsing.read_yaml(path / "metadata.yaml", f"{where}, metadata.yaml")
        mode = str(about["rosbag2_bagfile_information"].get("compression_mode", "")).lower()
    if mode in ("", "none", "storage"):
        yield path, bytes
        return
    from rosbags.rosbag2.reader import zstd

    def unpacked(raw: bytes) -> bytes:
        stream = zstd.ZstdDecompressor()
        content: bytes = stream.decompress(raw, max_length=_LARGEST_CHUNK)
        if not stream.eof:
            raise DatasetError(
                f"{where}: a message is cut off, or unpacks to more than {_LARGEST_CHUNK} bytes"
            )
        return content

    with TemporaryDirectory() as scratch:
        said, names = about["rosbag2_bagfile_information"], []
        for file in (path / PurePosixPath(name).name for name in said["relative_file_paths"]):
            names.append(file.stem if mode == "file" else file.name)
            if mode == "file":
                _unpack_file(zstd, file, Path(scratch) / names[-1], where)
            else:
                (Path(scratch) / names[-1]).symlink_to(file.resolve())
        said |= {"compression_mode": "", "compression_format": "", "relative_file_paths": names}
        (Path(scratch) / "metadata.yaml").write_text(yaml.safe_dump(about), encoding="utf-8")
        yield Path(scratch), unpacked if mode == "message" else bytes


def _unpack_file(zstd: Any, file: Path, place: Path, where: str) -> None:
    with zstd.open(file, "rb") as packed, open(place, "wb") as whole:
        size = 0
        while part := packed.read(_PART):
            size += len(part)
            if size > LARGEST_FILE:
                raise DatasetError(f"{where}: {file.name} unpacks to more than {LARGEST_FILE} bytes")
            whole.write(part)


def _bounded(chunk: Any, where: str) -> Any:
    """A chunk of a ROS 1 bag with bounded decompression."""
    from rosbags.rosbag1.reader import Compression, decompressors

    def unpacked(stream: Any, content: bytes) -> bytes:
        result = bytes(stream.decompress(content, max_length=_LARGEST_CHUNK))
        if not stream.eof:
            raise DatasetError(
                f"{where}: a chunk is cut short, or unpacks to more than {_LARGEST_CHUNK} bytes"
            )
        return result

    def of_bz2(content: bytes) -> bytes:
        return unpacked(BZ2Decompressor(), content)

    def of_lz4(content: bytes) -> bytes:
        from lz4.frame import LZ4FrameDecompressor

        return unpacked(LZ4FrameDecompressor(), content)

    kinds: dict[Any, Callable[[bytes], bytes]] = {
        decompressors[Compression.BZ2.value]: of_bz2,
        decompressors[Compression.LZ4.value]: of_lz4,
    }
    return chunk._replace(decompressor=kinds.get(chunk.decompressor, chunk.decompressor))


def _mcap(path: Path, where: str, topics: set[str]) -> Iterator[_Message]:
    """Messages of an MCAP file with ROS or JSON schemas."""
    try:
        from mcap.reader import make_reader
    except ImportError:
        raise missing_library(where, "mcap") from None
    decoders: dict[int, Callable[[bytes], Any]] = {}
    with open(path, "rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        for chunk in summary.chunk_indexes if summary else ():
            if chunk.uncompressed_size > _LARGEST_CHUNK:
                raise DatasetError(f"{where}: a chunk unpacks to more than {_LARGEST_CHUNK} bytes")
        known = {channel.topic for channel in summary.channels.values()} if summary else set()
        if topics and summary and not topics & known:
            listed = ", ".join(sorted(known)[:12])
            raise DatasetError(f"{where}: has no messages on {', '.join(sorted(topics))}; topics: {listed}")
        for schema, channel, message in reader.iter_messages(topics=sorted(topics) or None):
            if schema is None or schema.name.rpartition("/")[2].rpartition(".")[2] in _NO_POSES:
                continue
            if schema.id not in decoders:
                decoders[schema.id] = _decoder(schema, channel.message_encoding, where)
            yield channel.topic, 1e-9 * message.log_time, decoders[schema.id](message.data)


def _decoder(schema: Any, encoding: str, where: str) -> Callable[[bytes], Any]:
    if encoding == "json":
        return json.loads
    if encoding in ("cdr", "ros1"):
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.LATEST if encoding == "cdr" else Stores.ROS1_NOETIC)
        _define(store, schema.data.decode(), schema.name)
        name = schema.name if schema.name in store.types else schema.name.replace("/", "/msg/", 1)
        read = store.deserialize_cdr if encoding == "cdr" else store.deserialize_ros1
        return lambda data: read(data, name)
    raise DatasetError(
        f"{where}: messages of {parsing.shown(schema.name)} are encoded as {parsing.shown(encoding)}; slipmap"
        " reads JSON and ROS messages"
    )
