"""Long computations, run in worker processes beside the diagram, or in place if there are none. Workers end
with their parent, however it ends.
"""

import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, wait
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing import resource_tracker
from typing import Any, ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
COUNT = 2  # processes: one for pictures, one for learning or planning
_NICER = 5  # niceness added to workers, as commands to the arm come first
_HAND_OVER = 1e-3  # s after which a thread yields to another
_EVERY = 1.0  # s between two looks whether the parent still runs

_in_place = 0.0  # s


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
    global _in_place
    future: Future[Result] = Future()
    started = time.perf_counter()
    try:
        future.set_result(task(*args, **kwargs))
    except Exception as error:
        future.set_exception(error)
    finally:  # also if Ctrl-C ends it
        _in_place += time.perf_counter() - started
    return future


def time_in_place() -> float:
    """Time that this process has spent on tasks run in place, s; only differences have a meaning."""
    return _in_place


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
        with deaf_workers():
            loaded = [pool.submit(_load) for _ in range(COUNT)]
        wait(loaded)
        gc.collect()
        gc.freeze()
        sys.setswitchinterval(_HAND_OVER)
        yield pool
    finally:
        sys.setswitchinterval(before)
        gc.unfreeze()
        pool.shutdown(wait=True, kill_workers=True)


@contextmanager
def deaf_workers() -> Iterator[None]:
    """Workers that start meanwhile do not hear Ctrl-C, which reaches all processes of a terminal.

    Before `prepare_worker` they would end with a traceback. This process may hear it only afterwards.
    """
    resource_tracker.ensure_running()  # its start would end the block's effect
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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


def prepare_worker(parent: int) -> None:
    """Ignore Ctrl-C, which the parent handles, and exit within seconds of the parent's end, even if killed.

    Call it first in a worker.

    Args:
        parent: number of its process, as the parent knows it: it may have ended before the worker began.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_EVERY)
    os._exit(1)
