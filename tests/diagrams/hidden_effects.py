"""Simulated pushes of a block, with effects that the plain model does not have."""

from __future__ import annotations

from functools import cache

import numpy as np

from slipmap.models.effects.registry import effects_named
from slipmap.models.measurements import PushDataset
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners.exploration import candidate_pushes

WIDTH = 0.02
"""Of a cell, m. Large ones show the effects as well as small ones, and are soon simulated."""

TILT = {"down_x": 0.03, "down_y": -0.04}
"""Slopes, rad."""

LATENCY = 0.08
"""By how much the tracker is late, s."""

DRAG = 3000.0
"""Of a film of oil, N s/m³: at 50 mm/s a quarter of the friction."""


@cache
def tilted_pushes() -> PushDataset:
    """Pushes on a table that is not level."""
    return _pushes("tilted", {"table_tilt": list(TILT.values())})


def late_pushes() -> PushDataset:
    """Pushes seen by a tracker that is late, faster than the others."""
    return _pushes("late", {"sensor_latency": [LATENCY]}, speed=(0.05, 0.15))


def tilted_and_oily_pushes() -> PushDataset:
    """Pushes on a table that is neither level nor dry; more and longer ones, to tell that from a cable."""
    hidden = {"table_tilt": list(TILT.values()), "viscous_friction": [DRAG]}
    return _pushes("oily", hidden, length=(0.06, 0.14), fit=12, heldout=6)


def late_and_oily_pushes() -> PushDataset:
    """Pushes on an oily table, seen by a tracker that is so late that the oil hardly shows beside it."""
    hidden = {"sensor_latency": [LATENCY], "viscous_friction": [DRAG]}
    return _pushes("late and oily", hidden, speed=(0.05, 0.15))


def _pushes(
    name: str,
    hidden: dict[str, list[float]],
    *,
    speed: tuple[float, float] = (0.03, 0.1),
    length: tuple[float, float] = (0.04, 0.09),
    fit: int = 8,
    heldout: int = 4,
) -> PushDataset:
    """Pushes all over a table of 0.6 m, of six large cells; 200 kg/m² on average."""
    grid = cells_from_polygon(np.array([[-3, -2], [3, -2], [3, 2], [-3, 2]]) * 0.01, width=WIDTH)
    mass = 200.0 * WIDTH**2 * (1.0 + 0.4 * grid.centers[:, 0] / 0.03)
    values = np.concatenate(list(hidden.values()))
    truth = Maps(mass[None], np.full((1, len(grid)), 0.3), np.array([0.3]), values[None])
    slider = Slider(grid, 0.005, effects=effects_named(list(hidden)))
    rng = np.random.default_rng(3)
    pushes = [
        candidate.push([*rng.uniform(-0.3, 0.3, 2), rng.uniform(-np.pi, np.pi)], h=2e-3)
        for candidate in candidate_pushes(grid, 0.005, rng, fit + heldout, length=length, speed=speed)
    ]
    return record_pushes(slider, truth, pushes, rng, heldout=heldout, name=name, mass=float(mass.sum()))
