"""What the blocks of the robot's loops tell one another. None of these values ever changes."""

from dataclasses import dataclass

from slipmap.diagrams.execution.requests import ActiveGrasp
from slipmap.planners.action_selection import Choice
from slipmap.planners.goals import Goal
from slipmap.planners.robust_push import PlannedPush


@dataclass(frozen=True)
class LoopStatus:
    """Where the loop is."""

    mode: str  # one of `MODES`
    push: int  # number of the push that is made or comes next, from 0
    attempt: int = 0  # number of the candidate for it, from 0; the arm refused those before
    reason: str = ""  # why the loop failed, or why the arm refused the candidate before; else empty

    @property
    def number(self) -> int:
        """Number of the candidate over all pushes, which the executor knows it by."""
        return MOST_ATTEMPTS * self.push + self.attempt


MOST_ATTEMPTS = 20
"""Candidates that the arm may refuse for one push before the loop gives up."""

EXPLORING = (
    "looking",
    "choosing",
    "telling apart",
    "pushing",
    "recording",
    "learning",
    "diagnosing",
    "finished",
    "failed",
)
"""Modes of exploring. Where the model is repaired on the way, there is `diagnosing`, and `telling apart`
instead of `choosing` where the next push is to tell the models apart that a diagnosis left."""

CHOOSING = ("choosing", "telling apart")
"""Modes in which a push is chosen."""

BRINGING = (
    "planning",
    "pushing",
    "recording",
    "diagnosing",
    "grasping",
    "lifting",
    "holding",
    "held",
    "failed",
)
"""Modes of bringing the object to the table's edge and taking it, after those of exploring."""

MODES = tuple(dict.fromkeys((*EXPLORING, *BRINGING)))


@dataclass(frozen=True, eq=False)
class ExplorationPlan:
    """A push that is asked for."""

    number: int  # the candidate's, see `LoopStatus.number`
    choice: Choice | None  # what to do; None where nothing can be done
    reason: str = ""  # why there is none, else empty


@dataclass(frozen=True, eq=False)
class PregraspPlan:
    """What is to be done next to take the object: a push towards the edge, or the grasp."""

    number: int  # the candidate's, see `LoopStatus.number`
    goal: Goal | None = None  # pose at the edge that it serves; None where there is none
    # the push and what is expected of it; None where the object can be grasped, or nothing be done
    push: PlannedPush | None = None
    # the grasp; None where the object is to be pushed, or nothing can be done
    grasp: ActiveGrasp | None = None
    # that the object lies at the goal after the push, or stays where it is until the grasp
    success_probability: float = 0.0
    # distance of the centre of mass from the edge of its support after the push, or now, that the object has
    # with the probability 1 - epsilon of the settings, m; negative where it may fall
    margin: float = 0.0
    reason: str = ""  # why there is neither push nor grasp, else empty
