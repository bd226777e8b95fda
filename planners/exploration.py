"""Pushes worth trying on an object of which nothing is known: Algorithm 2, line 1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike

from slipmap.models.geometry import angle_between
from slipmap.models.inference.observations import Observation
from slipmap.models.measurements import PushDataset
from slipmap.models.objects import contour_cells
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Push
from slipmap.planners.rehearsal import straight_push

TRIES_PER_CELL = 20
DESCENT = 0.008
"""Room around the finger where it comes down, m: as wrong as object and finger can be together."""
TOUCH = 1e-9  # m; a path that comes nearer than the finger's radius less this touches


class NoReachablePush(ValueError):
    """No direction was found in which the finger reaches the contour without touching the object before."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A straight push of a round finger against one cell of the contour.

    Attributes:
        cell: the cell.
        contact: (2,) point of the outline that is touched first, object frame, m.
        direction: (2,) unit vector of the finger's motion, object frame.
        touch: (2,) finger centre at first touch, object frame, m.
        approach: way of the finger before it touches, m.
        length: way of the finger from first touch to its stop, m.
        speed: of the finger between speeding up and slowing down, m/s.
    """

    cell: int
    contact: FloatArray
    direction: FloatArray
    touch: FloatArray
    approach: float
    length: float
    speed: float

    def push(self, pose: ArrayLike, *, h: float = 1e-3, ramp: float = 0.1, rest: float = 0.2) -> Push:
        """The push that a finger at rest performs on the object at `pose`.

        The finger waits for `rest`, speeds up and slows down evenly over `ramp` each, and waits again.

        Args:
            pose: (3,) of the object before, world, m and rad.
            h: step, s.
            ramp: s.
            rest: s.
        """
        x, y, angle = np.asarray(pose, dtype=float)
        way = self.approach + self.length
        ramp = min(ramp, way / self.speed)
        moving = way / self.speed + ramp
        steps = int(np.ceil((moving + 2 * rest) / h))
        t = np.clip(h * np.arange(steps + 1) - rest, 0.0, moving)
        up, down = np.minimum(t, ramp), np.maximum(t - (moving - ramp), 0.0)
        travelled = self.speed * (0.5 * up**2 / ramp + np.maximum(t - ramp, 0.0) - 0.5 * down**2 / ramp)
        local = self.touch + np.outer(travelled - self.approach, self.direction)
        c, s = np.cos(angle), np.sin(angle)
        return Push(h, local @ np.array([[c, s], [-s, c]]) + [x, y], np.array([x, y, angle]))


def candidate_pushes(
    grid: CellGrid,
    finger_radius: float,
    rng: np.random.Generator,
    count: int,
    *,
    length: tuple[float, float] = (0.04, 0.1),
    speed: tuple[float, float] = (0.03, 0.1),
    cone: float = np.pi / 6,
    approach: float = 0.01,
) -> list[Candidate]:
    """Random pushes on random contact points of the contour (Algorithm 2, line 1).

    Cells of the contour come in random order, and none a second time before every other has had its turn.
    A cell that no drawn direction reaches is passed over. Where the finger comes down it has room all round,
    `DESCENT` or as much as the way before the touch allows: a prong beside it may be off by millimetres.

    Args:
        grid: the object.
        finger_radius: m.
        rng: source of every draw.
        count: number of pushes.
        length: least and largest way after first touch, m.
        speed: least and largest speed of the finger, m/s.
        cone: largest angle between direction and inward normal, rad.
        approach: way before first touch, m.

    Raises:
        ValueError: a number out of range; the message names it.
        NoReachablePush: the finger fits nowhere, for instance because it is too thick.
    """
    _check(finger_radius, count, length, speed, cone, approach)
    cells, points, normals = contour_cells(grid)
    pushes: list[Candidate] = []
    while len(pushes) < count:
        found = len(pushes)
        for k in rng.permutation(len(cells)):
            touch = points[k] + finger_radius * normals[k]
            direction = _aimed(grid, finger_radius, rng, touch, -normals[k], cone, approach)
            if direction is not None and len(pushes) < count:
                way, pace = float(rng.uniform(*length)), float(rng.uniform(*speed))
                pushes.append(Candidate(int(cells[k]), points[k], direction, touch, approach, way, pace))
        if len(pushes) == found:
            raise NoReachablePush(
                f"exploration: a finger of radius {finger_radius:.4g} m reaches none of {len(cells)} contour"
                f" cells within {np.degrees(cone):.0f}° of their normals; take a thinner finger"
            )
    return pushes


def _aimed(
    grid: CellGrid,
    radius: float,
    rng: np.random.Generator,
    touch: FloatArray,
    inward: FloatArray,
    cone: float,
    approach: float,
) -> FloatArray | None:
    """A random direction about `inward` in which a disc meets the object at `touch` and not before."""
    room = min(DESCENT, approach * np.cos(cone)) - TOUCH
    for angle in rng.uniform(-cone, cone, TRIES_PER_CELL):
        c, s = np.cos(angle), np.sin(angle)
        direction = np.array([c * inward[0] - s * inward[1], s * inward[0] + c * inward[1]])
        begin = touch - approach * direction
        if shapely.distance(shapely.Point(begin), grid.polygon) < radius + room:
            continue
        if shapely.distance(shapely.LineString([begin, touch]), grid.polygon) >= radius - TOUCH:
            return direction
    return None


def _check(
    finger_radius: float,
    count: int,
    length: Sequence[float],
    speed: Sequence[float],
    cone: float,
    approach: float,
) -> None:
    if count < 1:
        raise ValueError(f"exploration: count must be at least 1, got {count}")
    for name, value in (("finger_radius", finger_radius), ("approach", approach)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"exploration: {name} must be a positive length in m, got {value}")
    for name, (least, largest) in (("length", length), ("speed", speed)):
        if not (np.isfinite(largest) and 0 < least <= largest):
            raise ValueError(
                f"exploration: {name} must be a positive range (least, largest), got {(least, largest)}"
            )
    if not 0 <= cone < np.pi / 2:
        raise ValueError(f"exploration: cone must lie in [0, π/2) rad, got {cone}")


# Straight pushes on the table that a person could make next, like those that were recorded.


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
class Instruction:
    """A candidate push on the table."""

    pose: FloatArray
    contact: FloatArray
    begin: FloatArray
    end: FloatArray
    speed: float
    length: float
    dwell: float

    @classmethod
    def of(cls, push: Candidate, pose: FloatArray, speed: float, length: float, dwell: float) -> Instruction:
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


def instructions_for(
    dataset: PushDataset, habits: Habits, mu_finger: float, count: int, rng: np.random.Generator
) -> list[Instruction]:
    """Random pushes that stay in the region of the recorded ones and on the table.

    Half of them come in pairs that differ by half a turn alone, since a reversed push is what tells many
    apart.
    """
    cone = float(np.clip(0.9 * np.arctan(mu_finger), 0.05, np.pi / 4))
    contacts = candidate_pushes(
        dataset.grid, dataset.finger_radius, rng, CONTACTS, cone=cone, approach=APPROACH
    )
    found: list[Instruction] = []
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
            proposal = Instruction.of(contact, np.array([*place, angle]), speed, length, dwell)
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


def _on_table(proposal: Instruction, dataset: PushDataset) -> bool:
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
