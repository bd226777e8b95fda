"""Candidate pushes on an unknown object: Algorithm 2, line 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike

from slipmap.models.geometry import rotated, turn
from slipmap.models.objects import contour_cells
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Push
from slipmap.models.settings import (
    check_finger_radius,
    check_kind,
    check_positive,
    check_whole,
    finite_array,
)

DESCENT = 0.008
"""Clearance around the finger where it comes down, m: the largest combined error of object and finger."""

TOUCH = 1e-9  # a path closer to the object than the finger's radius less this counts as touching, m
_TRIES = 20  # directions drawn per cell


class NoReachablePush(ValueError):
    """No direction was found in which the finger reaches the contour without touching the object earlier."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A straight push of a round finger against one cell of the contour."""

    cell: int  # the cell
    contact: FloatArray  # (2,) first point of the outline to be touched, object frame, m
    direction: FloatArray  # (2,) unit vector of the finger's motion, object frame
    touch: FloatArray  # (2,) finger centre at first touch, object frame, m
    approach: float  # distance that the finger travels before first touch, m
    length: float  # distance that the finger travels from first touch to its stop, m
    speed: float  # of the finger between speeding up and slowing down, m/s

    def way_at(self, pose: FloatArray, length: float) -> tuple[FloatArray, FloatArray]:
        """Finger centre (2,) at the start and at the end of a push, world, m.

        Args:
            pose: (3,) of the object before the push, world, m and rad.
            length: distance that the finger travels after first touch, m.
        """
        rotation = turn(pose[2])
        begin = pose[:2] + rotation @ (self.touch - self.approach * self.direction)
        return begin, pose[:2] + rotation @ (self.touch + length * self.direction)

    def push(self, pose: ArrayLike, *, h: float = 1e-3, ramp: float = 0.1, rest: float = 0.2) -> Push:
        """The push on an object at `pose`, with the finger at rest before and after.

        The finger waits for `rest`, speeds up at a constant rate over `ramp`, slows down likewise, and waits
        again.

        Args:
            pose: (3,) of the object before the push, world, m and rad.
            h: step, s.
            ramp: s.
            rest: s.

        Raises:
            ValueError: a pose that is not three finite numbers.
        """
        start = finite_array("push: pose", pose, (3,))
        way = self.approach + self.length
        ramp = min(ramp, way / self.speed)
        moving = way / self.speed + ramp
        steps = int(np.ceil((moving + 2 * rest) / h))
        t = np.clip(h * np.arange(steps + 1) - rest, 0.0, moving)
        up, down = np.minimum(t, ramp), np.maximum(t - (moving - ramp), 0.0)
        travelled = self.speed * (0.5 * up**2 / ramp + np.maximum(t - ramp, 0.0) - 0.5 * down**2 / ramp)
        local = self.touch + np.outer(travelled - self.approach, self.direction)
        return Push(h, local @ turn(start[2]).T + start[:2], start)


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

    Contour cells come in random order; none comes twice before each has had its turn. Those along openings in
    which the finger can come down count too. Cells that no drawn direction reaches are skipped. Where the
    finger comes down it has clearance all round: `DESCENT`, or as much as the approach allows, because the
    object may be millimetres away from its estimated place.

    Args:
        grid: the object.
        finger_radius: m.
        rng: source of every draw.
        count: number of pushes.
        length: smallest and largest distance after first touch, m.
        speed: smallest and largest speed of the finger, m/s.
        cone: largest angle between direction and inward normal, rad.
        approach: distance before first touch, m.

    Raises:
        TypeError, ValueError: another kind of argument, a number out of range; the message names it.
        NoReachablePush: the finger fits nowhere, for example because it is too thick.

    Example:
        >>> import numpy as np
        >>> import slipmap
        >>> grid, _ = slipmap.hammer()
        >>> candidates = slipmap.candidate_pushes(grid, 0.008, np.random.default_rng(0), 3)
        >>> len(candidates), candidates[0].push([0, 0, 0]).tip.shape[1]
        (3, 2)
    """
    check_kind("exploration: rng", rng, np.random.Generator, "such as np.random.default_rng(0)")
    _check(finger_radius, count, length, speed, cone, approach)
    clear = min(DESCENT, approach * np.cos(cone)) - TOUCH
    cells, points, normals = contour_cells(grid, finger_radius + clear)
    pushes: list[Candidate] = []
    while len(pushes) < count:
        found = len(pushes)
        for k in rng.permutation(len(cells)):
            touch = points[k] + finger_radius * normals[k]
            direction = _aimed(grid, finger_radius, rng, touch, -normals[k], cone, approach, clear)
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
    clear: float,
) -> FloatArray | None:
    """A random direction near `inward` in which a disc first meets the object at `touch`."""
    for angle in rng.uniform(-cone, cone, _TRIES):
        direction = rotated(inward, angle)
        begin = touch - approach * direction
        if shapely.distance(shapely.Point(begin), grid.polygon) < radius + clear:
            continue
        if shapely.distance(shapely.LineString([begin, touch]), grid.polygon) >= radius - TOUCH:
            return direction
    return None


def _check(
    finger_radius: float,
    count: int,
    length: tuple[float, float],
    speed: tuple[float, float],
    cone: float,
    approach: float,
) -> None:
    check_whole("exploration: count", count, 1)
    check_finger_radius("exploration: finger_radius", finger_radius)
    check_positive("exploration: approach", approach, "m")
    for name, (least, largest) in (("length", length), ("speed", speed)):
        if not (np.isfinite(largest) and 0 < least <= largest):
            raise ValueError(
                f"exploration: {name} must be a positive range (least, largest), got {(least, largest)}"
            )
    if not 0 <= cone < np.pi / 2:
        raise ValueError(f"exploration: cone must lie in [0, π/2) rad, got {cone}")
