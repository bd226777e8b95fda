"""Bytes, JSON and YAML from disk: bounded in size, never executed, and every failure a DatasetError."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from slipmap.models.files import UnreadableFile, read_bounded
from slipmap.models.measurements.fields import shown
from slipmap.models.measurements.push_dataset import DatasetError

LARGEST_RECORD = 64 * 2**20  # bytes; ten minutes of three channels at 250 Hz are 30 MB
LARGEST_YAML = 4 * 2**20  # bytes; 50,000 cells are 1.5 MB

DEEPEST_YAML = 50
LONGEST_NAME = 250  # characters of a path that an error text has in full

_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _PlainLoader(_Loader):
    """Safe loader without merge keys, which can grow without bound, and without repeated keys."""

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        for key, _ in node.value:
            if key.tag == "tag:yaml.org,2002:merge":
                raise yaml.constructor.ConstructorError(problem="merge keys (<<) are not part of the format")
        super().flatten_mapping(node)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        names: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in names:
                    line = key.start_mark.line + 1
                    raise yaml.constructor.ConstructorError(
                        problem=f"the key {shown(key.value)} stands there twice, again in line {line}"
                    )
                names.add(key.value)
        return super().construct_mapping(node, deep)


def read_bytes(path: Path, largest: int = LARGEST_RECORD) -> bytes:
    """The content of a regular file.

    Raises:
        DatasetError: missing, not a file, unreadable, or larger than `largest` bytes.
    """
    try:
        return read_bounded(path, largest)
    except UnreadableFile as error:
        where = str(path)
        whole = where.isprintable() and len(where) < LONGEST_NAME
        raise DatasetError(f"{where if whole else shown(where)}: {error}") from None


def parse_json(content: bytes, where: str) -> Any:
    """A JSON document; NaN is allowed, a key that stands twice is not.

    Raises:
        DatasetError: with the line and column of the fault.
    """
    try:
        return json.loads(content, object_pairs_hook=_unrepeated)
    except RecursionError:
        raise DatasetError(f"{where}: nested too deeply to be a list of rows") from None
    except ValueError as error:
        raise DatasetError(
            f"{where}: not valid JSON ({shown_error(error)}); was the file cut short?"
        ) from None


def parse_yaml(content: bytes, where: str) -> Any:
    """A YAML document of plain data.

    Raises:
        DatasetError: with the line and column of the fault.
    """
    try:
        if _depth(content) > DEEPEST_YAML:
            raise DatasetError(f"{where}: nested too deeply for a description of a dataset")
        return yaml.load(content, Loader=_PlainLoader)
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, LookupError, OverflowError) as error:
        raise DatasetError(f"{where}: not valid YAML ({shown_error(error)})") from None


def _depth(content: bytes) -> int:
    """How deeply a YAML document is nested, up to one more than may be. The compiled loader would crash."""
    depth = 0
    try:
        for event in yaml.parse(content, Loader=_Loader):
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
                if depth > DEEPEST_YAML:
                    break
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
    except yaml.MarkedYAMLError as error:
        # libyaml from 0.2.6 on has a limit of its own, far above ours, and meets it while it looks ahead.
        if "nesting depth" in (error.problem or ""):
            return DEEPEST_YAML + 1
        raise
    return depth


def shown_error(error: Exception) -> str:
    """The message of a library's exception on one line of bounded length; the file is named elsewhere."""
    message = " ".join(str(error).replace('in "<byte string>", ', "").split())
    return message if len(message) <= 200 else message[:197] + "..."


class Fingerprint:
    """sha256 over named contents in the order in which they are added."""

    def __init__(self) -> None:
        self._digest = hashlib.sha256()

    def add(self, name: str, content: bytes) -> None:
        """Add a file under a name that does not depend on where the dataset lies."""
        encoded = name.encode("utf-8", "surrogatepass")
        self._digest.update(f"{len(encoded)} {len(content)} ".encode() + encoded)
        self._digest.update(content)

    def hexdigest(self) -> str:
        """The fingerprint so far, 64 hexadecimal digits."""
        return self._digest.hexdigest()


def _unrepeated(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        name, _ = Counter(name for name, _ in pairs).most_common(1)[0]
        raise ValueError(f"the key {shown(name)} stands there twice")
    return result
