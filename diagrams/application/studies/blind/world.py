"""The simulated world: Drake's multibody plant moves object and finger; friction comes from elastic bristles.

The object slides on a planar joint, so no contacts carry its weight. The finger is a sphere on two prismatic
joints, driven along a prescribed path with a mass so large that no push disturbs it. Finger and object touch
through the plant's own contact model.

Table friction acts on many points, each held by a short bristle that yields at a limit: Coulomb's law with
true sticking. A point sticks within its bristle's reach of a few micrometres and slides beyond it at constant
force. The scheme is explicit in time and solves no equations.
"""

from dataclasses import dataclass, replace

import numpy as np
from pydrake.geometry import AddContactMaterial, Box, ProximityProperties, SceneGraph, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody import tree
from pydrake.multibody.plant import CoulombFriction, DiscreteContactApproximation, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.application.studies.blind.objects import FloatArray, PushPlan, SlidingObject
from slipmap.diagrams.application.studies.blind.secret_effects import Effect, Instant
from slipmap.models.physics.compiled import LONE_FOLDER, compiled

_STEP = 5e-4  # s
_HAND_MASS = 100.0  # kg
_TIP_MASS = 0.05  # kg, of a compliant finger
_BOX_HEIGHT = 0.1  # m; a finger always meets a side
_REACH = 8e-6  # m, of a bristle
_DAMPING_TIME = 1.5e-3  # s, damping of a sticking bristle divided by its stiffness


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion during one push, at every time step."""

    clock: FloatArray  # (N,) s
    poses: FloatArray  # (N, 3) of the object frame
    hand: FloatArray  # (N, 2) finger position known to the robot; the tip itself if the finger is rigid
    # (N, 3) of the contact force on the object since the start, N·s, and of its torque about the hand, N·m·s
    impulse: FloatArray


class World:
    """One object, one finger and one effect; built once and pushed many times."""

    def __init__(self, thing: SlidingObject, effect: Effect, *, step: float = _STEP):
        self._thing, self._effect, self._step = thing, effect, step
        self._points, cell, share = thing.quadrature()
        self._loads = thing.mass[cell] * -effect.gravity[2] / share
        self._limits = self._loads * thing.mu[cell]
        self._drag = effect.drag * thing.area / len(self._points)
        self._blade = effect.blade
        self._build()

    def push(self, plan: PushPlan, *, index: int = 0, count: int = 1) -> Motion:
        """Carry out a plan as push `index` of `count`."""
        steps = int(np.ceil((plan.duration + 0.02) / self._step))
        target = plan.path.positions(self._step * np.arange(steps + 2, dtype=float))
        return self._run(plan.pose, np.zeros(3), target, index, count)

    def _run(self, pose: FloatArray, twist: FloatArray, target: FloatArray, index: int, count: int) -> Motion:
        h, plant, context, effect = self._step, self._plant, self._context, self._effect
        positions, velocities = np.zeros(plant.num_positions()), np.zeros(plant.num_velocities())
        positions[self._q], velocities[self._v] = pose, twist
        positions[self._hand_q] = target[0]
        plant.SetPositions(context, positions)
        plant.SetVelocities(context, velocities)
        nq = plant.num_positions()
        bristles, blade_bristle = np.zeros_like(self._points), np.zeros((1, 2))
        effect.begin(index, count, len(self._points))
        contact, table = np.zeros(3), np.zeros(3)
        steps = len(target) - 1
        states = np.empty((steps, nq))
        impulse = np.zeros((steps, 3))
        applied = np.zeros(plant.num_velocities())
        force = self._force.GetMutableData().get_mutable_value()
        for k in range(steps):
            state = context.get_discrete_state_vector().value()
            states[k] = state[:nq]
            pose, twist = state[self._q], state[nq + self._v]
            now = Instant(h * k, h, pose, twist, self._points, self._loads, contact, table)
            table = self._friction(now, bristles, blade_bristle)
            own = effect.force(now)
            applied[self._v] = table if own is None else table + own
            # The hand reaches its target at the end of the step, whatever pushes against it.
            wanted = (target[k + 1] - state[self._hand_q]) / h
            applied[self._hand_v] = _HAND_MASS * (wanted - state[nq + self._hand_v]) / h
            force.SetFromVector(applied)
            contact = self._contact.Eval(context)
            if k + 1 < steps:
                arm = state[self._hand_q] - pose[:2]
                about_hand = contact[2] - (arm[0] * contact[1] - arm[1] * contact[0])
                impulse[k + 1] = impulse[k] + h * np.array([contact[0], contact[1], about_hand])
                new = self._diagram.EvalUniquePeriodicDiscreteUpdate(self._root)
                self._root.SetDiscreteState(new)
        return Motion(h * np.arange(steps, dtype=float), states[:, self._q], states[:, self._hand_q], impulse)

    def _friction(self, now: Instant, bristles: FloatArray, blade_bristle: FloatArray) -> FloatArray:
        """(3,) friction force and torque of the table on the object, world frame."""
        factor = self._effect.friction_factor(now)
        grain = self._effect.grain(float(now.pose[2]))
        turn = now.rotation
        twist = np.array([*(turn.T @ now.twist[:2]), now.twist[2]])
        fx, fy, torque = _bristle_wrench(
            bristles,
            self._points,
            self._limits if factor is None else self._limits * factor,
            np.eye(2) if grain is None else grain,
            self._drag,
            turn.T @ self._effect.table_velocity,
            twist,
            now.step,
        )
        total = np.array([fx, fy, torque])
        if self._blade is not None:
            across = np.array([-np.sin(self._blade.angle), np.cos(self._blade.angle)])
            total += _bristle_wrench(
                blade_bristle,
                np.array([self._blade.place]),
                np.array([self._blade.resistance]),
                np.outer(across, across),
                0.0,
                np.zeros(2),
                twist,
                now.step,
            )
        total[:2] = turn @ total[:2]
        return total

    def _build(self) -> None:
        thing, effect = self._thing, self._effect
        builder = DiagramBuilder()
        plant = MultibodyPlant(self._step)
        plant.SetUseSampledOutputPorts(False)
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
        scene = builder.AddSystem(SceneGraph())
        builder.AddSystem(plant)
        plant.RegisterAsSourceForSceneGraph(scene)
        builder.Connect(
            plant.get_geometry_pose_output_port(), scene.get_source_pose_port(plant.get_source_id())
        )
        builder.Connect(scene.get_query_output_port(), plant.get_geometry_query_input_port())
        plant.mutable_gravity_field().set_gravity_vector(effect.gravity)
        pushed, finger = plant.AddModelInstance("object"), plant.AddModelInstance("finger")
        loose = effect.loose_mass
        fixed = replace(thing, mass=thing.mass * (1.0 - (loose.mass / thing.total_mass if loose else 0.0)))
        body = plant.AddRigidBody("object", pushed, _flat_inertia(fixed))
        slide = plant.AddJoint(tree.PlanarJoint("slide", plant.world_frame(), body.body_frame(), np.zeros(3)))
        surface = _surface(thing.mu_finger)
        for number, (center, size) in enumerate(thing.rectangles()):
            place = RigidTransform([*center, 0.0])
            box = Box(*size, _BOX_HEIGHT)
            plant.RegisterCollisionGeometry(body, place, box, f"rectangle {number}", surface)
        hand, joints = _cart(plant, finger, plant.world_body(), "hand", _HAND_MASS)
        tip = hand
        spring = effect.finger_stiffness
        if spring is not None:
            damping = 1.4 * np.sqrt(spring * _TIP_MASS)
            tip, _ = _cart(plant, finger, hand, "tip", _TIP_MASS, stiffness=spring, damping=damping)
        sphere = Sphere(thing.finger_radius)
        plant.RegisterCollisionGeometry(tip, RigidTransform(), sphere, "tip", surface)
        if loose is not None:
            inside = plant.AddModelInstance("inside")
            _cart(
                plant, inside, body, "loose", loose.mass,
                place=loose.place, stiffness=loose.stiffness, damping=loose.damping,
            )  # fmt: skip
        plant.set_gravity_enabled(finger, False)
        plant.Finalize()
        self._plant, self._diagram = plant, builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self._context = plant.GetMyMutableContextFromRoot(self._root)
        self._force = plant.get_applied_generalized_force_input_port().FixValue(
            self._context, np.zeros(plant.num_velocities())
        )
        self._contact = plant.get_generalized_contact_forces_output_port(pushed)
        self._q, self._v = slide.position_start() + np.arange(3), slide.velocity_start() + np.arange(3)
        self._hand_q = np.array([joint.position_start() for joint in joints])
        self._hand_v = np.array([joint.velocity_start() for joint in joints])


def _surface(mu: float) -> ProximityProperties:
    """Contact properties; Drake combines equal coefficients to 2 μ μ / (μ + μ) = μ, and halves stiffness."""
    properties = ProximityProperties()
    AddContactMaterial(
        properties=properties,
        dissipation=100.0,  # s/m: a finger does not bounce off
        point_stiffness=2e5,  # N/m
        friction=CoulombFriction(mu, mu),
    )
    return properties


def _flat_inertia(thing: SlidingObject) -> tree.SpatialInertia:
    """Spatial inertia of the cells as uniform squares in a plane, about the object frame's origin."""
    share = thing.mass / thing.total_mass
    x, y = thing.centers.T
    square = thing.width**2 / 12
    xx, yy, xy = share @ (y**2 + square), share @ (x**2 + square), share @ (x * y)
    unit = tree.UnitInertia(xx, yy, xx + yy, -xy, 0.0, 0.0)
    return tree.SpatialInertia(thing.total_mass, [*thing.center_of_mass, 0.0], unit)


