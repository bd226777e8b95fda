"""Work that takes long, done beside the diagram by other processes, or at once where there are none."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from typing import Any, ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

COUNT = 2
"""Processes: one for pictures, one for learning or planning."""

_NICER = 5  # of a worker: what commands the arm comes first


def begun(
    worker: Executor | None,
    task: Callable[Arguments, Result],
    *args: Arguments.args,
    **kwargs: Arguments.kwargs,
) -> Future[Result]:
    """A task under way, or already done where there is no worker.

    A block keeps it in its Context (`held`), asks at each of its events whether it is done, and then takes
    its `result`, which raises what the task raised. Task and arguments must not change meanwhile.
    """
    if worker is not None:
        return worker.submit(task, *args, **kwargs)
    future: Future[Result] = Future()
    future.set_result(task(*args, **kwargs))
    return future


@contextmanager
def workers() -> Iterator[Executor]:
    """Processes for tasks; at the end those that still work are ended."""
    from joblib.externals.loky import ProcessPoolExecutor  # takes closures, unlike that of the library

    pool: Any = ProcessPoolExecutor(COUNT, timeout=None, initializer=_prepare)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, kill_workers=True)


def _prepare() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the diagram's affair
    with suppress(OSError):
        os.nice(_NICER)
