"""The schemas fit what is written; `conftest.py` holds what each command writes with --json against them."""

from __future__ import annotations

import copy
import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from jsonschema import Draft202012Validator
from schemas import FOLDER, NAMES, assert_as_described, validator

import slipmap
from slipmap.diagrams.application import command_line
from slipmap.models.measurements import KnownMaps
from slipmap.models.measurements.known_maps import known_document
from slipmap.models.measurements.setup_description import parse_setup

ROOT = FOLDER.parents[1]


@pytest.mark.parametrize("name", NAMES)
def test_a_schema_is_one(name):
    Draft202012Validator.check_schema(validator(name).schema)
    assert f"schemas/{name}.json" in (ROOT / "docs" / "file-formats.md").read_text(encoding="utf-8")


def test_every_command_that_writes_json_has_a_schema():
    with_json = {
        name
        for name, command in command_line.slipmap.commands.items()
        if any(parameter.name == "json_file" for parameter in command.params)
    }
    assert len(with_json) > 10 and with_json <= set(NAMES)


def test_a_dataset_that_is_written_is_as_described(demo_folder):
    pushes = demo_folder / "demo" / "pushes"
    described = yaml.safe_load((pushes / "dataset.yaml").read_text(encoding="utf-8"))
    assert_as_described("push-dataset", described)
    for entry in described["trials"]:
        assert_as_described("push-trial", json.loads((pushes / entry["file"]).read_text(encoding="utf-8")))


def test_openings_places_and_single_rows_that_are_written_are_as_described(tmp_path):
    """Of a frame whose first push was left out, in which nothing but the tip's place is known."""
    ring = np.array([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]])
    grid = slipmap.cells_from_polygon(ring, [0.4 * ring])
    pushes = [
        {"object_pose": [[0.0, 0.0, 0.0, 0.0], [1.0, way, 0.0, 0.0]], "tip_pose": [[0.0, 1.0, 0.0]]}
        for way in (0.01, 0.02)
    ]
    dataset = slipmap.dataset_from_arrays(pushes, grid, finger_radius=0.006, keep_all=True)
    folder = slipmap.write_dataset(replace(dataset, trials=dataset.trials[1:]), tmp_path / "pushes")
    described = yaml.safe_load((folder / "dataset.yaml").read_text(encoding="utf-8"))
    (entry,) = described["trials"]
    assert entry["order"] == 1 and len(described["object"]["holes"]) == 1
    assert_as_described("push-dataset", described)
    assert_as_described("push-trial", json.loads((folder / entry["file"]).read_text(encoding="utf-8")))


def test_the_least_dataset_of_the_page_is_as_described():
    page = (ROOT / "docs" / "file-formats.md").read_text(encoding="utf-8")
    least = page.split("```yaml\n")[1].split("```")[0]
    assert_as_described("push-dataset", yaml.safe_load(least))


def test_the_known_maps_of_the_page_are_as_described_and_can_be_read(tmp_path):
    page = (ROOT / "docs" / "file-formats.md").read_text(encoding="utf-8")
    least, known = (
        yaml.safe_load(page.split("```yaml\n")[1 + place].split("```")[0])
        for place in (0, page[: page.index("\nknown:\n")].count("```yaml") - 1)
    )
    assert_as_described("push-dataset", {**least, **known})
    known["known"]["mass"] = "uniform"
    setup, warnings = parse_setup({**least, **known}, "dataset.yaml", "hammer")
    assert warnings == [] and setup.known is not None and setup.known.complete
    for one in (setup.known, KnownMaps(finger_friction=0.2)):
        assert_as_described("push-dataset", {**least, "known": known_document(one)})


def test_what_is_missing_unknown_or_of_another_kind_is_found(demo_folder):
    written = json.loads((demo_folder / "demo.json").read_text(encoding="utf-8"))
    assert_as_described("demo", written)
    for spoil in (
        lambda document: document.pop("seed"),
        lambda document: document.update(sead=0),
        lambda document: document["trials"][0].update(role="judge"),
        lambda document: document["hypotheses"][1].update(center_of_mass=[0.0]),
        lambda document: document["truth"][0].update(inside="yes"),
    ):
        document = copy.deepcopy(written)
        spoil(document)
        with pytest.raises(pytest.fail.Exception, match="schemas/demo"):
            assert_as_described("demo", document)
