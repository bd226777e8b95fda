import gc
import threading

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.perception import cell_perception
from slipmap.diagrams.perception.camera import add_camera
from slipmap.diagrams.perception.cell_perception import FRAMES, CellPerception
from slipmap.diagrams.perception.sight import ArmHulls
from slipmap.models.perception.object_mask import draw_hulls
from slipmap.models.perception.pose_tracking import track
from slipmap.models.perception.seen_object import ObservedPose, Rests

PERIOD = 1 / 15


def test_from_an_empty_table_to_a_pose_and_back(world):
    context = world.context()
    simulator = world.simulator(context)
    simulator.AdvanceTo(0.75 * PERIOD)
    assert world.output(context, "object_pose").reason == "no object"
    world.place(context, "hammer", (0.05, -0.02, 0.6))
    simulator.AdvanceTo(8.75 * PERIOD)
    world.place(context, "hammer", (0.08, -0.02, 0.6))  # moved during the first look: it takes longer
    simulator.AdvanceTo((FRAMES + 0.75) * PERIOD)
    assert world.output(context, "cell_grid") is None
    assert not world.output(context, "object_pose").valid
    simulator.AdvanceTo((FRAMES + 10.75) * PERIOD)
    grid = world.output(context, "cell_grid")
    assert 32 <= len(grid) <= 50
    first = world.output(context, "object_pose")
    assert first.valid
    assert first.time == pytest.approx((FRAMES + 10) * PERIOD)
    world.place(context, "hammer", (0.09, 0.0, 0.65))
    simulator.AdvanceTo((FRAMES + 11.75) * PERIOD)
    moved = world.output(context, "object_pose")
    assert moved.pose[2] - first.pose[2] == pytest.approx(0.05, abs=np.deg2rad(0.5))
    assert np.array_equal(world.output(context, "cell_grid").centers, grid.centers)
    assert np.array_equal(world.output(context, "seen_object").grid.centers, grid.centers)
    world.place(context, None, (0, 0, 0))
    simulator.AdvanceTo((FRAMES + 12.75) * PERIOD)
    assert world.output(context, "object_pose").reason == "left the table"


def test_each_new_place_improves_the_outline_and_nothing_else(world):
    context = world.context()
    world.place(context, "hammer", (0.05, -0.02, 0.6))
    simulator = world.simulator(context)
    simulator.AdvanceTo((FRAMES + 10.75) * PERIOD)
    seen, grid = (world.output(context, name) for name in ("seen_object", "cell_grid"))
    assert len(world.output(context, "rests").offsets) == 1  # the same place again does not count
    assert grid is not seen.grid
    for place, pictures in (((0.09, 0.0, 0.65), 15.75), ((0.06, 0.02, 0.4), 30.75)):
        world.place(context, "hammer", place)
        simulator.AdvanceTo((FRAMES + pictures) * PERIOD)
        assert world.output(context, "cell_grid") is grid  # five pictures so far
        simulator.AdvanceTo((FRAMES + pictures + 10) * PERIOD)
        before, grid = grid, world.output(context, "cell_grid")
        assert grid is not before
        assert np.array_equal(grid.centers, seen.grid.centers)
        moved = grid.polygon.symmetric_difference(before.polygon).area / grid.polygon.length
        assert 0.05e-3 < moved < 0.6e-3
    assert world.output(context, "seen_object") is seen
    rests = world.output(context, "rests").offsets
    assert len(rests) == 3
    first = world.output(context, "first_picture")
    again = first.grid(world.config.intrinsics, rests)  # as another process finds it
    assert np.array_equal(again.exterior, grid.exterior)


@pytest.mark.parametrize(("places", "counted"), [(2, 0), (3, 1)])
def test_no_more_places_are_looked_at_than_wanted(monkeypatch, places, counted):
    offsets = np.zeros(20)
    monkeypatch.setattr(cell_perception, "outline_offsets", lambda *seen: offsets)
    memory = cell_perception._Memory(
        ObservedPose.of((0.1, 0.0, 0.0)), seen=object(), last_pose=np.array([0.1, 0.0, 0.0]),
        rests=Rests((offsets, offsets), np.zeros(3)),
    )  # fmt: skip
    after = cell_perception._Eye(None, 40, 1.0, places)._outlined(memory, None, None, None)
    assert len(after.rests.looks) == counted and (after is memory) == (counted == 0)


