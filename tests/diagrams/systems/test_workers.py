"""Blocks with and without a worker say the same, and with one the diagram does not wait."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest
from driven_block import DrivenBlock, seen_at
from hidden_effects import tilted_pushes

from slipmap.diagrams.systems import identification
from slipmap.diagrams.systems.exploration import Exploration
from slipmap.diagrams.systems.identification import PERIOD, Identification
from slipmap.diagrams.systems.loop_messages import LoopStatus
from slipmap.diagrams.systems.workers import begun, workers
from slipmap.planners.settings import PokeSettings


def seen() -> SimpleNamespace:
    grid = tilted_pushes().grid
    return SimpleNamespace(grid=grid, cell_heights=np.full(len(grid), 0.05))


@pytest.fixture(scope="module")
def pool():
    """The processes, which end with the block."""
    with workers() as pool:
        process = begun(pool, os.getpid).result()
        assert begun(None, os.getpid).result() == os.getpid() != process
        yield pool
    deadline = time.monotonic() + 10.0
    while _runs(process) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _runs(process)


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def learner(worker) -> DrivenBlock:
    block = Identification(
        lambda trials, grid: replace(tilted_pushes(), trials=tuple(trials)),
        hypotheses=4,
        seed=7,
        worker=worker,
    )
    return DrivenBlock(block, trials=tilted_pushes().fit_trials[:2], cell_grid=tilted_pushes().grid)


def chooser(worker) -> DrivenBlock:
    def allowed(obstacle, push) -> bool:
        return push.begin[0] > 0.0

    block = Exploration("random", 9, 0.008, PokeSettings(), allowed, 3, worker)
    status = LoopStatus("choosing", 0)
    return DrivenBlock(
        block, belief=None, object_pose=seen_at(0.02, -0.03, 0.4), seen_object=seen(), status=status
    )


def awaited(block: DrivenBlock, port: str):
    """What comes, in the end, out of a port that says nothing before."""
    deadline = time.monotonic() + 60.0
    while not block.read(port) and time.monotonic() < deadline:
        block.advance(PERIOD)
        time.sleep(0.01)
    return block.read(port)


def test_the_belief_is_the_same(pool):
    inside, beside = learner(None), learner(pool)
    inside.advance(PERIOD)
    assert inside.read("learned") == 2
    beside.advance(PERIOD)
    assert beside.read("learned") == 0  # it goes on while the worker learns
    assert awaited(beside, "learned") == 2
    ours, theirs = inside.read("belief"), beside.read("belief")
    np.testing.assert_array_equal(ours.maps.mass, theirs.maps.mass)
    np.testing.assert_array_equal(ours.probability, theirs.probability)


def test_the_push_is_the_same(pool):
    inside, beside = chooser(None), chooser(pool)
    inside.advance(PERIOD)
    ours, theirs = inside.read("plan"), awaited(beside, "plan")
    assert ours.number == theirs.number
    np.testing.assert_array_equal(ours.choice.push.begin, theirs.choice.push.begin)
    np.testing.assert_array_equal(ours.choice.push.end, theirs.choice.push.end)


def test_a_learner_does_not_begin_twice(monkeypatch):
    asked, go = [], Event()

    def slow(dataset, **rest):
        asked.append(dataset)
        go.wait(10.0)
        raise ValueError("no belief")

    monkeypatch.setattr(identification, "identify", slow)
    with ThreadPoolExecutor(1) as worker:
        block = learner(worker)
        block.advance(5 * PERIOD)
        go.set()
        with pytest.raises(ValueError, match="no belief"):
            for _ in range(100):
                block.advance(PERIOD)
                time.sleep(0.01)
    assert len(asked) == 1
