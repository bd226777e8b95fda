"""Settings of the robot cell: YAML dataclasses like those of Drake's scenarios.

`read_scenario` reads them from a file; its errors name the field that is wrong.
"""

# Annotations stay objects, because Drake's YAML reader inspects them.

import dataclasses
import difflib
import reprlib
import types
import typing
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydrake.common.yaml import yaml_load_typed

from slipmap.diagrams.execution.requests import ExecutionConfig
from slipmap.diagrams.hardware.guard import GuardSettings
from slipmap.diagrams.perception.camera import CameraConfig
from slipmap.diagrams.perception.depth_noise import DepthNoiseConfig
from slipmap.diagrams.station.arm import ARM_MODELS
from slipmap.diagrams.station.hidden_effects import HiddenEffectsConfig
from slipmap.diagrams.station.sliding_object import GRAVITY
from slipmap.models.files import BadInput, UnreadableFile, read_bounded
from slipmap.models.measurements.parsing import read_as_text, shown_error
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.objects.meshes import DIRECTIONS
from slipmap.models.objects.true_object import (
    DEFAULT_CELLS,
    DEFAULT_MU_FINGER,
    TrueObject,
    object_from_labels,
    object_from_mesh,
)
from slipmap.models.settings import check_kind
from slipmap.planners.settings import GoalSettings, PokeSettings, PushSettings, RepairSettings

_LARGEST_TABLE = 20.0  # radius or side, m; more is in millimetres
LARGEST = 2**16  # largest size of a scenario file, bytes; one with every setting has 5 kB
_LONGEST = 60  # characters of a name or value in an error text
_LONGEST_LABEL = 9  # digits

# What each kind of object uses of its settings besides the pose, by the field that tells the kind.
_FROM_A_FILE = ("mu_finger", "cells")
_USED = {
    "name": ("name",),
    "mesh": ("mesh", "mass", "mu", "metres_per_unit", "up", *_FROM_A_FILE),
    "labels": ("labels", "background", "metres_per_pixel", "masses", "frictions", "height", *_FROM_A_FILE),
}
_KINDS = {
    "name": "a benchmark object",
    "mesh": "an object from a mesh",
    "labels": "an object from a label image",
}

T = typing.TypeVar("T")


class ScenarioError(BadInput, ValueError):
    """A scenario file that cannot be used; the message names the file and the field."""


@dataclass
class ObjectSettings:
    """The object on the table: one of the benchmark, or your own from a mesh or a label image."""

    name: str = "hammer"  # of a benchmark object, which needs nothing else but a pose
    mesh: str | None = None  # file that trimesh can load; needs `mass` and `mu`
    # image whose pixel values label segments; needs `metres_per_pixel`, `masses`, `frictions`, `height`
    labels: str | None = None
    # mass, mu: of an object of one material, from a mesh, kg
    mass: float | None = None
    mu: float | None = None
    # unit of the mesh, 0.001 for millimetres; by default that of the file, else 1
    metres_per_unit: float | None = None
    up: str | None = None  # the mesh's axis that points up, such as y or -z; by default that of its format
    background: int = 0  # label of the pixels outside the object
    metres_per_pixel: float = 0.001  # side of a pixel, m
    # masses, frictions: of each label
    masses: dict[str, float] = field(default_factory=dict)
    frictions: dict[str, float] = field(default_factory=dict)
    height: float = 0.03  # of an object from a label image, m
    mu_finger: float = DEFAULT_MU_FINGER  # friction of your own object with the finger
    cells: int = DEFAULT_CELLS  # wanted number of true cells of your own object
    # initial x and y in m and rotation in degrees
    pose: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def check(self) -> None:
        """Raise ValueError for an invalid field."""
        if len(self.pose) != 3 or not np.isfinite(self.pose).all():
            raise ValueError(f"object.pose must be x, y in m and a rotation in degrees, got {self.pose}")
        if self.mesh is not None and self.labels is not None:
            raise ValueError("object: give mesh or labels, not both")
        for name in ("mass", "mu", "metres_per_unit"):
            value = getattr(self, name)
            if value is not None and self.mesh is None:
                raise ValueError(
                    f"object.{name} only applies to your own object from a mesh; {self.called} has its own"
                )
            if value is not None and not (np.isfinite(value) and value > 0):
                raise ValueError(f"object.{name} must be positive, got {value}")
        if self.up is not None and (self.mesh is None or self.up not in DIRECTIONS):
            raise ValueError(
                f"object.up must be one of {', '.join(DIRECTIONS)} and needs a mesh, got {self.up!r}"
            )
        if self.mesh is not None and (self.mass is None or self.mu is None):
            raise ValueError("object: an object from a mesh needs mass (kg) and mu")
        for name in (*self.masses, *self.frictions):
            if not (name.isascii() and name.isdigit() and len(name) <= _LONGEST_LABEL):
                raise ValueError(f"object: keys of masses and frictions must be integer labels, got {name!r}")
        self._refuse_unused()

    def _refuse_unused(self) -> None:
        kind = "mesh" if self.mesh is not None else "labels" if self.labels is not None else "name"
        plain = ObjectSettings()
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            if item.name in (*_USED[kind], "pose") or value == getattr(plain, item.name):
                continue
            users = " or ".join(_KINDS[other] for other, used in _USED.items() if item.name in used)
            raise ValueError(
                f"object.{item.name} has no effect on {self.called}, which is {_KINDS[kind]}; only {users}"
                " uses it: remove it"
            )

    @property
    def called(self) -> str:
        """The object's name; that of its file if it comes from one."""
        return Path(self.mesh or self.labels or self.name).stem

    def make(self) -> TrueObject:
        """Make the true object.

        Raises:
            ValueError: it cannot be made; names the object, the file or the number.
        """
        if self.mesh is not None:
            assert self.mass is not None and self.mu is not None  # see check
            return object_from_mesh(
                self.mesh, self.mass, self.mu,
                mu_finger=self.mu_finger, count=self.cells, metres_per_unit=self.metres_per_unit,
                up=None if self.up is None else DIRECTIONS[self.up],
            )  # fmt: skip
        if self.labels is not None:
            return object_from_labels(
                self.labels,
                self.metres_per_pixel,
                {int(label): value for label, value in self.masses.items()},
                {int(label): value for label, value in self.frictions.items()},
                height=self.height,
                mu_finger=self.mu_finger,
                count=self.cells,
                background=self.background,
            )
        return benchmark_object(self.name)