def test_a_pose_is_known_half_a_picture_after_the_picture(world):
    context = world.context()
    world.place(context, "hammer", (0.05, -0.02, 0.6))
    simulator = world.simulator(context)
    for after, newest in ((1.4, 0.0), (1.6, 1.0), (2.4, 1.0), (2.6, 2.0)):
        simulator.AdvanceTo((FRAMES + after) * PERIOD)
        said = world.output(context, "object_pose")
        assert said.valid
        assert said.time == pytest.approx((FRAMES + newest) * PERIOD)


def test_the_same_run_twice_is_the_same_to_the_bit(world):
    poses = []
    for _ in range(2):
        context = world.context()
        world.place(context, "wrench", (0.05, -0.02, 0.6))
        world.simulator(context).AdvanceTo((FRAMES + 1.75) * PERIOD)
        poses.append(world.output(context, "object_pose").pose)
    assert np.all(np.isfinite(poses[0]))
    assert np.array_equal(*poses)


def test_no_garbage_is_collected_in_the_thread_that_looks(world, monkeypatch):
    """What it would free there may be a renderer, which only the thread that made it may free."""
    seen = []

    def spied(*args):
        seen.append((threading.current_thread() is threading.main_thread(), gc.isenabled()))
        return track(*args)

    monkeypatch.setattr("slipmap.diagrams.perception.cell_perception.track", spied)
    context = world.context()
    world.place(context, "hammer", (0.05, -0.02, 0.6))
    world.simulator(context).AdvanceTo((FRAMES + 2.75) * PERIOD)
    assert seen == [(False, False)] * 4
    assert gc.isenabled()


def test_nor_is_any_but_the_newest_once_a_picture_was_looked_at(world):
    elsewhere = []

    def note(phase: str, details: dict[str, int]) -> None:
        if phase == "start" and threading.current_thread() is not threading.main_thread():
            elsewhere.append(details["generation"])

    context = world.context()
    world.place(context, "hammer", (0.05, -0.02, 0.6))
    simulator = world.simulator(context)
    threshold = gc.get_threshold()
    gc.callbacks.append(note)
    gc.set_threshold(100, 0, 0)  # each collection is of all generations, but for those asked for
    try:
        simulator.AdvanceTo((FRAMES + 2.75) * PERIOD)
    finally:
        gc.set_threshold(*threshold)
        gc.callbacks.remove(note)
    assert set(elsewhere) <= {0}


def test_hulls_cover_what_the_camera_sees_of_an_arm(world):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.01)
    arm = plant.AddModelInstance("arm")
    parent = plant.world_body()
    shapes = (Box(0.1, 0.06, 0.2), Capsule(0.04, 0.2), Cylinder(0.05, 0.15), Ellipsoid(0.04, 0.06, 0.1))
    for k, shape in enumerate(shapes):
        link = plant.AddRigidBody(f"link{k}", arm, SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        turned = RigidTransform(RollPitchYaw(0.3 * k, 0.4, 0.0), [0.02, 0.0, 0.1])
        plant.RegisterVisualGeometry(link, turned, shape, f"shape{k}", [1.0, 1.0, 1.0, 1.0])
        at = FixedOffsetFrame(f"at{k}", parent.body_frame(), RigidTransform([0.1, 0.05, 0.12 if k else 0.3]))
        plant.AddJoint(RevoluteJoint(f"joint{k}", plant.AddFrame(at), link.body_frame(), [0, 1, 0]))
        parent = link
    plant.Finalize()
    camera = add_camera(builder, plant, scene_graph)
    diagram = builder.Build()
    hulls = ArmHulls(plant, scene_graph, [arm])
    context = diagram.CreateDefaultContext()
    rng = np.random.default_rng(0)
    for _ in range(5):
        q = rng.uniform(-1.5, 1.5, 4)
        plant.SetPositions(plant.GetMyMutableContextFromRoot(context), q)
        port = camera.depth_image_32F_output_port()
        depth = port.Eval(camera.GetMyContextFromRoot(context)).data[:, :, 0]
        visible = np.isfinite(depth)
        mask = draw_hulls(hulls(q), world.view, margin=0.002)
        assert visible.sum() > 5000
        assert np.sum(visible & ~mask) < 5
        assert mask.sum() < 1.15 * visible.sum()
    with pytest.raises(ValueError, match="at least"):
        ArmHulls(plant, scene_graph, [])


def test_a_number_of_cells_below_one_is_refused():
    with pytest.raises(ValueError, match="cells"):
        CellPerception(cells=0)
