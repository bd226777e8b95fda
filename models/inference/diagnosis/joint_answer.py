"""The verdict on several datasets, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from slipmap.models.inference.diagnosis.locked import CLEARLY, JudgedFit, LockedErrors
from slipmap.models.inference.diagnosis.verdict_rules import far_above_noise

_NEAR_NOISE = 2.0
"""Root-mean-square misfit of locked pushes, in units of sensor noise, that needs no explanation."""

MORE_PUSHES = "give each dataset three pushes or more"
"""What to do where no pushes could be locked away."""


@dataclass(frozen=True)
class JointAnswer:
    """What several datasets lack."""

    verdict: str  # adequate, effect, ambiguous or undecided
    sentence: str  # the verdict in words
    effects: tuple[str, ...] = ()  # what the data cannot rule out, best first
    together: bool = False  # whether two effects are needed at once


def objection_to(one: JudgedFit) -> str:
    """Why the locked pushes or its interval speak against a model with effects."""
    if not one.judging:
        return f"no pushes were locked away that could judge {one.pronoun}; {MORE_PUSHES}"
    if one.fall <= CLEARLY:
        return f"the locked pushes are not clearly predicted better with {one.pronoun}"
    if not one.agrees:
        if one.worse:
            return f"the locked pushes of {', '.join(one.worse)} are predicted worse with {one.pronoun}"
        return f"the locked pushes of no single dataset are clearly predicted better with {one.pronoun}"
    own = "its 90 % interval" if len(one.fit.effects) == 1 else "the 90 % interval of one of them"
    return f"{own} includes the value without the effect"


def contradiction(faults: Mapping[str, str]) -> str:
    """What is wrong in the records, in sentences; `faults` as for `joint_answer`."""
    told = " ".join(f"{name}: {fault}" for name, fault in faults.items())
    return f"The records of {', '.join(faults)} contradict themselves, so no effect can be identified. {told}"


def where_it_shows(one: JudgedFit) -> str:
    """Which datasets do not have what is named for several of them, in a sentence that begins with a space;
    empty if all may have it."""
    if not one.shared:
        clear = [name for name, fall in one.judging.items() if fall > CLEARLY]
        others = [name for name in one.judging if name not in clear]
        shows = (
            f"{'It shows' if one.pronoun == 'it' else 'They show'} in the locked pushes of {', '.join(clear)}"
        )
        return f" {shows}, not in those of {', '.join(others)}." if others else ""
    if not one.worse:
        return ""
    names = ", ".join(one.worse)
    do = f"{names} does" if len(one.worse) == 1 else "they do"
    return (
        f" But the locked pushes of {names} are predicted worse with {one.pronoun}, so {do} not seem to have"
        f" {one.pronoun}."
    )


def what_is_left(one: JudgedFit, beside: Sequence[str]) -> str:
    """What may be missing besides, in a sentence that begins with a space, where the locked pushes stay far
    off with the answer; else empty.

    Args:
        one: the model with the effects of the answer.
        beside: as for `joint_answer`.
    """
    misfit = far_above_noise(one.misfits)
    if misfit is None:
        return ""
    cause = "the outline or the recording is wrong, or pushes scatter"
    if beside:
        cause = f"{' or '.join(beside)}, which gain alike beside {one.pronoun}"
    return (
        f" Even with {one.name}, the typical locked push is {misfit:.0f} times the sensor noise off:"
        f" something else is missing too, {cause}."
    )


def joint_answer(
    kept: Sequence[JudgedFit],
    judged: Sequence[JudgedFit],
    before: Sequence[LockedErrors | None],
    beside: Sequence[str] = (),
    faults: Mapping[str, str] | None = None,
) -> JointAnswer:
    """The verdict.

    Args:
        kept: models with effects that nothing speaks against, best first; two effects at once in the only one
            where both are needed.
        judged: all models that the locked pushes judged, those of most evidence first.
        before: errors of each dataset's locked pushes without effects; None where there are none.
        beside: effects that gain much beside the first, but alike, so that none of them is named.
        faults: in the records, as clauses, by the name of the dataset.
    """
    if faults:
        return JointAnswer("undecided", contradiction(faults))
    names = tuple(effect.name for one in kept for effect in one.fit.effects)
    if len(kept) == 1:
        lacks = "one effect" if len(names) == 1 else "two effects at once"
        sentence = f"The model lacks {lacks} in these datasets: {' and '.join(names)}."
        sentence += f"{where_it_shows(kept[0])}{what_is_left(kept[0], beside)}"
        return JointAnswer("effect", sentence, names, len(names) == 2)
    if names:
        sentence = (
            "The model lacks an effect; the datasets cannot tell which of these it is:"
            f" {', '.join(names)}.{what_is_left(kept[0], ())}"
        )
        return JointAnswer("ambiguous", sentence, names)
    if judged:
        # The table has the effect of most evidence first, too.
        against = objection_to(judged[0])
        return JointAnswer(
            "undecided", f"{judged[0].name} would explain most, but {against}. No effect is named."
        )
    squares = [errors.misfit**2 for errors in before if errors is not None]
    if not squares:
        # Few pushes are explained by maps alone, whatever is missing.
        return JointAnswer(
            "undecided",
            f"No pushes were locked away that could show whether anything is missing; {MORE_PUSHES}.",
        )
    if float(np.concatenate(squares).mean()) > _NEAR_NOISE**2:
        sentence = (
            "The model error is larger than the sensor noise, but no effect that the datasets could share"
            " explains it."
        )
        return JointAnswer("undecided", sentence)
    return JointAnswer("adequate", "The model explains the data; no effect is missing.")


def answer_about(
    judged: JudgedFit, explains: bool, is_there: bool, faults: Mapping[str, str]
) -> tuple[Literal["for", "against", "undecided"], str]:
    """What several datasets say about given effects, and that in words.

    Args:
        judged: the model with the effects.
        explains: whether the open pushes are explained clearly better than by the freedom of the parameters.
        is_there: whether the intervals exclude the values without the effects.
        faults: as for `joint_answer`.
    """
    are, their = ("is", "its") if len(judged.fit.effects) == 1 else ("are", "their")
    unclear = f"The datasets do not show whether {judged.name} {are} present"
    if faults:
        return "undecided", f"{unclear}. {contradiction(faults)}"
    if judged.fall < -CLEARLY:
        worse = f"the locked pushes are predicted worse with {judged.pronoun}"
        return "against", f"THE DATASETS SPEAK AGAINST {judged.name}: {worse}."
    if not explains:
        freely = f"the open pushes are explained hardly better than {their} parameters would explain anyway"
        return "undecided", f"{unclear}: {freely}."
    if judged.is_supported and is_there:
        return "for", f"The datasets support {judged.name}.{where_it_shows(judged)}"
    return "undecided", f"{unclear}: {objection_to(judged)}."
