"""Effects of bodies and springs: in the finger, in the object and under it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from blind.effects.effect import Blade, Effect, LooseMass, Strength, sized
from blind.objects import SlidingObject


@dataclass
class FingerCompliance(Effect):
    """The recorded position is that of the hand; the tip hangs on it by a spring, `compliance` in m/N."""

    name = "finger_compliance"
    compliance: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        bend = sized(rng, strength, (4e-3, 8e-3), (1e-3, 2e-3))
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
        share = sized(rng, strength, (0.5, 0.7), (0.15, 0.25))
        x, y = thing.center_of_mass
        frequency, ratio = float(rng.uniform(1.2, 2.5)), float(rng.uniform(0.1, 0.4))
        return cls(share, frequency, ratio, (float(x), float(y)), share * thing.total_mass)

    def loose_mass(self) -> LooseMass | None:
        omega = 2 * np.pi * self.frequency
        damping = 2 * self.damping_ratio * self.mass * omega
        return LooseMass(self.mass, self.place, self.mass * omega**2, damping)


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
        share = sized(rng, strength, (0.35, 0.6), (0.06, 0.12))
        return cls((float(x), float(y)), float(rng.uniform(0, np.pi)), share * thing.friction_force)

    def blade(self) -> Blade | None:
        return Blade(self.place, self.angle, self.resistance)
