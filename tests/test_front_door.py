"""The front door: what `import slipmap` offers, how fast, and that every example in a docstring is true."""

from __future__ import annotations

import doctest
import pkgutil
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import matplotlib
import pytest

import slipmap

ROOT = Path(__file__).parents[1]
ROOMS = {"diagrams", "figures", "models", "planners"}
OFFERED = sorted(set(slipmap.__all__) - ROOMS)
PLAIN = {"LIBRARY"}  # a tuple, with nowhere to put a docstring
PAGE = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")


def further_inside() -> list[str]:
    """Paths of what the page names beyond the front door."""
    paths, module = [f"slipmap.{path}" for path in re.findall(r"`(figures\.\w+)`", PAGE)], ""
    for named, name in re.findall(r"^\| (?:`(slipmap\.[\w.]+)` )?\| `(\w+)` \|", PAGE, flags=re.M):
        module = named or module
        paths.append(f"{module}.{name}")
    return paths


EXPLAINED = [f"slipmap.{name}" for name in sorted(set(OFFERED) - PLAIN)] + further_inside()


def test_every_name_is_there_and_listed() -> None:
    assert set(OFFERED) <= set(dir(slipmap))
    for name in OFFERED:
        assert getattr(slipmap, name) is not None


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match=r"slipmap has no identfy; did you mean identify\?"):
        slipmap.identfy  # noqa: B018
    with pytest.raises(AttributeError, match=r"slipmap has no xyzzy; dir\(slipmap\) lists"):
        slipmap.xyzzy  # noqa: B018
    assert not hasattr(slipmap, "__wrapped__")


def test_the_version_is_that_of_the_command() -> None:
    told = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert slipmap.__version__ == told


def test_it_loads_neither_drake_nor_numpy() -> None:
    script = (
        "import sys, slipmap; print(sorted({'pydrake', 'numpy', 'numba', 'matplotlib'} & set(sys.modules)))"
    )
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


def test_the_page_of_the_docs_names_all() -> None:
    assert set(OFFERED) <= set(re.findall(r"`(\w+)`", PAGE))


@pytest.mark.parametrize("path", EXPLAINED)
def test_its_docstring_has_an_example_that_is_true(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    matplotlib.use("Agg")
    named = pkgutil.resolve_name(path)
    examples = doctest.DocTestParser().get_doctest(named.__doc__ or "", {}, path, None, None)
    assert examples.examples
    said: list[str] = []
    results = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(examples, out=said.append)
    assert results.failed == 0, "".join(said)


def test_the_docstring_of_the_package_is_true() -> None:
    results = doctest.testmod(slipmap)
    assert results.attempted and not results.failed
