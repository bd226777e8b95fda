"""Long computations: callbacks for their progress, and independent parts side by side."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache, partial
from typing import Any, TypeVar

Result = TypeVar("Result")
Progress = Callable[[str, int, int], None]  # called with (stage, done, total)
StageProgress = Callable[[int, int], None]  # the same for one stage: called with (done, total)


def silent(stage: str, done: int, total: int) -> None:
    """Ignore the progress."""


def about(what: str, progress: Progress) -> Progress:
    """Progress whose stages name their subject: `fitting, without effects`."""
    return lambda stage, done, total: progress(f"{stage}, {what}", done, total)


def part_of(progress: StageProgress, place: int, parts: int) -> StageProgress:
    """Progress of one of several equally long parts, counted over all of them."""
    return lambda done, total: progress(place * total + done, parts * total)


def shares_of(progress: StageProgress, parts: int) -> list[StageProgress]:
    """Progress of several equally long parts that may run side by side, added up."""
    shares, lock = [0.0] * parts, threading.Lock()

    def report(place: int, done: int, total: int) -> None:
        with lock:
            shares[place] = max(shares[place], done / max(total, 1))
            progress(round(100 * sum(shares) / parts), 100)

    return [partial(report, place) for place in range(parts)]


class Cores:
    """Cores that no thread of `side_by_side` works on."""

    def __init__(self, count: int) -> None:
        self._lock, self._free = threading.Lock(), count - 1  # this thread works too

    def take(self) -> bool:
        """Take one for a thread that is about to start, if there is one; whether there was."""
        with self._lock:
            if self._free <= 0:
                return False
            self._free -= 1
            return True

    def give_back(self) -> None:
        """Give one back when a thread ends."""
        with self._lock:
            self._free += 1

    @contextmanager
    def given_back(self) -> Iterator[None]:
        """Lend this thread's core to others while it waits for them."""
        self.give_back()
        try:
            yield
        finally:
            with self._lock:
                self._free -= 1

    @property
    def any_free(self) -> bool:
        """Whether a thread may start, or use more than one core itself."""
        return self._free > 0


@cache
def cores() -> Cores:
    """Those of this program."""
    from numba import config  # takes long to import, and most commands need no rollouts

    return Cores(config.NUMBA_NUM_THREADS)


class Unwanted(BaseException):
    """The task of a thread whose caller was interrupted."""


_helping = threading.local()  # `wanted()`: whether its caller still waits for this thread's task


def go_on() -> None:
    """End this thread's task if nobody waits for it any more; long tasks call it now and then.

    Raises:
        Unwanted: the caller of `side_by_side` was interrupted, as by Ctrl-C in a notebook.
    """
    if not getattr(_helping, "wanted", lambda: True)():
        raise Unwanted


def side_by_side(tasks: Sequence[Callable[[], Result]]) -> list[Result]:
    """Results of independent tasks, run on this thread and on others; as many are at work as there are cores.

    Rollouts, and most of NumPy, let other threads run meanwhile. The results are those of one task after the
    other, whatever the number of threads.

    Args:
        tasks: to run; one must not change what another one reads.

    Raises:
        Exception: that of the first task that raises one; later tasks may not have run then.
    """
    results: list[Any] = [None] * len(tasks)
    errors: dict[int, BaseException] = {}
    numbers, lock = iter(range(len(tasks))), threading.Lock()
    stopped, outer, own = False, getattr(_helping, "wanted", lambda: True), cores()

    def work() -> None:
        while not stopped and not errors:
            with lock:
                number = next(numbers, None)
            if number is None:
                return
            try:
                results[number] = tasks[number]()
            except BaseException as error:
                errors[number] = error
                if not isinstance(error, Exception):
                    raise

    def help_out() -> None:
        _helping.wanted = lambda: not stopped and outer()
        with suppress(BaseException):  # this thread's caller raises it
            work()
        own.give_back()

    threads: list[threading.Thread] = []
    try:
        while len(threads) < len(tasks) - 1 and own.take():
            # It ends with the program even if that is interrupted.
            threads.append(threading.Thread(target=help_out, daemon=True))
            try:
                threads[-1].start()
            except RuntimeError:  # no more threads
                threads.pop()
                own.give_back()
                break
        work()
        if threads:
            with own.given_back():
                for thread in threads:
                    thread.join()
    finally:
        stopped = True
    if errors:
        raise errors[min(errors)]
    return results