@dataclass
class TableSettings:
    """The table, centred on the world's origin."""

    shape: str = "round"  # round or rectangle
    radius: float = 0.5  # of a round table, m
    size: list[float] = field(default_factory=lambda: [1.2, 0.8])  # along x and y of a rectangular one, m
    # of the table's own surface; the object's friction with it is set by the object, but must be below twice
    # this
    friction: float = 0.6

    @staticmethod
    def check_keys(keys: Collection[str]) -> None:
        """Raise ValueError for a size alone: even the default one would leave the table round."""
        if "size" in keys and "shape" not in keys:
            raise ValueError("table.size is of a rectangular table; write shape: rectangle beside it")

    def check(self) -> None:
        """Raise ValueError for an invalid field."""
        if self.shape not in ("round", "rectangle"):
            raise ValueError(f"table.shape must be round or rectangle, got {self.shape!r}")
        lengths = np.array([self.radius, *self.size])
        if len(self.size) != 2 or not (np.isfinite(lengths) & (lengths > 0)).all():
            raise ValueError(f"table: radius and size must be positive, got {self.radius} and {self.size}")
        for name, length in (("radius", self.radius), ("size", max(self.size))):
            if length > _LARGEST_TABLE:
                raise ValueError(f"table.{name} is {length:g} m; no table is that large, divide by 1000?")
        unused, used = ("size", "radius") if self.shape == "round" else ("radius", "size")
        value = getattr(self, unused)
        if value != getattr(TableSettings(), unused):
            other = "rectangle" if self.shape == "round" else "round"
            raise ValueError(
                f"table.{unused} is {value}, but table.shape is {self.shape}, which takes {used}; write"
                f" shape: {other}, or {used}"
            )
        if not self.friction > 0:
            raise ValueError(f"table.friction must be positive, got {self.friction}")

    def make(self) -> Table:
        """The table top as push datasets describe it."""
        if self.shape == "round":
            return Table("round", (0.0, 0.0), radius=self.radius)
        return Table("rectangle", (0.0, 0.0), size=(self.size[0], self.size[1]))


@dataclass
class ArmSettings:
    """The arm."""

    # `primitives`, which are part of slipmap, or `drake_models`, which Drake downloads
    models: str = "primitives"

    def check(self) -> None:
        """Raise ValueError for an invalid field."""
        if self.models not in ARM_MODELS:
            raise ValueError(f"arm.models must be one of {', '.join(ARM_MODELS)}, got {self.models!r}")


@dataclass
class SimulationSettings:
    """The simulated world."""

    # of the plant, s; best a divisor of 10 ms, the period at which the finger is recorded: with 3 ms its
    # recording jitters by its motion in one step, and a tap seems 20 % faster or slower. The rows of a
    # commanded path should be spaced by a multiple of the step, or the finger jerks.
    time_step: float = 0.0025

    def check(self) -> None:
        """Raise ValueError for an invalid field."""
        if not 1e-4 <= self.time_step <= 0.01:
            raise ValueError(f"simulation.time_step must lie between 0.0001 and 0.01 s, got {self.time_step}")


