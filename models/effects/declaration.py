"""What the class of an effect must declare: name, parameters, a formula, and where a search begins."""

from __future__ import annotations

import difflib
import inspect
import math
import re
from numbers import Real

from models.effects.effect import Effect, EffectError, Parameter, Scene
from models.effects.symbols import FORCE_NAMES, body_names, cell_names
from models.effects.written import QUANTITIES

UNITS = re.compile(r"^(1|([a-zA-Z]+(\^-?\d+)?)([ /][a-zA-Z]+(\^-?\d+)?)*|1(/[a-zA-Z]+(\^\d+)?)+)$")
KNOWN_UNITS = {"m", "s", "kg", "N", "rad", "push", "J", "W", "Hz", "Pa"}
FORMULAS = tuple(QUANTITIES)
METHODS = (*FORMULAS, "remember", "starts")
SCENES = (
    Scene((0.0, 0.0), 0.12, 0.07, 0.05, 20, 5.0),
    Scene((0.6, -0.2), 0.3, 0.15, 0.1, 8, 20.0),
    Scene((-1.2, 1.0), 0.05, 0.03, 0.02, 3, 1.0),
)
"""Pushes as they may have been recorded: places, sizes and weights that differ."""


def check_declaration(effect: Effect) -> None:
    """Refuse an effect whose class is declared wrongly.

    Raises:
        EffectError: what is wrong and what to do.
    """
    _check_methods(type(effect))
    for attribute in ("name", "sentence", "parameters"):
        if not getattr(effect, attribute, None):
            raise EffectError(f"it has no {attribute}")
    if not (isinstance(effect.name, str) and re.fullmatch(r"[a-z][a-z0-9_]*", effect.name)):
        raise EffectError(f"name {effect.name!r} must be lower case letters, digits and underscores")
    if not isinstance(effect.sentence, str):
        raise EffectError(f"sentence must be text, got {effect.sentence!r}")
    _check_names("memory", effect.memory)
    taken = [name for name in effect.memory if name in cell_names(body_names({})) or name in FORCE_NAMES]
    if taken or len(set(effect.memory)) < len(effect.memory):
        raise EffectError(
            f"memory {effect.memory}: every name must be given once, and not be one that body or cell have"
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
        raise EffectError("two parameters have one name")
    if not effect.amplitudes.any():
        raise EffectError("no parameter has a null; give one a value at which the effect vanishes (null=0.0)")


def check_starts(effect: Effect) -> None:
    """Refuse guesses that fail, are no numbers, or leave their parameter's range wherever the pushes were.

    Raises:
        EffectError: what is wrong and what to do.
    """
    given = [[guess for guess in effect.guesses(scene)] for scene in SCENES]
    for parameter in effect.parameters:
        values = [[guess.get(parameter.name, parameter.center) for guess in scene] for scene in given]
        # Places follow the pushes, and a range may be meant for those of one table.
        if all(any(not parameter.low <= v <= parameter.high for v in scene) for scene in values):
            beyond = next(v for v in values[0] if not parameter.low <= v <= parameter.high)
            raise EffectError(
                f"starts() gives {parameter.name} = {beyond:g}; it must lie within {parameter.low:g} and"
                f" {parameter.high:g}"
            )


def _check_methods(kind: type[Effect]) -> None:
    own = {name: value for base in kind.__mro__ if base is not Effect for name, value in vars(base).items()}
    for name, value in own.items():
        if name.startswith("_") or not inspect.isroutine(value) or hasattr(Effect, name):
            continue
        near = difflib.get_close_matches(name, METHODS, n=1)
        hint = f"did you mean {near[0]}()?" if near else f"there are {', '.join(METHODS)}."
        raise EffectError(
            f"{name}() is no method of an effect; {hint} A helper's name begins with an underscore"
        )
    if not any(getattr(kind, name) is not getattr(Effect, name) for name in FORMULAS):
        raise EffectError(f"it has no formula; write one or more of {', '.join(FORMULAS)}")


def _check_names(attribute: str, names: object) -> None:
    if not (isinstance(names, tuple | list) and all(isinstance(n, str) and n.isidentifier() for n in names)):
        raise EffectError(f'{attribute} must be a tuple of names, as ("lag_x", "lag_y"), got {names!r}')


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
        return f"its null or start {parameter.center} must lie within {low} and {high}"
    # A start that was not given is 0; one besides a null means nothing, but must not be a slip either.
    if parameter.start != 0 and not low <= parameter.start <= high:
        return f"its start {parameter.start} must lie within {low} and {high}"
    unknown = set(re.findall(r"[a-zA-Z]+", parameter.unit)) - KNOWN_UNITS
    if not UNITS.fullmatch(parameter.unit) or unknown:
        return (
            f"unit {parameter.unit!r} is not SI as slipmap writes it: 1, m, s, N/m, rad/s, N s/m^3 …"
            f" from {', '.join(sorted(KNOWN_UNITS))}"
        )
    return None
