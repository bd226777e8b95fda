"""BLAS threads while slipmap computes, and after."""

import threading

import cv2  # noqa: F401  # it has a BLAS of its own, like the next
import pytest
import scipy.linalg  # noqa: F401
from threadpoolctl import threadpool_info, threadpool_limits

import slipmap
from slipmap.models.blas import one_blas_thread


def threads():
    return {own["num_threads"] for own in threadpool_info() if own["user_api"] == "blas"}


@pytest.fixture
def two_threads():
    with threadpool_limits(2, "blas"):
        if threads() != {2}:
            pytest.skip("this BLAS has only one thread")
        yield


def test_public_calls_compute_on_one_blas_thread_and_give_the_others_back(two_threads):
    dataset, _ = slipmap.simulated_hammer(seed=1, fit=1, heldout=1)
    seen = set()
    slipmap.identify(dataset, hypotheses=2, friction_laws=False, progress=lambda *_: seen.update(threads()))
    assert seen == {1}
    assert threads() == {2}


def test_calls_within_calls_and_in_threads_leave_the_limit_to_the_outermost(two_threads):
    seen = []

    @one_blas_thread()
    def inner():
        seen.append(threads())

    with pytest.raises(ZeroDivisionError), one_blas_thread():
        inner()
        thread = threading.Thread(target=inner)
        thread.start()
        thread.join()
        seen.append(threads())
        raise ZeroDivisionError
    assert seen == [{1}, {1}, {1}]
    assert threads() == {2}


def test_calls_that_overlap_in_threads_leave_the_limit_to_the_last(two_threads):
    inside, leave, seen = threading.Event(), threading.Event(), []

    def other():
        with one_blas_thread():
            inside.set()
            leave.wait(10)
            seen.append(threads())

    thread = threading.Thread(target=other)
    with one_blas_thread():
        thread.start()
        inside.wait(10)
    leave.set()
    thread.join()
    assert seen == [{1}]
    assert threads() == {2}
    with one_blas_thread():
        assert threads() == {1}
    assert threads() == {2}
