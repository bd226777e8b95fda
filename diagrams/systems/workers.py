"""Long computations, run in worker processes beside the diagram, or in place if there are none."""

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
COUNT = 2  # processes: one for pictures, one for learning or planning
_NICER = 5  # niceness added to workers, as commands to the arm come first
_HAND_OVER = 1e-3  # s after which a thread yields to another


def begun(
    worker: Executor | None,
    task: Callable[Arguments, Result],
    *args: Arguments.args,
    **kwargs: Arguments.kwargs,
) -> Future[Result]:
    """Start a task; without a worker, run it at once.

    A block keeps the future in its Context (`held`), checks at each of its events whether it is done, and
    then takes its `result`, which raises what the task raised. Task and arguments must not change meanwhile.
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
    """Run worker processes; on exit, those still working are killed.

    Meanwhile the threads of this process switch more often than by default, and its present objects are
    exempt from garbage collection, which would cause pauses.
    """
    from joblib.externals.loky import ProcessPoolExecutor  # takes closures, unlike that of the library

    before = sys.getswitchinterval()
    pool: Any = ProcessPoolExecutor(COUNT, timeout=None, initializer=_prepare, initargs=(os.getpid(),))
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
    """Import what tasks need, and take long enough that the other process has to start, too."""
    for name in (
        "slipmap.diagrams.perception.cell_perception",
        "slipmap.diagrams.systems.goal_and_push_planner",
        "slipmap.models.inference.identification",
    ):
        import_module(name)
    time.sleep(0.1)


def _prepare(parent: int) -> None:
    prepare_worker(parent)
    with suppress(OSError, AttributeError):
        # Real-time priority, where it exists, is meant for the diagram, not for its workers.
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    with suppress(OSError):
        os.nice(_NICER)
