"""Compilation of the kernels: to machine code once, kept on disk, and made anew when a kernel file changes.

Numba's own cache looks at the file of the outermost function alone and would go on using stale code after a
change in a file that this one calls. Here the cache's folder carries a hash of all kernel files instead.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import njit


def _source_hash() -> str:
    # Numba keeps kernels by where their source lies: another checkout cannot use them.
    digest = hashlib.sha256(f"{numba.__version__} {Path(__file__).parent.resolve()}".encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_root() -> Path:
    base = os.environ.get("SLIPMAP_CACHE") or os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "slipmap"


CACHE_FOLDER = _cache_root() / f"kernels-{_source_hash()}"
"""Where compiled kernels are kept; under SLIPMAP_CACHE or XDG_CACHE_HOME if set, else under ~/.cache."""


LONE_FOLDER = CACHE_FOLDER.parent / "lone-kernels"
"""Where those of other folders are kept; each file of them stands alone, calling nothing of another."""


def compiled(folder: Path = CACHE_FOLDER, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: compile on first call and keep the result; options are numba's.

    Nothing is compiled for callers in C, which there are none of.

    Args:
        folder: where it is kept. In `LONE_FOLDER` only a change of a function's own file is noticed.
    """
    options["no_cfunc_wrapper"] = True

    def decorate(function: Callable[..., Any]) -> Any:
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(folder)
        try:
            return njit(cache=True, error_model="numpy", **options)(function)
        finally:
            numba.config.CACHE_DIR = before

    return decorate


def needs_compiling() -> bool:
    """Whether the next call of a kernel will compile it first, which takes about half a minute."""
    return not any(CACHE_FOLDER.glob("**/*.nbc"))
