"""What an effect may change in the simulated world.

Places and velocities are in the world frame, m and m/s, unless said otherwise.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
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


def sized(
    rng: np.random.Generator,
    strength: Strength,
    clear: tuple[float, float],
    weak: tuple[float, float],
) -> float:
    """A number from the range of that strength."""
    return float(rng.uniform(*(clear if strength == "clear" else weak)))


def place_within(rng: np.random.Generator, within: float) -> tuple[float, float]:
    """A place of the table, at most so far from its middle along x and y."""
    x, y = rng.uniform(-within, within, 2)
    return float(x), float(y)


def any_angle(rng: np.random.Generator) -> float:
    """Of any direction."""
    return float(rng.uniform(-np.pi, np.pi))
