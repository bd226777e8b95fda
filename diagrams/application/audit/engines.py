"""Engines by name: MuJoCo, Bullet and Drake with settings, or a class in a user's own file."""

from __future__ import annotations

import importlib.util
import inspect
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import numpy as np

from slipmap.diagrams.application.audit.engine import Subject
from slipmap.models.effects.effect import failure
from slipmap.models.files import BadInput


@dataclass(frozen=True)
class BuiltIn:
    """An engine that slipmap can audit out of the box."""

    package: str  # name of its pip package
    where: str  # module and class
    words: Mapping[str, Mapping[str, Any]]  # settings by word, as attributes of the class
    numbers: tuple[str, ...]  # attributes that take a number
    remedies: Mapping[str, str]  # what to set, by key of the defect


BUILT_IN = {
    "mujoco": BuiltIn(
        "mujoco", "mujoco_engine:MujocoEngine", {"pyramidal": {}, "elliptic": {"cone": "elliptic"}},
        ("dt", "impratio", "timeconst"),
        {
            "diamond": 'cone="elliptic" in MuJoCo\'s <option> gives a cone (mujoco:elliptic)',
            "creep": "impratio of 10 to 100 in MuJoCo's <option> cures creep (mujoco:elliptic,impratio=100)",
            "load_follows_slip": "against load that follows slip, no setting of MuJoCo is known (impratio and"
            " a smaller step do not help, a shorter timeconst of contacts makes it worse)",
        },
    ),
    "bullet": BuiltIn(
        "pybullet", "bullet_engine:BulletEngine", {"cone": {}, "pyramid": {"cone": False}},
        ("dt", "iterations"),
        {
            "square": "setPhysicsEngineParameter(enableConeFriction=1) gives a cone (bullet:cone)",
            "lean": "against leaning friction, no setting of Bullet's multibody solver is known",
        },
    ),
    "drake": BuiltIn(
        "drake", "drake_engine:DrakeEngine",
        {
            "lagged": {}, "similar": {"approximation": "similar"}, "sap": {"approximation": "sap"},
            "tamsi": {"approximation": "tamsi"}, "hydroelastic": {"hydroelastic": True},
        },
        ("dt", "stiction"),
        {
            "load_follows_slip": 'discrete_contact_approximation="lagged" keeps loads even (drake:lagged)',
            "creep": "a smaller stiction_tolerance (drake:stiction=1e-5)",
        },
    ),
}  # fmt: skip
"""Built-in engines by name."""

_LARGEST = 2**20  # bytes of a user's file


def find_engine(spec: str) -> Subject:
    """An engine as a user names it.

    Args:
        spec: `mujoco`, `bullet` or `drake`, with comma-separated settings after a colon, such as
            `mujoco:elliptic,impratio=100`; or a file and a class, such as `my_engine.py:Engine`.

    Raises:
        BadInput: the engine or setting does not exist or is not installed, or the file is faulty.
    """
    name, _, rest = spec.partition(":")
    if name in BUILT_IN:
        return Subject(spec, _with_settings(spec, BUILT_IN[name], rest))
    file, colon, kind = spec.rpartition(":")
    if not colon or not file.endswith(".py"):
        known = ", ".join(BUILT_IN)
        raise BadInput(
            f"there is no engine {spec!r}; name {known}, or a file and its class, such as my_engine.py:Engine"
        )
    return Subject(kind, _class_in(Path(file), kind))


def installed() -> list[str]:
    """Names of the built-in engines that are installed."""
    return [
        name for name, engine in BUILT_IN.items() if importlib.util.find_spec(_module(engine)) is not None
    ]


def version(spec: str) -> str:
    """Name and version of the package of a built-in engine; empty for a user's engine."""
    engine = BUILT_IN.get(spec.partition(":")[0])
    return "" if engine is None else f"{engine.package} {metadata.version(engine.package)}"


def remedy(spec: str, key: str) -> str:
    """The setting that removes a defect of an engine; empty where none is known."""
    engine = BUILT_IN.get(spec.partition(":")[0])
    return "" if engine is None else engine.remedies.get(key, "")


def _module(engine: BuiltIn) -> str:
    return "pydrake" if engine.package == "drake" else engine.package


def _with_settings(spec: str, engine: BuiltIn, settings: str) -> type:
    chosen: dict[str, Any] = {}
    for setting in filter(None, settings.split(",")):
        word, equals, value = setting.partition("=")
        if not equals and word in engine.words:
            chosen |= engine.words[word]
        elif equals and word in engine.numbers:
            try:
                number = float(value)
            except ValueError:
                raise BadInput(f"engine {spec}: {word} must be a number, got {value!r}") from None
            if not 0 < number < np.inf or (word == "iterations" and number % 1):
                raise BadInput(f"engine {spec}: {word} must be a positive number, got {value!r}")
            chosen[word] = int(number) if word == "iterations" else number
        else:
            known = [*engine.words, *(f"{name}=…" for name in engine.numbers)]
            raise BadInput(f"engine {spec}: there is no setting {setting!r}; there are {', '.join(known)}")
    if importlib.util.find_spec(_module(engine)) is None:
        extra = "slipmap" if engine.package == "drake" else "slipmap[bench]"
        raise BadInput(f"engine {spec}: {engine.package} is not installed; use `pip install '{extra}'`")
    module, _, name = engine.where.partition(":")
    kind = getattr(import_module(f"{__package__}.{module}"), name)
    return type(name, (kind,), chosen)


def _class_in(path: Path, name: str) -> Any:
    if not path.is_file() or path.stat().st_size > _LARGEST:
        raise BadInput(f"engine file {path}: there is no such file, or it is too large; check the name")
    module_name = f"slipmap_engine_file_{abs(hash(path.resolve()))}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    assert spec is not None and spec.loader is not None  # as its name ends in .py
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module
    try:
        spec.loader.exec_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # as by sys.exit()
        raise BadInput(f"engine file {path} cannot be run: {failure(error)}") from error
    kind = getattr(module, name, None)
    if not inspect.isclass(kind):
        classes = [key for key, value in vars(module).items() if inspect.isclass(value)]
        raise BadInput(
            f"engine file {path}: there is no class {name} in it; it has {', '.join(classes) or 'none'}"
        )
    return kind
