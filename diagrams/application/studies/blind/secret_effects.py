"""Hidden effects: what each may change in the simulated world, and how strong it is drawn by chance.

Most of them are in slipmap's library too and were written here without it; five are in no library. Places and
velocities are in the world frame, m and m/s, unless said otherwise. Fields of an effect are the parameters
that the truth file tells, in SI; names with a leading underscore are its memory.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from slipmap.diagrams.application.studies.blind.objects import (
    GRAVITY,
    FloatArray,
    SlidingObject,
    rotation_matrix,
)
from slipmap.models.geometry import rotated

Strength = Literal["clear", "weak"]
Range = tuple[float, float]
Vector = tuple[float, float]


@dataclass(eq=False)
class Instant:
    """The state of the object at one time step, as effects see it.

    Attributes:
        time: since the push began, s.
        step: s.
        pose, twist: (3,) of the object frame.
        points: (p, 2) that carry load, object frame.
        loads: (p,) N on them in the plain world.
        contact, friction: (3,) force of finger and of table, and torque about the object frame's origin, of
            the step before.
    """

    time: float
    step: float
    pose: FloatArray
    twist: FloatArray
    points: FloatArray
    loads: FloatArray
    contact: FloatArray
    friction: FloatArray

    @cached_property
    def rotation(self) -> FloatArray:
        """(2, 2) from the object frame to the world."""
        return rotation_matrix(self.pose[2])

    @cached_property
    def places(self) -> FloatArray:
        """(p, 2) of the points on the table."""
        return self.points @ self.rotation.T + self.pose[:2]

    @cached_property
    def speeds(self) -> FloatArray:
        """(p,) of the points."""
        v = self.rotation.T @ self.twist[:2]
        return np.hypot(v[0] - self.twist[2] * self.points[:, 1], v[1] + self.twist[2] * self.points[:, 0])


class LooseMass(NamedTuple):
    """Part of the object's mass on springs: kg, rest place in the object frame, N/m and N·s/m."""

    mass: float
    place: Vector
    stiffness: float
    damping: float


class Blade(NamedTuple):
    """Resists sideways motion at a place of the object: m, rad of its own line, N."""

    place: Vector
    angle: float
    resistance: float


class Chance(NamedTuple):
    """What an effect is drawn from: source of chance, how strong it is to be, and the object it acts on."""

    rng: np.random.Generator
    strength: Strength
    thing: SlidingObject

    def size(self, clear: Range, weak: Range) -> float:
        """A number from the range of the strength."""
        return float(self.rng.uniform(*(clear if self.strength == "clear" else weak)))

    def signed(self, clear: Range, weak: Range) -> float:
        """The same, positive or negative."""
        size = self.size(clear, weak)
        return float(self.rng.choice([-1.0, 1.0])) * size

    def vector(self, clear: Range, weak: Range) -> Vector:
        """A vector of that length in any direction."""
        size, angle = self.size(clear, weak), self.direction()
        return float(size * np.cos(angle)), float(size * np.sin(angle))

    def between(self, low: float, high: float) -> float:
        """A number that does not depend on the strength."""
        return float(self.rng.uniform(low, high))

    def direction(self) -> float:
        """Any direction, rad."""
        return self.between(-np.pi, np.pi)

    def place(self, within: float) -> Vector:
        """A place of the table, at most so far from its middle along x and y."""
        x, y = self.rng.uniform(-within, within, 2)
        return float(x), float(y)


