"""In which order jobs are handed to threads, so that all are busy to the end."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


def evenly_dealt(steps: NDArray[np.int64], models: int, threads: int | None = None) -> NDArray[np.int64]:
    """Jobs k B + b of models times pushes, in an order whose equal parts, one a thread, are equally long.

    A parallel loop gives each thread one run of consecutive jobs. With ten pushes in the order of their
    recording, one of two threads waited for an eighth of the time.

    Args:
        steps: (B,) of each push.
        models: K.
        threads: among which jobs are dealt; those of numba if None.
    """
    threads = numba.get_num_threads() if threads is None else threads
    longest_first = np.argsort(-np.tile(steps, models), kind="stable")
    turn, seat = np.divmod(np.arange(len(longest_first)), threads)
    # Dealt there and back, as who is first in one turn gets the longer job.
    hand = np.where(turn % 2 == 0, seat, threads - 1 - seat)
    return longest_first[np.argsort(hand, kind="stable")]
