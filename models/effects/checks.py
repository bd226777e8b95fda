"""Checks of an effect before it is used: declared as it must be, nothing at its null, finite elsewhere."""

from __future__ import annotations

import numpy as np
import sympy as sp

from models.effects.declaration import FORMULAS, check_declaration, check_starts
from models.effects.effect import Effect, EffectError
from models.effects.singular import singular_point
from models.effects.slots import Slots
from models.effects.symbols import FORCE_NAMES, memory_name, parameter_name
from models.physics.effect_layout import BODY_OUTPUTS

POINTS = 20
VANISHES = 1e-12
FIXED = {
    "m": 1.0, "J": 0.02, "s_x": 0.03, "s_y": -0.02, "gravity": 9.81, "h": 0.005, "width": 0.01, "n": 60.0,
    "c_x": 0.02, "c_y": -0.01, "g_xx": 300.0, "g_xy": 40.0, "g_yy": 500.0, "time": 0.4, "order": 2.0,
}  # fmt: skip
"""Of an object that could be, its cells and its push, as in SI."""


def check_effect(effect: Effect, where: str) -> None:
    """Refuse an effect that is declared wrongly, does not vanish at its null, or is not finite.

    Args:
        effect: to check.
        where: file, line and class, for the message.

    Raises:
        EffectError: what is wrong and what to do.
    """
    try:
        check_declaration(effect)
        slots = Slots([effect])
        _check_values(effect, slots)
        _check_slopes(effect, slots)
        _check_that_it_acts(effect, slots)
        check_starts(effect)
    except EffectError as error:
        raise EffectError(f"effect file {where}: {error}") from error


def _check_that_it_acts(effect: Effect, slots: Slots) -> None:
    """Refuse formulas, as those without a `return`, that are the same whatever the parameters are."""
    outputs = [*slots.body, *slots.cell, slots.delay, *slots.measured, *slots.renewed]
    within = {str(symbol) for output in outputs for symbol in sp.sympify(output).free_symbols}
    names = [p.name for p in effect.parameters if p.null is not None]
    if not within & {parameter_name(effect.name, name) for name in names}:
        written = [
            f"{name}()" for name in FORMULAS if getattr(type(effect), name) is not getattr(Effect, name)
        ]
        raise EffectError(
            f"what {' and '.join(written)} return does not depend on {' or '.join(names)}: a formula without"
            " `return` gives nothing (None), and one without a parameter is no effect"
        )


def _check_values(effect: Effect, slots: Slots) -> None:
    """Evaluate the formulas at random states, with the effect at its null and at random parameters."""
    rng = np.random.default_rng(0)
    outputs = [*slots.body, *slots.cell, slots.delay, *slots.measured]
    outputs = [sp.sympify(entry) for entry in outputs]
    plain = [0, 0, 0, 1, 0, *[None] * (4 * slots.blades), 1, 0, 1, 0, 1, 0, None, None, None]
    # A blade is nothing where its force is nothing, wherever it stands.
    for blade in range(slots.blades):
        plain[BODY_OUTPUTS + 4 * blade] = 0
    symbols = sorted({s for entry in outputs for s in entry.free_symbols}, key=str)
    evaluate = sp.lambdify(symbols, outputs, modules="math")
    parameters = {parameter_name(effect.name, p.name): p for p in effect.parameters}
    own = {memory_name(effect.name, name) for name in effect.memory} | set(FORCE_NAMES)
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
            raise EffectError(
                f"the formula cannot be evaluated: {type(error).__name__}: {error}; {_told(values)}"
            ) from error
        if not np.isfinite(results).all():
            raise EffectError(f"the formula is not finite at {_told(values)}")
        if trial == 1:
            states = [symbol for symbol in symbols if str(symbol) not in {*parameters, *FIXED}]
            place = singular_point(outputs, states, values, rng)
            if place is not None:
                raise EffectError(
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
                raise EffectError(
                    f"the effect does not vanish when its parameters are at their nulls ({', '.join(nulls)}):"
                    f" it gives {value:.6g} instead of {wanted:g}"
                )


def _check_slopes(effect: Effect, slots: Slots) -> None:
    """Refuse formulas without a finite derivative where an object lies still, as every push begins."""
    from models.effects.formulas import derivative

    rng = np.random.default_rng(1)
    parameters = {parameter_name(effect.name, p.name): p for p in effect.parameters}
    remembered = (memory_name(effect.name, name) for name in effect.memory)
    still = {"v_x", "v_y", "omega", *FORCE_NAMES, *remembered}
    outputs = [sp.sympify(entry) for entry in (*slots.body, *slots.cell, *slots.renewed)]
    values = {}
    for symbol in sorted({s for entry in outputs for s in entry.free_symbols} | {*slots.y}, key=str):
        drawn = rng.normal(scale=0.1)
        if (parameter := parameters.get(str(symbol))) is not None:
            low, high = parameter.low, parameter.high
            drawn = float(np.clip(parameter.center + parameter.scale * (0.5 + abs(drawn)), low, high))
        values[symbol] = 0.0 if str(symbol) in still else FIXED.get(str(symbol), drawn)
    symbols = list(values)
    at_rest = {symbol: 0.0 for symbol in symbols if str(symbol) in still}
    for symbol in slots.y:
        slopes = [derivative(entry, symbol) for entry in outputs]
        try:
            found = sp.lambdify(symbols, slopes, modules="math")(*values.values())
            finite = bool(np.isfinite([float(value) for value in found]).all())
        except (ArithmeticError, ValueError):
            finite = False
        except Exception as error:  # of SymPy, which cannot write every function as code
            raise EffectError(
                f"the formula's derivative by {symbol} cannot be computed: {type(error).__name__}:"
                f" {' '.join(str(error).split())[:200]}"
            ) from error
        if not finite:
            raise EffectError(
                f"the formula has no derivative where the object lies still ({_told(at_rest)}): keep what"
                " stands under a root away from 0, as in sqrt(vx**2 + vy**2 + 1e-4**2)"
            )


def _told(values: dict[sp.Symbol, float]) -> str:
    names = (str(symbol).removeprefix("p_").replace("_P_", ".") for symbol in values)
    return ", ".join(f"{name} = {value:.3g}" for name, value in zip(names, values.values(), strict=True))
