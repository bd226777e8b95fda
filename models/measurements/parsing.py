"""Parse files of measurements: bytes, JSON and YAML, and the numbers, texts and tables in them.

Files are bounded in size and never executed; every failure is a `DatasetError` that says where it occurred.
The checks are our own because libraries such as pydantic name field and type, but not row, unit and remedy.
"""

import hashlib
import json
import math
import re
import reprlib
import zlib
from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from itertools import chain
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import numpy as np
import yaml

from slipmap.models.files import UnreadableFile, read_bounded
from slipmap.models.measurements.trial import DatasetError
from slipmap.models.physics.cell_grid import FloatArray

_LARGEST_RECORD = 64 * 2**20  # bytes; ten minutes of three channels at 250 Hz are 30 MB
_LARGEST_YAML = 4 * 2**20  # bytes; 50,000 cells are 1.5 MB
_DEEPEST_YAML = 50
_MOST_FAULTS = 40  # in one message
BROKEN = (
    OSError, RuntimeError, ValueError, TypeError, LookupError, MemoryError, AttributeError, ArithmeticError,
    zlib.error,
)  # fmt: skip
"""Errors that libraries raise on unexpected files."""
NUMBER = r"-?\d+(\.\d+)?(e[-+]\d+)?"
"""Pattern of a number in a message."""
_LONGEST_NAME = 250  # characters up to which a path is given in full


def by_numbers(path: PurePath) -> tuple[list[list[str | int]], PurePath]:
    """Sort key of paths by their names, in which numbers count by value: push_2 comes before push_10."""
    names = [re.split("([0-9]+)", part) for part in path.parts]  # words and numbers take turns
    return [[int(text) if k % 2 else text for k, text in enumerate(name)] for name in names], path


def read_bytes(path: Path, largest: int = _LARGEST_RECORD) -> bytes:
    """The content of a regular file of at most `largest` bytes."""
    try:
        return read_bounded(path, largest)
    except UnreadableFile as error:
        where = str(path)
        whole = where.isprintable() and len(where) < _LONGEST_NAME
        raise DatasetError(f"{where if whole else shown(where)}: {error}") from None


@contextmanager
def reading(where: str, kind: str, errors: tuple[type[Exception], ...] = BROKEN) -> Iterator[None]:
    """Report errors of a library that reads a kind of file as DatasetError."""
    try:
        yield
    except DatasetError:
        raise
    except errors as error:
        shown = shown_error(error)
        raise DatasetError(f"{where}: not readable as {kind} ({shown}); was the file cut short?") from None


def parse_json(content: bytes, where: str) -> Any:
    """Parse a JSON document; NaN is allowed, a repeated key is not."""
    try:
        return json.loads(content, object_pairs_hook=_unrepeated)
    except RecursionError:
        raise DatasetError(f"{where}: nested too deeply to be a list of rows") from None
    except ValueError as error:
        raise DatasetError(
            f"{where}: not valid JSON ({shown_error(error)}); was the file cut short?"
        ) from None


def _unrepeated(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        name, _ = Counter(name for name, _ in pairs).most_common(1)[0]
        raise ValueError(f"the key {shown(name)} appears twice")
    return result


def read_yaml(path: Path, where: str) -> tuple[bytes, dict[str, Any]]:
    """The content of a YAML file, and the mapping of plain data in it; `where` names it in error messages."""
    content = read_bytes(path, _LARGEST_YAML)
    try:
        if _depth(content) > _DEEPEST_YAML:
            raise DatasetError(f"{where}: nested too deeply for a description of a dataset")
        document = yaml.load(content, Loader=_PlainLoader)
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, LookupError, OverflowError) as error:
        mark = getattr(error, "problem_mark", None)
        tab = mark is not None and b"\t" in b"".join(content.splitlines()[mark.line : mark.line + 1])
        hint = "; indent with spaces, not with a tab" if tab else ""
        raise DatasetError(f"{where}: not valid YAML ({shown_error(error)}){hint}") from None
    return content, mapping(document, where)


def _depth(content: bytes) -> int:
    """Nesting depth of a YAML document, up to one more than allowed. The compiled loader would crash."""
    depth = 0
    try:
        for event in yaml.parse(content, Loader=_Loader):
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
                if depth > _DEEPEST_YAML:
                    break
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
    except yaml.MarkedYAMLError as error:
        # libyaml from 0.2.6 on has its own limit, far above ours, and hits it while looking ahead.
        if "nesting depth" in (error.problem or ""):
            return _DEEPEST_YAML + 1
        raise
    return depth


