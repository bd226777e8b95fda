"""Reverse-mode derivatives of the cells' formulas, against SymPy's forward ones, term by term."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import sympy as sp

from slipmap.models.effects.backward_loop import backward_loop
from slipmap.models.effects.formulas import _Printer, derivative

RX, RY = sp.symbols("r_x r_y", real=True)
Y = sp.symbols("y0:5", real=True)
A, B, C, D, E = Y

FORMULAS = {
    "affine": [A + B * RX - C * RY],
    "same for all cells": [sp.sin(A) * B + C],
    "bounded shift": [1 + (A * RX + B * RY) / (1 + (A * RX + B * RY) ** 8) ** sp.Rational(1, 8)],
    "parts that several use": [
        sp.sqrt(1 + (A + B * RX) ** 2) / (2 + sp.cos(C) * RY),
        D * sp.exp(-((A + B * RX) ** 2)),
        (A + B * RX) ** 2 * sp.cos(C) ** 2 - E,
    ],
    "powers": [(2 + A * RX) ** -3 + (3 + B * RY) ** sp.Rational(-3, 4), 1 / (4 + C * RX) ** 2],
    "by cases": [sp.Piecewise((A * RX, RX * B > 0), (C * RY**2, True)), sp.Max(A * RX, B)],
    "a case that guards": [
        sp.Piecewise((sp.exp(-1 / (A * RX)) * (1 + 1 / (A * RX)), A * RX > 0), (0, True)) * B + C * RY,
    ],
    "without y": [RX * RY, A * RX],
}


@pytest.mark.parametrize("name", FORMULAS)
def test_sums_over_cells_are_those_of_forward_derivatives(name: str) -> None:
    rng = np.random.default_rng(3)
    formulas, cells = FORMULAS[name], rng.uniform(-1, 1, (6, 2))
    values = rng.uniform(0.2, 0.9, len(Y))
    g = rng.normal(size=(len(formulas), 3, len(cells)))
    stems = [f"g{c}" for c in range(len(formulas))]
    code = backward_loop(
        list(zip(stems, formulas, strict=True)),
        Y,
        (RX, RY),
        derivative,
        _Printer({"fully_qualified_modules": True}).doprint,
    )
    space: dict[str, Any] = {"math": math, "G": np.zeros(3 * len(Y))}
    space |= {str(symbol): float(value) for symbol, value in zip(Y, values, strict=True)}
    exec("\n".join([*code.before, *(f"{total} = 0.0" for total in code.sums)]), space)
    for i, (x, y) in enumerate(cells):
        space |= {"r_x": x, "r_y": y} | {f"{s}{a}": g[c, a, i] for c, s in enumerate(stems) for a in range(3)}
        exec("\n".join(code.within), space)
    exec("\n".join(code.after), space)

    slopes = sp.lambdify([Y, RX, RY], [[derivative(e, s) for s in Y] for e in formulas], modules="math")
    by_cell = np.array([slopes(values, x, y) for x, y in cells], dtype=float)
    np.testing.assert_allclose(
        space["G"].reshape(3, -1), np.einsum("cai,icj->aj", g, by_cell), rtol=1e-12, atol=1e-13
    )


def test_a_form_in_many_states_costs_few_sums() -> None:
    """Three rows for each of the two numbers in front of r_x and r_y, however many states make them up."""
    shift = (A * B - C) * RX + (D / E + A * C) * RY
    code = backward_loop([("g", shift / sp.sqrt(1 + shift**2))], Y, (RX, RY), derivative, str)
    assert len(code.sums) == 6


def test_negative_powers_are_written_as_quotients() -> None:
    """Numba's negative powers keep the compiler from vectorising over cells."""
    printer = _Printer({"fully_qualified_modules": True})
    for power in (-1, -2, sp.Rational(-1, 8), sp.Rational(-9, 8)):
        assert "**(-" not in printer.doprint((1 + RX**2) ** power)
        assert "**-" not in printer.doprint((1 + RX**2) ** power)
