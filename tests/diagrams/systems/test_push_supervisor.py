"""The order of the loop: what each mode waits for, and when it gives up."""

from __future__ import annotations

import numpy as np
import pytest
from driven_block import DrivenBlock, seen_at

from slipmap.diagrams.execution.requests import ExecutionStatus
from slipmap.diagrams.systems.diagnosis import Repair
from slipmap.diagrams.systems.loop_messages import MOST_ATTEMPTS, ExplorationPlan, LoopStatus
from slipmap.diagrams.systems.supervisors import MOST_MISSED, PATIENCE, PERIOD, PushSupervisor
from slipmap.models.perception.seen_object import ObservedPose
from slipmap.planners.action_selection import Choice
from slipmap.planners.table_push import TablePush

GRID = object()  # the supervisor only asks whether there is one
CHOICE = Choice(TablePush(np.zeros(2), np.array([0.1, 0.0]), 0.05), np.zeros(2), np.array([1.0, 0.0]))
AT_HOME = ExecutionStatus("home")
UNSEEN = ObservedPose.unseen("occluded")


class Loop(DrivenBlock):
    """A supervisor whose partners do what the test says."""

    def __init__(self, fit: int = 1, heldout: int = 0, patience: float = PATIENCE) -> None:
        super().__init__(
            PushSupervisor(fit, heldout, patience=patience),
            object_pose=UNSEEN, cell_grid=None, plan=None, execution=AT_HOME, trials=(), learned=0, missed=(),
        )  # fmt: skip
        self.advance(0.5 * PERIOD)  # decisions fall between the steps of the test

    def step(self, **inputs) -> LoopStatus:
        """The status after one decision."""
        self.set(**inputs)
        self.advance(PERIOD)
        return self.read("status")

    def begin_push(self) -> LoopStatus:
        """From looking to pushing."""
        assert self.step(object_pose=seen_at(0, 0, 0), cell_grid=GRID).mode == "choosing"
        return self.step(plan=ExplorationPlan(self.read("status").number, CHOICE))


def mode(status: LoopStatus) -> tuple[str, int, int]:
    return status.mode, status.push, status.attempt


def test_the_modes_follow_in_order():
    """One push to learn from and one to judge; each mode lasts until what it waits for has come."""
    loop = Loop(fit=1, heldout=1)
    record = (object(),)
    assert mode(loop.step()) == ("looking", 0, 0)
    assert mode(loop.step(object_pose=seen_at(0, 0, 0))) == ("looking", 0, 0)  # no cells yet
    assert mode(loop.step(object_pose=UNSEEN, cell_grid=GRID)) == ("looking", 0, 0)
    assert mode(loop.step(object_pose=seen_at(0, 0, 0))) == ("choosing", 0, 0)
    assert mode(loop.step()) == ("choosing", 0, 0)
    assert loop.read("active_push") is None
    assert mode(loop.step(plan=ExplorationPlan(0, CHOICE))) == ("pushing", 0, 0)
    for doing in ("approaching", "lowering", "pushing", "retreating"):
        assert loop.read("active_push").push is CHOICE.push
        assert mode(loop.step(execution=ExecutionStatus(doing, 0), object_pose=UNSEEN)) == ("pushing", 0, 0)
    assert mode(loop.step(execution=ExecutionStatus("home", 0))) == ("recording", 0, 0)
    assert loop.read("active_push") is None
    assert mode(loop.step()) == ("recording", 0, 0)
    assert mode(loop.step(trials=record)) == ("learning", 0, 0)
    assert mode(loop.step()) == ("learning", 0, 0)
    assert mode(loop.step(learned=1)) == ("looking", 1, 0)
    assert loop.begin_push().push == 1
    assert (
        mode(loop.step(execution=ExecutionStatus("home", loop.read("active_push").push_id)))[0] == "recording"
    )
    assert mode(loop.step()) == ("recording", 1, 0)  # the first push's record does not count for this one
    assert mode(loop.step(trials=2 * record)) == ("learning", 1, 0)
    assert mode(loop.step()) == ("finished", 2, 0)  # from a push that only judges, nothing is learned
    assert mode(loop.step(object_pose=seen_at(0, 0, 0))) == ("finished", 2, 0)


def test_every_push_has_a_number_of_its_own():
    numbers = {LoopStatus("pushing", push, k).number for push in range(5) for k in range(MOST_ATTEMPTS)}
    assert len(numbers) == 5 * MOST_ATTEMPTS


