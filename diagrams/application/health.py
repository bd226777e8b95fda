"""Checks that this machine has everything slipmap needs, by trying each thing out."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from slipmap.diagrams.perception.system_libraries import IMPORTS, RENDER, RENDERING_PACKAGES, package_for

LEAST_PYTHON = (3, 11)
LEAST_DISK = 1.0  # least free disk space, GB; compiled kernels take some MB, a recorded run up to 100
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "firefox")
PATIENCE = 120.0  # s for one check; the slowest, importing all of Drake, takes some seconds

LCM_URL = "udpm://239.255.76.67:7691?ttl=0"
"""LCM's usual address with a port at which no cell listens; with ttl=0, nothing leaves this computer."""

_ROUND_TRIP = f"""
from pydrake.lcm import DrakeLcm
heard = []
lcm = DrakeLcm({LCM_URL!r})
subscription = lcm.Subscribe("SLIPMAP_DOCTOR", heard.append)
lcm.Publish("SLIPMAP_DOCTOR", b"hello")
for _ in range(20):
    if heard or lcm.HandleSubscriptions(100):
        break
assert heard == [b"hello"], "the message sent was not received"
"""

_COMPILE = "from numba import njit; assert njit(lambda x: x + 1)(1) == 2"

Try = Callable[[str], str | None]
"""Runs Python code in its own process; returns the last line of the error, or None."""


@dataclass(frozen=True)
class Finding:
    """Result of one check."""

    name: str  # of the thing checked
    ok: bool  # whether it is present and works
    needed: bool  # whether slipmap requires it
    found: str  # what is present, or what is wrong
    remedy: str = ""  # command or step that fixes it; empty where nothing is wrong


def examine(attempt: Try | None = None) -> Iterator[Finding]:
    """Run all checks in turn; code runs in a fresh interpreter if `attempt` is None."""
    attempt = attempt or _in_fresh_interpreter
    yield _python()
    yield from _packages()
    for module in IMPORTS:
        yield _import(module, attempt)
    renderer, remedy = "camera's renderer (EGL)", _apt(*RENDERING_PACKAGES)
    yield _tried(renderer, attempt(RENDER), remedy, "the test picture is correct")
    remedy = f"{sys.executable} -m pip install --force-reinstall numba llvmlite"
    yield _tried("compiler (numba)", attempt(_COMPILE), remedy)
    yield _cache()
    yield _disk()
    yield _cores()
    yield _browser()
    yield _lcm(attempt)


def _python() -> Finding:
    found = ".".join(map(str, sys.version_info[:3]))
    least = ".".join(map(str, LEAST_PYTHON))
    remedy = f"sudo apt-get install python{least} python{least}-venv, then make PYTHON3=python{least} install"
    return _finding("Python", sys.version_info >= LEAST_PYTHON, found, remedy)


def _packages() -> Iterator[Finding]:
    """Check the required packages and their versions."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        from packaging.requirements import Requirement
    except ImportError:
        yield _finding("packaging", False, "not installed", f"{sys.executable} -m pip install packaging")
        return
    wanted = [Requirement(text) for text in _required()]
    for requirement in wanted:
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": ""}):
            continue
        try:
            found = version(requirement.name)
        except PackageNotFoundError:
            found = "not installed"
        ok = found != "not installed" and requirement.specifier.contains(found, prereleases=True)
        remedy = f"{sys.executable} -m pip install '{requirement.name}{requirement.specifier}'"
        yield _finding(
            requirement.name, ok, found if ok else f"{found}, but {requirement.specifier} is needed", remedy
        )


def _required() -> list[str]:
    """Requirements of the checkout, which may be newer than the installation; else of the installation."""
    description = Path(__file__).resolve().parents[2] / "pyproject.toml"
    if description.is_file():
        import tomllib

        return list(tomllib.loads(description.read_text(encoding="utf-8"))["project"]["dependencies"])
    from importlib.metadata import requires

    return requires("slipmap") or []


def _import(module: str, attempt: Try) -> Finding:
    failure = attempt(f"import {module}")
    package = package_for(failure or "")
    remedy = _apt(package) if package else "make install, and read its output"
    return _tried(f"import {module}", failure, remedy)


def _tried(name: str, failure: str | None, remedy: str, works: str = "works") -> Finding:
    """Finding from an attempt that failed, or not if `failure` is None."""
    return _finding(name, failure is None, failure or works, remedy)


def _cache() -> Finding:
    name, remedy = "cache of compiled kernels", "export SLIPMAP_CACHE=/a/folder/that/you/may/write"
    try:
        from slipmap.models.physics.compiled import CACHE_FOLDER, needs_compiling
    except ImportError as error:
        return _finding(name, False, f"cannot be checked: {error}", "install what is missing above")
    try:
        CACHE_FOLDER.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=CACHE_FOLDER) as file:
            file.write(b"slipmap")
    except OSError as error:
        return _finding(name, False, f"{CACHE_FOLDER}: {error.strerror}", remedy)
    state = "empty; the first run compiles for up to two minutes" if needs_compiling() else "filled"
    return _finding(name, True, f"{CACHE_FOLDER}, {state}")


def _disk() -> Finding:
    least = min(shutil.disk_usage(folder).free for folder in (Path.home(), Path.cwd())) / 1e9
    remedy = "free some space, or move the cache with the environment variable SLIPMAP_CACHE"
    return _finding("disk", least >= LEAST_DISK, f"{least:.1f} GB free", remedy)


def _cores() -> Finding:
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    threads = os.environ.get("NUMBA_NUM_THREADS", str(available))
    ok = available >= 2 and threads.isdigit() and 1 <= int(threads) <= available
    remedy = "one core is slow; if there are more threads than cores, unset NUMBA_NUM_THREADS"
    found = f"{available}, threads for rollouts: {threads}"
    return _finding("processor cores", ok, found, remedy, needed=False)


def _browser() -> Finding:
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    said = found or "none found; reports also open in a browser on another computer"
    return _finding("browser", found is not None, said, _apt("chromium"), needed=False)


def _lcm(attempt: Try) -> Finding:
    failure = attempt(_ROUND_TRIP)
    found = f"{failure}; only needed for a real arm or its twin" if failure else "a message came back"
    remedy = "sudo ip link set lo multicast on && sudo ip route add 224.0.0.0/4 dev lo"
    return _finding("LCM by multicast", failure is None, found, remedy, needed=False)


def _finding(name: str, ok: bool, found: str, remedy: str = "", *, needed: bool = True) -> Finding:
    return Finding(name, ok, needed, found, "" if ok else remedy)


def _apt(*packages: str) -> str:
    return f"sudo apt-get install {' '.join(packages)}"


def _in_fresh_interpreter(code: str) -> str | None:
    # Where a library is missing, Drake ends the process instead of raising an error.
    try:
        result = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL, timeout=PATIENCE,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"no answer within {PATIENCE:.0f} s"
    if result.returncode == 0:
        return None
    lines = re.sub(r"\x1b\[[0-9;]*m", "", result.stderr).strip().splitlines()
    return lines[-1] if lines else f"ended with exit code {result.returncode}"
