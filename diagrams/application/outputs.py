"""Output paths, checked before any work is done, and pictures of several pages."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from slipmap.models.files import BadInput, whole_file, writing

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def check_output(path: Path, endings: Sequence[str] = ()) -> None:
    """Refuse, before any work is done, an output that could not be written.

    Raises:
        BadInput: a wrong ending, a missing or unwritable folder, a path that is a folder or a device, or `-`.
    """
    if str(path) == "-":
        raise BadInput("cannot write to standard output, which is for people to read; name a file for -")
    if path.is_dir():
        raise BadInput(f"cannot write {path}: it is a folder; name a file in it")
    if endings and path.suffix.lower().lstrip(".") not in endings:
        wanted = " or ".join(f".{ending}" for ending in endings)
        raise BadInput(f"cannot write {path}: its name must end in {wanted}")
    if path.exists() and not path.is_file():
        raise BadInput(f"cannot write {path}: it is a device or a pipe; name a file instead")
    check_folder(path.parent, path)


def check_folder(folder: Path, path: Path) -> None:
    """Refuse a folder in which `path` could not be written.

    Raises:
        BadInput: it does not exist or cannot be written to.
    """
    if not folder.is_dir():
        raise BadInput(
            f"cannot write {path}: the folder {folder} does not exist; create it or choose another one"
        )
    with writing(path), tempfile.TemporaryFile(dir=folder):
        pass


def make_folder(folder: Path) -> None:
    """Make a folder for results, with its parents. Those that stay empty are removed when the command ends.

    Raises:
        BadInput: a file is in the way, or the folder cannot be written to.
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


def take_folder(folder: Path) -> None:
    """Make a folder for results, and lock it. Raises BadInput as `make_folder` and `lock_folder` do."""
    make_folder(folder)
    lock_folder(folder)


def lock_folder(folder: Path) -> None:
    """Lock a folder for this command until it ends, so that no other command writes a run there.

    Raises:
        BadInput: another command holds the lock.
    """
    with writing(folder):
        place = os.open(folder, os.O_RDONLY)
    command = click.get_current_context(silent=True)
    if command is not None:
        command.call_on_close(lambda: os.close(place))
    try:
        fcntl.flock(place, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise BadInput(
            f"{folder}: another slipmap is writing a run there; wait until it ends, or choose another folder"
        ) from error
    except OSError:
        pass  # some network disks cannot lock a folder


def _remove_empty(folders: Sequence[Path]) -> None:
    with suppress(OSError):  # a folder that is not empty stays, as do its parents
        for folder in folders:
            folder.rmdir()


def write_figures(path: Path, figures: Sequence[Figure]) -> list[Path]:
    """Write the pages of a picture: the first to `path`, further ones with their number before the ending.

    Raises:
        BadInput: a file cannot be written.
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
