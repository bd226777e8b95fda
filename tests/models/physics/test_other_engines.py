"""The same push in Drake: a rigid body on many contact points, against the cell grid."""

from __future__ import annotations

import numpy as np
import pytest
from sliding_objects import finger_push, line, rectangle

from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Maps, Slider

pytest.importorskip("pydrake", reason="the comparison runs in Drake")

from pydrake.geometry import (
    AddContactMaterial,
    Box,
    CollisionFilterDeclaration,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

FINGER_RADIUS = 0.01
HALF_HEIGHT = 0.001
STIFFNESS = 1e5
MU_TABLE = 1.0


def material(mu: float) -> ProximityProperties:
    properties = ProximityProperties()
    friction = CoulombFriction(mu, mu)
    AddContactMaterial(point_stiffness=STIFFNESS, dissipation=10.0, friction=friction, properties=properties)
    return properties


def against_table(mu: float) -> ProximityProperties:
    """Material of friction `mu` with the table, as Drake combines two coefficients to 2 a b / (a + b)."""
    return material(mu * MU_TABLE / (2 * MU_TABLE - mu))


def drake_push(
    grid: CellGrid, mass: float, mu: FloatArray, mu_finger: float, tip: FloatArray, duration: float
) -> FloatArray:
    """Last pose (x, y, θ) of a flat box on four spheres a cell; a heavy sphere pushes from tip[0] to tip[1].

    The box is so flat and pushed so low that no load shifts between its cells; its mass is even, so each of
    the equally stiff spheres carries the same.
    """
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(time_step=1e-3, discrete_contact_approximation="lagged")
    plant, scene_graph = AddMultibodyPlant(config, builder)
    table = plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform(), HalfSpace(), "table", material(MU_TABLE)
    )

    size = np.ptp(grid.exterior, axis=0)
    body = plant.AddRigidBody(
        "object", SpatialInertia(mass, np.zeros(3), UnitInertia.SolidBox(size[0], size[1], 0.0))
    )
    outline = plant.RegisterCollisionGeometry(
        body, RigidTransform(), Box(*size, 2 * HALF_HEIGHT), "outline", material(mu_finger)
    )
    # Points at the radius of gyration of a square resist a spin like the cell.
    offsets = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * grid.width / np.sqrt(12)
    feet = [
        plant.RegisterCollisionGeometry(
            body,
            RigidTransform([*(center + offset), 0.0]),
            Sphere(HALF_HEIGHT),
            f"foot {k} {corner}",
            against_table(friction),
        )
        for k, (center, friction) in enumerate(zip(grid.centers, mu, strict=True))
        for corner, offset in enumerate(offsets)
    ]

    model = plant.AddModelInstance("finger")
    # So heavy that it keeps its speed.
    heavy = SpatialInertia(1e6, np.zeros(3), UnitInertia.SolidSphere(FINGER_RADIUS))
    carriage = plant.AddRigidBody("carriage", model, heavy)
    finger = plant.AddRigidBody("finger", model, heavy)
    joints = (
        plant.AddJoint(PrismaticJoint("x", plant.world_frame(), carriage.body_frame(), [1, 0, 0])),
        plant.AddJoint(PrismaticJoint("y", carriage.body_frame(), finger.body_frame(), [0, 1, 0])),
    )
    ball = plant.RegisterCollisionGeometry(
        finger, RigidTransform([0, 0, HALF_HEIGHT / 2]), Sphere(FINGER_RADIUS), "tip", material(mu_finger)
    )
    plant.set_gravity_enabled(model, False)
    plant.Finalize()

    filters = scene_graph.collision_filter_manager()
    for one, others in ((table, [outline, ball]), (ball, feet)):
        rule = CollisionFilterDeclaration().ExcludeBetween(GeometrySet(one), GeometrySet(others))
        filters.Apply(rule)
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetFreeBodyPose(context, body, RigidTransform([0, 0, HALF_HEIGHT]))
    for joint, first, last in zip(joints, *tip, strict=True):
        joint.set_translation(context, first)
        joint.set_translation_rate(context, (last - first) / duration)
    simulator.AdvanceTo(duration)
    reached = [joint.get_translation(context) for joint in joints]
    assert reached == pytest.approx(tip[1], abs=1e-5)
    pose = plant.EvalBodyPoseInWorld(context, body)
    turn = pose.rotation().matrix()
    return np.array([*pose.translation()[:2], np.arctan2(turn[1, 0], turn[0, 0])])


@pytest.mark.parametrize(
    ("mu_finger", "angle"), [pytest.param(0.15, 0.5, id="slips"), pytest.param(0.8, 0.2, id="sticks")]
)
def test_a_push_of_8_cm_ends_where_drake_ends(mu_finger: float, angle: float) -> None:
    grid = rectangle(5, 3, 0.02)
    mu = np.random.default_rng(14).uniform(0.2, 0.6, len(grid))
    mass, duration, h = 0.6, 1.6, 2e-3
    start = np.array([-0.05 - FINGER_RADIUS - 1e-4, 0.012])
    end = start + 0.08 * np.array([np.cos(angle), np.sin(angle)])
    expected = drake_push(grid, mass, mu, mu_finger, np.array([start, end]), duration)

    maps = Maps(np.full(len(grid), mass / len(grid)), mu, np.array([mu_finger]))
    push = finger_push(line(start, (end - start) / duration, duration, h), h)
    pose = Slider(grid, FINGER_RADIUS).rollout(maps, [push]).poses[0, -1]
    assert abs(expected[2]) > np.deg2rad(15)
    assert pose[:2] == pytest.approx(expected[:2], abs=1e-3)
    assert pose[2] == pytest.approx(expected[2], abs=np.deg2rad(0.5))
