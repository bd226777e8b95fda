"""The true object in Drake's world slides like the cell-grid model, and falls where its weight is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pushed_object import FINGER_RADIUS, TestBed
from pydrake.geometry import Role
from pydrake.multibody.plant import MultibodyPlant

from slipmap.diagrams.station.sliding_object import (
    add_sliding_object,
    partner_friction,
    sink_of,
    spatial_inertia,
)
from slipmap.diagrams.station.table import ROUND_TABLE, add_table
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.objects.benchmark_objects import BENCHMARK_OBJECTS, benchmark_object
from slipmap.models.objects.footprints import cells_from_polygon
from slipmap.models.objects.meshes import coloured
from slipmap.models.objects.true_object import Block, TrueObject
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.rollout import Push, Slider
from slipmap.planners.exploration import candidate_pushes
from slipmap.planners.table_push import TablePush

START = np.array([-0.05, 0.02, 0.3])
SQUARE_TABLE = Table("rectangle", (0.1, 0.0), size=(0.8, 0.6))
EDGE = 0.5  # m, of both tables along x


def _telling_push(thing: TrueObject, seed: int) -> tuple[Push, np.ndarray]:
    """A push of 10 cm at 5 cm/s during which the finger stays at the object, and the model's poses.

    Where the finger slips off, a hundredth of a millimetre decides when it does.
    """
    slider = Slider(thing.grid, FINGER_RADIUS)
    for candidate in candidate_pushes(thing.grid, FINGER_RADIUS, np.random.default_rng(seed), 20):
        push = replace(candidate, length=0.1, speed=0.05).push(START, h=2.5e-3, rest=0.1)
        moving = 1.0 / push.h * np.linalg.norm(np.diff(push.tip, axis=0), axis=1) > 0.02
        last = float(push.h * np.flatnonzero(moving)[-1])
        result = slider.rollout(thing.maps, [replace(push, force_times=np.array([last]))])
        poses = result.poses_of(0)[0]
        if np.linalg.norm(result.forces[0, 0]) > 0 and abs(poses[-1, 2] - START[2]) > np.radians(5):
            return push, poses
    raise AssertionError(f"no push turns the {thing.name}")


@pytest.mark.parametrize("name", BENCHMARK_OBJECTS)
def test_pushed_object_follows_the_cell_grid_model(name: str) -> None:
    thing = benchmark_object(name)
    push, expected = _telling_push(thing, seed=1)
    bed = TestBed(thing, finger=True)
    bed.start(push.start_pose, push.tip[0])
    poses = bed.follow(push.tip, push.h)[1:]
    off = poses - expected
    assert np.linalg.norm(off[:, :2], axis=1).max() < 2e-3
    assert np.abs(off[:, 2]).max() < np.radians(1.0)
    # Neither tipped nor lifted.
    assert abs(bed.X_WO.translation()[2] + sink_of(thing)) < 2e-6


def test_pushed_over_the_rim_it_slides_as_on_the_table() -> None:
    """Feet that sink by 20 µm let its blocks down on the table, and it ends 24 mm off."""
    thing, pose = benchmark_object("hammer"), np.array([0.09685, 0.49962, 0.87122])
    tip = TablePush(np.array([0.03466, 0.48889]), np.array([0.06474, 0.46205]), 0.085).path(2.5e-3)
    slider = Slider(thing.grid, FINGER_RADIUS, table=ROUND_TABLE)
    expected = slider.rollout(thing.maps, [Push(2.5e-3, tip, pose)]).end[0, 0, :3]
    assert add(pose[None], expected, thing.grid.centers)[0] > 15e-3
    bed = TestBed(thing, finger=True)
    bed.start(pose, tip[0])
    bed.follow(tip, 2.5e-3)
    bed.advance(0.2)
    assert add(bed.pose[None], expected, thing.grid.centers)[0] < 2e-3


@pytest.fixture(scope="module")
def bar() -> Iterator[TrueObject]:
    """30 cm × 6 cm, all weight in its right third but a little."""
    outline = np.array([[0, 0], [0.3, 0], [0.3, 0.06], [0, 0.06]]) - [0.15, 0.03]
    grid = cells_from_polygon(outline, width=0.03)
    right = grid.centers[:, 0] > 0.05
    body = trimesh.creation.box((0.3, 0.06, 0.04))
    body.apply_translation([0, 0, 0.02])
    yield TrueObject(
        name="bar",
        grid=grid,
        labels=right.astype(int),
        mass=np.where(right, 0.1, 0.002),
        mu=np.where(right, 0.3, 0.5),
        mu_finger=0.3,
        height=np.full(len(grid), 0.04),
        mesh=coloured([(body, (0.5, 0.5, 0.5, 1.0))]),
        colors=np.ones((2, 4)),
        blocks=(Block(grid.polygon, 0.04),),
    )


def test_each_foot_carries_the_weight_of_its_cell(bar: TrueObject) -> None:
    bed = TestBed(bar)
    bed.start(np.array([0.1, 0.0, 0.7]))
    bed.advance(0.2)
    np.testing.assert_allclose(bed.pose, [0.1, 0.0, 0.7], atol=1e-7)
    results = bed.plant.get_contact_results_output_port().Eval(bed.context)
    inspector = bed.scene_graph.model_inspector()
    carried = np.zeros(len(bar.grid))
    for k in range(results.num_point_pair_contacts()):
        contact = results.point_pair_contact_info(k)
        pair = contact.point_pair()
        names = inspector.GetName(pair.id_A) + inspector.GetName(pair.id_B)
        assert "block" not in names
        cell = int(names.split("cell_")[1].split("_")[0])
        carried[cell] += abs(contact.contact_force()[2])
    np.testing.assert_allclose(carried, bar.mass * 9.81, rtol=1e-3)


def test_cells_of_next_to_no_mass_make_no_foot_as_stiff_as_the_table(bar: TrueObject) -> None:
    mass = np.where(bar.labels == 1, 0.5, 1e-6)
    light = replace(bar, mass=mass)
    stiffness = mass * 9.81 / 4 / sink_of(light)
    assert stiffness.max() == pytest.approx(1e7, rel=1e-3)
    bed = TestBed(light)
    bed.start(np.array([0.1, 0.0, 0.7]))
    bed.advance(0.1)
    np.testing.assert_allclose(bed.pose, [0.1, 0.0, 0.7], atol=1e-6)


def test_inertia_is_that_of_the_boxes(bar: TrueObject) -> None:
    inertia = spatial_inertia(bar)
    assert inertia.get_mass() == pytest.approx(bar.total_mass)
    np.testing.assert_allclose(inertia.get_com(), bar.center_of_mass, atol=1e-12)
    about_z = inertia.CalcRotationalInertia().CopyToFullMatrix3()[2, 2]
    assert about_z == pytest.approx(Slider(bar.grid, 0.01).inertia(bar.mass)[3])


@pytest.mark.parametrize("table", [ROUND_TABLE, SQUARE_TABLE], ids=["round", "rectangle"])
def test_falls_where_its_weight_is_beyond_the_edge(bar: TrueObject, table: Table) -> None:
    bed = TestBed(bar, table=table)
    for angle in (0.0, np.pi):
        middle = np.cos(angle) * bar.center_of_mass[0]
        for beyond, falls in ((-6e-3, False), (1e-3, True)):
            bed.start(np.array([EDGE + beyond - middle, 0.0, angle]))
            bed.advance(1.2)
            height = (bed.X_WO @ bar.center_of_mass)[2]
            if falls:
                assert height < -0.3, f"{beyond} m beyond the edge, turned by {angle}"
            else:
                assert height == pytest.approx(bar.center_of_mass[2], abs=1e-3)
                tilt = np.degrees(np.arccos(bed.X_WO.rotation().matrix()[2, 2]))
                assert tilt < 1.0


def test_falls_onto_the_floor_and_stays_there(bar: TrueObject) -> None:
    bed = TestBed(bar)
    bed.start(np.array([0.9, 0.0, 0.0]))
    bed.advance(2.0)
    assert bed.X_WO.translation()[2] == pytest.approx(-0.72, abs=0.05)


def test_coasting_stops_after_the_way_that_friction_allows(bar: TrueObject) -> None:
    even = replace(bar, mu=np.full(len(bar.grid), 0.4), mass=np.full(len(bar.grid), 0.02))
    bed = TestBed(even, time_step=1e-3)
    bed.start(np.zeros(3))
    velocity = np.zeros(6)
    velocity[3] = 0.5
    bed.plant.SetVelocities(bed.context, bed.plant.GetModelInstanceByName("object"), velocity)
    bed.advance(0.5)
    assert bed.pose[0] == pytest.approx(0.5**2 / (2 * 0.4 * 9.81), rel=0.02)
    np.testing.assert_allclose(bed.pose[1:], 0.0, atol=1e-4)


def test_spinning_cell_stops_after_the_angle_that_friction_allows(bar: TrueObject) -> None:
    width, mu, spin = 0.1, 0.3, 5.0
    grid = cells_from_polygon(width * (np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) - 0.5), count=1)
    one, height = np.ones(1), np.array([0.02])
    blocks = (Block(grid.polygon, 0.02),)
    tile = replace(bar, grid=grid, labels=np.zeros(1), mass=one, mu=mu * one, height=height, blocks=blocks)
    bed = TestBed(tile, time_step=1e-3)
    bed.start(np.zeros(3))
    bed.plant.SetVelocities(
        bed.context, bed.plant.GetModelInstanceByName("object"), np.array([0.0, 0.0, spin, 0.0, 0.0, 0.0])
    )
    bed.advance(0.3)
    # Friction's moment is that of pressure spread evenly over the square, the inertia m w²/6.
    arm = np.mean(np.hypot(*np.meshgrid(np.linspace(-0.5, 0.5, 401), np.linspace(-0.5, 0.5, 401)))) * width
    deceleration = 6 * mu * 9.81 * arm / width**2
    assert bed.pose[2] == pytest.approx(spin**2 / (2 * deceleration), rel=0.03)


def test_friction_of_the_pair_is_the_wanted_one() -> None:
    wanted = np.array([0.1, 0.3, 0.6])
    partners = partner_friction(wanted, 0.35, "pair")
    combined = 2 * partners * 0.35 / (partners + 0.35)
    np.testing.assert_allclose(combined, wanted)
    with pytest.raises(ValueError, match=r"pair: a friction coefficient of 0\.6.*more than 0\.3"):
        partner_friction(wanted, 0.3, "pair")


def test_friction_out_of_reach_names_the_object(bar: TrueObject) -> None:
    plant = MultibodyPlant(1e-3)
    with pytest.raises(ValueError, match="object bar on the table"):
        add_sliding_object(plant, bar, 0.2)
    with pytest.raises(ValueError, match="object bar at the finger"):
        add_sliding_object(plant, replace(bar, mu_finger=0.7), 0.6)
    with pytest.raises(ValueError, match="radius"):
        add_table(plant, Table("round", (0.0, 0.0)))


def test_looks_have_the_colours_of_the_mesh() -> None:
    thing = benchmark_object("hammer")
    bed = TestBed(thing)
    inspector = bed.scene_graph.model_inspector()
    frame = bed.plant.GetBodyFrameIdOrThrow(bed.body.index())
    seen = {
        tuple(
            np.round(
                255 * np.array(inspector.GetIllustrationProperties(g).GetProperty("phong", "diffuse").rgba)
            ).astype(int)
        )
        for g in inspector.GetGeometries(frame, Role.kIllustration)
    }
    assert seen == {tuple(color) for color in np.asarray(thing.mesh.visual.face_colors)}
    perceived = inspector.GetGeometries(frame, Role.kPerception)
    assert len(perceived) == len(seen)
