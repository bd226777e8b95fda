"""Hidden effects: what each changes in the simulated world, and how its parameters are drawn.

Most of them are also in slipmap's library but are implemented here independently; five are outside it.
Places and velocities are in the world frame, m and m/s, unless stated otherwise. A function makes each
effect; its arguments, in SI, are the parameters in the truth file. `LIBRARY` and `OUTSIDE` define the draws.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from slipmap.diagrams.application.studies.blind.objects import GRAVITY, FloatArray, SlidingObject
from slipmap.models.geometry import rotated, turn

Strength = Literal["clear", "weak"]
Range = tuple[float, float]
Vector = tuple[float, float]


@dataclass(eq=False)
class Instant:
    """State of the object at one time step, for the effects."""

    time: float  # since the push began, s
    step: float  # s
    # pose, twist: (3,) of the object frame
    pose: FloatArray
    twist: FloatArray
    points: FloatArray  # (p, 2) that carry the load, object frame
    loads: FloatArray  # (p,) loads on them in the plain world, N
    # contact, friction: (3,) force of the finger and of the table with torque about the object frame's
    # origin, from the previous step
    contact: FloatArray
    friction: FloatArray

    @cached_property
    def rotation(self) -> FloatArray:
        """(2, 2) rotation from the object frame to the world."""
        return turn(self.pose[2])

    @cached_property
    def places(self) -> FloatArray:
        """(p, 2) positions of the points on the table."""
        return self.points @ self.rotation.T + self.pose[:2]

    @cached_property
    def speeds(self) -> FloatArray:
        """(p,) speeds of the points."""
        v = self.rotation.T @ self.twist[:2]
        return np.hypot(v[0] - self.twist[2] * self.points[:, 1], v[1] + self.twist[2] * self.points[:, 0])


class LooseMass(NamedTuple):
    """Part of the object's mass on springs: kg, rest position in the object frame, N/m and N·s/m."""

    mass: float
    place: Vector
    stiffness: float
    damping: float


class Blade(NamedTuple):
    """Resistance to sideways motion at a point of the object: place, m; direction of the blade, rad; N."""

    place: Vector
    angle: float
    resistance: float


class Chance(NamedTuple):
    """Source of random parameters: generator, intended strength, and the object acted on."""

    rng: np.random.Generator
    strength: Strength
    thing: SlidingObject

    def size(self, clear: Range, weak: Range) -> float:
        """A random number from the range of the strength."""
        return float(self.rng.uniform(*(clear if self.strength == "clear" else weak)))

    def signed(self, clear: Range, weak: Range) -> float:
        """A random number from that range with a random sign."""
        size = self.size(clear, weak)
        return float(self.rng.choice([-1.0, 1.0])) * size

    def vector(self, clear: Range, weak: Range) -> Vector:
        """A vector with a length from that range in a random direction."""
        size, angle = self.size(clear, weak), self.direction()
        return float(size * np.cos(angle)), float(size * np.sin(angle))

    def between(self, low: float, high: float) -> float:
        """A random number that does not depend on the strength."""
        return float(self.rng.uniform(low, high))

    def direction(self) -> float:
        """A random direction, rad."""
        return self.between(-np.pi, np.pi)

    def place(self, within: float) -> Vector:
        """A random place on the table, at most `within` from its middle along x and y."""
        x, y = self.rng.uniform(-within, within, 2)
        return float(x), float(y)


def exact(times: FloatArray, clock: FloatArray, poses: FloatArray) -> FloatArray:
    """(T, c) report of an exact sensor at `times`, from true `poses` (N, c) at the times `clock`."""
    return np.column_stack([np.interp(times, clock, column) for column in poses.T])


def _as_it_is(forces: FloatArray) -> FloatArray:
    return forces


_ROUNDS = 20  # of Newton's method for the loads of an object

Factor = FloatArray | float | None
Report = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


