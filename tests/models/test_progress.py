"""Independent parts of long computations, side by side."""

import threading
import time

import pytest

from slipmap.models import progress
from slipmap.models.progress import Cores, go_on, shares_of, side_by_side


@pytest.fixture(autouse=True)
def three_cores(monkeypatch):  # type: ignore[no-untyped-def]
    own = Cores(3)
    monkeypatch.setattr(progress, "cores", lambda: own)


def test_results_come_in_the_order_of_the_tasks() -> None:
    later = threading.Event()

    def first() -> str:
        assert later.wait(30)  # a task that must wait for another one
        return "first"

    def second() -> str:
        later.set()
        return "second"

    assert side_by_side([first, second]) == ["first", "second"]
    assert side_by_side([]) == []


def test_no_core_is_free_while_tasks_work_on_all() -> None:
    begun, asked = threading.Barrier(3), threading.Barrier(3)

    def work() -> bool:
        begun.wait(30)
        free = progress.cores().any_free
        asked.wait(30)
        return free

    assert side_by_side([work, work, work]) == [False, False, False]
    assert progress.cores().any_free


def test_a_thread_that_waits_leaves_its_core_to_others(monkeypatch: pytest.MonkeyPatch) -> None:
    own = Cores(2)
    monkeypatch.setattr(progress, "cores", lambda: own)
    begun = threading.Event()

    def task() -> bool:
        if threading.current_thread() is threading.main_thread():
            return begun.wait(30)
        taken = not own.any_free
        begun.set()
        end = time.monotonic() + 30
        while not own.any_free and time.monotonic() < end:
            time.sleep(1e-3)
        return taken and own.any_free

    assert side_by_side([task, task]) == [True, True]
    assert own.take()
    assert not own.take()


def test_the_first_failing_task_is_told() -> None:
    failed = threading.Event()

    def first() -> None:
        assert failed.wait(30)
        raise ValueError("first")

    def second() -> None:
        failed.set()
        raise KeyError("second")

    with pytest.raises(ValueError, match="first"):
        side_by_side([first, second])


def test_a_task_that_ends_its_thread_is_an_error_too() -> None:
    for _ in range(4):  # and its place is free for another
        begun = threading.Event()

        def task(begun: threading.Event = begun) -> None:
            if threading.current_thread() is threading.main_thread():
                assert begun.wait(30)
            else:
                begun.set()
                raise SystemExit(3)

        with pytest.raises(SystemExit):
            side_by_side([task, task])


def test_an_interruption_ends_the_tasks_of_all_threads() -> None:
    """Those too that another thread waits for."""
    begun, threads = threading.Barrier(3), []

    def inner() -> None:
        begun.wait(30)
        while threading.current_thread() is not threads[0]:
            go_on()

    def outer() -> None:
        if threading.current_thread() is threading.main_thread():
            begun.wait(30)
            threads.extend(set(threading.enumerate()) - before - {threads[0]})
            raise KeyboardInterrupt
        threads.append(threading.current_thread())
        side_by_side([inner, inner])

    before = set(threading.enumerate())
    with pytest.raises(KeyboardInterrupt):
        side_by_side([outer, outer])
    for thread in threads:
        thread.join(30)
    assert len(threads) == 2 and not any(thread.is_alive() for thread in threads)


def test_no_more_tasks_within_tasks_run_than_there_are_cores() -> None:
    most, running, lock = 0, 0, threading.Lock()

    def leaf() -> None:
        nonlocal most, running
        with lock:
            running += 1
            most = max(most, running)
        threading.Event().wait(0.01)
        with lock:
            running -= 1

    side_by_side([lambda: side_by_side([leaf] * 4)] * 4)
    assert 1 < most <= 3
    most = 0
    side_by_side([leaf] * 3)
    assert most > 1  # threads that have ended may start again


def test_shares_of_parts_add_up_and_never_fall() -> None:
    told: list[tuple[int, int]] = []
    first, second = shares_of(lambda done, total: told.append((done, total)), 2)
    first(1, 2), second(3, 10), first(1, 4), second(1, 1), first(2, 2)
    assert told == [(25, 100), (40, 100), (40, 100), (75, 100), (100, 100)]
