"""Checks of settings and arguments; settings dataclasses of scenario files, whose fields have a range."""

import math
from collections.abc import Collection, Sequence
from dataclasses import field, fields
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray


def check_choice(name: str, value: object, choices: Sequence[object]) -> None:
    """Raise ValueError, with the choices, for a value that is none of them."""
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(map(str, choices))}, got {value!r}")


def check_whole(name: str, value: object, least: int) -> None:
    """Raise ValueError for a value that is no whole number, or below the least."""
    if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")


def check_positive(name: str, value: float | None, unit: str) -> None:
    """Raise ValueError for anything but a positive and finite number."""
    if not (isinstance(value, Real) and 0 < value < math.inf):
        raise ValueError(f"{name} must be positive and finite, got {value} {unit}")


def check_not_negative(name: str, value: float, unit: str) -> None:
    """Raise ValueError for anything but zero and positive finite numbers."""
    if not (isinstance(value, Real) and 0 <= value < math.inf):
        raise ValueError(f"{name} must be finite and not negative, got {value} {unit}")


def check_kind(name: str, value: object, kind: type, source: str) -> None:
    """Raise TypeError for a value of another kind; the message says where to get one of this kind."""
    if not isinstance(value, kind):
        got = "None" if value is None else f"a {type(value).__name__}"
        raise TypeError(f"{name} must be a {kind.__name__}, {source}; got {got}")


def check_several(name: str, value: object, source: str) -> None:
    """Raise TypeError for a single object, or a generator, where several are wanted; the message says where
    to get them."""
    if not isinstance(value, Collection):
        raise TypeError(f"{name} must be a list, {source}; got one {type(value).__name__}")


def finite_array(name: str, values: "ArrayLike", shape: tuple[int, ...]) -> "NDArray[np.float64]":
    """The values as an array.

    Raises:
        ValueError: another shape, or a number that is not finite.
    """
    import numpy as np

    array = np.asarray(values, dtype=float)
    if array.shape != shape:
        raise ValueError(f"{name} must be of shape {shape}, got {array.shape}")
    for value in array[~np.isfinite(array)]:
        raise ValueError(f"{name} must be finite, got {value}")
    return array


THICKEST_FINGER = 0.5  # m, radius
TOO_THICK = "{where} is {value:g} m; no finger is that thick, divide by 1000?"


def check_finger_radius(name: str, radius: float) -> None:
    """Raise ValueError for a radius, m, that no finger has."""
    check_positive(name, radius, "m")
    if radius > THICKEST_FINGER:
        raise ValueError(TOO_THICK.format(where=name, value=radius))


def within(default: float, least: float, largest: float) -> Any:
    """A field of a settings dataclass that must lie between two values; see `check_ranges`."""
    return field(default=default, metadata={"range": (least, largest)})


def check_ranges(settings: Any, section: str) -> None:
    """Refuse settings with a field made by `within` that is out of range.

    Args:
        section: prefix of the field's name in the message, such as `execution.` or `goals: `.

    Raises:
        ValueError: names the field, its range and its value; NaN is in no range.
    """
    for item in fields(settings):
        least, largest = item.metadata.get("range", (None, None))
        value = getattr(settings, item.name)
        if least is not None and not least <= value <= largest:
            raise ValueError(f"{section}{item.name} must lie between {least} and {largest}, got {value}")


class CheckedSettings:
    """Base of settings dataclasses that refuse values out of range on construction."""

    _section = ""

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Raise ValueError if a field is out of range."""
        check_ranges(self, self._section)
