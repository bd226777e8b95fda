"""Probes of an engine: how friction depends on direction, speed, place and spin.

All probes use a plate of uniform weight and friction, for which Coulomb's law gives the answers. In some
engines, sliding contacts hop and friction comes in bursts. Probes therefore keep the object sliding steadily,
with gravity tilted to balance friction, where that is possible, and average over several speeds elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slipmap.diagrams.application.audit.engines import (
    GRAVITY,
    LEVEL,
    MU,
    REST,
    Laid,
    Subject,
    plain_scene,
)
from slipmap.diagrams.application.audit.law import (
    DIRECTIONS,
    EARLY,
    STEADY_SPEEDS,
    Harmonics,
    Law,
    LawEngine,
    harmonics_of,
    parabola,
    seen_in_slides,
    slide_speeds,
)
from slipmap.models.files import BadInput
from slipmap.models.geometry import rotated
from slipmap.models.physics.cell_grid import FloatArray

SPINS = np.outer([-1.0, 1.0], np.linspace(3.0, 8.0, 8)).ravel()  # initial rates of the spins in place, rad/s
CREEP_LOAD = 0.6  # load as a share of what friction can hold
APART = 0.1  # m, of places from the origin
_LATE = (0.1, 0.75)  # evaluated share of the time until a spin stops
_TURNED = np.pi / 2  # rad, heading of the slides that tell a grain of the object from one of the table
_SETTLED, _STEADY = 0.1, 0.3  # s for which a steady slide settles, and is then observed
_STEADY_TRIES, _ON_SPEED = 30, 0.01  # most trials of gravity; share of the speed by which it may be missed
_SLOW_SPIN, _SLOW_STEPS = 0.8, 6  # rad/s, and number of steps
_SLOW_SLIDES = np.array([0.15, 0.2, 0.25, 0.3])  # m/s of the object in the meantime
_CREEP_DIRECTIONS = np.radians([0.0, 22.5, 45.0])
_LAID, _CREPT = 0.25, 0.25  # s for which a loaded object settles, and is then observed
_STEEP = 1.5  # load, as a multiple of what friction can hold, under which the object must slide
_RELEASED = 0.03  # s for which an object must keep most of the velocity that it is given
Report = Callable[[int], None]  # called with the number of finished probes
COUNT = 4 + len(DIRECTIONS) + len(DIRECTIONS) // 3 + 4 + 2 * len(STEADY_SPEEDS) + len(SPINS) + 3
"""Number of probes of one engine at one time step."""


@dataclass(frozen=True, eq=False)
class Answers:
    """Answers of an engine to the probes at one time step."""

    # (24, 2) directions of motion (unit vectors) and friction as acceleration over μ g, both half-way;
    # Coulomb's law gives -1 along the motion
    direction: FloatArray
    friction: FloatArray
    by_place: FloatArray  # (2,) change of friction per `APART` along x and y, relative to Coulomb's
    steady: FloatArray  # (4,) friction along x at `STEADY_SPEEDS` relative to Coulomb's, mean of both ways
    steady_unsure: FloatArray  # (4,) its standard deviation, because the speed was not quite the stated one
    law: Law  # that the above show
    spin: FloatArray  # (16,) torque of spins in place relative to the law's
    # (8,) torque of slow spins during a slide minus the law's, relative to the law's for a spin in place
    slow_spin: FloatArray
    creep: FloatArray  # (3,) speed under a load that friction can hold, m/s
    repeat: float  # largest distance between ends of the same slide, in a new engine and after a reset, m


def ask(subject: Subject, report: Report) -> Answers:
    """Run all probes of an engine.

    Args:
        subject: the engine.
        report: called after each of `COUNT` probes.

    Raises:
        BadInput: the engine fails, or ignores the tilt of gravity or the velocity at the start.
    """
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        report(done)

    _check_gravity(subject)
    count()
    _check_velocity(subject)
    count()
    slides = []
    for angle in DIRECTIONS:
        slides.append(_free_slide(subject, angle))
        count()
    direction, friction = np.array(slides).transpose(1, 0, 2)
    harmonics = harmonics_of(direction, friction, subject.dt, subject.full_dt)
    turned = []
    for angle in DIRECTIONS[::3]:
        turned.append(_free_slide(subject, angle, np.array([0.0, 0.0, _TURNED])))
        count()
    by_place = []
    for axis, angle in zip(np.eye(2), (0.0, np.pi / 2), strict=True):
        sizes = []
        for side in (-APART, APART):
            sizes.append(-_free_slide(subject, angle, np.append(side * axis, 0.0))[1] @ axis)
            count()
        by_place.append((sizes[1] - sizes[0]) / 2)
    steady, unsure = [], []
    for speed in STEADY_SPEEDS:
        both = []
        for sense in (1.0, -1.0):
            both.append(_steady_slide(subject, speed, sense))
            count()
        steady.append(np.mean(both, axis=0)[0])
        unsure.append(np.mean(both, axis=0)[1])
    along_x = 1 + float(harmonics.along[0])
    law = Law(harmonics, _is_of_object(harmonics, np.array(turned)), np.array(steady) / along_x)
    same = Subject("law", type("Same", (LawEngine,), {"dt": subject.dt, "law": law}), subject.full_dt)
    spins = []
    for number, rate in enumerate(SPINS):
        heading = 2 * np.pi * number / len(SPINS)
        spins.append(_spin_torque(subject, rate, heading) / _spin_torque(same, rate, heading))
        count()
    slow = (_slow_spin_torques(subject) - _slow_spin_torques(same)) / _spin_torque(same, SPINS[-1], 0.0)
    count()
    creep = []
    for angle in _CREEP_DIRECTIONS:
        creep.append(_creep(subject, np.array([np.cos(angle), np.sin(angle)])))
        count()
    again = subject.lay(plain_scene())
    ends = [_turning_slide(laid)[-1, :2] for laid in (subject.lay(plain_scene()), again, again)]
    count()
    return Answers(
        direction, friction, np.array(by_place), np.array(steady), np.array(unsure), law, np.array(spins),
        slow, np.array(creep), float(max(np.linalg.norm(end - ends[0]) for end in ends)),
    )  # fmt: skip


def _tilted(along: FloatArray) -> FloatArray:
    """(3,) gravity with a component (2,) along the table, m/s²."""
    return LEVEL + np.append(along, 0.0)


def _check_gravity(subject: Subject) -> None:
    along = np.array([_STEEP * MU * GRAVITY, 0.0])
    path = subject.lay(plain_scene(), _tilted(along)).slide(REST, _LAID)
    moved, wanted = path[-1, 0] - path[0, 0], 0.5 * (_STEEP - 1) * MU * GRAVITY * _LAID**2
    if moved < 0.1 * wanted:
        raise BadInput(
            f"engine {subject.name}: with gravity {_tilted(along).round(2).tolist()} m/s², the object moves"
            f" {1e3 * moved:.1f} mm in {_LAID} s instead of {1e3 * wanted:.0f} mm under Coulomb's law;"
            " __init__ must use the gravity that it is given, tilted or not"
        )


def _check_velocity(subject: Subject) -> None:
    """Release the object turned, obliquely and with a spin: in a wrong frame it would go elsewhere."""
    velocity = np.array([0.18, -0.24, 5.0])
    path = subject.lay(plain_scene()).slide(velocity, _RELEASED, np.array([0.0, 0.0, 1.0]))
    moved = path[-1] - path[0]
    allowed = np.array([0.2, 0.2, 2.5])  # more than friction takes, less than a wrong frame would change
    if np.any(np.abs(moved / _RELEASED - velocity) > allowed):
        raise BadInput(
            f"engine {subject.name}: released at {velocity.tolist()} (m/s, m/s, rad/s), the object moves by"
            f" {moved.round(4).tolist()} (m, m, rad) in {_RELEASED} s; reset() must use the velocity that"
            " it is given, of the object frame's origin in the world"
        )


def _free_slide(subject: Subject, angle: float, start: FloatArray = REST) -> tuple[FloatArray, FloatArray]:
    """Direction half-way and friction (2,) of slides released in a direction."""
    laid, along = subject.lay(plain_scene()), np.array([np.cos(angle), np.sin(angle), 0.0])
    paths = [
        laid.slide(speed * along, EARLY[1] * speed / (MU * GRAVITY), start)[:, :2]
        for speed in slide_speeds(subject.full_dt)
    ]
    return seen_in_slides(paths, subject.dt)


def _turning_slide(laid: Laid) -> FloatArray:
    """Path (T + 1, 3) of a slide with a spin until it almost stops."""
    velocity = np.array([STEADY_SPEEDS[-1], 0.0, SPINS[-1]])
    return laid.slide(velocity, 0.9 * STEADY_SPEEDS[-1] / (MU * GRAVITY))


def _is_of_object(harmonics: Harmonics, turned: FloatArray) -> bool:
    """Whether a grain turns with the object, from slides (8, 2, 2) with the object turned."""
    direction, friction = turned[:, 0], turned[:, 1]
    twice = 2 * np.arctan2(direction[:, 1], direction[:, 0])
    along = -np.sum(friction * direction, axis=1)
    waves = np.array([np.cos(twice), np.sin(twice)]) @ (along - along.mean())
    return bool(waves @ harmonics.along < 0)  # turned by 90°, all harmonics of twice the angle change sign


def _steady_slide(subject: Subject, speed: float, sense: float) -> tuple[float, float]:
    """Friction along x at a steady speed relative to Coulomb's, and its uncertainty.

    A tilt of gravity is sought under which the object keeps its speed and its direction. A stronger pull
    makes it faster, whether friction rises with speed or falls, so the pull can be bracketed. The object
    passes the origin half-way.
    """
    way = np.array([sense, 0.0])
    half_way = _SETTLED + _STEADY / 2
    start = np.append(-way * speed * half_way, 0.0)
    first = round(_SETTLED / subject.dt)
    pull, side = MU * GRAVITY, 0.0  # m/s², along and across
    slow: tuple[float, float] | None = None  # of the strongest pull that is too weak: the pull, the speed
    fast: tuple[float, float] | None = None
    tried: list[tuple[float, float]] = []  # by how much the speed was missed, and friction
    for _ in range(_STEADY_TRIES):
        laid = subject.lay(plain_scene(), _tilted(sense * np.array([pull, side])))
        path = laid.slide(np.append(speed * way, 0.0), _SETTLED + _STEADY, start)[first:, :2] * sense
        times = subject.dt * np.arange(float(len(path)))
        velocity = (path[-1] - path[0]) / times[-1]
        friction = pull - float(parabola(times, path[:, 0])[1])
        miss = float(np.abs(velocity / speed - [1.0, 0.0]).max())
        tried.append((miss, friction / (MU * GRAVITY)))
        if miss < _ON_SPEED:
            return tried[-1][1], 0.0
        here = (pull, float(velocity[0]))
        crooked = velocity[1] / max(velocity[0], 0.2 * speed)
        if abs(crooked) > _ON_SPEED:
            side -= float(np.clip(crooked, -0.5, 0.5)) * pull
            pull, slow, fast = float(np.clip(friction, 0.8 * pull, 1.25 * pull)), None, None
            continue
        if velocity[0] < speed:
            slow = max(slow or here, here)
        else:
            fast = min(fast or here, here)
        pull = _next_pull(slow, fast, speed, half_way)
    return min(tried)[1], float(np.ptp([friction for _, friction in tried]))


def _next_pull(
    slow: tuple[float, float] | None, fast: tuple[float, float] | None, speed: float, time: float
) -> float:
    """A pull between one that is too weak and one that is too strong."""
    if slow is None or fast is None:
        pull, seen = slow or fast or (0.0, 0.0)
        if seen < 0.2 * speed:
            return 1.1 * pull  # it does not move, so friction is at least this large
        step = (speed - seen) / time
        return pull + float(np.clip(2 * step, -0.1 * pull, 0.1 * pull))
    share = (speed - slow[1]) / (fast[1] - slow[1])
    if slow[1] < 0.2 * speed or fast[1] > 3 * speed:
        share = 0.5
    return slow[0] + float(np.clip(share, 0.1, 0.9)) * (fast[0] - slow[0])


def _spin_torque(subject: Subject, rate: float, heading: float) -> float:
    """Angular deceleration of an object released with a spin, rad/s²."""
    scene = plain_scene()
    stop = abs(rate) * scene.moment_of_inertia / (MU * GRAVITY * scene.mass.sum() * scene.mean_arm)
    start = np.array([0.0, 0.0, heading])
    path = subject.lay(scene).slide(np.array([0.0, 0.0, rate]), _LATE[1] * stop, start)
    first = round(_LATE[0] * stop / subject.dt)
    return float(
        -np.sign(rate) * parabola(subject.dt * np.arange(float(first), len(path)), path[first:, 2])[1]
    )


def _slow_spin_torques(subject: Subject) -> FloatArray:
    """(8,) angular decelerations of slow spins either way while tilted gravity keeps the object sliding."""
    laid = subject.lay(plain_scene(), _tilted(np.array([MU * GRAVITY, 0.0])))
    torques = []
    for speed in _SLOW_SLIDES:
        for rate in (-_SLOW_SPIN, _SLOW_SPIN):
            path = laid.slide(np.array([speed, 0.0, rate]), _SLOW_STEPS * subject.full_dt)
            times = subject.dt * np.arange(float(len(path)))
            torques.append(-np.sign(rate) * parabola(times, path[:, 2])[1])
    return np.array(torques)


def _creep(subject: Subject, along: FloatArray) -> float:
    """Speed under a load that friction can hold, m/s."""
    laid = subject.lay(plain_scene(), _tilted(CREEP_LOAD * MU * GRAVITY * along))
    path = laid.slide(REST, _LAID + _CREPT)
    first = round(_LAID / subject.dt)
    return float(np.linalg.norm(path[-1, :2] - path[first, :2]) / (subject.dt * (len(path) - 1 - first)))


def leaned(answers: Answers) -> FloatArray:
    """(24,) angles between friction and the line of motion, counter-clockwise, rad."""
    back = rotated(answers.friction, np.pi - np.arctan2(answers.direction[:, 1], answers.direction[:, 0]))
    return np.arctan2(back[:, 1], back[:, 0])
