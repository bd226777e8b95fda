"""Who commands the arm when, and how bringing the object to the edge ends."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from driven_block import DrivenBlock, seen_at

from slipmap.diagrams.execution.requests import ActivePush, ExecutionStatus
from slipmap.diagrams.systems.diagnosis import Repair
from slipmap.diagrams.systems.loop_messages import MOST_ATTEMPTS, LoopStatus, PregraspPlan
from slipmap.diagrams.systems.supervisors import HOLD, MOST_MISSED, PATIENCE, PERIOD, PregraspSupervisor
from slipmap.models.perception.seen_object import ObservedPose
from slipmap.models.robots import PIN_RADIUS
from slipmap.planners.table_push import TablePush

PUSH = TablePush([0.0, 0.0], [0.1, 0.0], 0.05)
PLANNED = SimpleNamespace(push=PUSH)
HEIGHT = 0.03
GRASP = SimpleNamespace(push_id=0, grasp=SimpleNamespace(height=HEIGHT))
EXPLORED = LoopStatus("finished", 2)
FIRST = MOST_ATTEMPTS * 2


class Loop(DrivenBlock):
    """A supervisor whose partners do what the test says."""

    def __init__(self, exploration: LoopStatus = EXPLORED) -> None:
        super().__init__(
            PregraspSupervisor(),
            exploration=exploration, exploring_push=None, object_pose=seen_at(0, 0, 0), plan=None,
            execution=ExecutionStatus("home", 1), trials=(None, None),
            **{"gripper.state_measured": [0.0, 0.0]},
        )  # fmt: skip
        self.advance(0.5 * PERIOD)

    def step(self, **inputs) -> str:
        """The mode after one decision."""
        self.set(**inputs)
        self.advance(PERIOD)
        return self.read("status").mode

    def reach(self, mode: str) -> None:
        """From planning to a mode of grasping."""
        assert self.step(plan=PregraspPlan(FIRST, grasp=GRASP)) == "grasping"
        for doing in ("reaching", "closing", "lifting", "holding"):
            if self.read("status").mode != mode:
                self.step(execution=ExecutionStatus(doing, FIRST))
        assert self.read("status").mode == mode


def test_while_exploring_the_other_supervisor_commands():
    loop = Loop(LoopStatus("pushing", 1, 3))
    loop.set(exploring_push=ActivePush(23, PUSH))
    assert loop.read("status") == LoopStatus("pushing", 1, 3)  # at once, as if there were nothing between
    assert loop.read("active_push").push_id == 23
    assert loop.read("active_grasp") is None
    assert loop.step(exploration=LoopStatus("failed", 1, 3, "lost")) == "failed"
    assert loop.read("status").reason == "lost"


def test_pushes_follow_until_a_grasp_and_the_object_is_held():
    loop = Loop()
    assert loop.step() == "planning"
    assert loop.read("status").number == FIRST
    assert loop.step(plan=PregraspPlan(1, push=PLANNED)) == "planning"  # of another number
    assert loop.step(plan=PregraspPlan(FIRST, push=PLANNED)) == "pushing"
    assert loop.read("active_push").push_id == FIRST
    assert (loop.read("active_push").push.end == PUSH.end).all()
    assert loop.step() == "pushing"  # the arm said "home" of the push before
    assert loop.step(execution=ExecutionStatus("pushing", FIRST)) == "pushing"
    assert loop.step(execution=ExecutionStatus("home", FIRST)) == "recording"
    assert loop.read("active_push") is None
    assert loop.step() == "recording"
    assert loop.step(trials=(None,) * 3) == "planning"
    number = FIRST + MOST_ATTEMPTS
    assert loop.read("status").number == number
    assert loop.step(plan=PregraspPlan(number, grasp=GRASP)) == "grasping"
    assert loop.read("active_grasp").grasp.height == HEIGHT
    assert loop.step(execution=ExecutionStatus("closing", number)) == "grasping"
    assert loop.step(execution=ExecutionStatus("lifting", number)) == "lifting"
    assert loop.step(execution=ExecutionStatus("holding", number)) == "holding"
    loop.set(**{"gripper.state_measured": [2 * PIN_RADIUS + 0.9 * HEIGHT, 0.0]})
    loop.advance(HOLD - 2 * PERIOD)
    assert loop.read("status").mode == "holding"
    loop.advance(3 * PERIOD)
    assert loop.read("status").mode == "held"
    assert loop.read("active_grasp") is not None  # it goes on being held


def test_pins_that_closed_on_nothing_hold_nothing():
    loop = Loop()
    loop.step()
    loop.reach("holding")
    loop.set(**{"gripper.state_measured": [2 * PIN_RADIUS + 0.1 * HEIGHT, 0.0]})
    loop.advance(HOLD + PERIOD)
    assert (loop.read("status").mode, loop.read("status").reason) == ("failed", "the pins closed on nothing")


def test_a_gripper_that_is_stuck_open_holds_nothing():
    loop = Loop()
    loop.step()
    loop.reach("holding")
    loop.set(**{"gripper.state_measured": [0.094, 0.0]})
    loop.advance(HOLD + PERIOD)
    assert loop.read("status").mode == "failed"
    assert "did not close: its pins are 79 mm apart" in loop.read("status").reason


@pytest.mark.parametrize("when", ["planning", "pushing", "grasping", "holding"])
def test_an_arm_that_was_stopped_ends_the_loop_with_its_reason(when):
    loop = Loop()
    loop.step()
    if when == "pushing":
        loop.step(plan=PregraspPlan(FIRST, push=PLANNED))
    elif when != "planning":
        loop.reach(when)
    assert loop.read("status").mode == when
    assert loop.step(execution=ExecutionStatus("stopped", FIRST, "stopped by hand")) == "failed"
    assert loop.read("status").reason == "stopped by hand"
    assert loop.read("active_push") is None


@pytest.mark.parametrize("plan", [{"push": PLANNED}, {"grasp": GRASP}])
def test_what_the_arm_refuses_is_planned_anew_until_it_is_too_often(plan):
    loop = Loop()
    loop.step()
    for attempt in range(MOST_ATTEMPTS):
        number = FIRST + attempt
        assert loop.step(plan=PregraspPlan(number, **plan)) in ("pushing", "grasping")
        mode = loop.step(execution=ExecutionStatus("refused", number, f"too far, {attempt}"))
        assert loop.read("status").reason == f"too far, {attempt}"
        assert mode == ("planning" if attempt + 1 < MOST_ATTEMPTS else "failed")


def test_after_a_push_that_missed_the_planner_is_told_so():
    loop = Loop()
    loop.set(missed=())
    loop.step()
    for attempt in range(MOST_MISSED):
        number = FIRST + attempt
        assert loop.step(plan=PregraspPlan(number, push=PLANNED)) == "pushing"
        assert loop.step(execution=ExecutionStatus("home", number)) == "recording"
        mode = loop.step(missed=tuple(range(FIRST, number + 1)))
        assert loop.read("status").reason.startswith("the finger touched nothing")
        assert mode == ("planning" if attempt + 1 < MOST_MISSED else "failed")


def test_a_plan_of_nothing_ends_the_loop_with_its_reason():
    loop = Loop()
    loop.step()
    assert loop.step(plan=PregraspPlan(FIRST, reason="no goal")) == "failed"
    assert loop.read("status").reason == "no goal"


def test_planning_may_take_its_time_while_the_object_is_seen():
    loop = Loop()
    loop.step()
    loop.advance(2 * PATIENCE)
    assert loop.step(object_pose=ObservedPose.unseen("no object")) == "planning"  # one bad picture
    assert loop.step(object_pose=seen_at(0, 0, 0)) == "planning"
    loop.set(object_pose=ObservedPose.unseen("left the table"))
    loop.advance(PATIENCE - 2 * PERIOD)
    assert loop.read("status").mode == "planning"
    loop.advance(4 * PERIOD)
    assert "left the table" in loop.read("status").reason


def test_an_object_that_is_not_seen_after_a_push_ends_the_loop():
    loop = Loop()
    loop.step()
    loop.step(plan=PregraspPlan(FIRST, push=PLANNED))
    loop.step(execution=ExecutionStatus("home", FIRST), object_pose=ObservedPose.unseen("left the table"))
    loop.advance(PATIENCE - 2 * PERIOD)
    assert loop.read("status").mode == "recording"
    loop.advance(4 * PERIOD)
    assert loop.read("status").mode == "failed"
    assert "left the table" in loop.read("status").reason


def test_a_push_towards_the_edge_is_looked_into_and_learned_from():
    loop = Loop()
    loop.set(repair=Repair(2), learned=2)
    assert loop.step(plan=PregraspPlan(FIRST, push=PLANNED)) == "pushing"
    assert loop.step(execution=ExecutionStatus("home", FIRST)) == "recording"
    assert loop.step(trials=(None,) * 3) == "diagnosing"
    assert loop.step(learned=3) == "diagnosing"
    assert loop.step(repair=Repair(3, ("tether",)), learned=0) == "diagnosing"
    assert loop.step(learned=3) == "planning"
    assert loop.read("status").push == 3
