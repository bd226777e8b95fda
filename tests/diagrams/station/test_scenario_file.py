"""Scenario files: everything can be set, and what is wrong is said by the file and the full name."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from pydrake.common.yaml import yaml_dump_typed

from slipmap.diagrams.hardware.interface import HeardCell
from slipmap.diagrams.loops.exploration_loop import LoopOptions, exploration_loop, recorded_dataset
from slipmap.diagrams.station.placement import check_placement, check_rest
from slipmap.diagrams.station.scenario import (
    ObjectSettings,
    Scenario,
    ScenarioError,
    check_scenario,
    read_scenario,
    read_settings,
)
from slipmap.diagrams.station.station import Station
from slipmap.models.measurements import Trial
from slipmap.models.measurements.trial import Channel
from slipmap.models.objects import cells_from_polygon
from slipmap.planners.settings import RepairSettings


@pytest.fixture
def read(tmp_path):
    def from_text(text: str | bytes) -> Scenario:
        path = tmp_path / "cell.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_settings(path, Scenario)

    return from_text


def refusal(read, text: str | bytes) -> str:
    with pytest.raises(ScenarioError) as caught:
        read(text)
    message = str(caught.value)
    assert "cell.yaml: " in message and "\n" not in message
    return message


def leaves(settings: Any, where: tuple[str, ...] = ()):
    """(path, value) of every number, text and list in nested dataclasses."""
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        path = (*where, field.name)
        yield from leaves(value, path) if dataclasses.is_dataclass(value) else [(path, value)]


CHOICES = {
    "object.name": "wrench",
    "object.labels": "shoe.png",
    "object.up": "-y",
    "object.masses": {"1": 0.5},
    "object.frictions": {"1": 0.5, "2": 0.25},
    "table.shape": "rectangle",
    "arm.models": "drake_models",
    "pokes.longest": 0.1,
    "pokes.fastest": 0.1,
}
"""Other values of fields that are no plain numbers, or must keep an order."""


def another(name: str, value: Any) -> Any:
    if name in CHOICES:
        return CHOICES[name]
    if isinstance(value, list):
        return [item + 0.125 for item in value]
    return value + 1 if isinstance(value, int) else value * 0.875 + 0.0009765625


DEFAULTS = dict(leaves(Scenario()))


def test_the_defaults_survive_a_round_trip(read):
    assert read(yaml_dump_typed(Scenario())) == Scenario()


TOGETHER = ("object.mesh", "object.mass", "object.mu", "object.metres_per_unit", "object.up")
"""Fields of an object from a mesh, which need one another."""

NEEDS = {
    **{
        ("object", name): "labels"
        for name in ("background", "metres_per_pixel", "masses", "frictions", "height")
    },
    ("object", "mu_finger"): "labels",
    ("object", "cells"): "labels",
    ("table", "size"): "shape",
}
"""Fields that need another one of their section, here as in `CHOICES`."""

ALONE = {path: value for path, value in DEFAULTS.items() if ".".join(path) not in TOGETHER}


@pytest.mark.parametrize(("path", "value"), ALONE.items(), ids=map(".".join, ALONE))
def test_every_field_can_be_set_alone(read, path, value):
    wanted = {path: another(".".join(path), value)}
    if path in NEEDS:
        needed = (*path[:-1], NEEDS[path])
        wanted[needed] = CHOICES[".".join(needed)]
    content: Any = {}
    for where, setting in wanted.items():
        section = content
        for name in where[:-1]:
            section = section.setdefault(name, {})
        section[where[-1]] = setting
    settings = read(yaml.safe_dump(content))
    assert {where: now for where, now in leaves(settings) if now != DEFAULTS[where]} == wanted


A_MESH, AN_IMAGE = "mesh: a.obj, mass: 1.0, mu: 0.3", "labels: b.png"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("table: {size: [0.6, 0.4]}", ["table.size", "shape: rectangle"]),
        ("table: {size: [1.2, 0.8]}", ["table.size", "shape: rectangle"]),
        (
            "table: {shape: round, size: [0.6, 0.4]}",
            ["table.size is [0.6, 0.4]", "shape is round", "shape: rectangle"],
        ),
        (
            "table: {shape: rectangle, radius: 0.3}",
            ["table.radius is 0.3", "shape is rectangle", "shape: round"],
        ),
        ("object: {name: box, mu_finger: 0.9}", ["object.mu_finger", "box, which is a benchmark object"]),
        (
            "object: {name: box, cells: 500}",
            ["object.cells", "a mesh or an object from a label image uses it"],
        ),
        ("object: {height: 0.1}", ["object.height", "hammer", "only an object from a label image uses it"]),
        ("object: {masses: {'1': 3.0}}", ["object.masses", "hammer, which is a benchmark object"]),
        ("object: {frictions: {'1': 0.5}}", ["object.frictions"]),
        ("object: {background: 255}", ["object.background"]),
        ("object: {metres_per_pixel: 0.002}", ["object.metres_per_pixel"]),
        (
            f"object: {{{A_MESH}, masses: {{'1': 3.0}}}}",
            ["object.masses", "a, which is an object from a mesh"],
        ),
        (f"object: {{{A_MESH}, name: banana}}", ["object.name", "only a benchmark object uses it"]),
        (
            f"object: {{{AN_IMAGE}, name: wrench}}",
            ["object.name", "b, which is an object from a label image"],
        ),
    ],
)
def test_a_field_without_effect_is_refused(read, text, named):
    message = refusal(read, text)
    for name in named:
        assert name in message


def test_another_object_takes_nothing_but_the_pose_from_the_file(tmp_path):
    path = tmp_path / "cell.yaml"
    path.write_text(f"object: {{{A_MESH}, cells: 90, pose: [0.1, 0.0, 20.0]}}")
    scenario = read_scenario(path, "wrench")
    assert scenario.object == ObjectSettings(name="wrench", pose=[0.1, 0.0, 20.0])
    path.write_text(yaml_dump_typed(scenario))
    assert read_scenario(path) == scenario


def test_an_object_from_a_mesh_is_set_as_a_whole(read):
    settings = read("object: {mesh: shoe.obj, mass: 0.8, mu: 0.3, metres_per_unit: 0.001, up: y}")
    assert [getattr(settings.object, name.split(".")[1]) for name in TOGETHER] == [
        "shoe.obj",
        0.8,
        0.3,
        0.001,
        "y",
    ]


def test_all_sections_can_be_set_at_once(read):
    settings = read(
        """
        object: {name: wrench, pose: [0.1, -0.1, 90]}
        table: {shape: rectangle, size: [1, 0.7]}
        execution: {settle: 1}
        camera: {position: [0.05, 0], rate: 5}
        depth_noise: {quantum: 0, seed: 3}
        hidden: {table_tilt: {down_x: 0.1}, tether: {stiffness: 20}}
        pokes: {center: [0.1, 0]}
        simulation: {time_step: 0.005}
        """
    )
    assert settings.object.make().name == "wrench"
    assert settings.table.make().size == (1.0, 0.7)
    assert settings.execution.settle == 1.0
    assert settings.camera.X_WC.translation() == pytest.approx([0.05, 0.0, 1.1])
    assert settings.hidden.tether.stiffness == 20.0 and settings.hidden.table_tilt.down_x == 0.1


@pytest.mark.parametrize("text", ["", "\n", "# nothing but a remark\n", "---\n"])
def test_an_empty_file_means_the_defaults(read, text):
    assert read(text) == Scenario()


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("camra: {height: 1.0}", ["unknown field camra", "did you mean camera?"]),
        ("camera: {heigth: 1.0}", ["unknown field camera.heigth", "did you mean height?"]),
        ("hidden: {table_tilt: {donw_x: 0.1}}", ["hidden.table_tilt.donw_x", "did you mean down_x?"]),
        ("execution: {tip_hight: 0.01}", ["unknown field execution.tip_hight", "did you mean tip_height?"]),
        ("table: {qqq: 1}", ["unknown field table.qqq", "radius", "friction"]),
        ("3: {height: 1.0}", ["unknown field 3", "camera"]),
    ],
)
def test_a_typo_is_told_by_its_full_name(read, text, named):
    message = refusal(read, text)
    for name in named:
        assert name in message
    assert ("did you mean" in message) == ("mean" in "".join(named))


@pytest.mark.parametrize(
    ("text", "where", "kind", "got"),
    [
        ("camera: {height: tall}", "camera.height", "a number", "'tall'"),
        ("camera: {rate: true}", "camera.rate", "a number", "True"),
        ("camera: {width: 640.5}", "camera.width", "a whole number", "640.5"),
        ("camera: {position: 0.1}", "camera.position", "a list", "0.1"),
        ("camera: {position: [0.1, left]}", "camera.position[1]", "a number", "'left'"),
        ("object: {name: 7}", "object.name", "text", "7"),
        ("object: {mesh: [a]}", "object.mesh", "text", "['a']"),
        ("object: {mass: heavy}", "object.mass", "a number", "'heavy'"),
        ("object: {masses: [1.0]}", "object.masses", "names and values", "[1.0]"),
        ("object: {masses: {'1': heavy}}", "object.masses.1", "a number", "'heavy'"),
        ("hidden: {tether: 3}", "hidden.tether", "fields and values", "3"),
        ("camera:", "camera", "fields and values", "None"),
        ("[1, 2]", "the file", "fields and values", "[1, 2]"),
    ],
)
def test_a_value_of_another_type_is_told_by_its_full_name(read, text, where, kind, got):
    message = refusal(read, text)
    assert f"{where} must" in message
    assert kind in message and message.endswith(f"got {got}")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("camera: {height: 9.0}", ["camera.height", "0.3", "3.9", "9.0"]),
        ("object: {masses: {1: 1.0}}", ["object.masses: the name 1 must be text; write '1'"]),
        ("camera: {width: '640'}", ["camera.width must be a whole number", "'640'", "text; write 640"]),
        ("camera: {rate: .nan}", ["camera.rate", "nan"]),
        ("camera: {position: [0.1, 0.2, 0.3]}", ["camera.position", "[0.1, 0.2, 0.3]"]),
        ("camera: {yaw: .inf}", ["camera.yaw", "inf"]),
        ("depth_noise: {missing_at_edges: 1.5}", ["depth_noise.missing_at_edges", "1.0", "1.5"]),
        ("execution: {settle: -1}", ["execution.settle", "60", "-1"]),
        ("execution: {tip_height: 0.05, safe_height: 0.04}", ["execution.safe_height", "0.04", "tip_height"]),
        ("object: {pose: [0.1, 0.2]}", ["object.pose", "[0.1, 0.2]"]),
        ("object: {pose: [0.1, .nan, 0]}", ["object.pose", "nan"]),
        ("object: {mesh: a.obj, labels: b.png, mass: 1.0, mu: 0.3}", ["object", "mesh", "labels"]),
        ("object: {mesh: a.obj, mass: 1.0}", ["mesh", "mass", "mu"]),
        ("object: {mesh: a.obj, mass: -1.0, mu: 0.3}", ["object.mass", "positive", "-1.0"]),
        ("object: {mass: 3.0}", ["object.mass", "hammer has its own"]),
        ("object: {masses: {head: 1.0}}", ["object", "masses", "'head'"]),
        ("object: {frictions: {'²': 1.0}}", ["object", "frictions", "'²'"]),
        ("object: {masses: {'1234567890': 1.0}}", ["object", "masses", "'1234567890'"]),
        ("table: {shape: oval}", ["table.shape", "round", "rectangle", "'oval'"]),
        ("table: {shape: rectangle, size: [1.0]}", ["table", "size", "[1.0]"]),
        ("table: {radius: .inf}", ["table", "radius", "inf"]),
        ("table: {radius: 500}", ["table.radius is 500 m", "divide by 1000?"]),
        ("table: {shape: rectangle, size: [800, 1200]}", ["table.size is 1200 m", "divide by 1000?"]),
        ("table: {friction: 0}", ["table.friction", "0"]),
        ("arm: {models: lego}", ["arm.models", "primitives", "drake_models", "'lego'"]),
        ("simulation: {time_step: 0.1}", ["simulation.time_step", "0.01", "0.1"]),
        ("hidden: {table_tilt: {down_y: 0.7}}", ["hidden.table_tilt", "0.5", "0.7"]),
        ("hidden: {tether: {stiffness: -1}}", ["hidden.tether", "stiffness", "-1"]),
        ("pokes: {shortest: 0.2}", ["pokes", "shortest", "0.2"]),
    ],
)
def test_a_value_out_of_range_is_told_by_its_name(read, text, named):
    message = refusal(read, text)
    for name in named:
        assert name in message


def test_fields_that_belong_together_are_checked_together(read):
    """The order of two lines in the file must not matter."""
    for text in ("{shortest: 0.09, longest: 0.12}", "{longest: 0.12, shortest: 0.09}"):
        assert read(f"pokes: {text}").pokes.shortest == 0.09
    for text in ("{tip_height: 0.04, safe_height: 0.15}", "{safe_height: 0.02, tip_height: 0.01}"):
        assert read(f"execution: {text}").execution.safe_height > 0.01


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ScenarioError, match=r"nowhere\.yaml: there is no such file"):
        read_settings(tmp_path / "nowhere.yaml", Scenario)
    with pytest.raises(ScenarioError, match="is a folder"):
        read_settings(tmp_path, Scenario)


@pytest.mark.parametrize(
    "text", ["camera: {height: 1", "a: b: c", "\t- x", b"\xff\xfe\x00name", "a: !!python/name:os.system"]
)
def test_what_is_no_yaml_is_named(read, text):
    assert "is not YAML" in refusal(read, text)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("camera: {rate: 9}\ntable: {}\ncamera: {rate: 5}", "camera is given in line 1 and again in line 3"),
        ("camera:\n  height: 1.0\n  height: 0.9", "camera.height is given in line 2 and again in line 3"),
    ],
)
def test_a_key_that_stands_twice_is_told_with_its_lines(read, text, told):
    assert told in refusal(read, text)


@pytest.mark.parametrize("field", ["mesh", "labels"])
def test_an_objects_file_is_looked_for_beside_the_scenario_first(tmp_path, monkeypatch, field):
    beside, here = tmp_path / "cells" / "shoe.obj", tmp_path / "here" / "shoe.obj"
    more = ", mass: 1.0, mu: 0.3" if field == "mesh" else ""
    for folder in (beside.parent, here.parent):
        folder.mkdir()
    scenario = beside.parent / "cell.yaml"
    scenario.write_text(f"object: {{{field}: shoe.obj{more}}}")
    monkeypatch.chdir(here.parent)
    with pytest.raises(ScenarioError) as refused:
        read_scenario(scenario)
    assert all(str(part) in str(refused.value) for part in ("cell.yaml", f"object.{field}", beside, here))
    assert read_scenario(scenario, "wrench").object.called == "wrench"
    for place in (here, beside):
        place.touch()
        assert getattr(read_scenario(scenario).object, field) == str(place)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gravity", 0.0),
        ("gravity", "9.81"),
        ("gravty", 9.81),
        ("camera.rate", 0.0),
        ("camera.width", 640.5),
        ("camera.position", [0.0]),
        ("table.shape", "square"),
        ("table.radius", -1.0),
        ("object.pose", None),
        ("object.mass", 1.0),
        ("object.masses", {"one": 1.0}),
        ("hidden.table_tilt.down_x", float("inf")),
        ("simulation.time_step", 1.0),
        ("pushes.candidates", True),
        ("repair", None),
    ],
)
def test_what_a_file_must_not_say_python_must_not_either(read, name, value):
    scenario, content = Scenario(), value
    *parents, last = name.split(".")
    setattr(functools.reduce(getattr, parents, scenario), last, value)
    for part in reversed(name.split(".")):
        content = {part: content}
    said = refusal(read, yaml.safe_dump(content)).partition("cell.yaml: ")[2]
    for build in (Station, lambda scenario: exploration_loop(scenario, LoopOptions()), HeardCell):
        with pytest.raises(ScenarioError) as refused:
            build(scenario)
        assert str(refused.value) == f"scenario: {said}"


def test_python_gives_numbers_and_lists_as_it_likes():
    scenario = Scenario(gravity=9)
    scenario.object.pose = np.zeros(3)
    scenario.table.shape, scenario.table.size = "rectangle", (1.0, np.float32(0.8))
    scenario.camera = dataclasses.replace(scenario.camera, width=np.int64(320))
    check_scenario(scenario)


def test_recorded_pushes_bear_the_objects_name(tmp_path):
    """An object of the user's own must not go by the name of the default one."""
    rows = np.array([0.0, 1.0])
    trial = Trial("trials/000.json", "fit", Channel(rows, np.zeros((2, 3))), Channel(rows, np.zeros((2, 2))))
    grid = cells_from_polygon(np.array([[-2, -1], [2, -1], [2, 1], [-2, 1]]) * 0.01, width=0.01)
    scenario = Scenario()
    assert recorded_dataset([trial], grid, scenario).name == "hammer"
    trimesh.creation.box((0.1, 0.05, 0.03)).export(tmp_path / "shoe_box.stl")
    scenario.object.mesh = str(tmp_path / "shoe_box.stl")
    scenario.object.mass, scenario.object.mu = 0.8, 0.3
    assert recorded_dataset([trial], grid, scenario).name == scenario.object.make().name == "shoe_box"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("object: {pose: [5.0, 0.0, 0.0]}", ["object.pose", "x = 5 m", "does not lie on the table", "0.5 m"]),
        ("object: {pose: [0.4, 0.0, 0.0]}", ["does not lie on the table"]),
        ("{object: {pose: [0.0, 0.3, 0.0]}, table: {shape: rectangle}}", None),
        ("{object: {pose: [0.0, 0.4, 0.0]}, table: {shape: rectangle}}", ["sides of 1.2 m and 0.8 m"]),
        ("{object: {name: box}, execution: {safe_height: 0.08}}", ["box is 0.070 m high", "0.060 m"]),
        ("execution: {tip_height: 0.05}", ["tip_height is 0.05 m", "hammer is 0.0", "would pass over it"]),
        ("hidden: {table_tilt: {down_x: 0.3, down_y: 0.3}}", ["hammer slides off by itself", "23.6°"]),
        (
            "{object: {name: box}, hidden: {tether: {stiffness: 50, anchor_x: 0.4}}}",
            ["hidden.tether: object box does not stay", "pulls with 20 N, but friction only holds up to 5."],
        ),
        (
            "{object: {name: box}, hidden: {tether: {stiffness: 8, anchor_x: .4}, table_tilt: {down_x: .2}}}",
            ["3.2 N and the tilt of the table with 3.12 N, but friction only holds up to", "% of that"],
        ),
        ("{object: {name: box}, hidden: {tether: {stiffness: 8, anchor_x: 0.4}}}", None),
        ("{object: {name: box}, hidden: {tether: {stiffness: 500, anchor_x: 0.4, slack: 0.4}}}", None),
        ("{object: {pose: [0.0, 0.25, 0]}, camera: {fov_y: 0.4}}", ["not wholly in the picture", "y = 0.25"]),
        ("camera: {position: [1.0, 0.0]}", ["not wholly in the picture", "about (1, 0) m"]),
        ("{object: {name: box}, camera: {height: 0.3, fov_y: 1.5}}", None),
        ("{object: {name: box}, camera: {height: 0.3, fov_y: 2.5}, execution: {safe_height: 0.2}}", None),
    ],
)
def test_an_object_must_lie_on_the_table_and_under_the_finger(read, text, named):
    scenario = read(text)
    if named is None:
        check_placement(scenario, scenario.object.make())
        check_rest(scenario, scenario.object.make())
        return
    with pytest.raises(ValueError) as refused:
        check_placement(scenario, scenario.object.make())
        check_rest(scenario, scenario.object.make())
    for part in named:
        assert part in str(refused.value)


def test_keys_of_earlier_versions_are_passed_over(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text("repair: {together: 0.25, pushes: 3}\n")
    assert read_scenario(path).repair == RepairSettings(pushes=3)


def test_a_loop_refuses_an_object_that_would_slide_off_before_its_first_push():
    scenario = Scenario()
    scenario.hidden.table_tilt.down_x = 0.34  # m/s² were meant, for 2°
    with pytest.raises(ScenarioError, match="hammer slides off by itself: the table is tilted by 19"):
        exploration_loop(scenario, LoopOptions())
    Station(scenario)  # a Diagram of one's own may show how it slides
