"""Compiles the formulas of effects to machine code for the values and derivatives that the kernels need.

SymPy differentiates the formulas, `formulas.py` writes them as a small Python module into the cache folder of
the kernels, and `machine_code.py` compiles it once. Kernels call the functions by address, so a new effect or
combination does not recompile them.
"""

import hashlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slipmap.models.effects.effect import Effect, EffectError
from slipmap.models.files import read_checked, write_checked
from slipmap.models.physics.compiled import CACHE_FOLDER
from slipmap.models.physics.friction import FINGER_SETTLING

FloatArray = NDArray[np.float64]
Report = Callable[..., tuple[FloatArray, FloatArray, FloatArray]]
Delay = Callable[[FloatArray], tuple[float, FloatArray]]

_temporary: list[TemporaryDirectory[str]] = []  # removed when the process ends


@dataclass(frozen=True, eq=False)
class Program:
    """Compiled formulas of some effects."""

    effects: tuple[Effect, ...]  # in the order of their parameters
    # (4,) addresses of the functions body, cells, cell slopes, memory; 0 for those that `sizes` rules out
    addresses: NDArray[np.int64]
    sizes: NDArray[np.int64]  # (7,) as in `slipmap.models.physics.kernel_tools.Formulas`
    # from x, y, θ (…,) and parameters to poses (…, 3) as the tracker reports them, and their derivatives with
    # respect to the true pose (…, 3, 3) and the parameters (…, 3, P); None if no effect changes them
    measured: Report | None
    # from parameters to the tracker's delay and its derivative (P,); None if there is none
    delay: Delay | None
    felt: Report | None  # like `measured`, for the finger's force: F_x, F_y (…,) to (…, 2)
    force_delay: Delay | None  # like `delay`, for the finger's force
    module: ModuleType  # holds the machine code; without it the addresses would be invalid

    @property
    def parameters(self) -> int:
        """P: number of parameters of all effects."""
        return int(self.sizes[1])

    @property
    def memory(self) -> int:
        """E: numbers carried from step to step."""
        return int(self.sizes[0])


def program_of(effects: Sequence[Effect]) -> Program:
    """Compiled formulas of some effects, taken from memory or disk if compiled before.

    Raises:
        EffectError: a formula fails or is not a SymPy expression; names the effect, file and line.
    """
    return _program_of(tuple(effects))


@lru_cache(maxsize=64)
def _program_of(effects: tuple[Effect, ...]) -> Program:
    text = None
    key = _key(effects)
    if key is None:
        _check_declarations(effects)
        key = _key_of_formulas(effects)
    if key is None:
        text = _source(effects)
        key = hashlib.sha256(text.encode()).hexdigest()[:16]
    path = CACHE_FOLDER / f"effects-{key}" / "program.py"
    if read_checked(path) is None:
        path = _written(path, text or _source(effects))
    spec = importlib.util.spec_from_file_location(f"slipmap_effects_{key}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    functions = [getattr(module, name, None) for name in ("body", "cells", "cell_slopes", "memory")]
    return Program(
        effects,
        np.array([function.address if function else 0 for function in functions], dtype=np.int64),
        np.array(module.SIZES, dtype=np.int64),
        getattr(module, "measured", None),
        getattr(module, "delay", None),
        getattr(module, "felt", None),
        getattr(module, "force_delay", None),
        module,
    )


def _written(path: Path, text: str) -> Path:
    """Path of a file with this text: the one given, or a temporary one where that cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_checked(path, text.encode())
        return path
    except OSError:
        # The machine code lies beside its source. Numba, which compiles some formulas, needs a file too.
        folder = TemporaryDirectory(prefix="slipmap-")
        _temporary.append(folder)
        path = Path(folder.name) / path.parent.name / path.name
        path.parent.mkdir()
        write_checked(path, text.encode())
        return path


def _key(effects: Sequence[Effect]) -> str | None:
    """Hash of the sources of the code, or None if an effect is not slipmap's own.

    A user's formulas may depend on more than the text of their file: on modules that it imports, or on the
    arguments of a function that makes classes.
    """
    here = Path(__file__).parent
    digest = _digest_of_writer()
    for effect in effects:
        try:
            path = Path(inspect.getfile(type(effect)))
        except (TypeError, OSError):
            return None
        if path.parent != here:
            return None
        digest.update(path.read_bytes())
        digest.update(type(effect).__qualname__.encode())
    return digest.hexdigest()[:16]


def _key_of_formulas(effects: Sequence[Effect]) -> str | None:
    """Hash of the formulas themselves, which takes a tenth of the time of differentiating them; None if that
    is not all the code depends on."""
    from slipmap.models.effects.formulas import written_out

    text = written_out(effects)
    if text is None:
        return None
    digest = _digest_of_writer()
    digest.update(text.encode())
    return digest.hexdigest()[:16]


def _digest_of_writer() -> Any:
    """Hash of what writes the code for given formulas."""
    here = Path(__file__).parent
    digest = hashlib.sha256(repr(FINGER_SETTLING).encode())
    writers = ("effect", "symbols", "program", "formulas", "backward_loop", "machine_code")
    for name in (f"{writer}.py" for writer in writers):
        digest.update((here / name).read_bytes())
    return digest


def _check_declarations(effects: Sequence[Effect]) -> None:
    """Refuse a user's effects that are declared wrongly, such as with a scale of 0."""
    from slipmap.models.effects.effect_checks import check_declaration  # it imports SymPy

    for effect in effects:
        try:
            check_declaration(effect)
        except EffectError as error:
            raise EffectError(f"effect {effect.name}: {error}") from error


def _source(effects: Sequence[Effect]) -> str:
    # SymPy takes a third of a second to import and is needed only for new formulas.
    from slipmap.models.effects.formulas import module_source

    return module_source(effects)
