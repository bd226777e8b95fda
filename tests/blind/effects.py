"""Hidden effects: what a small class changes in the simulated world, with strengths drawn by chance.

Places and velocities are in the world frame, m and m/s, unless said otherwise. Most of these effects are in
slipmap's library too and were written here without it; five are in no library.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal, Self

import numpy as np

from blind.objects import GRAVITY, FloatArray, SlidingObject

Strength = Literal["clear", "weak"]


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
        c, s = np.cos(self.pose[2]), np.sin(self.pose[2])
        return np.array([[c, -s], [s, c]])

    @cached_property
    def places(self) -> FloatArray:
        return self.points @ self.rotation.T + self.pose[:2]

    @cached_property
    def speeds(self) -> FloatArray:
        v = self.rotation.T @ self.twist[:2]
        return np.hypot(v[0] - self.twist[2] * self.points[:, 1], v[1] + self.twist[2] * self.points[:, 0])


@dataclass(frozen=True)
class LooseMass:
    """Part of the object's mass on springs: kg, rest place in the object frame, N/m and N·s/m."""

    mass: float
    place: tuple[float, float]
    stiffness: float
    damping: float


@dataclass(frozen=True)
class Blade:
    """Resists sideways motion at a place of the object: m, rad of its own line, N."""

    place: tuple[float, float]
    angle: float
    resistance: float


@dataclass
class Effect:
    """The plain world. Subclasses change one thing each.

    Fields are the parameters that the truth file tells, in SI.
    """

    name: ClassVar[str] = "none"
    in_library: ClassVar[bool] = True
    resembles: ClassVar[tuple[str, ...]] = ()
    """Effects of the library that act alike; naming one of them is a near miss, not a blunder."""

    changes_motion: ClassVar[bool] = True
    """False for sensors, which change what is recorded alone."""

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        """An effect of the given strength on `thing`."""
        return cls()

    @property
    def parameters(self) -> dict[str, Any]:
        return asdict(self)

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

    def drag_per_area(self) -> float:
        """N·s/m³."""
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


def _sized(
    rng: np.random.Generator,
    strength: Strength,
    clear: tuple[float, float],
    weak: tuple[float, float],
) -> float:
    return float(rng.uniform(*(clear if strength == "clear" else weak)))


def _place(rng: np.random.Generator, within: float) -> tuple[float, float]:
    x, y = rng.uniform(-within, within, 2)
    return float(x), float(y)


def _angle(rng: np.random.Generator) -> float:
    return float(rng.uniform(-np.pi, np.pi))


@dataclass
class TableTilt(Effect):
    """Gravity pulls downhill, towards `direction`."""

    name = "table_tilt"
    tilt: float = 0.0
    direction: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        return cls(_sized(rng, strength, (0.035, 0.065), (0.01, 0.02)), _angle(rng))

    def gravity(self) -> FloatArray:
        flat = np.sin(self.tilt)
        return GRAVITY * np.array(
            [flat * np.cos(self.direction), flat * np.sin(self.direction), -np.cos(self.tilt)]
        )


@dataclass
class Tether(Effect):
    """A cable from the object frame's origin pulls towards `anchor` when longer than `slack`."""

    name = "tether"
    anchor: tuple[float, float] = (0.0, 0.0)
    stiffness: float = 0.0
    slack: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        anchor = _place(rng, 0.4)
        slack = float(rng.uniform(0.05, 0.15))
        farthest = 0.4 + np.hypot(*anchor) - slack
        share = _sized(rng, strength, (0.5, 0.75), (0.12, 0.2))
        return cls(anchor, share * thing.friction_force / farthest, slack)

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
    drag: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        at_10_cm_per_s = _sized(rng, strength, (0.5, 1.0), (0.1, 0.2))
        return cls(at_10_cm_per_s * thing.friction_force / 0.1 / thing.area)

    @property
    def parameters(self) -> dict[str, Any]:
        return {"drag_per_area": self.drag}

    def drag_per_area(self) -> float:
        return self.drag


@dataclass
class StribeckFriction(Effect):
    """Friction is `static` times larger at rest and falls to its value within about `speed`."""

    name = "stribeck_friction"
    static: float = 1.0
    speed: float = 0.05

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        rise = _sized(rng, strength, (0.5, 0.9), (0.12, 0.2))
        return cls(1.0 + rise, float(rng.uniform(0.03, 0.08)))

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
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        root = np.sqrt(_sized(rng, strength, (1.25, 1.5), (1.06, 1.12)))
        return cls(1.0 / root, root, float(rng.uniform(0.0, np.pi)))

    def grain(self, angle: float) -> FloatArray | None:
        c, s = np.cos(self.angle - angle), np.sin(self.angle - angle)
        axes = np.array([[c, -s], [s, c]])
        return axes @ np.diag([self.along, self.across]) @ axes.T


