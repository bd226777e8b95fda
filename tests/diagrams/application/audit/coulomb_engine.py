"""The model itself as an engine to audit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from slipmap.diagrams.application.audit.engines import EngineScene
from slipmap.models.effects.effect import Effect
from slipmap.models.geometry import rotated
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.stepper import Stepper


class CoulombEngine:
    """A subclass may add effects for the audit to find."""

    dt: ClassVar[float] = 2e-3
    effects: ClassVar[Sequence[Effect]] = ()
    parameters: ClassVar[Sequence[float]] = ()  # of the effects

    def __init__(self, scene: EngineScene, gravity: FloatArray) -> None:
        self._scene, self._gravity = scene, np.asarray(gravity, dtype=float)
        self._stepper = Stepper(
            scene.grid, scene.finger_radius, self.dt, self.effects, gravity=-float(self._gravity[2])
        )
        maps = scene.maps
        self._models = self._stepper.models(
            Maps(maps.mass, maps.mu, maps.mu_finger, np.array([self.parameters], dtype=float))
        )

    def reset(self, pose: FloatArray, velocity: FloatArray, tip: FloatArray) -> None:
        twist = np.array([[*rotated(velocity[:2], -pose[2]), velocity[2]]])
        self._state = self._stepper.start(self._models, np.asarray(pose, dtype=float), twist)

    def step(
        self, tip: FloatArray, tip_velocity: FloatArray, next_tip: FloatArray, next_velocity: FloatArray
    ) -> FloatArray:
        along = self._scene.mass.sum() * self._gravity[:2]
        wrench = np.array([*along, *self._scene.center_of_mass, 0.0])
        self._state, _ = self._stepper.step(
            self._models, self._state, wrench=wrench, tip=np.array([tip, next_tip])
        )
        return np.asarray(self._state[0, 6:8])

    def pose(self) -> FloatArray:
        return np.asarray(self._state[0, :3])
