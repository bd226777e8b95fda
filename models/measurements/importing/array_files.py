"""Read tables from array files: MATLAB, HDF5, zarr and parquet (LeRobot).

Nothing in them is executed: objects that need pickles are refused, links that lead out of a file or folder
are not followed, and nothing that would unpack to more than `MOST_NUMBERS` numbers is unpacked.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from slipmap.models.measurements import parsing
from slipmap.models.measurements.importing.source import (
    MOST_NUMBERS,
    Column,
    Source,
    check_size,
    missing_library,
    tables_of_arrays,
)
from slipmap.models.measurements.trial import DatasetError
from slipmap.models.physics.cell_grid import FloatArray

_DEEPEST = 16  # folders inside a file
_MOST_ARRAYS = 4096
_Items = Iterable[tuple[str, Any]]  # of a group, by name


def _leaves(
    items: _Items, inside: Callable[[Any], _Items | None], prefix: str = "", depth: int = 0
) -> Iterator[tuple[str, Any]]:
    """Items of nested groups by path; `inside` gives a group's own items, None for what is no group."""
    for name, item in items:
        own = inside(item)
        if own is None:
            yield f"{prefix}{name}", item
        elif depth < _DEEPEST:
            yield from _leaves(own, inside, f"{prefix}{name}/", depth + 1)


def _of_numbers(item: Any) -> bool:
    """Whether a library's array holds numbers, in one or two dimensions."""
    return item.dtype.kind in "fiub" and 1 <= item.ndim <= 2


def read_hdf5(path: Path, where: str) -> list[Source]:
    """Tables of an HDF5 file, named after the paths inside it, without links. Raises DatasetError."""
    import h5py

    def inside(item: Any) -> _Items | None:
        if not isinstance(item, h5py.Group):
            return None
        return (
            (name, item[name]) for name in item if isinstance(item.get(name, getlink=True), h5py.HardLink)
        )

    check_size(path, where)
    found: dict[str, FloatArray] = {}
    with parsing.reading(where, "HDF5"), h5py.File(path, "r") as file:
        for name, item in _leaves(inside(file) or (), inside):
            if not isinstance(item, h5py.Dataset) or item.is_virtual or item.external:
                continue
            if item.dtype.names and 1 <= item.ndim <= 2:
                _refuse_size(item.size or 0, f"{where}, {name}")
                values = item[...]
                fields = [field for field in item.dtype.names if item.dtype[field].kind in "fiub"]
                found |= {f"{name}/{field}": _array(values[field]) for field in fields}
            elif _of_numbers(item):
                _refuse_size(item.size or 0, f"{where}, {name}")
                found[name] = _array(item[...])
    return _tables(where, found, "HDF5")


def read_matlab(path: Path, where: str) -> list[Source]:
    """Tables of a MATLAB file: variables, and fields of structures as `name/field`. Raises DatasetError."""
    check_size(path, where)
    with open(path, "rb") as file:
        head = file.read(128)
    if b"MATLAB 7.3" in head or head.startswith(b"\x89HDF"):
        return read_hdf5(path, where)
    from scipy.io import loadmat

    _refuse_exploding_matlab(path, where)
    # scipy's reader can raise anything on broken bytes
    with parsing.reading(where, "MATLAB", (Exception,)):
        variables = loadmat(path, simplify_cells=True).items()
        own = [(name, value) for name, value in variables if not name.startswith("__")]
        leaves = _leaves(own, lambda value: value.items() if isinstance(value, dict) else None)
        found = {
            name: _array(value)
            for name, value in leaves
            if isinstance(value, np.ndarray) and _of_numbers(value)
        }
    return _tables(where, found, "MATLAB")


