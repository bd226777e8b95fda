"""Checks of an effect before use: correctly declared, vanishing at its null, finite elsewhere."""

import difflib
import inspect
import math
import re
from collections.abc import Sequence
from numbers import Real

import numpy as np
import sympy as sp

from slipmap.models.effects.effect import Effect, EffectError, Parameter, Scene
from slipmap.models.effects.formulas import Slots, derivative
from slipmap.models.effects.symbols import (
    FORCE_NAMES,
    POSE_SYMBOLS,
    PUSH_SYMBOLS,
    body_names,
    cell_names,
    memory_name,
    parameter_name,
    real,
)
from slipmap.models.effects.written import QUANTITIES

Values = dict[sp.Symbol, float]

FORMULAS = tuple(QUANTITIES)

# Plausible recordings with different places, sizes and weights.
_SCENES = (
    Scene((0.0, 0.0), 0.12, 0.07, 0.05, 20, 5.0),
    Scene((0.6, -0.2), 0.3, 0.15, 0.1, 8, 20.0),
    Scene((-1.2, 1.0), 0.05, 0.03, 0.02, 3, 1.0),
)
# A plausible object, its cells and its push, in SI units.
_FIXED = {
    "m": 1.0, "J": 0.02, "s_x": 0.03, "s_y": -0.02, "gravity": 9.81, "h": 0.005, "width": 0.01, "n": 60.0,
    "c_x": 0.02, "c_y": -0.01, "g_xx": 300.0, "g_xy": 40.0, "g_yy": 500.0, "time": 0.4, "order": 2.0,
}  # fmt: skip


def check_effect(effect: Effect, where: str) -> None:
    """Refuse an effect that is declared wrongly, does not vanish at its null, or is not finite.

    Args:
        where: file, line and class, for the message.

    Raises:
        EffectError: says what is wrong and what to do.
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
    """Refuse formulas that do not depend on the parameters, such as those without a `return`."""
    names = [p.name for p in effect.parameters if p.null is not None]
    if _acts(effect, names, slots):
        return
    written = " and ".join(f"{name}()" for name in FORMULAS if _overrides(type(effect), name))
    if _acts(effect, names, Slots([effect], (real("downhill_x"), real("downhill_y")))):
        raise EffectError(
            f"what {written} return depends on {' or '.join(names)} only through downhill_x or downhill_y,"
            " which are zero where nothing else makes a slope: let the effect pull downhill too (`downhill`)"
        )
    raise EffectError(
        f"what {written} return does not depend on {' or '.join(names)}: a formula needs a `return`, and at"
        " least one parameter in it"
    )


def _acts(effect: Effect, names: Sequence[str], slots: Slots) -> bool:
    """Whether what the formulas return depends on one of the parameters."""
    outputs = [*slots.body, *slots.cell, *slots.reports, *slots.renewed]
    within = {str(symbol) for output in outputs for symbol in sp.sympify(output).free_symbols}
    return bool(within & {parameter_name(effect.name, name) for name in names})


def _check_values(effect: Effect, slots: Slots) -> None:
    """Evaluate the formulas at random states, with the effect at its null and at random parameters."""
    rng = np.random.default_rng(0)
    outputs = [sp.sympify(entry) for entry in (*slots.body, *slots.cell, *slots.reports)]
    _check_readable(outputs)
    symbols = sorted({s for entry in outputs for s in entry.free_symbols}, key=str)
    try:
        evaluate = sp.lambdify(symbols, outputs, modules="math")
    except Exception as error:  # SymPy cannot write every function as code
        raise EffectError(
            f"the formula cannot be written as code: {type(error).__name__}: {_shortened(error)}; build it"
            " from sums, products, powers, cases and functions such as sin and exp"
        ) from error
    parameters = {parameter_name(effect.name, p.name): p for p in effect.parameters}
    own = {memory_name(effect.name, name) for name in effect.memory} | set(FORCE_NAMES)
    for trial in range(20):
        null = trial % 2 == 0
        values = {}
        for symbol in symbols:
            parameter = parameters.get(str(symbol))
            if parameter is None:
                drawn = rng.normal(scale=0.1)
                values[symbol] = _FIXED.get(str(symbol), 0.0 if null and str(symbol) in own else drawn)
            elif null and parameter.null is not None:
                values[symbol] = parameter.null
            else:
                drawn = parameter.center + parameter.scale * rng.normal()
                values[symbol] = float(np.clip(drawn, parameter.low, parameter.high))
        try:
            results = [float(value) for value in evaluate(*(values[symbol] for symbol in symbols))]
        except (ArithmeticError, ValueError, TypeError, NameError) as error:
            raise EffectError(
                f"the formula cannot be evaluated: {type(error).__name__}: {error}; {_listed(values)}"
            ) from error
        if not np.isfinite(results).all():
            raise EffectError(f"the formula is not finite at {_listed(values)}")
        if trial == 1:
            states = [symbol for symbol in symbols if str(symbol) not in {*parameters, *_FIXED}]
            place = _singular_point(outputs, states, values, rng)
            if place is not None:
                raise EffectError(
                    f"the formula has no value at {_listed(place)}: a divisor is 0 there; keep it away from"
                    " 0, as in sqrt(x**2 + y**2 + 0.01**2)"
                )
        if null:
            true = [values.get(real(name), 0.0) for name in (*POSE_SYMBOLS, *PUSH_SYMBOLS)]
            _check_vanished(effect, results, slots, true[:3], true[3:])


def _check_readable(outputs: Sequence[sp.Expr]) -> None:
    """Refuse complex numbers, and cases that leave some values out."""
    for entry in outputs:
        if entry.has(sp.I):
            raise EffectError("the formula contains the imaginary unit I; it must give real numbers")
        for cases in entry.atoms(sp.Piecewise):
            if sp.Or(*(condition for _, condition in cases.args)) != sp.true:
                raise EffectError(
                    f"the cases of {_shortened(cases)} leave out some values: end it with one for all others,"
                    " as in Piecewise((1, body.x > 0), (0, True))"
                )


def _shortened(what: object) -> str:
    return str(what).strip().partition("\n")[0][:200]


def _check_vanished(
    effect: Effect, results: Sequence[float], slots: Slots, pose: Sequence[float], push: Sequence[float]
) -> None:
    """Refuse values at the null that differ from the plain model's, in the order of `_check_values`."""
    # A blade without force vanishes, wherever it is.
    blade, pyramid = (0, None, None, None), (1, 0, None, None)
    wrench, cell = (0, 0, 0), (1, 0, 1, 0, 1)
    inertia, compliance, delay = 1, 0, 0
    plain = (
        *wrench, inertia, compliance, *(slots.blades * blade), *(slots.pyramids * pyramid), *cell, *pose,
        delay, *push, delay,
    )  # fmt: skip
    for value, wanted in zip(results, plain, strict=True):
        if wanted is not None and abs(value - wanted) > 1e-12 * max(1.0, abs(wanted)):
            nulls = [f"{p.name} = {p.null}" for p in effect.parameters if p.null is not None]
            raise EffectError(
                f"the effect does not vanish when its parameters are at their nulls ({', '.join(nulls)}):"
                f" it gives {value:.6g} instead of {wanted:g}"
            )


