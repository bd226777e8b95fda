"""Direct questions to an engine: how friction depends on direction, speed and spin, and whether it holds.

All are asked of a plate of even weight and friction, whose answers by Coulomb's law are known. Contacts of
some engines hop while they slide, so that friction comes in blows: whatever can be kept sliding evenly, by a
gravity as steep as friction, is; the others are averaged over several speeds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slipmap.diagrams.application.audit.engine import (
    GRAVITY,
    LEVEL,
    MU,
    REST,
    CoulombEngine,
    Subject,
    plain_scene,
)
from slipmap.models.files import BadInput
from slipmap.models.geometry import rotated
from slipmap.models.physics.cell_grid import FloatArray

DIRECTIONS = np.arange(24) * np.pi / 12
"""(24,) of the free slides, rad."""
STEADY_SPEEDS = np.array([0.02, 0.05, 0.1, 0.3])
"""m/s, along x."""
SPINS = np.outer([-1.0, 1.0], np.linspace(3.0, 8.0, 8)).ravel()
"""rad/s, in place."""
CREEP_LOAD = 0.6
"""Of what friction can hold."""

_SLIDE_SPEEDS = np.array([0.2, 0.3, 0.45])  # m/s
_STEPS = 40  # at least, until a free slide stops
_FINE = 4  # steps of a point in one of the engine
_EARLY = (0.05, 0.45)  # of the time until it stops, in which a direction changes little
LATE = (0.1, 0.75)
"""The same of spins."""
_SETTLED, _STEADY = 0.1, 0.3  # s that an even slide is left to itself, and watched
_SLOW_SPIN, _SLOW_STEPS = 0.8, 6  # rad/s, for so many steps
_SLOW_SLIDES = np.array([0.15, 0.2, 0.25, 0.3])  # m/s of the object in the meantime
_CREEP_DIRECTIONS = np.radians([0.0, 22.5, 45.0])
_LAID, _CREPT = 0.25, 0.25  # s that a load is left to itself, and watched
_STEEP = 1.5  # load, of what friction can hold, under which anything slides

Report = Callable[[int], None]
"""Called with how many probes are done."""
COUNT = 2 + len(DIRECTIONS) + len(STEADY_SPEEDS) + len(SPINS) + len(_CREEP_DIRECTIONS)
"""Probes of one engine at one step."""


@dataclass(frozen=True, eq=False)
class Answers:
    """What an engine does at one time step."""

    # (24, 2) directions of motion half-way, unit vectors, and friction there as an acceleration over μ g;
    # Coulomb's is -1 along the motion
    direction: FloatArray
    friction: FloatArray
    steady: FloatArray  # (4,) friction at `STEADY_SPEEDS` over Coulomb's
    spin: FloatArray  # (16,) torque of a spin in place over Coulomb's
    # (8,) torque of slow spins while the object slides, less Coulomb's, over Coulomb's of a spin in place
    slow_spin: FloatArray
    creep: FloatArray  # (3,) speed under a load that friction can hold, m/s


def ask(subject: Subject, report: Report) -> Answers:
    """Ask all probes of an engine.

    Args:
        subject: the engine.
        report: called after each of `COUNT` probes.

    Raises:
        BadInput: the engine fails, or gravity's tilt does nothing in it.
    """
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        report(done)

    _check_gravity(subject)
    count()
    slides = []
    for angle in DIRECTIONS:
        slides.append(_free_slide(subject, np.array([np.cos(angle), np.sin(angle)])))
        count()
    steady = []
    for speed in STEADY_SPEEDS:
        steady.append(_steady_slide(subject, speed))
        count()
    same = Subject("Coulomb", type("Same", (CoulombEngine,), {"dt": subject.dt}), subject.full_dt)
    spins = []
    for rate in SPINS:
        spins.append(_spin_torque(subject, rate) / _spin_torque(same, rate))
        count()
    slow = (_slow_spin_torques(subject) - _slow_spin_torques(same)) / _spin_torque(same, SPINS[-1])
    count()
    creep = []
    for angle in _CREEP_DIRECTIONS:
        creep.append(_creep(subject, np.array([np.cos(angle), np.sin(angle)])))
        count()
    direction, friction = np.array(slides).transpose(1, 0, 2)
    return Answers(direction, friction, np.array(steady), np.array(spins), slow, np.array(creep))


def _tilted(along: FloatArray) -> FloatArray:
    """(3,) gravity with a part (2,) along the table, m/s²."""
    return LEVEL + np.append(along, 0.0)


def _parabola(times: NDArray[np.floating[Any]], values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Velocity half-way and acceleration of what is seen at times, by least squares."""
    bend, slope, _ = np.polyfit(times - times.mean(), values, 2)
    return slope, 2 * bend


def _check_gravity(subject: Subject) -> None:
    along = np.array([_STEEP * MU * GRAVITY, 0.0])
    path = subject.lay(plain_scene(), _tilted(along)).slide(REST, _LAID)
    moved, wanted = path[-1, 0] - path[0, 0], 0.5 * (_STEEP - 1) * MU * GRAVITY * _LAID**2
    if moved < 0.1 * wanted:
        raise BadInput(
            f"engine {subject.name}: under a gravity of {_tilted(along).round(2).tolist()} m/s² the object"
            f" moves by {1e3 * moved:.1f} mm in {_LAID} s, by Coulomb's law {1e3 * wanted:.0f} mm; __init__"
            " must use the gravity that it is given, tilted or not"
        )


