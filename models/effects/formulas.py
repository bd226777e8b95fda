"""Python source of the functions that the kernel calls, written from the effects' formulas.

All formulas become expressions of y and the constants (see `slipmap.models.physics.effect_cells`); common
subexpressions are taken out, those that do not depend on the cell in front of the loop over cells.

What the gradient of a step changes with is a sum over cells,

    G_aj = Σ_i Σ_c g_cai ∂e_c(b(y), r_i)/∂y_j ,

with the formulas e_c of a cell at r, and b all that they use and that is the same for every cell. Each
formula is cut into small assignments. The loop goes through them forwards, for their values and local
derivatives, and then backwards with the three rows of g, which gives Σ_i Σ_c g_cai ∂e_c/∂b_k; the chain by
∂b_k/∂y_j is left for after the loop. Going forwards with every y_j took three to five times the arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp
from sympy.printing.numpy import NumPyPrinter
from sympy.printing.pycode import PythonCodePrinter

from slipmap.models.effects.effect import Effect
from slipmap.models.effects.program import Slots
from slipmap.models.effects.symbols import CONSTANT_NAMES, real

# Derivatives of the cells' formulas: backwards through their common parts, in one loop over the cells.


ROWS = 3
"""Rows of g and G: the gradient by v_x, v_y, omega."""


@dataclass(frozen=True)
class BackwardLoop:
    """Code lines, not indented, of the loop and of what comes around it.

    Attributes:
        before: assigns b.
        within: for one cell; adds to the sums.
        after: adds to G from the sums.
        sums: names of the sums.
    """

    before: list[str]
    within: list[str]
    after: list[str]
    sums: list[str]


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
        y: symbols to differentiate by, in the order of G's columns.
        place: symbols that differ from cell to cell, r_x and r_y.
        derivative: of an expression by a symbol.
        printed: code of an expression.
    """
    # What stands in a case may have no value outside of it, and is computed there alone.
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
    """Piecewise parts of an expression that are not inside of another."""
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
    """Lines that compute the steps, and the derivatives of steps and formulas by what they are made of as far
    as that depends on what is wanted: for each, symbols and derivatives."""
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
    """Lines that go from the formulas, last of the symbols, back to the first step; and what flows into each
    symbol."""
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
    """Derivative of Σ_c g_ca e_c by a symbol.

    Attributes:
        formula: stem of the g of the only formula that depends on the symbol, or None where there are more.
        parts: that formula's derivative, to be multiplied by g_0, g_1, g_2; or the three rows.
    """

    formula: str | None
    parts: list[Any]

    def rows(self) -> list[Any]:
        """The three rows."""
        if self.formula is None:
            return self.parts
        return [self.parts[0] * sp.Symbol(f"{self.formula}{a}") for a in range(ROWS)]


def _together(flows: Sequence[_Flow]) -> _Flow:
    """The sum of flows; three rows only where it takes several formulas."""
    formulas = {flow.formula for flow in flows}
    if len(formulas) == 1 and None not in formulas:
        return _Flow(flows[0].formula, [sp.Add(*(flow.parts[0] for flow in flows))])
    return _Flow(None, [sp.Add(*row) for row in zip(*(flow.rows() for flow in flows), strict=True)])


class _Parts:
    """Formulas of a cell cut into small steps; what is the same for all cells has names of its own.

    Attributes:
        names: symbols under which the loop uses what is the same for all cells, and their values.
        steps: symbols that differ from cell to cell, and each in terms of earlier ones and of names.
    """

    def __init__(self, place: set[Any]) -> None:
        self.names: dict[Any, Any] = {}
        self.steps: list[tuple[Any, Any]] = []
        self._moving = place
        self._stands_for: dict[Any, Any] = {}
        self._symbols: dict[Any, Any] = {}

    def define(self, symbol: Any, expression: Any) -> None:
        """Let a symbol of later expressions stand for this one."""
        if self._moves(expression):
            self._stands_for[symbol] = self._symbol(self.small(expression))
        else:
            self._stands_for[symbol] = expression.xreplace(self._stands_for)

    def small(self, expression: Any) -> Any:
        """The expression as one operation on symbols, those of its parts being defined by steps."""
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
        # Cases stay whole: a condition is no number that a symbol could stand for.
        return expression.xreplace({symbol: self.small(symbol) for symbol in expression.free_symbols})

    def _operand(self, expression: Any, products: bool) -> Any:
        """A symbol or number for a small expression; products of symbols stay where they are, if wished."""
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
    """Lines that assign expressions to targets, their common parts first."""
    steps, reduced = sp.cse(
        [e for _, e in targets], symbols=sp.numbered_symbols(stem, real=True), order="none"
    )
    lines = [f"{symbol} = {printed(expression)}" for symbol, expression in steps]
    return lines + [f"{target} {printed(e)}" for (target, _), e in zip(targets, reduced, strict=True)]


