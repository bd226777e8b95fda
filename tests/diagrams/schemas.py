"""The JSON schemas of docs/schemas, and documents held against them."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from referencing import Registry, Resource

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "schemas"
NAMES = sorted(path.stem for path in FOLDER.glob("*.json"))


@cache
def validator(name: str) -> Draft202012Validator:
    texts = {path.name: json.loads(path.read_text(encoding="utf-8")) for path in FOLDER.glob("*.json")}
    registry = Registry().with_resources(
        (file, Resource.from_contents(schema)) for file, schema in texts.items()
    )
    return Draft202012Validator(texts[f"{name}.json"], registry=registry)


def assert_as_described(name: str, document: Any) -> None:
    """Fail where a document is not what docs/schemas/NAME.json says."""
    wrong = [f"{error.json_path}: {error.message[:300]}" for error in validator(name).iter_errors(document)]
    if wrong:
        pytest.fail(f"not as docs/schemas/{name}.json says: " + "; ".join(wrong))


def assert_json_as_described(arguments: list[str]) -> None:
    """Hold what a command that ended well wrote with --json against its schema."""
    command = arguments[0] if arguments else ""
    if command in NAMES and "--json" in arguments:
        file = Path(arguments[arguments.index("--json") + 1])
        assert_as_described(command, json.loads(file.read_text(encoding="utf-8")))
