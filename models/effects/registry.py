"""Effects by name: from the library and from users' own files."""

import difflib
import importlib.util
import inspect
import sys
from collections.abc import Iterable, Sequence
from hashlib import sha256
from pathlib import Path

from slipmap.models.effects.effect import Effect, EffectError, failure
from slipmap.models.effects.library import LIBRARY
from slipmap.models.files import UnreadableFile, check_file

_LARGEST = 2**20  # bytes of a file with effects


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    r"""Load the effects that a Python file defines: one of each subclass of `Effect` in it, checked.

    Raises:
        EffectError: the file cannot be read or run, or defines no effect or a faulty one; names the file
            and line.

    Example:
        >>> import pathlib
        >>> import tempfile
        >>> import slipmap
        >>> text = 'from slipmap import Effect, Parameter\n'
        >>> text += 'class Fan(Effect):\n    name = "fan"\n    sentence = "A fan blows."\n'
        >>> text += '    parameters = (Parameter("thrust", "N", "of the air", -5.0, 5.0, 0.2, null=0.0),)\n'
        >>> text += '    def force(self, body, p):\n        return p.thrust, 0, 0\n'
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "fan.py"
        ...     characters = path.write_text(text)
        ...     [effect.name for effect in slipmap.load_effects(path)]
        ['fan']
    """
    path = Path(path)
    try:
        check_file(path, _LARGEST)
    except UnreadableFile as error:
        raise EffectError(f"effect file {path}: {error}") from error
    source = path.read_bytes()
    before, null, _ = source.partition(b"\0")
    if null:  # Pythons before 3.11.4 name no line
        row = before.count(b"\n") + 1
        raise EffectError(f"effect file {path}, line {row}: it holds a null byte; save it as UTF-8 text")
    # SymPy formulas are keyed by their file; another module of the same name must not be mistaken for it.
    name = f"slipmap_effect_file_{sha256(str(path.resolve()).encode()).hexdigest()[:16]}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None:
        raise EffectError(f"effect file {path}: it is not a Python file; its name must end with .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        # An import may use bytecode of the file as it was, known by its size and the second of its change.
        exec(compile(source, str(path), "exec", dont_inherit=True), vars(module))
    except SyntaxError as error:
        line = f", line {error.lineno}" if error.lineno else ""
        raise EffectError(f"effect file {path}{line}: {error.msg}") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # sys.exit() would end the program silently
        said = failure(error)
        place = said.removeprefix(path.name) if said.startswith(f"{path.name}, line") else f": {said}"
        raise EffectError(f"effect file {path}{place}") from error
    classes = [
        value
        for value in vars(module).values()
        if inspect.isclass(value) and issubclass(value, Effect) and value.__module__ == name
    ]
    if not classes:
        raise EffectError(
            f"effect file {path}: it defines no effect; write a subclass of Effect (`from slipmap import"
            " Effect`)"
        )
    return tuple(_made(kind, path) for kind in classes)


def _made(kind: type[Effect], path: Path) -> Effect:
    """An instance of an effect class, checked."""
    from slipmap.models.effects.effect_checks import check_effect

    where = f"{path}{_line_of(kind)}, class {kind.__name__}"
    try:
        effect = kind()
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise EffectError(f"effect file {where}: {kind.__name__}() failed in {failure(error)}") from error
    check_effect(effect, where)
    return effect


def _line_of(kind: type[Effect]) -> str:
    try:
        return f", line {inspect.getsourcelines(kind)[1]}"
    except (OSError, TypeError):  # a class made without a `class` statement
        return ""


def known_effects(files: Iterable[str | Path] = ()) -> tuple[Effect, ...]:
    """The library's effects, followed by those of the given files.

    Raises:
        EffectError: a file is faulty, or two effects have the same name.
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
    """The effects with the given names, in that order.

    Raises:
        EffectError: a name is unknown (the message suggests near ones) or given twice, or the names are one
            text.

    Example:
        >>> import slipmap
        >>> [effect.sentence for effect in slipmap.effects_named(["table_tilt"])]
        ['The table is not level: gravity has a component along it.']
    """
    if isinstance(names, str):
        raise EffectError(f"effects must be a list of names, got {names!r}; write [{names!r}]")
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


def effects_given(effects: Sequence[Effect | str]) -> tuple[Effect, ...]:
    """Effects from objects and from names in the library.

    Raises:
        EffectError: a name is unknown, an effect is given twice, or something is neither name nor effect.
    """
    if isinstance(effects, str):
        return effects_named(effects)  # says how to write it
    if isinstance(effects, Effect):
        raise EffectError(f"effects must be a list, got one effect; write [{effects.name}]")
    if not isinstance(effects, Iterable):
        raise EffectError(f"effects must be a list of names or effects, got {effects!r}")
    effects = tuple(effects)
    for effect in effects:
        if inspect.isclass(effect) and issubclass(effect, Effect):
            name = effect.__name__
            raise EffectError(f"effects must be objects, got the class {name}; write {name}()")
        if not isinstance(effect, Effect | str):
            raise EffectError(f"effects must be names or objects of a class of Effect, got {effect!r}")
    own = [effect for effect in effects if not isinstance(effect, str)]
    names = [effect if isinstance(effect, str) else effect.name for effect in effects]
    return effects_named(names, (*LIBRARY, *own))


def candidates_given(effects: Sequence[Effect | str]) -> tuple[Effect, ...]:
    """The same for the candidates of a diagnosis, of which there is at least one.

    Raises:
        EffectError: as `effects_given`, or there is none.
    """
    found = effects_given(effects)
    if not found:
        raise EffectError("effects: name at least one candidate, or leave them out to try the whole library")
    return found