def test_only_what_was_asked_for_counts():
    """Requests and arm reports of another push are not taken for this one's."""
    loop = Loop(fit=2)
    assert loop.begin_push().mode == "pushing"
    for old in (None, 7):
        assert loop.step(execution=ExecutionStatus("home", old)).mode == "pushing"
        assert loop.step(execution=ExecutionStatus("refused", old, "too far")).mode == "pushing"
    loop.step(execution=ExecutionStatus("home", 0))
    loop.step(trials=(object(),))
    assert mode(loop.step(learned=1)) == ("looking", 1, 0)
    assert mode(loop.step()) == ("choosing", 1, 0)
    assert mode(loop.step()) == ("choosing", 1, 0)  # the first push's request still stands
    assert mode(loop.step(plan=ExplorationPlan(MOST_ATTEMPTS, CHOICE))) == ("pushing", 1, 0)
    assert loop.read("active_push").push_id == MOST_ATTEMPTS
    assert mode(loop.step()) == ("pushing", 1, 0)  # "home" was said of the first push


def test_a_refused_push_is_chosen_anew_until_attempts_run_out():
    loop = Loop()
    loop.begin_push()
    for attempt in range(MOST_ATTEMPTS):
        active = loop.read("active_push")
        assert active.push_id == attempt
        status = loop.step(execution=ExecutionStatus("refused", attempt, f"joint 4 at its limit, {attempt}"))
        if attempt + 1 < MOST_ATTEMPTS:
            assert mode(status) == ("choosing", 0, attempt + 1)
            assert loop.read("active_push") is None
            assert loop.step(plan=ExplorationPlan(attempt + 1, CHOICE)).mode == "pushing"
    assert status.mode == "failed"
    assert status.reason == f"joint 4 at its limit, {MOST_ATTEMPTS - 1}"
    assert loop.step(execution=AT_HOME).mode == "failed"


def test_attempts_are_counted_for_each_push_anew():
    loop = Loop(fit=2)
    loop.begin_push()
    assert mode(loop.step(execution=ExecutionStatus("refused", 0, "too far"))) == ("choosing", 0, 1)
    loop.step(plan=ExplorationPlan(1, CHOICE))
    assert mode(loop.step(execution=ExecutionStatus("home", 1))) == ("recording", 0, 1)
    loop.step(trials=(object(),))
    assert mode(loop.step(learned=1)) == ("looking", 1, 0)


def test_no_push_that_can_be_made_ends_the_loop_with_its_reason():
    loop = Loop()
    loop.step(object_pose=seen_at(0, 0, 0), cell_grid=GRID)
    status = loop.step(plan=ExplorationPlan(0, None, "the robot can make none of these"))
    assert (status.mode, status.reason) == ("failed", "the robot can make none of these")


def lost(loop: Loop, patience: float = PATIENCE) -> LoopStatus:
    """The status just before patience (s) is over is not a failure; returns that just after."""
    before = loop.read("status")
    loop.advance(patience - 2 * PERIOD)
    assert loop.read("status") == before
    loop.advance(3 * PERIOD)
    assert loop.read("status").mode == "failed"
    return loop.read("status")


@pytest.mark.parametrize("pose", [None, UNSEEN, ObservedPose.unseen("left the table")])
def test_an_object_that_is_never_seen_ends_the_loop(pose):
    loop = Loop()
    loop.set(object_pose=pose)
    status = lost(loop)
    assert status.push == 0
    assert ("no picture" if pose is None else pose.reason) in status.reason


def test_patience_may_be_longer():
    loop = Loop(patience=2 * PATIENCE)
    loop.advance(1.5 * PATIENCE)
    assert "occluded" in lost(loop, 0.5 * PATIENCE).reason


def test_patience_begins_anew_with_each_mode():
    """The push before took longer than the patience with what comes after it."""
    loop = Loop(fit=2)
    loop.begin_push()
    loop.step(execution=ExecutionStatus("approaching", 0))
    loop.advance(2 * PATIENCE)
    assert loop.step(execution=ExecutionStatus("home", 0)).mode == "recording"
    assert "not seen at rest after the push" in lost(loop).reason


def test_the_reason_is_told_in_its_details():
    loop = Loop()
    loop.set(object_pose=ObservedPose.unseen("no object", detail="nothing is higher than 4 mm"))
    assert lost(loop).reason == "the camera does not see the object: nothing is higher than 4 mm"
    loop = Loop()
    loop.begin_push()
    loop.step(execution=ExecutionStatus("home", 0), object_pose=ObservedPose.unseen("left the table"))
    assert lost(loop).reason.startswith("the object was not seen after the push; the camera does")


def test_for_a_push_that_touched_nothing_another_is_chosen_until_it_is_hopeless():
    loop = Loop()
    loop.begin_push()
    refused = 4  # by the arm; that is no miss
    for attempt in range(refused):
        loop.step(execution=ExecutionStatus("refused", attempt, "too far"))
        loop.step(plan=ExplorationPlan(attempt + 1, CHOICE))
    missed = ()
    for attempt in range(refused, refused + MOST_MISSED):
        assert mode(loop.step(execution=ExecutionStatus("home", attempt))) == ("recording", 0, attempt)
        missed = (*missed, attempt)
        status = loop.step(missed=missed)
        if len(missed) < MOST_MISSED:
            assert mode(status) == ("choosing", 0, attempt + 1)
            assert mode(loop.step(plan=ExplorationPlan(attempt + 1, CHOICE))) == ("pushing", 0, attempt + 1)
    assert status.mode == "failed" and "touched nothing" in status.reason and "tip_height" in status.reason


