"""Names for what the probes show: where an engine leaves Coulomb's law, how far, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import minimize_scalar

from slipmap.diagrams.application.audit.engine import plain_scene
from slipmap.diagrams.application.audit.probes import (
    CREEP_LOAD,
    LATE,
    SPINS,
    STEADY_SPEEDS,
    Answers,
    slides_of_point,
)
from slipmap.models.geometry import cross
from slipmap.models.physics.cell_grid import FloatArray

Key = Literal[
    "factor", "speed", "diamond", "square", "grain", "lean", "load_follows_slip", "torsion", "creep"
]

SPIN_OF_SQUARE, SPIN_OF_DIAMOND = 4 / np.pi, 2 * np.sqrt(2) / np.pi
"""Torque of a spin over a cone's: the means of |cos| + |sin| and of max(|cos|, |sin|)."""

_SURE = 2.0  # times its uncertainty that a size must be
_CORNER = 0.02  # share of the speed within which a pyramid's corners are round


@dataclass(frozen=True)
class Measure:
    """One size that the probes give, named or not."""

    key: Key
    title: str
    value: float  # 0 by Coulomb's law
    uncertainty: float  # one standard deviation; the change at half the time step is part of it
    tolerance: float  # below which nobody minds
    unit: str  # "1" for a share
    sentence: str  # what it means, with the size
    effect: str | None  # of the library, that has it

    @property
    def named(self) -> bool:
        """Whether it is a defect."""
        return abs(self.value) > max(self.tolerance, _SURE * self.uncertainty)


@dataclass(frozen=True)
class Pyramid:
    """How far friction follows a pyramid instead of a cone."""

    kind: Literal["diamond", "square"]
    share: float  # 1 for a pyramid, 0 for a cone

    @property
    def spin(self) -> float:
        """Torque of a spin in place over that of a cone."""
        whole = SPIN_OF_SQUARE if self.kind == "square" else SPIN_OF_DIAMOND
        return float(1 + self.share * (whole - 1))


@dataclass(frozen=True, eq=False)
class _Shape:
    """How friction depends on direction."""

    pyramid: Pyramid
    grain: float  # half the difference of friction along and across a grain, as a share
    along_x: float  # friction along x over its mean, by the grain
    lean: float  # largest angle by which friction leaves the line of motion otherwise, rad


def pyramid_force(kind: str, direction: FloatArray) -> FloatArray:
    """(…, 2) friction over μ N of a whole pyramid of the world's axes, for motion in directions (…, 2)."""
    x, y = direction[..., 0], direction[..., 1]
    if kind == "square":
        return np.stack([-_sign(x), -_sign(y)], axis=-1)
    up, down = _sign((x + y) / np.sqrt(2)), _sign((x - y) / np.sqrt(2))
    return np.stack([-(up + down) / 2, -(up - down) / 2], axis=-1)


def measures(full: Answers, half: Answers, dt: float) -> list[Measure]:
    """Sizes of all that can be named, from the answers at the engine's time step dt, s, and at half of it."""
    shape, finer = _shape(full, dt, dt), _shape(half, dt / 2, dt)
    pyramid = shape.pyramid
    result = [
        _factor(full, half, shape), _speed(full, half), _pyramid(shape, finer),
        Measure(
            "grain", "grain", shape.grain, abs(shape.grain - finer.grain), 0.02, "1",
            f"Friction differs by {_percent(2 * shape.grain)} along and across one direction of the table.",
            "anisotropic_table",
        ),
        Measure(
            "lean", "leaning friction", np.degrees(shape.lean),
            np.degrees(abs(shape.lean - finer.lean)), 1.0, "°",
            f"Friction leaves the line of motion by up to {np.degrees(shape.lean):.1f}°, with no grain to"
            " explain it.", "impulse_friction",
        ),
    ]  # fmt: skip
    torsion, torsion_unsure = _mean(full.slow_spin), _spread(full.slow_spin, half.slow_spin)
    spins = [answers.spin / _expected_spin(answers, pyramid, shape) for answers in (full, half)]
    spin, unsure = _mean(spins[0]), _spread(*spins)
    # Torsion is the same in place and in a slide; a pyramid resists a slow spin across its axes as it would.
    has_torsion = (
        abs(torsion) > max(0.05, _SURE * torsion_unsure)
        and (spin - 1) / torsion > 0.5
        and pyramid.share < 0.05
    )
    if has_torsion:
        way = "resists" if torsion > 0 else "helps"
        result.append(
            Measure(
                "torsion", "torsional friction", torsion, torsion_unsure, 0.05, "1",
                f"A torque {way} any spin, with {_percent(abs(torsion))} of what Coulomb's law gives a"
                " spin in place.", "torsional_friction" if torsion > 0 else None,
            )
        )  # fmt: skip
    excess = spin - 1 - (torsion if has_torsion else 0.0)
    result.append(
        Measure(
            "load_follows_slip", "load that follows slip", excess, unsure, 0.05, "1",
            f"A spin in place meets {1 + excess:.2f} times the torque that even loads have: cells that slip"
            f" {'faster' if excess > 0 else 'slower'} carry more.", "slip_load",
        )
    )  # fmt: skip
    result.append(_creep(full, half))
    return result


