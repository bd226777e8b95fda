"""Find files that can be read, and the reader for each kind."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from pathlib import Path, PurePosixPath

from slipmap.models.measurements.importing.array_files import read_hdf5, read_matlab, read_parquet, read_zarr
from slipmap.models.measurements.importing.bags import BAG_ENDINGS, read_bag
from slipmap.models.measurements.importing.source import Reader, Source
from slipmap.models.measurements.importing.text_tables import TEXT_ENDINGS, read_text
from slipmap.models.measurements.parsing import by_numbers
from slipmap.models.measurements.trial import DatasetError

_READERS: dict[str, Reader] = {
    ".mat": read_matlab,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".parquet": read_parquet,
    ".zarr": read_zarr,
    **dict.fromkeys(TEXT_ENDINGS, read_text),
}
_SPREADSHEETS = (".xlsx", ".xls", ".ods")
_PICKLES = (".pkl", ".pickle", ".npy", ".npz", ".pt", ".pth", ".joblib")
_NO_TABLES = ("readme", "license")  # starts of names of texts that are not tables
KINDS = ", ".join(sorted({*_READERS, *BAG_ENDINGS})) + " and folders of ROS 2 bags"


def find_files(sources: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> dict[str, Path]:
    """Files that can be read, in order, by their names for a setup.yaml; in a folder, the path inside it.

    Files of a folder are in the order of their names, in which numbers count by value.

    Raises:
        DatasetError: a missing path, a file of another kind, or a folder without readable files.
    """
    found: dict[str, Path] = {}
    for path in map(Path, [sources] if isinstance(sources, str | os.PathLike) else sources):
        if not path.exists():
            raise DatasetError(f"{str(path)!r}: there is no such file or folder")
        if not path.is_dir() or _is_table(path):
            if not _is_table(path):
                raise DatasetError(f"{path}: this kind of file cannot be read; {_instead(path)}")
            inside = {path.name: path}
        else:
            inside = {
                PurePosixPath(file.relative_to(path)).as_posix(): file
                for file in sorted(path.rglob("*"), key=by_numbers)
                if _is_table(file)
                and not any(_is_table(folder) for folder in file.parents if folder.is_relative_to(path))
                and not any(part.startswith(".") for part in file.relative_to(path).parts)
                and not file.stem.lower().startswith(_NO_TABLES)
            }
            if (path / "meta" / "info.json").is_file():  # LeRobot: tables about the tables
                inside = {name: file for name, file in inside.items() if not name.startswith("meta/")}
            root = path.resolve()
            outside = [name for name, file in inside.items() if not file.resolve().is_relative_to(root)]
            if outside:
                raise DatasetError(f"{path}: {outside[0]} is a link that leads out of the folder")
            if not inside:
                raise DatasetError(f"{path}: contains no files that can be read; expected {KINDS}")
        for name, file in inside.items():
            found[name if name not in found else str(file)] = file
    return found


def _is_table(path: Path) -> bool:
    if path.is_dir():
        return path.suffix.lower() == ".zarr" or (path / "metadata.yaml").is_file()
    return path.suffix.lower() in {*_READERS, *BAG_ENDINGS}


def _instead(path: Path) -> str:
    if path.suffix.lower() in _PICKLES:
        return "such files can run code and are never loaded; write a table as CSV, HDF5 or parquet"
    if path.suffix.lower() in _SPREADSHEETS:
        return "save the sheet as CSV; decimal commas and semicolons are fine"
    return f"there are readers for {KINDS}"


def read_sources(path: Path, where: str, wanted: Collection[str] = ()) -> list[Source]:
    """The tables of a file; for a bag, only the wanted topics if any are named. Raises DatasetError."""
    ending = path.suffix.lower()
    if ending in BAG_ENDINGS or (path.is_dir() and ending != ".zarr"):
        return read_bag(path, where, wanted)
    return _READERS[ending](path, where)
