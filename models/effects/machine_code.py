"""Machine code for functions of plain arithmetic, such as the formulas of effects.

A program of all effects is thousands of assignments between floats. Numba would infer a type for each, which
takes more than nine tenths of its time. Here such a function is translated to LLVM's language statement by
statement, and Numba's code generator optimises it as it does Numba's own. A function that is more than
arithmetic, as a user's formula may be, is compiled by Numba as usual.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import math
import pickle
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from llvmlite import ir
from numba import cfunc, types
from numba.core.cgutils import insert_pure_function
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target

from slipmap.models.files import read_checked, write_checked

_TRANSLATOR = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()

# Liberties that the compiler may take with sums and quotients to vectorise over cells.
_FAST = ("arcp", "contract", "nsz", "reassoc")

_FLOAT, _WHOLE, _TRUTH = ir.DoubleType(), ir.IntType(64), ir.IntType(1)

_INTRINSIC = {
    "sin": 1, "cos": 1, "exp": 1, "log": 1, "sqrt": 1, "floor": 1, "ceil": 1, "fabs": 1, "pow": 2,
    "copysign": 2,
}  # fmt: skip
"""Functions that LLVM knows, and how many arguments they have."""

_OF_C = {
    "tan": 1, "asin": 1, "acos": 1, "atan": 1, "atan2": 2, "sinh": 1, "cosh": 1, "tanh": 1, "asinh": 1,
    "acosh": 1, "atanh": 1, "hypot": 2, "expm1": 1, "log1p": 1, "log2": 1, "log10": 1, "erf": 1, "erfc": 1,
}  # fmt: skip
"""Those of C's library."""

_loaded: dict[str, Any] = {}  # libraries of machine code by key; freed code would leave addresses dangling


class Formula:
    """A function `f(double*, double*, …)` for the kernels, which call it by its `address`."""

    def __init__(self, address: int, code: Any) -> None:
        self.address = address
        self._code = code  # keeps the machine code


def formula(function: Callable[..., None]) -> Formula:
    """Decorator: compile a function of arrays, given as pointers, which returns nothing.

    The result is kept beside the function's file, whose folder must have another name for another text.
    """
    name, path = function.__name__, Path(function.__code__.co_filename)
    generator = cpu_target.target_context.codegen()
    made_for = repr((path.parent.name, name, generator.magic_tuple(), _TRANSLATOR))
    key = f"{name}-{hashlib.sha256(made_for.encode()).hexdigest()[:16]}"
    kept = path.parent / f"{key}.bin"
    with global_compiler_lock:
        if key not in _loaded and (state := _read(kept)) is not None:
            _loaded[key] = generator.unserialize_library(state)
        if key not in _loaded:
            library = generator.create_library(key)
            library.enable_object_caching()
            module = _translated(function, library.create_ir_module(key))
            if module is None:
                return _by_numba(function)
            library.add_ir_module(module)
            library.finalize()
            _loaded[key] = library
            with suppress(OSError):  # where nothing can be written, the next process compiles it again
                _write(kept, library.serialize_using_object_code())
        return Formula(_loaded[key].get_pointer_to_function(key), _loaded[key])


def _by_numba(function: Callable[..., None]) -> Formula:
    kinds = [types.CPointer(types.float64)] * function.__code__.co_argcount
    # Division by zero gives infinity, which the kernel notices; checks would add branches to the loop.
    code = cfunc(types.void(*kinds), cache=True, error_model="numpy", fastmath=set(_FAST))(function)
    return Formula(code.address, code)


def _write(kept: Path, state: Any) -> None:
    write_checked(kept, pickle.dumps(state))


def _read(kept: Path) -> Any:
    """What was kept, or None if there is nothing, or nothing whole."""
    data = read_checked(kept)
    return None if data is None else pickle.loads(data)


def _translated(function: Callable[..., None], module: ir.Module) -> ir.Module | None:
    """The module, with the function in it under the module's name; None if it is more than assignments of
    arithmetic, and loops over these."""
    (tree,) = ast.parse(inspect.getsource(function)).body
    assert isinstance(tree, ast.FunctionDef)
    try:
        _Translation(module, tree)
    except (_Unknown, RecursionError, OverflowError):
        return None
    return module


class _Unknown(Exception):
    """Something that is not translated."""


