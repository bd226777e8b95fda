"""slipmap as pip installs it, used from a folder that has `models`, `planners` and `diagrams` of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
from importlib.metadata import distribution, distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[3]
FOLDERS = ("models", "planners", "diagrams")


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy, as setuptools leaves build products in it; skips where setuptools is too old to build it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    needed = Requirement(*project["build-system"]["requires"])
    if not any(found.version in needed.specifier for found in distributions(name=needed.name)):
        pytest.skip(f"{needed} is not installed")
    copy = tmp_path_factory.mktemp("installed") / "checkout"
    for name in (".src", *FOLDERS):
        shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=_no_source)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy / name)
    return copy


def _no_source(_: str, names: list[str]) -> list[str]:
    return [name for name in names if name == "__pycache__" or name.endswith(".egg-info")]


@pytest.fixture(scope="module", params=["wheel", "editable"])
def environment(request: pytest.FixtureRequest, checkout: Path) -> Path:
    """An environment with slipmap from the copy, and all other packages from that of the tests."""
    folder = checkout.parent / request.param
    venv.create(folder, symlinks=True)
    others = {str(distribution(name).locate_file("")) for name in ("numba", "setuptools")}
    _packages(folder).joinpath("others.pth").write_text("\n".join(sorted(others)))
    how = ["-e", str(checkout)] if request.param == "editable" else [str(checkout)]
    options = ("--no-deps", "--no-index", "--no-build-isolation", "--ignore-installed", "--no-compile")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", str(folder)]
    _output(checkout, *pip, "install", "--quiet", *options, *how)
    return folder


def _packages(environment: Path) -> Path:
    return Path(sysconfig.get_path("purelib", "venv", {"base": str(environment)}))


def _output(folder: Path, *command: str | Path) -> str:
    """What a command says in a folder, in which nothing points at the checkout of these tests."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PIP_"))}
    ended = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_folders_of_the_same_names_do_not_meet(environment, tmp_path):
    for name in FOLDERS:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("whose = 'mine'\n")
    script = "\n".join(
        [
            "import diagrams, models, planners, slipmap, slipmap.models.physics.rollout",
            "print(models.whose, planners.whose, diagrams.whose, slipmap.models.__name__)",
            "print(slipmap.__file__)",
        ]
    )
    python = environment / "bin" / "python"
    whose, place = _output(tmp_path, python, "-c", script).splitlines()
    assert whose == "mine mine mine slipmap.models"
    assert environment.parent in Path(place).parents  # not of the checkout that the tests run in
    said = f"slipmap {distribution('slipmap').version}\n"
    for command in ([python, "-m", "slipmap"], [environment / "bin" / "slipmap"]):
        assert _output(tmp_path, *command, "--version") == said


def test_a_wheel_holds_one_package_with_all_its_files(environment, checkout):
    packages = _packages(environment)
    brought = {path.name for path in packages.iterdir()} - {"others.pth"}
    (described,) = [name for name in brought if name.endswith(".dist-info")]
    brought.remove(described)
    source = checkout / ".src"
    if environment.name == "editable":
        (link,) = brought
        assert (packages / link).read_text().split() == [str(source)]
    else:
        assert brought == {"slipmap"}
        assert _files(packages / "slipmap") == _files(source / "slipmap")


def _files(package: Path) -> set[str]:
    """All files of a package, those behind links with them, without what Python has compiled."""
    return {
        str(Path(folder, name).relative_to(package))
        for folder, _, names in os.walk(package, followlinks=True)
        for name in names
        if Path(folder).name != "__pycache__"
    }
