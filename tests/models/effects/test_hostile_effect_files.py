"""Any effect file, whatever it contains, soon gives effects or an EffectError."""

from __future__ import annotations

import sys
import warnings

import pytest
from test_effect_files import GOOD

from slipmap.models.effects import EffectError
from slipmap.models.effects.registry import load_effects
from tests.mutations import refusals, spoilt

WORDS = tuple(
    b"body|p.|sp.|sp.sqrt(|self|return |None|()|lambda: |Effect|    |raise SystemExit\n|1/0|sp.oo|sp.nan|sp.I"
    b"|**-1|**0.5|name|True|[]".split(b"|")
)


@pytest.fixture
def read(tmp_path):
    path = tmp_path / "magnet.py"

    def from_bytes(content: bytes) -> object:
        path.write_bytes(content)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # as of a string with a strange escape
            try:
                return load_effects(path)
            except EffectError as error:
                assert str(error).startswith(f"effect file {path}")
                raise

    yield from_bytes
    for name in [name for name in sys.modules if name.startswith("slipmap_effect_file_")]:
        del sys.modules[name]


def test_spoilt_effects(read):
    read(GOOD.encode())
    _, refused = refusals(spoilt(GOOD.encode(), 300, WORDS), read, EffectError)
    assert refused > 100


LINES = GOOD.splitlines(keepends=True)


def test_effects_with_lines_left_out_or_doubled(read):
    """Most of them are still valid Python."""
    files = []
    for number, line in enumerate(LINES):
        files.append("".join(LINES[:number] + LINES[number + 1 :]).encode())
        files.append("".join([*LINES[:number], line, *LINES[number:]]).encode())
    _, refused = refusals(iter(files), read, EffectError)
    assert refused > 5


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x00",
        b"\xff\xfe",
        b"(" * 100_000,
        b"-" * 50_000 + b"1",
        b"x = " + b"1" * 5000,
        b"# coding: nothing\n",
        b"raise KeyError",
        b"raise BaseException('a' * 100000)",
        b"def f(): f()\nf()",
        b"class A(Exception):\n    def __str__(self): raise ValueError\nraise A",
        b"x" * 2**21,
    ],
    ids=range(12),
)
def test_what_is_no_effect_is_refused(read, content):
    assert refusals(iter([content]), read, EffectError) == (0, 1)
