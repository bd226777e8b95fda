"""Runs the commands of `commands.py` and keeps what they say.

A recording is a JSON file for each command line: exit code, standard output, standard error, and the JSON
that the command wrote. What differs from run to run (times, versions) is masked.
`python -m tests.recorded.recording` records anew.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import re
import shlex
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from slipmap.diagrams.application.command_line import run
from tests.recorded.commands import CASES

FOLDER = Path(__file__).parent / "outputs"

RELATIVE = 1e-5
"""Numbers of a JSON document may differ by this share, as another processor rounds otherwise."""

_TIME = re.compile(r"\b\d+(\.\d+)? (s|min)\b")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
_MASKED_KEYS = {"seconds", "versions", "version"}


def said(arguments: str) -> dict[str, Any]:
    """Exit code, output and JSON of one command line, run in this process and folder."""
    words = shlex.split(arguments)
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run(words)
    result: dict[str, Any] = {
        "arguments": arguments,
        "code": code,
        "out": masked(out.getvalue()),
        "err": [line for line in masked(err.getvalue()).splitlines() if not _is_progress(line)],
    }
    if "--json" in words and code == 0:
        document = json.loads(Path(words[words.index("--json") + 1]).read_text(encoding="utf-8"))
        result["json"] = without(document)
    return result


def _is_progress(line: str) -> bool:
    """Whether a line says how far a stage is: how many there are depends on the machine's pace."""
    return line.endswith("…") or "TIME" in line or line.startswith("Compiling")


def prepare(folder: Path) -> None:
    """Write what the commands read: a mesh of a block, in metres."""
    corners = [(x, y, z) for x in (0, 0.1) for y in (0, 0.06) for z in (0, 0.04)]
    faces = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {face}" for face in faces]
    (folder / "block.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")


def masked(text: str) -> str:
    """A text without times."""
    return _TIME.sub("TIME", text)


def without(document: Any) -> Any:
    """A JSON document without what differs from run to run."""
    if isinstance(document, dict):
        return {key: None if key in _MASKED_KEYS else without(value) for key, value in document.items()}
    return [without(value) for value in document] if isinstance(document, list) else document


def differences(wanted: Any, got: Any, where: str = "") -> Iterator[str]:
    """What differs between two recordings, each a line that names the place."""
    if isinstance(wanted, dict) and isinstance(got, dict):
        for key in sorted({*wanted, *got}):
            if key not in wanted or key not in got:
                yield f"{where}/{key}: {'new' if key not in wanted else 'missing'}"
            else:
                yield from differences(wanted[key], got[key], f"{where}/{key}")
    elif isinstance(wanted, list) and isinstance(got, list):
        if len(wanted) != len(got):
            yield f"{where}: {len(wanted)} entries wanted, got {len(got)}: {wanted!r:.300} and {got!r:.300}"
        for number, (one, other) in enumerate(zip(wanted, got, strict=False)):
            yield from differences(one, other, f"{where}[{number}]")
    elif isinstance(wanted, str) and isinstance(got, str):
        for number, (one, other) in enumerate(zip(wanted.splitlines(), got.splitlines(), strict=False)):
            if not _same_text(one, other):
                yield f"{where}, line {number + 1}: wanted {one!r}, got {other!r}"
        if len(wanted.splitlines()) != len(got.splitlines()):
            yield f"{where}: {len(wanted.splitlines())} lines wanted, got {len(got.splitlines())}"
    elif isinstance(wanted, float) and isinstance(got, float | int):
        if not math.isclose(wanted, got, rel_tol=RELATIVE, abs_tol=1e-9):
            yield f"{where}: wanted {wanted}, got {got}"
    elif wanted != got:
        yield f"{where}: wanted {wanted!r}, got {got!r}"


def _same_text(one: str, other: str) -> bool:
    """Whether two lines are the same but for the last digit of their numbers."""
    if one == other:
        return True
    if _NUMBER.split(one) != _NUMBER.split(other):
        return False
    pairs = zip(_NUMBER.findall(one), _NUMBER.findall(other), strict=True)
    return all(a == b or ("." in a and abs(float(a) - float(b)) <= 1.01 * _last_digit(a)) for a, b in pairs)


def _last_digit(number: str) -> float:
    """What one unit of a number's last digit is worth."""
    digits, _, power = number.partition("e")
    return 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))


def recorded(name: str) -> dict[str, Any]:
    """What was recorded of the case `name`."""
    return json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))


def main() -> None:
    """Record all cases anew."""
    FOLDER.mkdir(exist_ok=True)
    os.environ["COLUMNS"] = "80"
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        prepare(Path(folder))
        for name, arguments in CASES.items():
            text = json.dumps(said(arguments), indent=1, ensure_ascii=False, sort_keys=True)
            (FOLDER / f"{name}.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
