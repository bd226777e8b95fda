"""SymPy functions that stand for themselves in formulas that people read.

They lie apart because `symbols.py` makes them and loads SymPy only when a formula is first asked for.
"""

from typing import Any

import sympy as sp


class PositivePart(sp.Function):
    """max(value, 0) in formulas that are read, unevaluated unless the value is a number."""

    @classmethod
    def eval(cls, value: Any) -> Any:
        """A number's positive part."""
        return sp.Max(value, 0) if value.is_number else None

    def _latex(self, printer: Any, **_: Any) -> str:
        return rf"\left[{printer.doprint(self.args[0])}\right]_{{+}}"

    def _sympystr(self, printer: Any) -> str:
        return f"max({printer.doprint(self.args[0])}, 0)"


class SmoothStep(sp.Function):
    """0 below -width and 1 above width, in formulas that are read."""

    def _latex(self, printer: Any, **_: Any) -> str:
        value, width = (printer.doprint(argument) for argument in self.args)
        return rf"\sigma\left(\frac{{{value}}}{{{width}}}\right)"

    def _sympystr(self, printer: Any) -> str:
        value, width = (printer.doprint(argument) for argument in self.args)
        return f"step(({value})/{width})"
