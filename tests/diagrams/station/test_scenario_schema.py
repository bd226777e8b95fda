"""docs/schemas/scenario.json says what scenario files are read as, field by field."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydrake.common.yaml import yaml_dump_typed
from schemas import FOLDER, assert_as_described, validator

from slipmap.diagrams.station.scenario import Scenario, ScenarioError, read_settings

ROOT = FOLDER.parents[1]
SCHEMA = validator("scenario").schema

PAGES = [
    (path.name, block)
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    for block in re.findall(r"```yaml\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)
    if path.name != "import.md"
    and not any(word in block for word in ("format: push-dataset", "\ncsv:", "known:"))
]

OF_A_MESH = {"mesh": "shoe.obj", "mass": 0.8, "mu": 0.3}
OF_LABELS = {"labels": "shoe.png"}
BESIDE: dict[str, dict[str, Any]] = {
    "object.mass": OF_A_MESH,
    "object.mu": OF_A_MESH,
    "object.metres_per_unit": OF_A_MESH,
    "object.up": OF_A_MESH,
    "object.background": OF_LABELS,
    "object.metres_per_pixel": OF_LABELS,
    "object.masses": OF_LABELS,
    "object.frictions": OF_LABELS,
    "object.height": OF_LABELS,
    "object.mu_finger": OF_LABELS,
    "object.cells": OF_LABELS,
    "table.size": {"shape": "rectangle"},
    "execution.tip_height": {"safe_height": 0.3},
    "execution.safe_height": {"tip_height": 0.001},
    "pokes.shortest": {"longest": 10 - 1e-12},
    "pokes.longest": {"shortest": 1e-12},
    "pokes.slowest": {"fastest": 10 - 1e-12},
    "pokes.fastest": {"slowest": 1e-12},
}
"""What leaves a field free to be anything that it can be: a schema cannot compare two fields."""


def leaves(settings: Any, where: tuple[str, ...] = ()) -> dict[str, Any]:
    """Every value in nested dataclasses by its path, with dots."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(settings):
        value, path = getattr(settings, field.name), (*where, field.name)
        found |= leaves(value, path) if dataclasses.is_dataclass(value) else {".".join(path): value}
    return found


def described(schema: dict[str, Any], where: tuple[str, ...] = ()) -> dict[str, dict[str, Any]]:
    """Every field of the schema by its path, with dots; sections must be closed."""
    found: dict[str, dict[str, Any]] = {}
    for name, part in schema["properties"].items():
        path = (*where, name)
        if "properties" in part:
            assert part["type"] == "object" and part["additionalProperties"] is False, path
            found |= described(part, path)
        else:
            found[".".join(path)] = part
    return found


DEFAULTS, DESCRIBED = leaves(Scenario()), described(SCHEMA)


def probes(default: Any, part: dict[str, Any]) -> list[Any]:
    """Values of all kinds, and numbers at the ends of the described range and just outside and inside."""
    if isinstance(default, list):
        lists = [[item] * len(default) for item in probes(default[0], part["items"])]
        return [*lists, default[:-1], [*default, default[-1]], [], "text", 1.0, None]
    whole = isinstance(default, int)
    numbers = [-(10**9), -1, 0, 1, 10**9]
    for key in ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"):
        if key in part:
            numbers += [part[key], part[key] - (1 if whole else 1e-9), part[key] + (1 if whole else 1e-9)]
    kinds = ["text", True, None, [1.0], {}, default + 0.5 if whole else 0.5]
    return [*(int(one) if whole else float(one) for one in numbers), *kinds, *part.get("enum", [])]


def content(path: str, value: Any) -> dict[str, Any]:
    """A file that says one thing, and what must stand beside it."""
    *sections, name = path.split(".")
    result: dict[str, Any] = {**BESIDE.get(path, {}), name: value}
    for section in reversed(sections):
        result = {section: result}
    return result


def is_read(document: Any, folder: Path) -> bool:
    file = folder / "cell.yaml"
    file.write_text(yaml.safe_dump(document), encoding="utf-8")
    try:
        read_settings(file, Scenario)
    except ScenarioError:
        return False
    return True


