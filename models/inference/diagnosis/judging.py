"""The last word of the locked pushes: models learned with and without an answer, and what is left of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from slipmap.models.inference.diagnosis import outcomes
from slipmap.models.inference.diagnosis.fitting import Fitted
from slipmap.models.inference.diagnosis.locked import locked_errors
from slipmap.models.inference.diagnosis.outcomes import Outcome
from slipmap.models.inference.diagnosis.verdict_rules import objections, typical_misfit
from slipmap.models.inference.friction_laws import TOGETHER, laws_without
from slipmap.models.inference.results import Identification
from slipmap.models.progress import Progress, about, side_by_side, silent

if TYPE_CHECKING:
    from slipmap.models.inference.diagnosis.procedure import Inquiry


class Learning:
    """What is learned from the open pushes with each model, and with each choice of laws of friction."""

    def __init__(self, learn: Callable[..., Identification], progress: Progress) -> None:
        """`learn` learns a model with effects, or with None without, and takes `laws` and `report`."""
        self._learn, self._progress = learn, progress
        self._known: list[tuple[Fitted | None, tuple[str, ...], Identification]] = []

    def of(self, models: Sequence[Fitted | None], laws: tuple[str, ...]) -> list[Identification]:
        """What is learned with each model where laws consist of these at most; nothing is learned twice."""
        missing = [one for one in dict.fromkeys(models) if self._find(one, laws) is None]
        told = about("with effects", self._progress)
        watched = next((one for one in missing if one is not None), None)  # the one whose progress is shown
        tasks = [
            partial(self._learn, one, laws=laws, report=silent if one is None or one is not watched else told)
            for one in missing
        ]
        self._known += [(one, laws, own) for one, own in zip(missing, side_by_side(tasks), strict=True)]
        return [own for one in models if (own := self._find(one, laws)) is not None]

    def _find(self, model: Fitted | None, laws: tuple[str, ...]) -> Identification | None:
        for one, allowed, learned in self._known:
            # Laws that were allowed, but have no share, changed nothing.
            barred = set(allowed).difference(laws)
            unused = all(barred.isdisjoint(law.split(TOGETHER)) for law in learned.friction_laws)
            if one is model and unused and set(laws) <= set(allowed):
                return learned
        return None


def laws_beside(rivals: Sequence[Fitted]) -> tuple[str, ...]:
    """What laws of friction may consist of where these models are judged: not of what is judged."""
    return laws_without([effect for rival in rivals for effect in rival.effects])


def judged(
    inquiry: Inquiry, learning: Learning, answer: Outcome, firsts: Sequence[Fitted], rough: bool
) -> tuple[Outcome, list[Identification], Sequence[Fitted]]:
    """An answer without rivals that the locked pushes contradict, what is learned with the rest, and the
    rivals that were judged.

    It must predict them better than without effects and with any of the first ones; if `rough`, by more than
    the scatter from push to push. All of these lack the answer's effects among their laws of friction. If
    only pairs are contradicted, some by an effect that may be zero, the other ones are judged alone.

    Args:
        firsts: effects that were judged before, each alone.
    """
    laws = laws_beside(answer.rivals)
    earlier: list[Fitted | None] = [None, *firsts]
    learned = learning.of([*earlier, *answer.rivals], laws)
    known = [errors for own in learned[: len(earlier)] if (errors := locked_errors(own)) is not None]
    baseline = min(known, key=lambda one: typical_misfit(one.misfit), default=None)
    with_each = {
        outcomes.name_of(rival): (rival.effects, own, locked_errors(own))
        for rival, own in zip(answer.rivals, learned[len(earlier) :], strict=True)
    }
    against = objections(with_each, rough, baseline)
    kept = outcomes.without_those_objected_to(answer, against, inquiry.base, inquiry.first)
    needed = [] if kept.rivals else inquiry.without_needless(answer.rivals, against)
    if needed:
        found, with_needed, tried = judged(inquiry, learning, outcomes.one_of(needed), firsts, rough)
        if found.rivals:
            return replace(found, objections={**kept.objections, **found.objections}), with_needed, tried
    if kept.rivals and laws_beside(kept.rivals) != laws:  # a law may return with those that are left
        found, with_kept, _ = judged(inquiry, learning, kept, firsts, rough)
        told = {**kept.objections, **found.objections}
        return replace(found, objections=told), with_kept, answer.rivals
    return kept, [with_each[outcomes.name_of(rival)][1] for rival in kept.rivals], answer.rivals
