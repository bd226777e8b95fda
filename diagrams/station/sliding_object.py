"""The true object in Drake: one rigid body on many small feet, each with its own friction."""

from itertools import groupby

import numpy as np
from pydrake import geometry
from pydrake.common import MemoryFile
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import ModelInstanceIndex, SpatialInertia, UnitInertia
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from slipmap.models.objects.footprints import convex_pieces, without_scan_noise
from slipmap.models.objects.meshes import shaded_obj
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.physics.cell_grid import FloatArray

GRAVITY = 9.81  # default gravity, m/s²
BODY = "object"  # name of the body and of the model instance's only link
DISC = "disc"  # name of the body with the surface of a round table that feet touch; see `add_table`
FINGER_FRICTION = 0.3  # friction coefficient of the finger's own geometry, as in its model file
STICTION = 1e-4  # speed below which friction lets an object creep, m/s
_SINK = 4e-6
"""Depth to which the feet of the lightest cell would sink in under the weight of a mean cell, m; see
`sink_of`."""

CLEARANCE = 1e-4  # between the table and the blocks and walls above it, m
_FOOT_RADIUS = 5e-4  # m; lower than any finger over the table
_BLOCK_SINK = 5e-5  # m; of a block under the weight of the whole object
_TABLE_STIFFNESS = 1e8  # N/m
_HARDEST = 0.1  # greatest stiffness of a foot, as a share of the table's
_DISSIPATION = 20.0  # s/m

# Four points on the diagonals at this distance from the centre (in cell widths) resist spinning like the
# whole square: the mean distance of a square's points from its centre, (√2 + ln(1 + √2)) / 6.
_FOOT_DISTANCE = (np.sqrt(2) + np.log(1 + np.sqrt(2))) / 6
FEET = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * _FOOT_DISTANCE / np.sqrt(2)
"""(f, 2) places of a cell's feet, from its centre, in widths of a cell. With fewer, an object whose centre of
mass is between the last row of feet and the table's edge leans on its blocks at that edge."""


def plant_config(time_step: float) -> MultibodyPlantConfig:
    """Settings under which the object slides according to Coulomb's law.

    With the `lagged` approximation, a body of nine cells turns within 0.4° of the exact solution at steps of
    1 to 5 ms. Friction falls to zero below the stiction tolerance, which must be small compared with a push's
    speed.
    """
    return MultibodyPlantConfig(
        time_step=time_step,
        contact_model="point",
        discrete_contact_approximation="lagged",
        stiction_tolerance=STICTION,
    )


def table_contact(friction: float) -> geometry.ProximityProperties:
    """Contact properties of the table: hard, so that only the feet yield."""
    return _contact(_TABLE_STIFFNESS, friction)


def _contact(
    stiffness: float, friction: float, dissipation: float = _DISSIPATION
) -> geometry.ProximityProperties:
    properties = geometry.ProximityProperties()
    geometry.AddContactMaterial(
        dissipation=dissipation,
        point_stiffness=stiffness,
        friction=CoulombFriction(friction, friction),
        properties=properties,
    )
    return properties


def partner_friction(wanted: FloatArray, given: float, what: str) -> FloatArray:
    """Coefficients for which Drake's rule 2 μ₁ μ₂ / (μ₁ + μ₂) gives the wanted ones with a given partner.

    Args:
        wanted: (k,) coefficients of the pairs.
        given: coefficient of the other body.
        what: the pairs, for the message.

    Raises:
        ValueError: a wanted coefficient is twice the given one or more, which no partner can reach.
    """
    wanted = np.asarray(wanted, dtype=float)
    worst = float(wanted.max())
    if not worst < 2 * given:
        raise ValueError(
            f"{what}: a friction coefficient of {worst:.3g} cannot be reached on a surface with {given:.3g}, "
            f"as Drake combines two to 2 μ₁ μ₂ / (μ₁ + μ₂); give the surface more than {worst / 2:.3g}"
        )
    return wanted * given / (2 * given - wanted)


def foot_frictions(true_object: TrueObject, table_friction: float) -> FloatArray:
    """(n,) own coefficients of the cells' feet. Raises ValueError as `partner_friction`."""
    return partner_friction(true_object.mu, table_friction, f"object {true_object.name} on the table")


def side_contact(
    true_object: TrueObject, gravity: float, sink: float = _BLOCK_SINK, dissipation: float = _DISSIPATION
) -> geometry.ProximityProperties:
    """Contact properties of the object's side, which a finger touches; by default those of blocks.

    Args:
        gravity: m/s², which determines the stiffness.
        sink: depth to which the whole object would sink in under its weight, m.
        dissipation: Hunt and Crossley's, s/m.

    Raises:
        ValueError: see `partner_friction`.
    """
    wanted = np.array([true_object.mu_finger])
    (mu,) = partner_friction(wanted, FINGER_FRICTION, f"object {true_object.name} at the finger")
    return _contact(true_object.total_mass * gravity / sink, mu, dissipation)


def connect_motion(builder: DiagramBuilder, plant: MultibodyPlant, system: LeafSystem) -> None:
    """Connect the plant's `body_poses` and `body_spatial_velocities` to a system's ports of these names."""
    for name in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), system.GetInputPort(name))