_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _PlainLoader(_Loader):
    """Safe loader without merge keys, which can grow without bound, and without repeated keys."""

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        for key, _ in node.value:
            if key.tag == "tag:yaml.org,2002:merge":
                raise yaml.constructor.ConstructorError(problem="merge keys (<<) are not part of the format")
        super().flatten_mapping(node)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        names: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in names:
                    line = key.start_mark.line + 1
                    raise yaml.constructor.ConstructorError(
                        problem=f"the key {shown(key.value)} appears twice, again in line {line}"
                    )
                names.add(key.value)
        return super().construct_mapping(node, deep)


class Fingerprint:
    """sha256 over named contents, in the order in which they are added."""

    def __init__(self) -> None:
        self._digest = hashlib.sha256()

    def add(self, name: str, content: bytes) -> None:
        """Add a file under a name that does not depend on the dataset's location."""
        encoded = name.encode("utf-8", "surrogatepass")
        self._digest.update(f"{len(encoded)} {len(content)} ".encode() + encoded)
        self._digest.update(content)

    def hexdigest(self) -> str:
        """The fingerprint so far, 64 hexadecimal digits."""
        return self._digest.hexdigest()


def all_faults(faults: Sequence[str], count: int, what: str) -> DatasetError:
    """One error with everything that is wrong with some of `count` files or recordings (`what`)."""
    unique = grouped(faults, NUMBER)
    if len(set(faults)) == 1:
        return DatasetError(faults[0])
    more = f"; and {len(unique) - _MOST_FAULTS} more" if len(unique) > _MOST_FAULTS else ""
    listed = "; ".join(unique[:_MOST_FAULTS])
    return DatasetError(f"{len(faults)} of {count} {what} cannot be used: {listed}{more}")


def grouped(texts: Iterable[str], varies: str = "$^") -> list[str]:
    """Each text once; texts that differ only before the first colon, or after it in the name of their file,
    become one text that names them all.

    Args:
        varies: pattern of what may differ too; the words are then those about the first.
    """
    alike: dict[str, list[tuple[str, str]]] = {}
    for text in dict.fromkeys(texts):
        place, colon, complaint = text.partition(": ")
        file = Path(place.partition(", ")[0])
        anyones = complaint.replace(file.name, "the file") if file.suffix else complaint
        alike.setdefault(re.sub(varies, "#", anyones) if colon else text, []).append((text, anyones))
    return [_together(*zip(*each, strict=True)) for each in alike.values()]


def _together(texts: Sequence[str], anyones: Sequence[str]) -> str:
    if len(texts) == 1:
        return texts[0]
    places = listed([text.partition(": ")[0] for text in texts], _MOST_FAULTS)
    return f"{places}: {'' if len(set(anyones)) == 1 else 'in the first, '}{anyones[0]}"


def mapping(value: object, where: str) -> dict[str, Any]:
    """A mapping with text keys."""
    if not isinstance(value, dict):
        raise DatasetError(f"{where}: must be a mapping of keys to values, got {shown(value)}")
    for key in value:
        if not isinstance(key, str):
            raise DatasetError(f"{where}: keys must be text, got {shown(key)}")
    return value


def required(fields: dict[str, Any], key: str, where: str, hint: str) -> Any:
    """The value of a key that must be there."""
    if fields.get(key) is None:
        raise DatasetError(f"{where}: `{key}` is missing; {hint}")
    return fields[key]


def section(value: object, known: Iterable[str], where: str, warnings: list[str]) -> dict[str, Any]:
    """A mapping, with a warning for each unknown key."""
    fields = mapping(value, where)
    warnings += unknown_keys(fields, known, where)
    return fields


def unknown_keys(fields: Iterable[str], known: Iterable[str], where: str) -> list[str]:
    """One warning for each unknown key, most likely a typing error."""
    known = sorted(known)
    return [
        f"{where}: the key {shown(key)} is unknown and ignored{_near(key, known)} (known: {', '.join(known)})"
        for key in sorted(set(fields) - set(known))
    ]


def _near(key: str, known: Sequence[str]) -> str:
    near = get_close_matches(key, [name for name in known if name[0] == key[:1]], n=1)  # no weight for height
    return f"; did you mean {near[0]}?" if near else ""


def text(value: object, where: str) -> str:
    """A text."""
    if not isinstance(value, str):
        raise DatasetError(f"{where}: must be text, got {shown(value)}")
    return value


def read_as_text(value: object) -> str:
    """How to write a number that YAML reads as text, such as 1e6, 5e-3 or -.5; empty for other values."""
    try:
        result = float(value) if isinstance(value, str) and len(value) < 40 else math.nan
    except ValueError:
        return ""
    if not math.isfinite(result):
        return ""
    whole = result.is_integer() and abs(result) < 1e9
    return f", which is read as text; write {yaml.safe_dump(int(result) if whole else result).split()[0]}"


def _other(value: object, where: str, wanted: str) -> DatasetError:
    """An error that says what a value must be; a key without a value is missing."""
    if value is None:
        return DatasetError(f"{where} is missing; it must be {wanted}")
    return DatasetError(f"{where}: must be {wanted}, got {shown(value)}{read_as_text(value)}")