@dataclass
class Effect:
    """The plain world. Subclasses change one thing each."""

    name: ClassVar[str] = "none"
    in_library: ClassVar[bool] = True
    resembles: ClassVar[tuple[str, ...]] = ()
    """Effects of the library that act alike; naming one of them is a near miss, not a blunder."""

    kind: ClassVar[str] = ""
    """Tells effects of one name apart."""

    changes_motion: ClassVar[bool] = True
    """False for sensors, which change what is recorded alone."""

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        """An effect of that strength."""
        return cls()

    @property
    def parameters(self) -> dict[str, Any]:
        """Its fields by name, SI."""
        fields = {name: value for name, value in asdict(self).items() if not name.startswith("_")}
        return {"kind": self.kind, **fields} if self.kind else fields

    def begin(self, push: int, pushes: int, points: int) -> None:
        """A push begins, on an object that rests on so many points."""

    def gravity(self) -> FloatArray:
        """(3,) m/s²."""
        return np.array([0.0, 0.0, -GRAVITY])

    def loose_mass(self) -> LooseMass | None:
        """The part of the mass that is not fixed to the object."""
        return None

    def blade(self) -> Blade | None:
        """A blade under the object."""
        return None

    def finger_stiffness(self) -> float | None:
        """Of a spring between the recorded position of the finger and its tip, N/m."""
        return None

    def drag(self) -> float:
        """Force per speed and area, N·s/m³."""
        return 0.0

    def grain(self, angle: float) -> FloatArray | None:
        """(2, 2) metric of friction in the frame of an object at that angle; None where it is round."""
        return None

    def table_velocity(self) -> FloatArray:
        """(2,) of the table's top."""
        return np.zeros(2)

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        """(p,) or one factor on every point's friction; None for 1."""
        return None

    def force(self, now: Instant) -> FloatArray | None:
        """(3,) force on the object and torque about its origin; None for no force."""
        return None

    def reported(self, times: FloatArray, clock: FloatArray, poses: FloatArray) -> FloatArray:
        """(T, 3) what an exact tracker reports at `times` of the true `poses`, which are known at `clock`."""
        return np.column_stack([np.interp(times, clock, column) for column in poses.T])


# Forces that pull, drag or carry the object.


@dataclass
class TableTilt(Effect):
    """Gravity pulls downhill, towards `direction`."""

    name = "table_tilt"
    tilt: float = 0.0
    direction: float = 0.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        return cls(chance.size((0.035, 0.065), (0.01, 0.02)), chance.direction())

    def gravity(self) -> FloatArray:
        flat = np.sin(self.tilt)
        return GRAVITY * np.array(
            [flat * np.cos(self.direction), flat * np.sin(self.direction), -np.cos(self.tilt)]
        )


@dataclass
class Tether(Effect):
    """A cable from the object frame's origin pulls towards `anchor` when longer than `slack`."""

    name = "tether"
    anchor: Vector = (0.0, 0.0)
    stiffness: float = 0.0
    slack: float = 0.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        anchor, slack = chance.place(0.4), chance.between(0.05, 0.15)
        farthest = 0.4 + np.hypot(*anchor) - slack
        share = chance.size((0.5, 0.75), (0.12, 0.2))
        return cls(anchor, share * chance.thing.friction_force / farthest, slack)

    def force(self, now: Instant) -> FloatArray | None:
        towards = np.array(self.anchor) - now.pose[:2]
        length = float(np.hypot(*towards))
        if length <= self.slack:
            return None
        pull = self.stiffness * (length - self.slack) / length * towards
        return np.array([*pull, 0.0])


@dataclass
class ViscousFriction(Effect):
    """Drag proportional to speed and area."""

    name = "viscous_friction"
    drag_per_area: float = 0.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        at_10_cm_per_s = chance.size((0.5, 1.0), (0.1, 0.2))
        return cls(at_10_cm_per_s * chance.thing.friction_force / 0.1 / chance.thing.area)

    def drag(self) -> float:
        return self.drag_per_area


