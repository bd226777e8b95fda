"""Effects of the tracker, which change what is recorded alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from blind.effects.effect import Effect, Strength, any_angle, sized
from blind.objects import FloatArray, SlidingObject


@dataclass
class SensorLatency(Effect):
    """The tracker reports a pose `latency` late."""

    name = "sensor_latency"
    changes_motion = False
    latency: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, strength: Strength, thing: SlidingObject) -> Self:
        return cls(sized(rng, strength, (0.05, 0.08), (0.015, 0.025)))

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
        size, angle = sized(rng, strength, (4e-3, 8e-3), (1e-3, 2e-3)), any_angle(rng)
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
        size = sized(rng, strength, (0.02, 0.04), (0.005, 0.01))
        return cls(1.0 + float(rng.choice([-1.0, 1.0])) * size)

    def reported(self, times: FloatArray, clock: FloatArray, poses: FloatArray) -> FloatArray:
        return super().reported(times, clock, poses) * [self.scale, self.scale, 1.0]
