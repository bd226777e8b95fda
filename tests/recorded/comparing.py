"""What differs between a recording and what a command does now.

Numbers may differ as another processor rounds otherwise, and by nothing more: those of a JSON document by
`RELATIVE`, those of a text by one in the last digit that is printed, if that is a fraction or has a unit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

RELATIVE = 1e-6
SMALL = 1e-9
"""A number of a document below this is a zero that rounding has moved."""

_NUMBER = re.compile(r"[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_UNIT = re.compile(r"\s?(?:%|°|mm|ms|cm|kg|g|N|s)(?![\w])")
_BLANKS = re.compile(r"\s+")


def differences(wanted: Any, got: Any, where: str = "") -> Iterator[str]:
    """One line for each difference: the place, what was wanted, and what came."""
    if isinstance(wanted, dict) and isinstance(got, dict):
        for key in sorted({*wanted, *got}):
            place = f"{where}.{key}" if where else key
            if key not in got:
                yield f"{place}: is missing, wanted {_short(wanted[key])}"
            elif key not in wanted:
                yield f"{place}: is new, got {_short(got[key])}"
            else:
                yield from differences(wanted[key], got[key], place)
    elif isinstance(wanted, list) and isinstance(got, list):
        yield from _of_lists(wanted, got, where)
    elif _are_numbers(wanted, got):
        if not math.isclose(wanted, got, rel_tol=RELATIVE, abs_tol=SMALL):
            yield f"{where}: wanted {wanted!r}, got {got!r}"
    elif isinstance(wanted, str) and isinstance(got, str):
        if not same_line(wanted, got):
            yield f"{where}:\n    wanted {wanted!r}\n    got    {got!r}"
    elif type(wanted) is not type(got) or wanted != got:
        yield f"{where}: wanted {_short(wanted)}, got {_short(got)}"


def same_line(wanted: str, got: str) -> bool:
    """Whether two lines of text are the same but for how their numbers are rounded."""
    if wanted == got:
        return True
    ours, theirs = list(_NUMBER.finditer(wanted)), list(_NUMBER.finditer(got))
    between = [_NUMBER.split(line) for line in (wanted, got)]
    if [len(m.group()) for m in ours] != [len(m.group()) for m in theirs]:
        # One digit more moves what stands beside it.
        between = [[_BLANKS.sub(" ", part) for part in parts] for parts in between]
    if between[0] != between[1]:
        return False
    return all(_same_number(a, b) for a, b in zip(ours, theirs, strict=True))


def _same_number(wanted: re.Match[str], got: re.Match[str]) -> bool:
    if wanted.group() == got.group():
        return True
    ours, theirs = wanted.group().replace("−", "-"), got.group().replace("−", "-")
    digits = [_last_digit(text) for text in (ours, theirs)]
    if digits == [0, 0] and not _UNIT.match(wanted.string, wanted.end()):
        return False  # a count
    return abs(float(ours) - float(theirs)) <= 1.001 * 10.0 ** max(digits)


def _last_digit(number: str) -> int:
    """The power of ten of a number's last digit."""
    digits, _, power = number.partition("e")
    return int(power or 0) - len(digits.partition(".")[2])


def _of_lists(wanted: list[Any], got: list[Any], where: str) -> Iterator[str]:
    """Of two lists: entry by entry, or of lines of text: where they part, and how many there are."""
    lines = all(isinstance(entry, str) for entry in (*wanted, *got))
    if len(wanted) != len(got):
        yield f"{where}: wanted {len(wanted)} {'lines' if lines else 'entries'}, got {len(got)}"
    for number, (one, other) in enumerate(zip_longest(wanted, got)):
        place = f"{where}, line {number + 1}" if lines else f"{where}[{number}]"
        found = list(differences(one, other, place))
        yield from found
        if found and len(wanted) != len(got):
            return  # all that follows is moved


def _are_numbers(*values: Any) -> bool:
    """Whether one is a fraction and all are numbers; whole numbers are counts, and equal or not."""
    kinds = [type(value) for value in values]
    return float in kinds and all(kind in (int, float) for kind in kinds)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 200 else f"{text[:200]}…"