def _cart(
    plant: MultibodyPlant,
    instance: tree.ModelInstanceIndex,
    parent: tree.RigidBody,
    name: str,
    mass: float,
    *,
    place: tuple[float, float] = (0.0, 0.0),
    stiffness: float = 0.0,
    damping: float = 0.0,
) -> tuple[tree.RigidBody, list[tree.PrismaticJoint]]:
    """A body that moves along x and y of its parent from `place`, on springs if `stiffness` is positive."""
    ball = tree.UnitInertia.SolidSphere(0.005)
    frame = plant.AddFrame(
        tree.FixedOffsetFrame(f"{name} rest", parent.body_frame(), RigidTransform([*place, 0.0]))
    )
    joints = []
    for axis, direction in (("x", [1.0, 0.0, 0.0]), ("y", [0.0, 1.0, 0.0])):
        body = plant.AddRigidBody(
            f"{name} {axis}", instance, tree.SpatialInertia(0.0 if axis == "x" else mass, np.zeros(3), ball)
        )
        joint = tree.PrismaticJoint(f"{name} {axis}", frame, body.body_frame(), direction, damping=damping)
        joints.append(plant.AddJoint(joint))
        if stiffness > 0:
            plant.AddForceElement(tree.PrismaticSpring(joints[-1], 0.0, stiffness))
        frame = body.body_frame()
    return body, joints


