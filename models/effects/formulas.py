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

from models.effects.effect import Effect, EffectError
from models.effects.failures import call_formula
from models.effects.symbols import (
    CONSTANT_NAMES,
    FORCE_NAMES,
    INERTIA_NAMES,
    STATE_NAMES,
    Names,
    after_names,
    body_names,
    cell_names,
    real,
)

_HEADER = '''"""Formulas of effects, made by slipmap; safe to delete."""

import math

import numpy
from numba import cfunc, types

_P = types.CPointer(types.float64)
'''


class Slots:
    """Everything that some effects change, summed up, as SymPy expressions.

    Attributes:
        parameters: symbols of all parameters.
        memory: symbols of what is carried along; empty, or the last force and the effects' own.
        y: all that the formulas are differentiated by.
        body: the first entries of `effect_layout.BODY_OUTPUTS`, then four for each blade.
        factor: of a cell's friction.
        drag: of a cell.
        renewed: the effects' own memory after the step.
        measured: x, y, theta as reported, or None.
        delay: s, or None.
    """

    def __init__(self, effects: Sequence[Effect]) -> None:
        self.parameters = [real(f"p_{e.name}_{p.name}") for e in effects for p in e.parameters]
        own = [real(f"mem_{e.name}_{name}") for e in effects for name in e.memory]
        force = [real(name) for name in FORCE_NAMES]
        one, zero = sp.Integer(1), sp.Integer(0)
        wrench = [zero, zero, zero]
        stretch = [one, zero, one]
        inertia, compliance = one, zero
        self.factor, self.drag = one, zero
        self.renewed: list[Any] = []
        self.delay = zero
        pose = [real("pose_x"), real("pose_y"), real("pose_theta")]
        self.measured = list(pose)
        blades: list[Any] = []
        for e in effects:
            p = Names(f"effect {e.name}: p", {q.name: real(f"p_{e.name}_{q.name}") for q in e.parameters})
            memory = {name: real(f"mem_{e.name}_{name}") for name in e.memory}
            known = body_names(memory | dict(zip(FORCE_NAMES, force, strict=True)))
            body = Names(f"effect {e.name}: body", known)
            cell = Names(f"effect {e.name}: cell", cell_names(known))
            factor = self._ask(e, "friction", 1, cell, p)
            self.factor = self.factor * (factor[0] if factor else one)
            drag = self._ask(e, "drag", 1, cell, p)
            self.drag = self.drag + (drag[0] if drag else zero)
            shape = self._ask(e, "stretch", 3, body, p)
            if shape:
                stretch = [
                    total + value - base for total, value, base in zip(stretch, shape, (1, 0, 1), strict=True)
                ]
            push = self._ask(e, "force", 3, body, p)
            if push:
                cos, sin = known["cos"], known["sin"]
                turned = (cos * push[0] + sin * push[1], cos * push[1] - sin * push[0], push[2])
                wrench = [total + value for total, value in zip(wrench, turned, strict=True)]
            blade = self._ask(e, "blade", 5, body, p)
            if blade:
                strength, nx, ny, rx, ry = blade
                blades += [strength, nx, ny, rx * ny - ry * nx]
            share = self._ask(e, "inertia", 1, body, p)
            inertia = inertia * (share[0] if share else one)
            give = self._ask(e, "compliance", 1, body, p)
            compliance = compliance + (give[0] if give else zero)
            after = Names(f"effect {e.name}: after", after_names())
            renewed = self._ask(e, "remember", len(e.memory), body, after, p)
            if len(renewed or []) != len(e.memory):
                raise EffectError(
                    f"effect {e.name}: it has memory {e.memory} but no remember() that renews it"
                )
            self.renewed += renewed or []
            seen = self._ask(
                e, "measured", 3, Names("pose", dict(zip(("x", "y", "theta"), self.measured, strict=True))), p
            )
            self.measured = seen or self.measured
            late = self._ask(e, "delay", 1, p)
            self.delay = self.delay + (late[0] if late else zero)
        self.blades = len(blades) // 4
        self.body = [*wrench, *stretch, inertia, compliance, *blades]
        self.measures = self.measured != pose
        self.stretches = stretch != [one, zero, one]
        asked = {
            s for e in [*self.body, self.factor, self.drag, *self.renewed] for s in sp.sympify(e).free_symbols
        }
        needed = bool(self.renewed) or compliance != zero or bool(asked & set(force))
        self.memory = [*force, *own] if needed else []
        state = [real(name) for name in STATE_NAMES]
        self.y = [*state, *self.memory, *(real(name) for name in INERTIA_NAMES), *self.parameters]
        allowed = {*self.y, *(real(name) for name in CONSTANT_NAMES), *pose, real("r_x"), real("r_y")}
        allowed |= {real(f"after_{k}") for k in range(8)}
        strangers = {s for s in asked | sp.sympify(self.delay).free_symbols if s not in allowed}
        if strangers:
            names = ", ".join(e.name for e in effects)
            raise EffectError(
                f"effects {names}: the formula holds symbols that are neither its parameters nor given to"
                f" it: {', '.join(sorted(map(str, strangers)))}"
            )

    @staticmethod
    def _ask(effect: Effect, method: str, length: int, *arguments: Any) -> list[Any] | None:
        value = call_formula(effect, method, *arguments)
        if value is None:
            return None
        values = list(value) if isinstance(value, (tuple, list)) else [value]
        try:
            values = [sp.sympify(entry, strict=True) for entry in values]
        except sp.SympifyError as error:
            raise EffectError(
                f"effect {effect.name}: {method}() must return SymPy expressions: {error}"
            ) from error
        if len(values) != length:
            raise EffectError(
                f"effect {effect.name}: {method}() must return {length} expressions, got {len(values)}"
            )
        return values