@dataclass(eq=False)
class Effect:
    """What an effect changes; everything else is as in the plain world.

    Attributes:
        parameters: by name, SI; none in the plain world.
        gravity: (3,) m/s².
        loose_mass: the part of the mass that is not fixed to the object.
        blade: under the object.
        finger_stiffness: of a spring between the recorded position of the finger and its tip, N/m.
        drag: force per speed and area, N·s/m³.
        table_velocity: (2,) of the table surface.
        begin: called with the index of the push, the number of pushes and the number of support points.
        grain: (2, 2) metric of friction in the frame of an object at an angle; None where isotropic.
        friction_factor: (p,) or one factor on every point's friction; None for 1.
        force: (3,) on the object and torque about its origin; None for no force.
        reported: see `exact`.
        felt: what the force sensor reports for true forces (T, 2).
    """

    parameters: dict[str, Any] = field(default_factory=dict)
    gravity: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, -GRAVITY]))
    loose_mass: LooseMass | None = None
    blade: Blade | None = None
    finger_stiffness: float | None = None
    drag: float = 0.0
    table_velocity: FloatArray = field(default_factory=lambda: np.zeros(2))
    begin: Callable[[int, int, int], None] = lambda push, pushes, points: None
    grain: Callable[[float], FloatArray | None] = lambda angle: None
    friction_factor: Callable[[Instant], Factor] = lambda now: None
    force: Callable[[Instant], FloatArray | None] = lambda now: None
    reported: Report = exact
    felt: Callable[[FloatArray], FloatArray] = _as_it_is

    @property
    def changes_motion(self) -> bool:
        """False for sensor effects, which only change the recording, and for the plain world."""
        return bool(self.parameters) and self.reported is exact and self.felt is _as_it_is


# Forces that pull, drag or carry the object.


def table_tilt(tilt: float, direction: float) -> Effect:
    """Gravity pulls downhill, towards `direction`."""
    flat = np.sin(tilt)
    down = np.array([flat * np.cos(direction), flat * np.sin(direction), -np.cos(tilt)])
    return Effect(gravity=GRAVITY * down)


def tether(anchor: Vector, stiffness: float, slack: float) -> Effect:
    """A cable from the object frame's origin pulls towards `anchor` when longer than `slack`."""

    def force(now: Instant) -> FloatArray | None:
        towards = np.array(anchor) - now.pose[:2]
        length = float(np.hypot(*towards))
        if length <= slack:
            return None
        pull = stiffness * (length - slack) / length * towards
        return np.array([*pull, 0.0])

    return Effect(force=force)


def viscous_friction(drag_per_area: float) -> Effect:
    """Drag proportional to speed and area."""
    return Effect(drag=drag_per_area)


def gusts(strength: float, direction: float, period: float, phases: tuple[float, ...]) -> Effect:
    """A force along `direction` that oscillates with `period`; each push starts at another phase."""
    phase = 0.0

    def begin(push: int, pushes: int, points: int) -> None:
        nonlocal phase
        phase = phases[push % len(phases)]

    def force(now: Instant) -> FloatArray:
        size = strength * np.sin(2 * np.pi * now.time / period + phase)
        return size * np.array([np.cos(direction), np.sin(direction), 0.0])

    return Effect(begin=begin, force=force)


def moving_table(velocity: Vector) -> Effect:
    """The table is a belt that creeps at a constant velocity."""
    return Effect(table_velocity=np.array(velocity))


# Friction that depends on speed, direction, push or load.


def stribeck_friction(static: float, speed: float) -> Effect:
    """Friction is `static` times larger at rest and falls to its value within about `speed`."""
    return Effect(friction_factor=lambda now: 1.0 + (static - 1.0) * np.exp(-now.speeds / speed))


def anisotropic_table(along: float, across: float, angle: float) -> Effect:
    """Friction is `along` times larger along the table's grain at `angle`, and `across` times across it."""

    def grain(turned: float) -> FloatArray:
        axes = turn(angle - turned)
        return axes @ np.diag([along, across]) @ axes.T

    return Effect(grain=grain)


def anisotropic_object(along: float, across: float, angle: float) -> Effect:
    """The same with the grain fixed to the object."""
    fixed = anisotropic_table(along, across, angle).grain(0.0)
    return Effect(grain=lambda turned: fixed)


def friction_drift(change: float) -> Effect:
    """Friction changes linearly by `change` from the first push to the last; its mean is unchanged."""
    share = 0.0

    def begin(push: int, pushes: int, points: int) -> None:
        nonlocal share
        share = push / max(pushes - 1, 1) - 0.5

    return Effect(begin=begin, friction_factor=lambda now: 1.0 + change * share)


def load_transfer(push_height: float, mass_height: float) -> Effect:
    """Pushing at `push_height` above the table and braking with the mass at `mass_height` shift the load."""
    plane = np.zeros(3)

    def begin(push: int, pushes: int, points: int) -> None:
        plane[:] = 0.0

    def factor(now: Instant) -> FloatArray:
        push = now.rotation.T @ now.contact[:2]
        # Bounded by the weight, because the first touch causes a short force spike.
        push *= min(1.0, now.loads.sum() / max(float(np.hypot(*push)), 1e-9))
        inertial = push + now.rotation.T @ now.friction[:2]
        moment = push * push_height - inertial * mass_height
        return shifted_loads(now.loads, now.points, moment, plane) / now.loads

    return Effect(begin=begin, friction_factor=factor)


