"""Probes of an engine: how friction depends on direction, speed, place and spin; and the sizes of possible
defects, from its answers, each with an uncertainty.

All probes use a plate of uniform weight and friction, for which Coulomb's law gives the answers. In some
engines, sliding contacts hop and friction comes in bursts. Probes therefore keep the object sliding steadily,
with gravity tilted to balance friction, where that is possible, and average over several speeds elsewhere.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from slipmap.diagrams.application.audit.engines import GRAVITY, LEVEL, MU, REST, Laid, Subject, plain_scene
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
# load, as a multiple of what friction can hold, under which the object must slide, also if friction is three
# times Coulomb's; and for how long, s
_STEEP, _SLID = 4.0, 0.15
_RELEASED = 0.03  # s for which an object must keep most of the velocity that it is given
Report = Callable[[int], None]  # called with the number of finished probes or pushes
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
    numbers = itertools.count(1)

    def done(answer: Any) -> Any:
        report(next(numbers))
        return answer

    for check in (_check_gravity, _check_velocity):
        check(subject)
        done(None)
    slides = [done(_free_slide(subject, angle)) for angle in DIRECTIONS]
    direction, friction = np.array(slides).transpose(1, 0, 2)
    harmonics = harmonics_of(direction, friction, subject.dt, subject.full_dt)
    heading = np.array([0.0, 0.0, _TURNED])
    turned = [done(_free_slide(subject, angle, heading)) for angle in DIRECTIONS[::3]]
    by_place = []
    for axis, angle in zip(np.eye(2), (0.0, np.pi / 2), strict=True):
        starts = (np.append(side * axis, 0.0) for side in (-APART, APART))
        before, beyond = (done(-_free_slide(subject, angle, start)[1] @ axis) for start in starts)
        by_place.append((beyond - before) / 2)
    both_ways = [[done(_steady_slide(subject, v, sense)) for sense in (1.0, -1.0)] for v in STEADY_SPEEDS]
    steady, unsure = np.mean(both_ways, axis=1).T
    along_x = 1 + float(harmonics.along[0])
    law = Law(harmonics, _is_of_object(harmonics, np.array(turned)), steady / along_x)
    same = Subject("law", type("Same", (LawEngine,), {"dt": subject.dt, "law": law}), subject.full_dt)
    headings = 2 * np.pi * np.arange(len(SPINS)) / len(SPINS)
    spins = [
        done(_spin_torque(subject, rate, at) / _spin_torque(same, rate, at))
        for rate, at in zip(SPINS, headings, strict=True)
    ]
    slow = _slow_spin_torques(subject) - _slow_spin_torques(same)
    slow = done(slow / _spin_torque(same, SPINS[-1], 0.0))
    creep = [done(_creep(subject, angle)) for angle in _CREEP_DIRECTIONS]
    again = subject.lay(plain_scene())
    ends = [_turning_slide(laid)[-1, :2] for laid in (subject.lay(plain_scene()), again, again)]
    repeat = done(float(max(np.linalg.norm(end - ends[0]) for end in ends)))
    return Answers(
        direction, friction, np.array(by_place), steady, unsure, law, np.array(spins), slow, np.array(creep),
        repeat,
    )  # fmt: skip


def _tilted(along: FloatArray) -> FloatArray:
    """(3,) gravity with a component (2,) along the table, m/s²."""
    return LEVEL + np.append(along, 0.0)


def _check_gravity(subject: Subject) -> None:
    along = np.array([_STEEP * MU * GRAVITY, 0.0])
    path = subject.lay(plain_scene(), _tilted(along)).slide(REST, _SLID)
    moved, wanted = path[-1, 0] - path[0, 0], 0.5 * (_STEEP - 1) * MU * GRAVITY * _SLID**2
    if moved < 0.1 * wanted:
        raise BadInput(
            f"engine {subject.name}: with gravity {_tilted(along).round(2).tolist()} m/s², the object moves"
            f" {1e3 * moved:.1f} mm in {_SLID} s instead of {1e3 * wanted:.0f} mm under Coulomb's law;"
            " __init__ must use the gravity that it is given, tilted or not, and friction must be less than"
            " three times Coulomb's"
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


def _creep(subject: Subject, angle: float) -> float:
    """Speed under a load in a direction (rad) that friction can hold, m/s."""
    along = np.array([np.cos(angle), np.sin(angle)])
    laid = subject.lay(plain_scene(), _tilted(CREEP_LOAD * MU * GRAVITY * along))
    path = laid.slide(REST, _LAID + _CREPT)
    first = round(_LAID / subject.dt)
    return float(np.linalg.norm(path[-1, :2] - path[first, :2]) / (subject.dt * (len(path) - 1 - first)))


def leaned(answers: Answers) -> FloatArray:
    """(24,) angles between friction and the line of motion, counter-clockwise, rad."""
    back = rotated(answers.friction, np.pi - np.arctan2(answers.direction[:, 1], answers.direction[:, 0]))
    return np.arctan2(back[:, 1], back[:, 0])


# Sizes of possible defects.

Key = Literal[
    "factor", "speed", "diamond", "square", "grain", "lean", "force", "place", "load_follows_slip",
    "torsion", "creep", "repeat",
]  # fmt: skip
_SURE = 2.0  # least ratio of a size to its uncertainty


@dataclass(frozen=True)
class Measure:
    """One size measured by the probes, whether a defect or not."""

    key: Key
    title: str
    value: float  # 0 under Coulomb's law
    uncertainty: float  # one standard deviation, including the change at half the time step
    tolerance: float  # size up to which it is no defect
    unit: str  # "1" for a share
    sentence: str  # its meaning, with the size
    effect: str | None  # corresponding effect of the library

    @property
    def named(self) -> bool:
        """Whether it is a defect."""
        return abs(self.value) > max(self.tolerance, _SURE * self.uncertainty)


_KINDS: dict[Key, tuple[str, float, str]] = {
    "factor": ("friction off by a factor", 0.02, "1"),
    "speed": ("friction that depends on speed", 0.03, "1"),
    "diamond": ("friction pyramid, a diamond", 0.1, "1"),
    "square": ("friction pyramid, a square", 0.1, "1"),
    "grain": ("grain", 0.02, "1"),
    "lean": ("leaning friction", 1.0, "°"),
    "force": ("constant force, or a tilt", 0.01, "1"),
    "place": ("friction that depends on place", 0.03, "1"),
    "torsion": ("torsional friction", 0.05, "1"),
    "load_follows_slip": ("load that follows slip", 0.05, "1"),
    "creep": ("creep", 0.02, "mm/s"),
    "repeat": ("results that change between runs", 0.01, "mm"),
}
"""Title, tolerance and unit of each measure."""

_PYRAMIDS = {
    "square": "Friction along x and along y is solved independently",
    "diamond": "Friction along x and along y share one limit",
}


def measures(full: Answers, half: Answers) -> list[Measure]:
    """Sizes of all possible defects, from the answers at the engine's time step and at half of it."""
    found: list[Measure] = []

    def add(key: Key, value: float, uncertainty: float, sentence: str, effect: str | None = None) -> None:
        title, tolerance, unit = _KINDS[key]
        numbers = float(value), float(uncertainty)
        found.append(Measure(key, title, *numbers, tolerance, unit, sentence, effect))

    shape, finer = full.law.harmonics, half.law.harmonics
    pyramid, grain = shape.pyramid, shape.grain
    (factor, guess), (factor_half, _) = _factor(full), _factor(half)
    # Means over directions, of friction or of its inverse, differ by up to the square of a grain.
    add("factor", factor,
        float(np.linalg.norm([factor - factor_half, *full.steady_unsure, guess, grain**2])),
        f"Friction is {1 + factor:.3f} times the value from the coefficient, at any speed.")  # fmt: skip
    rise, rise_half = (answers.steady[-1] / answers.steady[0] - 1 for answers in (full, half))
    add("speed", rise, float(np.linalg.norm([rise - rise_half, *full.steady_unsure[[0, -1]]])),
        f"From {STEADY_SPEEDS[0]:g} to {STEADY_SPEEDS[-1]:g} m/s, friction changes by {_percent(rise)}, from"
        f" {full.steady[0]:.3f} to {full.steady[-1]:.3f} times Coulomb's.",
        "viscous_friction" if rise > 0 else "stribeck_friction")  # fmt: skip
    same_kind = pyramid.kind == finer.pyramid.kind
    corner = 1 + pyramid.share * ((np.sqrt(2) if pyramid.kind == "square" else np.sqrt(0.5)) - 1)
    # An elliptic grain has a fourth harmonic, too, of about the square of the grain.
    add(pyramid.kind, pyramid.share,
        np.hypot(pyramid.share - finer.pyramid.share, grain**2) if same_kind else pyramid.share,
        f"{_PYRAMIDS[pyramid.kind]}: on the world's diagonals, it is {corner:.2f} times that along the axes.",
        f"friction_{pyramid.kind}")  # fmt: skip
    owner = "object" if full.law.of_object else "table"
    add("grain", grain, np.hypot(shape.along_unsure, grain - finer.grain),
        f"Friction along and across one direction of the {owner} is {_percent(grain)} above and below its"
        " mean.",
        f"anisotropic_{owner}")  # fmt: skip
    lean, finer_lean = np.degrees(shape.leaning), np.degrees(finer.leaning)
    everywhere = abs(np.degrees(np.arctan(shape.lean))) > 0.5 * abs(lean)
    add("lean", lean, np.hypot(np.degrees(shape.lean_unsure), abs(lean) - abs(finer_lean)),
        f"Friction leans off the line of motion by {'' if everywhere else 'up to '}{abs(lean):.1f}°"
        + (f", {'counter-' if lean > 0 else ''}clockwise in every direction." if everywhere
           else ", which no grain explains."),
        None if everywhere else "impulse_friction")  # fmt: skip
    force, change = np.hypot(*shape.force), np.hypot(*(shape.force - finer.force))
    add("force", force, np.hypot(shape.force_unsure, change),
        f"A constant force of {_percent(force)} of friction pulls the object in the direction"
        f" {_degrees(shape.force):.0f}°, as if the table sloped by {np.degrees(np.arctan(MU * force)):.2g}°.",
        "table_tilt")  # fmt: skip
    place, change = np.hypot(*full.by_place), np.hypot(*(full.by_place - half.by_place))
    add("place", place, np.hypot(shape.scatter, change),
        f"Friction rises by {_percent(place)} per {APART:g} m in the direction"
        f" {_degrees(full.by_place):.0f}°.", "table_friction_field")  # fmt: skip
    torsion, torsion_unsure = full.slow_spin.mean(), _spread(full.slow_spin, half.slow_spin)
    spin, unsure = full.spin.mean(), _spread(full.spin, half.spin)
    # Torsion is the same in place and during a slide; a pyramid resists a slow spin across its axes likewise.
    felt = abs(torsion) > max(_KINDS["torsion"][1], _SURE * torsion_unsure)
    has_torsion = felt and (spin - 1) / torsion > 0.5 and pyramid.share < max(0.05, 2 * grain**2)
    add("torsion", torsion if has_torsion or not felt else 0.0, torsion_unsure,
        f"A torque {'resists' if torsion > 0 else 'helps'} any spin, with {_percent(abs(torsion))} of the"
        " torque of a spin in place without it.",
        "torsional_friction" if torsion > 0 else None)  # fmt: skip
    excess = spin - 1 - (torsion if has_torsion else 0.0)
    add("load_follows_slip", excess, unsure,
        f"A spin in place meets {1 + excess:.2f} times the torque of even loads: cells that slip"
        f" {'faster' if excess > 0 else 'slower'} carry more load.", "slip_load")  # fmt: skip
    creep, creep_half = (1e3 * answers.creep.max() for answers in (full, half))
    add("creep", creep, abs(creep - creep_half),
        f"Under {_percent(CREEP_LOAD)} of the force that friction can hold, the object creeps at"
        f" {creep:.2g} mm/s.")  # fmt: skip
    repeat = 1e3 * full.repeat
    add("repeat", repeat, 0.0,
        f"The same slide, repeated, ends {repeat:.2g} mm apart, so other sizes may be chance.")  # fmt: skip
    return found


def _factor(answers: Answers) -> tuple[float, float]:
    """The part of friction's excess over Coulomb's that is there at any speed, and how much of it is guessed.

    Close to rest, where nothing is measured, it is extrapolated.
    """
    level = answers.law.level * np.hypot(1.0, answers.law.harmonics.lean)
    rise = (level[1] - level[0]) / (STEADY_SPEEDS[1] - STEADY_SPEEDS[0])
    guess = STEADY_SPEEDS[0] * rise
    excess = np.append(level, level[0] - guess) - 1
    return float(max(excess.min(), 0.0) + min(excess.max(), 0.0)), float(guess)


def _degrees(vector: FloatArray) -> float:
    return float(np.degrees(np.arctan2(vector[1], vector[0])).round() + 0.0)  # no -0


def _spread(full: FloatArray, half: FloatArray) -> float:
    """Uncertainty of the mean of answers: their scatter, and the change at half the time step."""
    scatter = np.std(np.append(full - full.mean(), half - half.mean())) / np.sqrt(len(full))
    return float(np.hypot(scatter, full.mean() - half.mean()))


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"
