"""Contact between a round finger and the object's side, with exact normals.

Drake finds contacts of a convex shape, or of a cylinder, by an iterative search that misses the normal by
tens of degrees wherever a finger touches a corner, and where two convex shapes meet in one straight side.
Only a ball and a box have a closed form. So the finger pushes with a ball at the height where it touches, and
the object is touched at thin boxes along its outline, its walls. Neither touches anything else.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import shapely
from pydrake import geometry
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody

from slipmap.diagrams.station.arm import Arm
from slipmap.diagrams.station.sliding_object import BODY, CLEARANCE, FINGER_FRICTION, side_contact
from slipmap.models.objects.footprints import without_scan_noise
from slipmap.models.objects.true_object import TrueObject

_THICKNESS = 1e-5
"""m. At a corner sharper than a right angle, the end of a wall sticks out by less than this. A ball may sink
in much deeper, since its centre stays outside."""

YIELD_AT_ARM = 2e-4
"""Depth to which a wall would yield under the weight of the object, m, for the finger of an arm.

`lagged` contact computes friction from the load of the step before. On harder walls, or with more
dissipation, loads change from step to step: the finger of the arm, which gives way a little upwards, then
lifts the side of the object by more than friction allows, and light or low objects rock for whole pushes.
"""

YIELD_AT_RIGID_FINGER = 2e-5
"""The same for a finger that cannot give way, m: nothing rocks, and the walls may be hard. Soft ones push on
while the finger brakes, so that a light object that is tapped slides 1 % too far."""

_DISSIPATION = 2.0  # of the walls, s/m
_USUAL = 0.75  # force of a push, as a share of what makes the object slide without turning
_SEAM = 1e-6  # m, by which blocks may be apart that share a side
_SHORTEST = 1e-5  # m, side of an outline


def push_with_balls(
    plant: MultibodyPlant,
    true_object: TrueObject,
    balls: Sequence[tuple[RigidBody, np.ndarray]],
    radius: float,
    contact: geometry.ProximityProperties,
    *,
    wall_yield: float = YIELD_AT_ARM,
    instead_of: Sequence[geometry.GeometryId] = (),
) -> None:
    """Let the object be pushed by balls at its walls; the last step before the plant is finalized.

    Args:
        plant: with the object of `add_sliding_object`, the finger, and all else that has a shape.
        true_object: the object.
        balls: bodies of the finger, and the centres (3,) of their balls in these bodies' frames, m.
        radius: of the finger, m; the balls are larger by `skin_of` the object.
        contact: stiffness of the balls if any, and a friction coefficient of `FINGER_FRICTION`.
        wall_yield: depth to which a wall would yield under the object's weight, m.
        instead_of: the finger's shapes that no longer touch the object's blocks.

    Raises:
        ValueError: a friction that Drake's rule cannot reach.
    """
    body = plant.GetBodyByName(BODY)
    # Sets copy the shapes' ids, which Drake moves when it registers more.
    blocks = geometry.GeometrySet(plant.GetCollisionGeometriesForBody(body))
    others = geometry.GeometrySet(list(instead_of))
    for index in range(plant.num_bodies()):
        others.Add(geometry_ids=plant.GetCollisionGeometriesForBody(plant.get_body(BodyIndex(index))))
    declaration = geometry.CollisionFilterDeclaration()
    declaration.ExcludeBetween(geometry.GeometrySet(list(instead_of)), blocks)
    gravity = -float(plant.gravity_field().gravity_vector()[2])
    own = side_contact(true_object, gravity, wall_yield, _DISSIPATION)
    walls = [
        plant.RegisterCollisionGeometry(body, X_OG, wall, f"wall_{index}", own)
        for index, (X_OG, wall) in enumerate(walls_of(true_object))
    ]
    ball = geometry.Sphere(radius + skin_of(true_object, wall_yield))
    tips = [
        plant.RegisterCollisionGeometry(finger, RigidTransform(center), ball, f"ball_{index}", contact)
        for index, (finger, center) in enumerate(balls)
    ]
    declaration.ExcludeBetween(geometry.GeometrySet(walls + tips), others)
    declaration.ExcludeWithin(geometry.GeometrySet(tips))
    # The plant does not expose its scene graph, but a parser does.
    Parser(plant).scene_graph().collision_filter_manager().Apply(declaration)


def skin_of(true_object: TrueObject, wall_yield: float = YIELD_AT_ARM) -> float:
    """Depth to which a usual push sinks in, m: with a skin of that on the finger, the object is then pushed
    as by a rigid finger without it."""
    friction = float(true_object.mass @ true_object.mu) / true_object.total_mass
    return _USUAL * friction * wall_yield


def push_with_gripper(plant: MultibodyPlant, true_object: TrueObject, arm: Arm) -> None:
    """Let the closed gripper push with balls in place of its collars; see `push_with_balls`.

    Collars pass through the object's blocks, and pins, which are thinner, grasp them. A finger that comes
    down on the object is stopped by the pins, but a ball whose centre lies inside the outline, less than its
    radius from a side, presses that side outwards: what happens there is not what a real finger would do.
    """
    inspector = Parser(plant).scene_graph().model_inspector()
    contact = geometry.ProximityProperties()
    friction = CoulombFriction(FINGER_FRICTION, FINGER_FRICTION)
    geometry.AddContactMaterial(friction=friction, properties=contact)
    balls, collars = [], []
    for side in ("left", "right"):
        finger = plant.GetBodyByName(f"{side}_finger", arm.gripper)
        frame = plant.GetBodyFrameIdOrThrow(finger.index())
        collar = inspector.GetGeometryIdByName(frame, geometry.Role.kProximity, f"gripper::{side}_end")
        balls.append((finger, inspector.GetPoseInFrame(collar).translation()))
        collars.append(collar)
    push_with_balls(plant, true_object, balls, arm.finger_radius, contact, instead_of=collars)


def walls_of(true_object: TrueObject) -> list[tuple[RigidTransform, geometry.Box]]:
    """A thin upright box inside each side of the outline, from the blocks' lower end to the lowest height of
    the blocks there."""
    outlines = [block.outline.buffer(_SEAM, join_style="mitre") for block in true_object.blocks]
    whole = shapely.union_all(outlines).buffer(-_SEAM, join_style="mitre")
    walls = []
    for part in shapely.get_parts(whole):
        outline = shapely.orient_polygons(without_scan_noise(part.simplify(_SEAM)))
        for start, end in (
            side
            for ring in (outline.exterior, *outline.interiors)
            for side in pairwise(np.asarray(ring.coords))
        ):
            length = float(np.hypot(*(end - start)))
            if length < _SHORTEST:
                continue
            side = shapely.LineString([start, end])
            height = min(
                block.height for block in true_object.blocks if block.outline.dwithin(side, 10 * _SEAM)
            )
            along = (end - start) / length
            inward = np.array([-along[1], along[0]])
            middle = 0.5 * (start + end) + 0.5 * _THICKNESS * inward
            axes = np.column_stack([[*along, 0.0], [*inward, 0.0], [0.0, 0.0, 1.0]])
            X_OG = RigidTransform(RotationMatrix(axes), [*middle, 0.5 * (CLEARANCE + height)])
            walls.append((X_OG, geometry.Box(length, _THICKNESS, height - CLEARANCE)))
    return walls