def shifted_loads(loads: FloatArray, points: FloatArray, moment: FloatArray, plane: FloatArray) -> FloatArray:
    """Loads (p,) of a rigid object on equally soft points (p, 2) once a moment (2,) acts on it, N m.

    They differ from `loads` by a plane, are nowhere negative, and balance weight and moment. An object that
    no loads can hold keeps its weight alone. The search starts from `plane` (3,), which receives the result.
    """
    levers = np.column_stack([np.ones(len(points)), points - points.mean(axis=0)])
    wanted = levers.T @ loads + np.array([0.0, *moment])
    for _ in range(_ROUNDS):
        pressed = np.maximum(loads + levers @ plane, 0.0)
        missing = wanted - levers.T @ pressed
        if np.abs(missing).max() < 1e-9 * loads.sum():
            break
        touching = levers[pressed > 0]
        plane += np.linalg.solve(touching.T @ touching + 1e-9 * np.eye(3), missing)
    return pressed * (loads.sum() / pressed.sum())


def ageing(rise: float, memory: float) -> Effect:
    """Contacts strengthen while they rest and are renewed over `memory` of sliding (Dieterich's law).

    The factor is 1 + rise · log10(1 + age / 0.01 s).
    """
    age = np.zeros(0)

    def begin(push: int, pushes: int, points: int) -> None:
        nonlocal age
        age = np.ones(points)

    def factor(now: Instant) -> FloatArray:
        nonlocal age
        age = (age + now.step) / (1.0 + now.step * now.speeds / memory)
        return 1.0 + rise * np.log10(1.0 + age / 0.01)

    return Effect(begin=begin, friction_factor=factor)


# Friction that depends on the place on the table.


def linear_friction_field(gradient: Vector, center: Vector) -> Effect:
    """Friction grows across the table by `gradient` (1/m) and has its plain value at `center`."""
    return Effect(
        friction_factor=lambda now: np.maximum(1.0 + (now.places - center) @ np.array(gradient), 0.15)
    )


def patch_friction_field(center: Vector, radius: float, edge: float, factor: float) -> Effect:
    """A round patch of the table multiplies friction by `factor`, with a transition `edge` wide."""

    def local(now: Instant) -> FloatArray:
        distance = np.hypot(*(now.places - center).T)
        inside = np.clip(0.5 - (distance - radius) / edge, 0.0, 1.0)
        return 1.0 + (factor - 1.0) * inside

    return Effect(friction_factor=local)


def magnet(center: Vector, radius: float, pressure: float, area: float) -> Effect:
    """A magnet under the table at `center` adds load within about `radius`: `pressure`, Pa, at its middle."""

    def factor(now: Instant) -> FloatArray:
        square = ((now.places - center) ** 2).sum(axis=1)
        extra = pressure * np.exp(-0.5 * square / radius**2) * area / len(now.points)
        return 1.0 + extra / now.loads

    return Effect(friction_factor=factor)


def sticky_line(center: Vector, angle: float, width: float, factor: float) -> Effect:
    """A strip of glue on the table, `width` wide, through `center` along `angle`, multiplies friction."""

    def local(now: Instant) -> FloatArray:
        across = (now.places - center) @ np.array([-np.sin(angle), np.cos(angle)])
        return np.where(np.abs(across) < 0.5 * width, factor, 1.0)

    return Effect(friction_factor=local)


# Bodies and springs: in the finger, in the object and under it.


def finger_compliance(compliance: float) -> Effect:
    """The recorded position is the hand's; a spring connects the tip to it, `compliance` in m/N."""
    return Effect(finger_stiffness=1.0 / compliance)


def loose_mass(share: float, frequency: float, damping_ratio: float, place: Vector, mass: float) -> Effect:
    """`share` of every cell's mass is one body on a spring and a damper; loads on the table are unchanged."""
    omega = 2 * np.pi * frequency
    return Effect(loose_mass=LooseMass(mass, place, mass * omega**2, 2 * damping_ratio * mass * omega))


def skate(place: Vector, angle: float, resistance: float) -> Effect:
    """A blade at `place` of the object rolls along `angle` and resists sideways with `resistance` in N."""
    return Effect(blade=Blade(place, angle, resistance))


# Tracker effects, which only change the recording.


def sensor_latency(latency: float) -> Effect:
    """The tracker reports a pose `latency` late."""
    return Effect(reported=lambda times, clock, poses: exact(times - latency, clock, poses))


