"""Compilation of the kernels: once to machine code, kept on disk, and repeated when a kernel file changes.

Numba's own cache checks only the file of the outermost function and would keep stale code after a change in
another file. Here the name of the cache folder contains a hash of all kernel files instead. Numba also keeps
functions apart by the folder of their source; here by the text of their file alone, so that a checkout, its
copies and an installed package share what one of them has compiled.

A large function is compiled once and called by its address, a number that a kernel gets as an argument. Numba
copies functions called by name into each caller and optimises them again; a parallel loop alone holds three
copies. Formulas made at run time are called by address too, from kernels that were compiled before them.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from llvmlite import ir
from numba import njit, typeof, types
from numba._dispatcher import compute_fingerprint
from numba.core.caching import CompileResultCacheImpl, FunctionCache, UserProvidedCacheLocator
from numba.core.cgutils import if_unlikely
from numba.core.errors import TypingError
from numba.core.registry import CPUDispatcher
from numba.core.targetconfig import TargetConfig
from numba.extending import intrinsic, overload

# Read when the first parallel kernel runs. Threads without work would otherwise keep their cores busy: an
# identification took 12 s of processor time instead of 7.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")


def _same_options(first: TargetConfig, second: Any) -> bool:
    if type(first) is not type(second):
        return NotImplemented
    ours, theirs = first._values, second._values  # all others are at their defaults
    return ours == theirs or all(getattr(first, name) == getattr(second, name) for name in ours | theirs)


# Options of compilation all have the same hash, so Numba compares them one by one when it looks up a call: a
# hundred thousand times for one kernel. Comparing every option, as it would, takes a fifth of the whole time.
TargetConfig.__eq__ = _same_options
TargetConfig.__hash__ = lambda options: hash(type(options))


def _source_hash() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_root() -> Path:
    base = os.environ.get("SLIPMAP_CACHE") or os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "slipmap"


CACHE_FOLDER = _cache_root() / f"kernels-{_source_hash()}"
"""Folder of compiled kernels, under SLIPMAP_CACHE or XDG_CACHE_HOME if set, else under ~/.cache."""

LONE_FOLDER = CACHE_FOLDER.parent / "lone-kernels"
"""Folder of the compiled kernels of other packages, whose files call no kernel of another file."""


class _ByText(UserProvidedCacheLocator):
    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        path = Path(py_file)
        return f"{path.stem}-{hashlib.sha256(path.read_bytes()).hexdigest()[:16]}"


class _KeptByText(CompileResultCacheImpl):
    _locator_classes = (_ByText, *CompileResultCacheImpl._locator_classes)


class _Cache(FunctionCache):
    _impl_class = _KeptByText


class _Inlined(CPUDispatcher):
    """A function that only other compiled functions can call."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        raise TypeError(f"{self.py_func.__name__} is inlined into kernels; call it from a compiled function")


def compiled(folder: Path = CACHE_FOLDER, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: compile on first call and keep the result; options are Numba's.

    Functions with `forceinline` or `inline` can be called only from compiled functions.

    Args:
        folder: where the result is kept. In `LONE_FOLDER` only a change of a function's own file is noticed.
    """
    options["no_cfunc_wrapper"] = True  # nothing in C calls kernels
    inlined = "forceinline" in options or "inline" in options
    # A wrapper for calls from Python takes a fifth of the time of compiling.
    options["no_cpython_wrapper"] = inlined

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(error_model="numpy", **options)(function)
        if inlined:
            dispatcher.__class__ = _Inlined
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(folder)
        try:
            dispatcher._cache = _Cache(function)  # what cache=True does, with Numba's own class
        finally:
            numba.config.CACHE_DIR = before
        return dispatcher

    return decorate


def without_or_with(without: Any, given: Any) -> Any:
    """A function for kernels that is `without` if its first argument is None, and `given` otherwise.

    The choice is made when a kernel is compiled, so the two may return different types.
    """

    def choice(first: Any, *others: Any) -> Any:
        raise TypeError("this function runs only in compiled code")

    @overload(choice, jit_options={"forceinline": True})
    def chosen(first, *others):  # type: ignore[no-untyped-def]
        function = without if isinstance(first, types.NoneType) else given
        return lambda first, *others: function(first, *others)

    return choice


def needs_compiling() -> bool:
    """Whether the next call of a kernel must compile it first, which takes half a minute to two minutes."""
    return not any(CACHE_FOLDER.glob("**/*.nbc"))


_addresses: dict[tuple[Any, bytes], int] = {}


def address_of(function: Any, arguments: tuple[Any, ...]) -> int:
    """Address of a compiled function for arguments of these types; compiles it if needed."""
    key = function, compute_fingerprint(arguments)
    if key not in _addresses:
        # Numba keeps what it compiled for a tuple of types and for a signature apart; calls use tuples.
        kinds = tuple(typeof(argument) for argument in arguments)
        function.compile(kinds)
        result = function.overloads[kinds]
        if result.signature.return_type != types.none:
            raise TypingError(f"{function.__name__} is called by address, so it must not return anything")
        _addresses[key] = int(result.library.get_pointer_to_function(result.fndesc.llvm_func_name))
    return _addresses[key]


@intrinsic
def call_compiled(typingctx, function, address, arguments):  # type: ignore[no-untyped-def]
    """Call a compiled function, which returns nothing, by its address from `address_of`.

    The function itself is passed to check the types of the arguments.
    """
    kinds = tuple(arguments)
    if kinds not in function.dispatcher.overloads:
        raise TypingError(f"{function.dispatcher.py_func.__name__}: not compiled for {kinds}")
    signature = types.void(function, address, arguments)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        shape = context.call_conv.get_function_type(types.none, kinds)
        target = builder.inttoptr(args[1], shape.as_pointer())
        values = [builder.extract_value(args[2], k) for k in range(len(kinds))]
        status, _ = context.call_conv.call_function(builder, target, types.none, kinds, values)
        with if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def call_address(typingctx, address, arrays):  # type: ignore[no-untyped-def]
    """Call the C function `void f(double*, double*, …)` at an integer address with a tuple of arrays.

    Nothing is checked: the arrays must be contiguous float arrays of the lengths that the function expects.
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


@intrinsic
def borrowed(typingctx, value):  # type: ignore[no-untyped-def]
    """The same arrays, alone or in tuples, without reference counting.

    Numba counts references to each array of a tuple whenever a function receives it, even if the function is
    inlined; in a step of a third of a microsecond that takes longer than the arithmetic. The caller must
    `keep` what it borrowed until the last use.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _uncounted(context, builder, signature.args[0], args[0])

    return value(value), generate


def _uncounted(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = array.meminfo.type(None)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for k, part in enumerate(kind):
            entry = _uncounted(context, builder, part, builder.extract_value(value, k))
            value = builder.insert_value(value, entry, k)
    return value


@intrinsic
def keep(typingctx, value):  # type: ignore[no-untyped-def]
    """Keep arrays, alone or in tuples, alive until this call."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return context.get_dummy_value()

    return types.void(value), generate
