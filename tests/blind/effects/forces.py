"""Effects that pull, drag or carry the object."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Self

import numpy as np

from blind.effects.effect import Effect, Instant, Strength, any_angle, place_within, sized
from blind.objects import GRAVITY, FloatArray, SlidingObject


@dataclass
class TableTilt(Effect):
    """Gravity pulls downhill, towards `direction`."""

    name = "table_tilt"
    tilt: float = 0.0
    direction: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        return cls(sized(rng, strength, (0.035, 0.065), (0.01, 0.02)), any_angle(rng))

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
        anchor = place_within(rng, 0.4)
        slack = float(rng.uniform(0.05, 0.15))
        farthest = 0.4 + np.hypot(*anchor) - slack
        share = sized(rng, strength, (0.5, 0.75), (0.12, 0.2))
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
        at_10_cm_per_s = sized(rng, strength, (0.5, 1.0), (0.1, 0.2))
        return cls(at_10_cm_per_s * thing.friction_force / 0.1 / thing.area)

    @property
    def parameters(self) -> dict[str, Any]:
        return {"drag_per_area": self.drag}

    def drag_per_area(self) -> float:
        return self.drag


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
        share = sized(rng, strength, (0.6, 0.85), (0.15, 0.25))
        phases = tuple(float(phase) for phase in rng.uniform(0, 2 * np.pi, 24))
        return cls(share * thing.friction_force, any_angle(rng), float(rng.uniform(0.4, 1.0)), phases)

    @property
    def parameters(self) -> dict[str, Any]:
        return {key: value for key, value in asdict(self).items() if key != "_phase"}

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
    velocity: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        size, angle = sized(rng, strength, (4e-3, 8e-3), (5e-4, 1e-3)), any_angle(rng)
        return cls((float(size * np.cos(angle)), float(size * np.sin(angle))))

    def table_velocity(self) -> FloatArray:
        return np.array(self.velocity)
