"""One trial of a campaign: what is to be done, and what came of it. Both are plain data."""

from __future__ import annotations

import importlib
import json
import os
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


class CampaignError(ValueError):
    """A campaign that cannot be run as asked. The text says what to do."""


@dataclass(frozen=True)
class TrialSpec:
    """A trial to be made, on whatever machine.

    Attributes:
        name: of the trial and its file; letters, digits, '-', '_' and '.'.
        function: `module:function`, called as function(seed=seed, **parameters); returns what JSON can hold.
        parameters: what JSON can hold.
        seed: of every random draw in it.

    Raises:
        CampaignError: a name that is no file name, or parameters that JSON cannot hold.
    """

    name: str
    function: str
    parameters: Mapping[str, Any]
    seed: int

    def __post_init__(self) -> None:
        if not self.name.strip("._-") or not all(c.isalnum() or c in "-_." for c in self.name):
            raise CampaignError(f"trial {self.name!r}: a name has letters, digits, '-', '_' and '.'")
        try:
            self.told()
        except (TypeError, ValueError) as error:
            raise CampaignError(f"trial {self.name}: parameters must be plain data ({error})") from error

    def told(self) -> dict[str, Any]:
        """As JSON holds it."""
        document = {
            "name": self.name,
            "function": self.function,
            "parameters": dict(self.parameters),
            "seed": self.seed,
        }
        return dict(json.loads(json.dumps(document, allow_nan=False)))

    def run(self) -> TrialOutcome:
        """Make the trial. What it raises is recorded, not passed on."""
        began = time.perf_counter()
        try:
            module, _, name = self.function.partition(":")
            result = getattr(importlib.import_module(module), name)(seed=self.seed, **self.parameters)
            plain = json.loads(json.dumps(result, allow_nan=False))
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            text = " ".join(str(error).split())
            failure = f"{type(error).__name__} in {Path(place.filename).name}, line {place.lineno}: {text}"
            return TrialOutcome(self, None, failure, time.perf_counter() - began)
        return TrialOutcome(self, plain, None, time.perf_counter() - began)


@dataclass(frozen=True)
class TrialOutcome:
    """What came of a trial.

    Attributes:
        spec: the trial.
        result: what its function returned, or None where it failed.
        failure: why it failed, or None.
        seconds: that it took, s; the only part that depends on the machine.
    """

    spec: TrialSpec
    result: Any
    failure: str | None
    seconds: float = field(compare=False, default=0.0)


def write_outcome(outcome: TrialOutcome, folder: Path) -> None:
    """Write `<name>.json` into a folder; the file appears whole or not at all.

    Raises:
        CampaignError: the folder cannot be written to.
    """
    document = outcome.spec.told() | {
        "result": outcome.result,
        "failure": outcome.failure,
        "seconds": outcome.seconds,
    }
    path = _file(outcome.spec, folder)
    part = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        part.write_text(json.dumps(document, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        raise CampaignError(
            f"cannot write {path}: {error.strerror or error}; choose another folder"
        ) from error
    finally:
        part.unlink(missing_ok=True)


def read_outcome(spec: TrialSpec, folder: Path) -> TrialOutcome | None:
    """What is on file for a trial, or None.

    Raises:
        CampaignError: the file is damaged, or of a trial of this name with other parameters.
    """
    path = _file(spec, folder)
    if not path.exists():
        return None
    advice = "remove it or choose another folder"
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        told = {key: document[key] for key in ("name", "function", "parameters", "seed")}
        outcome = TrialOutcome(spec, document["result"], document["failure"], float(document["seconds"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CampaignError(f"{path} is not a readable trial ({error}); {advice}") from error
    if told != spec.told():
        different = [key for key, value in spec.told().items() if told[key] != value]
        raise CampaignError(f"{path} is of another campaign, its {' and '.join(different)} differ; {advice}")
    return outcome


def _file(spec: TrialSpec, folder: Path) -> Path:
    return folder / f"{spec.name}.json"
