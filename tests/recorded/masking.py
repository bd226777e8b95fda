"""Takes out of an output what is not the same in every run or on every machine: times, places, versions."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

_TIMES = re.compile(r"(?<=\bin )\d+(?:\.\d+)? s\b|(?<=\btook )\d+(?:\.\d+)? s\b")
_VERSION = re.compile(r"(?<=^slipmap )\d+\.\d+\S*", re.MULTILINE)
_NOW_AND_THEN = re.compile(
    r"^Compiling .*…$"  # once on a machine
    r"|^[^:]+: (\d+ of \d+|\d+ s so far)(, about \d+ (h|min|s) left)?(; .*)?$"  # what takes long says how far
)
_FINDING = re.compile(r"^(ok|missing|without) +([^:]+): .*$")

TIMED = frozenset({"seconds", "seconds_per_push"})
"""Keys of a document whose values are times."""

DIGITS = 9
"""Of a recorded number; more than are compared."""


def masked_lines(text: str, folder: Path) -> list[str]:
    """The lines of a text; `folder` is where the command ran."""
    for place in {str(folder), str(folder.resolve())}:
        text = text.replace(place, "FOLDER")
    text = _VERSION.sub("VERSION", _TIMES.sub("TIME", text))
    return [line for line in text.split("\n") if not _NOW_AND_THEN.match(line)]


def masked_document(value: Any, folder: Path) -> Any:
    """A JSON document."""
    if isinstance(value, dict):
        return {
            key: "TIME" if key in TIMED else masked_document(entry, folder) for key, entry in value.items()
        }
    if isinstance(value, list):
        return [masked_document(entry, folder) for entry in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    return "\n".join(masked_lines(value, folder)) if isinstance(value, str) else value


def doctor_lines(lines: list[str]) -> list[str]:
    """What `slipmap doctor` looked at, without what it found; remedies are for what one machine lacks."""
    return [_FINDING.sub(r"STATE \2", line) for line in lines if not line.lstrip().startswith("-> ")]


def doctor_document(document: Any) -> Any:
    """The same of its JSON."""
    kept: Callable[[dict[str, Any]], dict[str, Any]] = lambda check: {  # noqa: E731
        key: value if key in ("name", "needed") else "FOUND" for key, value in check.items()
    }
    return {**document, "checks": [kept(check) for check in document["checks"]]}
