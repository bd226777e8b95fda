"""Base class of effects: a name, a sentence, parameters, and SymPy formulas for what the effect changes.

A subclass sets `name`, `sentence` and `parameters` and overrides one or more of the methods below. Each gets
SymPy symbols (see `symbols.py`) and the effect's parameters as attributes of `p`, and returns SymPy
expressions. slipmap derives derivatives and machine code from them; nothing is differentiated by hand. If a
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
    """An unusable effect; the message names the effect, and the file and line if known."""


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes:
        name: a Python identifier.
        unit: SI; `1` for a dimensionless number.
        meaning: a few words for the reader.
        low: smallest value.
        high: largest value.
        scale: expected distance from `center`: the standard deviation of the prior.
        null: value at which the effect vanishes whatever the other parameters are; None for a parameter that
            only shapes the effect.
        start: first guess of a shaping parameter; its prior is centred there.
        weight_power: the scale is multiplied by this power of the object's weight in newtons, so that the
            prior on forces suits heavy and light objects alike.

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
        """The null, or the first guess if there is no null."""
        return self.start if self.null is None else self.null


@dataclass(frozen=True)
class Scene:
    """Summary of the recorded pushes, for effects that must guess where to start a search."""

    center: tuple[float, float]  # (2,) centre of the region that the object covered, m
    reach: float  # half the width of that region, m
    radius: float  # radius of the object about its frame's origin, m
    speed: float  # typical speed of the finger, m/s
    pushes: int  # number of pushes
    weight: float  # the object's weight from the first fit, N


class Effect:
    """Base of all effects; a subclass overrides only what it changes.

    Attributes:
        name: lower case with underscores.
        sentence: one sentence that says what the effect is.
        parameters: at least one has a null value.
        memory: names of numbers that the effect carries from step to step; they start at 0.
        belongs_to: where the effect originates. Several datasets share one set of parameters, unless the
            effect belongs to the object; then each has its own.

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

    def __repr__(self) -> str:
        return f"<effect {getattr(self, 'name', type(self).__name__)}>"

    def friction(self, cell: Any, p: Any) -> Any:
        """Factor on the friction of a cell; 1 without the effect."""
        return None

    def drag(self, cell: Any, p: Any) -> Any:
        """Force on a cell per unit speed, against its motion, N s/m; 0 without the effect."""
        return None

    def stretch(self, cell: Any, p: Any) -> Any:
        """(xx, xy, yy) of a cell's Q in the friction norm sqrt(uᵀ Q u), object frame; (1, 0, 1) without."""
        return None

    def force(self, body: Any, p: Any) -> Any:
        """(F_x, F_y, torque) on the object: world frame, N; about the object frame's origin, N m."""
        return None

    def downhill(self, body: Any, p: Any) -> Any:
        """(a_x, a_y): gravity along the table, world, m/s²; formulas may use the sum, `downhill_x`, `_y`."""
        return None

    def blade(self, body: Any, p: Any) -> Any:
        """(F, n_x, n_y, r_x, r_y): F newtons resist motion of the object's point r along unit vector n."""
        return None

    def pyramid(self, body: Any, p: Any) -> Any:
        """(c, d, angle): the friction norm |u| becomes c |u| + d (|u·e| + |u·n|), a pyramid.

        Unit vector e points at this angle in the world, n at right angles to it; (1, 0, 0) without.
        """
        return None

    def inertia(self, body: Any, p: Any) -> Any:
        """Factor on mass and moment of inertia (not on weight); 1 without the effect."""
        return None

    def compliance(self, body: Any, p: Any) -> Any:
        """Deflection of the finger per force, m/N, reached with a time constant of 10 ms; 0 without."""
        return None

    def remember(self, before: Any, after: Any, p: Any) -> Any:
        """Values after a step of the numbers named in `memory`."""
        return None

    def measured(self, pose: Any, p: Any) -> Any:
        """(x, y, theta) that the tracker reports for the true object pose `pose`."""
        return None

    def delay(self, p: Any) -> Any:
        """Delay of the tracker's poses, s; 0 without the effect."""
        return None

    def felt(self, force: Any, p: Any) -> Any:
        """(F_x, F_y) that the force sensor reports for the finger's true `force`, world, N."""
        return None

    def force_delay(self, p: Any) -> Any:
        """Delay of the sensor's forces, s; 0 without the effect."""
        return None

    def level(self, place: FloatArray, values: FloatArray) -> FloatArray:
        """(K,) factor on friction at a place (2,), world, m, outside any patch, for parameters (K, P).

        Total friction is reported with it, at the mean place of the pushes; 1 where friction does not depend
        on the place.
        """
        return np.ones(len(values))

    def starts(self, scene: Scene) -> list[dict[str, float]]:
        """Starting points of a search, for parameters without a null; those not named keep their `start`."""
        return [{}]

    def far_starts(self) -> list[dict[str, float]]:
        """Further starting points, for parameters with a null, where a search from the null may go astray.

        An angle, for instance, may be half a turn away.
        """
        return []

    @property
    def only_force(self) -> bool:
        """Whether the effect changes only the measured force."""
        return all(getattr(type(self), name) is getattr(Effect, name) for name in _OF_MOTION)

    @property
    def nulls(self) -> FloatArray:
        """(P,) parameters at which the effect vanishes; shaping parameters are at their start."""
        return np.array([parameter.center for parameter in self.parameters])

    @property
    def amplitudes(self) -> NDArray[np.bool_]:
        """(P,) which parameters have a null."""
        return np.array([parameter.null is not None for parameter in self.parameters])

    @property
    def signs(self) -> FloatArray:
        """(P,) 1 or -1 if a parameter's null is the low or high end of its range, else 0."""
        return np.array([float(p.center == p.low) - float(p.center == p.high) for p in self.parameters])

    def guesses(self, scene: Scene) -> list[dict[str, float]]:
        """What `starts` returns, checked against the parameters.

        Raises:
            EffectError: starts() failed, or returns anything but guesses of this effect's parameters.
        """
        given = call_formula(self, "starts", scene)
        if not (isinstance(given, list | tuple) and given and all(isinstance(g, Mapping) for g in given)):
            raise EffectError(
                f"effect {self.name}: starts() must return a list of one or more guesses, each a dict from"
                f" parameter names to numbers, got {given!r}"
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
        """(1 + F, P) the parameters (P,), then a copy with each of the `far_starts`."""
        rows = np.tile(values, (1 + len(self.far_starts()), 1))
        names = [parameter.name for parameter in self.parameters]
        for row, far in zip(rows[1:], self.far_starts(), strict=True):
            for name, value in far.items():
                row[names.index(name)] = value
        return rows

    def start_values(self, scene: Scene) -> FloatArray:
        """(G, P) `guesses` as arrays within the parameters' ranges; parameters not named are at `center`.

        Raises:
            EffectError: as `guesses`.
        """
        rows = [[guess.get(p.name, p.center) for p in self.parameters] for guess in self.guesses(scene)]
        return np.clip(np.array(rows, dtype=float), *bounds([self]))


def bounds(effects: Sequence[Effect]) -> tuple[FloatArray, FloatArray]:
    """(P,) lowest and highest values of the effects' parameters, joined."""
    every = [parameter for effect in effects for parameter in effect.parameters]
    return np.array([p.low for p in every]), np.array([p.high for p in every])


def columns_of(effect: Effect, effects: Sequence[Effect]) -> slice:
    """Columns of an effect's parameters among those of several effects, joined.

    Raises:
        ValueError: it is not among them.
    """
    names = [one.name for one in effects]
    first = sum(len(one.parameters) for one in effects[: names.index(effect.name)])
    return slice(first, first + len(effect.parameters))


def scales(effects: Sequence[Effect], weight: float) -> FloatArray:
    """(P,) prior standard deviations of the parameters for an object of the given weight, N."""
    return np.array([p.scale * weight**p.weight_power for effect in effects for p in effect.parameters])


def call_formula(effect: Effect, method: str, *arguments: Any) -> Any:
    """Result of one of the effect's methods.

    Raises:
        EffectError: it raised, or tried to exit; names the effect, the method, file and line.
    """
    try:
        return getattr(effect, method)(*arguments)
    except (EffectError, KeyboardInterrupt):
        raise
    except BaseException as error:  # sys.exit() would end the program silently
        said = failure(error)
        if isinstance(error, TypeError) and any(words in said for words in _OF_NUMPY):
            said += ". Formulas are symbolic: use sympy.cos and the like, not those of numpy or math"
        raise EffectError(f"effect {effect.name}: {method}() failed in {said}") from error


def failure(error: BaseException) -> str:
    """Location and message of a failure in an effect's code: `file, line n: Kind: text`."""
    try:
        said = " ".join(str(error).split())
    except Exception:  # an error of the user's own may fail to describe itself
        said = "no text"
    said = said if len(said) <= _LONGEST else f"{said[: _LONGEST - 3]}..."
    return f"{_failing_line(error)}: {type(error).__name__}: {said}"


def _failing_line(error: BaseException) -> str:
    """`file, line n` of an error's innermost frame outside this package and its libraries."""
    here = Path(__file__).parent
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        if frame.filename.startswith("<"):  # Python itself, such as "<frozen _sitebuiltins>"
            continue
        if "site-packages" not in path.parts and (path.parent != here or path.name == "library.py"):
            return f"{path.name}, line {frame.lineno}"
    return "unknown place"


_OF_MOTION = (
    "friction", "drag", "stretch", "force", "downhill", "blade", "pyramid", "inertia", "compliance",
    "remember", "measured", "delay",
)  # fmt: skip
"""Methods that change the motion of objects, or how it is measured."""

_OF_NUMPY = ("loop of ufunc does not support", "Cannot convert expression to float")
"""What functions of numpy and math say about symbols."""

_LONGEST = 400  # characters kept of an error message from an effect's code
