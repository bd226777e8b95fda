"""Collects the formulas of effects, sums them up and writes them as source code that the kernels call.

All formulas become expressions of y and the constants (see `slipmap.models.physics.friction`). Common
subexpressions are factored out, and those that do not depend on the cell move out of the loop over cells.
"""

from collections.abc import Mapping, Sequence, Set
from functools import partial
from typing import Any

import sympy as sp
from sympy.printing.numpy import NumPyPrinter
from sympy.printing.pycode import PythonCodePrinter

from slipmap.models.effects.backward_loop import backward_loop
from slipmap.models.effects.effect import Effect, EffectError, call_formula
from slipmap.models.effects.symbols import (
    AFTER_SYMBOLS,
    CONSTANT_NAMES,
    FORCE_NAMES,
    INERTIA_NAMES,
    LEAN_NAMES,
    POSE_SYMBOLS,
    PUSH_SYMBOLS,
    STATE_NAMES,
    Names,
    after_names,
    body_names,
    cell_names,
    force_at_mass_center,
    memory_name,
    parameter_name,
    real,
)
from slipmap.models.physics.friction import FINGER_SETTLING


class Slots:
    """The combined changes of several effects, as SymPy expressions.

    Args:
        slope: (2,) acceleration by which gravity pulls along the table for effects besides these, world.

    Attributes:
        parameters: symbols of all parameters.
        memory: symbols carried from step to step: none, or the last force, the lean of a finger that bends,
            and the effects' own.
        y: symbols with respect to which the formulas are differentiated.
        body: the first entries of `friction.BODY_OUTPUTS`, then four for each blade, then those of pyramids.
        factor: of a cell's friction.
        drag: of a cell.
        stretch: q_xx, q_xy, q_yy of a cell.
        bends: whether the finger does.
        renewed: the memory after the step, without the force.
        measured: x, y, theta as reported.
        delay: s.
        felt: the finger's force as reported.
        force_delay: s.
    """

    def __init__(self, effects: Sequence[Effect], slope: Sequence[Any] = (0, 0)) -> None:
        one, zero = sp.Integer(1), sp.Integer(0)
        force = [real(name) for name in FORCE_NAMES]
        pose, push = [real(name) for name in POSE_SYMBOLS], [real(name) for name in PUSH_SYMBOLS]
        self.factor, self.drag, self.delay, self.force_delay = one, zero, zero, zero
        self.renewed: list[Any] = []
        self.measured, self.felt = list(pose), list(push)
        inertia, compliance = one, zero
        shapes: list[list[Any]] = []
        blades: list[Any] = []
        pyramids: list[list[Any]] = []
        cone: Any = one
        downhill = _downhill(effects, force)
        known = body_names({})
        pull = force_at_mass_center(Names("body", known), *(known["mass"] * part for part in downhill))
        wrench = [*_turned(known, *pull[:2]), pull[2]]
        downhill = [own + other for own, other in zip(downhill, slope, strict=True)]
        for e in effects:
            ask = partial(_ask, e)
            p, memory = _parameters(e), _memory(e)
            known = body_names(memory | dict(zip(FORCE_NAMES, force, strict=True)), downhill)
            body = Names(f"effect {e.name}: body", known)
            cell = Names(f"effect {e.name}: cell", cell_names(known))
            self.factor *= (ask("friction", 1, cell, p) or [one])[0]
            self.drag += (ask("drag", 1, cell, p) or [zero])[0]
            shapes += [shape] if (shape := ask("stretch", 3, cell, p)) else []
            fx, fy, torque = ask("force", 3, body, p) or [zero, zero, zero]
            added = (*_turned(known, fx, fy), torque)
            wrench = [total + value for total, value in zip(wrench, added, strict=True)]
            blade = ask("blade", 5, body, p)
            if blade:
                strength, nx, ny, rx, ry = blade
                blades += [strength, nx, ny, rx * ny - ry * nx]
            pyramid = ask("pyramid", 3, body, p)
            if pyramid:
                rest, edge, angle = pyramid
                cone *= rest
                pyramids = [[rest * entry[0], *entry[1:]] for entry in pyramids]
                pyramids.append([edge, *_turned(known, sp.cos(angle), sp.sin(angle))])
            inertia *= (ask("inertia", 1, body, p) or [one])[0]
            compliance += (ask("compliance", 1, body, p) or [zero])[0]
            after = Names(f"effect {e.name}: after", after_names())
            renewed = ask("remember", len(e.memory), body, after, p) or []
            if len(renewed) != len(e.memory):
                raise EffectError(
                    f"effect {e.name}: it has memory {e.memory} but no remember() that renews it"
                )
            self.renewed += renewed
            reported = Names("pose", dict(zip(("x", "y", "theta"), self.measured, strict=True)))
            self.measured = ask("measured", 3, reported, p) or self.measured
            self.delay += (ask("delay", 1, p) or [zero])[0]
            self.felt = (
                ask("felt", 2, Names("force", dict(zip("xy", self.felt, strict=True))), p) or self.felt
            )
            self.force_delay += (ask("force_delay", 1, p) or [zero])[0]
        self.bends = compliance != zero
        lean = [real(name) for name in LEAN_NAMES] if self.bends else []
        followed = map(real, AFTER_SYMBOLS[-2:])
        share = sp.Min(1, real("h") / FINGER_SETTLING)
        leant = [old + share * (new - old) for old, new in zip(lean, followed, strict=False)]
        self.renewed = [*leant, *self.renewed]
        self.blades, self.pyramids = len(blades) // 4, len(pyramids)
        edges = [cone, *(number for entry in pyramids for number in entry)] if pyramids else []
        self.body = [*wrench, inertia, compliance, *blades, *edges]
        self.stretch = [sp.sympify(entry) for entry in _combined(shapes)]
        self.measures, self.feels = self.measured != pose, self.felt != push
        self.stretches = self.stretch != [one, zero, one]
        formulas = [*self.body, *self.cell, *self.renewed, *self.reports]
        asked = {symbol for formula in formulas for symbol in sp.sympify(formula).free_symbols}
        needs_memory = bool(self.renewed) or bool(asked & set(force))
        remembered = [*lean, *(real(memory_name(e.name, name)) for e in effects for name in e.memory)]
        self.parameters = [real(parameter_name(e.name, p.name)) for e in effects for p in e.parameters]
        self.memory = [*force, *remembered] if needs_memory else []
        inertia_symbols = [real(name) for name in INERTIA_NAMES]
        self.y = [*(real(name) for name in STATE_NAMES), *self.memory, *inertia_symbols, *self.parameters]
        given, own = {*self.y, *slope, *map(real, CONSTANT_NAMES)}, {*self.parameters}
        # What the functions of the module know, see `module_source`.
        known_by = (
            (self.body, given),
            (self.cell, given | {real("r_x"), real("r_y")}),
            (self.renewed, given | {*map(real, AFTER_SYMBOLS)}),
            (self.measured, own | {*pose}),
            (self.felt, own | {*push}),
            ([self.delay, self.force_delay], own),
        )
        _refuse_strangers(effects, known_by)

    @property
    def cell(self) -> list[Any]:
        """Changes of a cell: factor, drag, stretch."""
        return [self.factor, self.drag, *self.stretch]

    @property
    def reports(self) -> list[Any]:
        """Reports of the sensors: pose and its delay, force and its delay."""
        return [*self.measured, self.delay, *self.felt, self.force_delay]


