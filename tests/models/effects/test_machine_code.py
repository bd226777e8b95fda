"""Machine code against the same functions in Python."""

import ctypes
import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slipmap.models.effects import machine_code

FUNCTIONS = {
    "arithmetic": """
    a = y[0] + 2*y[1] - (1/2)*y[2]
    b = -a*y[3]/(1.0/(y[4]))
    out[0] = a
    out[1] = b**1 + b**2 - b**7
    out[2] = y[4]**(3/2) + y[4]**y[0]
    out[3] = math.pi*a
    out[3] += 0.5*a
    out[4] = min(a, b) + 10*max(a, b) + 100*min(b, a)
""",
    "functions": """
    out[0] = math.sin(y[0]) + math.cos(y[1]) + math.exp(y[2]) + math.log(y[4]) + math.sqrt(y[4])
    out[1] = math.tanh(y[0]) + math.atan2(y[1], y[2]) + math.hypot(y[0], y[3]) + math.log1p(y[4])
    out[2] = math.tan(y[0]) + math.asin(y[0]) + math.acos(y[1]) + math.atan(y[2]) + math.sinh(y[3])
    out[3] = abs(y[3]) + math.floor(10*y[0]) + math.ceil(10*y[0]) + math.copysign(y[4], y[3])
    out[4] = math.erf(y[0]) + math.cosh(y[1]) + math.asinh(y[2]) + math.expm1(y[3])
""",
    "cases": """
    out[0] = ((1) if (y[3] > 0) else (-1) if (y[3] < 0) else (0))
    out[1] = (2.0 if y[0] <= y[1] and y[0] != y[1] else 3.0)
    out[2] = (2.0 if y[0] >= y[1] or not y[0] == y[1] else 3.0)
    out[3] = ((y[0]) if (y[1] > 9) else (y[2]) if (True) else (y[3]))
    out[4] = (1.0 if math.nan != y[0] else 0.0)
""",
    "what is not a number": """
    a = math.nan*y[0]
    out[0] = (1.0 if a < y[0] else 2.0) + (10.0 if not a > y[0] else 20.0) + (100.0 if a == a else 200.0)
    out[1] = min(y[0], a) + max(y[0], a)
    out[2] = max(math.inf, y[0])
    out[3] = max(y[0], y[1], y[2]) + 10*min(y[0], y[1], y[2])
    out[4] = max(a, y[0])
""",
    "conditions with names": """
    w = y[0] < y[2]
    v = y[0] < y[1] or y[3] > 0
    for i in range(int(y[5])):
        u = z[i] > 0.8 and w
        out[i] = (math.exp(z[i]) if (u) else (1/(z[i])) if (w) else (0))
    out[3] = (1.0 if ((v) if (w) else (w)) else 4.0)
    out[4] = (2.0 if v else 3.0)
""",
    "loops": """
    n = y[5]
    total = 0.0
    largest = y[0]
    seen = 1
    for i in range(int(n)):
        x = z[i]
        w = z[2 * int(n) + i]
        out[i] = x*w
        total += x
        largest = max(largest, w)
        seen = seen*1.5
    for i in range(0):
        total += 100.0
    out[3] = total
    out[4] = largest + seen
""",
    "what Numba compiles": """
    out[0] = y[0] % 0.1
    out[1] = int(y[4])
    out[2] = y[0] // 0.1
    out[3] = 0
    out[4] = 0
""",
}
Y = np.array([0.3, -0.4, 0.7, -1.2, 1.9, 3.0])
Z = np.linspace(0.5, 2.0, 9)


def module_of(folder: Path, text: str, decorator: str) -> Any:
    lines = ["import math", "", "", decorator, f"def f(y, z, out):{text}"]
    if decorator:
        lines.insert(1, "from slipmap.models.effects.machine_code import formula")
    folder.mkdir(exist_ok=True)
    (folder / "program.py").write_text("\n".join(lines))
    spec = importlib.util.spec_from_file_location("formulas_of_a_test", folder / "program.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def called(address: int) -> np.ndarray:
    out, kind = np.full(5, 7.0), ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3)
    kind(address)(*(array.ctypes.data for array in (Y, Z, out)))
    return out


@pytest.mark.parametrize("name", FUNCTIONS)
def test_machine_code_does_what_python_does(name: str, tmp_path: Path) -> None:
    expected = np.full(5, 7.0)
    module_of(tmp_path / "python", FUNCTIONS[name], "").f(Y, Z, expected)
    made = module_of(tmp_path / f"{name} {tmp_path.name}", FUNCTIONS[name], "@formula").f
    assert called(made.address) == pytest.approx(expected, rel=1e-13, abs=1e-15, nan_ok=True)
    by_numba = bool(list(tmp_path.glob("*/__pycache__/*.nbc")))
    assert by_numba == (name == "what Numba compiles")


def test_code_is_read_where_it_is_kept_and_made_anew_where_it_is_torn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / f"kept {tmp_path.name}"
    first = called(module_of(folder, FUNCTIONS["loops"], "@formula").f.address)
    (kept,) = folder.glob("*.bin")
    text, translated = kept.read_bytes(), machine_code._translated
    monkeypatch.setattr(machine_code, "_loaded", {})
    monkeypatch.setattr(machine_code, "_translated", lambda *args: pytest.fail("translated anew"))
    assert np.array_equal(called(module_of(folder, FUNCTIONS["loops"], "@formula").f.address), first)
    kept.write_bytes(text[:100])
    monkeypatch.setattr(machine_code, "_loaded", {})
    monkeypatch.setattr(machine_code, "_translated", translated)
    assert np.array_equal(called(module_of(folder, FUNCTIONS["loops"], "@formula").f.address), first)
    assert len(kept.read_bytes()) > 100


def test_where_nothing_can_be_kept_it_runs_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(machine_code, "_write", full)
    folder = tmp_path / f"full {tmp_path.name}"
    assert called(module_of(folder, FUNCTIONS["loops"], "@formula").f.address)[3] == Z[:3].sum()
    assert not list(folder.glob("*.bin"))


def test_code_of_another_translator_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / f"older {tmp_path.name}"
    module_of(folder, FUNCTIONS["loops"], "@formula")
    monkeypatch.setattr(machine_code, "_TRANSLATOR", "an older one")
    module_of(folder, FUNCTIONS["loops"], "@formula")
    assert len(list(folder.glob("*.bin"))) == 2


def test_loops_over_cells_are_vectorised(tmp_path: Path) -> None:
    """Also where C's functions are called in them."""
    text = """
    for i in range(int(y[5])):
        out[i] = math.tanh(z[i]) + math.exp(z[i])
"""
    made = module_of(tmp_path / f"vectors {tmp_path.name}", text, "@formula").f
    assert "x double>" in made._code.get_llvm_str()
