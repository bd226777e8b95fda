"""Effects that change friction by the place on the table."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np

from blind.effects.effect import Effect, Instant, Strength, any_angle, place_within, sized
from blind.objects import GRAVITY, FloatArray, SlidingObject


@dataclass
class LinearFrictionField(Effect):
    """Friction grows across the table by `gradient` (1/m), and is the object's own at `center`."""

    name = "table_friction_field"
    gradient: tuple[float, float] = (0.0, 0.0)
    center: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        size, angle = sized(rng, strength, (1.2, 2.0), (0.3, 0.5)), any_angle(rng)
        return cls((float(size * np.cos(angle)), float(size * np.sin(angle))), place_within(rng, 0.1))

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
        rise = sized(rng, strength, (0.9, 1.5), (0.2, 0.35))
        factor = 1.0 + rise if rng.random() < 0.6 else 1.0 / (1.0 + rise)
        return cls(place_within(rng, 0.15), float(rng.uniform(0.13, 0.22)), 0.006, factor)

    @property
    def parameters(self) -> dict[str, Any]:
        return {"kind": "patch", **asdict(self)}

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
    center: tuple[float, float] = (0.0, 0.0)
    radius: float = 0.1
    pressure: float = 0.0
    area: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        share = sized(rng, strength, (1.5, 2.5), (0.5, 0.8))
        pressure = share * GRAVITY * thing.total_mass / thing.area
        return cls(place_within(rng, 0.2), float(rng.uniform(0.06, 0.12)), pressure, thing.area)

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
        factor = 1.0 + sized(rng, strength, (3.0, 6.0), (1.0, 1.6))
        return cls(
            place_within(rng, 0.1), float(rng.uniform(0, np.pi)), float(rng.uniform(0.02, 0.04)), factor
        )

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        across = (now.places - self.center) @ np.array([-np.sin(self.angle), np.cos(self.angle)])
        return np.where(np.abs(across) < 0.5 * self.width, self.factor, 1.0)
