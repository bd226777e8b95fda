"""Files that the commands write: each appears whole or not at all."""

from __future__ import annotations

import errno
import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slipmap.diagrams.application.terminal import BadInput

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SHARED_NAME = 40
"""Characters that the temporary name of a file has from its own, which may be as long as a name can be."""


def check_file(path: Path, endings: Sequence[str] = ()) -> None:
    """Refuse, before any work is done, an output that could not be written after it.

    Raises:
        BadInput: another ending, a missing or unwritable folder, or a folder or a device in the file's place.
    """
    if path.is_dir():
        raise BadInput(f"cannot write {path}: that is a folder; name a file in it")
    if endings and path.suffix.lower().lstrip(".") not in endings:
        wanted = " or ".join(f".{ending}" for ending in endings)
        raise BadInput(f"cannot write {path}: its name must end in {wanted}")
    if path.exists() and not path.is_file():
        raise BadInput(f"cannot write {path}: that is a device or a pipe; name a file and read that")
    check_folder(path.parent, path)


def check_folder(folder: Path, path: Path) -> None:
    """Refuse a folder in which `path` could not be written.

    Raises:
        BadInput: it does not exist or cannot be written to.
    """
    if not folder.is_dir():
        raise BadInput(
            f"cannot write {path}: the folder {folder} does not exist; make it first or choose another"
        )
    with writing(path), tempfile.TemporaryFile(dir=folder):
        pass


def make_folder(folder: Path) -> None:
    """Make a folder for results, its parents included. Those that the command leaves empty go when it ends.

    Raises:
        BadInput: a file is in the way, or the place cannot be written to.
    """
    made = [place for place in (folder, *folder.parents) if not place.exists()]
    for place in (folder, *folder.parents):
        if place.exists() and not place.is_dir():
            raise BadInput(f"cannot make the folder {folder}: {place} is a file; name another folder")
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    command = click.get_current_context(silent=True)
    if command is not None:
        command.call_on_close(lambda: _remove_empty(made))
    check_folder(folder, folder)


def _remove_empty(folders: Sequence[Path]) -> None:
    with suppress(OSError):  # the first that holds something, and its parents, stay
        for folder in folders:
            folder.rmdir()


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary name beside `path`, renamed to it when the block ends well and removed when it does not. A
    link stays one: the file that it names is written.

    Raises:
        BadInput: the place cannot be written to.
    """
    file = Path(os.path.realpath(path))
    part = file.with_name(f".{os.getpid()}.{file.name[-SHARED_NAME:]}")
    try:
        with writing(path):
            yield part
            os.replace(part, file)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Tell a failure of the disk or of permissions as bad input that names `path`.

    Raises:
        BadInput: instead of OSError.
    """
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise BadInput(
                f"cannot write {path}: the disk is full; make room or choose another place"
            ) from error
        raise BadInput(f"cannot write {path}: {error.strerror or error}; choose another place") from error


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a JSON document, keys sorted; a number that is not finite becomes null.

    Raises:
        BadInput: the place cannot be written to.
    """
    text = json.dumps(plain(document), indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text.

    Raises:
        BadInput: the place cannot be written to.
    """
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")


def write_figures(path: Path, figures: Sequence[Figure]) -> list[Path]:
    """Write the pages of a picture: the first as `path`, further ones with their number before the ending.

    Raises:
        BadInput: the place cannot be written to.
    """
    from slipmap.diagrams.application.figures import save

    paths = [
        path,
        *(path.with_name(f"{path.stem}.{page}{path.suffix}") for page in range(2, len(figures) + 1)),
    ]
    for place, figure in zip(paths, figures, strict=True):
        with whole_file(place) as part:
            save(figure, part)
    return paths


def plain(value: Any) -> Any:
    """Mappings, lists and numbers as JSON knows them, null for numbers that are not finite."""
    if hasattr(value, "tolist"):  # arrays and numpy's numbers
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
