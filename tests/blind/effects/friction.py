"""Effects that change friction by speed, direction and push, or with the load."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from blind.effects.effect import Effect, Instant, Strength, sized
from blind.objects import GRAVITY, FloatArray, SlidingObject


@dataclass
class StribeckFriction(Effect):
    """Friction is `static` times larger at rest and falls to its value within about `speed`."""

    name = "stribeck_friction"
    static: float = 1.0
    speed: float = 0.05

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        rise = sized(rng, strength, (0.5, 0.9), (0.12, 0.2))
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
        root = np.sqrt(sized(rng, strength, (1.25, 1.5), (1.06, 1.12)))
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
class FrictionDrift(Effect):
    """Friction of all pushes together changes by `change` from the first to the last, its mean kept."""

    name = "friction_drift"
    change: float = 0.0
    _share: float = field(default=0.0, repr=False)

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        size = sized(rng, strength, (0.4, 0.7), (0.1, 0.18))
        return cls(float(rng.choice([-1.0, 1.0])) * size)

    @property
    def parameters(self) -> dict[str, Any]:
        return {"change": self.change}

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
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        share = sized(rng, strength, (0.6, 1.0), (0.12, 0.2))
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
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        return cls(sized(rng, strength, (0.35, 0.6), (0.08, 0.14)), float(rng.uniform(0.003, 0.01)))

    @property
    def parameters(self) -> dict[str, Any]:
        return {"rise": self.rise, "memory": self.memory}

    def begin(self, push: int, pushes: int, points: int) -> None:
        self._age = np.ones(points)

    def friction_factor(self, now: Instant) -> FloatArray | float | None:
        self._age = (self._age + now.step) / (1.0 + now.step * now.speeds / self.memory)
        return 1.0 + self.rise * np.log10(1.0 + self._age / 0.01)