def test_an_object_that_is_lost_between_pushes_ends_the_loop():
    loop = Loop(fit=2)
    loop.begin_push()
    loop.step(execution=ExecutionStatus("home", 0))
    loop.step(trials=(object(),))
    assert loop.step(learned=1, object_pose=ObservedPose.unseen("left the table")).mode == "looking"
    status = lost(loop)
    assert status.push == 1 and "left the table" in status.reason


def test_an_object_that_is_lost_while_a_push_is_chosen_ends_the_loop():
    loop = Loop()
    assert loop.step(object_pose=seen_at(0, 0, 0), cell_grid=GRID).mode == "choosing"
    loop.set(object_pose=ObservedPose.unseen("left the table"))
    assert "left the table" in lost(loop).reason


def test_choosing_may_take_its_time():
    loop = Loop()
    assert loop.step(object_pose=seen_at(0, 0, 0), cell_grid=GRID).mode == "choosing"
    loop.advance(2 * PATIENCE)
    assert loop.step(object_pose=ObservedPose.unseen("no object")).mode == "choosing"  # one bad picture
    assert "no object" in lost(loop).reason


def test_learning_may_take_its_time():
    """The arm may be slow and learning late; neither is a lost object."""
    loop = Loop()
    loop.begin_push()
    loop.step(execution=ExecutionStatus("home", 0), object_pose=UNSEEN)
    loop.step(trials=(object(),))
    loop.advance(2 * PATIENCE)
    assert loop.read("status").mode == "learning"


@pytest.mark.parametrize("when", ["looking", "choosing", "pushing", "recording", "learning"])
def test_an_arm_that_was_stopped_ends_the_loop_with_its_reason(when):
    loop = Loop()
    if when != "looking":
        loop.step(object_pose=seen_at(0, 0, 0), cell_grid=GRID)
    if when in ("pushing", "recording", "learning"):
        loop.step(plan=ExplorationPlan(0, CHOICE))
    if when in ("recording", "learning"):
        loop.step(execution=ExecutionStatus("home", 0))
    if when == "learning":
        loop.step(trials=(object(),))
    assert loop.read("status").mode == when
    status = loop.step(execution=ExecutionStatus("stopped", None, "joint 4 is pushed; look why"))
    assert (status.mode, status.reason) == ("failed", "joint 4 is pushed; look why")
    assert loop.read("active_push") is None
    assert loop.step(execution=AT_HOME).mode == "failed"


def test_a_push_is_looked_into_and_may_ask_for_more():
    loop = Loop(fit=1)
    loop.set(repair=Repair())
    loop.begin_push()
    loop.step(execution=ExecutionStatus("home", 0))
    assert loop.step(trials=(object(),)).mode == "learning"
    assert loop.step(learned=1).mode == "diagnosing"
    assert loop.step().mode == "diagnosing"
    # The answer adds an effect, with which all is learned anew, and asks for a push to try it.
    assert loop.step(repair=Repair(1, ("table_tilt",), wanted=2), learned=0).mode == "diagnosing"
    assert mode(loop.step(learned=1)) == ("looking", 1, 0)
    loop.begin_push()
    loop.step(execution=ExecutionStatus("home", loop.read("active_push").push_id))
    loop.step(trials=2 * (object(),))
    assert loop.step(learned=2).mode == "diagnosing"
    assert mode(loop.step(repair=Repair(2, ("table_tilt",), wanted=2))) == ("finished", 2, 0)


def test_where_a_diagnosis_left_a_question_the_next_push_is_to_answer_it():
    loop = Loop(fit=2)
    loop.begin_push()
    loop.step(execution=ExecutionStatus("home", 0))
    loop.step(trials=(object(),), repair=Repair(0))
    asking = Repair(1, question=object())
    assert mode(loop.step(learned=1)) == ("diagnosing", 0, 0)
    assert mode(loop.step(repair=asking)) == ("looking", 1, 0)
    assert mode(loop.step(object_pose=seen_at(0, 0, 0))) == ("telling apart", 1, 0)
    number = loop.read("status").number
    assert mode(loop.step(plan=ExplorationPlan(number, CHOICE))) == ("pushing", 1, 0)
    refused = ExecutionStatus("refused", number, "too far")
    assert mode(loop.step(execution=refused)) == ("telling apart", 1, 1)