def add_sliding_object(
    plant: MultibodyPlant, true_object: TrueObject, table_friction: float
) -> ModelInstanceIndex:
    """Add an object to the plant as a free body named "object", in a model instance of that name.

    Body frame and object frame coincide. Each cell stands on feet (small spheres) that have the cell's
    friction with the table. The stiffness of a foot is proportional to its cell's mass: all sink in equally,
    so that at rest each carries the weight of its cell. The gripper, and the table's edge once the object
    tips over it, touch the object's blocks, which end a little above the table; see `finger_contact` for
    pushes.

    Args:
        plant: registered with a scene graph, not finalized, with any round table already in it; see
            `plant_config`. Its gravity determines the stiffness of the feet.
        table_friction: of the table's own geometry (`table_contact`).

    Raises:
        ValueError: a friction that Drake's rule cannot reach with the given surfaces.
    """
    foot_mu = foot_frictions(true_object, table_friction)
    instance = plant.AddModelInstance(BODY)
    body = plant.AddRigidBody(BODY, instance, spatial_inertia(true_object))
    grid, gravity = true_object.grid, -float(plant.gravity_field().gravity_vector()[2])
    side = side_contact(true_object, gravity)
    sink = sink_of(true_object)
    foot_shapes, block_shapes = [], []
    for cell, (center, mass) in enumerate(zip(grid.centers, true_object.mass, strict=True)):
        wanted = mass * gravity / len(FEET) / sink
        contact = _contact(wanted * _TABLE_STIFFNESS / (_TABLE_STIFFNESS - wanted), foot_mu[cell])
        for foot, place in enumerate(center + grid.width * FEET):
            X_OF = RigidTransform(np.array([*place, _FOOT_RADIUS]))
            name_of_foot = f"cell_{cell}_foot_{foot}"
            foot_shapes.append(
                plant.RegisterCollisionGeometry(
                    body, X_OF, geometry.Sphere(_FOOT_RADIUS), name_of_foot, contact
                )
            )
    for index, points in enumerate(_block_corners(true_object)):
        shape = geometry.Convex(points=points, label=f"{true_object.name} block {index}")
        block_shapes.append(
            plant.RegisterCollisionGeometry(body, RigidTransform(), shape, f"block_{index}", side)
        )
    _share_round_table(plant, foot_shapes, block_shapes)
    for index, (color, mesh) in enumerate(_colored_meshes(true_object)):
        plant.RegisterVisualGeometry(body, RigidTransform(), mesh, f"look_{index}", color)
    plant.SetDefaultFloatingBaseBodyPose(body, resting_pose(0.0, 0.0, 0.0, sink=sink))
    return instance


def sink_of(true_object: TrueObject) -> float:
    """Depth to which every foot sinks in under the load of its own cell, m.

    At the rim of a table light cells may carry hundreds of times their weight. Where they sink in far, an
    object leans there on its blocks, which have the finger's friction. Where feet are stiffer than need be,
    loads jump between them as the object rocks, and friction, which `lagged` contact computes from the loads
    of the step before, is wrong meanwhile. No foot may be nearly as stiff as the table.
    """
    mass = true_object.mass
    least = float(mass.max()) * GRAVITY / len(FEET) / (_HARDEST * _TABLE_STIFFNESS)
    return max(_SINK * float(mass.min() / mass.mean()), least)


def resting_pose(x: float, y: float, angle: float, *, sink: float = 0.0) -> RigidTransform:
    """X_WO of an object on a level table.

    With `sink` from `sink_of`, every foot carries the load of its cell; with 0, feet just touch.
    """
    return RigidTransform(RollPitchYaw(0.0, 0.0, angle), np.array([x, y, -sink]))


def spatial_inertia(true_object: TrueObject) -> SpatialInertia:
    """Inertia about the object frame's origin, with the cells as solid boxes of their height."""
    width = true_object.grid.width
    total = SpatialInertia.Zero()
    for center, mass, height in zip(
        true_object.grid.centers, true_object.mass, true_object.height, strict=True
    ):
        box = UnitInertia.SolidBox(width, width, height)
        p_OC = np.array([*center, height / 2])
        total += SpatialInertia(mass, np.zeros(3), box).Shift(-p_OC)
    return total


def _share_round_table(
    plant: MultibodyPlant, feet: list[geometry.GeometryId], blocks: list[geometry.GeometryId]
) -> None:
    """Let feet touch the disc of a round table, and blocks the rest of it."""
    if not plant.HasBodyNamed(DISC):
        return
    disc, table = (
        geometry.GeometrySet(plant.GetCollisionGeometriesForBody(plant.GetBodyByName(name)))
        for name in (DISC, "table")
    )
    # The plant does not expose its scene graph, but a parser does.
    declaration = geometry.CollisionFilterDeclaration()
    declaration.ExcludeBetween(geometry.GeometrySet(feet), table)
    declaration.ExcludeBetween(geometry.GeometrySet(blocks), disc)
    Parser(plant).scene_graph().collision_filter_manager().Apply(declaration)


def _block_corners(true_object: TrueObject) -> list[FloatArray]:
    result = []
    for block in true_object.blocks:
        for piece in convex_pieces(without_scan_noise(block.outline)):
            ring = np.asarray(piece.exterior.coords)[:-1].T
            ends = [np.vstack([ring, np.full(ring.shape[1], z)]) for z in (CLEARANCE, block.height)]
            result.append(np.hstack(ends))
    return result


def _colored_meshes(true_object: TrueObject) -> list[tuple[FloatArray, geometry.Mesh]]:
    mesh = true_object.mesh
    colors = np.asarray(mesh.visual.face_colors)
    order = np.lexsort(colors.T)
    result: list[tuple[FloatArray, geometry.Mesh]] = []
    for color, group in groupby(order, key=lambda face: tuple(colors[face])):
        part = mesh.submesh([list(group)], append=True)
        file = MemoryFile(shaded_obj(part), ".obj", f"{true_object.name}, colour {len(result)}")
        result.append((np.array(color) / 255, geometry.Mesh(geometry.InMemoryMesh(mesh_file=file))))
    return result
