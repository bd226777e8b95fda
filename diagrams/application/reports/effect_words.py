"""Sizes of effects as a person would say them: a tilt in degrees and where it leads, not two slopes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from slipmap.models.effects.effect import Effect, Parameter
from slipmap.models.inference.diagnosis.results import ParameterEstimate
from slipmap.models.physics.cell_grid import CellGrid

Estimates = Mapping[str, ParameterEstimate]


@dataclass(frozen=True)
class Reading:
    """One number that a person asks for, with its 90 % interval, in the unit of its text.

    Attributes:
        text: with `{}` where the number goes, such as `tilt {}°`.
        value: the number.
        low: lower end of the interval.
        high: upper end.
    """

    text: str
    value: float
    low: float
    high: float

    def said(self) -> str:
        """The reading with its number and interval."""
        value, low, high = shown_numbers(self.value, self.low, self.high)
        return self.text.format(f"{value}") + f" ({low} to {high})"


def effect_in_words(name: str, estimates: Sequence[ParameterEstimate], grid: CellGrid) -> str:
    """How large an effect is, in one line; the parameters as they are where there is no better way to say it.

    Args:
        name: of the effect.
        estimates: of all its parameters.
        grid: the object's, for what its size decides.
    """
    reader = READERS.get(name)
    if reader is None or not estimates:
        readings = [Reading(f"{e.name} {{}}{unit_text(e.unit)}", e.value, e.low, e.high) for e in estimates]
    else:
        readings = reader({e.name: e for e in estimates}, grid)
    return ", ".join(reading.said() for reading in readings)


def parameter_rows(
    effects: Sequence[Effect], estimates: Sequence[ParameterEstimate]
) -> list[tuple[str, str, str, str]]:
    """Name with unit (and effect, if there are several), value, 90 % interval, meaning of each parameter."""
    known = {(effect.name, p.name): p for effect in effects for p in effect.parameters}
    several = len({e.effect for e in estimates}) > 1
    rows = []
    for e in estimates:
        value, low, high = shown_numbers(e.value, e.low, e.high)
        name = (f"{e.effect}: " if several else "") + e.name + ("" if e.unit == "1" else f", {e.unit}")
        parameter = known.get((e.effect, e.name))
        meaning = "" if parameter is None else parameter.meaning
        if parameter is not None and _at_an_end(e.value, parameter):
            meaning += "; at the end of its range"
        rows.append((name, value, f"{low} to {high}", meaning))
    return rows


def _at_an_end(value: float, parameter: Parameter) -> bool:
    """Whether a value lies at an end of its range that only keeps the search within reason, as 0 does not."""
    near = 0.01 * (parameter.high - parameter.low)
    ends = [end for end in (parameter.low, parameter.high) if end != 0.0]
    return any(abs(value - end) < near for end in ends)


def unit_text(unit: str) -> str:
    """The unit after a number; nothing where there is none."""
    return "" if unit == "1" else f" {unit}"


def shown_numbers(*values: float) -> tuple[str, ...]:
    """Numbers of which the last two are an interval, with two figures of its width."""
    width = abs(values[-1] - values[-2])
    size = width if np.isfinite(width) and width > 0 else max(map(abs, values))
    digits = int(np.clip(1 - np.floor(np.log10(size)), 0, 8)) if np.isfinite(size) and size > 0 else 3
    return tuple(f"{value:.{digits}f}" for value in values)


def _scaled(text: str, estimate: ParameterEstimate, factor: float) -> Reading:
    ends = sorted((factor * estimate.low, factor * estimate.high))
    return Reading(text, factor * estimate.value, *ends)


def _polar(
    x: ParameterEstimate, y: ParameterEstimate
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Length and direction (rad) of two parameters with their intervals, the two taken as independent."""
    length = float(np.hypot(x.value, y.value))
    spread_x, spread_y = 0.5 * (x.high - x.low), 0.5 * (y.high - y.low)
    angle = float(np.arctan2(y.value, x.value))
    c, s = np.cos(angle), np.sin(angle)
    along = float(np.hypot(c * spread_x, s * spread_y))
    across = float(np.hypot(s * spread_x, c * spread_y))
    turn = min(across / length, np.pi) if length > 0 else np.pi
    return (length, max(length - along, 0.0), length + along), (angle, angle - turn, angle + turn)


def _direction(text: str, angle: tuple[float, float, float], factor: float = 1.0) -> list[Reading]:
    """A direction in degrees; nothing where it might as well be the opposite one."""
    if angle[2] - angle[1] > np.pi:
        return []
    value, low, high = (float(np.degrees(factor * a)) for a in angle)
    return [Reading(text, value, low, high)]


def _tilt(p: Estimates, grid: CellGrid) -> list[Reading]:
    slope, angle = _polar(p["down_x"], p["down_y"])
    # The parameters are gravity's components as shares of it: the sine of the tilt.
    tilt = [float(np.degrees(np.arcsin(min(value, 1.0)))) for value in slope]
    return [Reading("tilt {}°", *tilt), *_direction("downhill towards {}°", angle)]


