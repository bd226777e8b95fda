"""Whatever stands in a scenario file, there is a scenario or a sentence that says what is wrong, and soon."""

from __future__ import annotations

import pytest
from pydrake.common.yaml import yaml_dump_typed

from slipmap.diagrams.application.commands.cell_run import scenario_of
from slipmap.diagrams.station.scenario import Scenario, ScenarioError, read_scenario
from slipmap.models.files import BadInput
from tests.mutations import refusals, spoilt

WHOLE = yaml_dump_typed(Scenario()).encode()
SMALL = b"""\
object: {name: box, pose: [0.1, 0.0, 20]}
table: {shape: rectangle, size: [1.2, 0.8], friction: 0.5}
camera:
  rate: 5.0
  width: 640
hidden: {table_tilt: {down_x: 0.02}, tether: {stiffness: 5.0}}
depth_noise: {seed: 3}
"""
WORDS = tuple(
    b"&a |*a|<<: *a|!!binary |!!int |!!set |!!python/name:os.system |[|{|}|: |- |? |~|true|2001-99-99|0x"
    b"|1_0:99:9|camera: |mesh: |labels: |masses: |{1: 2}|---\n|%YAML 1.1\n|'".split(b"|")
)


@pytest.fixture
def read(tmp_path):
    path = tmp_path / "cell.yaml"

    def from_bytes(content: bytes) -> Scenario:
        path.write_bytes(content)
        try:
            return read_scenario(path)
        except ScenarioError as error:
            assert str(error).startswith(str(path))
            raise

    return from_bytes


@pytest.mark.parametrize(("content", "count"), [(WHOLE, 120), (SMALL, 400)], ids=["whole", "small"])
def test_spoilt_scenarios(read, content, count):
    assert read(content) is not None
    read_well, refused = refusals(spoilt(content, count, WORDS), read, ScenarioError)
    assert refused > count // 3 and read_well > 0


def test_spoilt_scenarios_of_a_command(tmp_path):
    """Those that can be read still have to make sense, of the object and its place."""
    path = tmp_path / "cell.yaml"

    def read(content: bytes) -> None:
        path.write_bytes(content)
        try:
            scenario_of(path, None)
        except BadInput as error:
            raise ValueError(str(error)) from error

    _, refused = refusals(spoilt(SMALL, 150, WORDS, seed=1), read, ValueError)
    assert refused > 50


LAUGHS = b"a0: &a0 [x, x]\n" + b"".join(
    b"a%d: &a%d [*a%d, *a%d]\n" % (k, k, k - 1, k - 1) for k in range(1, 60)
)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"[" * 60_000, "nested too deeply"),
        (b"a: " + b"{a: " * 5_000, "nested too deeply"),
        (LAUGHS, "unknown field a0"),
        (b"object: &x {pose: *x}", "pose"),
        (LAUGHS.replace(b"a59: &a59", b"camera: {position: ").rstrip() + b"}", "unknown field a0"),
        (b"camera: {position: &a [[x, x], [x, x]], rate: *a}", "camera.position[0] must be a number"),
        (b"camera: {rate: 2001-99-99}", "is not YAML"),
        (b"camera: {rate: !!int x}", "is not YAML"),
        (b"camera: {rate: !!bool x}", "is not YAML"),
        (b"camera: {rate: 1" + b"0" * 400 + b"}", "camera.rate must be a number"),
        (b"camera: {rate: 1" + b"0" * 5000 + b"}", "is not YAML"),
        (b"? [a, b]\n: 1", "is not YAML"),
        (b"? &a [*a]\n: 1", "is not YAML"),
        (b"? " + b"x" * 50_000 + b"\n: 1", "unknown field"),
        (b"object: {mesh: 'a\\0b', mass: 1.0, mu: 0.3}", "object.mesh"),
        (b'object: {mesh: "a\\0b", mass: 1.0, mu: 0.3}', "object.mesh"),
        (b"object: {labels: " + b"x" * 5000 + b"}", "object.labels"),
        (b"table: {shape: " + b"x" * 50_000 + b"}", "table.shape must be round or rectangle"),
        (b"camera: {rate: [" + b"1, " * 20_000 + b"]}", "camera.rate"),
    ],
)
def test_what_would_grow_without_bound_is_refused(read, content, told):
    def named(content: bytes) -> None:
        try:
            read(content)
        except ScenarioError as error:
            assert told in str(error), str(error)[:300]
            raise

    assert refusals(iter([content]), named, ScenarioError) == (0, 1)
