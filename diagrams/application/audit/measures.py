"""Sizes of an engine's possible defects, from its answers to the probes; each with an uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from slipmap.diagrams.application.audit.engines import MU
from slipmap.diagrams.application.audit.law import STEADY_SPEEDS
from slipmap.diagrams.application.audit.probes import APART, CREEP_LOAD, Answers
from slipmap.models.physics.cell_grid import FloatArray

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
        found.append(Measure(key, title, value, uncertainty, tolerance, unit, sentence, effect))

    shape, finer = full.law.harmonics, half.law.harmonics
    pyramid, grain = shape.pyramid, shape.grain
    (factor, guess), (factor_half, _) = _factor(full), _factor(half)
    # Means over directions, of friction or of its inverse, differ by up to the square of a grain.
    add("factor", factor,
        float(np.linalg.norm([factor - factor_half, *full.steady_unsure, guess, grain**2])),
        f"Friction is {1 + factor:.3f} times the value from the coefficient, at any speed.")  # fmt: skip
    rise, rise_half = (float(answers.steady[-1] / answers.steady[0] - 1) for answers in (full, half))
    add("speed", rise, float(np.linalg.norm([rise - rise_half, *full.steady_unsure[[0, -1]]])),
        f"From {STEADY_SPEEDS[0]:g} to {STEADY_SPEEDS[-1]:g} m/s, friction changes by {_percent(rise)}, from"
        f" {full.steady[0]:.3f} to {full.steady[-1]:.3f} times Coulomb's.",
        "viscous_friction" if rise > 0 else "stribeck_friction")  # fmt: skip
    same_kind = pyramid.kind == finer.pyramid.kind
    corner = 1 + pyramid.share * ((np.sqrt(2) if pyramid.kind == "square" else np.sqrt(0.5)) - 1)
    add(pyramid.kind, pyramid.share,
        abs(pyramid.share - finer.pyramid.share) if same_kind else pyramid.share,
        f"{_PYRAMIDS[pyramid.kind]}: on the world's diagonals, it is {corner:.2f} times that along the axes.",
        f"friction_{pyramid.kind}")  # fmt: skip
    owner = "object" if full.law.of_object else "table"
    add("grain", grain, float(np.hypot(shape.along_unsure, grain - finer.grain)),
        f"Friction along and across one direction of the {owner} is {_percent(grain)} above and below its"
        " mean.",
        f"anisotropic_{owner}")  # fmt: skip
    lean, finer_lean = np.degrees(shape.leaning), np.degrees(finer.leaning)
    everywhere = abs(np.degrees(np.arctan(shape.lean))) > 0.5 * abs(lean)
    add("lean", float(lean), float(np.hypot(np.degrees(shape.lean_unsure), abs(lean) - abs(finer_lean))),
        f"Friction leans off the line of motion by {'' if everywhere else 'up to '}{abs(lean):.1f}°"
        + (f", {'counter-' if lean > 0 else ''}clockwise in every direction." if everywhere
           else ", which no grain explains."),
        None if everywhere else "impulse_friction")  # fmt: skip
    force, change = _size(shape.force), _size(shape.force - finer.force)
    add("force", force, float(np.hypot(shape.force_unsure, change)),
        f"A constant force of {_percent(force)} of friction pulls the object in the direction"
        f" {_degrees(shape.force):.0f}°, as if the table sloped by {np.degrees(np.arctan(MU * force)):.2g}°.",
        "table_tilt")  # fmt: skip
    place, change = _size(full.by_place), _size(full.by_place - half.by_place)
    add("place", place, float(np.hypot(shape.scatter, change)),
        f"Friction rises by {_percent(place)} per {APART:g} m in the direction"
        f" {_degrees(full.by_place):.0f}°.", "table_friction_field")  # fmt: skip
    torsion, torsion_unsure = _mean(full.slow_spin), _spread(full.slow_spin, half.slow_spin)
    spin, unsure = _mean(full.spin), _spread(full.spin, half.spin)
    # Torsion is the same in place and during a slide; a pyramid resists a slow spin across its axes likewise.
    has_torsion = (
        abs(torsion) > max(_KINDS["torsion"][1], _SURE * torsion_unsure)
        and (spin - 1) / torsion > 0.5
        and pyramid.share < 0.05
    )
    if has_torsion:
        add("torsion", torsion, torsion_unsure,
            f"A torque {'resists' if torsion > 0 else 'helps'} any spin, with {_percent(abs(torsion))} of the"
            " torque of a spin in place without it.",
            "torsional_friction" if torsion > 0 else None)  # fmt: skip
    excess = spin - 1 - (torsion if has_torsion else 0.0)
    add("load_follows_slip", excess, unsure,
        f"A spin in place meets {1 + excess:.2f} times the torque of even loads: cells that slip"
        f" {'faster' if excess > 0 else 'slower'} carry more load.", "slip_load")  # fmt: skip
    creep, creep_half = (1e3 * float(answers.creep.max()) for answers in (full, half))
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


def _mean(values: FloatArray) -> float:
    return float(np.mean(values))


def _size(vector: FloatArray) -> float:
    return float(np.hypot(*vector))


def _degrees(vector: FloatArray) -> float:
    return float(np.degrees(np.arctan2(vector[1], vector[0])).round() + 0.0)  # no -0


def _spread(full: FloatArray, half: FloatArray) -> float:
    """Uncertainty of the mean of answers: their scatter, and the change at half the time step."""
    scatter = np.std(np.append(full - full.mean(), half - half.mean())) / np.sqrt(len(full))
    return float(np.hypot(scatter, full.mean() - half.mean()))


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"
