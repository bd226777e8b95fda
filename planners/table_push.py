"""A push as it is asked for: the finger moves along a line on the table, and when it is where on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.balance import corners_of
from slipmap.models.physics.cell_grid import FloatArray

TOUCH_SPEED = 0.05
"""m/s, at which a tap meets the object: fast enough to be brief, too slow for a blow."""
TAP_SPEEDING_UP, TAP_SLOWING_DOWN = 3.0, 5.0
"""m/s², of the finger in a tap. It stops faster than friction stops an object, which slides on alone; the arm
can brake so in nearly all places, by 8 m/s² in few."""


@dataclass(frozen=True, eq=False)
class TablePush:
    """A straight push of the finger.

    A tap touches the object gently, speeds up with it, and stops short, so that the object slides on by
    itself. How far and with what turn tells mass from friction, which slow pushes cannot.

    Attributes:
        begin: (2,) centre of the finger before it moves, free of the object, world, m.
        end: (2,) centre of the finger where it stops, world, m.
        speed: of the finger between speeding up and slowing down, m/s.
        creep: of a tap, way that the finger goes at `TOUCH_SPEED` before it speeds up, m; 0 in other pushes.

    Raises:
        ValueError: a number that is not finite, a speed that is not positive, no way to go, or a creep that
            takes up all of it.
    """

    begin: FloatArray
    end: FloatArray
    speed: float
    creep: float = 0.0

    def __post_init__(self) -> None:
        begin, end = np.asarray(self.begin, dtype=float), np.asarray(self.end, dtype=float)
        if begin.shape != (2,) or end.shape != (2,) or not np.isfinite([*begin, *end]).all():
            raise ValueError(f"push: begin and end must be finite points (2,), got {begin} and {end}")
        if not (np.isfinite(self.speed) and self.speed > 0):
            raise ValueError(f"push: speed must be positive, got {self.speed} m/s")
        if np.hypot(*(end - begin)) < 1e-6:
            raise ValueError("push: begin and end are the same point")
        if not 0 <= self.creep < np.hypot(*(end - begin)):
            raise ValueError(f"push: creep must lie between 0 and the length of the push, got {self.creep} m")
        object.__setattr__(self, "begin", begin)
        object.__setattr__(self, "end", end)

    @property
    def length(self) -> float:
        """Way of the finger, m."""
        return float(np.hypot(*(self.end - self.begin)))

    @property
    def direction(self) -> FloatArray:
        """(2,) unit vector of the finger's motion, world."""
        return (self.end - self.begin) / self.length

    def pace(self, speeding_up: float, slowing_down: float) -> Pace:
        """When the finger is where, from rest to rest.

        Where the way is too short for the speed, the fastest point is where slowing down has to begin.

        Args:
            speeding_up: acceleration in pushes that are not taps, m/s².
            slowing_down: the same at the end.
        """
        slow = min(TOUCH_SPEED, self.speed, np.sqrt(2.0 * speeding_up * self.creep))
        up, down = (TAP_SPEEDING_UP, TAP_SLOWING_DOWN) if self.creep else (speeding_up, slowing_down)
        way = self.length - self.creep
        top = min(self.speed, np.sqrt((2.0 * way + slow**2 / up) / (1.0 / up + 1.0 / down)))
        cruise = max(way - (top**2 - slow**2) / (2.0 * up) - top**2 / (2.0 * down), 0.0) / top
        pieces = [((top - slow) / up, top), (cruise, top), (top / down, 0.0)]
        if self.creep:
            rise = slow / speeding_up
            pieces = [(rise, slow), (self.creep / slow - rise / 2.0, slow), *pieces]
        times, ways, speeds = [0.0], [0.0], [0.0]
        for duration, reached in pieces:
            if duration > 1e-9:
                times.append(times[-1] + duration)
                ways.append(ways[-1] + duration * (speeds[-1] + reached) / 2.0)
                speeds.append(reached)
        return Pace(np.array(times), np.array(ways), np.array(speeds))

    def path(
        self, step: float, *, speeding_up: float = 0.5, slowing_down: float = 0.5, rest: float = 0.4
    ) -> FloatArray:
        """(N + 1, 2) centre of the finger, a row each `step` (s), as `slipmap.models.physics.pushes.Push` takes it.

        The finger rests before it moves, and after; an object that was tapped slides on meanwhile.

        Args:
            step: s.
            speeding_up: acceleration in pushes that are not taps, m/s².
            slowing_down: the same at the end.
            rest: at least so long before and after, s.

        Raises:
            ValueError: a step that is not positive.
        """
        if not (np.isfinite(step) and step > 0):
            raise ValueError(f"push: the step must be positive, got {step} s")
        pace = self.pace(speeding_up, slowing_down)
        times: FloatArray = step * np.arange(int(np.ceil((pace.duration + 2 * rest) / step)) + 1, dtype=float)
        return self.begin + np.outer(pace.at(times - rest), self.direction)