def _free_slide(subject: Subject, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Direction half-way and friction (2,) of slides that are let go in a direction."""
    laid = subject.lay(plain_scene())
    paths = [
        laid.slide(np.array([*(speed * along), 0.0]), _EARLY[1] * speed / (MU * GRAVITY))[:, :2]
        for speed in slide_speeds(subject.full_dt)
    ]
    return seen_in_slides(paths, subject.dt)


def slide_speeds(dt: float) -> FloatArray:
    """(3,) speeds of free slides, m/s, for an engine of this step, s: faster where it is long."""
    return np.asarray(_SLIDE_SPEEDS * max(1.0, _STEPS * dt * MU * GRAVITY / _SLIDE_SPEEDS[0]))


def seen_in_slides(paths: Sequence[FloatArray], dt: float) -> tuple[FloatArray, FloatArray]:
    """Mean direction and friction (…, 2), as in `Answers`, of free slides: paths (T + 1, …, 2), steps dt."""
    ways, frictions = [], []
    for path in paths:
        first = round(_EARLY[0] / _EARLY[1] * (len(path) - 1))
        times = dt * np.arange(float(first), len(path))
        flat = path[first:].reshape(len(times), -1)
        velocity, acceleration = (part.reshape(path.shape[1:]) for part in _parabola(times, flat))
        ways.append(velocity / np.linalg.norm(velocity, axis=-1, keepdims=True))
        frictions.append(acceleration / (MU * GRAVITY))
    way = np.mean(ways, axis=0)
    return way / np.linalg.norm(way, axis=-1, keepdims=True), np.mean(frictions, axis=0)


def slides_of_point(
    friction: Callable[[FloatArray], FloatArray], dt: float, full_dt: float
) -> tuple[FloatArray, FloatArray]:
    """What free slides would show, (24, 2) each, as in `Answers`, if friction followed a law.

    Args:
        friction: directions of motion (24, 2) to friction over μ N (24, 2).
        dt, full_dt: of the `Subject`, s.
    """
    paths = []
    for speed in slide_speeds(full_dt):
        steps = round(_EARLY[1] * speed / (MU * GRAVITY) / dt)
        velocity = speed * np.column_stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)])
        place = np.zeros_like(velocity)
        path = [place]
        for _ in range(steps):
            for _ in range(_FINE):
                length = np.linalg.norm(velocity, axis=1, keepdims=True)
                velocity = velocity + dt / _FINE * MU * GRAVITY * friction(velocity / length)
                place = place + dt / _FINE * velocity
            path.append(place)
        paths.append(np.array(path))
    return seen_in_slides(paths, dt)


def _steady_slide(subject: Subject, speed: float) -> float:
    """Friction along x, over Coulomb's, at an even speed: that of the gravity which keeps it."""
    along = MU * GRAVITY
    for _ in range(3):
        laid = subject.lay(plain_scene(), _tilted(np.array([along, 0.0])))
        path = laid.slide(np.array([speed, 0.0, 0.0]), _SETTLED + _STEADY)
        first = round(_SETTLED / subject.dt)
        along -= float(_parabola(subject.dt * np.arange(float(first), len(path)), path[first:, 0])[1])
        if path[-1, 0] - path[first, 0] < 0.2 * speed * _STEADY:
            along *= 1.1  # it stands still, so that friction is at least this
    return along / (MU * GRAVITY)


def _spin_torque(subject: Subject, rate: float) -> float:
    """Angular deceleration of an object that is let go with a spin, rad/s²."""
    scene = plain_scene()
    stop = abs(rate) * scene.moment_of_inertia / (MU * GRAVITY * scene.mass.sum() * scene.mean_arm)
    path = subject.lay(scene).slide(np.array([0.0, 0.0, rate]), LATE[1] * stop)
    first = round(LATE[0] * stop / subject.dt)
    return float(
        -np.sign(rate) * _parabola(subject.dt * np.arange(float(first), len(path)), path[first:, 2])[1]
    )


def _slow_spin_torques(subject: Subject) -> FloatArray:
    """(8,) the same of a slow spin, either way, while a steep gravity keeps the object sliding."""
    laid = subject.lay(plain_scene(), _tilted(np.array([MU * GRAVITY, 0.0])))
    torques = []
    for speed in _SLOW_SLIDES:
        for rate in (-_SLOW_SPIN, _SLOW_SPIN):
            path = laid.slide(np.array([speed, 0.0, rate]), _SLOW_STEPS * subject.full_dt)
            times = subject.dt * np.arange(float(len(path)))
            torques.append(-np.sign(rate) * _parabola(times, path[:, 2])[1])
    return np.array(torques)


def _creep(subject: Subject, along: FloatArray) -> float:
    """Speed under a load that friction can hold, m/s."""
    laid = subject.lay(plain_scene(), _tilted(CREEP_LOAD * MU * GRAVITY * along))
    path = laid.slide(REST, _LAID + _CREPT)
    first = round(_LAID / subject.dt)
    return float(np.linalg.norm(path[-1, :2] - path[first, :2]) / (subject.dt * (len(path) - 1 - first)))


def leaned(answers: Answers) -> FloatArray:
    """(24,) angles by which friction leaves the line of motion, counter-clockwise, rad."""
    back = rotated(answers.friction, np.pi - np.arctan2(answers.direction[:, 1], answers.direction[:, 0]))
    return np.arctan2(back[:, 1], back[:, 0])
