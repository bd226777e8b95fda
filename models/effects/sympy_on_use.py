"""SymPy, imported when a formula is first looked at: that takes half a second, and where all formulas are
compiled already nothing of it is needed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import sympy as sp
else:

    class _SympyOnUse:
        def __getattr__(self, name: str) -> Any:
            import sympy

            return getattr(sympy, name)

    sp = _SympyOnUse()

__all__ = ["sp"]
