"""Runs one command line of `slipmap` as a user would, and keeps what it said and left behind.

No module of the project is named here but `PROGRAM`, so that the recordings outlive any move of modules.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import os
import shlex
import signal
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

PROGRAM = "slipmap"
"""The package that `python -m` starts."""

ENVIRONMENT = {"COLUMNS": "80", "LC_ALL": "C.UTF-8", "NO_COLOR": "1", "MPLBACKEND": "agg"}
"""What would change how a result looks; not what it is."""

UNSET = ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE", "SLIPMAP_TRACEBACK", "PAGER")
TEXTS = (".csv", ".md", ".yaml")
"""Endings of text files that are kept as they were written."""


class Said(NamedTuple):
    """What a command did, before anything is masked.

    Attributes:
        code: exit code.
        out: standard output.
        err: standard error.
        wrote: names of the files that were not there before.
        texts: those that are text, by name.
        document: what it wrote with --json.
    """

    code: int
    out: str
    err: str
    wrote: list[str]
    texts: dict[str, str]
    document: Any


def main_of_program() -> None:
    """Start the program with the arguments in `sys.argv`; it ends with `SystemExit`."""
    importlib.import_module(f"{PROGRAM}.__main__").main()


def run(line: str, folder: Path, environment: Mapping[str, str]) -> Said:
    """Run a command line, without the word `slipmap`, in this process with `folder` as its working folder."""
    words, before = shlex.split(line), _files(folder)
    out, err = _stream(), _stream()
    with _surroundings(words, folder, environment), _streams(out, err):
        code = _exit_code()
    wrote = [name for name in _files(folder) if name not in before]
    texts = {name: (folder / name).read_text(encoding="utf-8") for name in wrote if name.endswith(TEXTS)}
    document = None
    if code == 0 and "--json" in words:
        document = json.loads((folder / words[words.index("--json") + 1]).read_text(encoding="utf-8"))
    return Said(code, _text(out), _text(err), wrote, texts, document)


def _exit_code() -> int:
    try:
        main_of_program()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    return 0


@contextlib.contextmanager
def _surroundings(words: list[str], folder: Path, environment: Mapping[str, str]) -> Iterator[None]:
    """Arguments, working folder, environment and signals as a process of its own would have them."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    with (
        mock.patch.object(sys, "argv", ["slipmap", *words]),
        mock.patch.object(sys, "stdin", io.StringIO()),
        mock.patch.dict(os.environ, {**ENVIRONMENT, **environment}),
        contextlib.chdir(folder),
    ):
        for name in UNSET:
            os.environ.pop(name, None)
        try:
            yield
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)


@contextlib.contextmanager
def _streams(out: io.TextIOWrapper, err: io.TextIOWrapper) -> Iterator[None]:
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        yield


def _stream() -> io.TextIOWrapper:
    """A stream that is no terminal."""
    return io.TextIOWrapper(io.BytesIO(), encoding="utf-8", newline="", write_through=True)


def _text(stream: io.TextIOWrapper) -> str:
    buffer = stream.buffer
    assert isinstance(buffer, io.BytesIO)
    return buffer.getvalue().decode("utf-8")


def _files(folder: Path) -> list[str]:
    found = (path for path in folder.rglob("*") if path.is_file())
    return sorted(path.relative_to(folder).as_posix() for path in found if "__pycache__" not in path.parts)