_HEADER = '''"""Formulas of effects, made by slipmap; safe to delete."""

import functools
import math

import numpy
from numba import cfunc, types

_P = types.CPointer(types.float64)
'''

_FAST = ("arcp", "contract", "nsz", "reassoc")
"""What the compiler may do to sums and quotients, so that several cells are computed at once."""


class _Printer(PythonCodePrinter):
    """Writes powers so that the compiler computes those of several cells at once: fourth and eighth roots as
    square roots of square roots, negative powers as quotients."""

    def _print_Pow(self, expr: Any, rational: bool = False) -> str:
        exponent = expr.exp
        if exponent.is_Rational and exponent.is_negative and exponent != sp.Rational(-1, 2):
            return f"(1.0/({self._print(sp.Pow(expr.base, -exponent))}))"
        if exponent.is_Rational and exponent.q in (4, 8):
            root = self._print(expr.base)
            for _ in range(exponent.q.bit_length() - 1):
                root = f"math.sqrt({root})"
            return f"({root})**{exponent.p}"
        return str(super()._print_Pow(expr, rational))


def derivative(expression: Any, symbol: sp.Symbol) -> Any:
    """Derivative of a formula, jumps of absolute values and cases left out."""
    result = sp.diff(expression, symbol).replace(sp.DiracDelta, lambda *_: sp.Integer(0))
    return result.rewrite(sp.Piecewise) if result.has(sp.Heaviside, sp.sign, sp.Abs) else result


def _assignments(
    printer: Any, targets: Sequence[tuple[str, Any]], loop: set[sp.Symbol], indent: int = 4
) -> tuple[list[str], list[str]]:
    """Lines that assign expressions to targets: those in front of the loop over cells, and those in it."""
    kept = [(target, expression) for target, expression in targets]
    steps, reduced = sp.cse(
        [expression for _, expression in kept], symbols=sp.numbered_symbols("t"), order="none"
    )
    before: list[str] = []
    within: list[str] = []
    moving = set(loop)
    pad = " " * indent
    for symbol, expression in steps:
        if expression.free_symbols & moving:
            moving.add(symbol)
            within.append(f"{pad}    {symbol} = {printer.doprint(expression)}")
        else:
            before.append(f"{pad}{symbol} = {printer.doprint(expression)}")
    for (target, _), expression in zip(kept, reduced, strict=True):
        within.append(f"{pad}    {target} {printer.doprint(expression)}")
    return before, within


def _arguments(slots: Slots, after: bool = False) -> list[str]:
    lines = [f"    {symbol} = y[{k}]" for k, symbol in enumerate(slots.y)]
    lines += [f"    {name} = c[{k}]" for k, name in enumerate(CONSTANT_NAMES)]
    if after:
        lines += [f"    after_{k} = after[{k}]" for k in range(8)]
    return lines


def _function(name: str, arguments: str, lines: Sequence[str]) -> str:
    count = arguments.count(",") + 1
    kinds = ", ".join(["_P"] * count)
    fast = ", ".join(map(repr, _FAST))
    # Division by zero gives infinity, which the kernel notices; checks would be branches in the loop.
    decorator = f'@cfunc(types.void({kinds}), cache=True, error_model="numpy", fastmath={{{fast}}})'
    return "\n".join(["", "", decorator, f"def {name}({arguments}):", *lines, ""])


def _straight(printer: Any, targets: Sequence[tuple[str, Any]]) -> list[str]:
    """Lines that assign expressions to targets, where no loop is."""
    before, within = _assignments(printer, targets, set())
    return before + [line[4:] for line in within]


def module_source(effects: Sequence[Effect]) -> str:
    """Source of the module for some effects; its names are those that `slipmap.models.effects.program` loads.

    Functions that the kernel, by `SIZES`, does not call are left out: each takes a tenth of a second to
    compile.
    """
    slots = Slots(effects)
    printer = _Printer({"fully_qualified_modules": True})
    Y = len(slots.y)
    targets = [(f"out[{k}] =", e) for k, e in enumerate(slots.body)]
    targets += [
        (f"dout[{k * Y + j}] =", d)
        for k, e in enumerate(slots.body)
        for j, symbol in enumerate(slots.y)
        if (d := derivative(e, symbol)) != 0
    ]
    text = _HEADER + _function("body", "y, c, out, dout", [*_arguments(slots), *_straight(printer, targets)])

    cells = slots.factor != 1 or slots.drag != 0 or slots.stretches
    if cells:
        text += _cell_functions(slots, printer)
    if slots.renewed:
        text += _memory_function(slots, printer)
    text += _measurement(slots)
    sizes = (len(slots.memory), len(slots.parameters), slots.blades, int(cells), int(slots.stretches))
    text += f"\n\nSIZES = {sizes}\nMEASURES = {slots.measures}\nDELAYS = {slots.delay != 0}\n"
    return text


