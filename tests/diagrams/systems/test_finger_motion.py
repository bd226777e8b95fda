"""The finger as the sliding model gets it."""

from __future__ import annotations

import numpy as np
import pytest
from driven_block import DrivenBlock
from pydrake.math import RigidTransform

from slipmap.diagrams.execution.requests import MODES, ActivePush, ExecutionStatus
from slipmap.diagrams.systems.finger import FingerMotion
from slipmap.planners.table_push import TablePush

PERIOD = 0.01
VELOCITY = np.array([0.06, -0.08])


def moving() -> DrivenBlock:
    block = DrivenBlock(FingerMotion(PERIOD), tip_pose=RigidTransform(), execution=ExecutionStatus("home"))
    block.advance(0.5 * PERIOD)
    return block


def step(block: DrivenBlock, mode: str) -> np.ndarray:
    """The output after one more period, the finger moving on all the while."""
    place = VELOCITY * (block.time + PERIOD)
    block.set(tip_pose=RigidTransform([*place, 0.004]), execution=ExecutionStatus(mode, 0))
    block.advance(PERIOD)
    return block.read("finger")


@pytest.mark.parametrize("mode", [mode for mode in MODES if mode != "pushing"])
def test_a_finger_that_does_not_push_is_nowhere(mode):
    block = moving()
    assert np.isnan(block.read("finger")).all()
    for _ in range(3):
        assert np.isnan(step(block, mode)).all()


def test_a_pushing_finger_has_place_and_velocity():
    block = moving()
    for _ in range(5):
        step(block, "lowering")
    first = step(block, "pushing")
    assert first[:2] == pytest.approx(VELOCITY * block.time)
    assert first[2:] == pytest.approx([0, 0])  # where it was before is not known
    for _ in range(3):
        now = step(block, "pushing")
        assert now[:2] == pytest.approx(VELOCITY * block.time)
        assert now[2:] == pytest.approx(VELOCITY)


def test_between_pushes_the_finger_does_not_jump():
    block = moving()
    step(block, "pushing")
    for _ in range(10):
        assert np.isnan(step(block, "retreating")).all()
    assert step(block, "pushing")[2:] == pytest.approx([0, 0])
    assert step(block, "pushing")[2:] == pytest.approx(VELOCITY)


def test_a_finger_that_was_not_measured_for_a_while_does_not_strike_the_model():
    """A stall of half a second, after which the steps that were missed follow at once."""
    block = moving()
    push = ActivePush(0, TablePush([0.0, 0.0], [0.6, -0.8], speed=0.1))
    block.set(push=push)
    step(block, "pushing")
    start = step(block, "pushing")
    jumped = start[:2] + 0.5 * VELOCITY
    block.set(tip_pose=RigidTransform([*jumped, 0.004]))
    places = [start[:2]]
    for _ in range(45):
        block.advance(PERIOD)
        place, velocity = np.split(block.read("finger"), 2)
        assert np.hypot(*velocity) <= 1.25 * 0.1 + 1e-12
        assert velocity == pytest.approx((place - places[-1]) / PERIOD)
        places.append(place)
    assert places[-1] == pytest.approx(jumped)
    assert np.hypot(*(places[10] - start[:2])) == pytest.approx(10 * PERIOD * 0.125)