def _parameters(effect: Effect) -> Names:
    own = {q.name: real(parameter_name(effect.name, q.name)) for q in effect.parameters}
    return Names(f"effect {effect.name}: p", own)


def _memory(effect: Effect) -> dict[str, sp.Symbol]:
    return {name: real(memory_name(effect.name, name)) for name in effect.memory}


def _refuse_strangers(
    effects: Sequence[Effect], known_by: Sequence[tuple[Sequence[Any], Set[sp.Symbol]]]
) -> None:
    """Raise EffectError if formulas use other symbols than those that the function with them knows."""
    strangers = {
        symbol
        for formulas, symbols in known_by
        for formula in formulas
        for symbol in sp.sympify(formula).free_symbols - symbols
    }
    if strangers:
        names = ", ".join(e.name for e in effects)
        raise EffectError(
            f"effects {names}: the formula uses symbols that are neither its parameters nor given to"
            f" it: {', '.join(sorted(map(str, strangers)))}"
        )


def _downhill(effects: Sequence[Effect], force: Sequence[sp.Symbol]) -> list[Any]:
    """Sum over the effects of the acceleration by which gravity pulls along the table, world."""
    total = [sp.Integer(0), sp.Integer(0)]
    for e in effects:
        known = body_names(_memory(e) | dict(zip(FORCE_NAMES, force, strict=True)))
        body = Names(f"effect {e.name}: body", known)
        own = _ask(e, "downhill", 2, body, _parameters(e)) or total[:0]
        total = [before + part for before, part in zip(total, own, strict=True)] if own else total
    return total


def _combined(shapes: Sequence[Sequence[Any]]) -> Sequence[Any]:
    """q_xx, q_xy, q_yy of several stretches together: determinants multiply, traceless parts A add.

    With s² = det + |A|², Q = s 1 + A has the eigenvalues s ± |A|, so it is positive definite as each Q is,
    and to first order in the stretches it is 1 + Σ (Q - 1).
    """
    if len(shapes) < 2:
        return shapes[0] if shapes else (1, 0, 1)
    det = sp.prod(xx * yy - xy**2 for xx, xy, yy in shapes)
    along, across = sum((xx - yy) / 2 for xx, _, yy in shapes), sum(xy for _, xy, _ in shapes)
    middle = sp.sqrt(det + along**2 + across**2)
    return middle + along, across, middle - along