def _derivative(expression: Any, symbol: sp.Symbol) -> Any:
    result = sp.diff(expression, symbol)
    return (
        result.rewrite(sp.Piecewise) if result.has(sp.Heaviside, sp.sign, sp.Abs, sp.DiracDelta) else result
    )


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
    return "\n".join(
        ["", "", f"@cfunc(types.void({kinds}), cache=True)", f"def {name}({arguments}):", *lines, ""]
    )


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
    printer = PythonCodePrinter({"fully_qualified_modules": True})
    Y = len(slots.y)
    targets = [(f"out[{k}] =", e) for k, e in enumerate(slots.body)]
    targets += [
        (f"dout[{k * Y + j}] =", d)
        for k, e in enumerate(slots.body)
        for j, symbol in enumerate(slots.y)
        if (d := _derivative(e, symbol)) != 0
    ]
    text = _HEADER + _function("body", "y, c, out, dout", [*_arguments(slots), *_straight(printer, targets)])

    cells = slots.factor != 1 or slots.drag != 0
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
    Y = len(slots.y)
    loop = {real("r_x"), real("r_y")}
    start = ["    for i in range(int(n)):", "        r_x = rx[i]", "        r_y = ry[i]"]
    targets = [("factor[i] =", slots.factor), ("drag[i] =", slots.drag)]
    before, within = _assignments(printer, targets, loop)
    text = _function("cells", "y, c, rx, ry, factor, drag", [*_arguments(slots), *before, *start, *within])

    targets = []
    for j, symbol in enumerate(slots.y):
        by_factor, by_drag = _derivative(slots.factor, symbol), _derivative(slots.drag, symbol)
        for a in range(3):
            value = sp.Symbol(f"gl{a}") * by_factor + sp.Symbol(f"gd{a}") * by_drag
            if value != 0:
                targets.append((f"G[{a * Y + j}] +=", value))
    before, within = _assignments(
        printer, targets, loop | {sp.Symbol(f"g{k}{a}") for k in "ld" for a in range(3)}
    )
    rows = [f"        g{k}{a} = g{k}[{a} * int(n) + i]" for k in "ld" for a in range(3)]
    text += _function(
        "cell_slopes", "y, c, rx, ry, gl, gd, G", [*_arguments(slots), *before, *start, *rows, *within]
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
        if (d := _derivative(e, symbol)) != 0
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
        (f"by_pose[..., {k}, {j}] =", _derivative(e, s))
        for k, e in enumerate(slots.measured)
        for j, s in enumerate(pose)
    ]
    targets += [
        (f"by_p[..., {k}, {j}] =", d)
        for k, e in enumerate(slots.measured)
        for j, s in enumerate(slots.parameters)
        if (d := _derivative(e, s)) != 0
    ]
    before, within = _assignments(printer, targets, set())
    lines += [*before, *(line[4:] for line in within), "    return out, by_pose, by_p"]
    lines += ["", "", "def delay(p):", *read, f"    slopes = numpy.zeros({P})"]
    for j, symbol in enumerate(slots.parameters):
        slope = _derivative(slots.delay, symbol)
        if slope != 0:
            lines.append(f"    slopes[{j}] = {printer.doprint(slope)}")
    lines.append(f"    return float({printer.doprint(slots.delay)}), slopes")
    return "\n".join([*lines, ""])
