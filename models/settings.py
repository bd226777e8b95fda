"""Settings dataclasses of scenario files: fields with a range, and the check of that range."""

from dataclasses import field, fields
from typing import Any


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
