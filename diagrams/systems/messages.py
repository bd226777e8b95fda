"""What the blocks of the exploration loop tell one another. None of these values ever changes."""

from __future__ import annotations

from dataclasses import dataclass

from planners.action_selection import Poke


@dataclass(frozen=True)
class LoopStatus:
    """Where the loop is.

    Attributes:
        mode: one of `MODES`.
        push: number of the push that is made or comes next, from 0.
        attempt: number of the candidate for it, from 0; the arm refused those before.
        reason: why the loop failed, else empty.
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

MODES = ("looking", "choosing", "pushing", "recording", "learning", "finished", "failed")


@dataclass(frozen=True, eq=False)
class PokeRequest:
    """A push that is asked for.

    Attributes:
        number: the candidate's, see `LoopStatus.number`.
        poke: what to do; None where nothing can be done.
        reason: why there is none, else empty.
    """

    number: int
    poke: Poke | None
    reason: str = ""