def _mean(values: FloatArray) -> float:
    return float(np.mean(values))


def _spread(full: FloatArray, half: FloatArray) -> float:
    """Uncertainty of the mean of answers: their scatter, and the change at half the time step."""
    scatter = np.std(np.append(full - full.mean(), half - half.mean())) / np.sqrt(len(full))
    return float(np.hypot(scatter, full.mean() - half.mean()))


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def _expected_spin(answers: Answers, pyramid: Pyramid, shape: _Shape) -> FloatArray:
    """(16,) torque of spins in place over Coulomb's, if friction had no more to it than slides show."""
    slip = np.mean(LATE) * np.abs(SPINS) * plain_scene().mean_arm
    return np.asarray(pyramid.spin * np.interp(slip, STEADY_SPEEDS, answers.steady) / shape.along_x)


def _factor(full: Answers, half: Answers, shape: _Shape) -> Measure:
    value, finer = (float(answers.steady[0] / shape.along_x - 1) for answers in (full, half))
    return Measure(
        "factor", "friction off by a factor", value, abs(value - finer), 0.02, "1",
        f"Friction of slow slides is {1 + value:.3f} times what the coefficient says.", None,
    )  # fmt: skip


def _speed(full: Answers, half: Answers) -> Measure:
    def rise(answers: Answers) -> float:
        return float(answers.steady[-1] / answers.steady[0] - 1)

    slow, fast = STEADY_SPEEDS[0], STEADY_SPEEDS[-1]
    return Measure(
        "speed", "friction that depends on speed", rise(full), abs(rise(full) - rise(half)), 0.03, "1",
        f"From {slow:g} to {fast:g} m/s friction changes by {_percent(rise(full))}.",
        "viscous_friction" if rise(full) > 0 else "stribeck_friction",
    )  # fmt: skip


def _pyramid(shape: _Shape, finer: _Shape) -> Measure:
    kind, share = shape.pyramid.kind, shape.pyramid.share
    change = abs(share - finer.pyramid.share) if kind == finer.pyramid.kind else share
    corner = 1 + share * ((np.sqrt(2) if kind == "square" else np.sqrt(0.5)) - 1)
    if kind == "square":
        title, sentence = "friction pyramid, a square", "Along x and along y friction is solved by itself"
    else:
        title, sentence = "friction pyramid, a diamond", "Friction along x takes from friction along y"
    return Measure(
        kind, title, share, change, 0.1, "1",
        f"{sentence}: on the world's diagonals it is {corner:.2f} times that along the axes.",
        f"friction_{kind}",
    )  # fmt: skip


def _creep(full: Answers, half: Answers) -> Measure:
    value = 1e3 * float(full.creep.max())
    return Measure(
        "creep", "creep", value, abs(value - 1e3 * float(half.creep.max())), 0.02, "mm/s",
        f"Under {_percent(CREEP_LOAD)} of the force that friction can hold the object creeps at"
        f" {value:.2g} mm/s.", None,
    )  # fmt: skip


def _sign(values: FloatArray) -> FloatArray:
    return values / np.sqrt(values**2 + _CORNER**2)


def _shape(answers: Answers, dt: float, full_dt: float) -> _Shape:
    """The pyramid that fits best, beside a grain and a lean."""
    fits = []
    for kind in ("diamond", "square"):

        def misfit(share: float, kind: str = kind) -> float:
            return _beside_pyramid(answers, kind, share, dt, full_dt)[0]

        best = minimize_scalar(misfit, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-3})
        fits.append((float(best.fun), kind, float(best.x)))
    _, kind, share = min(fits)
    _, waves = _beside_pyramid(answers, kind, share, dt, full_dt)
    grain, lean = float(np.hypot(*waves[:2])), float(np.hypot(*waves[2:]))
    # Where friction changes with direction by a wave of size g, it leans by up to 2 g; what leans beyond is
    # something else.
    return _Shape(
        Pyramid("square" if kind == "square" else "diamond", share), grain, 1 + float(waves[0]),
        max(lean - 2 * grain, 0.0),
    )  # fmt: skip


def _beside_pyramid(
    answers: Answers, kind: str, share: float, dt: float, full_dt: float
) -> tuple[float, FloatArray]:
    """Sum of squares that a pyramid and two waves a turn leave, and (4,) these: along motion, and across."""

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
