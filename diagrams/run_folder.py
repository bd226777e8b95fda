"""Whose pushes a folder of results holds: those of an ended run give way to the same command alone."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from diagrams.console import BadInput
from diagrams.outputs import write_json
from models.measurements import DatasetError, Trial
from models.measurements.files import read_bytes
from models.measurements.writing import trial_text

RUN, PUSHES = "run.json", "pushes"


def read_run(folder: Path, format_: str) -> dict[str, Any]:
    """What `run.json` tells of the run in a folder.

    Raises:
        BadInput: there is none, or that of another command.
    """
    path = folder / RUN
    try:
        run = json.loads(read_bytes(path))
    except DatasetError as error:
        raise BadInput(f"{error}; begin anew") from error
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: cannot be read ({error}); begin anew") from error
    if not isinstance(run, dict) or run.get("format") != format_:
        raise BadInput(f"{path}: is not the file of a run that this slipmap knows ({format_})")
    return run


def refuse_others_files(folder: Path, format_: str, command: str, *files: str) -> None:
    """Refuse a folder in which a run would replace what no earlier run of the same command left.

    Args:
        folder: where results go.
        format_: that `run.json` has after such a run.
        command: such as `slipmap explore`.
        files: beside the pushes, that a run replaces.

    Raises:
        BadInput: names the folder, and `--out`.
    """
    pushes = folder / PUSHES
    present = [pushes] if pushes.is_dir() and any(pushes.iterdir()) else []
    present += [folder / name for name in files if (folder / name).exists()]
    if not present:
        return
    try:
        run = read_run(folder, format_)
    except BadInput:
        run = {}
    if run.get("ended") is not True or not _holds(pushes, run.get("pushes")):
        raise BadInput(
            f"{present[0]}: is not of an earlier run of `{command}` that ended, and would be lost; choose"
            " another folder with --out, or move it away"
        )


def refuse_robots_pushes(folder: Path, option: str) -> None:
    """Refuse a folder with pushes of a robot's cell, which cannot be made again, to a command that has none.

    Args:
        folder: where results go.
        option: that names another.

    Raises:
        BadInput: names both.
    """
    if (folder / RUN).exists() and (folder / PUSHES).exists():
        raise BadInput(
            f"{folder}: holds a run of the robot's cell, whose pushes would be lost; choose another folder"
            f" with {option}"
        )


def write_run(folder: Path, run: dict[str, Any]) -> None:
    """Write `run.json`.

    Raises:
        BadInput: the place cannot be written to.
    """
    write_json(folder / RUN, run)


def digests_of(trials: Sequence[Trial]) -> list[str]:
    """Digests of trials' files, by which `run.json` knows them."""
    return [digest(trial_text(trial).encode()) for trial in trials]


def digest(content: bytes) -> str:
    """As 64 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def digest_of(path: Path) -> str:
    """Digest of a file.

    Raises:
        DatasetError: it cannot be read.
    """
    return digest(read_bytes(path))


def _holds(pushes: Path, told: Any) -> bool:
    """Whether a dataset's trials are those that `run.json` tells of."""
    try:
        expected = sorted(str(push["digest"]) for push in told)
        return sorted(digest_of(path) for path in pushes.rglob("*.json")) in (expected, [])
    except (DatasetError, KeyError, TypeError):
        return False
