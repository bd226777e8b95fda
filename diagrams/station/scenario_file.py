"""Reading a scenario from YAML: what is wrong in it is said by the name of the field."""

import dataclasses
import difflib
import math
import reprlib
import types
import typing
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml
from pydrake.common.yaml import yaml_load_typed

from diagrams.station.scenario import Scenario
from models.bounded_files import UnreadableFile, read_bounded

LARGEST = 2**16
"""Bytes of a scenario file; one with all that can be set has 5 kB."""

LONGEST = 60
"""Characters of a name or value in an error text."""


class ScenarioError(ValueError):
    """A scenario file that cannot be used; the message names the file and the field."""


T = typing.TypeVar("T")


def read_scenario(path: str | Path, object_name: str | None = None) -> Scenario:
    """Read the robot's cell from a YAML file.

    A mesh or label image is looked for beside the file, then from the working folder.

    Args:
        path: of the file.
        object_name: of the benchmark object that lies there instead of the file's.

    Raises:
        ScenarioError: see `read_settings`; or the object's file is in neither place.
    """
    scenario = read_settings(path, Scenario)
    if object_name is not None:
        scenario.object.name = object_name
        scenario.object.mesh = scenario.object.labels = None
    for field in ("mesh", "labels"):
        name = getattr(scenario.object, field)
        if name is not None:
            setattr(scenario.object, field, str(_found(name, Path(path), f"object.{field}")))
    return scenario


def _found(name: str, scenario: Path, field: str) -> Path:
    places = list(dict.fromkeys(place.absolute() for place in (scenario.parent / name, Path(name))))
    for place in places:
        with suppress(OSError, ValueError):  # a name that no disk can hold
            if place.is_file():
                return place
    if len(name) > LONGEST or not name.isprintable():
        raise ScenarioError(f"{scenario}: {field}: there is no file {_shown(name)}")
    tried = ", nor ".join(str(place) for place in places)
    raise ScenarioError(f"{scenario}: {field}: there is no file {tried}")


def read_settings(path: str | Path, schema: type[T]) -> T:
    """Read a dataclass from a YAML file; what the file leaves out keeps its default.

    Args:
        path: of the file.
        schema: dataclass, whose fields may be dataclasses.

    Raises:
        ScenarioError: no such file, no YAML, an unknown field, a value of another type, or one that the
            dataclass itself refuses.
    """
    path = Path(path)
    try:
        text = read_bounded(path, LARGEST).decode("utf-8")
        for key, first, again in _repeated_keys(yaml.compose(text, Loader=yaml.SafeLoader)):
            raise ScenarioError(f"{path}: {key} stands in line {first} and again in line {again}; keep one")
        content = yaml.safe_load(text)
    except UnreadableFile as error:
        raise ScenarioError(f"{path}: {error}") from error
    except ScenarioError:
        raise
    except RecursionError as error:
        raise ScenarioError(f"{path}: is nested too deeply to be a scenario") from error
    # Beside its own errors, the parser lets those of the types pass: a month 99, an integer of 5000 digits.
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, LookupError, OverflowError) as error:
        raise ScenarioError(f"{path}: is not YAML ({_told(error)})") from error
    if content is None:
        return schema()
    _check(content, schema, str(path), "")
    try:
        settings = yaml_load_typed(schema=schema, data=text, defaults=schema())
        _refuse(settings, "")
    except ValueError as error:
        said = str(error)
        raise ScenarioError(f"{path}: {said if len(said) <= 1000 else f'{said[:997]}...'}") from error
    return settings


def _told(error: Exception) -> str:
    """What a parser says, on one line; of the text that it names, only the line and column."""
    said = " ".join(str(error).replace('in "<unicode string>", ', "").split())
    return said if len(said) <= 200 else f"{said[:197]}..."


def _shown(value: Any) -> str:
    """A value as it stands in Python, of bounded length; a few lines of YAML can mean billions of items."""
    brief = reprlib.Repr()
    brief.maxlist = brief.maxdict = 8
    brief.maxlevel = 3
    brief.maxstring = brief.maxother = brief.maxlong = LONGEST
    return brief.repr(value)


def _name(key: Any) -> str:
    name = key if isinstance(key, str) else _shown(key)
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 1]}…"


