"""Points at which a formula has no value: where what it divides by, or takes the logarithm of, vanishes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp

STARTS = 4
"""Random states from which each zero is searched."""

ZERO = 1e-10
"""A divisor so small, against its size elsewhere, is a zero."""

HUGE = 1e6
"""Times its size elsewhere; a value beyond is none."""

DIGITS = 6
"""Decimals of a zero; most zeros are where a state is nothing, or equal to a parameter."""

Values = dict[sp.Symbol, float]


def singular_point(
    outputs: Sequence[sp.Expr], states: Sequence[sp.Symbol], values: Values, rng: np.random.Generator
) -> Values | None:
    """A state at which some output is not finite because a divisor vanishes; None if none is found.

    Args:
        outputs: formulas.
        states: symbols that may have any value.
        values: of all symbols, states included; the others keep theirs. At these all outputs are finite.
        rng: of the states from which zeros are searched.
    """
    usual = 1.0 + max(abs(_value(entry, values)) for entry in outputs)
    moving = [state for state in states if str(state).startswith("v_")]
    for divisor in _divisors(outputs):
        users = [entry for entry in outputs if entry.has(divisor)]
        # First at rest: a place at which an object lies says more than one that it passes.
        at_rest = [state for state in moving if state in divisor.free_symbols]
        for still in [at_rest, []] if at_rest else [[]]:
            begin = {**values, **dict.fromkeys(still, 0.0)}
            free = [state for state in states if state in divisor.free_symbols and state not in still]
            others = {symbol: value for symbol, value in begin.items() if symbol not in free}
            function = sp.lambdify([free], divisor.subs(others), modules="math")
            for _ in range(STARTS):
                zero = _zero(function, rng.normal(scale=0.1, size=len(free)))
                if zero is None:
                    continue
                for place in (np.round(zero, DIGITS) + 0.0, zero):
                    at = {**begin, **dict(zip(free, map(float, place), strict=True))}
                    if not all(_is_value(entry, at, HUGE * usual) for entry in users):
                        return {state: round(at[state], DIGITS) + 0.0 for state in (*free, *still)}
    return None


def _divisors(outputs: Sequence[sp.Expr]) -> list[sp.Expr]:
    """What outputs divide by or take the logarithm of, unless it is always positive."""
    found = []
    for entry in outputs:
        for node in sp.preorder_traversal(entry):
            divides = isinstance(node, sp.Pow) and node.exp.is_negative
            if (divides or isinstance(node, sp.log)) and not node.args[0].is_positive:
                found.append(node.args[0])
    return list(dict.fromkeys(found))


def _zero(function, start: np.ndarray) -> np.ndarray | None:  # type: ignore[no-untyped-def]
    """Where a function of states vanishes, searched from `start`; None where it does not."""

    def size(place: np.ndarray) -> float:
        try:
            return abs(function(place))
        except (ArithmeticError, ValueError):
            return np.inf

    if len(start) == 0 or size(start) == 0.0:
        return start if size(start) == 0.0 else None
    from scipy.optimize import minimize  # needed for new formulas alone, and slow to import

    options = {"xatol": 1e-12, "fatol": 1e-24, "maxiter": 400 * len(start)}
    best = minimize(size, start, method="Nelder-Mead", options=options)
    return best.x if best.fun < ZERO * max(1.0, size(start)) else None


def _is_value(entry: sp.Expr, values: Values, largest: float) -> bool:
    try:
        return bool(abs(_value(entry, values)) < largest)
    except (ArithmeticError, ValueError, TypeError):
        return False


def _value(entry: sp.Expr, values: Values) -> float:
    symbols = sorted(entry.free_symbols, key=str)
    return float(sp.lambdify(symbols, entry, modules="math")(*(values[s] for s in symbols)))
