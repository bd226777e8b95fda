"""Sizes of effects in everyday terms: a tilt in degrees and its direction instead of two slopes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from slipmap.models.effects.effect import Effect, Parameter
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.diagnosis.results import ParameterEstimate
from slipmap.models.inference.summaries import decimals, interval
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import CellGrid

Estimates = Mapping[str, ParameterEstimate]


@dataclass(frozen=True)
class Reading:
    """One number of interest with its 90 % interval, in the unit of its text."""

    text: str  # with `{}` where the number goes, such as `tilt {}°`
    value: float
    low: float
    high: float

    def said(self) -> str:
        """The reading with its number and interval."""
        _, low, high = shown_numbers(self.value, self.low, self.high)
        return f"{self.value_said()} ({low} to {high})"

    def value_said(self) -> str:
        """The reading with its number alone."""
        return self.text.format(shown_numbers(self.value, self.low, self.high)[0])


Reader = Callable[[Estimates, CellGrid], list[Reading]]


def effect_in_words(name: str, estimates: Sequence[ParameterEstimate], grid: CellGrid) -> str:
    """The size of an effect in one line; its plain parameters where there are no better words.

    Args:
        grid: the object's, whose size some effects depend on.
    """
    return ", ".join(reading.said() for reading in _readings(name, estimates, grid))


def effect_of_belief(name: str, belief: Belief) -> list[str]:
    """The numbers of an effect, each in words: medians over hypotheses that have it, without intervals."""
    (effect,) = (effect for effect in belief.effects if effect.name == name)
    carried, probability = belief.parameters_of(name)
    own = [
        ParameterEstimate(name, parameter.name, parameter.unit, *interval(values, probability))
        for parameter, values in zip(effect.parameters, carried.T, strict=True)
    ]
    return [reading.value_said() for reading in _readings(name, own, belief.grid)]


def _readings(name: str, estimates: Sequence[ParameterEstimate], grid: CellGrid) -> list[Reading]:
    reader = READERS.get(name)
    if reader is None or not estimates:
        return [Reading(f"{e.name} {{}}{unit_text(e.unit)}", e.value, e.low, e.high) for e in estimates]
    return reader({e.name: e for e in estimates}, grid)


def in_the_middle(name: str, estimates: Sequence[ParameterEstimate], datasets: Sequence[PushDataset]) -> str:
    """Clause on how far a turned tracker is off in the middle of the pushes; empty for other effects.

    Its parameters hold at the world's origin, which may be far from the pushes.
    """
    p = {e.name: e for e in estimates}
    if name != "tracker_shift" or p["angle"].low <= 0.0 <= p["angle"].high:
        return ""
    poses = np.concatenate([t.object_pose.values[:, :2] for one in datasets for t in one.trials])
    x, y = middle = np.nanmean(poses, axis=0)
    c, s = np.cos(p["angle"].value), np.sin(p["angle"].value)
    off = np.array([c * x - s * y + p["x"].value, s * x + c * y + p["y"].value]) - middle
    at, shift = 1e3 * middle, 1e3 * off
    return (
        f"; in the middle of the pushes (x {at[0]:.0f} mm, y {at[1]:.0f} mm), poses lie {shift[0]:.2f} mm,"
        f" {shift[1]:.2f} mm (x, y) off"
    )


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
    """Whether a value lies at a nonzero end of its range, which only bounds the search."""
    near = 0.01 * (parameter.high - parameter.low)
    ends = [end for end in (parameter.low, parameter.high) if end != 0.0]
    return any(abs(value - end) < near for end in ends)


def unit_text(unit: str) -> str:
    """The unit after a number; nothing where there is none."""
    return "" if unit == "1" else f" {unit}"


def shown_numbers(*values: float) -> tuple[str, ...]:
    """Numbers whose last two are an interval, rounded to two figures of its width."""
    width = abs(values[-1] - values[-2])
    size = width if np.isfinite(width) and width > 0 else max(map(abs, values))
    return tuple(f"{value:.{decimals(size)}f}" for value in values)


def _scaled(text: str, estimate: ParameterEstimate, factor: float) -> Reading:
    ends = sorted((factor * estimate.low, factor * estimate.high))
    return Reading(text, factor * estimate.value, *ends)


def _polar(
    x: ParameterEstimate, y: ParameterEstimate
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Length and direction (rad) of two parameters, treated as independent, with their intervals.

    Where both intervals contain zero, so does that of the length: what is said of an effect must not exclude
    what its parameters leave open.
    """
    length = float(np.hypot(x.value, y.value))
    spread_x, spread_y = 0.5 * (x.high - x.low), 0.5 * (y.high - y.low)
    angle = float(np.arctan2(y.value, x.value))
    c, s = np.cos(angle), np.sin(angle)
    along = float(np.hypot(c * spread_x, s * spread_y))
    across = float(np.hypot(s * spread_x, c * spread_y))
    turn = min(across / length, np.pi) if length > 0 else np.pi
    shortest = 0.0 if all(p.low <= 0.0 <= p.high for p in (x, y)) else max(length - along, 0.0)
    return (length, shortest, length + along), (angle, angle - turn, angle + turn)


def _direction(text: str, angle: tuple[float, float, float], factor: float = 1.0) -> list[Reading]:
    """A direction in degrees; nothing where its interval exceeds half a turn."""
    if angle[2] - angle[1] > np.pi:
        return []
    value, low, high = (float(np.degrees(factor * a)) for a in angle)
    return [Reading(text, value, low, high)]


