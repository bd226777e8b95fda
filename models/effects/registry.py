"""Effects by name: those of the library, and those that users bring in files of their own."""

from __future__ import annotations

import difflib
import importlib.util
import inspect
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from models.effects.checks import check_effect
from models.effects.effect import Effect, EffectError
from models.effects.library import LIBRARY
from models.effects.program import failing_line


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """Effects that a Python file defines: one of each subclass of `Effect` in it, checked.

    Raises:
        EffectError: the file cannot be read or run, defines no effect, or one that is faulty; names file
            and line.
    """
    path = Path(path)
    if not path.is_file():
        raise EffectError(f"effect file {path}: there is no such file")
    # SymPy formulas are keyed by their file; a module of the same name elsewhere must not be taken for this
    # one.
    name = f"slipmap_effect_file_{abs(hash(path.resolve()))}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise EffectError(f"effect file {path}: it is not a Python file; its name must end with .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        raise EffectError(f"effect file {path}, line {error.lineno}: {error.msg}") from error
    except Exception as error:
        raise EffectError(
            f"effect file {path}: {failing_line(error)}: {type(error).__name__}: {error}"
        ) from error
    classes = [
        value
        for value in vars(module).values()
        if inspect.isclass(value) and issubclass(value, Effect) and value.__module__ == name
    ]
    if not classes:
        raise EffectError(
            f"effect file {path}: it defines no effect; write a subclass of models.effects.Effect"
        )
    effects = []
    for kind in classes:
        line = inspect.getsourcelines(kind)[1]
        try:
            effect = kind()
        except Exception as error:
            raise EffectError(
                f"effect file {path}, line {line}: {kind.__name__}() failed: {error}"
            ) from error
        check_effect(effect, f"{path}, line {line}")
        effects.append(effect)
    return tuple(effects)


def known_effects(files: Iterable[str | Path] = ()) -> tuple[Effect, ...]:
    """The library, and the effects of some files.

    Raises:
        EffectError: a file is faulty, or two effects have one name.
    """
    effects = list(LIBRARY)
    for path in files:
        for effect in load_effects(path):
            if effect.name in {other.name for other in effects}:
                raise EffectError(
                    f"effect file {path}: there is already an effect {effect.name}; rename yours"
                )
            effects.append(effect)
    return tuple(effects)


def effects_named(names: Sequence[str], known: Sequence[Effect] = LIBRARY) -> tuple[Effect, ...]:
    """Effects of some names, in that order.

    Raises:
        EffectError: an unknown name, with the nearest known ones; or a name given twice.
    """
    by_name = {effect.name: effect for effect in known}
    for name in names:
        if name not in by_name:
            part_of = [known_name for known_name in by_name if name and name in known_name]
            near = difflib.get_close_matches(name, by_name, n=1) or part_of
            hint = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(by_name)}"
            raise EffectError(f"unknown effect {name!r}; {hint}")
        if list(names).count(name) > 1:
            raise EffectError(f"effect {name} is given twice")
    return tuple(by_name[name] for name in names)