@dataclass
class Gusts(Effect):
    """A force towards `direction` that swells and ebbs with `period`; each push meets it at another phase."""

    name = "gusts"
    in_library = False
    resembles = ("table_tilt",)
    strength: float = 0.0
    direction: float = 0.0
    period: float = 0.5
    phases: tuple[float, ...] = ()
    _phase: float = field(default=0.0, repr=False)

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        share = chance.size((0.6, 0.85), (0.15, 0.25))
        phases = tuple(float(phase) for phase in chance.rng.uniform(0, 2 * np.pi, 24))
        return cls(share * chance.thing.friction_force, chance.direction(), chance.between(0.4, 1.0), phases)

    def begin(self, push: int, pushes: int, points: int) -> None:
        self._phase = self.phases[push % len(self.phases)] if self.phases else 0.0

    def force(self, now: Instant) -> FloatArray | None:
        size = self.strength * np.sin(2 * np.pi * now.time / self.period + self._phase)
        return size * np.array([np.cos(self.direction), np.sin(self.direction), 0.0])


@dataclass
class MovingTable(Effect):
    """The table is a belt that creeps along at a constant velocity."""

    name = "moving_table"
    in_library = False
    velocity: Vector = (0.0, 0.0)

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        return cls(chance.vector((4e-3, 8e-3), (5e-4, 1e-3)))

    def table_velocity(self) -> FloatArray:
        return np.array(self.velocity)


# Friction by speed, direction and push, or with the load.


@dataclass
class StribeckFriction(Effect):
    """Friction is `static` times larger at rest and falls to its value within about `speed`."""

    name = "stribeck_friction"
    static: float = 1.0
    speed: float = 0.05

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        return cls(1.0 + chance.size((0.5, 0.9), (0.12, 0.2)), chance.between(0.03, 0.08))

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        return 1.0 + (self.static - 1.0) * np.exp(-now.speeds / self.speed)


@dataclass
class AnisotropicTable(Effect):
    """Friction is `along` times larger along the table's grain at `angle`, and `across` times across it."""

    name = "anisotropic_table"
    along: float = 1.0
    across: float = 1.0
    angle: float = 0.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        root = np.sqrt(chance.size((1.25, 1.5), (1.06, 1.12)))
        return cls(1.0 / root, root, chance.between(0.0, np.pi))

    def grain(self, angle: float) -> FloatArray | None:
        axes = rotation_matrix(self.angle - angle)
        return axes @ np.diag([self.along, self.across]) @ axes.T


@dataclass
class AnisotropicObject(AnisotropicTable):
    """The same with the grain fixed to the object."""

    name = "anisotropic_object"

    def grain(self, angle: float) -> FloatArray | None:
        return super().grain(0.0)


@dataclass
class FrictionDrift(Effect):
    """Friction of all pushes together changes by `change` from the first to the last, its mean kept."""

    name = "friction_drift"
    change: float = 0.0
    _share: float = field(default=0.0, repr=False)

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        return cls(chance.signed((0.4, 0.7), (0.1, 0.18)))

    def begin(self, push: int, pushes: int, points: int) -> None:
        self._share = push / max(pushes - 1, 1) - 0.5

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        return 1.0 + self.change * self._share


@dataclass
class LoadTransfer(Effect):
    """A push `push_height` above the table and braking with the mass at `mass_height` shift the load."""

    name = "load_transfer"
    push_height: float = 0.0
    mass_height: float = 0.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        share, thing = chance.size((0.6, 1.0), (0.12, 0.2)), chance.thing
        reach = 0.5 * thing.reach / float(thing.friction_force / (GRAVITY * thing.total_mass))
        height = min(share * max(thing.height, 0.06), share * reach)
        return cls(height, 0.5 * height)

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        push = now.rotation.T @ now.contact[:2]
        # The weight bounds the force, which the first touch would raise to a short spike.
        push *= min(1.0, now.loads.sum() / max(float(np.hypot(*push)), 1e-9))
        inertial = push + now.rotation.T @ now.friction[:2]
        moment = push * self.push_height - inertial * self.mass_height
        arms = now.points - now.points.mean(axis=0)
        shift = arms @ np.linalg.solve(arms.T @ arms, moment)
        return np.clip(1.0 + shift / now.loads, 0.0, 3.0)