def tracker_offset(x: float, y: float) -> Effect:
    """The tracked frame lies at (`x`, `y`) of the object frame."""

    def reported(times: FloatArray, clock: FloatArray, poses: FloatArray) -> FloatArray:
        poses = exact(times, clock, poses)
        return np.column_stack([poses[:, :2] + rotated(np.array([x, y]), poses[:, 2]), poses[:, 2]])

    return Effect(reported=reported)


def tracker_scale(scale: float) -> Effect:
    """The tracker's lengths, from the middle of the table, are `scale` times the true ones."""
    return Effect(reported=lambda times, clock, poses: exact(times, clock, poses) * [scale, scale, 1.0])


def tracker_shift(x: float, y: float) -> Effect:
    """The tracker's positions are shifted by (`x`, `y`), or the recorded point is not the finger's centre."""
    off = np.array([x, y, 0.0])
    return Effect(reported=lambda times, clock, poses: exact(times, clock, poses) + off)


# Force sensor effects, likewise.


def force_frame(angle: float, negated: bool) -> Effect:
    """Forces are rotated by `angle`, after negating y if `negated`."""
    frame = turn(angle) * [1.0, -1.0 if negated else 1.0]
    return Effect(felt=lambda forces: forces @ frame.T)


def force_bias(x: float, y: float) -> Effect:
    """The sensor was not zeroed: it adds (`x`, `y`), N."""
    added = np.array([x, y])
    return Effect(felt=lambda forces: forces + added)


# Random arguments of the effects; the order of the draws matters.


def _tether(c: Chance) -> dict[str, Any]:
    anchor, slack = c.place(0.4), c.between(0.05, 0.15)
    farthest = 0.4 + np.hypot(*anchor) - slack
    share = c.size((0.5, 0.75), (0.12, 0.2))
    return {"anchor": anchor, "stiffness": share * c.thing.friction_force / farthest, "slack": slack}


def _viscous_friction(c: Chance) -> dict[str, Any]:
    at_10_cm_per_s = c.size((0.5, 1.0), (0.1, 0.2))
    return {"drag_per_area": at_10_cm_per_s * c.thing.friction_force / 0.1 / c.thing.area}


def _gusts(c: Chance) -> dict[str, Any]:
    share = c.size((0.6, 0.85), (0.15, 0.25))
    phases = tuple(float(phase) for phase in c.rng.uniform(0, 2 * np.pi, 24))
    strength = share * c.thing.friction_force
    return {
        "strength": strength, "direction": c.direction(), "period": c.between(0.4, 1.0), "phases": phases
    }  # fmt: skip


def _anisotropy(c: Chance) -> dict[str, Any]:
    root = np.sqrt(c.size((1.25, 1.5), (1.06, 1.12)))
    return {"along": 1.0 / root, "across": root, "angle": c.between(0.0, np.pi)}


def _load_transfer(c: Chance) -> dict[str, Any]:
    share, thing = c.size((0.6, 1.0), (0.12, 0.2)), c.thing
    reach = 0.5 * thing.reach / float(thing.friction_force / (GRAVITY * thing.total_mass))
    height = min(share * max(thing.height, 0.06), share * reach)
    return {"push_height": height, "mass_height": 0.5 * height}


def _patch(c: Chance) -> dict[str, Any]:
    rise = c.size((0.9, 1.5), (0.2, 0.35))
    factor = 1.0 + rise if c.rng.random() < 0.6 else 1.0 / (1.0 + rise)
    return {"center": c.place(0.15), "radius": c.between(0.13, 0.22), "edge": 0.006, "factor": factor}


def _magnet(c: Chance) -> dict[str, Any]:
    share, area = c.size((1.5, 2.5), (0.5, 0.8)), c.thing.area
    pressure = share * GRAVITY * c.thing.total_mass / area
    return {"center": c.place(0.2), "radius": c.between(0.06, 0.12), "pressure": pressure, "area": area}


def _sticky_line(c: Chance) -> dict[str, Any]:
    factor = 1.0 + c.size((3.0, 6.0), (1.0, 1.6))
    line = {"center": c.place(0.1), "angle": c.between(0, np.pi), "width": c.between(0.02, 0.04)}
    return {**line, "factor": factor}


def _finger_compliance(c: Chance) -> dict[str, Any]:
    return {"compliance": c.size((4e-3, 8e-3), (1e-3, 2e-3)) / (0.6 * c.thing.friction_force)}


def _force_frame(c: Chance) -> dict[str, Any]:
    negated = c.strength == "clear" and c.rng.random() < 0.3
    return {"angle": c.signed((0.3, np.pi), (0.06, 0.12)), "negated": bool(negated)}


