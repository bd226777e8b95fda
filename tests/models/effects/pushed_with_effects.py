"""One object, one push by a finger and one coast, and parameters at which each effect of the library
shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slipmap.models.effects import LIBRARY, Effect
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps, Push, Rollouts, Slider

FloatArray = NDArray[np.float64]

RADIUS = 0.005
H = 0.01
EFFECTS = {effect.name: effect for effect in LIBRARY}

SHOWN: dict[str, tuple[float, ...]] = {
    "viscous_friction": (300.0,),
    "stribeck_friction": (0.4, 0.05, 1.6),
    "anisotropic_table": (0.15, -0.1),
    "anisotropic_object": (-0.12, 0.2),
    "table_tilt": (0.05, -0.04),
    "table_friction_field": (1.2, -1.8, 0.4, 0.05, 0.01, 0.06),
    "tether": (8.0, -0.2, 0.1, 0.12, 0.02, -0.01),
    "sensor_latency": (0.033,),
    "friction_drift": (0.02,),
    "finger_compliance": (2e-3,),
    "loose_mass": (0.3, 15.0, 0.2),
    "load_transfer": (0.02, 0.03),
    "skate": (0.2, 0.4, 0.01, -0.015),
    "impulse_friction": (0.7,),
    "friction_diamond": (0.6,),
    "friction_square": (0.7,),
    "slip_load": (0.6,),
    "torsional_friction": (0.01,),
    "tracker_offset": (0.004, -0.003, 0.05),
    "tracker_scale": (0.02,),
    "tracker_shift": (0.004, -0.003, 0.02),
    "force_frame": (0.4, 0.2),
    "force_bias": (0.1, -0.07),
    "force_gains": (0.1,),
    "force_latency": (0.033,),
}
"""Parameters, in order, away from their nulls."""


def block(columns: int = 5, rows: int = 3, width: float = 0.02) -> CellGrid:
    """A rectangle that its cells tile exactly, centred on the origin."""
    x, y = np.meshgrid((np.arange(columns) - (columns - 1) / 2), (np.arange(rows) - (rows - 1) / 2))
    half = np.array([columns, rows]) * width / 2
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    return CellGrid(np.column_stack([x.ravel(), y.ravel()]) * width, width, corners)


BLOCK = block()


def plain_maps(mu_finger: float = 0.1) -> Maps:
    rng = np.random.default_rng(11)
    n = len(BLOCK)
    return Maps(rng.uniform(0.02, 0.05, n), rng.uniform(0.2, 0.5, n), np.array([mu_finger]))


def with_values(maps: Maps, values: FloatArray | Sequence[float]) -> Maps:
    return Maps(maps.mass, maps.mu, maps.mu_finger, np.atleast_2d(np.asarray(values, dtype=float)))


def sliding_push(duration: float = 0.6, h: float = H) -> Push:
    """The finger slides along the left side at 5 cm/s. It touches once and stays, far from corners."""
    start = np.array([0.02, -0.01, 0.3])
    c, s = np.cos(start[2]), np.sin(start[2])
    turn = np.array([[c, -s], [s, c]])
    begin = start[:2] + turn @ [-0.05 - RADIUS - 2e-4, 0.008]
    velocity = 0.05 * turn @ [np.cos(0.6), np.sin(0.6)]
    steps = round(duration / h)
    ends = h * np.arange(steps + 1)
    return Push(h, begin + np.outer(ends, velocity), start, force_times=ends[:-1] + h / 2, order=4.0)


def coasting(duration: float = 0.3) -> Push:
    """Thrown, without a finger; still moving at the end."""
    steps = round(duration / H)
    start, twist = np.array([0.02, -0.01, 0.3]), np.array([1.5, -0.4, 5.0])
    return Push(H, np.full((steps + 1, 2), np.nan), start, twist, order=4.0)


def slider_of(effects: Sequence[Effect], grid: CellGrid = BLOCK) -> Slider:
    return Slider(grid, RADIUS, effects=effects)


def slide(
    effects: Sequence[Effect],
    values: Sequence[float],
    push: Push,
    *,
    grid: CellGrid,
    mass: float = 0.5,
    mu: float | FloatArray = 0.3,
    mu_finger: float = 0.3,
) -> Rollouts:
    """An object of uniform mass (kg, in all) under one push."""
    n = len(grid)
    row = np.array([values]) if len(values) else np.zeros((1, 0))
    maps = Maps(np.full((1, n), mass / n), np.broadcast_to(mu, (1, n)), np.array([mu_finger]), row)
    return slider_of(effects, grid).rollout(maps, [push])


def coast_of(
    twist: Sequence[float],
    duration: float,
    h: float,
    *,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    order: float = 0.0,
    times: FloatArray | None = None,
) -> Push:
    tip = np.full((round(duration / h) + 1, 2), np.nan)
    return Push(h, tip, np.array(start), np.array(twist), pose_times=times, order=order)


def steady_push(
    angle: float, *, yaw: float = 0.0, order: float = 0.0, half: float = 0.03, speed: float = 0.05
) -> Push:
    """Against the middle of a side of a square centred on the origin, world direction `angle`, for one
    second."""
    h = 2e-3
    ends = h * np.arange(501)
    way = np.array([np.cos(angle), np.sin(angle)])
    tip = np.outer(speed * ends - half - RADIUS, way)
    return Push(h, tip, np.array([0.0, 0.0, yaw]), force_times=ends[1:] - h / 2, order=order)
