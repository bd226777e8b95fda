"""A blind dataset from a seed: an object, 24 pushes, one hidden effect or none, and noisy sensors."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from slipmap.diagrams.application.studies.blind.objects import (
    GRAVITY,
    HELDOUT,
    KINDS,
    TABLE_SIZE,
    FloatArray,
    PushPlan,
    SlidingObject,
    random_object,
    random_plan,
)
from slipmap.diagrams.application.studies.blind.secret_effects import (
    LIBRARY,
    OUTSIDE,
    PLAIN,
    Chance,
    Effect,
    Kind,
    Strength,
    exact,
)
from slipmap.diagrams.application.studies.blind.world import Motion, World
from slipmap.models.files import replaced_file, replaced_folder
from slipmap.models.geometry import placed

_RATE = 100.0  # Hz
_NOISE = {"position": 2.5e-4, "angle": float(np.radians(0.15)), "tip": 5e-5, "force": 0.05}  # SI
_DROPOUTS = 0.005  # share of rows that a sensor loses, with values NaN
_SHARE_NONE, _SHARE_OUTSIDE, _SHARE_WEAK = 0.3, 0.2, 0.35
_LEAST_MOVED = 0.01  # m
_TRIES = 6


@dataclass(frozen=True)
class Truth:
    """The hidden truth of a dataset."""

    name: str  # of the dataset
    seed: int  # of the dataset
    verdict: str  # 'none' or 'effect'
    effect: str | None  # name; None without effect
    in_library: bool  # whether slipmap's library contains it
    resembles: tuple[str, ...]  # similar effects of the library
    strength: str | None  # 'clear' or 'weak'; None without effect
    parameters: dict[str, Any]  # of the effect, SI
    # mean, median, max and per_trial: displacement of the recorded end of each push by the effect, averaged
    # over the cells
    final_change_mm: dict[str, Any]
    largest_change_mm: float  # the same at any time of any push
    force_change_rms: float  # N, mean over the pushes

    @classmethod
    def read(cls, file: Path) -> Truth:
        """The truth beside a dataset."""
        document = yaml.safe_load(file.read_text(encoding="utf-8"))
        document["resembles"] = tuple(document["resembles"])
        return cls(**{key: document[key] for key in cls.__dataclass_fields__})


def truth_file(folder: Path) -> Path:
    """Path of the truth about the dataset in `folder`."""
    return folder.parent / f"{folder.name}.truth.yaml"


def generate(
    seed: int,
    folder: Path,
    *,
    effect: Kind | None = None,
    strength: Strength | None = None,
    pushes: int = len(KINDS),
) -> Truth:
    """Simulate a dataset and write it to `folder`, with the truth beside it.

    The same seed gives bit-identical files. An existing folder is replaced.

    Args:
        folder: for the dataset, which takes its name.
        effect: to hide; random if None, `PLAIN` for none.
        strength: of the effect; random if None.
    """
    rng = np.random.default_rng([seed, 0x51EB])
    drawn_effect, drawn_strength = _draw_effect(rng)
    effect, strength = effect or drawn_effect, strength or drawn_strength
    thing = random_object(np.random.default_rng([seed, 1]))
    hidden = effect.drawn(Chance(np.random.default_rng([seed, 2]), strength, thing))
    plans, plain = _plans(np.random.default_rng([seed, 3]), thing, pushes)
    changed = plain
    if hidden.changes_motion:
        world = World(thing, hidden)
        changed = [world.push(plan, index=i, count=pushes) for i, plan in enumerate(plans)]
    changes = [
        _change(thing, plan.duration, hidden, motion, before)
        for plan, motion, before in zip(plans, changed, plain, strict=True)
    ]
    final, largest, force = np.array(changes).T
    final = 1e3 * final
    is_none = effect is PLAIN
    truth = Truth(
        name=folder.name,
        seed=seed,
        verdict="none" if is_none else "effect",
        effect=None if is_none else effect.name,
        in_library=effect.in_library and not is_none,
        resembles=effect.resembles,
        strength=None if is_none else strength,
        parameters=_plain(hidden.parameters),
        final_change_mm={
            "mean": round(float(final.mean()), 3),
            "median": round(float(np.median(final)), 3),
            "max": round(float(final.max()), 3),
            "per_trial": [round(float(value), 3) for value in final],
        },
        largest_change_mm=round(float(1e3 * largest.max()), 3),
        force_change_rms=round(float(force.mean()), 4),
    )
    sensors = np.random.default_rng([seed, 4])
    trials = [
        _record(sensors, thing, plan, motion, hidden) for plan, motion in zip(plans, changed, strict=True)
    ]
    heldout = set(sensors.permutation(pushes)[: pushes * HELDOUT // len(KINDS)].tolist())
    roles = ["heldout" if index in heldout else "fit" for index in range(pushes)]
    _write(folder, _description(folder.name, thing, roles), trials)
    _write_truth(truth_file(folder), truth, thing, plans, plain)
    return truth


def _draw_effect(rng: np.random.Generator) -> tuple[Kind, Strength]:
    strength: Strength = "weak" if rng.random() < _SHARE_WEAK else "clear"
    chance = rng.random()
    if chance < _SHARE_NONE:
        return PLAIN, strength
    group = OUTSIDE if chance < _SHARE_NONE + _SHARE_OUTSIDE else LIBRARY
    return group[rng.integers(len(group))], strength


def _plans(
    rng: np.random.Generator, thing: SlidingObject, pushes: int
) -> tuple[list[PushPlan], list[Motion]]:
    """Pushes that move the object in the plain world, and their motions."""
    world = World(thing, Effect())
    plans, motions = [], []
    for kind in [KINDS[i % len(KINDS)] for i in rng.permutation(max(pushes, len(KINDS)))[:pushes]]:
        for _ in range(_TRIES):
            plan = random_plan(rng, thing, kind)
            motion = world.push(plan)
            if _distance(thing, motion.poses[-1], motion.poses[0]) > _LEAST_MOVED:
                break
        plans.append(plan)
        motions.append(motion)
    return plans, motions


def _change(
    thing: SlidingObject, duration: float, effect: Effect, motion: Motion, plain: Motion
) -> tuple[float, float, float]:
    """Changes by the effect: of the recorded pose at the end and at most, m; of the force (RMS), N."""
    times = np.arange(0.0, duration, 1.0 / _RATE)
    recorded = effect.reported(times, motion.clock, motion.poses)
    apart = _distance(thing, recorded, exact(times, plain.clock, plain.poses))
    every = round(motion.clock.size / (_RATE * motion.clock[-1]))
    pushed, plainly = (_RATE * np.diff(one.impulse[::every, :2], axis=0) for one in (motion, plain))
    force = effect.felt(pushed) - plainly
    return float(apart[-1]), float(apart.max()), float(np.sqrt((force**2).sum(axis=1).mean()))


def _distance(thing: SlidingObject, one: FloatArray, other: FloatArray) -> FloatArray:
    """(...) mean distance of the cells between poses (..., 3), m."""
    cells, others = (placed(thing.centers, poses[..., None, :]) for poses in (one, other))
    return np.linalg.norm(cells - others, axis=-1).mean(axis=-1)


def _record(
    rng: np.random.Generator, thing: SlidingObject, plan: PushPlan, motion: Motion, effect: Effect
) -> dict[str, list[list[float]]]:
    """What the sensors record: at 100 Hz, each with its own time offset, noise and lost rows."""

    def stamps() -> FloatArray:
        first = rng.uniform(0.0, 1.0 / _RATE)
        return first + np.arange(int((plan.duration - first) * _RATE)) / _RATE

    def rows(times: FloatArray, values: FloatArray, levels: list[float]) -> list[list[float]]:
        noisy = values + np.array(levels) * rng.standard_normal(values.shape)
        noisy[rng.random(len(times)) < _DROPOUTS] = np.nan
        return np.round(np.column_stack([times, noisy]), 6).tolist()

    tip_noise, force_noise = _NOISE["tip"], _NOISE["force"]
    t = stamps()
    poses = effect.reported(t, motion.clock, motion.poses)
    record = {"object_pose": rows(t, poses, [_NOISE["position"], _NOISE["position"], _NOISE["angle"]])}
    t = stamps()
    tip = np.column_stack([exact(t, motion.clock, motion.hand), np.zeros(len(t))])
    record["tip_pose"] = rows(t, tip, [tip_noise, tip_noise, 0.0])
    t = stamps()
    # Filter of the force sensor: mean from half a sampling period before to half a period after.
    half = 0.5 / _RATE
    low, high = np.maximum(t - half, 0.0), t + half
    passed = exact(high, motion.clock, motion.impulse) - exact(low, motion.clock, motion.impulse)
    wrench = passed / (high - low)[:, None]
    wrench[:, :2] = effect.felt(wrench[:, :2])
    record["ft_wrench"] = rows(t, wrench, [force_noise, force_noise, force_noise * thing.finger_radius])
    return record


def _description(name: str, thing: SlidingObject, roles: list[str]) -> dict[str, Any]:
    shape: dict[str, Any] = {
        "outline": np.round(thing.outline, 9).tolist(),
        "cells": {"width": round(thing.width, 9), "centers": np.round(thing.centers, 9).tolist()},
        "height": round(thing.height, 3),
    }
    if thing.weighed:
        shape["mass"] = round(thing.total_mass, 4)
    return {
        "format": "push-dataset/1",
        "name": name,
        "description": "24 pushes of one object over a table with a round finger; poses from a tracker, force"
        " from the finger. The order of the files is the order of the experiment.",
        "object": shape,
        "finger": {"radius": round(thing.finger_radius, 5)},
        "table": {"shape": "rectangle", "center": [0.0, 0.0], "size": [TABLE_SIZE, TABLE_SIZE]},
        "gravity": GRAVITY,
        "noise": {name: round(level, 9) for name, level in _NOISE.items()},
        "trials": [{"file": f"trials/{index:03d}.json", "role": role} for index, role in enumerate(roles)],
    }


def _write(folder: Path, description: dict[str, Any], trials: list[dict[str, Any]]) -> None:
    with replaced_folder(folder) as part:
        (part / "trials").mkdir(parents=True)
        for entry, trial in zip(description["trials"], trials, strict=True):
            (part / entry["file"]).write_text(json.dumps(trial), encoding="utf-8")
        (part / "dataset.yaml").write_text(_yaml(description), encoding="utf-8")


def _write_truth(
    file: Path, truth: Truth, thing: SlidingObject, plans: list[PushPlan], plain: list[Motion]
) -> None:
    document = asdict(truth)
    document["object"] = {
        "shape": thing.shape,
        "total_mass": thing.total_mass,
        "com": thing.center_of_mass.tolist(),
        "mu_finger": thing.mu_finger,
        "friction_force": thing.friction_force,
        "mass": thing.mass.tolist(),
        "mu": thing.mu.tolist(),
    }
    document["trials"] = [
        {
            "kind": plan.kind,
            "end": plan.end,
            "duration": plan.duration,
            "object_pose0": plan.pose.tolist(),
            "moved_mm_without_effect": 1e3 * float(_distance(thing, motion.poses[-1], motion.poses[0])),
        }
        for plan, motion in zip(plans, plain, strict=True)
    ]
    with replaced_file(file) as part:
        part.write_text(_yaml(_plain(document)), encoding="utf-8")


def _yaml(document: dict[str, Any]) -> str:
    return yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110)


def _plain(value: Any) -> Any:
    """Lists instead of tuples, numbers rounded to seven digits."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return float(f"{value:.7g}") if isinstance(value, float) else value
