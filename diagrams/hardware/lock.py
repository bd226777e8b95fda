"""One controller for each arm: whoever drives it holds a lock by the address at which it listens."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shlex
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from diagrams.console import BadInput
from diagrams.outputs import writing

_held: set[Path] = set()
# By this process: to the system its own locks are not in its way, and closing such a file frees the lock.


@contextmanager
def only_controller(url: str) -> Iterator[None]:
    """Hold the lock of the arm at an address until the block ends.

    The system lets go of it when the process ends, however it ends: a lock of a dead process is free.

    Args:
        url: LCM address; how it is written counts.

    Raises:
        BadInput: another process has it; names that process. Or the lock's folder cannot be written to.
    """
    path = lock_folder() / f"{hashlib.sha256(url.encode()).hexdigest()[:16]}.lock"
    if path in _held:
        raise _taken(url, f"this process ({os.getpid()})")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        file = open(path, "a+", encoding="utf-8")  # noqa: SIM115
    with file:
        if not _locked(file):
            raise _taken(url, _holder(file))
        _held.add(path)
        try:
            with writing(path):
                _sign(file)
            yield
        finally:
            _held.discard(path)


def _taken(url: str, holder: str) -> BadInput:
    return BadInput(
        f"{url}: {holder} drives the arm there; end it first, or choose another address with --lcm"
    )


def lock_folder() -> Path:
    """Where this user's locks are."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and Path(runtime).is_dir():
        return Path(runtime) / "slipmap"
    return Path(tempfile.gettempdir()) / f"slipmap-{os.getuid()}"


def _locked(file: IO[str]) -> bool:
    # A record lock, unlike flock, does not pass on to worker processes that might live longer.
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _sign(file: IO[str]) -> None:
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    file.seek(0)
    file.truncate()
    json.dump({"process": os.getpid(), "command": command, "since": time.strftime("%H:%M:%S")}, file)
    file.flush()


def _holder(file: IO[str]) -> str:
    file.seek(0)
    try:
        told = json.load(file)
        return f"process {told['process']} ({told['command']}, since {told['since']})"
    except (ValueError, KeyError, TypeError):  # it has only just got it
        return "another process"