@dataclass
class Ageing(Effect):
    """Contacts strengthen while they rest and are renewed over `memory` of sliding (Dieterich's law).

    The factor is 1 + rise · log10(1 + age / 0.01 s).
    """

    name = "ageing"
    in_library = False
    resembles = ("stribeck_friction",)
    rise: float = 0.0
    memory: float = 0.005
    _age: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        return cls(chance.size((0.35, 0.6), (0.08, 0.14)), chance.between(0.003, 0.01))

    def begin(self, push: int, pushes: int, points: int) -> None:
        self._age = np.ones(points)

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        self._age = (self._age + now.step) / (1.0 + now.step * now.speeds / self.memory)
        return 1.0 + self.rise * np.log10(1.0 + self._age / 0.01)


# Friction by the place on the table.


@dataclass
class LinearFrictionField(Effect):
    """Friction grows across the table by `gradient` (1/m), and is the object's own at `center`."""

    name = "table_friction_field"
    kind = "linear"
    gradient: Vector = (0.0, 0.0)
    center: Vector = (0.0, 0.0)

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        return cls(chance.vector((1.2, 2.0), (0.3, 0.5)), chance.place(0.1))

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        return np.maximum(1.0 + (now.places - self.center) @ np.array(self.gradient), 0.15)


@dataclass
class PatchFrictionField(Effect):
    """A round patch of the table multiplies friction by `factor`, with a border `edge` wide."""

    name = "table_friction_field"
    kind = "patch"
    center: Vector = (0.0, 0.0)
    radius: float = 0.15
    edge: float = 0.006
    factor: float = 1.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        rise = chance.size((0.9, 1.5), (0.2, 0.35))
        factor = 1.0 + rise if chance.rng.random() < 0.6 else 1.0 / (1.0 + rise)
        return cls(chance.place(0.15), chance.between(0.13, 0.22), factor=factor)

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        distance = np.hypot(*(now.places - self.center).T)
        inside = np.clip(0.5 - (distance - self.radius) / self.edge, 0.0, 1.0)
        return 1.0 + (self.factor - 1.0) * inside


@dataclass
class Magnet(Effect):
    """A magnet under the table at `center` adds load within about `radius`: `pressure`, Pa, at its middle."""

    name = "magnet"
    in_library = False
    resembles = ("table_friction_field",)
    center: Vector = (0.0, 0.0)
    radius: float = 0.1
    pressure: float = 0.0
    area: float = 0.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        share, area = chance.size((1.5, 2.5), (0.5, 0.8)), chance.thing.area
        pressure = share * GRAVITY * chance.thing.total_mass / area
        return cls(chance.place(0.2), chance.between(0.06, 0.12), pressure, area)

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        square = ((now.places - self.center) ** 2).sum(axis=1)
        extra = self.pressure * np.exp(-0.5 * square / self.radius**2) * self.area / len(now.points)
        return 1.0 + extra / now.loads


@dataclass
class StickyLine(Effect):
    """A strip of glue on the table, `width` wide, through `center` along `angle`, multiplies friction."""

    name = "sticky_line"
    in_library = False
    resembles = ("table_friction_field",)
    center: Vector = (0.0, 0.0)
    angle: float = 0.0
    width: float = 0.03
    factor: float = 1.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        factor = 1.0 + chance.size((3.0, 6.0), (1.0, 1.6))
        return cls(chance.place(0.1), chance.between(0, np.pi), chance.between(0.02, 0.04), factor)

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        across = (now.places - self.center) @ np.array([-np.sin(self.angle), np.cos(self.angle)])
        return np.where(np.abs(across) < 0.5 * self.width, self.factor, 1.0)


# Bodies and springs: in the finger, in the object and under it.