def _check_slopes(effect: Effect, slots: Slots) -> None:
    """Refuse formulas without a finite derivative at rest, where every push begins."""
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
        values[symbol] = 0.0 if str(symbol) in still else _FIXED.get(str(symbol), drawn)
    symbols = list(values)
    at_rest = {symbol: 0.0 for symbol in symbols if str(symbol) in still}
    for symbol in slots.y:
        slopes = [derivative(entry, symbol) for entry in outputs]
        try:
            found = sp.lambdify(symbols, slopes, modules="math")(*values.values())
            finite = bool(np.isfinite([float(value) for value in found]).all())
        except (ArithmeticError, ValueError):
            finite = False
        except Exception as error:  # SymPy cannot write every function as code
            raise EffectError(
                f"the formula's derivative with respect to {symbol} cannot be computed:"
                f" {type(error).__name__}: {_shortened(error)}"
            ) from error
        if not finite:
            raise EffectError(
                f"the formula has no finite derivative at rest ({_listed(at_rest)}): keep the argument of a"
                " square root away from 0, as in sqrt(vx**2 + vy**2 + 1e-4**2)"
            )


def check_declaration(effect: Effect) -> None:
    """Refuse an effect whose class is declared wrongly.

    Raises:
        EffectError: says what is wrong and what to do.
    """
    _check_methods(type(effect))
    for attribute in ("name", "sentence", "parameters"):
        if not getattr(effect, attribute, None):
            raise EffectError(f"it has no {attribute}")
    if not (isinstance(effect.name, str) and re.fullmatch(r"[a-z][a-z0-9_]*", effect.name)):
        raise EffectError(
            f"name {effect.name!r} must be lower-case letters, digits and underscores, a letter first"
        )
    if not isinstance(effect.sentence, str):
        raise EffectError(f"sentence must be text, got {effect.sentence!r}")
    memory = effect.memory
    if not (
        isinstance(memory, tuple | list) and all(isinstance(n, str) and n.isidentifier() for n in memory)
    ):
        raise EffectError(f'memory must be a tuple of names, such as ("lag_x", "lag_y"), got {memory!r}')
    taken = [name for name in effect.memory if name in cell_names(body_names({})) or name in FORCE_NAMES]
    if taken or len(set(effect.memory)) < len(effect.memory):
        raise EffectError(
            f"memory {effect.memory}: each name must occur once, and not be one that body or cell has"
        )
    if not isinstance(effect.parameters, tuple | list):
        raise EffectError(f"parameters must be a tuple of Parameter, got {effect.parameters!r}")
    for parameter in effect.parameters:
        if not isinstance(parameter, Parameter):
            raise EffectError(f"parameters must be a tuple of Parameter, got {parameter!r}")
        problem = _faulty(parameter)
        if problem:
            raise EffectError(f"parameter {parameter.name}: {problem}")
    if len({parameter.name for parameter in effect.parameters}) < len(effect.parameters):
        raise EffectError("two parameters have the same name")
    if not effect.amplitudes.any():
        raise EffectError("no parameter has a null; give one a value at which the effect vanishes (null=0.0)")


