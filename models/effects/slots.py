"""What some effects change, asked of their formulas and summed up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy as sp

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
    memory_name,
    parameter_name,
    real,
)


class Slots:
    """Everything that some effects change, summed up, as SymPy expressions.

    Attributes:
        parameters: symbols of all parameters.
        memory: symbols of what is carried along; empty, or the last force and the effects' own.
        y: all that the formulas are differentiated by.
        body: the first entries of `effect_layout.BODY_OUTPUTS`, then four for each blade.
        factor: of a cell's friction.
        drag: of a cell.
        stretch: q_xx, q_xy, q_yy of a cell.
        renewed: the effects' own memory after the step.
        measured: x, y, theta as reported, or None.
        delay: s, or None.
    """

    def __init__(self, effects: Sequence[Effect]) -> None:
        self.parameters = [real(parameter_name(e.name, p.name)) for e in effects for p in e.parameters]
        own = [real(memory_name(e.name, name)) for e in effects for name in e.memory]
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
            own_parameters = {q.name: real(parameter_name(e.name, q.name)) for q in e.parameters}
            p = Names(f"effect {e.name}: p", own_parameters)
            memory = {name: real(memory_name(e.name, name)) for name in e.memory}
            known = body_names(memory | dict(zip(FORCE_NAMES, force, strict=True)))
            body = Names(f"effect {e.name}: body", known)
            cell = Names(f"effect {e.name}: cell", cell_names(known))
            factor = self._ask(e, "friction", 1, cell, p)
            self.factor = self.factor * (factor[0] if factor else one)
            drag = self._ask(e, "drag", 1, cell, p)
            self.drag = self.drag + (drag[0] if drag else zero)
            shape = self._ask(e, "stretch", 3, cell, p)
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
        self.body = [*wrench, inertia, compliance, *blades]
        self.stretch = [sp.sympify(entry) for entry in stretch]
        self.measures = self.measured != pose
        self.stretches = self.stretch != [one, zero, one]
        asked = {
            s
            for e in [*self.body, *self.cell, *self.renewed, *self.measured]
            for s in sp.sympify(e).free_symbols
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

    @property
    def cell(self) -> list[Any]:
        """Everything that is changed of a cell: factor, drag, stretch."""
        return [self.factor, self.drag, *self.stretch]

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
