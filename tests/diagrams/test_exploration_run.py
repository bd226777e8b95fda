"""How a loop ends: once the arm is at rest, or at once if somebody insists."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable

import pytest
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from slipmap.diagrams.execution.requests import Health
from slipmap.diagrams.hardware.network import ARM_PERIOD
from slipmap.diagrams.loops.exploration_run import run_loop
from slipmap.diagrams.systems.loop_messages import LoopStatus
from slipmap.diagrams.systems.python_system import PythonSystem

FAULT, REST, LONGEST = 0.1, 0.3, 0.5  # s


class Says(PythonSystem):
    """A port whose value depends on the time; it moves on by steps like those of an arm's commands."""

    def __init__(self, port: str, of: Callable[[float], object]) -> None:
        super().__init__()
        self.declare_output(port, lambda context: of(context.get_time()), {self.time_ticket()})
        self.DeclarePeriodicPublishEvent(ARM_PERIOD, 0.0, lambda context: None)


class Cell(Says):
    """Stands for a real cell, from which nothing is heard."""

    realtime_rate = 0.0

    def __init__(self) -> None:
        super().__init__("nothing", lambda time: None)

    def connect(self, root: Context) -> None:
        pass

    def abort(self) -> None:
        pass


def loop_of(health: Health) -> Diagram:
    """A loop that a fault stops, with a guard that says this of the arm from then on."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("station", Cell())
    builder.AddNamedSystem("guard", Says("health", lambda time: health if time > FAULT else Health("ok")))
    builder.AddNamedSystem(
        "supervisor", Says("status", lambda time: LoopStatus("failed" if time > FAULT else "pushing", 0))
    )
    return builder.Build()


def ended(loop: Diagram, watch: Callable[[LoopStatus, Context], None] = lambda status, context: None):
    return run_loop(loop, "supervisor", ("finished", "failed"), LONGEST, watch)


@pytest.mark.parametrize("times", [1, 2])
def test_a_second_ctrl_c_in_a_real_cell_ends_everything_at_once(times):
    left = [signal.SIGINT] * times

    def press(status: LoopStatus, context: Context) -> None:
        while left:
            os.kill(os.getpid(), left.pop())

    loop = loop_of(Health("stopped", "stopped by hand", "start again", FAULT))
    if times == 1:
        assert ended(loop, press).interrupted
    else:
        with pytest.raises(KeyboardInterrupt):
            ended(loop, press)


def test_a_loop_goes_on_until_a_stopped_arm_is_at_rest():
    back = Health("stopped", "something pushes against the arm", "look", FAULT, back=True, rest=REST)
    end = ended(loop_of(back))
    assert end.status.mode == "failed"
    # The last command is sent in the period after the one in which it was made.
    assert REST + ARM_PERIOD <= end.simulated < REST + 3 * ARM_PERIOD
    for fine in (Health("ok"), Health("stopped", "no status of the arm", "look", FAULT)):
        assert ended(loop_of(fine)).simulated < FAULT + 2 * ARM_PERIOD
