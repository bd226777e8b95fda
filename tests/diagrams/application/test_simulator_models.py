"""What was learned, read back into other simulators: the body is right, a push ends where slipmap says."""

import numpy as np
import pytest

from slipmap.diagrams.application.simulator_models import body_of, convex_parts, export_belief
from slipmap.models.files import BadInput
from slipmap.models.geometry import placed
from slipmap.models.inference.belief import Belief
from slipmap.models.objects.benchmark_objects import hammer
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps, Slider, Smoothing
from slipmap.planners.exploration import candidate_pushes

RADIUS, HEIGHT, LOW = 0.008, 0.02, 0.006  # m; the finger pushes that low
START = np.array([0.0, 0.0, 0.3])
TOLERATED = 2e-3  # m


@pytest.fixture(scope="module")
def belief():
    grid, truth = hammer()
    heavier = Maps(1.5 * truth.mass, truth.mu, truth.mu_finger)
    maps = Maps(
        *(np.concatenate([getattr(m, k) for m in (truth, heavier)]) for k in ("mass", "mu", "mu_finger"))
    )
    return Belief(
        grid, RADIUS, 9.81, maps, np.array([1.0, 0.0]), Smoothing(), "a hammer", "", "gauss-newton", 0
    )


@pytest.fixture(scope="module", params=range(5))
def push(request, belief):
    drawn = candidate_pushes(belief.grid, RADIUS, np.random.default_rng(7), 10, length=(0.03, 0.07))
    pushes = [candidate.push(START) for candidate in drawn]
    return [push for push in pushes if moved(belief, end_of(belief, push)) > 0.03][request.param]


def end_of(belief, push):
    """Where slipmap expects the object after a push."""
    return Slider(belief.grid, RADIUS).rollout(belief.maps, [push]).poses_of(0)[0][-1]


def moved(belief, pose, start=START):
    """ADD between two poses, m."""
    return np.hypot(*(placed(belief.grid.centers, pose) - placed(belief.grid.centers, start)).T).mean()


def inertia_of_cells(belief, k):
    """Mass, centre and inertia about it of cells as upright boxes, by brute force over many points."""
    mass, centers, width = belief.maps.mass[k], belief.grid.centers, belief.grid.width
    steps = (np.arange(20) + 0.5) / 20 - 0.5
    x, y, z = (part.ravel() for part in np.meshgrid(width * steps, width * steps, HEIGHT * (steps + 0.5)))
    points = np.concatenate([np.column_stack([cx + x, cy + y, z]) for cx, cy in centers])
    weights = np.repeat(mass / len(x), len(x))
    com = weights @ points / weights.sum()
    away = points - com
    second = (away.T * weights) @ away
    return weights.sum(), com, np.trace(second) * np.eye(3) - second


def test_a_sliding_object_is_braked_as_by_its_cells(tmp_path):
    """Thrown over MuJoCo's floor, it stops where friction of one coefficient lets it: v² / (2 μ g)."""
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo comes with the extra `bench`")
    grid, truth = hammer()
    even = Maps(truth.mass, np.full_like(truth.mu, 0.25), truth.mu_finger)
    belief = Belief(grid, RADIUS, 9.81, even, np.ones(1), Smoothing(), "even", "", "gauss-newton", 0)
    (path,) = export_belief(belief, "mjcf", tmp_path / "models", height=HEIGHT)
    spec = mujoco.MjSpec.from_file(str(path))
    spec.option.timestep, spec.option.impratio = 1e-3, 10.0
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1])
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[0] = 0.5
    for _ in range(500):
        mujoco.mj_step(model, data)
    assert data.qpos[0] == pytest.approx(0.5**2 / (2 * 0.25 * 9.81), rel=0.03)
    assert abs(data.qpos[1]) < 1e-3


def test_feet_carry_equal_loads_and_rub_as_their_parts(belief):
    body = body_of(belief, 0, HEIGHT)
    load = body.mass * 9.81 / len(body.feet)
    rubbing = load * body.friction
    cells = belief.maps.mass[0] * belief.maps.mu[0] * 9.81
    centers = belief.grid.centers
    assert body.feet.mean(axis=0) == pytest.approx(body.com[:2], abs=1e-9)
    assert rubbing.sum() == pytest.approx(cells.sum())
    middle = cells @ centers / cells.sum()
    assert rubbing @ body.feet / rubbing.sum() == pytest.approx(middle, abs=1e-3)
    arms = [f @ np.hypot(*(p - middle).T) / f.sum() for f, p in ((rubbing, body.feet), (cells, centers))]
    assert arms[0] == pytest.approx(arms[1], rel=0.03)


