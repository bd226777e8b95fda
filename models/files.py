"""Files that users hand in, read whole and bounded in size."""

from __future__ import annotations

import errno
import zipfile
from pathlib import Path


class UnreadableFile(ValueError):
    """A file that cannot be read. The text says why and what to do; who asked names the file."""


def check_file(path: Path, largest: int) -> None:
    """Refuse what is no file, or one larger than `largest` bytes.

    Raises:
        UnreadableFile: missing, a folder, a device or a pipe, too large, or not to be looked at.
    """
    try:
        if path.is_dir():
            raise UnreadableFile("is a folder; name a file in it")
        if not path.is_file():
            if path.exists():
                raise UnreadableFile("is a device or a pipe; give a file")
            raise UnreadableFile("there is no such file; check the name")
        size = path.stat().st_size
    except (OSError, ValueError) as error:
        if isinstance(error, UnreadableFile):
            raise
        raise _unreadable(error) from error
    if size > largest:
        raise _too_large(size, largest)


def read_bounded(path: Path, largest: int) -> bytes:
    """The content of a regular file of at most `largest` bytes.

    Raises:
        UnreadableFile: as `check_file`.
    """
    check_file(path, largest)
    try:
        with open(path, "rb") as file:
            content = file.read(largest + 1)  # files of /proc have more than they say
    except OSError as error:
        raise _unreadable(error) from error
    if len(content) > largest:
        raise _too_large(len(content), largest)
    return content


def check_archive(path: Path, largest: int) -> None:
    """Refuse an archive, such as of numpy, that is larger than `largest` bytes, packed or not.

    Raises:
        UnreadableFile: as `check_file`.
        zipfile.BadZipFile: it is none.
    """
    check_file(path, largest)
    with zipfile.ZipFile(path) as archive:
        unpacked = sum(entry.file_size for entry in archive.infolist())
    if unpacked > largest:
        raise _too_large(unpacked, largest)


def _unreadable(error: OSError | ValueError) -> UnreadableFile:
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        return UnreadableFile("cannot be read: its name is too long for this disk; choose a shorter one")
    return UnreadableFile(f"cannot be read ({getattr(error, 'strerror', None) or error})")


def _too_large(size: int, largest: int) -> UnreadableFile:
    unit, name = (2**20, "MiB") if largest >= 2**20 else (2**10, "KiB")
    return UnreadableFile(f"{size / unit:.0f} {name}, more than the {largest / unit:.0f} {name} it may have")
