"""What an effect is: a name, a sentence, parameters, and formulas in SymPy for what it changes.

A subclass gives `name`, `sentence` and `parameters` and overrides one or more of the methods below. Each gets
SymPy symbols (see `symbols.py`) and the effect's parameters as attributes of `p`, and returns SymPy
expressions. Derivatives and machine code are made from them; nothing is differentiated by hand. Where a
method fails, an `EffectError` names the file and the line.
"""

import math
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from slipmap.models.physics.cell_grid import FloatArray

Owner = Literal["object", "table", "tracker", "finger", "force sensor"]


class EffectError(ValueError):
    """An effect that cannot be used; the message names the effect, and file and line where known."""


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes:
        name: a Python identifier.
        unit: SI, `1` where it has none.
        meaning: for a person, a few words.
        low: smallest value.
        high: largest value.
        scale: how far from `center` it is expected to be: the standard deviation of its prior.
        null: value at which the effect vanishes whatever the other parameters are; None for a parameter that
            shapes the effect and means nothing without it.
        start: first guess of a parameter that shapes; its prior is centred there.
        weight_power: the scale is multiplied by this power of the object's weight in newtons, so that forces
            are as likely for a heavy object as for a light one.

    Example:
        >>> import slipmap
        >>> thrust = slipmap.Parameter("thrust", "N", "of the air", -5.0, 5.0, 0.2, null=0.0)
        >>> thrust.unit, thrust.null
        ('N', 0.0)
    """

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    scale: float
    null: float | None = None
    start: float = 0.0
    weight_power: float = 0.0

    @property
    def center(self) -> float:
        """The null, or the first guess of a parameter without one."""
        return self.start if self.null is None else self.null


@dataclass(frozen=True)
class Scene:
    """What the recorded pushes look like, for effects that have to guess where to begin."""

    center: tuple[float, float]  # (2,) middle of the places at which the object was, m
    reach: float  # half the width of those places, m
    radius: float  # of the object about its frame's origin, m
    speed: float  # that the finger typically had, m/s
    pushes: int  # their number
    weight: float  # of the object as first fitted, N


class Effect:
    """Base of all effects; a subclass overrides what it changes and leaves the rest.

    Attributes:
        name: lower case with underscores.
        sentence: what it is, for a person.
        parameters: at least one with a null value.
        memory: names of numbers that the effect carries from step to step; they start at 0.
        belongs_to: what has the effect: datasets of several objects share it where they share that, and have
            parameters of their own where it is the object's.

    Example:
        >>> import slipmap
        >>> class Fan(slipmap.Effect):
        ...     name = "fan"
        ...     sentence = "A fan blows along x."
        ...     parameters = (slipmap.Parameter("thrust", "N", "of the air", -5.0, 5.0, 0.2, null=0.0),)
        ...     def force(self, body, p):
        ...         return p.thrust, 0, -body.com_y * p.thrust
        >>> Fan().name
        'fan'
    """

    name: ClassVar[str]
    sentence: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    memory: ClassVar[tuple[str, ...]] = ()
    belongs_to: ClassVar[Owner] = "object"

    def friction(self, cell: Any, p: Any) -> Any:
        """Factor on the friction of a cell, 1 without the effect."""
        return None

    def drag(self, cell: Any, p: Any) -> Any:
        """Force on a cell per speed, against its motion, N s/m; 0 without the effect."""
        return None

    def stretch(self, cell: Any, p: Any) -> Any:
        """(xx, xy, yy) of a cell's Q in the friction norm sqrt(uᵀ Q u), object frame; (1, 0, 1) without."""
        return None

    def force(self, body: Any, p: Any) -> Any:
        """(F_x, F_y, torque) on the object: world frame, N; about the object frame's origin, N m."""
        return None

    def blade(self, body: Any, p: Any) -> Any:
        """(F, n_x, n_y, r_x, r_y): F newtons resist motion of the object's point r along a unit vector n."""
        return None

    def pyramid(self, body: Any, p: Any) -> Any:
        """(c, d, angle): friction's norm |u| becomes c |u| + d (|u·e| + |u·n|), a pyramid's.

        Of the unit vectors e is at the angle in the world, n across it; (1, 0, 0) without.
        """
        return None

    def inertia(self, body: Any, p: Any) -> Any:
        """Factor on mass and moment of inertia (not on weight), 1 without the effect."""
        return None

    def compliance(self, body: Any, p: Any) -> Any:
        """How far the finger gives way to a force, m/N; 0 without the effect."""
        return None

    def remember(self, before: Any, after: Any, p: Any) -> Any:
        """The numbers named in `memory` after a step."""
        return None

    def measured(self, pose: Any, p: Any) -> Any:
        """(x, y, theta) that the tracker reports where the object truly is at `pose`."""
        return None

    def delay(self, p: Any) -> Any:
        """By how much the tracker's poses are late, s; 0 without the effect."""
        return None

    def felt(self, force: Any, p: Any) -> Any:
        """(F_x, F_y) that the force sensor reports where the finger truly pushes with `force`, world, N."""
        return None

    def force_delay(self, p: Any) -> Any:
        """By how much the sensor's forces are late, s; 0 without the effect."""
        return None

    def starts(self, scene: Scene) -> list[dict[str, float]]:
        """Guesses of the parameters without a null to begin a search from; others keep their start."""
        return [{}]

    def far_starts(self) -> list[dict[str, float]]:
        """Values of parameters with a null from which a search begins too, where the way from there may lead
        astray; an angle may have to turn by half a turn."""
        return []

    @property
    def only_force(self) -> bool:
        """Whether it changes nothing but the measured force."""
        return all(getattr(type(self), name) is getattr(Effect, name) for name in _OF_MOTION)

    @property
    def nulls(self) -> FloatArray:
        """(P,) parameters at which the effect vanishes, those that shape it at their start."""
        return np.array([parameter.center for parameter in self.parameters])

    @property
    def amplitudes(self) -> NDArray[np.bool_]:
        """(P,) which parameters have a null."""
        return np.array([parameter.null is not None for parameter in self.parameters])

    @property
    def signs(self) -> FloatArray:
        """(P,) 1 or -1 where a parameter's null is an end of its range: it can only grow or fall; else 0."""
        return np.array([float(p.center == p.low) - float(p.center == p.high) for p in self.parameters])

    def guesses(self, scene: Scene) -> list[dict[str, float]]:
        """What `starts` returns, checked against the parameters.

        Raises:
            EffectError: starts() failed, or gives something else than guesses of this effect's parameters.
        """
        given = call_formula(self, "starts", scene)
        if not (isinstance(given, list | tuple) and given and all(isinstance(g, Mapping) for g in given)):
            raise EffectError(
                f"effect {self.name}: starts() must return a list of one or more guesses, each a dict from"
                f" names of parameters to numbers, got {given!r}"
            )
        names = [parameter.name for parameter in self.parameters]
        for name, value in (item for guess in given for item in guess.items()):
            if name not in names:
                raise EffectError(
                    f"effect {self.name}: starts() names {name!r}; its parameters are {', '.join(names)}"
                )
            if not (isinstance(value, Real) and math.isfinite(value)):
                raise EffectError(
                    f"effect {self.name}: starts() gives {name} = {value!r}; it must be a finite number"
                )
        return [dict(guess) for guess in given]

    def with_far_starts(self, values: FloatArray) -> FloatArray:
        """(1 + F, P) parameters (P,), and the same with each of the `far_starts`."""
        rows = np.tile(values, (1 + len(self.far_starts()), 1))
        names = [parameter.name for parameter in self.parameters]
        for row, far in zip(rows[1:], self.far_starts(), strict=True):
            for name, value in far.items():
                row[names.index(name)] = value
        return rows

    def start_values(self, scene: Scene) -> FloatArray:
        """(G, P) `guesses` as arrays within the parameters' ranges; what they do not name at its `center`.

        Raises:
            EffectError: as `guesses`.
        """
        rows = [[guess.get(p.name, p.center) for p in self.parameters] for guess in self.guesses(scene)]
        return np.clip(np.array(rows, dtype=float), *bounds([self]))


