"""An object that something else moves, or that is lost, while the arm is on its way or between pushes."""

from __future__ import annotations

import numpy as np
import pytest

from slipmap.diagrams.execution.push_executor import MOVED, TIMES, TURNED, ObjectWatch, PushExecutor
from slipmap.diagrams.execution.requests import ActivePush, ExecutionStatus
from slipmap.diagrams.station.arm import HOME
from slipmap.models.perception.seen_object import ObservedPose
from tests.diagrams.systems.driven_block import DrivenBlock, seen_at
from tests.hardware.guarded_arm import KINEMATICS, MODEL, PUSH

PICTURE = 0.1


class Cell:
    """An object watch and what it sees."""

    def __init__(self) -> None:
        rest = {"object_pose": seen_at(0.1, 0.0, 0.3), "execution": ExecutionStatus("home")}
        self.block = DrivenBlock(ObjectWatch(), **rest)
        self.block.advance(PICTURE)
        self.block.set(execution=ExecutionStatus("approaching", 1))

    def see(self, *poses) -> str:
        for pose in poses:
            seen = ObservedPose.unseen("occluded") if pose is None else seen_at(*pose, time=self.block.time)
            self.block.set(object_pose=seen)
            self.block.advance(PICTURE)
        return self.block.read("moved")


AWAY, TURNED_ONLY = (0.1 + 2 * MOVED, 0.0, 0.3), (0.1, 0.0, 0.3 - 2 * TURNED)


@pytest.mark.parametrize("away", [AWAY, TURNED_ONLY])
def test_an_object_that_something_else_moved_is_told_after_three_pictures(away):
    cell = Cell()
    assert cell.see(*[away] * (TIMES - 1)) == ""
    assert "something else moved the object" in cell.see(away)
    assert cell.see(None, away) != ""
    cell.block.set(execution=ExecutionStatus("refused", 1))
    assert cell.see(away) == ""


def test_how_far_is_said():
    assert "by 20 mm and 0°" in Cell().see(*[AWAY] * TIMES)


@pytest.mark.parametrize(
    "poses",
    [
        [AWAY, AWAY, (0.1, 0.0, 0.3)] * 3,
        [(0.1 + 0.8 * MOVED, 0.0, 0.3)] * 6,
        [(0.1, 0.0, 0.3 - 2 * np.pi)] * 6,
        [None] * 6,
    ],
    ids=["seldom", "little", "the angle counted otherwise", "hidden by the arm"],
)
def test_an_object_that_seems_moved_seldom_or_little_or_is_hidden_stops_nothing(poses):
    assert Cell().see(*poses) == ""


def test_one_picture_counts_once():
    cell = Cell()
    cell.see(AWAY)
    cell.block.advance(10 * PICTURE)
    assert cell.block.read("moved") == ""


def test_while_the_finger_pushes_the_object_may_move():
    cell = Cell()
    cell.block.set(execution=ExecutionStatus("pushing", 1))
    assert cell.see(*[AWAY] * 6) == ""


def arm() -> DrivenBlock:
    rest = {"iiwa.position_measured": HOME, "iiwa.torque_external": np.zeros(7), "moved": ""}
    block = DrivenBlock(PushExecutor(MODEL, HOME), push=ActivePush(1, PUSH), **rest)
    block.advance(1.0)
    assert block.read("status").mode == "approaching"
    return block


def test_a_push_whose_object_was_moved_is_given_up_on_the_way_and_counts_as_refused():
    """The supervisors then choose anew. The finger does not come down."""
    block = arm()
    block.set(moved="something else moved the object by 20 mm")
    lowest = np.inf
    while block.time < 4.0:
        block.advance(0.05)
        lowest = min(lowest, KINEMATICS.pose(block.read("iiwa.position")).translation()[2])
    status = block.read("status")
    assert (status.mode, status.push_id) == ("refused", 1)
    assert status.reason == "something else moved the object by 20 mm"
    assert lowest > 0.075
    assert block.read("iiwa.position") == pytest.approx(HOME, abs=1e-6)
    block.set(moved="", push=ActivePush(2, PUSH))
    block.advance(0.5)
    assert (block.read("status").mode, block.read("status").push_id) == ("approaching", 2)


def test_once_the_finger_pushes_the_push_goes_on():
    block = arm()
    while block.read("status").mode != "pushing":
        block.advance(0.1)
    block.set(moved="something else moved the object by 20 mm")
    block.advance(0.3)
    assert block.read("status").mode == "pushing"
