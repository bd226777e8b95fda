"""What the arm is asked to do, and what it says of it. None of these values ever changes."""

from dataclasses import dataclass

from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.planners.grasps import Grasp
from slipmap.planners.table_push import TablePush

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
