"""What the arm is asked to do, how fast, and what it says of it."""

from dataclasses import dataclass

from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.robots import FINGER_RADIUS
from slipmap.models.settings import CheckedSettings, within
from slipmap.planners.grasps import Grasp
from slipmap.planners.table_push import TablePush

# Annotations stay objects: Drake's YAML reader looks at them.


@dataclass
class ExecutionConfig(CheckedSettings):
    """How the arm moves."""

    _section = "execution."

    tip_height: float = within(0.004, 0.001, 0.05)  # of the finger's end over the table while it pushes, m
    finger_radius: float = within(FINGER_RADIUS, 0.002, 0.02)  # of the round finger that pushes, m
    # of the finger's end over the table while it passes over things, m; the higher, the less of the table can
    # be reached
    safe_height: float = within(0.10, 0.02, 0.3)
    push_speed_limit: float = within(0.3, 0.001, 1.0)  # of the finger while it pushes, m/s
    # of the finger on its way to a push and back, m/s; before a real arm no more than `guard.transit_speed`
    transit_speed: float = within(1.5, 0.01, 2.0)
    lowering_speed: float = within(0.25, 0.01, 1.0)  # of the finger on its way down and up, m/s
    speeding_up: float = within(0.5, 0.01, 5.0)  # the finger's acceleration at the begin of a push, m/s²
    slowing_down: float = within(1.0, 0.01, 5.0)  # at its end, m/s²
    settle: float = within(0.3, 0.0, 60.0)  # time the finger rests at the end of a push, s
    # of the open gripper on its way in to the object, and of the lifted object, m/s
    grasping_speed: float = within(0.1, 0.01, 0.5)
    closing: float = within(1.5, 0.5, 10.0)  # time that the gripper has to close, s

    def check(self) -> None:
        """Raise ValueError where a field makes no sense."""
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
    """A push that the arm is to make."""

    push_id: int  # number of the push; a push is made once for each new number
    push: TablePush


@dataclass(frozen=True, eq=False)
class ActiveGrasp:
    """A grasp that the arm is to make at the table's edge."""

    push_id: int  # its number; pushes and grasps are counted together
    grasp: Grasp
    pose: FloatArray  # (3,) of the object, world, m and rad
    grid: CellGrid
    heights: FloatArray  # (n,) of the object's top over each cell, m


@dataclass(frozen=True)
class ExecutionStatus:
    """What the arm is doing."""

    # one of `MODES`. In `pushing` the finger moves along the line of the push, or rests at its end. In `home`
    # and `refused` the arm is at its home posture or, at the very start, on the way there. A grasp ends in
    # `holding`, the object lifted, and the arm stays so. In `stopped` a fault ended everything: the arm holds
    # where it is until all is started anew.
    mode: str
    # of the last push or grasp taken up, under way, done or refused; None before the first
    push_id: int | None = None
    reason: str = ""  # why it was refused, given up or stopped, else empty


@dataclass(frozen=True)
class Health:
    """Whether the arm may move."""

    mode: str  # `waiting` for the arm's first status, `ok`, or `stopped` by a fault, for good
    cause: str = ""  # of the stop, with numbers; else empty
    remedy: str = ""  # what to do about it; else empty
    time: float = 0.0  # of the fault, s
    # whether the arm goes back from something that presses against it; else it brakes on its path
    back: bool = False

    @property
    def ok(self) -> bool:
        """Whether the arm may move."""
        return self.mode == "ok"

    @property
    def text(self) -> str:
        """Cause and remedy; empty unless stopped."""
        return f"{self.cause}; {self.remedy}" if self.cause else ""
