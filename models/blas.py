"""BLAS on one thread, for the time of a computation.

The matrices here are small, and rollouts and independent parts have threads of their own. Where other
programs use the same cores, BLAS threads that wait for each other make an identification eight times slower.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS in this process to one thread. Also a decorator; calls may be nested, also in threads."""
    with _blas().limit(limits=1, user_api="blas"):
        yield


@cache
def _blas() -> Any:
    import scipy.linalg  # noqa: F401  # has a BLAS of its own, which must be loaded to be found
    from threadpoolctl import ThreadpoolController  # the search takes 1 ms, so it is kept

    return ThreadpoolController()
