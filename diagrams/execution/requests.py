"""What the arm is asked to do, and what it says of it. None of these values ever changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slipmap.models.physics.cell_grid import CellGrid, FloatArray
    from slipmap.planners.grasps import Grasp
    from slipmap.planners.table_push import TablePush

MODES = (
    "home", "approaching", "lowering", "pushing", "retreating", "refused",
    "reaching", "closing", "lifting", "holding", "stopped",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class ActivePush:
    """A push that the arm is to make.

    Attributes:
        push_id: number of the push; a push is made once for each new number.
    """

    push_id: int
    push: TablePush


@dataclass(frozen=True, eq=False)
class ActiveGrasp:
    """A grasp that the arm is to make at the table's edge.

    Attributes:
        push_id: its number; pushes and grasps are counted together.
        pose: (3,) of the object, world, m and rad.
        heights: (n,) of the object's top over each cell, m.
    """

    push_id: int
    grasp: Grasp
    pose: FloatArray
    grid: CellGrid
    heights: FloatArray


@dataclass(frozen=True)
class ExecutionStatus:
    """What the arm is doing.

    Attributes:
        mode: one of `MODES`. In `pushing` the finger moves along the line of the push, or rests at its end.
            In `home` and `refused` the arm is at its home posture or, at the very start, on the way there.
            A grasp ends in `holding`, the object lifted, and the arm stays so. In `stopped` a fault ended
            everything: the arm holds where it is until all is started anew.
        push_id: of the last push or grasp taken up, under way, done or refused; None before the first.
        reason: why it was refused, given up or stopped, else empty.
    """

    mode: str
    push_id: int | None = None
    reason: str = ""


@dataclass(frozen=True)
class Health:
    """Whether the arm may move.

    Attributes:
        mode: `waiting` for the arm's first status, `ok`, or `stopped` by a fault, for good.
        cause: of the stop, with numbers; else empty.
        remedy: what to do about it; else empty.
        time: of the fault, s.
        back: whether the arm goes back from something that presses against it; else it brakes on its path.
    """

    mode: str
    cause: str = ""
    remedy: str = ""
    time: float = 0.0
    back: bool = False

    @property
    def ok(self) -> bool:
        """Whether the arm may move."""
        return self.mode == "ok"

    @property
    def text(self) -> str:
        """Cause and remedy; empty unless stopped."""
        return f"{self.cause}; {self.remedy}" if self.cause else ""