def _turned(known: Mapping[str, Any], x: Any, y: Any) -> tuple[Any, Any]:
    """A vector in the world as one in the object frame."""
    cos, sin = known["cos"], known["sin"]
    return cos * x + sin * y, cos * y - sin * x


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


_HEADER = '''"""Formulas of effects, made by slipmap; safe to delete."""

import functools
import math

import numpy

from slipmap.models.effects.machine_code import formula
'''


class _Printer(PythonCodePrinter):
    """Writes powers so that the compiler can vectorise them over cells.

    Fourth and eighth roots become nested square roots, negative powers become quotients.
    """

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
    """Derivative of a formula; jumps in absolute values and cases are ignored."""
    result = sp.diff(expression, symbol).replace(sp.DiracDelta, lambda *_: sp.Integer(0))
    return result.rewrite(sp.Piecewise) if result.has(sp.Heaviside, sp.sign, sp.Abs) else result


Targets = Sequence[tuple[str, Any]]  # left sides of assignments, and the expressions assigned to them


def _slopes(place: str, expressions: Sequence[Any], symbols: Sequence[Any]) -> list[tuple[str, Any]]:
    """Targets for the nonzero derivatives; `place` names row k and column j, or `at` if stored flat."""
    return [
        (f"{place.format(k=k, j=j, at=k * len(symbols) + j)} =", slope)
        for k, expression in enumerate(expressions)
        for j, symbol in enumerate(symbols)
        if (slope := derivative(expression, symbol)) != 0
    ]


def _assignments(printer: Any, targets: Targets, loop: set[sp.Symbol]) -> tuple[list[str], list[str]]:
    """Lines that assign expressions to targets: those before the loop over cells, and those inside it."""
    steps, reduced = sp.cse([e for _, e in targets], symbols=sp.numbered_symbols("t"), order="none")
    before: list[str] = []
    within: list[str] = []
    moving = set(loop)
    for symbol, expression in steps:
        line = f"    {symbol} = {printer.doprint(expression)}"
        if expression.free_symbols & moving:
            moving.add(symbol)
            within.append(f"    {line}")
        else:
            before.append(line)
    for (target, _), expression in zip(targets, reduced, strict=True):
        within.append(f"        {target} {printer.doprint(expression)}")
    return before, within


def _straight(printer: Any, targets: Targets) -> list[str]:
    """Lines that assign expressions to targets outside any loop."""
    before, within = _assignments(printer, targets, set())
    return before + [line[4:] for line in within]


def _function(name: str, arguments: str, slots: Slots, lines: Sequence[str]) -> str:
    """Source of a function for the kernels whose first arguments are y and the constants."""
    read = [f"    {symbol} = y[{k}]" for k, symbol in enumerate(slots.y)]
    read += [f"    {name} = c[{k}]" for k, name in enumerate(CONSTANT_NAMES)]
    return "\n".join(["", "", "@formula", f"def {name}({arguments}):", *read, *lines, ""])


def module_source(effects: Sequence[Effect]) -> str:
    """Source of the module for some effects, with the names that `slipmap.models.effects.program` loads.

    Functions that the kernel does not call according to `SIZES` are left out.
    """
    slots = Slots(effects)
    printer = _Printer({"fully_qualified_modules": True})
    targets = [(f"out[{k}] =", e) for k, e in enumerate(slots.body)]
    targets += _slopes("dout[{at}]", slots.body, slots.y)
    text = _HEADER + _function("body", "y, c, out, dout", slots, _straight(printer, targets))
    cells = slots.factor != 1 or slots.drag != 0 or slots.stretches
    if cells:
        text += _cell_functions(slots, printer)
    if slots.renewed:
        text += _memory_function(slots, printer)
    if slots.measures:
        text += _report("measured", slots.measured, POSE_SYMBOLS, slots.parameters)
    if slots.feels:
        text += _report("felt", slots.felt, PUSH_SYMBOLS, slots.parameters)
    for name, delay in (("delay", slots.delay), ("force_delay", slots.force_delay)):
        if delay != 0:
            text += _delay(name, delay, slots.parameters)
    sizes = (
        len(slots.memory), len(slots.parameters), slots.blades, int(cells), int(slots.stretches),
        slots.pyramids, int(slots.bends),
    )  # fmt: skip
    return text + f"\n\nSIZES = {sizes}\n"


