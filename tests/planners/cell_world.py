"""A world whose truth is the cell-grid model with maps of its own, and whose finger is off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.measurements.trial import Channel, Trial
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.physics.balance import balance_margins
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.rollout import Push, Slider, Smoothing
from slipmap.planners.push_decisions import ObjectFell
from slipmap.planners.table_push import TablePush

RADIUS = 0.008
TABLE = Table("round", (0.0, 0.0), radius=0.5)


def belief_about(thing: TrueObject, hypotheses: int = 20, seed: int = 0) -> Belief:
    """Each cell's load is known to 5 %, how much of it is friction only to 25 %, both varying smoothly."""
    rng = np.random.default_rng(seed)
    r = thing.grid.centers
    near = np.exp(-((r[:, None] - r[None]) ** 2).sum(axis=-1) / (2 * 0.1**2)) + 1e-6 * np.eye(len(r))
    fields = np.linalg.cholesky(near) @ rng.standard_normal((2, len(r), hypotheses))
    mu = thing.mu * np.exp(0.25 * fields[0].T)
    load = thing.mu * thing.mass * np.exp(0.05 * fields[1].T)
    finger = thing.mu_finger * np.exp(0.1 * rng.standard_normal(hypotheses))
    return Belief(
        grid=thing.grid, finger_radius=RADIUS, gravity=9.81, maps=Maps(load / mu, mu, finger),
        probability=np.full(hypotheses, 1 / hypotheses), smoothing=Smoothing(penetration=1e-4),
        dataset="", fingerprint="", method="made", seed=seed,
    )  # fmt: skip


def with_effects(belief: Belief, names: list[str], values: Sequence[float]) -> Belief:
    """The belief with effects of these sizes in all hypotheses."""
    maps = belief.maps
    sizes = np.tile(np.asarray(values, dtype=float), (len(belief), 1))
    return replace(belief, maps=Maps(maps.mass, maps.mu, maps.mu_finger, sizes), effects=effects_named(names))


class CellWorld:
    """The finger begins off by 2 mm, goes off by 1°, and ends off by 2 mm more (one standard deviation)."""

    def __init__(self, name: str, pose, seed: int, table: Table = TABLE, noise: float = 1.0) -> None:
        self.thing = benchmark_object(name)
        self.table = table
        self.finger_radius = RADIUS
        self.pose = np.array(pose, dtype=float)
        self.lowest = np.inf
        self._noise = noise
        self._rng = np.random.default_rng(seed)
        self._slider = Slider(self.thing.grid, RADIUS, table=table)

    def look(self):
        if self.lowest < 0:
            raise ObjectFell(f"the {self.thing.name} fell")
        return self.pose + self._noise * np.array([5e-4, 5e-4, 3e-3]) * self._rng.standard_normal(3)

    def push(self, push: TablePush) -> Trial:
        shift, stretch, (turn, _) = (
            self._noise * self._rng.standard_normal((3, 2)) * [[2e-3], [2e-3], [0.0175]]
        )
        c, s = np.cos(turn), np.sin(turn)
        begin = push.begin + shift
        end = begin + np.array([[c, -s], [s, c]]) @ (push.end - push.begin) + stretch
        steps = max(int(push.length / 5e-4), 2)
        tip = begin + np.outer(np.linspace(0.0, 1.0, steps + 1), end - begin)
        tip = np.concatenate([tip, np.repeat(tip[-1:], 50, axis=0)])
        h = 5e-4 / push.speed
        times = np.linspace(0.0, h * (len(tip) - 1), 40)
        imagined = Push(h, tip, self.pose, pose_times=times[1:])
        poses = self._slider.rollout(self.thing.maps, [imagined]).poses_of(0)[0]
        center = self.thing.center_of_mass[None, :2]
        self.lowest = min(self.lowest, balance_margins(self.thing.grid, center, poses, self.table).min())
        track = Channel(times, np.vstack([self.pose, poses]))
        self.pose = poses[-1]
        return Trial("trials/000.json", "fit", track, Channel(h * np.arange(len(tip)), tip))