def _force_bias(c: Chance) -> dict[str, Any]:
    force = c.thing.friction_force
    x, y = c.vector((0.15, 0.4), (0.04, 0.08))
    return {"x": x * force, "y": y * force}


def _loose_mass(c: Chance) -> dict[str, Any]:
    share = c.size((0.5, 0.7), (0.15, 0.25))
    x, y = c.thing.center_of_mass
    spring = {"frequency": c.between(1.2, 2.5), "damping_ratio": c.between(0.1, 0.4)}
    return {"share": share, **spring, "place": (float(x), float(y)), "mass": share * c.thing.total_mass}


def _skate(c: Chance) -> dict[str, Any]:
    x, y = c.thing.centers[c.rng.integers(len(c.thing.centers))]
    share = c.size((0.35, 0.6), (0.06, 0.12))
    resistance = share * c.thing.friction_force
    return {"place": (float(x), float(y)), "angle": c.between(0, np.pi), "resistance": resistance}


class Kind(NamedTuple):
    """An effect before its parameters are drawn."""

    name: str  # in the library, if it is there
    make: Callable[..., Effect]  # its function
    draw: Callable[[Chance], dict[str, Any]]  # draws the arguments of the function
    kind: str = ""  # distinguishes effects of the same name
    # similar effects of the library; naming one of them is a near miss
    resembles: tuple[str, ...] = ()

    @property
    def in_library(self) -> bool:
        """Whether slipmap's library has it."""
        return self not in OUTSIDE

    def drawn(self, chance: Chance) -> Effect:
        """An effect with random parameters."""
        arguments = self.draw(chance)
        effect = self.make(**arguments)
        effect.parameters = {"kind": self.kind, **arguments} if self.kind else arguments
        return effect


PLAIN = Kind("none", Effect, lambda c: {})  # the plain world
_FIELD = "table_friction_field"
LIBRARY = (
    Kind("table_tilt", table_tilt, lambda c: {
        "tilt": c.size((0.035, 0.065), (0.01, 0.02)), "direction": c.direction()
    }),
    Kind("tether", tether, _tether),
    Kind("viscous_friction", viscous_friction, _viscous_friction),
    Kind("stribeck_friction", stribeck_friction, lambda c: {
        "static": 1.0 + c.size((0.5, 0.9), (0.12, 0.2)), "speed": c.between(0.03, 0.08)
    }),
    Kind("anisotropic_table", anisotropic_table, _anisotropy),
    Kind("anisotropic_object", anisotropic_object, _anisotropy),
    Kind(_FIELD, linear_friction_field, lambda c: {
        "gradient": c.vector((1.2, 2.0), (0.3, 0.5)), "center": c.place(0.1)
    }, "linear"),
    Kind(_FIELD, patch_friction_field, _patch, "patch"),
    Kind("friction_drift", friction_drift, lambda c: {"change": c.signed((0.4, 0.7), (0.1, 0.18))}),
    Kind("finger_compliance", finger_compliance, _finger_compliance),
    Kind("loose_mass", loose_mass, _loose_mass),
    Kind("load_transfer", load_transfer, _load_transfer),
    Kind("skate", skate, _skate),
    Kind("sensor_latency", sensor_latency, lambda c: {"latency": c.size((0.05, 0.08), (0.015, 0.025))}),
    Kind("tracker_offset", tracker_offset, lambda c: dict(
        zip("xy", c.vector((4e-3, 1e-2), (1e-3, 2e-3)), strict=True)
    )),
    Kind("tracker_shift", tracker_shift, lambda c: dict(
        zip("xy", c.vector((3e-3, 8e-3), (8e-4, 1.5e-3)), strict=True)
    )),
    Kind("force_frame", force_frame, _force_frame),
    Kind("force_bias", force_bias, _force_bias),
    Kind("tracker_scale", tracker_scale, lambda c: {"scale": 1.0 + c.signed((0.02, 0.04), (0.005, 0.01))}),
)  # fmt: skip
OUTSIDE = (
    Kind("gusts", gusts, _gusts, resembles=("table_tilt",)),
    Kind("magnet", magnet, _magnet, resembles=(_FIELD,)),
    Kind("sticky_line", sticky_line, _sticky_line, resembles=(_FIELD,)),
    Kind("ageing", ageing, lambda c: {
        "rise": c.size((0.35, 0.6), (0.08, 0.14)), "memory": c.between(0.003, 0.01)
    }, resembles=("stribeck_friction",)),
    Kind("moving_table", moving_table, lambda c: {"velocity": c.vector((4e-3, 8e-3), (5e-4, 1e-3))}),
)  # fmt: skip