def check_starts(effect: Effect) -> None:
    """Refuse guesses that fail, are not numbers, or always leave their parameter's range.

    Raises:
        EffectError: says what is wrong and what to do.
    """
    given = [effect.guesses(scene) for scene in _SCENES]
    for parameter in effect.parameters:
        values = [[guess.get(parameter.name, parameter.center) for guess in scene] for scene in given]
        # Guessed places follow the pushes, and a range may be meant for one table: only a guess that is out
        # of range in every scene is wrong.
        if all(any(not parameter.low <= v <= parameter.high for v in scene) for scene in values):
            beyond = next(v for v in values[0] if not parameter.low <= v <= parameter.high)
            raise EffectError(
                f"starts() gives {parameter.name} = {beyond:g}; it must lie between {parameter.low:g} and"
                f" {parameter.high:g}"
            )


def _check_methods(kind: type[Effect]) -> None:
    own = {name: value for base in kind.__mro__ if base is not Effect for name, value in vars(base).items()}
    for name, value in own.items():
        if name.startswith("_") or not inspect.isroutine(value) or hasattr(Effect, name):
            continue
        methods = (*FORMULAS, "remember", "starts", "far_starts")
        near = difflib.get_close_matches(name, methods, n=1)
        hint = f"did you mean {near[0]}()?" if near else f"there are {', '.join(methods)}."
        raise EffectError(
            f"{name}() is not a method of an effect; {hint} Begin a helper's name with an underscore"
        )
    if not any(_overrides(kind, name) for name in FORMULAS):
        raise EffectError(f"it has no formula; write one or more of {', '.join(FORMULAS)}")


def _overrides(kind: type[Effect], method: str) -> bool:
    return getattr(kind, method) is not getattr(Effect, method)


def _faulty(parameter: Parameter) -> str | None:
    """What is wrong with a parameter, or None."""
    if not (isinstance(parameter.name, str) and parameter.name.isidentifier()):
        return "its name must be a Python identifier"
    for attribute in ("unit", "meaning"):
        text = getattr(parameter, attribute)
        if not isinstance(text, str):
            return f"{attribute} must be text, got {text!r}"
    low, high = parameter.low, parameter.high
    numbers = (low, high, parameter.scale, parameter.center, parameter.start, parameter.weight_power)
    if not all(isinstance(value, Real) and math.isfinite(value) for value in numbers):
        return f"low, high, scale, null, start and weight_power must be finite numbers, got {numbers}"
    if not low < high:
        return f"low {low} must be below high {high}"
    if not parameter.scale > 0:
        return f"scale must be positive, got {parameter.scale}"
    if not low <= parameter.center <= high:
        return f"its null or start {parameter.center} must lie between {low} and {high}"
    # The default start is 0. A start beside a null has no use, but one out of range is likely a mistake.
    if parameter.start != 0 and not low <= parameter.start <= high:
        return f"its start {parameter.start} must lie between {low} and {high}"
    unknown = set(re.findall(r"[a-zA-Z]+", parameter.unit)) - _KNOWN_UNITS
    if not _UNITS.fullmatch(parameter.unit) or unknown:
        return (
            f"unit {parameter.unit!r} is not SI as slipmap writes it, such as 1, m, s, N/m, rad/s, N s/m^3;"
            f" build it from {', '.join(sorted(_KNOWN_UNITS))}"
        )
    return None


