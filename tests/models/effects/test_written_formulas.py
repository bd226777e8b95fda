"""Printed formulas say what the code computes."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from matplotlib.mathtext import MathTextParser
from pushed_with_effects import EFFECTS, SHOWN
from sympy.parsing.sympy_parser import (
    convert_xor,
    implicit_multiplication,
    parse_expr,
    standard_transformations,
)

from slipmap.models.effects import LIBRARY
from slipmap.models.effects.symbols import after_names, body_names, cell_names
from slipmap.models.effects.written import QUANTITIES, plain_text, written

LETTERS = {
    "x": "x", "y": "y", "theta": "θ", "omega": "ω", "com_x": "com_x", "com_y": "com_y", "com_vx": "com_vx",
    "com_vy": "com_vy", "width": "w",
    "mass": "m", "moment": "J", "gravity": "g", "step": "h", "order": "k",
    "centroid_x": "c_x", "centroid_y": "c_y",
    "spread_xx": "G_xx", "spread_xy": "G_xy", "spread_yy": "G_yy", "force_x": "F_x", "force_y": "F_y",
    "downhill_x": "a_x", "downhill_y": "a_y",
}  # fmt: skip
CELL = {
    "x": "X", "y": "Y", "rx": "r_x", "ry": "r_y", "ux": "u_x", "uy": "u_y", "speed": "u", "area": "a",
}  # fmt: skip
TRANSFORMATIONS = (*standard_transformations, convert_xor, implicit_multiplication)


def numbers(
    rng: np.random.Generator,
) -> tuple[dict[str, float], SimpleNamespace, SimpleNamespace, SimpleNamespace]:
    """Values of the printed letters, and the same as body, cell and after."""
    # In a fixed order, since the order of a set differs between processes.
    names = sorted({*body_names({}), *cell_names(body_names({}))})
    value = {name: float(rng.uniform(0.1, 0.9)) for name in names}
    value |= {
        name: float(rng.uniform(0.1, 0.9))
        for name in ("gain_x", "gain_y", "lag_x", "lag_y", "rush_x", "rush_y")
    }
    value |= {"force_x": 0.3, "force_y": -0.2}
    value |= {
        "cos": np.cos(value["theta"]),
        "sin": np.sin(value["theta"]),
        "weight": value["mass"] * value["gravity"],
    }
    place = {"x": 0.37, "y": -0.21}
    later = {name: float(rng.uniform(0.1, 0.9)) for name in after_names()}
    printed = {LETTERS[name]: value[name] for name in LETTERS} | {"X": place["x"], "Y": place["y"]}
    printed |= {CELL[name]: value[name] for name in ("rx", "ry", "ux", "uy", "speed", "area")}
    printed |= {name: value[name] for name in ("gain_x", "gain_y", "lag_x", "lag_y", "rush_x", "rush_y")}
    printed |= {f"{LETTERS[name]}_new": later[name] for name in ("com_vx", "com_vy")}
    return printed, SimpleNamespace(**value), SimpleNamespace(**value | place), SimpleNamespace(**later)


@pytest.mark.parametrize("name", EFFECTS)
def test_the_text_computes_what_the_code_does(name: str) -> None:
    effect = EFFECTS[name]
    printed, body, cell, after = numbers(np.random.default_rng(3))
    text = written(effect)
    p = SimpleNamespace(**dict(zip([q.name for q in effect.parameters], SHOWN[name], strict=True)))
    known: dict[str, object] = {letter: sp.Float(value) for letter, value in printed.items()}
    known |= {text.symbols[q.name]: sp.Float(getattr(p, q.name)) for q in effect.parameters}
    known |= {"max": sp.Max, "step": lambda value: (1 + sp.tanh(2 * value)) / 2}
    equations = dict(f.text.replace("'", "_new").split(" = ") for f in text.formulas)
    solved: dict[str, float] = {}
    for _ in range(8):
        for left, right in equations.items():
            names = {re.sub(r"\W", "_", k): v for k, v in (known | solved).items()}
            result = parse_expr(right, names, transformations=TRANSFORMATIONS)
            if (
                not result.free_symbols
                and left not in ("F_x", "F_y", "r_x", "r_y", "a_x", "a_y") | known.keys()
            ):
                solved[left] = result
            if not result.free_symbols:
                solved[f"result {left}"] = result
    compared = 0
    for method, (letters, _) in QUANTITIES.items():
        arguments = {method: (cell, p) for method in ("friction", "drag", "stretch")}
        arguments |= {"measured": (body, p), "delay": (p,), "force_delay": (p,)}
        arguments |= {"felt": (SimpleNamespace(x=body.force_x, y=body.force_y), p)}
        value = getattr(effect, method)(*arguments.get(method, (body, p)))
        if value is None:
            continue
        for letter, expected in zip(letters, value if isinstance(value, tuple) else (value,), strict=True):
            if letter == r"\tau":
                continue
            found = float(solved[f"result {plain_text(letter)}"])
            # Soft corners are not printed.
            assert found == pytest.approx(float(expected), rel=1e-3), letter
            compared += 1
    if effect.memory:
        for letter, expected in zip(effect.memory, effect.remember(body, after, p), strict=True):
            assert float(solved[f"result {letter}_new"]) == pytest.approx(float(expected), rel=1e-9)
            compared += 1
    assert compared > 0


@pytest.mark.parametrize("effect", LIBRARY, ids=lambda effect: effect.name)
def test_every_letter_is_explained_and_mathtext_can_set_it(effect) -> None:  # type: ignore[no-untyped-def]
    text = written(effect)
    parser = MathTextParser("path")
    told = {letter for letter, _, _ in text.letters} | set(text.symbols.values())
    helpers = {f.text.split(" = ")[0] for f in text.formulas}
    functions = {"exp", "sin", "cos", "sqrt", "max", "step", "pi"}
    for formula in text.formulas:
        assert parser.parse(f"${formula.latex}$")[0] > 10
        words = set(re.findall(r"[A-Za-zθωκτΔ]\w*", formula.text.split(" = ", 1)[1])) - functions
        assert words <= told | helpers | set(effect.memory), words
        assert len(formula.text) < 130


def test_a_torque_that_is_no_mere_lever_is_printed() -> None:
    assert not any("τ" in f.text for f in written(EFFECTS["loose_mass"]).formulas)

    class Twisted(type(EFFECTS["loose_mass"])):  # type: ignore[misc]
        def force(self, body, p):  # type: ignore[no-untyped-def]
            fx, fy, torque = super().force(body, p)
            return fx, fy, torque + p.share

    assert any(f.text.startswith("τ = ") for f in written(Twisted()).formulas)
