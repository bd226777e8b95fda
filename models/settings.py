"""What the settings of a scenario file have in common: each says which of its fields is out of range."""

from __future__ import annotations


def check_ranges(settings: object, section: str, **ranges: tuple[float, float]) -> None:
    """Refuse settings of which a field lies outside of its range.

    Args:
        settings: dataclass with the fields.
        section: what stands before a field's name in the message, such as `execution.` or `goals: `.
        ranges: least and largest value of each field.

    Raises:
        ValueError: names the field, its range and its value; NaN is in no range.
    """
    for name, (least, largest) in ranges.items():
        value = getattr(settings, name)
        if not least <= value <= largest:
            raise ValueError(f"{section}{name} must lie between {least} and {largest}, got {value}")
