"""Probes of an engine: how friction depends on direction, speed and spin, and which defects that shows.

All probes use a plate of uniform weight and friction, for which Coulomb's law gives the answers. In some
engines, sliding contacts hop and friction comes in bursts. Probes therefore keep the object sliding steadily,
with gravity tilted to balance friction, where that is possible, and average over several speeds elsewhere.
Every defect has a size with an uncertainty.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from slipmap.diagrams.application.audit.engines import (
    GRAVITY,
    LEVEL,
    MU,
    REST,
    CoulombEngine,
    Subject,
    plain_scene,
)
from slipmap.models.files import BadInput
from slipmap.models.geometry import cross, rotated
from slipmap.models.physics.cell_grid import FloatArray

DIRECTIONS = np.arange(24) * np.pi / 12  # (24,) directions of the free slides, rad
STEADY_SPEEDS = np.array([0.02, 0.05, 0.1, 0.3])  # speeds of the steady slides along x, m/s
SPINS = np.outer([-1.0, 1.0], np.linspace(3.0, 8.0, 8)).ravel()  # initial rates of the spins in place, rad/s
CREEP_LOAD = 0.6  # load as a share of what friction can hold
_SLIDE_SPEEDS = np.array([0.2, 0.3, 0.45])  # m/s
_STEPS = 40  # fewest time steps until a free slide stops
_FINE = 4  # steps of a point per step of the engine
_EARLY = (0.05, 0.45)  # evaluated share of the time until it stops, in which the direction changes little
LATE = (0.1, 0.75)  # evaluated share of the time until a spin stops
_SETTLED, _STEADY = 0.1, 0.3  # s for which a steady slide settles, and is then observed
_SLOW_SPIN, _SLOW_STEPS = 0.8, 6  # rad/s, and number of steps
_SLOW_SLIDES = np.array([0.15, 0.2, 0.25, 0.3])  # m/s of the object in the meantime
_CREEP_DIRECTIONS = np.radians([0.0, 22.5, 45.0])
_LAID, _CREPT = 0.25, 0.25  # s for which a loaded object settles, and is then observed
_STEEP = 1.5  # load, as a multiple of what friction can hold, under which the object must slide
Report = Callable[[int], None]  # called with the number of finished probes
COUNT = 2 + len(DIRECTIONS) + len(STEADY_SPEEDS) + len(SPINS) + len(_CREEP_DIRECTIONS)
"""Number of probes of one engine at one time step."""


@dataclass(frozen=True, eq=False)
class Answers:
    """Answers of an engine to the probes at one time step."""

    # (24, 2) directions of motion (unit vectors) and friction as acceleration over μ g, both half-way;
    # Coulomb's law gives -1 along the motion
    direction: FloatArray
    friction: FloatArray
    steady: FloatArray  # (4,) friction at `STEADY_SPEEDS` relative to Coulomb's
    spin: FloatArray  # (16,) torque of spins in place relative to Coulomb's
    # (8,) torque of slow spins during a slide minus Coulomb's, relative to Coulomb's for a spin in place
    slow_spin: FloatArray
    creep: FloatArray  # (3,) speed under a load that friction can hold, m/s


def ask(subject: Subject, report: Report) -> Answers:
    """Run all probes of an engine.

    Args:
        subject: the engine.
        report: called after each of `COUNT` probes.

    Raises:
        BadInput: the engine fails, or ignores the tilt of gravity.
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
    """(3,) gravity with a component (2,) along the table, m/s²."""
    return LEVEL + np.append(along, 0.0)