@compiled(LONE_FOLDER)
def _bristle_wrench(
    bristles: FloatArray,
    points: FloatArray,
    limit: FloatArray,
    grain: FloatArray,
    drag: float,
    table_velocity: FloatArray,
    twist: FloatArray,
    h: float,
) -> tuple[float, float, float]:
    """Advance the bristles by one step and sum their forces.

    All vectors in the object frame.

    Args:
        bristles: (p, 2) deflections, m; changed in place.
        points: (p, 2) m.
        limit: (p,) force at which a point slides, N.
        grain: (2, 2) symmetric; identity where friction is the same in all directions. Power is lost at
            the rate limit · |grain · velocity|.
        drag: force on each point per speed, N·s/m.
        table_velocity: (2,) of the table's top, m/s.
        twist: (3,) of the object at its origin, m/s and rad/s.
        h: s.

    Returns:
        Force and torque about the origin, N and N·m.
    """
    fx = fy = torque = 0.0
    for p in range(len(points)):
        x, y = points[p, 0], points[p, 1]
        ux = twist[0] - twist[2] * y - table_velocity[0]
        uy = twist[1] + twist[2] * x - table_velocity[1]
        sx = grain[0, 0] * ux + grain[0, 1] * uy
        sy = grain[1, 0] * ux + grain[1, 1] * uy
        bx, by = bristles[p, 0] + h * sx, bristles[p, 1] + h * sy
        size = np.sqrt(bx * bx + by * by)
        if size > _REACH:
            bx, by = bx * _REACH / size, by * _REACH / size
        bristles[p, 0], bristles[p, 1] = bx, by
        qx, qy = (bx + _DAMPING_TIME * sx) / _REACH, (by + _DAMPING_TIME * sy) / _REACH
        size = np.sqrt(qx * qx + qy * qy)
        share = limit[p] / max(size, 1.0)
        px = -share * (grain[0, 0] * qx + grain[0, 1] * qy) - drag * ux
        py = -share * (grain[1, 0] * qx + grain[1, 1] * qy) - drag * uy
        fx += px
        fy += py
        torque += x * py - y * px
    return fx, fy, torque
