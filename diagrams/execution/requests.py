"""Requests to the arm, its settings, and its status."""

from dataclasses import dataclass

from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.robots import FINGER_RADIUS
from slipmap.models.settings import CheckedSettings, within
from slipmap.planners.grasps import Grasp
from slipmap.planners.table_push import TablePush

# Annotations stay objects, because Drake's YAML reader inspects them.


@dataclass
class ExecutionConfig(CheckedSettings):
    """How the arm moves."""

    _section = "execution."

    tip_height: float = within(0.004, 0.001, 0.05)  # of the finger's end above the table while it pushes, m
    finger_radius: float = within(FINGER_RADIUS, 0.002, 0.02)  # of the round finger that pushes, m
    # of the finger's end above the table while it passes over things, m; the higher it is, the less of the
    # table is in reach
    safe_height: float = within(0.10, 0.02, 0.3)
    push_speed_limit: float = within(0.3, 0.001, 1.0)  # of the finger while it pushes, m/s
    # of the finger on its way to a push and back, m/s; with a real arm at most `guard.transit_speed`
    transit_speed: float = within(1.5, 0.01, 2.0)
    lowering_speed: float = within(0.25, 0.01, 1.0)  # of the finger on its way down and up, m/s
    speeding_up: float = within(0.5, 0.01, 5.0)  # the finger's acceleration at the start of a push, m/s²
    slowing_down: float = within(1.0, 0.01, 5.0)  # its deceleration at the end, m/s²
    settle: float = within(0.3, 0.0, 60.0)  # time for which the finger rests at the end of a push, s
    # of the open gripper on its way in to the object, and of the lifted object, m/s
    grasping_speed: float = within(0.1, 0.01, 0.5)
    closing: float = within(1.5, 0.5, 10.0)  # time that the gripper has to close, s

    def check(self) -> None:
        """Raise ValueError for an invalid field."""
        super().check()
        if self.safe_height <= self.tip_height:
            raise ValueError(
                f"execution.safe_height {self.safe_height} must exceed tip_height {self.tip_height}"
            )


MODES = (
    "home", "approaching", "lowering", "pushing", "retreating", "refused",
    "reaching", "closing", "lifting", "holding", "stopped",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class ActivePush:
    """A push for the arm to make."""

    push_id: int  # number of the push; each new number is executed once
    push: TablePush


@dataclass(frozen=True, eq=False)
class ActiveGrasp:
    """A grasp for the arm to make at the table's edge."""

    push_id: int  # its number; pushes and grasps are numbered together
    grasp: Grasp
    pose: FloatArray  # (3,) of the object, world, m and rad
    grid: CellGrid
    heights: FloatArray  # (n,) of the object's top over each cell, m


@dataclass(frozen=True)
class ExecutionStatus:
    """What the arm is doing."""

    # one of `MODES`. In `pushing` the finger moves along the line of the push or rests at its end. In `home`
    # and `refused` the arm is at its home posture or, at the very start, on the way there. A grasp ends in
    # `holding`, with the object lifted, and the arm stays there. `stopped` means that a fault ended
    # everything: the arm holds its position until the program is restarted.
    mode: str
    # of the last push or grasp, whether under way, done or refused; None before the first
    push_id: int | None = None
    reason: str = ""  # why it was refused, given up or stopped, else empty


@dataclass(frozen=True)
class Health:
    """Whether the arm may move."""

    mode: str  # `waiting` for the arm's first status, `ok`, or `stopped` by a fault, for good
    cause: str = ""  # of the stop, with numbers; else empty
    remedy: str = ""  # what to do about it; else empty
    time: float = 0.0  # of the fault, s
    # whether the arm backs off from something that presses against it; else it brakes on its path
    back: bool = False
    rest: float = 0.0  # when the last command of the motion to rest is made, s

    @property
    def ok(self) -> bool:
        """Whether the arm may move."""
        return self.mode == "ok"

    @property
    def text(self) -> str:
        """Cause and remedy; empty unless stopped."""
        return f"{self.cause}; {self.remedy}" if self.cause else ""
