"""A block with a belief about it, pushes across it, and a player of what was recorded of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from pydrake.common.value import Value

from slipmap.diagrams.systems.python_system import PythonSystem
from slipmap.models.inference.belief import Belief
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Maps, Push, Slider, Smoothing
from slipmap.planners.exploration import candidate_pushes

RADIUS = 0.005
H = 0.01


def block() -> CellGrid:
    """6 x 4 cells of 1 cm."""
    return cells_from_polygon(np.array([[-3, -2], [3, -2], [3, 2], [-3, 2]]) * 0.01, width=0.01)


def block_belief(models: int = 4) -> Belief:
    """Hypotheses that differ by a few percent in where their mass is."""
    grid = block()
    lean = np.linspace(0.3, 0.5, models)[:, None]
    mass = 0.02 * (1.0 + lean * grid.centers[:, 0] / 0.03)
    weight = 1.0 + np.arange(models)
    return Belief(
        grid=grid,
        finger_radius=RADIUS,
        gravity=9.81,
        maps=Maps(mass, np.full_like(mass, 0.3), np.full(models, 0.3)),
        probability=weight / weight.sum(),
        smoothing=Smoothing(),
        dataset="block",
        fingerprint="0",
        method="gauss-newton",
        seed=0,
    )


def table_pushes(count: int, seed: int, spread: float = 0.2) -> list[Push]:
    """Straight pushes of the block wherever it lies, poses wanted at 30 times."""
    rng = np.random.default_rng(seed)
    pushes = []
    for candidate in candidate_pushes(block(), RADIUS, rng, count, length=(0.06, 0.12)):
        push = candidate.push([*rng.uniform(-spread, spread, 2), rng.uniform(-np.pi, np.pi)], h=H)
        times = np.linspace(0.0, push.h * (len(push.tip) - 1), 31)[1:]
        pushes.append(Push(push.h, push.tip, push.start_pose, pose_times=times))
    return pushes


def moved(push: Push, effects: Sequence[Any] = (), values: Sequence[float] = ()) -> FloatArray:
    """(30, 3) poses of the most probable hypothesis' block, with effects it does not know of."""
    maps = block_belief().maps[3:]
    maps = Maps(maps.mass, maps.mu, maps.mu_finger, np.reshape(values, (1, -1)))
    slider = Slider(block(), RADIUS, effects=effects)
    return slider.rollout(maps, [push]).poses[0]


class Player(PythonSystem):
    """Plays functions of time; `vectors` by name with their size, `values` by name."""

    def __init__(
        self,
        vectors: dict[str, tuple[int, Callable[[float], Any]]],
        values: dict[str, Callable[[float], Any]],
    ) -> None:
        super().__init__()
        ticket = {self.time_ticket()}
        for name, (size, vector) in vectors.items():
            self.DeclareVectorOutputPort(
                name, size, lambda c, o, f=vector: o.SetFromVector(f(c.get_time())), ticket
            )
        for name, value in values.items():
            self.DeclareAbstractOutputPort(
                name,
                lambda: Value[object](None),
                lambda c, o, f=value: o.set_value(f(c.get_time())),
                ticket,
            )


def seen(pose: FloatArray, position: float = 5e-4, angle: float = 4e-3) -> SimpleNamespace:
    """What a camera says of a pose."""
    covariance = np.diag([position**2, position**2, angle**2])
    return SimpleNamespace(pose=np.asarray(pose), covariance=covariance, valid=True)