def _parabola(times: NDArray[np.floating[Any]], values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Velocity half-way and acceleration of values at given times, by least squares."""
    bend, slope, _ = np.polyfit(times - times.mean(), values, 2)
    return slope, 2 * bend


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


def _free_slide(subject: Subject, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Direction half-way and friction (2,) of slides released in a direction."""
    laid = subject.lay(plain_scene())
    paths = [
        laid.slide(np.array([*(speed * along), 0.0]), _EARLY[1] * speed / (MU * GRAVITY))[:, :2]
        for speed in slide_speeds(subject.full_dt)
    ]
    return seen_in_slides(paths, subject.dt)


def slide_speeds(dt: float) -> FloatArray:
    """(3,) speeds of free slides, m/s, for a time step of the engine, s; higher for long steps."""
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
    """Direction and friction (24, 2), as in `Answers`, of free slides under a law of friction.

    Args:
        friction: maps directions of motion (24, 2) to friction over μ N (24, 2).
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
    """Friction along x at a steady speed relative to Coulomb's, from the gravity that balances it."""
    along = MU * GRAVITY
    for _ in range(3):
        laid = subject.lay(plain_scene(), _tilted(np.array([along, 0.0])))
        path = laid.slide(np.array([speed, 0.0, 0.0]), _SETTLED + _STEADY)
        first = round(_SETTLED / subject.dt)
        along -= float(_parabola(subject.dt * np.arange(float(first), len(path)), path[first:, 0])[1])
        if path[-1, 0] - path[first, 0] < 0.2 * speed * _STEADY:
            along *= 1.1  # it does not move, so friction is at least this large
    return along / (MU * GRAVITY)


def _spin_torque(subject: Subject, rate: float) -> float:
    """Angular deceleration of an object released with a spin, rad/s²."""
    scene = plain_scene()
    stop = abs(rate) * scene.moment_of_inertia / (MU * GRAVITY * scene.mass.sum() * scene.mean_arm)
    path = subject.lay(scene).slide(np.array([0.0, 0.0, rate]), LATE[1] * stop)
    first = round(LATE[0] * stop / subject.dt)
    return float(
        -np.sign(rate) * _parabola(subject.dt * np.arange(float(first), len(path)), path[first:, 2])[1]
    )


def _slow_spin_torques(subject: Subject) -> FloatArray:
    """(8,) angular decelerations of slow spins either way while tilted gravity keeps the object sliding."""
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
    """(24,) angles between friction and the line of motion, counter-clockwise, rad."""
    back = rotated(answers.friction, np.pi - np.arctan2(answers.direction[:, 1], answers.direction[:, 0]))
    return np.arctan2(back[:, 1], back[:, 0])


Key = Literal[
    "factor", "speed", "diamond", "square", "grain", "lean", "load_follows_slip", "torsion", "creep"
]

SPIN_OF_SQUARE, SPIN_OF_DIAMOND = 4 / np.pi, 2 * np.sqrt(2) / np.pi
"""Torque of a spin relative to a cone's: the means of |cos| + |sin| and of max(|cos|, |sin|)."""

_SURE = 2.0  # least ratio of a size to its uncertainty
_CORNER = 0.02  # share of the speed within which a pyramid's corners are round


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


@dataclass(frozen=True)
class Pyramid:
    """Degree to which friction follows a pyramid instead of a cone."""

    kind: Literal["diamond", "square"]
    share: float  # 1 for a pyramid, 0 for a cone

    @property
    def spin(self) -> float:
        """Torque of a spin in place relative to a cone's."""
        whole = SPIN_OF_SQUARE if self.kind == "square" else SPIN_OF_DIAMOND
        return float(1 + self.share * (whole - 1))


@dataclass(frozen=True, eq=False)
class _Shape:
    """Dependence of friction on direction."""

    pyramid: Pyramid
    grain: float  # half the difference of friction along and across a grain, as a share
    along_x: float  # friction along x relative to its mean, due to the grain
    lean: float  # largest remaining angle between friction and the line of motion, rad


def pyramid_force(kind: str, direction: FloatArray) -> FloatArray:
    """(…, 2) friction over μ N of a full pyramid along the world's axes, for directions of motion (…, 2)."""
    x, y = direction[..., 0], direction[..., 1]
    if kind == "square":
        return np.stack([-_sign(x), -_sign(y)], axis=-1)
    up, down = _sign((x + y) / np.sqrt(2)), _sign((x - y) / np.sqrt(2))
    return np.stack([-(up + down) / 2, -(up - down) / 2], axis=-1)


_KINDS: dict[Key, tuple[str, float, str]] = {
    "factor": ("friction off by a factor", 0.02, "1"),
    "speed": ("friction that depends on speed", 0.03, "1"),
    "diamond": ("friction pyramid, a diamond", 0.1, "1"),
    "square": ("friction pyramid, a square", 0.1, "1"),
    "grain": ("grain", 0.02, "1"),
    "lean": ("leaning friction", 1.0, "°"),
    "torsion": ("torsional friction", 0.05, "1"),
    "load_follows_slip": ("load that follows slip", 0.05, "1"),
    "creep": ("creep", 0.02, "mm/s"),
}
"""Title, tolerance and unit of each measure."""

_PYRAMIDS = {
    "square": "Friction along x and along y is solved independently",
    "diamond": "Friction along x and along y share one limit",
}


def measures(full: Answers, half: Answers, dt: float) -> list[Measure]:
    """Sizes of all possible defects, from the answers at the engine's time step dt, s, and at half of it."""
    found: list[Measure] = []

    def add(key: Key, value: float, uncertainty: float, sentence: str, effect: str | None = None) -> None:
        title, tolerance, unit = _KINDS[key]
        found.append(Measure(key, title, value, uncertainty, tolerance, unit, sentence, effect))

    shape, finer = _shape(full, dt, dt), _shape(half, dt / 2, dt)
    pyramid = shape.pyramid
    slow, slow_half = (float(answers.steady[0] / shape.along_x - 1) for answers in (full, half))
    add("factor", slow, abs(slow - slow_half),
        f"Friction of slow slides is {1 + slow:.3f} times the value from the coefficient.")  # fmt: skip
    rise, rise_half = (float(answers.steady[-1] / answers.steady[0] - 1) for answers in (full, half))
    add("speed", rise, abs(rise - rise_half),
        f"From {STEADY_SPEEDS[0]:g} to {STEADY_SPEEDS[-1]:g} m/s, friction changes by {_percent(rise)}.",
        "viscous_friction" if rise > 0 else "stribeck_friction")  # fmt: skip
    same_kind = pyramid.kind == finer.pyramid.kind
    corner = 1 + pyramid.share * ((np.sqrt(2) if pyramid.kind == "square" else np.sqrt(0.5)) - 1)
    add(pyramid.kind, pyramid.share, abs(pyramid.share - finer.pyramid.share) if same_kind else pyramid.share,
        f"{_PYRAMIDS[pyramid.kind]}: on the world's diagonals, it is {corner:.2f} times that along the axes.",
        f"friction_{pyramid.kind}")  # fmt: skip
    add("grain", shape.grain, abs(shape.grain - finer.grain),
        f"Friction along and across one direction of the table differs by {_percent(2 * shape.grain)}.",
        "anisotropic_table")  # fmt: skip
    lean = np.degrees(shape.lean)
    add("lean", lean, np.degrees(abs(shape.lean - finer.lean)),
        f"Friction deviates from the line of motion by up to {lean:.1f}°, which no grain explains.",
        "impulse_friction")  # fmt: skip
    torsion, torsion_unsure = _mean(full.slow_spin), _spread(full.slow_spin, half.slow_spin)
    spins = [answers.spin / _expected_spin(answers, pyramid, shape) for answers in (full, half)]
    spin, unsure = _mean(spins[0]), _spread(*spins)
    # Torsion is the same in place and during a slide; a pyramid resists a slow spin across its axes likewise.
    has_torsion = (
        abs(torsion) > max(0.05, _SURE * torsion_unsure)
        and (spin - 1) / torsion > 0.5
        and pyramid.share < 0.05
    )
    if has_torsion:
        add("torsion", torsion, torsion_unsure,
            f"A torque {'resists' if torsion > 0 else 'helps'} any spin, with {_percent(abs(torsion))} of the"
            " torque of a spin in place under Coulomb's law.",
            "torsional_friction" if torsion > 0 else None)  # fmt: skip
    excess = spin - 1 - (torsion if has_torsion else 0.0)
    add("load_follows_slip", excess, unsure,
        f"A spin in place meets {1 + excess:.2f} times the torque of even loads: cells that slip"
        f" {'faster' if excess > 0 else 'slower'} carry more load.", "slip_load")  # fmt: skip
    creep, creep_half = (1e3 * float(answers.creep.max()) for answers in (full, half))
    add("creep", creep, abs(creep - creep_half),
        f"Under {_percent(CREEP_LOAD)} of the force that friction can hold, the object creeps at"
        f" {creep:.2g} mm/s.")  # fmt: skip
    return found


def _mean(values: FloatArray) -> float:
    return float(np.mean(values))


def _spread(full: FloatArray, half: FloatArray) -> float:
    """Uncertainty of the mean of answers: their scatter, and the change at half the time step."""
    scatter = np.std(np.append(full - full.mean(), half - half.mean())) / np.sqrt(len(full))
    return float(np.hypot(scatter, full.mean() - half.mean()))


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def _expected_spin(answers: Answers, pyramid: Pyramid, shape: _Shape) -> FloatArray:
    """(16,) torque of spins in place relative to Coulomb's, as predicted from the slides."""
    slip = np.mean(LATE) * np.abs(SPINS) * plain_scene().mean_arm
    return np.asarray(pyramid.spin * np.interp(slip, STEADY_SPEEDS, answers.steady) / shape.along_x)


def _sign(values: FloatArray) -> FloatArray:
    return values / np.sqrt(values**2 + _CORNER**2)


def _shape(answers: Answers, dt: float, full_dt: float) -> _Shape:
    """The best-fitting pyramid, with a grain and a lean."""
    fits = []
    for kind in ("diamond", "square"):

        def misfit(share: float, kind: str = kind) -> float:
            return _beside_pyramid(answers, kind, share, dt, full_dt)[0]

        best = minimize_scalar(misfit, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-3})
        fits.append((float(best.fun), kind, float(best.x)))
    _, kind, share = min(fits)
    _, waves = _beside_pyramid(answers, kind, share, dt, full_dt)
    grain, lean = float(np.hypot(*waves[:2])), float(np.hypot(*waves[2:]))
    # A variation of friction with direction of amplitude g deflects it by up to 2 g; only the rest is a lean.
    return _Shape(
        Pyramid("square" if kind == "square" else "diamond", share), grain, 1 + float(waves[0]),
        max(lean - 2 * grain, 0.0),
    )  # fmt: skip


def _beside_pyramid(
    answers: Answers, kind: str, share: float, dt: float, full_dt: float
) -> tuple[float, FloatArray]:
    """Sum of squares left by a pyramid and waves of period π; (4,) the waves, along motion and across."""

    def friction(direction: FloatArray) -> FloatArray:
        return (share - 1) * direction + share * pyramid_force(kind, direction)

    way, force = slides_of_point(friction, dt, full_dt)
    u = answers.direction
    angle = np.arctan2(u[:, 1], u[:, 0])
    waves, none = np.column_stack([np.cos(2 * angle), np.sin(2 * angle)]), np.zeros((len(u), 2))
    level = -np.sum(force * way, axis=1)[:, None]
    columns = np.block([[level, waves, none], [-cross(way, force)[:, None], none, waves]])
    seen = np.append(-np.sum(answers.friction * u, axis=1), -cross(u, answers.friction))
    found, *_ = np.linalg.lstsq(columns, seen, rcond=None)
    left = columns @ found - seen
    return float(left @ left), found[1:] / found[0]