_UNITS = re.compile(r"^(1|([a-zA-Z]+(\^-?\d+)?)([ /][a-zA-Z]+(\^-?\d+)?)*|1(/[a-zA-Z]+(\^\d+)?)+)$")
_KNOWN_UNITS = {"m", "s", "kg", "N", "rad", "push", "J", "W", "Hz", "Pa"}


_STARTS = 4  # random states from which each zero is searched
_ZERO = 1e-10  # a divisor that is smaller relative to its size elsewhere counts as zero
_HUGE = 1e6  # a value this many times larger than elsewhere counts as none
_DIGITS = 6  # decimals of a zero; at most zeros a state is 0 or equals a parameter


def _singular_point(
    outputs: Sequence[sp.Expr], states: Sequence[sp.Symbol], values: Values, rng: np.random.Generator
) -> Values | None:
    """A state at which some output is not finite because a divisor vanishes; None if none is found.

    Args:
        outputs: formulas.
        states: symbols that may take any value.
        values: of all symbols including states, at which all outputs are finite; the others keep theirs.
        rng: draws the states from which zeros are searched.
    """
    usual = 1.0 + max(abs(_value(entry, values)) for entry in outputs)
    moving = [state for state in states if str(state).startswith("v_")]
    for divisor in _divisors(outputs):
        users = [entry for entry in outputs if entry.has(divisor)]
        # Search at rest first: a place where an object rests tells the user more than one that it passes.
        at_rest = [state for state in moving if state in divisor.free_symbols]
        for still in [at_rest, []] if at_rest else [[]]:
            begin = {**values, **dict.fromkeys(still, 0.0)}
            free = [state for state in states if state in divisor.free_symbols and state not in still]
            others = {symbol: value for symbol, value in begin.items() if symbol not in free}
            function = sp.lambdify([free], divisor.subs(others), modules="math")
            for _ in range(_STARTS):
                zero = _zero(function, rng.normal(scale=0.1, size=len(free)))
                if zero is None:
                    continue
                for place in (np.round(zero, _DIGITS) + 0.0, zero):
                    at = {**begin, **dict(zip(free, map(float, place), strict=True))}
                    if not all(_is_value(entry, at, _HUGE * usual) for entry in users):
                        return {state: round(at[state], _DIGITS) + 0.0 for state in (*free, *still)}
    return None


def _divisors(outputs: Sequence[sp.Expr]) -> list[sp.Expr]:
    """Arguments of quotients and logarithms in the outputs, unless always positive."""
    found = []
    for entry in outputs:
        for node in sp.preorder_traversal(entry):
            divides = isinstance(node, sp.Pow) and node.exp.is_negative
            if (divides or isinstance(node, sp.log)) and not node.args[0].is_positive:
                found.append(node.args[0])
    return list(dict.fromkeys(found))


def _zero(function, start: np.ndarray) -> np.ndarray | None:  # type: ignore[no-untyped-def]
    """States at which a function vanishes, searched from `start`; None if none is found."""

    def size(place: np.ndarray) -> float:
        try:
            return abs(function(place))
        except (ArithmeticError, ValueError):
            return np.inf

    if len(start) == 0 or size(start) == 0.0:
        return start if size(start) == 0.0 else None
    from scipy.optimize import minimize  # needed only for new formulas, and slow to import

    options = {"xatol": 1e-12, "fatol": 1e-24, "maxiter": 400 * len(start)}
    best = minimize(size, start, method="Nelder-Mead", options=options)
    return best.x if best.fun < _ZERO * max(1.0, size(start)) else None


def _is_value(entry: sp.Expr, values: Values, largest: float) -> bool:
    try:
        return bool(abs(_value(entry, values)) < largest)
    except (ArithmeticError, ValueError, TypeError):
        return False


def _value(entry: sp.Expr, values: Values) -> float:
    symbols = sorted(entry.free_symbols, key=str)
    return float(sp.lambdify(symbols, entry, modules="math")(*(values[s] for s in symbols)))


def _listed(values: dict[sp.Symbol, float]) -> str:
    names = (str(symbol).removeprefix("p_").replace("_P_", ".") for symbol in values)
    return ", ".join(f"{name} = {value:.3g}" for name, value in zip(names, values.values(), strict=True))
