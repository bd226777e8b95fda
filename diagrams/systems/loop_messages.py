"""Messages between the blocks of the robot's loops, all of them immutable."""

from dataclasses import dataclass

from slipmap.diagrams.execution.requests import ActiveGrasp
from slipmap.planners.action_selection import Choice
from slipmap.planners.goals import Goal
from slipmap.planners.robust_push import PlannedPush


@dataclass(frozen=True)
class LoopStatus:
    """The loop's present step."""

    mode: str  # one of `EXPLORING` or `BRINGING`
    push: int  # number of the current or next push, from 0
    attempt: int = 0  # number of the candidate for it, from 0; earlier ones were refused or touched nothing
    # why the loop failed, or, while planning, why the previous candidate was refused or missed; else empty
    reason: str = ""
    of: int = 0  # pushes of the exploration, as planned so far; 0 once it is over

    @property
    def number(self) -> int:
        """Number of the candidate over all pushes, by which the executor identifies it."""
        return MOST_ATTEMPTS * self.push + self.attempt


MOST_ATTEMPTS = 20  # candidates for one push before the loop gives up

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
"""Modes of exploration. If the model is repaired during the run, `diagnosing` is one of them, and `telling
apart` replaces `choosing` when the next push should discriminate between the models that a diagnosis left."""

CHOOSING = ("choosing", "telling apart")  # modes in which a push is chosen

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
"""Modes of pushing the object to the table's edge and grasping it, after those of exploration."""


@dataclass(frozen=True, eq=False)
class ExplorationPlan:
    """The push to make next."""

    number: int  # the candidate's, see `LoopStatus.number`
    choice: Choice | None  # None if no push is possible
    reason: str = ""  # why there is none, else empty


@dataclass(frozen=True, eq=False)
class PregraspPlan:
    """The next action towards taking the object: a push towards the edge, or the grasp."""

    number: int  # the candidate's, see `LoopStatus.number`
    goal: Goal | None = None  # pose at the edge that it serves, if any
    # the push with its expected result; None if the object can be grasped or nothing can be done
    push: PlannedPush | None = None
    # the grasp; None if the object must be pushed or nothing can be done
    grasp: ActiveGrasp | None = None
    # probability that the object lies at the goal after the push, or stays in place until the grasp
    success_probability: float = 0.0
    # distance of the centre of mass from the edge of its support, after the push or now, that the object
    # keeps with the probability 1 - epsilon of the settings, m; negative if it may fall
    margin: float = 0.0
    reason: str = ""  # why there is neither push nor grasp, else empty
