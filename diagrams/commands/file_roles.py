"""What a command reads is not what it writes."""

from __future__ import annotations

from collections.abc import Iterator
from functools import wraps
from itertools import combinations
from pathlib import Path
from typing import Any

import click

from diagrams.commands.options import OutputFile

FILES_IN_FOLDERS = ("json_file", "recording")
FOLDERS = ("folder", "output", "pictures")
"""Parameters that are written though their type does not say so."""

MEASURED = (".yaml", ".yml", ".json", ".csv", ".h5", ".hdf5")
"""Endings of files that may be part of a dataset."""


def keep_files_apart(command: click.Command) -> None:
    """Have a command refuse, before any work, to write over what it reads or two results over each other.

    Raises:
        UsageError: when the command is called so.
    """
    work = command.callback
    assert work is not None

    @wraps(work)
    def checked(**arguments: Any) -> Any:
        _check(command, arguments)
        return work(**arguments)

    command.callback = checked


def _check(command: click.Command, arguments: dict[str, Any]) -> None:
    written: list[tuple[str, Path]] = []
    read: list[Path] = []
    for param in command.params:
        for path in _paths(arguments.get(param.name or "")):
            if isinstance(param.type, OutputFile) or param.name in FILES_IN_FOLDERS:
                written.append((param.opts[-1], path))
            elif param.name not in FOLDERS:
                read.append(path)
    for (one, path), (other, same) in combinations(written, 2):
        if path.resolve() == same.resolve():
            raise click.UsageError(f"{one} and {other} both name {path}; give each a file of its own.")
    for option, path in written:
        for source in read:
            if path.resolve() == source.resolve() or _is_part(path, source):
                raise click.UsageError(
                    f"{option} {path} would write over what the command reads; name another file."
                )


def _is_part(path: Path, source: Path) -> bool:
    """Whether an existing file may be one of a dataset's."""
    if not (source.is_dir() and path.is_file() and path.suffix.lower() in MEASURED):
        return False
    return path.resolve().is_relative_to(source.resolve())


def _paths(value: Any) -> Iterator[Path]:
    values = value if isinstance(value, tuple) else (value,)
    return (entry for entry in values if isinstance(entry, Path))