def _repeated_keys(root: yaml.Node | None) -> Iterator[tuple[str, int, int]]:
    """Keys that stand twice in one mapping, and their lines from 1. YAML would take the last."""
    waiting: list[tuple[str, Any]] = [("", root)]
    seen: set[int] = set()
    while waiting:
        where, node = waiting.pop()
        if not isinstance(node, yaml.CollectionNode) or id(node) in seen:
            continue
        seen.add(id(node))
        if isinstance(node, yaml.SequenceNode):
            waiting += [(where, item) for item in node.value]
            continue
        lines: dict[str, int] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            name, line = _name(key.value), key.start_mark.line + 1
            full = f"{where}.{name}" if where else name
            if name in lines:
                yield full, lines[name], line
            lines[name] = line
            waiting.append((full, value))


def _refuse(settings: Any, where: str) -> None:
    """Ask every part, once complete, whether its numbers make sense."""
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            _refuse(value, f"{where}.{field.name}" if where else field.name)
    check = getattr(settings, "check", None)
    if check is None:
        return
    try:
        check()
    except ValueError as error:
        # A section's own check names it; a part of a section does not know where it belongs.
        raise ValueError(f"{where}: {error}" if "." in where else str(error)) from error


def _check(value: Any, wanted: Any, path: str, where: str) -> None:
    if dataclasses.is_dataclass(wanted):
        _check_fields(value, wanted, path, where)
        return
    options = typing.get_args(wanted)
    origin = typing.get_origin(wanted)
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in options:
            return
        rest = [option for option in options if option is not type(None)]
        _check(value, rest[0], path, where)
        return
    if origin in (list, tuple):
        if not isinstance(value, list):
            raise ScenarioError(f"{path}: {where} must be a list, got {_shown(value)}")
        for index, item in enumerate(value):
            _check(item, options[0], path, f"{where}[{index}]")
        return
    if origin is dict:
        if not isinstance(value, dict):
            raise ScenarioError(f"{path}: {where} must hold names and values, got {_shown(value)}")
        for name, item in value.items():
            _check(name, options[0], path, f"{where}, the name {_shown(name)}")
            _check(item, options[1], path, f"{where}.{_name(name)}")
        return
    kinds = {float: (int, float), int: (int,), str: (str,), bool: (bool,)}[wanted]
    if not isinstance(value, kinds) or (isinstance(value, bool) and wanted is not bool):
        names = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
        hint = _exponent(value) if wanted is not str else ""
        raise ScenarioError(f"{path}: {where} must be {names[wanted]}, got {_shown(value)}{hint}")
    if wanted is float and not _is_float(value):
        raise ScenarioError(f"{path}: {where} must be a number that a computer holds, got {_shown(value)}")


def _is_float(value: Any) -> bool:
    try:
        return isinstance(float(value), float)
    except OverflowError:
        return False


def _exponent(value: Any) -> str:
    """What to write instead of a number that YAML reads as a text, such as 1e6."""
    try:
        number = float(value) if isinstance(value, str) else None
    except ValueError:
        return ""
    if number is None or not math.isfinite(number):
        return ""
    mantissa, _, power = f"{number:e}".partition("e")
    digits = mantissa.rstrip("0")
    written = f"{digits}0e{power}" if digits.endswith(".") else f"{digits}e{power}"
    return f", which YAML reads as a text; write {written}"


def _check_fields(value: Any, wanted: Any, path: str, where: str) -> None:
    known = {field.name: field.type for field in dataclasses.fields(wanted)}
    if not isinstance(value, dict):
        is_name = isinstance(value, str) and len(value) <= LONGEST and "name" in known
        hint = f"; write {where}: {{name: {value}}}" if is_name else ""
        wrong = f"{where or 'the file'} must hold fields and values, got {_shown(value)}{hint}"
        raise ScenarioError(f"{path}: {wrong}")
    for name, item in value.items():
        full = f"{where}.{_name(name)}" if where else _name(name)
        if name not in known:
            near = difflib.get_close_matches(_name(name), known, n=1)
            hint = f"did you mean {near[0]}? Known" if near else "known"
            raise ScenarioError(f"{path}: unknown field {full}; {hint} here: {', '.join(known)}")
        _check(item, known[name], path, full)
