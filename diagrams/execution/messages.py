"""What the arm is told to do, and what it says of it. None of these values ever changes."""

from __future__ import annotations

from dataclasses import dataclass

from planners.table_push import TablePush

MODES = ("home", "approaching", "lowering", "pushing", "retreating", "refused")


@dataclass(frozen=True, eq=False)
class ActivePush:
    """A push that the arm is to make.

    Attributes:
        push_id: tells this push from the others; a push is made once for each new number.
        push: what to do.
    """

    push_id: int
    push: TablePush


@dataclass(frozen=True)
class ExecutionStatus:
    """What the arm is doing.

    Attributes:
        mode: one of `MODES`. In `pushing` the finger moves along the line of the push, or rests at its end.
            In `home` and `refused` the arm is at its home posture or, at the very start, on the way there.
        push_id: of the last push taken up, whether under way, done or refused; None before the first.
        reason: why that push was refused or given up, else empty.
    """

    mode: str
    push_id: int | None = None
    reason: str = ""