def _cell_functions(slots: Slots, printer: Any) -> str:
    """The functions `cells` and `cell_slopes`."""
    loop = {real("r_x"), real("r_y")}
    start = ["    for i in range(int(n)):", "        r_x = rx[i]", "        r_y = ry[i]"]
    targets = [("factor[i] =", slots.factor), ("drag[i] =", slots.drag)]
    if slots.stretches:
        targets += [(f"{name}[i] =", e) for name, e in zip(("qxx", "qxy", "qyy"), slots.stretch, strict=True)]
    before, within = _assignments(printer, targets, loop)
    text = _function(
        "cells", "y, c, rx, ry, factor, drag, qxx, qxy, qyy", [*_arguments(slots), *before, *start, *within]
    )

    # What a cell has that changes: the array of the gradient's derivatives by it, its place there.
    changed = [("gl", 0, slots.factor), ("gd", 0, slots.drag)]
    changed += [("gq", q, e) for q, e in enumerate(slots.stretch) if slots.stretches]
    changed = [entry for entry in changed if entry[2].free_symbols & {*slots.y}]
    code = backward_loop(
        [(f"{name}{place}", e) for name, place, e in changed],
        slots.y,
        (real("r_x"), real("r_y")),
        derivative,
        printer.doprint,
    )
    rows = [
        f"{name}{place}{a} = {name}[{3 * place + a} * int(n) + i]"
        for name, place, _ in changed
        for a in range(3)
    ]
    # Summed up in numbers of their own: what is stored within a loop, the compiler does not compute at once.
    around = [*code.before, *(f"{name} = 0.0" for name in code.sums)]
    text += _function(
        "cell_slopes",
        "y, c, rx, ry, gl, gd, gq, G",
        [
            *_arguments(slots),
            *(f"    {line}" for line in around),
            *start,
            *(f"        {line}" for line in [*rows, *code.within]),
            *(f"    {line}" for line in code.after),
        ],
    )
    return text


def _memory_function(slots: Slots, printer: Any) -> str:
    """The function `memory`."""
    width = len(slots.y) + 8
    inputs = [*slots.y, *(real(f"after_{k}") for k in range(8))]
    targets = [(f"own[{k}] =", e) for k, e in enumerate(slots.renewed)]
    targets += [
        (f"down[{k * width + j}] =", d)
        for k, e in enumerate(slots.renewed)
        for j, symbol in enumerate(inputs)
        if (d := derivative(e, symbol)) != 0
    ]
    return _function(
        "memory", "y, c, after, own, down", [*_arguments(slots, True), *_straight(printer, targets)]
    )


def _measurement(slots: Slots) -> str:
    """The functions `measured` and `delay`, for numpy."""
    printer = NumPyPrinter({"fully_qualified_modules": True})
    pose = [real("pose_x"), real("pose_y"), real("pose_theta")]
    read = [f"    {symbol} = p[{k}]" for k, symbol in enumerate(slots.parameters)]
    P = len(slots.parameters)
    lines = ["", "", "def measured(pose_x, pose_y, pose_theta, p):", *read]
    lines += [
        "    shape = numpy.shape(pose_x)",
        "    out = numpy.zeros((*shape, 3))",
        "    by_pose = numpy.zeros((*shape, 3, 3))",
        f"    by_p = numpy.zeros((*shape, 3, {P}))",
    ]
    targets = [(f"out[..., {k}] =", e) for k, e in enumerate(slots.measured)]
    targets += [
        (f"by_pose[..., {k}, {j}] =", derivative(e, s))
        for k, e in enumerate(slots.measured)
        for j, s in enumerate(pose)
    ]
    targets += [
        (f"by_p[..., {k}, {j}] =", d)
        for k, e in enumerate(slots.measured)
        for j, s in enumerate(slots.parameters)
        if (d := derivative(e, s)) != 0
    ]
    before, within = _assignments(printer, targets, set())
    lines += [*before, *(line[4:] for line in within), "    return out, by_pose, by_p"]
    lines += ["", "", "def delay(p):", *read, f"    slopes = numpy.zeros({P})"]
    for j, symbol in enumerate(slots.parameters):
        slope = derivative(slots.delay, symbol)
        if slope != 0:
            lines.append(f"    slopes[{j}] = {printer.doprint(slope)}")
    lines.append(f"    return float({printer.doprint(slots.delay)}), slopes")
    return "\n".join([*lines, ""])
