"""Keeps what the commands say; `python -m tests.recorded.recording [NAME ...]` records cases anew.

Without names it records all.

A recording is `outputs/NAME.json`. Look at `git diff tests/recorded/outputs` before it is committed: every
line of it is something that a user will see changed.
"""

from __future__ import annotations

import json
import re
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from tests.recorded.cases import CASES
from tests.recorded.inputs import write_inputs
from tests.recorded.masking import doctor_document, doctor_lines, masked_document, masked_lines
from tests.recorded.running import run

OUTPUTS = Path(__file__).parent / "outputs"


class Recorder:
    """Runs cases in one folder, each once, and before it those that write what it reads."""

    def __init__(self, folder: Path) -> None:
        write_inputs(folder)
        self._folder = folder
        self._done: dict[str, dict[str, Any]] = {}

    def of(self, name: str) -> dict[str, Any]:
        """What the case does now, masked as it is recorded."""
        if name not in self._done:
            for earlier in CASES[name].after:
                self.of(earlier)
            self._done[name] = self._recording(name)
        return self._done[name]

    def _recording(self, name: str) -> dict[str, Any]:
        case = CASES[name]
        said = run(case.line, self._folder, case.environment)
        recording: dict[str, Any] = {
            "line": case.line,
            "code": said.code,
            "out": masked_lines(said.out, self._folder),
            "err": masked_lines(said.err, self._folder),
            "wrote": said.wrote,
            "texts": {file: masked_lines(text, self._folder) for file, text in said.texts.items()},
            "json": masked_document(said.document, self._folder),
        }
        if name == "doctor":
            recording["out"] = doctor_lines(recording["out"])
            recording["json"] = doctor_document(recording["json"])
        return recording


def recorded(name: str) -> dict[str, Any]:
    """What was recorded of a case."""
    return dict(json.loads((OUTPUTS / f"{name}.json").read_text(encoding="utf-8")))


def as_text(recording: dict[str, Any]) -> str:
    """A recording as it is kept: lists of numbers in one line."""
    text = json.dumps(recording, indent=1, ensure_ascii=False)
    numbers = re.compile(r"\[\s+(-?\d[-\d.e+]*(?:,\s+-?\d[-\d.e+]*)*)\s+\]")
    return numbers.sub(lambda found: "[" + " ".join(found[1].split()) + "]", text) + "\n"


def main() -> None:
    """Record cases anew."""
    names = sys.argv[1:] or list(CASES)
    OUTPUTS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(Path(folder))
        for name in names:
            began, cpu = time.monotonic(), time.process_time()
            recording = recorder.of(name)
            (OUTPUTS / f"{name}.json").write_text(as_text(recording), encoding="utf-8")
            took = f"{time.monotonic() - began:6.1f} s, {time.process_time() - cpu:6.1f} s of processor"
            print(f"{name:<32} exit code {recording['code']:<3} {took}", flush=True)
    for path in OUTPUTS.glob("*.json"):
        if path.stem not in CASES:
            path.unlink()


if __name__ == "__main__":
    main()