def _grain(where: str) -> Callable[[Estimates, CellGrid], list[Reading]]:
    def read(p: Estimates, grid: CellGrid) -> list[Reading]:
        rho, angle = _polar(p["along_x"], p["along_xy"])
        ratio = [(1 + r) / (1 - r) for r in (min(r, 0.99) for r in rho)]
        return [
            Reading("friction {} times as high", *ratio),
            *_direction(f"along {{}}° of {where} as across it", angle, 0.5),
        ]

    return read


def _viscous(p: Estimates, grid: CellGrid) -> list[Reading]:
    area = len(grid) * grid.width**2
    return [_scaled("drag {} N for each 100 mm/s of the whole object", p["drag_per_area"], 0.1 * area)]


def _stribeck(p: Estimates, grid: CellGrid) -> list[Reading]:
    return [
        _scaled("friction at rest {} % above that of fast sliding", p["excess"], 100.0),
        _scaled("most of it lost by {} mm/s", p["speed"], 1e3),
    ]


def _field(p: Estimates, grid: CellGrid) -> list[Reading]:
    gradient, angle = _polar(p["gradient_x"], p["gradient_y"])
    factor = [float(np.exp(value)) for value in (p["patch"].value, p["patch"].low, p["patch"].high)]
    readings = [
        Reading("friction rises by {} % each 100 mm", *(10.0 * value for value in gradient)),
        *_direction("towards {}°", angle),
        Reading("{} times as high on a round patch", *factor),
    ]
    if factor[1] < 1.0 < factor[2]:
        return readings
    return [
        *readings,
        _scaled("its middle at x {} mm", p["patch_x"], 1e3),
        _scaled("y {} mm", p["patch_y"], 1e3),
        _scaled("its radius {} mm", p["patch_radius"], 1e3),
    ]


def _tether(p: Estimates, grid: CellGrid) -> list[Reading]:
    return [
        _scaled("a pull of {} N for each 100 mm", p["stiffness"], 0.1),
        _scaled("towards x {} mm", p["anchor_x"], 1e3),
        _scaled("y {} mm", p["anchor_y"], 1e3),
        _scaled("beyond {} mm of slack", p["slack"], 1e3),
    ]


def _latency(p: Estimates, grid: CellGrid) -> list[Reading]:
    if p["latency"].value < 0:
        return [_scaled("the tracker is {} ms early", p["latency"], -1e3)]
    return [_scaled("the tracker is {} ms late", p["latency"], 1e3)]


def _drift(p: Estimates, grid: CellGrid) -> list[Reading]:
    return [_scaled("friction changes by {} % a push", p["rate"], 100.0)]


def _compliance(p: Estimates, grid: CellGrid) -> list[Reading]:
    return [_scaled("the tip gives {} mm for each newton", p["compliance"], 1e3)]


def _loose(p: Estimates, grid: CellGrid) -> list[Reading]:
    return [
        _scaled("{} % of the mass is loose", p["share"], 100.0),
        _scaled("swinging {} times a second", p["rate"], 0.5 / np.pi),
        _scaled("damping ratio {}", p["damping"], 1.0),
    ]


def _load(p: Estimates, grid: CellGrid) -> list[Reading]:
    return [
        _scaled("pushed {} mm above the table", p["push_height"], 1e3),
        _scaled("centre of mass {} mm above it", p["mass_height"], 1e3),
    ]


def _skate(p: Estimates, grid: CellGrid) -> list[Reading]:
    return [
        _scaled("sideways resistance {} % of the weight", p["resistance"], 100.0),
        _scaled("rolling along {}° of the object", p["angle"], 180.0 / np.pi),
        _scaled("at x {} mm", p["point_x"], 1e3),
        _scaled("y {} mm", p["point_y"], 1e3),
    ]


def _offset(p: Estimates, grid: CellGrid) -> list[Reading]:
    return [
        _scaled("the tracked frame sits {} mm along the object's x", p["x"], 1e3),
        _scaled("{} mm along its y", p["y"], 1e3),
        _scaled("turned by {}°", p["angle"], 180.0 / np.pi),
    ]


def _scale(p: Estimates, grid: CellGrid) -> list[Reading]:
    return [_scaled("reported lengths are {} % above true ones", p["excess"], 100.0)]


def _lean(p: Estimates, grid: CellGrid) -> list[Reading]:
    return [_scaled("friction leans {} % as far as in Bullet", p["share"], 100.0)]


READERS: dict[str, Callable[[Estimates, CellGrid], list[Reading]]] = {
    "table_tilt": _tilt,
    "anisotropic_table": _grain("the table"),
    "anisotropic_object": _grain("the object"),
    "viscous_friction": _viscous,
    "stribeck_friction": _stribeck,
    "table_friction_field": _field,
    "tether": _tether,
    "sensor_latency": _latency,
    "friction_drift": _drift,
    "finger_compliance": _compliance,
    "loose_mass": _loose,
    "load_transfer": _load,
    "impulse_friction": _lean,
    "skate": _skate,
    "tracker_offset": _offset,
    "tracker_scale": _scale,
}
"""Effects of the library, each with a way to say its size."""