def number(value: object, where: str) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _other(value, where, "a number")
    result = _as_float(value, where)
    if not math.isfinite(result):
        raise DatasetError(f"{where}: must be a finite number, got {result}")
    return result


class Number(NamedTuple):
    """Unit and limits of a number in a description."""

    unit: str  # for error messages; empty for a ratio
    # low, high: the limits
    low: float = 0.0
    high: float = math.inf
    # message for a number beyond them; a format string over the attributes, `where` and `value`
    beyond: str = "{where}: must lie between {low:g} and {high:g}{unit}, got {value:g}"
    or_zero: bool = False  # whether 0 is allowed; otherwise only positive numbers are

    def read(self, value: object, where: str) -> float:
        """Check a parsed value and return it as a number."""
        result = number(value, where)
        if result <= 0 and not self.or_zero:
            unit = f" ({self.unit})" if self.unit else ""
            raise DatasetError(f"{where}: must be positive{unit}, got {result}")
        if not self.low <= result <= self.high:
            attributes = {**self._asdict(), "unit": f" {self.unit}" if self.unit else ""}
            raise DatasetError(self.beyond.format(where=where, value=result, **attributes))
        return result


def pair(value: object, where: str) -> tuple[float, float]:
    """Two finite numbers."""
    if not isinstance(value, list) or len(value) != 2 or None in value:
        raise _other(value, where, "two numbers [a, b]")
    return number(value[0], where), number(value[1], where)


_CELLS = {int, float, type(None)}


def table(value: object, columns: int, where: str) -> FloatArray:
    """(n, columns) numbers from a list of rows; None becomes NaN, which JSON cannot express."""
    if not isinstance(value, list):
        raise _other(value, where, "a list of rows")
    if set(map(type, value)) - {list}:
        row = next(row for row, cells in enumerate(value) if not isinstance(cells, list))
        raise DatasetError(
            f"{where}, row {row}: must be a list of {columns} numbers, got {shown(value[row])}"
        )
    if set(map(len, value)) - {columns}:
        row = next(row for row, cells in enumerate(value) if len(cells) != columns)
        raise DatasetError(f"{where}, row {row}: needs {columns} columns, has {len(value[row])}")
    if set(map(type, chain.from_iterable(value))) - _CELLS:
        row, cell = next(
            (row, cell) for row, cells in enumerate(value) for cell in cells if type(cell) not in _CELLS
        )
        raise DatasetError(f"{where}, row {row}: must hold numbers, got {shown(cell)}{read_as_text(cell)}")
    try:
        return np.array(value, dtype=float).reshape(-1, columns)
    except OverflowError:
        for row, cells in enumerate(value):
            for cell in cells:
                _as_float(cell or 0, f"{where}, row {row}")
        raise


def _as_float(value: int | float, where: str) -> float:
    try:
        return float(value)
    except OverflowError:
        raise DatasetError(f"{where}: {shown(value)} is too large for a measured number") from None


class _Short(reprlib.Repr):
    """Representation of values in a few dozen characters, however large or nested they are."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 2
        self.maxlist = self.maxdict = 4
        self.maxstring = self.maxother = 60

    def repr_int(self, value: int, level: int) -> str:
        """Show an integer; the digits of one beyond 64 bits would not help, and Python may refuse them."""
        return repr(value) if value.bit_length() <= 64 else f"an integer of {value.bit_length()} bits"


def shown(value: object) -> str:
    """A value for an error message, in a few dozen characters."""
    return _Short().repr(value)


def shown_error(error: Exception) -> str:
    """The message of a library's exception on one line of bounded length; where it quotes an input string,
    only line and column are kept."""
    message = " ".join(re.sub(r'in "<(byte|unicode) string>", ', "", str(error)).split())
    return message if len(message) <= 200 else message[:197] + "..."


def rounded(value: float, digits: int) -> str:
    """A number with so many significant digits, and no power of ten below a million."""
    return f"{float(f'{value:.{digits}g}'):g}"


def listed(names: Sequence[str], most: int = 5) -> str:
    """The first names of a list, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def push_label(text: str) -> str:
    """The label of a push in a form that files can share: 1.0 and 01 become 1."""
    number = re.fullmatch(r"0*(\d+)(?:[.,]0*)?", text.strip())
    return number[1] if number else text.strip()


def number_in(cell: str, where: str) -> float:
    """The number in a cell of a table, without Python's underscores.

    Raises:
        DatasetError: the cell is not a number; the message names the place.
    """
    try:
        if "_" in cell:
            raise ValueError
        return float(cell)
    except ValueError:
        raise DatasetError(
            f"{where}: {shown(cell)} is not a number; leave the cell empty if nothing was measured"
        ) from None
