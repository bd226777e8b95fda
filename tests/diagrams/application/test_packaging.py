"""What an installed package needs besides code is declared, so that a wheel has it."""

from __future__ import annotations

import tomllib
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]


def test_every_file_that_is_no_code_is_declared():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    declared = project["tool"]["setuptools"]["package-data"]
    (sources,) = project["tool"]["setuptools"]["packages"]["find"]["where"]
    packages = [path.name for path in (ROOT / sources / "slipmap").iterdir() if path.is_dir()]
    assert {"models", "planners", "diagrams"} <= set(packages)
    files = [
        path.relative_to(ROOT)
        for package in packages
        for path in (ROOT / package).rglob("*")
        if path.is_file() and path.suffix not in (".py", ".pyc")
    ]
    assert len(files) > 5
    for path in files:
        patterns = declared.get(".".join(("slipmap", *path.parent.parts)), [])
        assert any(fnmatch(path.name, pattern) for pattern in patterns), path


def test_the_package_does_not_import_its_tests():
    """They are not in a wheel; `slipmap blind-test` has its simulator in the package."""
    assert (ROOT / "diagrams/application/studies/blind/generator.py").is_file()
    for path in (
        path for package in ("models", "planners", "diagrams") for path in (ROOT / package).rglob("*.py")
    ):
        for line in path.read_text(encoding="utf-8").splitlines():
            assert not line.strip().startswith(("from tests", "import tests", "sys.path")), path