@dataclass(frozen=True, eq=False)
class Pace:
    """A finger's way over time, with constant accelerations between knots.

    Attributes:
        times: (m,) from 0, s.
        ways: (m,) gone until then, m.
        speeds: (m,) then, m/s.
    """

    times: FloatArray
    ways: FloatArray
    speeds: FloatArray

    @property
    def duration(self) -> float:
        """s."""
        return float(self.times[-1])

    def at(self, times: FloatArray) -> FloatArray:
        """(T,) way gone at times (T,), m; at rest before the first and after the last knot."""
        t = np.clip(times, 0.0, self.duration)
        k = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        since = t - self.times[k]
        rate = (self.speeds[k + 1] - self.speeds[k]) / (self.times[k + 1] - self.times[k])
        return np.asarray(self.ways[k] + self.speeds[k] * since + 0.5 * rate * since**2)


# Where straight lines fixed to an object meet the table, for many poses of the object at once.


def first_on_table(
    direction: FloatArray, offset: FloatArray, poses: FloatArray, table: Table, half_width: float
) -> FloatArray:
    """Where strips that come from far away first meet the table's top.

    Args:
        direction: (L, 2) unit vectors in which they come, object frame.
        offset: (L,) of the strips' middle lines to the left of the object's origin, m.
        poses: (P, 3) of the object in the world, m and rad.
        table: round or rectangular.
        half_width: of the strips, m.

    Returns:
        (P, L) coordinate along each line, from the point nearest to the object's origin, m; inf where it
        passes by.
    """
    corners = corners_of(table)
    if len(corners) > 0:
        return _first_in_strip(*_on_lines(direction, offset, poses, corners), half_width)
    assert table.radius is not None  # see corners_of
    along, left = _on_lines(direction, offset, poses, np.array([table.center]))
    beside = np.maximum(np.abs(left[..., 0]) - half_width, 0.0)
    square = table.radius**2 - beside**2
    return np.asarray(np.where(square > 0, along[..., 0] - np.sqrt(np.maximum(square, 0.0)), np.inf))


def towards_table(
    direction: FloatArray, offset: FloatArray, at: FloatArray, poses: FloatArray, table: Table
) -> FloatArray:
    """Cosine between lines and the shortest way from one point of each, outside the table, to the table.

    Args:
        direction: (L, 2) unit vectors along the lines, object frame.
        offset: (L,) of the lines to the left of the object's origin, m.
        at: (L,) coordinate of the point along its line, m.
        poses: (P, 3) of the object in the world, m and rad.
        table: round or rectangular.

    Returns:
        (P, L).
    """
    if table.shape == "round":
        along, left = _on_lines(direction, offset, poses, np.array([table.center]))
        ahead = along[..., 0] - at
        return np.asarray(ahead / np.maximum(np.hypot(ahead, left[..., 0]), 1e-9))
    x, y = (at[:, None] * direction + offset[:, None] * direction[:, ::-1] * [-1, 1]).T
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    away = np.stack([c * x - s * y, s * x + c * y], axis=-1) + poses[:, None, :2] - np.asarray(table.center)
    half = np.asarray(table.size) / 2
    to_table = np.clip(away, -half, half) - away
    ux, uy = direction.T
    ahead = to_table[..., 0] * (c * ux - s * uy) + to_table[..., 1] * (s * ux + c * uy)
    return np.asarray(ahead / np.maximum(np.hypot(to_table[..., 0], to_table[..., 1]), 1e-9))


def _on_lines(
    direction: FloatArray, offset: FloatArray, poses: FloatArray, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """World points (c, 2) along (P, L, c) and to the left of (P, L, c) each line."""
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    dx, dy = points[:, 0] - poses[:, :1], points[:, 1] - poses[:, 1:2]
    x, y = (c * dx + s * dy)[:, None], (c * dy - s * dx)[:, None]
    ux, uy = direction[:, :1], direction[:, 1:]
    return x * ux + y * uy, y * ux - x * uy - offset[:, None]


def _first_in_strip(along: FloatArray, left: FloatArray, half_width: float) -> FloatArray:
    """Least coordinate of a polygon (..., c) within |left| <= half_width; inf where it is beside."""
    next_along, next_left = np.roll(along, -1, axis=-1), np.roll(left, -1, axis=-1)
    found = np.where(np.abs(left) <= half_width, along, np.inf).min(axis=-1)
    for side in (-half_width, half_width):
        crosses = (left > side) != (next_left > side)
        share = np.where(crosses, (side - left) / np.where(crosses, next_left - left, 1.0), 0.0)
        there = np.where(crosses, along + share * (next_along - along), np.inf)
        found = np.minimum(found, there.min(axis=-1))
    return np.asarray(found)