@pytest.mark.parametrize("kind", ["sdf", "urdf"])
def test_drake_reads_the_body(tmp_path, belief, kind):
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    paths = export_belief(belief, kind, tmp_path / "models", height=HEIGHT, hypotheses=True)
    assert [path.name for path in paths] == [f"a_hammer_00.{kind}", f"a_hammer_01.{kind}"]
    for k, path in enumerate(paths):
        plant = MultibodyPlant(1e-3)
        Parser(plant).AddModels(str(path))
        plant.Finalize()
        body = plant.GetBodyByName("a_hammer")
        found = body.CalcSpatialInertiaInBodyFrame(plant.CreateDefaultContext())
        mass, com, inertia = inertia_of_cells(belief, k)
        assert found.get_mass() == pytest.approx(mass)
        assert found.get_com() == pytest.approx(com, abs=1e-9)
        about = found.Shift(found.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
        assert about == pytest.approx(inertia, rel=5e-3, abs=1e-6)


def test_a_push_in_drake(tmp_path, belief, push):
    from pydrake.geometry import Box, Cylinder
    from pydrake.math import RigidTransform, RollPitchYaw
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
    from pydrake.multibody.tree import PdControllerGains, PrismaticJoint, SpatialInertia
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import TrajectorySource
    from pydrake.trajectories import PiecewisePolynomial

    (path,) = export_belief(belief, "sdf", tmp_path / "models", height=HEIGHT)
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    Parser(plant).AddModels(str(path))
    one = CoulombFriction(1.0, 1.0)
    plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform([0, 0, -0.5]), Box(4, 4, 1), "table", one
    )
    finger = plant.AddModelInstance("finger")
    ball = SpatialInertia.SolidSphereWithMass(1.0, 0.01)
    along, across = (plant.AddRigidBody(name, finger, ball) for name in ("along", "across"))
    joints = [
        plant.AddJoint(PrismaticJoint("x", plant.world_frame(), along.body_frame(), [1, 0, 0])),
        plant.AddJoint(PrismaticJoint("y", along.body_frame(), across.body_frame(), [0, 1, 0])),
    ]
    plant.RegisterCollisionGeometry(across, RigidTransform([0, 0, LOW]), Cylinder(RADIUS, LOW), "rod", one)
    for joint in joints:
        plant.AddJointActuator(joint.name(), joint).set_controller_gains(PdControllerGains(p=1e6, d=2e3))
    plant.Finalize()
    time = push.h * np.arange(len(push.tip))
    source = builder.AddSystem(TrajectorySource(PiecewisePolynomial.FirstOrderHold(time, push.tip.T), 1))
    builder.Connect(source.get_output_port(), plant.get_desired_state_input_port(finger))
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    body = plant.GetBodyByName("a_hammer")
    plant.SetFreeBodyPose(context, body, RigidTransform(RollPitchYaw(0, 0, START[2]), [0, 0, 0]))
    for joint, place in zip(joints, push.tip[0], strict=True):
        joint.set_translation(context, place)
    simulator.AdvanceTo(time[-1])
    pose = plant.EvalBodyPoseInWorld(context, body)
    yaw = RollPitchYaw(pose.rotation()).yaw_angle()
    assert moved(belief, np.array([*pose.translation()[:2], yaw]), end_of(belief, push)) < TOLERATED


def test_a_push_in_mujoco(tmp_path, belief, push):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo comes with the extra `bench`")
    (path,) = export_belief(belief, "mjcf", tmp_path / "models", height=HEIGHT)
    spec = mujoco.MjSpec.from_file(str(path))
    spec.option.timestep, spec.option.impratio = 1e-3, 10.0
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1])
    finger = spec.worldbody.add_body(name="finger", pos=[0, 0, LOW])
    finger.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[RADIUS, 0.5 * LOW, 0], mass=1e3)
    for axis in ([1, 0, 0], [0, 1, 0]):
        finger.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    model = spec.compile()
    data = mujoco.MjData(model)
    mass, com, inertia = inertia_of_cells(belief, 0)
    number = model.body("a_hammer").id
    assert model.body_mass[number] == pytest.approx(mass)
    assert model.body_ipos[number] == pytest.approx(com, abs=1e-9)
    assert np.sort(model.body_inertia[number]) == pytest.approx(np.linalg.eigvalsh(inertia), rel=5e-3)
    data.qpos[:7] = [0, 0, 0, np.cos(0.5 * START[2]), 0, 0, np.sin(0.5 * START[2])]
    assert push.h == pytest.approx(model.opt.timestep)
    for now, after in zip(push.tip[:-1], push.tip[1:], strict=True):
        data.qpos[7:], data.qvel[6:] = now, (after - now) / push.h
        mujoco.mj_step(model, data)
    yaw = 2.0 * np.arctan2(data.qpos[6], data.qpos[3])
    assert moved(belief, np.array([*data.qpos[:2], yaw]), end_of(belief, push)) < TOLERATED


@pytest.mark.parametrize(
    "exterior",
    [
        [[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]],
        [[np.cos(a), np.sin(a)] for a in np.linspace(0, 2 * np.pi, 24, endpoint=False)],
        [[0, 0], [3, 0], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]],
    ],
    ids=["L", "round", "U"],
)
def test_parts_are_convex_and_leave_no_gap(exterior):
    grid = CellGrid(np.array([[0.5, 0.5]]), 0.1, np.array(exterior, dtype=float))
    parts = convex_parts(grid)
    areas = []
    for part in parts:
        sides = np.roll(part, -1, axis=0) - part
        turn = sides[:, 0] * np.roll(sides[:, 1], -1) - sides[:, 1] * np.roll(sides[:, 0], -1)
        assert (turn > -1e-12).all(), "counter-clockwise, so that faces of the prism look outward"
        x, y = part.T
        areas.append(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    assert sum(areas) == pytest.approx(grid.polygon.area)
    assert len(parts) <= 3


@pytest.mark.parametrize("wrong", [{"to": "SDF"}, {"height": 1e-3}, {"height": float("nan")}])
def test_what_makes_no_model_is_refused(tmp_path, belief, wrong):
    with pytest.raises(BadInput):
        export_belief(belief, **({"to": "sdf"} | wrong), folder=tmp_path / "models")
    assert not (tmp_path / "models").exists()


def test_a_folder_that_holds_something_is_left_alone(tmp_path, belief):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(BadInput, match="name a new folder"):
        export_belief(belief, "sdf", tmp_path)