def written_out(effects: Sequence[Effect]) -> str | None:
    """Everything that the source of some effects is made of, and SymPy's version.

    None if a formula contains functions that are not SymPy's own, whose derivatives may change unseen.
    """
    slots = Slots(effects)
    formulas = sp.Tuple(*slots.body, *slots.cell, *slots.renewed, *slots.reports)
    if any(
        not str(kind.__module__).startswith("sympy.") for kind in map(type, sp.preorder_traversal(formulas))
    ):
        return None
    sizes = (len(slots.body), len(slots.renewed), slots.blades, slots.pyramids, slots.bends)
    return f"{sp.__version__} {sizes} {slots.y} {slots.parameters} {slots.memory} {sp.srepr(formulas)}"


def _cell_functions(slots: Slots, printer: Any) -> str:
    """Source of the functions `cells` and `cell_slopes`."""
    loop = {real("r_x"), real("r_y")}
    start = ["    for i in range(int(n)):", "        r_x = rx[i]", "        r_y = ry[i]"]
    targets = [("factor[i] =", slots.factor), ("drag[i] =", slots.drag)]
    if slots.stretches:
        targets += [(f"{name}[i] =", e) for name, e in zip(("qxx", "qxy", "qyy"), slots.stretch, strict=True)]
    before, within = _assignments(printer, targets, loop)
    arguments = "y, c, rx, ry, factor, drag, qxx, qxy, qyy"
    text = _function("cells", arguments, slots, [*before, *start, *within])

    # Quantities of a cell that change: the array of the gradient's derivatives with respect to them, the
    # index there, the formula.
    changed = [("gl", 0, slots.factor), ("gd", 0, slots.drag)]
    changed += [("gq", q, e) for q, e in enumerate(slots.stretch) if slots.stretches]
    changed = [entry for entry in changed if entry[2].free_symbols & {*slots.y}]
    formulas = [(f"{name}{place}", e) for name, place, e in changed]
    code = backward_loop(formulas, slots.y, (real("r_x"), real("r_y")), derivative, printer.doprint)
    rows = [
        f"{name}{place}{a} = {name}[{3 * place + a} * int(n) + i]"
        for name, place, _ in changed
        for a in range(3)
    ]
    # Sums go to local variables: the compiler does not vectorise loops that store to memory.
    lines = [
        *(f"    {line}" for line in [*code.before, *(f"{name} = 0.0" for name in code.sums)]),
        *start,
        *(f"        {line}" for line in [*rows, *code.within]),
        *(f"    {line}" for line in code.after),
    ]
    return text + _function("cell_slopes", "y, c, rx, ry, gl, gd, gq, G", slots, lines)


def _memory_function(slots: Slots, printer: Any) -> str:
    """Source of the function `memory`."""
    read = [f"    {name} = after[{k}]" for k, name in enumerate(AFTER_SYMBOLS)]
    targets = [(f"own[{k}] =", e) for k, e in enumerate(slots.renewed)]
    targets += _slopes("down[{at}]", slots.renewed, [*slots.y, *map(real, AFTER_SYMBOLS)])
    return _function("memory", "y, c, after, own, down", slots, [*read, *_straight(printer, targets)])


def _report(name: str, formulas: Sequence[Any], true: Sequence[str], parameters: Sequence[Any]) -> str:
    """Source of a NumPy function from true values (…,) and parameters to a sensor's report (…, n).

    It also returns the report's derivatives with respect to the true values (…, n, n) and the parameters
    (…, n, P).
    """
    n, P = len(formulas), len(parameters)
    targets = [(f"out[..., {k}] =", e) for k, e in enumerate(formulas)]
    targets += _slopes("by_true[..., {k}, {j}]", formulas, [real(symbol) for symbol in true])
    targets += _slopes("by_p[..., {k}, {j}]", formulas, parameters)
    lines = [
        "",
        "",
        f"def {name}({', '.join(true)}, p):",
        *(f"    {symbol} = p[{k}]" for k, symbol in enumerate(parameters)),
        f"    shape = numpy.shape({true[0]})",
        f"    out = numpy.zeros((*shape, {n}))",
        f"    by_true = numpy.zeros((*shape, {n}, {n}))",
        f"    by_p = numpy.zeros((*shape, {n}, {P}))",
        *_straight(NumPyPrinter({"fully_qualified_modules": True}), targets),
        "    return out, by_true, by_p",
    ]
    return "\n".join([*lines, ""])


def _delay(name: str, delay: Any, parameters: Sequence[Any]) -> str:
    """Source of a function from the parameters to a delay and its derivatives (P,)."""
    printer = NumPyPrinter({"fully_qualified_modules": True})
    lines = ["", "", f"def {name}(p):"]
    lines += [f"    {symbol} = p[{k}]" for k, symbol in enumerate(parameters)]
    lines += [f"    slopes = numpy.zeros({len(parameters)})"]
    lines += [
        f"    {target} {printer.doprint(slope)}"
        for target, slope in _slopes("slopes[{j}]", [delay], parameters)
    ]
    return "\n".join([*lines, f"    return float({printer.doprint(delay)}), slopes", ""])
