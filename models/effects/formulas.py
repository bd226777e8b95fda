"""Python source of the functions that the kernel calls, written from the effects' formulas.

All formulas become expressions of y and the constants (see `models.physics.effect_layout`); common
subexpressions are taken out, those that do not depend on the cell in front of the loop over cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy as sp
from sympy.printing.numpy import NumPyPrinter
from sympy.printing.pycode import PythonCodePrinter

from models.effects.backwards import backward_loop
from models.effects.effect import Effect
from models.effects.slots import Slots
from models.effects.symbols import CONSTANT_NAMES, real

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
    """Source of the module for some effects; its names are those that `models.effects.program` loads.

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
