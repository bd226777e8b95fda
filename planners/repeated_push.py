"""A push to repeat where the model misses something that no effect explains: with one thing changed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import shapely

from models.inference.diagnosis.results import Diagnosis
from models.inference.observations import Observation
from models.measurements import PushDataset
from planners.proposals import APPROACH, Habits, Proposal, how_to, turn


def repeat_the_worst(diagnosis: Diagnosis, dataset: PushDataset, habits: Habits) -> dict[str, Any] | None:
    """The push that the model misses most, with that changed on which the residual depends."""
    base = diagnosis.base
    likelihood = base.likelihood
    rows = likelihood.rows(base.z, base.offsets)
    worth = [np.isfinite(o.push.tip).all() for o in likelihood.observations]
    if not any(worth):
        return None
    norms = np.array([
        float(np.linalg.norm(likelihood.whiteners[b](row.pose[..., None], row.force[..., None])))
        for b, row in enumerate(rows)
    ])  # fmt: skip
    worst = int(np.argmax(np.where(worth, norms, -1.0)))
    observation = likelihood.observations[worst]
    repeated = _repeated(observation, dataset)
    if repeated is None:
        return None
    depends = (diagnosis.depends_on or "").split(":")[0]
    changed, what = _changed(repeated, depends, habits)
    told = changed.told() | {"separates": [depends or "unknown"], "separation": float(norms[worst])}
    trial = observation.trial
    return told | {
        "sentence": f"Repeat the push {trial}, which the model misses most"
        f" ({norms[worst]:.0f} standard deviations),"
        f" {what}. {how_to(told)} If the miss changes with it, that is what it depends on; if not, it is not."
    }


def _repeated(observation: Observation, dataset: PushDataset) -> Proposal | None:
    """A recorded push as a straight line from just before first touch to its end."""
    push, radius = observation.push, dataset.finger_radius
    rotation = turn(push.start_pose[2])
    local = (push.tip - push.start_pose[:2]) @ rotation
    gaps = shapely.distance(shapely.points(local), dataset.grid.polygon) - radius
    near = np.flatnonzero(gaps <= 1e-3)
    touch = int(near[0]) if len(near) else int(np.argmin(gaps))
    way = push.tip[-1] - push.tip[touch]
    length = float(np.hypot(*way))
    if length < 1e-3:
        return None
    boundary = dataset.grid.polygon.boundary
    nearest = boundary.interpolate(boundary.project(shapely.Point(local[touch])))
    speed = np.hypot(*np.diff(push.tip, axis=0).T) / push.h
    begin = push.tip[touch] - APPROACH * way / length
    pace = float(np.median(speed[speed > 0.2 * speed.max()]))
    return Proposal(push.start_pose, np.array(nearest.coords[0]), begin, push.tip[-1], pace, length, 0.0)


def _changed(push: Proposal, depends: str, habits: Habits) -> tuple[Proposal, str]:
    """The push with one thing changed, and what it is."""
    if "place" in depends:
        middle = 0.5 * (habits.low + habits.high)
        way = push.end - push.begin
        other = np.clip(2 * middle - push.pose[:2] - way, habits.low, habits.high) - push.pose[:2]
        return (
            replace(
                push, pose=push.pose + np.append(other, 0.0), begin=push.begin + other, end=push.end + other
            ),
            "at another place, all else the same",
        )
    if "direction" in depends or "object" in depends:
        angle = np.pi / 2 if "direction" in depends else np.pi
        rotation, origin = turn(angle), push.pose[:2]
        return (
            replace(
                push,
                pose=push.pose + np.array([0.0, 0.0, angle]),
                begin=origin + rotation @ (push.begin - origin),
                end=origin + rotation @ (push.end - origin),
            ),
            f"with object and finger turned by {np.degrees(angle):.0f} degrees",
        )
    if "time" in depends:
        return replace(push, dwell=2.0), "with a stop of 2 s half-way"
    if "order" in depends:
        return push, "exactly as it was, now after all others"
    fast = habits.speeds[2] if push.speed < 0.75 * habits.speeds[2] else habits.speeds[0]
    return replace(push, speed=fast), f"at {fast / push.speed:.1f} times its speed"
