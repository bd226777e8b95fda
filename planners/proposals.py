"""Straight pushes on the table that a person could make next, like those that were recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.angles import angle_between
from models.inference.observations import Observation
from models.measurements import PushDataset
from models.physics.cell_grid import FloatArray
from models.physics.rollout import Push
from planners.exploration import CandidatePush, NoReachablePush, candidate_pushes
from planners.rehearsal import straight_push

CONTACTS = 60
FASTER = 1.5
"""How much faster or slower than any recorded push a proposal may be."""

DWELL = 0.5
"""s that a finger stands still half-way."""

APPROACH = 0.01
"""m between finger and object before."""


@dataclass(frozen=True)
class Habits:
    """What the recorded pushes were like.

    Attributes:
        low: (2,) corner of the places at which the object was, m.
        high: (2,) opposite corner.
        speeds: slow, medium and fast, m/s.
        lengths: shortest and longest way to propose, m.
        pose_rows: rows of the tracker that an observed pose is the mean of.
        force_rows: the same of a force; 0 where none was measured.
        pushes: their number.
    """

    low: FloatArray
    high: FloatArray
    speeds: tuple[float, float, float]
    lengths: tuple[float, float]
    pose_rows: float
    force_rows: float
    pushes: int


def habits_of(observations: Sequence[Observation], dataset: PushDataset) -> Habits:
    """Region, speeds and lengths of recorded pushes."""
    poses = np.concatenate([np.vstack([o.push.start_pose, o.poses]) for o in observations])[:, :2]
    speeds, ways = [], []
    for o in observations:
        speed = np.hypot(*np.diff(o.push.tip, axis=0).T) / o.push.h
        moving = speed[np.isfinite(speed) & (speed > 1e-3)]
        if len(moving):
            speeds.append(float(np.median(moving)))
        ways.append(float(np.hypot(*(o.poses[-1, :2] - o.push.start_pose[:2]))))
    speeds = speeds or [0.05]
    force_rows = np.concatenate([o.force_rows[o.sliding] for o in observations])
    longest = max(max(ways), 0.5 * float(np.ptp(dataset.grid.exterior, axis=0).max()))
    return Habits(
        poses.min(axis=0),
        poses.max(axis=0),
        (min(speeds) / FASTER, float(np.median(speeds)), max(speeds) * FASTER),
        (0.5 * longest, longest),
        float(np.median(np.concatenate([o.pose_rows for o in observations]))),
        float(np.median(force_rows)) if len(force_rows) else 0.0,
        len(dataset.trials),
    )


@dataclass(frozen=True, eq=False)
class Proposal:
    """A candidate push on the table."""

    pose: FloatArray
    contact: FloatArray
    begin: FloatArray
    end: FloatArray
    speed: float
    length: float
    dwell: float

    @classmethod
    def of(cls, push: CandidatePush, pose: FloatArray, speed: float, length: float, dwell: float) -> Proposal:
        """A push of an object that lies at a pose (3,)."""
        rotation = turn(pose[2])
        begin = pose[:2] + rotation @ (push.touch - push.approach * push.direction)
        end = pose[:2] + rotation @ (push.touch + length * push.direction)
        return cls(pose, push.contact, begin, end, speed, length, dwell)

    def push(self, order: float, misplaced: FloatArray | None = None, *, coarseness: float = 1.0) -> Push:
        """To be simulated, if wanted with the object a little off (3,), or in longer steps."""
        pose = self.pose if misplaced is None else self.pose + misplaced
        return straight_push(
            pose, self.begin, self.end, self.speed, dwell=self.dwell, order=order, coarseness=coarseness
        )

    def told(self) -> dict[str, Any]:
        """As plain numbers."""
        way = self.end - self.begin
        return {
            "pose": [float(value) for value in self.pose],
            "contact": [float(value) for value in self.contact],
            "direction_deg": float(np.degrees(np.arctan2(way[1], way[0]))),
            "speed": float(self.speed),
            "length": float(self.length),
            "dwell": float(self.dwell),
            "tip_start": [float(value) for value in self.begin],
            "tip_end": [float(value) for value in self.end],
        }


def proposals_for(
    dataset: PushDataset, habits: Habits, mu_finger: float, count: int, rng: np.random.Generator
) -> list[Proposal]:
    """Random pushes that stay in the region of the recorded ones and on the table.

    Half of them come in pairs that differ by half a turn alone, since a reversed push is what tells many
    apart.
    """
    cone = float(np.clip(0.9 * np.arctan(mu_finger), 0.05, np.pi / 4))
    contacts = candidate_pushes(
        dataset.grid, dataset.finger_radius, rng, CONTACTS, cone=cone, approach=APPROACH
    )
    found: list[Proposal] = []
    for _ in range(20 * count):
        if len(found) >= count:
            break
        contact = contacts[int(rng.integers(len(contacts)))]
        yaw = float(rng.uniform(-np.pi, np.pi))
        length = float(rng.uniform(*habits.lengths))
        speed = habits.speeds[int(rng.integers(3))]
        dwell = DWELL if rng.random() < 0.25 else 0.0
        for turned in (0.0, np.pi) if rng.random() < 1 / 3 else (0.0,):
            angle = float(angle_between(yaw, -turned))
            place = _place(habits, length * turn(angle) @ contact.direction, rng)
            proposal = Proposal.of(contact, np.array([*place, angle]), speed, length, dwell)
            if _on_table(proposal, dataset):
                found.append(proposal)
    if not found:
        raise NoReachablePush("no push stays on the table")
    return found[:count]


def _place(habits: Habits, move: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Where to begin so that a move ends in the region too; centred on it where it does not fit."""
    low, high = habits.low - np.minimum(move, 0.0), habits.high - np.maximum(move, 0.0)
    middle = 0.5 * (habits.low + habits.high) - 0.5 * move
    return np.where(low < high, rng.uniform(np.minimum(low, high), np.maximum(low, high)), middle)


def _on_table(proposal: Proposal, dataset: PushDataset) -> bool:
    table = dataset.table
    if table is None:
        return True
    way = proposal.end - proposal.begin
    corners = dataset.grid.exterior @ turn(proposal.pose[2]).T + proposal.pose[:2]
    points = np.vstack([corners, corners + way]) - np.asarray(table.center)
    if table.radius is not None:
        return bool((np.hypot(*points.T) < table.radius).all())
    assert table.size is not None
    return bool((np.abs(points) < 0.5 * np.asarray(table.size)).all())


def how_to(told: dict[str, Any]) -> str:
    """What to do, in a sentence."""
    x, y, angle = told["pose"]
    stop = f", rest {told['dwell']:.1g} s half-way" if told["dwell"] else ""
    return (
        f"Put the object at x = {1e3 * x:.0f} mm, y = {1e3 * y:.0f} mm, turned by {np.degrees(angle):.0f}°;"
        f" move the finger from ({1e3 * told['tip_start'][0]:.0f}, {1e3 * told['tip_start'][1]:.0f}) mm to"
        f" ({1e3 * told['tip_end'][0]:.0f}, {1e3 * told['tip_end'][1]:.0f}) mm"
        f" at {1e3 * told['speed']:.0f} mm/s{stop},"
        " and stop abruptly."
    )


def turn(angle: float) -> FloatArray:
    """(2, 2) rotation by an angle, rad."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])
