"""Libraries of the operating system that Drake and OpenCV load: found missing by trying, then installed.

`make` runs it after installing slipmap.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence

from slipmap.diagrams.perception.system_libraries import (
    DEBIAN_PACKAGES,
    IMPORTS,
    RENDER,
    RENDERING_PACKAGES,
    missing_library,
)

WITHOUT_RENDERER = "Everything but the simulated camera, and what explores with it, works without"

Run = Callable[[Sequence[str]], "subprocess.CompletedProcess[str]"]


class MissingLibrary(RuntimeError):
    """A library that the user must install. The text is one paragraph with the command that does it."""


class MissingRenderer(MissingLibrary):
    """Everything can be imported, but the simulated camera cannot render."""


def main() -> int:
    """Check and install; the exit code is 0 if every import works, even without a renderer, else 1."""
    try:
        for package in install_missing():
            print(f"installed {package}", file=sys.stderr)
    except MissingRenderer as error:
        print(error, file=sys.stderr)
    except MissingLibrary as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def install_missing(run: Run | None = None) -> list[str]:
    """Install what the imports and the camera's renderer need, and return the packages.

    Args:
        run: runs a command and returns its result with text output; the operating system if None.

    Raises:
        MissingLibrary: an import or the renderer fails for another reason, or the packages cannot be
            installed from here.
    """
    run = run or _run
    installed = _install_for_imports(run)
    if _renders(run):
        return installed
    packages = [package for package in RENDERING_PACKAGES if package not in installed]
    try:
        for package in packages:
            _install(run, "rendering pictures", package)
    except MissingLibrary as error:
        raise MissingRenderer(f"{error}. {WITHOUT_RENDERER}") from error
    if not _renders(run):
        raise MissingRenderer(
            f"rendering pictures fails although {', '.join(RENDERING_PACKAGES)} are installed."
            f" {WITHOUT_RENDERER}"
        )
    return installed + packages


def _renders(run: Run) -> bool:
    return run([sys.executable, "-c", RENDER]).returncode == 0


def _install_for_imports(run: Run) -> list[str]:
    installed: list[str] = []
    for module in IMPORTS:
        while (failure := _import_failure(run, module)) is not None:
            library = missing_library(failure)
            if library is None:
                raise MissingLibrary(f"`import {module}` fails: {failure}")
            package = DEBIAN_PACKAGES.get(library)
            if package is None:
                raise MissingLibrary(
                    f"`import {module}` needs the system library {library}; install the package that holds it"
                    f" (on Debian and Ubuntu `apt-file search {library}` finds it) and try again"
                )
            if package in installed:
                raise MissingLibrary(
                    f"`import {module}` does not find {library} although {package} is installed"
                )
            _install(run, f"`import {module}`", package, library)
            installed.append(package)
    return installed


def _install(run: Run, purpose: str, package: str, library: str = "") -> None:
    needed = f"the system library {library}" if library else f"what Debian's package {package} holds"
    advice = MissingLibrary(
        f"{purpose} needs {needed}. On Debian and Ubuntu install it with"
        f" `sudo apt-get install {package}`, elsewhere with the package that holds it, and try again"
    )
    if shutil.which("apt-get") is None:
        raise advice
    sudo: list[str] = []
    if os.geteuid() != 0:
        sudo = ["sudo", "-n"]
        if shutil.which("sudo") is None or run([*sudo, "true"]).returncode != 0:
            raise advice
    print(f"installing {package} for {purpose} …", file=sys.stderr)
    command = [*sudo, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get"]
    run([*command, "update", "-q"])
    if run([*command, "install", "-q", "-y", "--no-install-recommends", package]).returncode != 0:
        raise advice


def _import_failure(run: Run, module: str) -> str | None:
    """Last line of the error of an import in a fresh interpreter, or None."""
    result = run([sys.executable, "-c", f"import {module}"])
    lines = result.stderr.strip().splitlines()
    return None if result.returncode == 0 else lines[-1] if lines else f"exit code {result.returncode}"


def _run(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)


if __name__ == "__main__":
    sys.exit(main())