def _refuse_exploding_matlab(path: Path, where: str) -> None:
    """Refuse a version 5 file whose compressed variables unpack to more than the limit."""
    unpacked, content = 0, path.read_bytes()
    order = "little" if content[126:128] == b"IM" else "big"
    place = 128
    while place + 8 <= len(content):
        kind = int.from_bytes(content[place : place + 4], order)  # type: ignore[arg-type]
        size = int.from_bytes(content[place + 4 : place + 8], order)  # type: ignore[arg-type]
        if kind == 15:  # miCOMPRESSED
            stream, rest = zlib.decompressobj(), content[place + 8 : place + 8 + size]
            with parsing.reading(where, "MATLAB", (zlib.error,)):
                while rest and unpacked <= 8 * MOST_NUMBERS:
                    unpacked += len(stream.decompress(rest, 2**20))
                    rest = stream.unconsumed_tail
            _refuse_size(unpacked // 8, where)
        place += 8 + size


def read_zarr(path: Path, where: str) -> list[Source]:
    """Tables of a zarr folder, named after the paths inside it. Raises DatasetError."""
    try:
        import zarr
    except ImportError:
        raise missing_library(where, "zarr") from None
    root = path.resolve()
    for file in path.rglob("*"):
        if not file.resolve().is_relative_to(root):
            raise DatasetError(f"{where}: {file.relative_to(path)} is a link that leads out of the folder")
        if file.name in (".zarray", ".zmetadata", "zarr.json"):
            said = parsing.parse_json(parsing.read_bytes(file), f"{where}, {file.relative_to(path)}")
            if "pickle" in json.dumps(said, ensure_ascii=True):
                raise DatasetError(f"{where}: contains pickles, which can run code; write plain arrays")
    found: dict[str, FloatArray] = {}
    # any library that unpacks chunks can raise its own
    with parsing.reading(where, "zarr", (Exception,)):
        groups = zarr.open_group(str(path), mode="r").members()
        for name, item in _leaves(
            groups, lambda item: item.members() if isinstance(item, zarr.Group) else None
        ):
            if _of_numbers(item):
                _refuse_size(math.prod(item.shape), f"{where}, {name}")
                found[name] = _array(item[...])
    return _tables(where, found, "zarr")


def read_parquet(path: Path, where: str) -> list[Source]:
    """The table of a parquet file; lists in cells become columns `name.0` and so on. Raises DatasetError.

    In LeRobot files `timestamp` is the time, and `episode_index` numbers the pushes.
    """
    try:
        from pyarrow import ArrowException, parquet, types
    except ImportError:
        raise missing_library(where, "pyarrow") from None
    check_size(path, where)
    columns: dict[str, Column] = {}
    with parsing.reading(where, "parquet", (ArrowException, *parsing.BROKEN)):
        file = parquet.ParquetFile(path)
        rows = file.metadata.num_rows
        _refuse_size(rows * file.metadata.num_columns, where)
        for name in file.schema_arrow.names:
            kind = file.schema_arrow.field(name).type
            lists = types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)
            of = kind.value_type if lists else kind
            if not (types.is_integer(of) or types.is_floating(of) or types.is_boolean(of)):
                continue
            cells = file.read(columns=[name]).column(name).combine_chunks()
            if lists:
                values = np.asarray(cells.flatten().to_numpy(zero_copy_only=False), dtype=float)
                width = len(values) // rows if rows else 0
                if cells.null_count or width * rows != len(values):
                    continue  # lists of different lengths are not columns
                for number in range(width):
                    columns[f"{name}.{number}"] = values.reshape(rows, width)[:, number]
            else:
                columns[name] = np.asarray(cells.to_numpy(zero_copy_only=False), dtype=float)
    if not columns:
        raise DatasetError(f"{where}: contains no columns of numbers")
    time = columns.get("timestamp")
    push = "episode_index" if "episode_index" in columns else ""
    return [Source(where, "", columns, None if time is None else np.asarray(time, dtype=float), push=push)]


def _array(values: Any) -> FloatArray:
    """Numbers (T,) or (T, c) with time along the longer side as rows."""
    array = np.asarray(values, dtype=float)
    if array.ndim == 2 and array.shape[0] < array.shape[1]:
        array = array.T
    return np.ascontiguousarray(array)


def _tables(where: str, found: Mapping[str, FloatArray], kind: str) -> list[Source]:
    arrays = {name: values for name, values in found.items() if values.size}
    if not arrays:
        raise DatasetError(f"{where}: contains no arrays of numbers that slipmap can read as {kind}")
    if len(arrays) > _MOST_ARRAYS:
        raise DatasetError(f"{where}: contains {len(arrays)} arrays, but at most {_MOST_ARRAYS} are read")
    return tables_of_arrays(where, arrays)


def _refuse_size(numbers: int, where: str) -> None:
    if numbers > MOST_NUMBERS:
        raise DatasetError(f"{where}: has {numbers} numbers, but at most {MOST_NUMBERS} are read")
