"""SymPy functions that stay unevaluated in formulas for readers.

They have a module of their own so that `symbols.py` loads SymPy only when a formula is first needed.
"""

from typing import Any

import sympy as sp


class PositivePart(sp.Function):
    """max(value, 0) in formulas for readers, unevaluated unless the value is a number."""

    @classmethod
    def eval(cls, value: Any) -> Any:
        """The positive part of a number; None leaves other values unevaluated."""
        return sp.Max(value, 0) if value.is_number else None

    def _latex(self, printer: Any, **_: Any) -> str:
        return rf"\left[{printer.doprint(self.args[0])}\right]_{{+}}"

    def _sympystr(self, printer: Any) -> str:
        return f"max({printer.doprint(self.args[0])}, 0)"


class SmoothStep(sp.Function):
    """0 below -width and 1 above width, in formulas for readers."""

    def _latex(self, printer: Any, **_: Any) -> str:
        value, width = (printer.doprint(argument) for argument in self.args)
        return rf"\sigma\left(\frac{{{value}}}{{{width}}}\right)"

    def _sympystr(self, printer: Any) -> str:
        value, width = (printer.doprint(argument) for argument in self.args)
        return f"step(({value})/{width})"
