"""Files: what users hand in is bounded in size; what is written appears whole or not at all."""

import errno
import json
import math
import os
import signal
import tempfile
import threading
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

_WAITING: ContextVar[dict[Path, Path] | None] = ContextVar("files that appear together", default=None)
"""Temporary names by the files that they become."""


class BadInput(Exception):
    """Something that the user can mend. Its text is one paragraph: what is wrong, and what to do."""


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
    """The content of a regular file of at most `largest` bytes. Raises UnreadableFile as `check_file`."""
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


@contextmanager
def replaced_file(path: Path, part: Path | None = None) -> Iterator[Path]:
    """A temporary name, renamed to `path` when the block ends well and removed when it does not. A link stays
    one: the file that it names is written.

    Args:
        part: the temporary name, on the same disk; beside the file unless given.

    Raises:
        OSError: the place cannot be written to.
    """
    file = Path(os.path.realpath(path))
    if part is None:
        part = file.with_name(f".{os.getpid()}.{file.name[-40:]}")  # names can be as long as the disk allows
    try:
        yield part
        os.replace(part, file)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def replaced_folder(path: Path) -> Iterator[Path]:
    """A temporary name for a folder that the block makes. When it ends well, the new folder takes the place
    of the one at `path`, which is gone then; else that one stays.

    Raises:
        OSError: the place cannot be written to.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as scratch:
        fresh, old = Path(scratch) / "new", Path(scratch) / "old"
        yield fresh
        if path.exists():
            os.replace(path, old)
        try:
            os.replace(fresh, path)
        except OSError:
            if old.exists():
                os.replace(old, path)
            raise


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """As `replaced_file`, for a place that a user named; inside `together` it appears with the others.

    Raises:
        BadInput: the place cannot be written to.
    """
    waiting = _WAITING.get()
    if waiting is None:
        with writing(path), replaced_file(path) as part:
            yield part
        return
    file = Path(os.path.realpath(path))
    part = waiting.setdefault(file, file.with_name(f".{os.getpid()}.{len(waiting)}.{file.name[-40:]}"))
    with writing(path):
        yield part


@contextmanager
def together() -> Iterator[None]:
    """What the block writes as `whole_file` appears when it ends well, all at once, or not at all; signals
    to end wait until all of it is there.

    Raises:
        BadInput: a place cannot be written to.
        KeyboardInterrupt: a signal came meanwhile.
    """
    waiting: dict[Path, Path] = {}
    token = _WAITING.set(waiting)
    try:
        yield
        with _undisturbed():
            for file, part in waiting.items():
                with writing(file):
                    os.replace(part, file)
    finally:
        _WAITING.reset(token)
        for part in waiting.values():
            part.unlink(missing_ok=True)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Keep signals to end until the block is over; Python hears them in its main thread alone."""
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
        raise KeyboardInterrupt


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


def write_json(path: Path | None, document: Mapping[str, Any]) -> None:
    """Write a JSON document as `write_text`, if there is a path; keys sorted, numbers not finite as null."""
    if path is None:
        return
    text = json.dumps(plain(document), indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text.

    Raises:
        BadInput: the place cannot be written to.
    """
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")


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