def bounds(effects: Sequence[Effect]) -> tuple[FloatArray, FloatArray]:
    """(P,) lowest and highest values of the parameters of some effects, one after the other."""
    every = [parameter for effect in effects for parameter in effect.parameters]
    return np.array([p.low for p in every]), np.array([p.high for p in every])


def scales(effects: Sequence[Effect], weight: float) -> FloatArray:
    """(P,) prior standard deviations of the parameters for an object of some weight, N."""
    return np.array([p.scale * weight**p.weight_power for effect in effects for p in effect.parameters])


def call_formula(effect: Effect, method: str, *arguments: Any) -> Any:
    """Result of one of the effect's methods.

    Raises:
        EffectError: it raised, or wanted to end the program; names the effect, the method, file and line.
    """
    try:
        return getattr(effect, method)(*arguments)
    except (EffectError, KeyboardInterrupt):
        raise
    except BaseException as error:  # as by sys.exit(), which would end the program without a word
        raise EffectError(f"effect {effect.name}: {method}() failed in {failure(error)}") from error


def failure(error: BaseException) -> str:
    """Where and with what an effect's code failed: `file, line n: Kind: text`."""
    try:
        said = " ".join(str(error).split())
    except Exception:  # an error of the user's own may fail to describe itself
        said = "no text"
    said = said if len(said) <= _LONGEST else f"{said[: _LONGEST - 3]}..."
    return f"{_failing_line(error)}: {type(error).__name__}: {said}"


def _failing_line(error: BaseException) -> str:
    """`file, line n` of the innermost frame of an error that is outside this package and its libraries."""
    here = Path(__file__).parent
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        if frame.filename.startswith("<"):  # of Python itself, as "<frozen _sitebuiltins>"
            continue
        if "site-packages" not in path.parts and (path.parent != here or path.name == "library.py"):
            return f"{path.name}, line {frame.lineno}"
    return "unknown place"


_OF_MOTION = (
    "friction", "drag", "stretch", "force", "blade", "inertia", "compliance", "remember", "measured", "delay",
)  # fmt: skip
"""Methods of what changes how objects move, or what is seen of it."""

_LONGEST = 400  # characters of what an error in an effect's code may say