@dataclass
class Scenario:
    """A robot cell and its task.

    Attributes:
        object: on the table.
        table: its shape and friction.
        arm: its model.
        execution: how the arm moves.
        guard: when a real arm is stopped.
        camera: its pose and pictures.
        depth_noise: of the camera.
        hidden: physics of the true world that the plain model lacks; none by default.
        pokes: how the object is explored.
        goals: where at the table's edge it may be left.
        pushes: how it is pushed there.
        repair: how pushes that surprise the model are diagnosed, if the run adapts.
        simulation: how the world is stepped.
        gravity: m/s².

    Example:
        >>> import slipmap
        >>> scenario = slipmap.Scenario()
        >>> scenario.camera.rate = 5.0
        >>> scenario.table.radius
        0.5
    """

    object: ObjectSettings = field(default_factory=ObjectSettings)
    table: TableSettings = field(default_factory=TableSettings)
    arm: ArmSettings = field(default_factory=ArmSettings)
    execution: ExecutionConfig = field(default_factory=ExecutionConfig)
    guard: GuardSettings = field(default_factory=GuardSettings)
    camera: CameraConfig = field(default_factory=lambda: CameraConfig(rate=10.0))
    depth_noise: DepthNoiseConfig = field(default_factory=DepthNoiseConfig)
    hidden: HiddenEffectsConfig = field(default_factory=HiddenEffectsConfig)
    pokes: PokeSettings = field(default_factory=PokeSettings)
    goals: GoalSettings = field(default_factory=lambda: GoalSettings(count=60))
    pushes: PushSettings = field(default_factory=PushSettings)
    repair: RepairSettings = field(default_factory=RepairSettings)
    simulation: SimulationSettings = field(default_factory=SimulationSettings)
    gravity: float = GRAVITY

    def check(self) -> None:
        """Raise ValueError for an invalid gravity."""
        if not 0.1 <= self.gravity <= 50.0:
            raise ValueError(f"gravity must lie between 0.1 and 50 m/s², got {self.gravity}")


def read_scenario(path: str | Path, object_name: str | None = None) -> Scenario:
    """Read a scenario from a YAML file.

    The path of a mesh or label image is relative to that file or, if there is none, to the working folder.

    Args:
        object_name: benchmark object to use instead of the file's.

    Raises:
        ScenarioError: see `read_settings`; or the object's file is in neither place.
    """
    scenario = read_settings(path, Scenario)
    if object_name is not None:
        scenario.object = ObjectSettings(name=object_name, pose=scenario.object.pose)
    for key in ("mesh", "labels"):
        name = getattr(scenario.object, key)
        if name is not None:
            setattr(scenario.object, key, str(_found(name, Path(path), f"object.{key}")))
    return scenario


def _found(name: str, scenario: Path, field: str) -> Path:
    places = list(dict.fromkeys(place.absolute() for place in (scenario.parent / name, Path(name))))
    for place in places:
        with suppress(OSError, ValueError):  # an impossible file name
            if place.is_file():
                return place
    if len(name) > _LONGEST or not name.isprintable():
        raise ScenarioError(f"{scenario}: {field}: there is no file {_shown(name)}")
    tried = " or ".join(str(place) for place in places)
    raise ScenarioError(f"{scenario}: {field}: there is no file {tried}")


# Keys in scenarios of earlier versions, among them those kept with every run, that no longer say anything.
_RETIRED = (("repair", "together"),)


def read_settings(path: str | Path, schema: type[T]) -> T:
    """Read a dataclass from a YAML file; fields that the file leaves out keep their defaults.

    Args:
        schema: dataclass, whose fields may be dataclasses.

    Raises:
        ScenarioError: no such file, invalid YAML, an unknown field, a value of the wrong type, or one that
            the dataclass's own check refuses.
    """
    path = Path(path)
    try:
        text = read_bounded(path, LARGEST).decode("utf-8")
        for key, first, again in _repeated_keys(yaml.compose(text, Loader=yaml.SafeLoader)):
            raise ScenarioError(f"{path}: {key} is given in line {first} and again in line {again}; keep one")
        content = yaml.safe_load(text)
    except UnreadableFile as error:
        raise ScenarioError(f"{path}: {error}") from error
    except ScenarioError:
        raise
    except RecursionError as error:
        raise ScenarioError(f"{path}: is nested too deeply to be a scenario") from error
    # The parser also raises errors of the types, such as for a month 99 or an integer of 5000 digits.
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, LookupError, OverflowError) as error:
        raise ScenarioError(f"{path}: is not YAML ({shown_error(error)})") from error
    if content is None:
        return schema()
    for section, name in _RETIRED:
        if isinstance(content, dict) and isinstance(content.get(section), dict) and name in content[section]:
            del content[section][name]
            text = yaml.safe_dump(content)
    try:
        _check(content, schema, "")
        settings = yaml_load_typed(schema=schema, data=text, defaults=schema())
        _refuse(settings, "")
    except ValueError as error:
        said = str(error)
        raise ScenarioError(f"{path}: {said if len(said) <= 1000 else f'{said[:997]}...'}") from error
    return settings


