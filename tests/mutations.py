"""Files spoilt at random, and what reading them may do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

STRANGE = [
    b"\x00",
    b"\xff\xff\xff\xff",
    b"\x7f\xff\xff\xff",
    b"\x80",
    b"\n",
    b" ",
    b"-",
    b"1e400",
    b"nan",
    b"inf",
]
STRANGE += [b"9" * 20, b"9" * 5000, b"-1", b"0", b'"', b"#", b"\xc3\x28", b"/dev/zero", b"../x"]


def spoilt(content: bytes, count: int, more: Sequence[bytes] = (), seed: int = 0) -> Iterator[bytes]:
    """`count` versions with one to three changes each: bytes, ranges cut or repeated, strange words."""
    rng = np.random.default_rng(seed)
    words = [*STRANGE, *more]
    for _ in range(count):
        data = bytearray(content)
        for _ in range(rng.integers(1, 4)):
            place = int(rng.integers(0, len(data) + 1))
            length = int(rng.integers(1, max(2, len(data) // 4)))
            change = rng.integers(0, 7)
            if change == 0 and place < len(data):
                data[place] = int(rng.integers(0, 256))
            elif change == 1:
                data[place : place + 4] = rng.bytes(4)
            elif change == 2:
                del data[place : place + length]
            elif change == 3:
                data[place:place] = data[place : place + length]
            elif change == 4:
                del data[place:]
            elif change == 5:
                data[place:place] = words[rng.integers(0, len(words))]
            else:
                word = words[rng.integers(0, len(words))]
                data[place : place + len(word)] = word
        yield bytes(data)


def refusals(
    files: Iterator[bytes], read: Callable[[bytes], object], documented: type[Exception]
) -> tuple[int, int]:
    """Files that were read and refused; each in one paragraph, with no other exception."""
    read_well = refused = 0
    for content in files:
        try:
            read(content)
            read_well += 1
        except documented as error:
            refused += 1
            assert "\n" not in str(error).strip(), str(error)
            assert len(str(error)) < 1500, str(error)
    return read_well, refused
