"""From the formulas of some effects to machine code: values and derivatives of all that the kernel asks for.

The formulas are differentiated by SymPy, written as a small Python module into the folder of compiled
kernels, and compiled there by numba once. The kernel (`slipmap.models.physics.effect_kernel`) calls them by address,
so that it need not be compiled anew for a new effect or combination.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from slipmap.models.effects.effect import Effect, EffectError, call_formula
from slipmap.models.effects.symbols import (
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
from slipmap.models.files import replaced_file
from slipmap.models.physics.compiled import CACHE_FOLDER

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Program:
    """Compiled formulas of some effects.

    Attributes:
        effects: in the order of their parameters.
        addresses: (4,) of the functions body, cells, cell slopes, memory; 0 for those that `sizes` rules out.
        sizes: (5,) as in `effect_kernel.effect_rollout`.
        measured: x, y, θ (…,) and parameters to (…, 3) poses as the tracker reports them, and their
            derivatives by the true pose (…, 3, 3) and by the parameters (…, 3, P); None where no effect
            changes them.
        delay: parameters to the tracker's delay and its derivative (P,); None where there is none.
        module: what holds the machine code; without it the addresses would lead nowhere.
    """

    effects: tuple[Effect, ...]
    addresses: NDArray[np.int64]
    sizes: NDArray[np.int64]
    measured: Callable[..., tuple[FloatArray, FloatArray, FloatArray]] | None
    delay: Callable[[FloatArray], tuple[float, FloatArray]] | None
    module: ModuleType

    @property
    def parameters(self) -> int:
        """P: number of parameters of all effects."""
        return int(self.sizes[1])

    @property
    def memory(self) -> int:
        """E: numbers carried from step to step."""
        return int(self.sizes[0])


def program_of(effects: Sequence[Effect]) -> Program:
    """Compiled formulas of some effects, from memory or disk where they were compiled before.

    Raises:
        EffectError: a formula raises an error or is no formula; names the effect, file and line.
    """
    return _program_of(tuple(effects))


@lru_cache(maxsize=64)
def _program_of(effects: tuple[Effect, ...]) -> Program:
    text = None
    key = _key(effects)
    if key is None:
        text = _source(effects)
        key = hashlib.sha256(text.encode()).hexdigest()[:16]
    folder = CACHE_FOLDER / f"effects-{key}"
    path = folder / "program.py"
    if not path.exists():
        text = text or _source(effects)
        folder.mkdir(parents=True, exist_ok=True)
        with replaced_file(path) as part:
            part.write_text(text)
    spec = importlib.util.spec_from_file_location(f"slipmap_effects_{key}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    functions = [getattr(module, name, None) for name in ("body", "cells", "cell_slopes", "memory")]
    return Program(
        effects,
        np.array([function.address if function else 0 for function in functions], dtype=np.int64),
        np.array(module.SIZES, dtype=np.int64),
        module.measured if module.MEASURES else None,
        module.delay if module.DELAYS else None,
        module,
    )


def _key(effects: Sequence[Effect]) -> str | None:
    """Hash of all that the code is made from, or None where an effect is not slipmap's own.

    What others' files give may hang on more than their text: on modules that they import, or on the arguments
    of a function that makes classes. There the written code itself tells.
    """
    here = Path(__file__).parent
    digest = hashlib.sha256()
    for name in ("effect.py", "symbols.py", "program.py", "formulas.py"):
        digest.update((here / name).read_bytes())
    for effect in effects:
        try:
            path = Path(inspect.getfile(type(effect)))
        except (TypeError, OSError):
            return None
        if path.parent != here:
            return None
        digest.update(path.read_bytes())
        digest.update(type(effect).__qualname__.encode())
    return digest.hexdigest()[:16]


def _source(effects: Sequence[Effect]) -> str:
    # SymPy takes a third of a second to import and is needed only for formulas that are new.
    from slipmap.models.effects.formulas import module_source

    return module_source(effects)


# What some effects change, asked of their formulas and summed up.


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
