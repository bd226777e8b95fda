"""Reverse-mode derivatives of the cells' formulas, in one loop over the cells.

The derivative of a step's gradient is a sum over cells,

    G_aj = Σ_i Σ_c g_cai ∂e_c(b(y), r_i)/∂y_j ,

with the formulas e_c of a cell at r, and b the parts of them that are the same for every cell. Each formula
is cut into small assignments. The loop goes through them forwards, for their values and local derivatives,
and then backwards with the three rows of g, which gives Σ_i Σ_c g_cai ∂e_c/∂b_k. The factors ∂b_k/∂y_j
follow after the loop. Forward mode with every y_j took three to five times the arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp

_ROWS = 3  # of g and G: the gradient with respect to v_x, v_y, omega


@dataclass(frozen=True)
class BackwardLoop:
    """Code lines, not indented, of the loop and around it."""

    before: list[str]  # assigns b
    within: list[str]  # for one cell; adds to the sums
    after: list[str]  # adds to G from the sums
    sums: list[str]  # names of the sums


def backward_loop(
    formulas: Sequence[tuple[str, Any]],
    y: Sequence[Any],
    place: Sequence[Any],
    derivative: Callable[[Any, Any], Any],
    printed: Callable[[Any], str],
) -> BackwardLoop:
    """Write the loop for some formulas of a cell.

    Args:
        formulas: the stem of the names of g_c0, g_c1 and g_c2, and e_c.
        y: symbols to differentiate with respect to, in the order of G's columns.
        place: symbols that differ from cell to cell, r_x and r_y.
        derivative: derivative of an expression with respect to a symbol.
        printed: code of an expression.
    """
    # The body of a case may have no value outside it, so it is computed only there.
    cases = {c: sp.Dummy(real=True) for _, e in formulas for c in _outermost_cases(e)}
    steps, ends = sp.cse(
        [e.xreplace(cases) for _, e in formulas], symbols=sp.numbered_symbols("t", real=True), order="none"
    )
    parts = _Parts(set(place))
    for case, symbol in cases.items():
        parts.define(symbol, case)
    for symbol, expression in steps:
        parts.define(symbol, expression)
    last = [(sp.Symbol(stem), parts.small(e)) for (stem, _), e in zip(formulas, ends, strict=True)]
    slopes = {
        (name, j): slope
        for name, value in parts.names.items()
        for j, symbol in enumerate(y)
        if (slope := derivative(value, symbol)) != 0
    }
    wanted = {name for name, _ in slopes}

    forwards, partials = _forwards(parts.steps, last, wanted, derivative, printed)
    symbols = [symbol for symbol, _ in (*parts.steps, *last)]
    backwards, inflow = _backwards(symbols, len(parts.steps), partials, printed)
    totals = {
        sp.Symbol(f"sum_{name}_{a}"): (name, a, total)
        for name in parts.names
        if name in wanted and name in inflow
        for a, total in enumerate(_together(inflow[name]).rows())
    }
    columns = [
        (f"G[{a * len(y) + j}] +=", symbol * slopes[name, j])
        for symbol, (name, a, _) in totals.items()
        for j in range(len(y))
        if (name, j) in slopes
    ]
    return BackwardLoop(
        before=_straight_backwards([(f"{name} =", e) for name, e in parts.names.items()], "f", printed),
        within=[
            *forwards,
            *backwards,
            *(f"{symbol} += {printed(e)}" for symbol, (_, _, e) in totals.items()),
        ],
        after=_straight_backwards(columns, "z", printed),
        sums=[str(symbol) for symbol in totals],
    )


def _outermost_cases(expression: Any) -> list[Any]:
    """Piecewise parts of an expression that are not nested in another."""
    if isinstance(expression, sp.Piecewise):
        return [expression]
    return [case for argument in expression.args for case in _outermost_cases(argument)]


def _forwards(
    steps: Sequence[tuple[Any, Any]],
    last: Sequence[tuple[Any, Any]],
    wanted: set[Any],
    derivative: Callable[[Any, Any], Any],
    printed: Callable[[Any], str],
) -> tuple[list[str], list[list[tuple[Any, Any]]]]:
    """Lines that compute the steps and the local derivatives, and these derivatives.

    For each step and formula: the symbols in it that depend on what is wanted, and the derivatives with
    respect to them.
    """
    lines: list[str] = []
    partials: list[list[tuple[Any, Any]]] = []
    active = set(wanted)
    for number, (symbol, expression) in enumerate([*steps, *last]):
        by = sorted(expression.free_symbols & active, key=str)
        local = [derivative(expression, s) for s in by]
        named = [sp.Symbol(f"d{number}_{k}") if e.free_symbols else e for k, e in enumerate(local)]
        targets = [(f"{n} =", e) for n, e in zip(named, local, strict=True) if n is not e]
        if number < len(steps):
            targets.insert(0, (f"{symbol} =", expression))
            if by:
                active.add(symbol)
        lines += _straight_backwards(targets, f"w{number}_", printed)
        partials.append(list(zip(by, named, strict=True)))
    return lines, partials


def _backwards(
    symbols: Sequence[Any],
    formulas_from: int,
    partials: Sequence[list[tuple[Any, Any]]],
    printed: Callable[[Any], str],
) -> tuple[list[str], dict[Any, list[_Flow]]]:
    """Lines from the formulas, last of the symbols, back to the first step, and the flows into symbols."""
    lines: list[str] = []
    inflow: dict[Any, list[_Flow]] = {}
    for number in range(len(symbols) - 1, -1, -1):
        symbol = symbols[number]
        if number >= formulas_from:
            flow = _Flow(str(symbol), [sp.Integer(1)])
        elif symbol not in inflow:
            continue
        else:
            total = _together(inflow[symbol])
            names = [sp.Symbol(f"a{number}_{k}") for k in range(len(total.parts))]
            lines += [f"{name} = {printed(e)}" for name, e in zip(names, total.parts, strict=True)]
            flow = _Flow(total.formula, names)
        for s, partial in partials[number]:
            inflow.setdefault(s, []).append(_Flow(flow.formula, [partial * part for part in flow.parts]))
    return lines, inflow


@dataclass(frozen=True)
class _Flow:
    """Derivative of Σ_c g_ca e_c with respect to a symbol."""

    # stem of the g of the only formula that depends on the symbol, or None if several do
    formula: str | None
    parts: list[Any]  # that formula's derivative, to be multiplied by g_0, g_1, g_2; or the three rows

    def rows(self) -> list[Any]:
        """The three rows."""
        if self.formula is None:
            return self.parts
        return [self.parts[0] * sp.Symbol(f"{self.formula}{a}") for a in range(_ROWS)]


def _together(flows: Sequence[_Flow]) -> _Flow:
    """The sum of flows; it has three rows only if several formulas contribute."""
    formulas = {flow.formula for flow in flows}
    if len(formulas) == 1 and None not in formulas:
        return _Flow(flows[0].formula, [sp.Add(*(flow.parts[0] for flow in flows))])
    return _Flow(None, [sp.Add(*row) for row in zip(*(flow.rows() for flow in flows), strict=True)])


class _Parts:
    """Formulas of a cell cut into small steps; parts that are the same for all cells get names.

    Attributes:
        names: symbols of the parts that are the same for all cells, and their values.
        steps: symbols that differ from cell to cell, each in terms of earlier ones and of names.
    """

    def __init__(self, place: set[Any]) -> None:
        self.names: dict[Any, Any] = {}
        self.steps: list[tuple[Any, Any]] = []
        self._moving = place
        self._stands_for: dict[Any, Any] = {}
        self._symbols: dict[Any, Any] = {}

    def define(self, symbol: Any, expression: Any) -> None:
        """Let a symbol in later expressions stand for this one."""
        if self._moves(expression):
            self._stands_for[symbol] = self._symbol(self.small(expression))
        else:
            self._stands_for[symbol] = expression.xreplace(self._stands_for)

    def small(self, expression: Any) -> Any:
        """The expression as one operation on symbols; steps define the symbols of its parts."""
        if not self._moves(expression):
            return self._name(expression)
        if expression.is_Symbol:
            return self._stands_for.get(expression, expression)
        if expression.is_Add or expression.is_Mul:
            same = [a for a in expression.args if not a.is_number and not self._moves(a)]
            named = [self._name(expression.func(*same))] if same else []
            numbers = [a for a in expression.args if a.is_number]
            rest = [self.small(a) for a in expression.args if self._moves(a)]
            return expression.func(*numbers, *named, *(self._operand(e, expression.is_Add) for e in rest))
        if all(isinstance(a, sp.Expr) for a in expression.args):
            return expression.func(*(self._operand(self.small(a), False) for a in expression.args))
        # Cases stay whole: a condition is not a number, so no symbol can stand for it.
        return expression.xreplace({symbol: self.small(symbol) for symbol in expression.free_symbols})

    def _operand(self, expression: Any, products: bool) -> Any:
        """A symbol or number for a small expression; with `products`, products of symbols stay inline."""
        if products and expression.is_Mul and all(a.is_Symbol or a.is_number for a in expression.args):
            return expression
        return expression if expression.is_Symbol or expression.is_number else self._symbol(expression)

    def _symbol(self, expression: Any) -> Any:
        if expression.is_Symbol:
            return expression
        if expression not in self._symbols:
            symbol = self._symbols[expression] = sp.Symbol(f"s{len(self.steps)}", real=True)
            self._moving = self._moving | {symbol}
            self.steps.append((symbol, expression))
        return self._symbols[expression]

    def _moves(self, expression: Any) -> bool:
        return any(
            symbol in self._moving or self._stands_for.get(symbol) in self._moving
            for symbol in expression.free_symbols
        )

    def _name(self, expression: Any) -> Any:
        value = expression.xreplace(self._stands_for)
        if value.is_number:
            return value
        if value not in self._symbols:
            self._symbols[value] = sp.Symbol(f"b{len(self.names)}", real=True)
            self.names[self._symbols[value]] = value
        return self._symbols[value]


def _straight_backwards(
    targets: Sequence[tuple[str, Any]], stem: str, printed: Callable[[Any], str]
) -> list[str]:
    """Lines that assign expressions to targets, after their common parts."""
    steps, reduced = sp.cse(
        [e for _, e in targets], symbols=sp.numbered_symbols(stem, real=True), order="none"
    )
    lines = [f"{symbol} = {printed(expression)}" for symbol, expression in steps]
    return lines + [f"{target} {printed(e)}" for (target, _), e in zip(targets, reduced, strict=True)]