def test_fields_are_the_same():
    assert DESCRIBED.keys() == DEFAULTS.keys()
    assert SCHEMA["additionalProperties"] is False


@pytest.mark.parametrize("section", [field.name for field in dataclasses.fields(Scenario)])
def test_what_is_described_is_what_is_read(section, tmp_path):
    check = validator("scenario")
    for path, default in DEFAULTS.items():
        if path.split(".")[0] != section:
            continue
        for value in probes(default, DESCRIBED[path]):
            document = content(path, value)
            assert check.is_valid(document) == is_read(document, tmp_path), f"{path}: {value!r}"


@pytest.mark.parametrize("shape", ["round", "rectangle"])
@pytest.mark.parametrize("kind", [{}, OF_A_MESH, OF_LABELS], ids=["benchmark", "mesh", "labels"])
def test_what_an_object_and_a_table_do_not_use_is_described(kind, shape, tmp_path):
    values = {
        "object": {
            "name": "wrench", "mass": 0.5, "mu": 0.5, "metres_per_unit": 0.5, "up": "y", "background": 1,
            "metres_per_pixel": 0.5, "masses": {"1": 0.5}, "frictions": {"1": 0.5}, "height": 0.5,
            "mu_finger": 0.5, "cells": 50, "pose": [0.1, 0.1, 10.0],
        },
        "table": {"radius": 0.4, "size": [0.5, 0.5], "friction": 0.5},
    }  # fmt: skip
    for section, beside in (("object", kind), ("table", {"shape": shape})):
        for name, value in values[section].items():
            document = {section: {**beside, name: value}}
            assert validator("scenario").is_valid(document) == is_read(document, tmp_path), document


def test_the_defaults_are_as_described():
    assert_as_described("scenario", dataclasses.asdict(Scenario()))
    assert_as_described("scenario", yaml.safe_load(yaml_dump_typed(Scenario())))


@pytest.mark.parametrize(("page", "text"), PAGES, ids=[page for page, _ in PAGES])
def test_scenarios_of_the_pages_are_as_described(page, text, tmp_path):
    assert is_read(yaml.safe_load(text), tmp_path)
    assert_as_described("scenario", yaml.safe_load(text))


def test_pages_have_scenarios():
    assert {"station.md", "faults.md"} <= {page for page, _ in PAGES}


@pytest.mark.parametrize(
    ("text", "good"),
    [
        ("", True),
        ("camra: {height: 1.0}", False),
        ("camera: {heigth: 1.0}", False),
        ("hidden: {table_tilt: {donw_x: 0.1}}", False),
        ("camera:", False),
        ("[1, 2]", False),
        ("object: {labels: shoe.png, masses: {'1': 0.5}, frictions: {'1': 0.5, '12': 1}}", True),
        ("object: {masses: {head: 1.0}}", False),
        ("object: {masses: {1: 1.0}}", False),
        ("object: {frictions: {'1': rough}}", False),
        ("object: {mesh: shoe.obj, mass: 0.8, mu: 0.3}", True),
        ("object: {mesh: shoe.obj, mass: 0.8}", False),
        ("object: {mesh: shoe.obj, mass: 0.8, mu: null}", False),
        ("object: {mesh: shoe.obj, mass: 0.8, mu: 0.3, labels: shoe.png}", False),
        ("object: {mass: 0.8}", False),
        ("object: {mesh: null, mass: 0.8, mu: 0.3}", False),
    ],
)
def test_what_no_single_field_says(text, good, tmp_path):
    document = yaml.safe_load(text)
    assert validator("scenario").is_valid(document) == is_read(document, tmp_path) == good


def test_what_is_wrong_is_named():
    document = dataclasses.asdict(Scenario())
    document["camera"]["rate"] = "fast"
    with pytest.raises(pytest.fail.Exception, match=r"\$\.camera\.rate: 'fast' is not of type 'number'"):
        assert_as_described("scenario", document)
