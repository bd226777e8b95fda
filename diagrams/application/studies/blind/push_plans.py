"""Random pushes: slow, medium, fast, accelerating and in strokes; straight and curved; three ways to end."""

from dataclasses import dataclass

import numpy as np
import shapely

from slipmap.diagrams.application.studies.blind.objects import FloatArray, SlidingObject, rotation_matrix

KINDS = ("medium",) * 7 + ("fast",) * 6 + ("slow",) * 4 + ("accelerating",) * 4 + ("strokes",) * 3
"""The kinds of the 24 pushes of a dataset, in no order."""

HELDOUT = 8
TABLE_SIZE = 1.0  # m, a square about the origin
_START_WITHIN = 0.33  # m
_SPARE = 0.1  # s that the path goes on after the recording


@dataclass(frozen=True, eq=False)
class FingerPath:
    """An arc of constant curvature, run through at a speed that is piecewise linear in time.

    Attributes:
        start: (2,) m.
        heading: of the first motion, rad.
        curvature: 1/m, positive to the left.
        times, speeds: (k,) s and m/s.
    """

    start: FloatArray
    heading: float
    curvature: float
    times: FloatArray
    speeds: FloatArray

    def travelled(self, t: FloatArray) -> FloatArray:
        """(T,) way since time zero, m."""
        span = np.diff(self.times)
        ways = np.concatenate([[0.0], np.cumsum(0.5 * (self.speeds[1:] + self.speeds[:-1]) * span)])
        t = np.clip(t, self.times[0], self.times[-1])
        piece = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(span) - 1)
        since = t - self.times[piece]
        slope = (self.speeds[piece + 1] - self.speeds[piece]) / span[piece]
        return ways[piece] + self.speeds[piece] * since + 0.5 * slope * since**2

    def positions(self, t: FloatArray) -> FloatArray:
        """(T, 2) m."""
        way = self.travelled(t)
        half = 0.5 * self.curvature * way
        chord = way * np.sinc(half / np.pi)
        direction = self.heading + half
        return self.start + chord[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])


@dataclass(frozen=True, eq=False)
class PushPlan:
    """One push: what the finger does to an object that rests at a pose."""

    # kind, end: such as 'medium' and 'abrupt'
    kind: str
    end: str
    duration: float  # of the recording, s
    pose: FloatArray  # (3,) of the object before, m and rad
    path: FingerPath  # of the finger, m


def random_plan(rng: np.random.Generator, thing: SlidingObject, kind: str) -> PushPlan:
    """A push of the given kind somewhere on the table, against a random place of the outline."""
    end, times, speeds = _timing(rng, kind)
    duration = round(float(times[-1]) - _SPARE, 2)
    curved = kind != "strokes" and rng.random() < 0.65
    curvature = float(rng.uniform(-3.5, 3.5)) if curved else 0.0
    start, heading = _approach(rng, thing)
    pose = np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    turn = rotation_matrix(pose[2])
    path = FingerPath(turn @ start, heading + pose[2], curvature, times, speeds)
    # The object is to start and to stay well within the table.
    way = path.positions(times[-1:])[0] - path.start
    for _ in range(1000):
        place = rng.uniform(-_START_WITHIN, _START_WITHIN, 2)
        if np.abs(place + way).max() + thing.reach < 0.5 * TABLE_SIZE:
            break
    else:
        place = -0.5 * way
    pose[:2] = place
    return PushPlan(
        kind, end, duration, pose, FingerPath(path.start + place, path.heading, curvature, times, speeds)
    )


def _timing(rng: np.random.Generator, kind: str) -> tuple[str, FloatArray, FloatArray]:
    """How it ends, and times and speeds of the finger."""
    chances = {"slow": (0.0, 0.2, 0.8), "medium": (0.35, 0.4, 0.25), "strokes": (0.5, 0.5, 0.0)}
    end = str(rng.choice(["gentle", "abrupt", "moving"], p=chances.get(kind, (0.5, 0.5, 0.0))))
    if kind == "strokes":
        times, speeds = _strokes(rng)
    elif kind == "accelerating":
        top = rng.uniform(0.12, 0.2)
        rise = rng.uniform(1.2, 1.7)
        hold = 0.05 if end == "abrupt" else 0.001
        times, speeds = [0.0, 0.05, rise, rise + hold], [0.0, 0.01, top, top]
    else:
        low, high = {"slow": (0.011, 0.025), "medium": (0.035, 0.095), "fast": (0.1, 0.19)}[kind]
        speed = rng.uniform(low, high)
        low, high = {"slow": (2.8, 3.6), "medium": (1.4, 2.8), "fast": (0.7, 1.3)}[kind]
        times, speeds = [0.0, rng.uniform(0.05, 0.28), rng.uniform(low, high)], [0.0, speed, speed]
    if end == "moving":
        times, speeds = [*times, times[-1] + _SPARE], [*speeds, speeds[-1]]
    else:
        brake = rng.uniform(0.14, 0.36) if end == "gentle" else rng.uniform(0.008, 0.02)
        stop = times[-1] + brake
        times, speeds = [*times, stop, stop + rng.uniform(0.4, 1.2)], [*speeds, 0.0, 0.0]
    return end, np.array(times), np.array(speeds)


def _strokes(rng: np.random.Generator) -> tuple[list[float], list[float]]:
    """A slow stroke and a faster one, half the time with a rest between them."""
    slow, fast = rng.uniform(0.02, 0.065), rng.uniform(0.065, 0.175)
    first = rng.uniform(0.7, 1.1)
    times, speeds = [0.0, 0.1, first], [0.0, slow, slow]
    if rng.random() < 0.5:
        times += [first + 0.02, first + rng.uniform(0.2, 0.4)]
        speeds += [0.0, 0.0]
    times += [times[-1] + 0.1, times[-1] + 0.1 + rng.uniform(0.4, 1.1)]
    speeds += [fast, fast]
    return times, speeds


def _approach(rng: np.random.Generator, thing: SlidingObject) -> tuple[FloatArray, float]:
    """Start and heading of a finger that meets the outline after some mm, in the object frame."""
    ring = thing.footprint.exterior
    while True:
        at = rng.uniform(0, ring.length)
        near = np.array([ring.interpolate(at + d).coords[0] for d in (-1e-4, 0.0, 1e-4)])
        tangent = (near[2] - near[0]) / np.linalg.norm(near[2] - near[0])
        outward = np.array([tangent[1], -tangent[0]])
        heading = float(np.arctan2(*-outward[::-1]) + rng.uniform(-0.6, 0.6))
        direction = np.array([np.cos(heading), np.sin(heading)])
        touch = near[1] + thing.finger_radius * outward
        start = touch - rng.uniform(0.002, 0.012) * direction
        free = shapely.LineString([start, touch - 1e-3 * direction]).distance(thing.footprint)
        if free > thing.finger_radius + 2e-4:
            return start, heading