def check_scenario(scenario: Scenario) -> None:
    """Refuse a scenario made or changed in Python for what would be refused in a file, in the same words.

    Raises:
        ScenarioError: an unknown field, a value of the wrong type, or one that a check refuses.
        TypeError: something other than a scenario.
    """
    check_kind("scenario", scenario, Scenario, "such as slipmap.Scenario()")
    try:
        _check(_content(scenario), Scenario, "")
        _refuse(scenario, "")
    except ValueError as error:
        raise ScenarioError(f"scenario: {error}") from error


def _content(value: Any) -> Any:
    """Settings as a file holds them, with attributes that are no fields."""
    if dataclasses.is_dataclass(value):
        return {name: _content(part) for name, part in vars(value).items()}
    return value


def _shown(value: Any) -> str:
    """A value as in Python, of bounded length, because a few lines of YAML can mean billions of items."""
    brief = reprlib.Repr()
    brief.maxlist = brief.maxdict = 8
    brief.maxlevel = 3
    brief.maxstring = brief.maxother = brief.maxlong = _LONGEST
    return brief.repr(value)


def _name(key: Any) -> str:
    name = key if isinstance(key, str) else _shown(key)
    return name if len(name) <= _LONGEST else f"{name[: _LONGEST - 1]}…"


def _repeated_keys(root: yaml.Node | None) -> Iterator[tuple[str, int, int]]:
    """Keys given twice in one mapping, and their lines from 1; YAML would silently use the last."""
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
    """Run the check of every part, inner parts first."""
    for part in dataclasses.fields(settings):
        value = getattr(settings, part.name)
        if dataclasses.is_dataclass(value):
            _refuse(value, f"{where}.{part.name}" if where else part.name)
    check = getattr(settings, "check", None)
    if check is None:
        return
    try:
        check()
    except ValueError as error:
        # The check of a section names it, but that of a part of a section does not.
        raise ValueError(f"{where}: {error}" if "." in where else str(error)) from error


def _check(value: Any, wanted: Any, where: str) -> None:
    if dataclasses.is_dataclass(wanted):
        _check_fields(value, wanted, where)
        return
    options = typing.get_args(wanted)
    origin = typing.get_origin(wanted)
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in options:
            return
        rest = [option for option in options if option is not type(None)]
        _check(value, rest[0], where)
        return
    if origin in (list, tuple):
        if not isinstance(value, list | tuple | np.ndarray):
            raise ValueError(f"{where} must be a list, got {_shown(value)}")
        for index, item in enumerate(value):
            _check(item, options[0], f"{where}[{index}]")
        return
    if origin is dict:
        if not isinstance(value, dict):
            raise ValueError(f"{where} must hold names and values, got {_shown(value)}")
        for name, item in value.items():
            if not isinstance(name, str):
                quoted = f"; write '{name}'" if isinstance(name, int) else ""
                raise ValueError(f"{where}: the name {_shown(name)} must be text{quoted}")
            _check(item, options[1], f"{where}.{_name(name)}")
        return
    kind: Any = {float: Real, int: Integral, str: str, bool: bool}[wanted]
    if not isinstance(value, kind) or (isinstance(value, bool) and wanted is not bool):
        names = {float: "a number", int: "a whole number", str: "text", bool: "true or false"}
        hint = read_as_text(value) if wanted is not str else ""
        raise ValueError(f"{where} must be {names[wanted]}, got {_shown(value)}{hint}")
    if wanted is float:
        try:
            float(value)
        except OverflowError as error:
            wrong = f"{where} must be a number that fits in double precision, got {_shown(value)}"
            raise ValueError(wrong) from error


def _check_fields(value: Any, wanted: Any, where: str) -> None:
    known = {field.name: field.type for field in dataclasses.fields(wanted)}
    if not isinstance(value, dict):
        is_name = isinstance(value, str) and len(value) <= _LONGEST and "name" in known
        hint = f"; write {where}: {{name: {value}}}" if is_name else ""
        wrong = f"{where or 'the file'} must hold fields and values, got {_shown(value)}{hint}"
        raise ValueError(wrong)
    for name, item in value.items():
        full = f"{where}.{_name(name)}" if where else _name(name)
        if name not in known:
            near = difflib.get_close_matches(_name(name), known, n=1)
            hint = f"did you mean {near[0]}? Known" if near else "known"
            raise ValueError(f"unknown field {full}; {hint} here: {', '.join(known)}")
        _check(item, known[name], full)
    if hasattr(wanted, "check_keys"):
        wanted.check_keys(value.keys())
