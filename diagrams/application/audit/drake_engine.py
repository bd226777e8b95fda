"""Drake under audit: a rigid body with one foot per cell."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    CollisionFilterDeclaration,
    Convex,
    GeometrySet,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import PrismaticJoint, RotationalInertia, SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.application.audit.engines import EngineScene
from slipmap.models.physics.cell_grid import FloatArray

_FOOT = 5e-4  # m, radius
_HEIGHT = 2e-3  # m, of the object's centre of mass and of the finger's centre above the table
_SINK = 2e-5  # m; penetration of every foot under the weight of its cell
_CLEARANCE = 1e-4  # m, between the table and the sides that the finger touches
_SIDE = 0.02  # m, height of the sides
_TABLE_FRICTION, _FINGER_FRICTION = 10.0, 10.0

_DISSIPATION = 20.0  # s/m
_RIGID = 1e9  # N/m, so that the other body determines the stiffness of a contact
_FINGER_MASS = 1e3  # kg; nothing in the scene moves it
_PLATE = 1e-3  # m, thickness of a cell's plate in hydroelastic contact
_MODULUS = 1e6  # Pa
_RESOLUTION = 9e-3  # m


class DrakeEngine:
    """Drake's MultibodyPlant with point contact: one foot per cell, as stiff as its cell is heavy."""

    dt: ClassVar[float] = 2e-3
    approximation: ClassVar[str] = "lagged"  # of contact, Drake's default
    hydroelastic: ClassVar[bool] = False  # a soft plate per cell instead of feet
    # m/s, below which friction lets an object creep; Drake's default is 1e-3
    stiction: ClassVar[float] = 1e-5

    def __init__(self, scene: EngineScene, gravity: FloatArray) -> None:
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(
            time_step=self.dt,
            contact_model="hydroelastic_with_fallback" if self.hydroelastic else "point",
            discrete_contact_approximation=self.approximation,
            stiction_tolerance=self.stiction,
        )
        plant, scene_graph = AddMultibodyPlant(config, builder)
        plant.mutable_gravity_field().set_gravity_vector(gravity)
        table = _contact(_TABLE_FRICTION)
        if self.hydroelastic:
            AddRigidHydroelasticProperties(20.0, table)
        # A half space would do, but Drake warns about it.
        X_WT, top = RigidTransform([0.0, 0.0, -0.5]), Box(20.0, 20.0, 1.0)
        ground = plant.RegisterCollisionGeometry(plant.world_body(), X_WT, top, "table", table)
        self._add_object(plant, scene)
        self._add_finger(plant, scene)
        plant.Finalize()
        finger = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("finger"))
        feet, sides = GeometrySet(self._feet), GeometrySet(self._sides)
        table_set, tip = GeometrySet([ground]), GeometrySet(finger)
        for one, other in ((table_set, sides), (tip, feet), (tip, table_set)):
            rule = CollisionFilterDeclaration().ExcludeBetween(one, other)
            scene_graph.collision_filter_manager().Apply(rule)
        self._plant, self._object = plant, plant.GetBodyByName("object")
        self._simulator = Simulator(builder.Build())
        self._root = self._simulator.get_mutable_context()
        self._context = plant.GetMyMutableContextFromRoot(self._root)

    def reset(self, pose: FloatArray, velocity: FloatArray, tip: FloatArray) -> None:
        """See `Engine`."""
        self._root.SetTime(0.0)
        X_WO = RigidTransform(RollPitchYaw(0, 0, pose[2]), [*pose[:2], -self._sink])
        self._plant.SetFreeBodyPose(self._context, self._object, X_WO)
        rates = np.array([0, 0, velocity[2], velocity[0], velocity[1], 0])
        self._plant.SetVelocities(self._context, self._object.model_instance(), rates)
        self._plant.SetPositions(self._context, self._instance, tip)
        self._plant.SetVelocities(self._context, self._instance, np.zeros(2))
        self._simulator.Initialize()
        self._steps = 0

    def step(
        self, tip: FloatArray, tip_velocity: FloatArray, next_tip: FloatArray, next_velocity: FloatArray
    ) -> FloatArray:
        """See `Engine`."""
        speed = (next_tip - tip) / self.dt
        self._plant.SetPositions(self._context, self._instance, tip)
        self._plant.SetVelocities(self._context, self._instance, speed)
        self._steps += 1
        self._simulator.AdvanceTo(self._steps * self.dt)
        after = self._plant.GetVelocities(self._context, self._instance)
        return np.asarray(_FINGER_MASS / self.dt * (speed - after))

    def pose(self) -> FloatArray:
        """See `Engine`."""
        cos, _, _, sin, x, y, _ = self._plant.GetPositions(self._context, self._object.model_instance())
        return np.array([x, y, 2 * np.arctan2(sin, cos)])

    def _add_object(self, plant: MultibodyPlant, scene: EngineScene) -> None:
        instance = plant.AddModelInstance("object")
        center = np.array([*scene.center_of_mass, _HEIGHT])
        away, mass = scene.grid.centers - center[:2], float(scene.mass.sum())
        own = scene.grid.width**2 / 12
        inertia = RotationalInertia(
            scene.mass @ (away[:, 1] ** 2 + own), scene.mass @ (away[:, 0] ** 2 + own),
            scene.moment_of_inertia, -scene.mass @ (away[:, 0] * away[:, 1]), 0.0, 0.0,
        )  # fmt: skip
        unit = UnitInertia().SetFromRotationalInertia(inertia, mass)
        body = plant.AddRigidBody("object", instance, SpatialInertia(mass, np.zeros(3), unit).Shift(-center))
        self._feet, self._sides = [], []
        self._sink = (
            scene.mass.mean() * 9.81 * _PLATE / _MODULUS / scene.grid.width**2 if self.hydroelastic else _SINK
        )
        for cell, (place, weight, mu) in enumerate(
            zip(scene.grid.centers, 9.81 * scene.mass, scene.mu, strict=True)
        ):
            # Drake combines two coefficients to 2 μ₁ μ₂ / (μ₁ + μ₂).
            friction = mu * _TABLE_FRICTION / (2 * _TABLE_FRICTION - mu)
            if self.hydroelastic:
                properties = _contact(friction)
                modulus = weight / scene.grid.width**2 * _PLATE / self._sink
                AddCompliantHydroelasticProperties(_RESOLUTION, modulus, properties)
                shape, z = Box(scene.grid.width, scene.grid.width, _PLATE), _PLATE / 2
            else:
                properties = _contact(friction, weight / _SINK)
                shape, z = Sphere(_FOOT), _FOOT
            self._feet.append(
                plant.RegisterCollisionGeometry(
                    body, RigidTransform([*place, z]), shape, f"foot {cell}", properties
                )
            )
        properties = _contact(scene.mu_finger * _FINGER_FRICTION / (2 * _FINGER_FRICTION - scene.mu_finger))
        for k, piece in enumerate(scene.pieces):
            corners = np.array([[*corner, z] for z in (_CLEARANCE, _SIDE) for corner in piece]).T
            self._sides.append(
                plant.RegisterCollisionGeometry(
                    body, RigidTransform(), Convex(points=corners, label=f"side {k}"), f"side {k}", properties
                )
            )

    def _add_finger(self, plant: MultibodyPlant, scene: EngineScene) -> None:
        self._instance = plant.AddModelInstance("finger")
        heavy = SpatialInertia(_FINGER_MASS, np.zeros(3), UnitInertia.SolidSphere(scene.finger_radius))
        carriage = plant.AddRigidBody("carriage", self._instance, SpatialInertia.Zero())
        finger = plant.AddRigidBody("finger", self._instance, heavy)
        frames = (plant.world_frame(), carriage.body_frame(), finger.body_frame())
        for name, axis, parent, child in zip("xy", np.eye(3), frames, frames[1:], strict=False):
            plant.AddJoint(PrismaticJoint(f"finger {name}", parent, child, axis))
        properties = _contact(_FINGER_FRICTION, 9.81 * float(scene.mass.sum()) / 1e-5)
        X_FG = RigidTransform([0, 0, _HEIGHT])
        plant.RegisterCollisionGeometry(finger, X_FG, Sphere(scene.finger_radius), "tip", properties)
        plant.set_gravity_enabled(self._instance, False)


def _contact(friction: float, stiffness: float = _RIGID) -> ProximityProperties:
    """Properties with a friction, and a stiffness, N/m."""
    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=_DISSIPATION, point_stiffness=stiffness, friction=CoulombFriction(friction, friction),
        properties=properties,
    )  # fmt: skip
    return properties
