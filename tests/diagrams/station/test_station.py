"""The station as a whole: its ports, what lies on its table, and that a seed repeats its pictures."""

from __future__ import annotations

import re
from collections.abc import Callable

import cv2
import numpy as np
import pytest
import trimesh
from pydrake.math import RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from slipmap.diagrams.perception.camera import CameraConfig
from slipmap.diagrams.station.arm import HOME
from slipmap.diagrams.station.scenario import Scenario
from slipmap.diagrams.station.station import Station

pytestmark = pytest.mark.usefixtures("renderer")

RATE = 10.0  # pictures a second
SMALL = {"width": 160, "height_pixels": 120, "rate": RATE}


def cell(**sections) -> Scenario:
    """The default cell with a small camera; sections hold fields to change."""
    scenario = Scenario(camera=CameraConfig(**SMALL))
    for section, values in sections.items():
        for name, value in values.items():
            setattr(getattr(scenario, section), name, value)
    return scenario


def at_rest(station: Station) -> Simulator:
    """The station before its first step, the arm kept at home."""
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.GetInputPort("iiwa.position").FixValue(context, HOME)
    station.GetInputPort("gripper.position").FixValue(context, [0.0])
    return simulator


def pose(station: Station, context: Context) -> np.ndarray:
    """(4,) place of the object's frame and its turn about the vertical."""
    X_WO = station.GetOutputPort("truth.object_pose").Eval(context)
    return np.array([*X_WO.translation(), RollPitchYaw(X_WO.rotation()).yaw_angle()])


def picture(station: Station, context: Context) -> np.ndarray:
    return station.GetOutputPort("camera.depth_image").Eval(context).data[:, :, 0].copy()


def heights(station: Station, context: Context, scenario: Scenario) -> np.ndarray:
    """Of what a noise-free camera sees over the table, m."""
    return scenario.camera.height - picture(station, context)


@pytest.fixture(scope="module")
def plain() -> Station:
    return Station(cell())


def test_the_ports_are_those_of_the_docstring(plain):
    listed = dict(re.findall(r"(input|output)_ports:\n((?:\s+- \S+\n)+)", Station.__doc__ or ""))
    inputs = [plain.get_input_port(k).get_name() for k in range(plain.num_input_ports())]
    outputs = [plain.get_output_port(k).get_name() for k in range(plain.num_output_ports())]
    assert inputs == re.findall(r"- (\S+)", listed["input"])
    assert outputs == re.findall(r"- (\S+)", listed["output"])


def test_ports_bear_the_names_that_drake_uses_for_an_iiwa(plain):
    """So that a controller for Drake's own station fits: names and sizes."""
    for name, size in (("iiwa.position", 7), ("gripper.position", 1), ("gripper.force_limit", 1)):
        assert plain.GetInputPort(name).size() == size
    for name, size in (
        ("iiwa.position_commanded", 7),
        ("iiwa.position_measured", 7),
        ("iiwa.velocity_estimated", 7),
        ("iiwa.torque_external", 7),
        ("gripper.state_measured", 2),
    ):
        assert plain.GetOutputPort(name).size() == size


def test_everything_can_be_read(plain):
    simulator = at_rest(plain)
    simulator.AdvanceTo(0.05)
    context = simulator.get_context()
    assert plain.GetOutputPort("iiwa.position_measured").Eval(context) == pytest.approx(HOME, abs=1e-3)
    assert plain.GetOutputPort("iiwa.position_commanded").Eval(context) == pytest.approx(HOME)
    assert plain.GetOutputPort("iiwa.torque_external").Eval(context) == pytest.approx(np.zeros(7), abs=0.1)
    color = plain.GetOutputPort("camera.rgb_image").Eval(context).data
    assert color.shape == (120, 160, 4) and np.ptp(color[:, :, :3]) > 50
    X_WC = plain.GetOutputPort("camera.X_WC").Eval(context)
    assert X_WC.IsNearlyEqualTo(cell().camera.X_WC, 1e-12)
    depth = picture(plain, context)
    assert np.median(depth[depth > 0]) == pytest.approx(1.1, abs=0.01)
    contacts = plain.GetOutputPort("truth.contact_results").Eval(context)
    weight = sum(
        contacts.point_pair_contact_info(k).contact_force()[2]
        for k in range(contacts.num_point_pair_contacts())
    )
    assert abs(weight) == pytest.approx(9.81 * plain.true_object.total_mass, rel=0.02)


def test_the_object_lies_still_where_the_scenario_puts_it():
    station = Station(cell(object={"name": "book", "pose": [0.05, -0.1, 30.0]}))
    simulator = at_rest(station)
    simulator.AdvanceTo(0.3)
    x, y, z, turn = pose(station, simulator.get_context())
    assert [x, y, z] == pytest.approx([0.05, -0.1, 0.0], abs=5e-4)
    assert np.degrees(turn) == pytest.approx(30.0, abs=0.1)


