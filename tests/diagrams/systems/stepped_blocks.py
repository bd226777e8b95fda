"""The block as a Drake system, built once for each effect, and as a rollout."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from moving_blocks import RADIUS, H, block, block_belief

from slipmap.diagrams.systems.cell_grid_slider import CellGridSlider
from slipmap.models.effects.registry import effects_named
from slipmap.models.physics.rollout import Maps, Push, Slider

FloatArray = np.ndarray

VALUES: dict[str, list[float]] = {
    "plain": [],
    "stribeck_friction": [0.4, 0.05, 1.6],
    "table_tilt": [0.03, -0.04],
    "friction_drift": [0.05],
    "sensor_latency": [0.033],
    "finger_compliance": [2e-3],
    "loose_mass": [0.3, 15.0, 0.2],
    "tracker_offset": [0.002, -0.001, 0.02],
}


def maps_of(name: str) -> Maps:
    maps = block_belief().maps[1:2]
    return Maps(maps.mass, maps.mu, maps.mu_finger, np.reshape(VALUES[name], (1, -1)))


@lru_cache
def system_of(name: str) -> Any:
    """Built once: each build keeps some memory for ever."""
    effects = [] if name == "plain" else effects_named([name])
    return CellGridSlider(block(), maps_of(name), RADIUS, H, effects)


@lru_cache
def autodiff_system_of(name: str) -> Any:
    return system_of(name).ToAutoDiffXd()


def rollout(name: str, push: Push, maps: Maps | None = None, **options: Any) -> Any:
    effects = [] if name == "plain" else effects_named([name])
    slider = Slider(block(), RADIUS, effects=effects)
    return slider.rollout(maps or maps_of(name), [push], **options)


def finger(push: Push, k: int) -> FloatArray:
    return np.concatenate([push.tip[k], (push.tip[k + 1] - push.tip[k]) / push.h])


def every_step(push: Push) -> Push:
    steps = len(push.tip) - 1
    middles = (np.arange(steps) + 0.5) * push.h
    return Push(push.h, push.tip, push.start_pose, push.start_twist, None, middles, push.wrench, order=3.0)


def steps(system: Any, context: Any, push: Push, count: int, see: Callable[[], Any]) -> list[Any]:
    """What is seen after each of the first steps of a push."""
    system.set_motion(context, push.start_pose, push.start_twist)
    system.set_push(context, 0.0, push.order)
    rows = []
    for k in range(count):
        context.SetTime(k * push.h)
        system.GetInputPort("finger").FixValue(context, finger(push, k))
        if push.wrench is not None:
            system.GetInputPort("wrench").FixValue(context, push.wrench[k])
        after = system.EvalUniquePeriodicDiscreteUpdate(context).get_vector().CopyToVector()
        context.SetDiscreteState(after)
        rows.append(see())
    return rows
