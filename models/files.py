"""Files: input is bounded in size; output appears whole or not at all."""

import errno
import fcntl
import hashlib
import json
import math
import os
import platform
import shutil
import signal
import threading
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

PART = f".slipmap.{zlib.crc32(platform.node().encode(errors='replace')):08x}."
"""How temporary names begin on this host; the number of their process follows.

Hosts that share a folder leave each other's files alone. Containers that share a host name must not share a
folder: each takes the others' processes for dead.
"""

_WAITING: ContextVar[dict[Path, Path] | None] = ContextVar("files that appear together", default=None)
"""Final file or folder: its temporary name."""


class BadInput(Exception):
    """An error that the user can fix. Its text is one paragraph: what is wrong, and what to do."""


class UnreadableFile(ValueError):
    """A file that cannot be read. The text says why and what to do; the caller names the file."""


def check_file(path: Path, largest: int) -> None:
    """Refuse anything but a regular file of at most `largest` bytes.

    Raises:
        UnreadableFile: missing, a folder, a device or a pipe, too large, or not accessible.
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
    """Content of a regular file of at most `largest` bytes. Raises UnreadableFile as `check_file` does."""
    check_file(path, largest)
    try:
        with open(path, "rb") as file:
            content = file.read(largest + 1)  # files in /proc hold more than their size says
    except OSError as error:
        raise _unreadable(error) from error
    if len(content) > largest:
        raise _too_large(len(content), largest)
    return content


def check_archive(path: Path, largest: int) -> None:
    """Refuse a zip archive, such as NumPy's, of more than `largest` bytes, packed or unpacked.

    Raises:
        UnreadableFile: as `check_file`.
        zipfile.BadZipFile: it is no zip archive.
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


def part_of(file: Path, number: str = "") -> Path:
    """A temporary name beside a file or folder, whose own name can be as long as the disk allows."""
    return file.with_name(f"{PART}{os.getpid()}.{number}{file.name[-40:]}")


def _sweep(folder: Path) -> None:
    """Remove temporary files and folders that killed processes of this host left, as far as permitted."""
    for part in folder.glob(f"{PART}*"):
        process = part.name.removeprefix(PART).partition(".")[0]
        if process.isdecimal() and not _runs(int(process)):
            remove_part(part)


def remove_part(part: Path) -> None:
    """Remove a temporary file or folder, even at Ctrl-C; one that may not be removed stays."""
    with undisturbed(), suppress(OSError):
        if part.is_dir():
            shutil.rmtree(part, ignore_errors=True)
        else:
            part.unlink()


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True


@contextmanager
def replaced_file(path: Path, part: Path | None = None) -> Iterator[Path]:
    """Yield a temporary name, renamed to `path` if the block succeeds, removed if not; links are followed.

    Args:
        part: the temporary name, from `part_of`, on the same disk; by default beside the file.

    Raises:
        OSError: the path cannot be written.
    """
    file = Path(os.path.realpath(path))
    part = part or part_of(file)
    _sweep(part.parent)
    try:
        yield part
        os.replace(part, file)
    finally:
        remove_part(part)


@contextmanager
def replaced_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary name for a folder that the block makes; if it succeeds, replace the folder at `path`.

    In `all_or_nothing` the folder appears with the files.

    Raises:
        OSError: the path cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _sweep(path.parent)
    fresh, waiting = part_of(path, f"{threading.get_ident()}.new."), _WAITING.get()
    try:
        yield fresh
        if waiting is None:
            with _in_turn(), undisturbed():
                _rename(fresh, path)
        else:
            waiting[path] = fresh
    except BaseException:
        remove_part(fresh)
        raise


def write_checked(path: Path, data: bytes) -> None:
    """Write a file for `read_checked`. Its first line is a hash of the rest, and a comment to Python.

    Raises:
        OSError: the path cannot be written.
    """
    with replaced_file(path) as part:
        part.write_bytes(_hash_line(data) + data)


def read_checked(path: Path) -> bytes | None:
    """What `write_checked` wrote, or None if there is nothing, or nothing whole."""
    try:
        line, _, data = path.read_bytes().partition(b"\n")
    except OSError:
        return None
    return data if line + b"\n" == _hash_line(data) else None


def _hash_line(data: bytes) -> bytes:
    return f"# {hashlib.sha256(data).hexdigest()}\n".encode()


def _rename(part: Path, final: Path) -> None:
    """Give a temporary file or folder its final name, in place of what has that name."""
    if not (part.is_dir() and final.exists()):
        os.replace(part, final)
        return
    old = part_of(final, f"{threading.get_ident()}.old.")
    os.replace(final, old)
    try:
        os.replace(part, final)
    except OSError:
        os.replace(old, final)
        raise
    remove_part(old)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Like `replaced_file`, for a path from the user; in `all_or_nothing` the file appears with the others.

    Raises:
        BadInput: the path cannot be written.
    """
    waiting = _WAITING.get()
    if waiting is None:
        with writing(path), replaced_file(path) as part:
            yield part
        return
    file = Path(os.path.realpath(path))
    part = waiting.setdefault(file, part_of(file, f"{len(waiting)}."))
    with writing(path):
        _sweep(file.parent)
        yield part


@contextmanager
def all_or_nothing() -> Iterator[None]:
    """Make all that the block writes with `whole_file` and `replaced_folder` appear at once, or nothing if it
    fails.

    Where two processes write files of the same names, all are of the one that ends last.

    Raises:
        BadInput: a path cannot be written.
    """
    waiting: dict[Path, Path] = {}
    token = _WAITING.set(waiting)
    try:
        yield
        with _in_turn(), undisturbed():
            for file, part in waiting.items():
                with writing(file):
                    _rename(part, file)
    finally:
        _WAITING.reset(token)
        with undisturbed():
            for part in waiting.values():
                remove_part(part)


@contextmanager
def _in_turn() -> Iterator[None]:
    """Wait until no other process of this installation renames its results, so that they are not mixed."""
    own = os.open(__file__, os.O_RDONLY)
    try:
        with suppress(OSError):  # on some network disks
            fcntl.flock(own, fcntl.LOCK_EX)
        yield
    finally:
        os.close(own)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Hold back termination signals until the block ends, however it ends; Python receives them only in its
    main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, frame: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) not in (signal.SIG_IGN, signal.SIG_DFL, None)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Report a disk or permission error as bad input that names `path`.

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


def write_json(path: Path | None, document: Mapping[str, Any]) -> None:
    """Write a JSON document if `path` is given; keys are sorted, numbers that are not finite become null."""
    if path is None:
        return
    text = json.dumps(plain(document), indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file.

    Raises:
        BadInput: the path cannot be written.
    """
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")


def plain(value: Any) -> Any:
    """The value in JSON's types: of a record its `to_json` or fields, of numbers that are not finite null."""
    if hasattr(value, "to_json"):
        value = value.to_json()
    elif is_dataclass(value):
        value = vars(value)
    elif hasattr(value, "tolist"):  # NumPy arrays and scalars
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