def _tilt(p: Estimates, grid: CellGrid) -> list[Reading]:
    slope, angle = _polar(p["down_x"], p["down_y"])
    # The parameters are gravity's components as shares of it: the sine of the tilt.
    tilt = [float(np.degrees(np.arcsin(min(value, 1.0)))) for value in slope]
    return [Reading("tilt {}°", *tilt), *_direction("downhill towards {}°", angle)]


def _grain(where: str) -> Reader:
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
    return [_scaled("a drag of {} N on the whole object per 100 mm/s", p["drag_per_area"], 0.1 * area)]


def _field(p: Estimates, grid: CellGrid) -> list[Reading]:
    gradient, angle = _polar(p["gradient_x"], p["gradient_y"])
    factor = [float(np.exp(value)) for value in (p["patch"].value, p["patch"].low, p["patch"].high)]
    readings = [
        Reading("friction rises by {} % per 100 mm", *(10.0 * value for value in gradient)),
        *_direction("towards {}°", angle),
        Reading("{} times as high on a round patch", *factor),
    ]
    if factor[1] < 1.0 < factor[2]:
        return readings
    return [
        *readings,
        _scaled("its centre at x {} mm", p["patch_x"], 1e3),
        _scaled("y {} mm", p["patch_y"], 1e3),
        _scaled("its radius {} mm", p["patch_radius"], 1e3),
    ]


def _late(what: str) -> Reader:
    def read(p: Estimates, grid: CellGrid) -> list[Reading]:
        early = p["latency"].value < 0
        return [
            _scaled(f"{what} is {{}} ms {'early' if early else 'late'}", p["latency"], -1e3 if early else 1e3)
        ]

    return read


def _shift(p: Estimates, grid: CellGrid) -> list[Reading]:
    return [
        _scaled("poses lie {} mm", p["x"], 1e3),
        _scaled("{} mm (x, y) off from where the finger's record puts them", p["y"], 1e3),
        _scaled("turned by {}° about the world's origin", p["angle"], 180.0 / np.pi),
        _scaled("or the finger's recorded point is off its centre by {} mm", p["x"], -1e3),
        _scaled("{} mm", p["y"], -1e3),
    ]


def _force_frame(p: Estimates, grid: CellGrid) -> list[Reading]:
    turned = _scaled("the reported force is turned by {}°", p["angle"], 180.0 / np.pi)
    if p["mirror"].value < 0.5:
        return [turned]
    mirrored = _scaled("the reported force is mirrored, y negated ({} of 1)", p["mirror"], 1.0)
    return [mirrored, _scaled("then turned by {}°", p["angle"], 180.0 / np.pi)]


def _each(*readings: tuple[str, str, float]) -> Reader:
    """Reads parameters one by one; each reading is a text, a parameter and a factor for it."""
    return lambda p, grid: [_scaled(text, p[name], factor) for text, name, factor in readings]


READERS: dict[str, Reader] = {
    "table_tilt": _tilt,
    "anisotropic_table": _grain("the table"),
    "anisotropic_object": _grain("the object"),
    "viscous_friction": _viscous,
    "stribeck_friction": _each(
        ("friction at rest {} % above that of fast sliding", "excess", 100.0),
        ("most of it gone by {} mm/s", "speed", 1e3),
    ),
    "table_friction_field": _field,
    "tether": _each(
        ("a pull of {} N per 100 mm", "stiffness", 0.1),
        ("towards x {} mm", "anchor_x", 1e3),
        ("y {} mm", "anchor_y", 1e3),
        ("beyond {} mm of slack", "slack", 1e3),
    ),
    "sensor_latency": _late("the tracker"),
    "friction_drift": _each(("friction changes by {} % per push", "rate", 100.0)),
    "finger_compliance": _each(("the tip gives {} mm per newton", "compliance", 1e3)),
    "loose_mass": _each(
        ("{} % of the mass is loose", "share", 100.0),
        ("oscillating at {} Hz", "rate", 0.5 / np.pi),
        ("damping ratio {}", "damping", 1.0),
    ),
    "load_transfer": _each(
        ("pushed {} mm above the table", "push_height", 1e3),
        ("centre of mass {} mm above it", "mass_height", 1e3),
    ),
    "impulse_friction": _each(("friction deviates {} % as much as in Bullet", "share", 100.0)),
    "friction_diamond": _each(("{} % of the way from a cone to a diamond", "share", 100.0)),
    "friction_square": _each(("{} % of the way from a cone to a square", "share", 100.0)),
    "slip_load": _each(("{} % of the load follows slip in a spin", "share", 100.0)),
    "torsional_friction": _each(("a torque of the weight times {} mm against every spin", "radius", 1e3)),
    "skate": _each(
        ("sideways resistance {} % of the weight", "resistance", 100.0),
        ("rolling along {}° of the object", "angle", 180.0 / np.pi),
        ("at x {} mm", "point_x", 1e3),
        ("y {} mm", "point_y", 1e3),
    ),
    "tracker_offset": _each(
        ("the tracked frame sits {} mm along the object's x", "x", 1e3),
        ("{} mm along its y", "y", 1e3),
        ("turned by {}°", "angle", 180.0 / np.pi),
    ),
    "tracker_scale": _each(("reported lengths are {} % above true ones", "excess", 100.0)),
    "tracker_shift": _shift,
    "force_frame": _force_frame,
    "force_bias": _each(("the sensor adds {} N along x", "x", 1.0), ("{} N along y", "y", 1.0)),
    "force_gains": _each(
        ("the force's gain along x is {} % above the mean, along y as much below", "excess", 100.0)
    ),
    "force_latency": _late("the force"),
}
"""Readers that put the size of each library effect into words."""
