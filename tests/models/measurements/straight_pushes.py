"""Pushes of a bar in many orientations on all four sides, along their normals, whose contact is exact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from slipmap.models.geometry import placed, rotated
from slipmap.models.measurements import Channel, Noise, PushDataset, Trial, read_dataset, write_dataset
from slipmap.models.objects.footprints import cells_from_polygon

RADIUS = 0.006
HALF = np.array([0.06, 0.035])  # m
SPEED = 0.08  # m/s
FRICTION = 0.2  # rad between force and normal


def straight_push(number: int) -> Trial:
    """The finger comes from 4 mm away, takes the bar 50 mm along and goes back 30 mm."""
    side, angle = number % 4, 0.3 + 0.9 * number
    inward = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][side]
    half = HALF[side % 2]
    along = 0.4 * HALF[1 - side % 2] * (-1.0) ** (number // 4)
    start = np.array([0.2 * np.cos(number), 0.2 * np.sin(number), angle])
    time = np.arange(0.0, 1.2, 0.01)
    way = SPEED * np.minimum(time, 0.675) - 0.004  # of the finger past contact
    back = SPEED * np.maximum(time - 0.8, 0.0)
    direction = rotated(np.array(inward), angle)
    pose = start + np.append(direction, 0.0) * np.maximum(way, 0.0)[:, None]
    normal = np.array(inward)
    touch = -(half + RADIUS) * normal + along * np.array([-normal[1], normal[0]])
    tip = placed(touch, start) + direction * (way - back)[:, None]
    pushing = (way > 0.0) & (time < 0.675)
    force = 4.0 * rotated(direction, FRICTION * (-1.0) ** number) * pushing[:, None]
    wrench = np.column_stack([force, 0.0 * time])
    role = "heldout" if number % 4 == 3 else "fit"
    channels = (Channel(time, pose), Channel(time, tip), Channel(time, wrench))
    return Trial(f"trials/{number:03d}.json", role, *channels)


def straight_pushes(count: int = 12) -> PushDataset:
    x, y = HALF
    outline = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    trials = tuple(straight_push(number) for number in range(count))
    grid = cells_from_polygon(outline, count=20)
    return PushDataset("bar", "", grid, None, None, RADIUS, None, 9.81, Noise(), trials, "")


Change = Callable[[Trial], Trial]


def reread(folder: Path, dataset: PushDataset, change: Change, only: int | None = None) -> PushDataset:
    """The dataset as it is read after a change of all pushes, or of one."""
    trials = tuple(
        change(trial) if only is None or number == only else trial
        for number, trial in enumerate(dataset.trials)
    )
    return read_dataset(write_dataset(replace(dataset, trials=trials), folder / "pushes", overwrite=True))


def posed(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda trial: replace(
        trial, object_pose=Channel(trial.object_pose.time, change(trial.object_pose.values))
    )


def tipped(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda trial: replace(trial, tip_pose=Channel(trial.tip_pose.time, change(trial.tip_pose.values)))


def forced(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda trial: replace(
        trial, ft_wrench=Channel(trial.ft_wrench.time, change(trial.ft_wrench.values))
    )
