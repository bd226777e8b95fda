"""What the blocks of the robot's loops tell one another. None of these values ever changes."""

from dataclasses import dataclass

from slipmap.diagrams.execution.requests import ActiveGrasp
from slipmap.planners.action_selection import Choice
from slipmap.planners.goals import Goal
from slipmap.planners.robust_push import PlannedPush


@dataclass(frozen=True)
class LoopStatus:
    """Where the loop is.

    Attributes:
        mode: one of `MODES`.
        push: number of the push that is made or comes next, from 0.
        attempt: number of the candidate for it, from 0; the arm refused those before.
        reason: why the loop failed, or why the arm refused the candidate before; else empty.
    """

    mode: str
    push: int
    attempt: int = 0
    reason: str = ""

    @property
    def number(self) -> int:
        """Number of the candidate over all pushes, which the executor knows it by."""
        return MOST_ATTEMPTS * self.push + self.attempt


MOST_ATTEMPTS = 20
"""Candidates that the arm may refuse for one push before the loop gives up."""

EXPLORING = ("looking", "choosing", "pushing", "recording", "learning", "finished", "failed")
"""Modes of exploring."""

BRINGING = ("planning", "pushing", "recording", "grasping", "lifting", "holding", "held", "failed")
"""Modes of bringing the object to the table's edge and taking it, after those of exploring."""

MODES = tuple(dict.fromkeys((*EXPLORING, *BRINGING)))


@dataclass(frozen=True, eq=False)
class ExplorationPlan:
    """A push that is asked for.

    Attributes:
        number: the candidate's, see `LoopStatus.number`.
        choice: what to do; None where nothing can be done.
        reason: why there is none, else empty.
    """

    number: int
    choice: Choice | None
    reason: str = ""


@dataclass(frozen=True, eq=False)
class PregraspPlan:
    """What is to be done next to take the object: a push towards the edge, or the grasp.

    Attributes:
        number: the candidate's, see `LoopStatus.number`.
        goal: pose at the edge that it serves; None where there is none.
        push: the push and what is expected of it; None where the object can be grasped, or nothing be done.
        grasp: the grasp; None where the object is to be pushed, or nothing can be done.
        success_probability: that the object lies at the goal after the push, or stays where it is until the
            grasp.
        margin: distance of the centre of mass from the edge of its support after the push, or now, that the
            object has with the probability 1 - epsilon of the settings, m; negative where it may fall.
        reason: why there is neither push nor grasp, else empty.
    """

    number: int
    goal: Goal | None = None
    push: PlannedPush | None = None
    grasp: ActiveGrasp | None = None
    success_probability: float = 0.0
    margin: float = 0.0
    reason: str = ""