@dataclass
class FingerCompliance(Effect):
    """The recorded position is that of the hand; the tip hangs on it by a spring, `compliance` in m/N."""

    name = "finger_compliance"
    compliance: float = 0.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        bend = chance.size((4e-3, 8e-3), (1e-3, 2e-3))
        return cls(bend / (0.6 * chance.thing.friction_force))

    def finger_stiffness(self) -> float | None:
        return 1.0 / self.compliance


@dataclass
class LooseMassInside(Effect):
    """`share` of every cell's mass is one body on a spring and a damper; the floor's load stays as it is."""

    name = "loose_mass"
    share: float = 0.0
    frequency: float = 2.0
    damping_ratio: float = 0.2
    place: Vector = (0.0, 0.0)
    mass: float = 0.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        share = chance.size((0.5, 0.7), (0.15, 0.25))
        x, y = chance.thing.center_of_mass
        frequency, ratio = chance.between(1.2, 2.5), chance.between(0.1, 0.4)
        return cls(share, frequency, ratio, (float(x), float(y)), share * chance.thing.total_mass)

    def loose_mass(self) -> LooseMass | None:
        omega = 2 * np.pi * self.frequency
        damping = 2 * self.damping_ratio * self.mass * omega
        return LooseMass(self.mass, self.place, self.mass * omega**2, damping)


@dataclass
class Skate(Effect):
    """A blade at `place` of the object rolls along `angle` and resists sideways with `resistance` in N."""

    name = "skate"
    place: Vector = (0.0, 0.0)
    angle: float = 0.0
    resistance: float = 0.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        x, y = chance.thing.centers[chance.rng.integers(len(chance.thing.centers))]
        share = chance.size((0.35, 0.6), (0.06, 0.12))
        return cls((float(x), float(y)), chance.between(0, np.pi), share * chance.thing.friction_force)

    def blade(self) -> Blade | None:
        return Blade(self.place, self.angle, self.resistance)


# The tracker, which changes what is recorded alone.


@dataclass
class SensorLatency(Effect):
    """The tracker reports a pose `latency` late."""

    name = "sensor_latency"
    changes_motion = False
    latency: float = 0.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        return cls(chance.size((0.05, 0.08), (0.015, 0.025)))

    def reported(self, times: FloatArray, clock: FloatArray, poses: FloatArray) -> FloatArray:
        return super().reported(times - self.latency, clock, poses)


@dataclass
class TrackerOffset(Effect):
    """The tracked frame lies at (`x`, `y`) of the object frame."""

    name = "tracker_offset"
    changes_motion = False
    x: float = 0.0
    y: float = 0.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        return cls(*chance.vector((4e-3, 8e-3), (1e-3, 2e-3)))

    def reported(self, times: FloatArray, clock: FloatArray, poses: FloatArray) -> FloatArray:
        poses = super().reported(times, clock, poses)
        shift = rotated(np.array([self.x, self.y]), poses[:, 2])
        return np.column_stack([poses[:, :2] + shift, poses[:, 2]])


@dataclass
class TrackerScale(Effect):
    """The tracker's lengths, from the middle of the table, are `scale` times the true ones."""

    name = "tracker_scale"
    changes_motion = False
    scale: float = 1.0

    @classmethod
    def draw(cls, chance: Chance) -> Self:
        return cls(1.0 + chance.signed((0.02, 0.04), (0.005, 0.01)))

    def reported(self, times: FloatArray, clock: FloatArray, poses: FloatArray) -> FloatArray:
        return super().reported(times, clock, poses) * [self.scale, self.scale, 1.0]


LIBRARY: tuple[type[Effect], ...] = (
    TableTilt, Tether, ViscousFriction, StribeckFriction, AnisotropicTable, AnisotropicObject,
    LinearFrictionField, PatchFrictionField, FrictionDrift, FingerCompliance, LooseMassInside, LoadTransfer,
    Skate, SensorLatency, TrackerOffset, TrackerScale,
)  # fmt: skip
OUTSIDE: tuple[type[Effect], ...] = (Gusts, Magnet, StickyLine, Ageing, MovingTable)
