"""Copies between arrays in kernels, without the slice assignments of numba.

Each kind of slice assignment brings along code that writes the shapes into an error message, which takes
three seconds to compile.
"""

from __future__ import annotations

from models.physics.compiled import compiled


@compiled(forceinline=True)
def copy_into(target, source):  # type: ignore[no-untyped-def]
    """Copy (n,) numbers.

    Raises:
        ValueError: the lengths differ.
    """
    if target.shape[0] != source.shape[0]:
        raise ValueError("copy_into: lengths differ")
    for i in range(source.shape[0]):
        target[i] = source[i]


@compiled(forceinline=True)
def add_columns(target, first, source, count):  # type: ignore[no-untyped-def]
    """Add the first `count` columns of `source` to those of `target` from `first` on, of equal rows."""
    for a in range(target.shape[0]):
        for k in range(count):
            target[a, first + k] += source[a, k]