@dataclass
class AnisotropicObject(AnisotropicTable):
    """The same with the grain fixed to the object."""

    name = "anisotropic_object"

    def grain(self, angle: float) -> FloatArray | None:
        return super().grain(0.0)


@dataclass
class LinearFrictionField(Effect):
    """Friction grows across the table by `gradient` (1/m), and is the object's own at `center`."""

    name = "table_friction_field"
    gradient: tuple[float, float] = (0.0, 0.0)
    center: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        size, angle = _sized(rng, strength, (1.2, 2.0), (0.3, 0.5)), _angle(rng)
        return cls((float(size * np.cos(angle)), float(size * np.sin(angle))), _place(rng, 0.1))

    @property
    def parameters(self) -> dict[str, Any]:
        return {"kind": "linear", **asdict(self)}

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        return np.maximum(1.0 + (now.places - self.center) @ np.array(self.gradient), 0.15)


@dataclass
class PatchFrictionField(Effect):
    """A round patch of the table multiplies friction by `factor`, with a border `edge` wide."""

    name = "table_friction_field"
    center: tuple[float, float] = (0.0, 0.0)
    radius: float = 0.15
    edge: float = 0.006
    factor: float = 1.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        rise = _sized(rng, strength, (0.9, 1.5), (0.2, 0.35))
        factor = 1.0 + rise if rng.random() < 0.6 else 1.0 / (1.0 + rise)
        return cls(_place(rng, 0.15), float(rng.uniform(0.13, 0.22)), 0.006, factor)

    @property
    def parameters(self) -> dict[str, Any]:
        return {"kind": "patch", **asdict(self)}

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        distance = np.hypot(*(now.places - self.center).T)
        inside = np.clip(0.5 - (distance - self.radius) / self.edge, 0.0, 1.0)
        return 1.0 + (self.factor - 1.0) * inside


@dataclass
class FrictionDrift(Effect):
    """Friction of all pushes together changes by `change` from the first to the last, its mean kept."""

    name = "friction_drift"
    change: float = 0.0
    _share: float = field(default=0.0, repr=False)

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        size = _sized(rng, strength, (0.4, 0.7), (0.1, 0.18))
        return cls(float(rng.choice([-1.0, 1.0])) * size)

    @property
    def parameters(self) -> dict[str, Any]:
        return {"change": self.change}

    def begin(self, push: int, pushes: int, points: int) -> None:
        self._share = push / max(pushes - 1, 1) - 0.5

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        return 1.0 + self.change * self._share


@dataclass
class FingerCompliance(Effect):
    """The recorded position is that of the hand; the tip hangs on it by a spring, `compliance` in m/N."""

    name = "finger_compliance"
    compliance: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        bend = _sized(rng, strength, (4e-3, 8e-3), (1e-3, 2e-3))
        return cls(bend / (0.6 * thing.friction_force))

    def blade(self) -> Blade | None:
        """A blade under the object."""
        return None

    def finger_stiffness(self) -> float | None:
        return 1.0 / self.compliance


@dataclass
class LooseMassInside(Effect):
    """`share` of every cell's mass is one body on a spring and a damper; the floor's load stays as it is."""

    name = "loose_mass"
    share: float = 0.0
    frequency: float = 2.0
    damping_ratio: float = 0.2
    place: tuple[float, float] = (0.0, 0.0)
    mass: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        share = _sized(rng, strength, (0.5, 0.7), (0.15, 0.25))
        x, y = thing.center_of_mass
        frequency, ratio = float(rng.uniform(1.2, 2.5)), float(rng.uniform(0.1, 0.4))
        return cls(share, frequency, ratio, (float(x), float(y)), share * thing.total_mass)

    def loose_mass(self) -> LooseMass | None:
        omega = 2 * np.pi * self.frequency
        damping = 2 * self.damping_ratio * self.mass * omega
        return LooseMass(self.mass, self.place, self.mass * omega**2, damping)


@dataclass
class LoadTransfer(Effect):
    """A push `push_height` above the table and braking with the mass at `mass_height` shift the load."""

    name = "load_transfer"
    push_height: float = 0.0
    mass_height: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        share = _sized(rng, strength, (0.6, 1.0), (0.12, 0.2))
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
class Skate(Effect):
    """A blade at `place` of the object rolls along `angle` and resists sideways with `resistance` in N."""

    name = "skate"
    place: tuple[float, float] = (0.0, 0.0)
    angle: float = 0.0
    resistance: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        x, y = thing.centers[rng.integers(len(thing.centers))]
        share = _sized(rng, strength, (0.35, 0.6), (0.06, 0.12))
        return cls((float(x), float(y)), float(rng.uniform(0, np.pi)), share * thing.friction_force)

    def blade(self) -> Blade | None:
        return Blade(self.place, self.angle, self.resistance)


