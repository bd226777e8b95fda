"""BLAS on one thread, for the time of a computation.

The matrices here are small, and rollouts and independent parts have threads of their own. Where other
programs use the same cores, BLAS threads that wait for each other make an identification eight times slower.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

_lock = threading.Lock()
_inside = 0  # computations under way, in all threads
_limits: Any = None  # set by the first of them, undone by the last


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS in this process to one thread until the last computation under way has ended.

    Also a decorator; computations may be nested or overlap, in any threads.
    """
    global _inside, _limits
    with _lock:
        _inside += 1
        if _inside == 1:
            _limits = _blas().limit(limits=1, user_api="blas")
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0:
                _hand_over()  # the first may have been another thread
                _limits.restore_original_limits()
                _hand_over()


def _hand_over() -> None:
    """Let the next thread that asks set the number of BLAS's threads; otherwise only one thread may."""
    from threadpoolctl import OpenBLASController

    OpenBLASController.clear_controlling_thread(force=True)


@cache
def _blas() -> Any:
    import scipy.linalg  # noqa: F401  # has a BLAS of its own, which must be loaded to be found
    from threadpoolctl import ThreadpoolController  # the search takes 1 ms, so it is kept

    return ThreadpoolController()
