"""Checks of an effect before it is used: declared as it must be, nothing at its null, finite elsewhere."""

from __future__ import annotations

import math
import re

import numpy as np
import sympy as sp

from models.effects.effect import Effect, EffectError, Parameter
from models.effects.formulas import Slots
from models.effects.singular import singular_point
from models.effects.symbols import FORCE_NAMES

UNITS = re.compile(r"^(1|([a-zA-Z]+(\^-?\d+)?)([ /][a-zA-Z]+(\^-?\d+)?)*|1(/[a-zA-Z]+(\^\d+)?)+)$")
KNOWN_UNITS = {"m", "s", "kg", "N", "rad", "push", "J", "W", "Hz", "Pa"}
POINTS = 20
VANISHES = 1e-12
FIXED = {"m": 1.0, "J": 0.01, "gravity": 9.81, "h": 0.005, "width": 0.01, "n": 60.0}
"""Of an object and its cells, as in SI."""


def check_effect(effect: Effect, where: str) -> None:
    """Refuse an effect that is declared wrongly, does not vanish at its null, or is not finite.

    Args:
        effect: to check.
        where: file and line, for the message.

    Raises:
        EffectError: what is wrong and what to do.
    """

    def refuse(problem: str) -> None:
        raise EffectError(f"effect file {where}: {problem}")

    for attribute in ("name", "sentence", "parameters"):
        if not getattr(effect, attribute, None):
            refuse(f"class {type(effect).__name__} has no {attribute}")
    if not (isinstance(effect.name, str) and re.fullmatch(r"[a-z][a-z0-9_]*", effect.name)):
        refuse(f"name {effect.name!r} must be lower case letters, digits and underscores")
    for parameter in effect.parameters:
        if not isinstance(parameter, Parameter):
            refuse(f"parameters must be a tuple of Parameter, got {parameter!r}")
        problem = _faulty(parameter)
        if problem:
            refuse(f"parameter {parameter.name}: {problem}")
    if len({parameter.name for parameter in effect.parameters}) < len(effect.parameters):
        refuse("two parameters have one name")
    if not effect.amplitudes.any():
        refuse("no parameter has a null; give one a value at which the effect vanishes (null=0.0)")
    try:
        slots = Slots([effect])
    except EffectError as error:
        refuse(str(error))
    _check_values(effect, slots, refuse)


def _faulty(parameter: Parameter) -> str | None:
    """What is wrong with a parameter, or None."""
    if not (isinstance(parameter.name, str) and parameter.name.isidentifier()):
        return "its name must be a Python identifier"
    numbers = (parameter.low, parameter.high, parameter.scale, parameter.center)
    if not all(isinstance(value, (int, float)) and math.isfinite(value) for value in numbers):
        return f"low, high, scale, null and start must be finite numbers, got {numbers}"
    if not parameter.low < parameter.high:
        return f"low {parameter.low} must be below high {parameter.high}"
    if not parameter.scale > 0:
        return f"scale must be positive, got {parameter.scale}"
    if not parameter.low <= parameter.center <= parameter.high:
        return f"its null or start {parameter.center} must lie within {parameter.low} and {parameter.high}"
    unknown = set(re.findall(r"[a-zA-Z]+", parameter.unit)) - KNOWN_UNITS
    if not UNITS.fullmatch(parameter.unit) or unknown:
        return (
            f"unit {parameter.unit!r} is not SI as slipmap writes it: 1, m, s, N/m, rad/s, N s/m^3 …"
            f" from {', '.join(sorted(KNOWN_UNITS))}"
        )
    return None


def _check_values(effect: Effect, slots: Slots, refuse) -> None:  # type: ignore[no-untyped-def]
    """Evaluate the formulas at random states, with the effect at its null and at random parameters."""
    rng = np.random.default_rng(0)
    outputs = [*slots.body, slots.factor, slots.drag, slots.delay, *slots.measured]
    outputs = [sp.sympify(entry) for entry in outputs]
    plain = [0, 0, 0, 1, 0, 1, 1, 0, *[None] * (4 * slots.blades), 1, 0, 0, None, None, None]
    # A blade is nothing where its force is nothing, wherever it stands.
    for blade in range(slots.blades):
        plain[8 + 4 * blade] = 0
    symbols = sorted({s for entry in outputs for s in entry.free_symbols}, key=str)
    evaluate = sp.lambdify(symbols, outputs, modules="math")
    parameters = {f"p_{effect.name}_{p.name}": p for p in effect.parameters}
    own = {f"mem_{effect.name}_{name}" for name in effect.memory} | set(FORCE_NAMES)
    for trial in range(POINTS):
        null = trial % 2 == 0
        values = {}
        for symbol in symbols:
            parameter = parameters.get(str(symbol))
            if parameter is None:
                drawn = rng.normal(scale=0.1)
                values[symbol] = FIXED.get(str(symbol), 0.0 if null and str(symbol) in own else drawn)
            elif null and parameter.null is not None:
                values[symbol] = parameter.null
            else:
                drawn = parameter.center + parameter.scale * rng.normal()
                values[symbol] = float(np.clip(drawn, parameter.low, parameter.high))
        try:
            results = [float(value) for value in evaluate(*(values[symbol] for symbol in symbols))]
        except (ArithmeticError, ValueError, TypeError, NameError) as error:
            refuse(f"the formula cannot be evaluated: {type(error).__name__}: {error}; {_told(values)}")
        if not np.isfinite(results).all():
            refuse(f"the formula is not finite at {_told(values)}")
        if trial == 1:
            states = [symbol for symbol in symbols if str(symbol) not in {*parameters, *FIXED}]
            place = singular_point(outputs, states, values, rng)
            if place is not None:
                refuse(
                    f"the formula has no value at {_told(place)}: it divides by what is 0 there; keep"
                    " that away from 0, as in sqrt(x**2 + y**2 + 0.01**2)"
                )
        if not null:
            continue
        pose = [values.get(symbol, 0.0) for symbol in sp.symbols("pose_x pose_y pose_theta", real=True)]
        expected = [*plain[:-3], *pose]
        if not slots.measures:
            results, expected = results[:-3], expected[:-3]
        for value, wanted in zip(results, expected, strict=True):
            if wanted is not None and abs(value - wanted) > VANISHES * max(1.0, abs(wanted)):
                nulls = [f"{p.name} = {p.null}" for p in effect.parameters if p.null is not None]
                refuse(
                    f"the effect does not vanish when its parameters are at their nulls ({', '.join(nulls)}):"
                    f" it gives {value:.6g} instead of {wanted:g}"
                )


def _told(values: dict[sp.Symbol, float]) -> str:
    return ", ".join(f"{symbol} = {value:.3g}" for symbol, value in values.items())
