"""Read tables from array files: MATLAB, HDF5, zarr and parquet (LeRobot).

Nothing in them is executed: objects that need pickles are refused, links that lead out of a file or folder
are not followed, and nothing that would unpack to more than `MOST_NUMBERS` numbers is unpacked.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Iterator, Mapping
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
from slipmap.models.measurements.push_dataset import DatasetError
from slipmap.models.physics.cell_grid import FloatArray

_DEEPEST = 16  # folders inside a file
_MOST_ARRAYS = 4096
_BROKEN = (
    OSError, RuntimeError, ValueError, TypeError, LookupError, MemoryError, AttributeError, ArithmeticError,
    zlib.error,
)  # fmt: skip
"""Errors that libraries raise on unexpected files."""


def read_hdf5(path: Path, where: str) -> list[Source]:
    """Tables of an HDF5 file, named after the paths inside it. Raises DatasetError."""
    import h5py

    check_size(path, where)
    found: dict[str, FloatArray] = {}
    try:
        with h5py.File(path, "r") as file:
            for name, item in _hdf5_items(file):
                _refuse_size(item.size or 0, f"{where}, {name}")
                if item.dtype.names:
                    fields = [field for field in item.dtype.names if item.dtype[field].kind in "fiub"]
                    values = item[...]
                    found |= {f"{name}/{field}": _array(values[field]) for field in fields}
                else:
                    found[name] = _array(item[...])
    except DatasetError:
        raise
    except _BROKEN as error:
        raise _unreadable(where, "HDF5", error) from None
    return _tables(where, found, "HDF5")


def _hdf5_items(group: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Arrays of numbers in an HDF5 file, without following links."""
    import h5py

    if depth > _DEEPEST:
        return
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item, path = group[name], f"{prefix}{name}"
        if isinstance(item, h5py.Group):
            yield from _hdf5_items(item, f"{path}/", depth + 1)
        elif isinstance(item, h5py.Dataset) and not (item.is_virtual or item.external):
            numbers = item.dtype.kind in "fiub" or bool(item.dtype.names)
            if numbers and 1 <= item.ndim <= 2:
                yield path, item


def read_matlab(path: Path, where: str) -> list[Source]:
    """Tables of a MATLAB file: variables, and fields of structures as `name/field`. Raises DatasetError."""
    check_size(path, where)
    with open(path, "rb") as file:
        head = file.read(128)
    if b"MATLAB 7.3" in head or head.startswith(b"\x89HDF"):
        return read_hdf5(path, where)
    from scipy.io import loadmat

    _refuse_exploding_matlab(path, where)
    try:
        document = loadmat(path, simplify_cells=True)
        found = dict(_matlab_arrays({k: v for k, v in document.items() if not k.startswith("__")}))
    except DatasetError:
        raise
    except Exception as error:  # scipy's reader can raise anything on broken bytes
        raise _unreadable(where, "MATLAB", error) from None
    return _tables(where, found, "MATLAB")


def _matlab_arrays(document: Mapping[str, Any], prefix: str = "", depth: int = 0) -> Iterator[Any]:
    for name, value in document.items():
        if isinstance(value, dict) and depth < _DEEPEST:
            yield from _matlab_arrays(value, f"{prefix}{name}/", depth + 1)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and 1 <= value.ndim <= 2:
            yield f"{prefix}{name}", _array(value)


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
            try:
                while rest and unpacked <= 8 * MOST_NUMBERS:
                    unpacked += len(stream.decompress(rest, 2**20))
                    rest = stream.unconsumed_tail
            except zlib.error as error:
                raise _unreadable(where, "MATLAB", error) from None
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
    try:
        for name, item in _zarr_items(zarr.open_group(str(path), mode="r"), zarr):
            _refuse_size(math.prod(item.shape), f"{where}, {name}")
            found[name] = _array(item[...])
    except DatasetError:
        raise
    except Exception as error:  # any library that unpacks chunks can raise its own
        raise _unreadable(where, "zarr", error) from None
    return _tables(where, found, "zarr")


def _zarr_items(group: Any, zarr: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    for name, item in group.members():
        if isinstance(item, zarr.Group):
            if depth < _DEEPEST:
                yield from _zarr_items(item, zarr, f"{prefix}{name}/", depth + 1)
        elif item.dtype.kind in "fiub" and 1 <= item.ndim <= 2:
            yield f"{prefix}{name}", item


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
    try:
        file = parquet.ParquetFile(path)
        rows = file.metadata.num_rows
        _refuse_size(rows * file.metadata.num_columns, where)
        for name in file.schema_arrow.names:
            kind = file.schema_arrow.field(name).type
            if not _holds_numbers(kind, types):
                continue
            cells = file.read(columns=[name]).column(name).combine_chunks()
            if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
                values = np.asarray(cells.flatten().to_numpy(zero_copy_only=False), dtype=float)
                width = len(values) // rows if rows else 0
                if cells.null_count or width * rows != len(values):
                    continue  # lists of different lengths are not columns
                for number in range(width):
                    columns[f"{name}.{number}"] = values.reshape(rows, width)[:, number]
            else:
                columns[name] = np.asarray(cells.to_numpy(zero_copy_only=False), dtype=float)
    except DatasetError:
        raise
    except (ArrowException, *_BROKEN) as error:
        raise _unreadable(where, "parquet", error) from None
    if not columns:
        raise DatasetError(f"{where}: contains no columns of numbers")
    time = columns.get("timestamp")
    push = "episode_index" if "episode_index" in columns else ""
    return [Source(where, "", columns, None if time is None else np.asarray(time, dtype=float), push=push)]


def _holds_numbers(kind: Any, types: Any) -> bool:
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        kind = kind.value_type
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind))


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


def _unreadable(where: str, kind: str, error: Exception) -> DatasetError:
    return DatasetError(
        f"{where}: not readable as {kind} ({parsing.shown_error(error)}); was the file cut short?"
    )
