"""Calls of compiled functions by their address: formulas made at run time inside kernels compiled before.

A kernel that took formulas as arguments would have to be compiled for each; an address is a number.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


@intrinsic
def call_address(typingctx, address, arrays):  # type: ignore[no-untyped-def]
    """Call the C function `void f(double*, double*, …)` at an integer address with a tuple of arrays.

    Nothing is checked: the arrays must be contiguous, of floats and as long as the function expects.
    """
    signature = types.void(address, arrays)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = ir.DoubleType().as_pointer()
        target = ir.FunctionType(ir.VoidType(), [pointer] * len(signature.args[1]))
        function = builder.inttoptr(args[0], target.as_pointer())
        data = []
        for k, kind in enumerate(signature.args[1]):
            array = builder.extract_value(args[1], k)
            data.append(context.make_array(kind)(context, builder, array).data)
        builder.call(function, data)
        return context.get_dummy_value()

    return signature, generate
