"""Work that takes long, done beside the diagram by others, or at once where there are none."""

import gc
import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, wait
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any, ParamSpec, TypeVar

from slipmap.models.process_end import prepare_worker

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

COUNT = 2
"""Processes: one for pictures, one for learning or planning."""

_NICER = 5  # of a worker: what commands the arm comes first
_HAND_OVER = 1e-3  # s after which a thread lets another go on


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
    try:
        future.set_result(task(*args, **kwargs))
    except Exception as error:
        future.set_exception(error)
    return future


@contextmanager
def workers() -> Iterator[Executor]:
    """Processes for tasks, up and running; at the end those that still work are ended.

    Meanwhile the threads of this process hand over more often than by default, and what it holds is not
    searched for garbage, which would stop everything for a while now and then.
    """
    from joblib.externals.loky import ProcessPoolExecutor  # takes closures, unlike that of the library

    before = sys.getswitchinterval()
    pool: Any = ProcessPoolExecutor(COUNT, timeout=None, initializer=_prepare)
    try:
        wait([pool.submit(_load) for _ in range(COUNT)])
        gc.collect()
        gc.freeze()
        sys.setswitchinterval(_HAND_OVER)
        yield pool
    finally:
        sys.setswitchinterval(before)
        gc.unfreeze()
        pool.shutdown(wait=True, kill_workers=True)


def _load() -> None:
    """Load what tasks need, and take so long that the other process has to start, too."""
    for name in (
        "slipmap.diagrams.perception.cell_perception",
        "slipmap.diagrams.systems.goal_and_push_planner",
        "slipmap.models.inference.identification",
    ):
        import_module(name)
    time.sleep(0.1)


def _prepare() -> None:
    prepare_worker()
    with suppress(OSError, AttributeError):
        # Who gave the diagram real-time priority, where there is such a thing, did not mean its workers.
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    with suppress(OSError):
        os.nice(_NICER)
