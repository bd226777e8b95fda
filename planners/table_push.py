"""`TablePush`: a requested push along a straight line on the table, and its `Pace`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.settings import check_not_negative

TOUCH_SPEED = 0.05
"""Speed at which a tap meets the object, m/s: fast enough to be brief, too slow for an impact."""

TAP_SPEEDING_UP, TAP_SLOWING_DOWN = 3.0, 5.0
"""Accelerations of the finger in a tap, m/s². The finger stops faster than friction stops the object, which
slides on alone; the arm can brake this hard nearly everywhere, but at 8 m/s² in few places."""
_LONGEST, _FASTEST = 10.0, 10.0  # of a push, m, and of its finger, m/s; more is in millimetres
_ACCELERATION = 0.5  # of a finger in pushes other than taps, speeding up and slowing down, m/s²


@dataclass(frozen=True, eq=False)
class TablePush:
    """A straight push of the finger.

    A tap touches the object gently, speeds up with it, and stops short, so that the object slides on by
    itself. How far it slides and turns distinguishes mass from friction, which slow pushes cannot.

    Attributes:
        begin: (2,) centre of the finger before it moves, clear of the object, world, m.
        end: (2,) centre of the finger where it stops, world, m.
        speed: of the finger between speeding up and slowing down, m/s.
        creep: in a tap, distance that the finger travels at `TOUCH_SPEED` before it speeds up, m; else 0.

    Raises:
        ValueError: a number that is not finite, a speed that is not positive, a length of zero, a creep as
            long as the push, or a length over 10 m or a speed over 10 m/s, as in millimetres.

    Example:
        >>> import slipmap
        >>> push = slipmap.TablePush(begin=[-0.06, 0.0], end=[0.04, 0.0], speed=0.05)
        >>> push.path(0.01).shape[1]
        2
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
        if self.speed > _FASTEST:
            raise ValueError(f"push: speed is {self.speed:g} m/s; no finger is that fast, divide by 1000?")
        if np.hypot(*(end - begin)) < 1e-6:
            raise ValueError("push: begin and end are the same point")
        if (length := np.hypot(*(end - begin))) > _LONGEST:
            raise ValueError(
                f"push: {length:g} m lie between begin and end; no push is that long, divide by 1000?"
            )
        if not 0 <= self.creep < np.hypot(*(end - begin)):
            raise ValueError(f"push: creep must lie between 0 and the length of the push, got {self.creep} m")
        object.__setattr__(self, "begin", begin)
        object.__setattr__(self, "end", end)

    @property
    def length(self) -> float:
        """Length of the finger's path, m."""
        return float(np.hypot(*(self.end - self.begin)))

    @property
    def direction(self) -> FloatArray:
        """(2,) unit vector of the finger's motion, world."""
        return (self.end - self.begin) / self.length

    def pace(self, speeding_up: float, slowing_down: float) -> Pace:
        """The finger's distance over time, from rest to rest.

        If the path is too short to reach the speed, the finger slows down as soon as it must.

        Args:
            speeding_up: acceleration in pushes other than taps, m/s².
            slowing_down: deceleration in pushes other than taps, m/s².
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

    def path(self, step: float, *, rest: float = 0.4) -> FloatArray:
        """(N + 1, 2) centre of the finger in the world, m, every `step` (s): the `tip` of a `Push`.

        The finger rests before and after it moves; after a tap, the object slides on during that rest.

        Args:
            step: s.
            rest: shortest rest before and after, s.

        Raises:
            ValueError: a step that is not positive, or a negative rest.
        """
        if not (np.isfinite(step) and step > 0):
            raise ValueError(f"push: the step must be positive, got {step} s")
        check_not_negative("push: rest", rest, "s")
        pace = self.pace(_ACCELERATION, _ACCELERATION)
        times: FloatArray = step * np.arange(int(np.ceil((pace.duration + 2 * rest) / step)) + 1, dtype=float)
        return self.begin + np.outer(pace.at(times - rest), self.direction)


@dataclass(frozen=True, eq=False)
class Pace:
    """A finger's distance over time, with constant accelerations between knots."""

    times: FloatArray  # (m,) of the knots, from 0, s
    ways: FloatArray  # (m,) distance travelled by then, m
    speeds: FloatArray  # (m,) at the knots, m/s

    @property
    def duration(self) -> float:
        """Total time, s."""
        return float(self.times[-1])

    def at(self, times: FloatArray) -> FloatArray:
        """(T,) distance travelled at times (T,), m; at rest before the first and after the last knot."""
        t = np.clip(times, 0.0, self.duration)
        k = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        since = t - self.times[k]
        rate = (self.speeds[k + 1] - self.speeds[k]) / (self.times[k + 1] - self.times[k])
        return np.asarray(self.ways[k] + self.speeds[k] * since + 0.5 * rate * since**2)
