"""Jobs dealt to threads."""

from __future__ import annotations

import numpy as np

from slipmap.models.physics.kernel_tools import evenly_dealt


def test_every_job_is_dealt_once_and_all_threads_get_about_as_much() -> None:
    steps = np.array([177, 172, 256, 170, 129, 437, 151, 249, 177, 132])
    order = evenly_dealt(steps, 3, threads=2)
    assert sorted(order) == list(range(30))
    work = np.tile(steps, 3)[order]
    assert abs(work[:15].sum() - work[15:].sum()) < 0.03 * work.sum()
    order = evenly_dealt(np.array([400, 300, 200, 100]), 1, threads=2)
    assert {frozenset(order[:2]), frozenset(order[2:])} == {frozenset({0, 3}), frozenset({1, 2})}
