"""The cell-grid model one step at a time, with derivatives with respect to all inputs of a step.

A rollout knows its whole push in advance. A caller that steps the model from outside, such as a simulation,
keeps the state itself: pose, twist, the finger's last force and the effects' memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slipmap.models.effects.effect import Effect
from slipmap.models.effects.program import Program, program_of
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.friction import AFTER, FORCE
from slipmap.models.physics.kernel import INPUTS, single_steps
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.rollout import RolloutError, Slider, Smoothing
from slipmap.models.physics.sensors import Sensors
from slipmap.models.physics.step import EXTRA_COLUMNS
from slipmap.models.physics.support import RIM_RESULTS

NO_FINGER = np.full((2, 2), np.nan)
NO_WRENCH = np.zeros(5)
_NO_DELAY = np.zeros(0)
_LONGEST_STEP = 0.1  # s


@dataclass(frozen=True, eq=False)
class StepModels:
    """K models in the form the kernel takes, so that no step checks and sums the maps again."""

    maps: Maps  # including the parameters of all effects
    reduced: tuple[FloatArray, ...]  # fields of `ReducedMaps`


class Stepper(Slider):
    """A `Slider` that takes single steps of length h.

    The state (Z,) of a model is x, y, θ (world), v_x, v_y, omega (object frame), the finger's last force
    (world, N), and the effects' memory. All are true values, whatever the sensors report.

    Args:
        grid: cells and outline.
        finger_radius: m.
        h: step, s.
        effects: see `Slider`.
        gravity: m/s².
        smoothing: see `Smoothing`.
        table: see `Slider`.

    Raises:
        ValueError: the step is not positive, or longer than 0.1 s; or as `Slider`.
    """

    program: Program

    def __init__(
        self,
        grid: CellGrid,
        finger_radius: float,
        h: float,
        effects: Sequence[Effect | str] = (),
        gravity: float = 9.81,
        smoothing: Smoothing | None = None,
        table: Table | None = None,
    ) -> None:
        if not (np.isfinite(h) and h > 0):
            raise ValueError(f"the step h must be positive, got {h} s")
        if h > _LONGEST_STEP:
            raise ValueError(f"the step h must be at most {_LONGEST_STEP:g} s, got {h:g} s; is it in s?")
        super().__init__(grid, finger_radius, gravity, smoothing, effects, table)
        self.program = program_of(self.effects)
        self.h = float(h)
        self._per_step = self._constants(self.h, 0.0)

    def __reduce__(self) -> tuple[object, ...]:
        return Stepper, (
            self.grid, self.finger_radius, self.h, self.effects, self.gravity, self.smoothing, self.table,
        )  # fmt: skip

    def on(self, table: Table | None) -> Stepper:
        """The same model on another table, or on a floor without a rim."""
        if table == self.table:
            return self
        return Stepper(
            self.grid, self.finger_radius, self.h, self.effects, self.gravity, self.smoothing, table
        )  # fmt: skip

    @property
    def size(self) -> int:
        """Z: size of one model's state."""
        return AFTER + max(0, self.program.memory - FORCE)

    def models(self, maps: Maps) -> StepModels:
        """Prepare K models.

        Raises:
            ValueError: maps for a different grid or different effects, or without friction.
        """
        maps = Maps(maps.mass, maps.mu, maps.mu_finger, self._effect_values(maps))
        return StepModels(maps, self._reduced(maps))

    def start(self, models: StepModels, poses: FloatArray, twists: FloatArray | None = None) -> FloatArray:
        """(K, Z) states whose tracker reports `poses` (K, 3) or (3,), at rest or with twists (K, 3)."""
        K = len(models.maps)
        reported = np.array(np.broadcast_to(poses, (K, 3)), dtype=float)
        states = np.zeros((K, self.size))
        sensors = Sensors.of(self.program, models.maps.effects)
        states[:, :3] = sensors.true_starts(reported[:, None]).poses[:, 0]
        states[:, 3:6] = 0.0 if twists is None else twists
        return states

    def step(
        self,
        models: StepModels,
        states: FloatArray,
        *,
        wrench: FloatArray = NO_WRENCH,
        tip: FloatArray = NO_FINGER,
        time: float = 0.0,
        order: float = 0.0,
        derive: bool = False,
    ) -> tuple[FloatArray, FloatArray]:
        """Take one step with K models.

        Args:
            models: see `models`.
            states: (K, Z).
            wrench: (5,) force (world, N), its point (object frame, m) and a torque (N m), as in `Push`.
            tip: (2, 2) finger centre before and after the step, world, m; NaN for no finger; it does not
                turn.
            time: from the start of the push to the start of the step, s.
            order: index of the push in the experiment, from 0.
            derive: whether to differentiate.

        Returns:
            States after the step (K, Z), and their derivatives (K, Z, C) with respect to mass (n), mu (n),
            finger friction, pose (3), twist (3), the effects' parameters (P), last force and memory (Z - 6),
            wrench (5), tip before and after (4); C is 0 without `derive`.

        Raises:
            RolloutError: a model's step was not solved; names the model.
        """
        # Always the same memory layout, so that the kernel is compiled only once.
        states = np.ascontiguousarray(states, dtype=float)
        wrench, path = np.ascontiguousarray(wrench, dtype=float), np.zeros((2, 3))
        path[:, :2] = tip
        (K, Z), n = states.shape, len(self.grid)
        constants = self._per_step.copy()
        constants[0, 0], constants[0, 2] = time, order
        columns = n + EXTRA_COLUMNS + self.program.parameters + Z - 6 + INPUTS if derive else 0
        after, jacobian = np.empty((K, Z + 1)), np.empty((K, Z, columns))
        # Fields of `Formulas`.
        formulas = (self.program.addresses, self.program.sizes, constants, models.maps.effects, _NO_DELAY)
        drive = (self.h, path, wrench)
        by_mass = np.zeros((K, Z, n if derive and self._top is not None else 0))
        found = np.empty((K, 0 if self._top is None else RIM_RESULTS))
        model = (self._common, models.reduced, formulas, self._top)
        unsolved = single_steps(*model, drive, states, after, jacobian, by_mass, found)
        if unsolved >= 0:
            raise RolloutError(f"model {unsolved}: the step from t = {time:.6g} s was not solved")
        return after[:, :Z], self._map_columns(models.maps, jacobian, by_mass) if derive else jacobian

    def load(self) -> None:
        """Load or compile the machine code of a step, so that the first step is as fast as the others."""
        n = len(self.grid)
        models = self.models(Maps(np.full((1, n), 1.0 / n), np.full((1, n), 0.3), np.full(1, 0.3)))
        self.step(models, self.start(models, np.zeros(3)))

    def delay(self, parameters: FloatArray) -> tuple[float, FloatArray]:
        """The tracker's delay, s, and its gradient (P,) in the effects' parameters (P,)."""
        if self.program.delay is None:
            return 0.0, np.zeros(self.program.parameters)
        return self.program.delay(parameters)


__all__ = ["NO_FINGER", "NO_WRENCH", "StepModels", "Stepper"]