def test_an_object_from_a_mesh_lies_on_the_table(tmp_path):
    """A cylinder, as wide and high in the picture as in its file."""
    trimesh.creation.cylinder(radius=0.07, height=0.06).export(tmp_path / "tin.stl")
    scenario = cell(
        object={"mesh": str(tmp_path / "tin.stl"), "mass": 0.8, "mu": 0.3, "pose": [0.1, 0.05, 0.0]}
    )
    for name in ("axial_floor", "axial_growth", "lateral_jitter", "missing_at_edges", "missing_anywhere"):
        setattr(scenario.depth_noise, name, 0.0)
    station = Station(scenario)
    assert station.true_object.total_mass == pytest.approx(0.8)
    simulator = at_rest(station)
    simulator.AdvanceTo(0.2)
    context = simulator.get_context()
    assert pose(station, context)[:3] == pytest.approx([0.1, 0.05, 0.0], abs=5e-4)
    seen = heights(station, context, scenario)
    row, column = np.nonzero(np.abs(seen - 0.06) < 2e-3)
    side = (scenario.camera.height - 0.06) / scenario.camera.focal  # of a pixel at the lid
    assert len(row) * side**2 == pytest.approx(np.pi * 0.07**2, rel=0.06)
    middle_row, middle_column = (np.array(seen.shape) - 1) / 2
    assert (column.mean() - middle_column) * side == pytest.approx(0.1, abs=side)
    assert -(row.mean() - middle_row) * side == pytest.approx(0.05, abs=side)


def test_an_object_from_a_label_image_lies_on_the_table(tmp_path):
    """Two halves of different mass and friction: the centre of mass lies on the heavy one's side."""
    labels = np.zeros((40, 100), np.uint8)
    labels[5:35, 5:50], labels[5:35, 50:95] = 1, 2
    cv2.imwrite(str(tmp_path / "bar.png"), labels)
    scenario = cell(
        object={
            "labels": str(tmp_path / "bar.png"),
            "metres_per_pixel": 0.002,
            "masses": {"1": 0.9, "2": 0.3},
            "frictions": {"1": 0.2, "2": 0.5},
            "height": 0.04,
        }
    )
    station = Station(scenario)
    true = station.true_object
    assert true.total_mass == pytest.approx(1.2)
    assert true.center_of_mass[0] == pytest.approx((0.9 * -0.045 + 0.3 * 0.045) / 1.2, abs=3e-3)
    assert sorted(set(true.mu)) == [0.2, 0.5]
    assert true.height == pytest.approx(np.full(len(true.grid), 0.04), abs=5e-3)
    body = station.plant.GetBodyByName("object")
    context = station.plant.CreateDefaultContext()
    inertia = body.CalcSpatialInertiaInBodyFrame(context)
    assert inertia.get_mass() == pytest.approx(1.2)
    assert inertia.get_com()[0] == pytest.approx(true.center_of_mass[0], abs=1e-6)
    simulator = at_rest(station)
    simulator.AdvanceTo(0.2)
    assert pose(station, simulator.get_context()) == pytest.approx(np.zeros(4), abs=1e-3)


def slid(hidden: Callable[[Scenario], None]) -> tuple[np.ndarray, float]:
    """Way of the book within 0.4 s, (2,) m, and the mass-weighted friction that holds it."""
    scenario = cell(object={"name": "book"})
    hidden(scenario)
    station = Station(scenario)
    simulator = at_rest(station)
    simulator.AdvanceTo(0.4)
    true = station.true_object
    return pose(station, simulator.get_context())[:2], float((true.mass * true.mu).sum() / true.total_mass)


def test_a_hidden_tilt_reaches_the_object():
    """Down a slope steeper than its friction it slides as a block on a ramp does."""

    def steep(scenario: Scenario) -> None:
        scenario.hidden.table_tilt.down_x = 0.45

    way, mu = slid(steep)
    assert np.tan(0.45) > mu
    acceleration = 9.81 * (np.sin(0.45) - mu * np.cos(0.45))
    assert way[0] == pytest.approx(0.5 * acceleration * 0.4**2, rel=0.1)
    assert abs(way[1]) < 0.1 * way[0]


def test_a_hidden_tether_reaches_the_object():
    def tied(scenario: Scenario) -> None:
        tether = scenario.hidden.tether
        tether.stiffness, tether.anchor_x, tether.anchor_y = 40.0, 0.0, 0.4

    way, _ = slid(tied)
    assert way[1] > 0.02 and abs(way[0]) < 0.2 * way[1]


def test_without_hidden_effects_nothing_moves():
    way, _ = slid(lambda scenario: None)
    assert way == pytest.approx([0, 0], abs=1e-4)


def test_the_same_seed_gives_the_same_pictures(plain):
    def pictures(station: Station) -> list[np.ndarray]:
        simulator = at_rest(station)
        taken = []
        for frame in range(3):
            simulator.AdvanceTo(frame / RATE)
            taken.append(picture(station, simulator.get_context()))
        return taken

    first, again, other = pictures(plain), pictures(plain), pictures(Station(cell(depth_noise={"seed": 1})))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], first[1])
    assert not any(np.array_equal(a, b) for a, b in zip(first, other, strict=True))