@dataclass
class SensorLatency(Effect):
    """The tracker reports a pose `latency` late."""

    name = "sensor_latency"
    changes_motion = False
    latency: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        return cls(_sized(rng, strength, (0.05, 0.08), (0.015, 0.025)))

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
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        size, angle = _sized(rng, strength, (4e-3, 8e-3), (1e-3, 2e-3)), _angle(rng)
        return cls(float(size * np.cos(angle)), float(size * np.sin(angle)))

    def reported(self, times: FloatArray, clock: FloatArray, poses: FloatArray) -> FloatArray:
        poses = super().reported(times, clock, poses)
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        shift = np.column_stack([c * self.x - s * self.y, s * self.x + c * self.y])
        return np.column_stack([poses[:, :2] + shift, poses[:, 2]])


@dataclass
class TrackerScale(Effect):
    """The tracker's lengths, from the middle of the table, are `scale` times the true ones."""

    name = "tracker_scale"
    changes_motion = False
    scale: float = 1.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        size = _sized(rng, strength, (0.02, 0.04), (0.005, 0.01))
        return cls(1.0 + float(rng.choice([-1.0, 1.0])) * size)

    def reported(self, times: FloatArray, clock: FloatArray, poses: FloatArray) -> FloatArray:
        return super().reported(times, clock, poses) * [self.scale, self.scale, 1.0]


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
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        share = _sized(rng, strength, (0.6, 0.85), (0.15, 0.25))
        phases = tuple(float(phase) for phase in rng.uniform(0, 2 * np.pi, 24))
        return cls(share * thing.friction_force, _angle(rng), float(rng.uniform(0.4, 1.0)), phases)

    @property
    def parameters(self) -> dict[str, Any]:
        return {key: value for key, value in asdict(self).items() if key != "_phase"}

    def begin(self, push: int, pushes: int, points: int) -> None:
        self._phase = self.phases[push % len(self.phases)] if self.phases else 0.0

    def force(self, now: Instant) -> FloatArray | None:
        size = self.strength * np.sin(2 * np.pi * now.time / self.period + self._phase)
        return size * np.array([np.cos(self.direction), np.sin(self.direction), 0.0])


@dataclass
class Magnet(Effect):
    """A magnet under the table at `center` adds load within about `radius`: `pressure`, Pa, at its middle."""

    name = "magnet"
    in_library = False
    resembles = ("table_friction_field",)
    center: tuple[float, float] = (0.0, 0.0)
    radius: float = 0.1
    pressure: float = 0.0
    area: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        share = _sized(rng, strength, (1.5, 2.5), (0.5, 0.8))
        pressure = share * GRAVITY * thing.total_mass / thing.area
        return cls(_place(rng, 0.2), float(rng.uniform(0.06, 0.12)), pressure, thing.area)

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
    center: tuple[float, float] = (0.0, 0.0)
    angle: float = 0.0
    width: float = 0.03
    factor: float = 1.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        factor = 1.0 + _sized(rng, strength, (3.0, 6.0), (1.0, 1.6))
        return cls(_place(rng, 0.1), float(rng.uniform(0, np.pi)), float(rng.uniform(0.02, 0.04)), factor)

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        across = (now.places - self.center) @ np.array([-np.sin(self.angle), np.cos(self.angle)])
        return np.where(np.abs(across) < 0.5 * self.width, self.factor, 1.0)


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
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        return cls(_sized(rng, strength, (0.35, 0.6), (0.08, 0.14)), float(rng.uniform(0.003, 0.01)))

    @property
    def parameters(self) -> dict[str, Any]:
        return {"rise": self.rise, "memory": self.memory}

    def begin(self, push: int, pushes: int, points: int) -> None:
        self._age = np.ones(points)

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        self._age = (self._age + now.step) / (1.0 + now.step * now.speeds / self.memory)
        return 1.0 + self.rise * np.log10(1.0 + self._age / 0.01)


@dataclass
class MovingTable(Effect):
    """The table is a belt that creeps along at a constant velocity."""

    name = "moving_table"
    in_library = False
    velocity: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        size, angle = _sized(rng, strength, (4e-3, 8e-3), (5e-4, 1e-3)), _angle(rng)
        return cls((float(size * np.cos(angle)), float(size * np.sin(angle))))

    def table_velocity(self) -> FloatArray:
        return np.array(self.velocity)


LIBRARY: tuple[type[Effect], ...] = (
    TableTilt, Tether, ViscousFriction, StribeckFriction, AnisotropicTable, AnisotropicObject,
    LinearFrictionField, PatchFrictionField, FrictionDrift, FingerCompliance, LooseMassInside, LoadTransfer,
    Skate, SensorLatency, TrackerOffset, TrackerScale,
)  # fmt: skip
OUTSIDE: tuple[type[Effect], ...] = (Gusts, Magnet, StickyLine, Ageing, MovingTable)