class _Translation:
    """Writes a function into a module; names that are assigned more than once live in memory, from where LLVM
    moves them to registers."""

    def __init__(self, module: ir.Module, function: ast.FunctionDef) -> None:
        self._module = module
        arguments = [argument.arg for argument in function.args.args]
        kind = ir.FunctionType(ir.VoidType(), [_FLOAT.as_pointer()] * len(arguments))
        made = ir.Function(module, kind, name=module.name)
        self._arrays = dict(zip(arguments, made.args, strict=True))
        self._builder = ir.IRBuilder(made.append_basic_block())
        self._counters: dict[str, Any] = {}
        self._values: dict[str, Any] = {}
        self._conditions: dict[str, Any] = {}
        nodes = [node for node in ast.walk(function) if isinstance(node, ast.Assign | ast.AugAssign)]
        targets = [node.targets[0] if isinstance(node, ast.Assign) else node.target for node in nodes]
        times = Counter(target.id for target in targets if isinstance(target, ast.Name))
        self._cells = {name: self._builder.alloca(_FLOAT) for name in times if times[name] > 1}
        self._statements(function.body)
        self._builder.ret_void()

    def _statements(self, statements: Sequence[ast.stmt]) -> None:
        for statement in statements:
            if isinstance(statement, ast.Assign) and len(statement.targets) == 1:
                target = statement.targets[0]
                if isinstance(statement.value, ast.Compare | ast.BoolOp) and isinstance(target, ast.Name):
                    if target.id in self._cells:
                        raise _Unknown(ast.unparse(statement))
                    self._conditions[target.id] = self._truth(statement.value)
                else:
                    self._store(target, self._value(statement.value))
            elif isinstance(statement, ast.AugAssign):
                target = statement.target
                before = ast.Name(target.id) if isinstance(target, ast.Name) else target
                self._store(target, self._operation(statement.op, self._value(before), statement.value))
            elif isinstance(statement, ast.For) and not statement.orelse:
                self._loop(statement)
            else:
                raise _Unknown(ast.unparse(statement))

    def _store(self, target: ast.expr, value: Any) -> None:
        if isinstance(target, ast.Name) and target.id in self._cells:
            self._builder.store(value, self._cells[target.id])
        elif isinstance(target, ast.Name):
            self._values[target.id] = value
        else:
            self._builder.store(value, self._place(target))

    def _loop(self, loop: ast.For) -> None:
        """`for i in range(count)`."""
        call = loop.iter
        if not (isinstance(loop.target, ast.Name) and isinstance(call, ast.Call) and len(call.args) == 1):
            raise _Unknown(ast.unparse(loop))
        if ast.unparse(call.func) != "range":
            raise _Unknown(ast.unparse(loop))
        builder, count = self._builder, self._whole(call.args[0])
        before = builder.block
        body, after = builder.append_basic_block(), builder.append_basic_block()
        zero, one = ir.Constant(_WHOLE, 0), ir.Constant(_WHOLE, 1)
        builder.cbranch(builder.icmp_signed(">", count, zero), body, after)
        builder.position_at_end(body)
        i = builder.phi(_WHOLE)
        i.add_incoming(zero, before)
        outside, conditions = dict(self._values), dict(self._conditions)
        self._counters[loop.target.id] = i
        self._statements(loop.body)
        following = builder.add(i, one, flags=["nsw"])
        i.add_incoming(following, builder.block)
        builder.cbranch(builder.icmp_signed("<", following, count), body, after)
        builder.position_at_end(after)
        # What was assigned within is unknown if there was nothing to loop over.
        self._values, self._conditions = outside, conditions
        del self._counters[loop.target.id]

    def _place(self, target: ast.expr) -> Any:
        """Address of an entry of an array."""
        if not (isinstance(target, ast.Subscript) and isinstance(target.value, ast.Name)):
            raise _Unknown(ast.unparse(target))
        if target.value.id not in self._arrays:
            raise _Unknown(ast.unparse(target))
        return self._builder.gep(self._arrays[target.value.id], [self._whole(target.slice)])

    def _whole(self, expression: ast.expr) -> Any:
        """A whole number: an index, or the end of a range."""
        match expression:
            case ast.Constant(value=int(value)):
                return ir.Constant(_WHOLE, value)
            case ast.Name(id=name) if name in self._counters:
                return self._counters[name]
            case ast.BinOp(left=left, op=ast.Add(), right=right):
                return self._builder.add(self._whole(left), self._whole(right))
            case ast.BinOp(left=left, op=ast.Mult(), right=right):
                return self._builder.mul(self._whole(left), self._whole(right))
            case ast.Call(func=ast.Name(id="int"), args=[of]):
                return self._builder.fptosi(self._value(of), _WHOLE)
        raise _Unknown(ast.unparse(expression))

    def _value(self, expression: ast.expr) -> Any:
        """A float."""
        match expression:
            case ast.Constant(value=bool()):
                raise _Unknown(ast.unparse(expression))
            case ast.Constant(value=int(value) | float(value)):
                return ir.Constant(_FLOAT, float(value))
            case ast.Name(id=name) if name in self._cells:
                return self._builder.load(self._cells[name])
            case ast.Name(id=name) if name in self._values:
                return self._values[name]
            case ast.Subscript():
                return self._builder.load(self._place(expression))
            case ast.Attribute(value=ast.Name(id="math"), attr="pi" | "e" | "inf" | "nan" as name):
                return ir.Constant(_FLOAT, getattr(math, name))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return self._builder.fsub(ir.Constant(_FLOAT, -0.0), self._value(operand), flags=_FAST)
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self._power(left, right)
            case ast.BinOp(left=left, op=op, right=right):
                return self._operation(op, self._value(left), right)
            case ast.IfExp(test=test, body=body, orelse=otherwise):
                return self._either(self._truth(test), body, otherwise)
            case ast.Call(keywords=[]):
                return self._call(expression)
        raise _Unknown(ast.unparse(expression))

    def _either(self, truth: Any, body: ast.expr, otherwise: ast.expr) -> Any:
        """One of two values; the other is not computed."""
        builder = self._builder
        first, second, after = (builder.append_basic_block() for _ in range(3))
        builder.cbranch(truth, first, second)
        arms = []
        for block, arm in ((first, body), (second, otherwise)):
            builder.position_at_end(block)
            arms.append((self._value(arm), builder.block))
            builder.branch(after)
        builder.position_at_end(after)
        result = builder.phi(_FLOAT)
        for value, block in arms:
            result.add_incoming(value, block)
        return result

    def _operation(self, op: ast.operator, left: Any, right: ast.expr) -> Any:
        name = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv"}.get(type(op))
        if name is None:
            raise _Unknown(type(op).__name__)
        return getattr(self._builder, name)(left, self._value(right), flags=_FAST)

    def _power(self, base: ast.expr, exponent: ast.expr) -> Any:
        """A power; with a whole exponent, products of squares."""
        if not (isinstance(exponent, ast.Constant) and isinstance(exponent.value, int)) or exponent.value < 1:
            return self._called("pow", [self._value(base), self._value(exponent)])
        square, left, result = self._value(base), exponent.value, None
        while True:
            if left & 1:
                result = square if result is None else self._builder.fmul(result, square, flags=_FAST)
            left >>= 1
            if not left:
                return result
            square = self._builder.fmul(square, square, flags=_FAST)

    def _call(self, call: ast.Call) -> Any:
        name, values = ast.unparse(call.func), [self._value(argument) for argument in call.args]
        if name in ("min", "max") and len(values) > 1:
            result, *others = values
            for other in others:
                better = self._builder.fcmp_ordered("<" if name == "min" else ">", other, result)
                result = self._builder.select(better, other, result)
            return result
        if name != "abs" and not name.startswith("math."):
            raise _Unknown(ast.unparse(call))
        return self._called("fabs" if name == "abs" else name.removeprefix("math."), values)

    def _called(self, name: str, values: Sequence[Any]) -> Any:
        kind = ir.FunctionType(_FLOAT, [_FLOAT] * len(values))
        if len(values) != {**_INTRINSIC, **_OF_C}.get(name):
            raise _Unknown(name)
        if name in _INTRINSIC:
            function = self._module.declare_intrinsic(f"llvm.{name}", [_FLOAT], kind)
        else:
            function = insert_pure_function(self._module, kind, name=name)  # else no loop is vectorised
        return self._builder.call(function, values, fastmath=_FAST)

    def _truth(self, test: ast.expr) -> Any:
        match test:
            case ast.Constant(value=bool(value)):
                return ir.Constant(_TRUTH, int(value))
            case ast.Name(id=name) if name in self._conditions:
                return self._conditions[name]
            case ast.IfExp(test=test, body=body, orelse=otherwise):
                return self._builder.select(self._truth(test), self._truth(body), self._truth(otherwise))
            case ast.BoolOp(op=op, values=[first, *others]):
                result = self._truth(first)
                for other in others:
                    join = self._builder.and_ if isinstance(op, ast.And) else self._builder.or_
                    result = join(result, self._truth(other))
                return result
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return self._builder.not_(self._truth(operand))
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _COMPARISONS:
                compare = (
                    self._builder.fcmp_unordered if isinstance(op, ast.NotEq) else self._builder.fcmp_ordered
                )
                return compare(_COMPARISONS[type(op)], self._value(left), self._value(right))
        raise _Unknown(ast.unparse(test))


_COMPARISONS: dict[type[ast.cmpop], str] = {
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip
