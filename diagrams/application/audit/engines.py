"""Engines that are audited: their interface, the built-in ones, and what they push.

An engine is a class. The audit makes one instance for each scene and direction of gravity, places the object
with `reset`, and advances with `step`; it only observes `pose`.
"""

from __future__ import annotations

import importlib.util
import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib import import_module, metadata
from numbers import Real
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np

from slipmap.models.effects.effect import failure
from slipmap.models.files import BadInput
from slipmap.models.geometry import placed, rotated
from slipmap.models.objects import cells_from_polygon
from slipmap.models.objects.footprints import convex_pieces
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.maps import Maps

AWAY = np.array([8.0, 8.0])  # finger position where it must not touch, m
SHORTEST_STEP, LONGEST_STEP = 1e-5, 0.02  # s
GRAVITY = 9.81
LEVEL = np.array([0.0, 0.0, -GRAVITY])
REST = np.zeros(3)


@dataclass(frozen=True, eq=False)
class EngineScene:
    """A flat rigid object on an infinite level table, and a round finger.

    Each cell rests on the table with its own weight m_i g, and the table resists its motion with mu_i m_i g.

    Attributes:
        grid: `grid.centers` (n, 2) and `grid.width` of the cells, `grid.exterior` (k, 2) of the outline,
            object frame, m.
        mass: (n,) of the cells, kg, each a square plate.
        mu: (n,) friction coefficients between the cells and the table.
        mu_finger: friction coefficient between outline and finger.
        finger_radius: m.
    """

    grid: CellGrid
    mass: FloatArray
    mu: FloatArray
    mu_finger: float
    finger_radius: float

    @property
    def pieces(self) -> list[FloatArray]:
        """Corners (k, 2) of convex polygons that together form the footprint, object frame, m."""
        return [np.asarray(piece.exterior.coords)[:-1] for piece in convex_pieces(self.grid.polygon)]

    @property
    def maps(self) -> Maps:
        """The maps as one hypothesis of the model."""
        return Maps(self.mass, self.mu, np.array([self.mu_finger]))

    @property
    def center_of_mass(self) -> FloatArray:
        """(2,) centre of mass, object frame, m."""
        return self.grid.center_of(self.mass)

    @property
    def mean_arm(self) -> float:
        """Mean distance of the mass from its centre, m."""
        return float(
            self.mass @ np.linalg.norm(self.grid.centers - self.center_of_mass, axis=1) / self.mass.sum()
        )

    @property
    def moment_of_inertia(self) -> float:
        """Moment of inertia about the vertical axis through the centre of mass, kg m²."""
        away = self.grid.centers - self.center_of_mass
        return float(self.mass @ ((away**2).sum(axis=1) + self.grid.width**2 / 6))


class Engine(Protocol):
    """One object on one table in a physics engine.

    Attributes:
        dt: time step, s, of the class. The audit also runs a subclass with half of it.

    Args:
        scene: what is simulated.
        gravity: (3,) acceleration, z up, m/s². It may be tilted.
    """

    dt: ClassVar[float]

    def __init__(self, scene: EngineScene, gravity: FloatArray) -> None: ...

    def reset(self, pose: FloatArray, velocity: FloatArray, tip: FloatArray) -> None:
        """Place the object on the table.

        Args:
            pose: (3,) x, y, θ of the object frame, world, m and rad.
            velocity: (3,) of the object frame's origin, world, m/s, and rad/s.
            tip: (2,) centre of the finger, world, m; far away where it must not touch.
        """

    def step(
        self, tip: FloatArray, tip_velocity: FloatArray, next_tip: FloatArray, next_velocity: FloatArray
    ) -> FloatArray:
        """Advance by dt while the finger, which nothing can stop, moves from `tip` to `next_tip`.

        Returns:
            (2,) force of the finger on the object, world, N.
        """

    def pose(self) -> FloatArray:
        """(3,) x, y, θ of the object frame, world, m and rad."""


class Subject:
    """An engine under audit.

    Args:
        name: as given by the user.
        kind: its class, see `Engine`.
        full_dt: the engine's own step where `kind` has half of it, s.

    Attributes:
        dt: its time step, s.
        full_dt: as the argument; `dt` where that is None.

    Raises:
        BadInput: the class lacks a part of `Engine`.
    """

    def __init__(self, name: str, kind: Any, full_dt: float | None = None) -> None:
        self.name, self.kind = name, kind
        missing = [part for part in ("reset", "step", "pose") if not callable(getattr(kind, part, None))]
        if missing:
            raise BadInput(f"engine {name}: it has no {' and no '.join(missing)}(); see docs/audit.md")
        dt = getattr(kind, "dt", None)
        if not (isinstance(dt, Real) and SHORTEST_STEP <= (full_dt or float(dt)) <= LONGEST_STEP):
            raise BadInput(
                f"engine {name}: its time step `dt` must be a number between {SHORTEST_STEP:g} and"
                f" {LONGEST_STEP:g} s, got {'none' if dt is None else repr(dt)}"
            )
        self.dt = float(dt)
        self.full_dt = full_dt or self.dt

    def halved(self) -> Subject:
        """The same engine at half its time step."""
        return Subject(self.name, type(self.kind.__name__, (self.kind,), {"dt": self.dt / 2}), self.dt)

    def lay(self, scene: EngineScene, gravity: FloatArray = LEVEL) -> Laid:
        """An engine with a scene, under a gravity (3,), m/s².

        Raises:
            BadInput: it cannot be made, or it does not use the step of its class.
        """
        engine = self.ask("__init__", self.kind, scene, np.array(gravity, dtype=float))
        if getattr(engine, "dt", None) != self.dt:
            raise BadInput(
                f"engine {self.name}: __init__ sets dt = {getattr(engine, 'dt', None)!r}, so it cannot run at"
                " half its step; make dt an attribute of the class, and use self.dt in the engine"
            )
        return Laid(self, engine, scene)

    def ask(self, method: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a method of the engine.

        Raises:
            BadInput: it fails; the message names method, file and line.
        """
        try:
            return function(*arguments)
        except (BadInput, KeyboardInterrupt):
            raise
        except BaseException as error:  # as by sys.exit()
            raise BadInput(f"engine {self.name}: {method}() failed in {failure(error)}") from error

    def ask_numbers(
        self, method: str, function: Callable[..., Any], length: int, *arguments: Any
    ) -> FloatArray:
        """Call a method of the engine that returns `length` numbers.

        Raises:
            BadInput: it fails, or returns something else.
        """
        value = self.ask(method, function, *arguments)
        try:
            numbers = np.array(value, dtype=float)
        except (TypeError, ValueError):
            numbers = np.zeros(0)
        if numbers.shape != (length,) or not np.isfinite(numbers).all():
            raise BadInput(
                f"engine {self.name}: {method}() must return {length} finite numbers, got {value!r:.80}"
            )
        return numbers


class Laid:
    """An engine with a scene, made by `Subject.lay`."""

    def __init__(self, subject: Subject, engine: Engine, scene: EngineScene) -> None:
        self._subject, self._engine, self._scene = subject, engine, scene

    def push(self, tip: FloatArray, pose: FloatArray, velocity: FloatArray = REST) -> FloatArray:
        """Poses (T + 1, 3) of the object frame in the world, with continuous angles, along a finger path.

        Args:
            tip: (T + 1, 2) centre of the finger at the ends of steps, world, m.
            pose, velocity: (3,) initial values of the object frame, world.

        Raises:
            BadInput: a method fails, or returns anything but finite numbers.
        """
        subject, engine = self._subject, self._engine
        pose, velocity = np.array(pose, dtype=float), np.array(velocity, dtype=float)
        speed = np.gradient(tip, subject.dt, axis=0)
        subject.ask("reset", engine.reset, pose.copy(), velocity.copy(), tip[0].copy())
        poses = [subject.ask_numbers("pose", engine.pose, 3)]
        off = poses[0] - pose
        off[2] = np.arctan2(np.sin(off[2]), np.cos(off[2]))
        if np.abs(off[:2]).max() > 1e-3 or abs(off[2]) > 0.01:
            raise BadInput(
                f"engine {subject.name}: after reset() at x, y, θ = {pose.round(4).tolist()}, pose() returns"
                f" {poses[0].round(4).tolist()}; both must be of the object frame in the world, m and rad"
            )
        for k in range(len(tip) - 1):
            path = (tip[k].copy(), speed[k].copy(), tip[k + 1].copy(), speed[k + 1].copy())
            subject.ask_numbers("step", engine.step, 2, *path)
            poses.append(subject.ask_numbers("pose", engine.pose, 3))
        result = np.array(poses)
        result[:, 2] = pose[2] + np.unwrap(result[:, 2] - pose[2])
        return result

    def slide(self, velocity: FloatArray, duration: float, start: FloatArray = REST) -> FloatArray:
        """(T + 1, 3) centre of mass and angle in the world of a released object; row k is at time k dt.

        Args:
            velocity: (3,) of the centre of mass, world, m/s, and rad/s.
            duration: s.
            start: (3,) centre of mass and angle at the start, world.
        """
        center = self._scene.center_of_mass
        arm = rotated(center, start[2])
        x, y, omega = velocity
        origin = np.array([x + omega * arm[1], y - omega * arm[0], omega])
        steps = round(duration / self._subject.dt)
        poses = self.push(np.tile(AWAY, (steps + 1, 1)), np.append(start[:2] - arm, start[2]), origin)
        return np.column_stack([placed(center, poses), poses[:, 2]])


OUTLINE = 1e-3 * np.array([[-81, -63], [81, -63], [81, -9], [-27, -9], [-27, 63], [-81, 63]])
"""(6, 2) corners of the L, m; cut into 39 cells of 18 mm."""

MU, MU_FINGER, FINGER_RADIUS = 0.35, 0.25, 6e-3
_CELLS = 39
_FOOT_ABOVE = -0.018  # m; cells above this y are of the other material


@cache
def plain_scene() -> EngineScene:
    """A uniform object with friction `MU`."""
    grid = cells_from_polygon(OUTLINE, count=_CELLS)
    n = len(grid)
    return EngineScene(grid, np.full(n, 1.0 / n), np.full(n, MU), MU_FINGER, FINGER_RADIUS)


def two_material_scene() -> EngineScene:
    """An L with a light rough leg on a heavy smooth foot."""
    grid = cells_from_polygon(OUTLINE, count=_CELLS)
    leg = grid.centers[:, 1] > _FOOT_ABOVE + 1e-6
    return EngineScene(grid, np.where(leg, 0.014, 0.034), np.where(leg, 0.5, 0.28), MU_FINGER, FINGER_RADIUS)


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
            "creep": "impratio of 10 to 100 in MuJoCo's <option> cures creep (mujoco:elliptic,impratio=100),"
            " though the price does not fall",
            "load_follows_slip": "against load that follows slip, no setting of MuJoCo is known that lowers"
            " the price (impratio lessens the defect but not the price, a smaller step raises the price, a"
            " shorter timeconst of contacts makes the defect worse)",
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
    return Subject(spec, _class_in(Path(file), kind))


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
            whole = word == "iterations"
            if not 0 < number < np.inf or (whole and number % 1):
                kind = "whole number" if whole else "number"
                raise BadInput(f"engine {spec}: {word} must be a positive {kind}, got {value!r}")
            chosen[word] = int(number) if whole else number
        else:
            known = [*engine.words, *(f"{name}=…" for name in engine.numbers)]
            raise BadInput(f"engine {spec}: there is no setting {setting!r}; there are {', '.join(known)}")
    if importlib.util.find_spec(_module(engine)) is None:
        extra = "slipmap" if engine.package == "drake" else "slipmap[bench]"
        raise BadInput(f"engine {spec}: {engine.package} is not installed; use `pip install '{extra}'`")
    module, _, name = engine.where.partition(":")
    return type(name, (getattr(import_module(f"{__package__}.{module}"), name),), chosen)


def _class_in(path: Path, name: str) -> Any:
    if not path.is_file() or path.stat().st_size > _LARGEST:
        raise BadInput(f"engine file {path}: there is no such file, or it is too large; check the name")
    # The name is the same in every process, as numba's cache keeps it.
    module_name = f"slipmap_engine_file_{sha256(str(path.resolve()).encode()).hexdigest()[:16]}"
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
        classes = [
            key
            for key, value in vars(module).items()
            if inspect.isclass(value) and value.__module__ == module_name
        ]
        said = (
            f"there is no class {name} in it; it" if name else "no class is named after the colon; the file"
        )
        raise BadInput(f"engine file {path}: {said} has {', '.join(classes) or 'none'}")
    return kind
