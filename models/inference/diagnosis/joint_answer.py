"""The verdict on several datasets, in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from slipmap.models.inference.diagnosis.locked import JudgedFit, LockedErrors

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


def joint_answer(
    kept: Sequence[JudgedFit],
    judged: Sequence[JudgedFit],
    objection: Callable[[JudgedFit], str],
    before: Sequence[LockedErrors | None],
) -> JointAnswer:
    """The verdict.

    Args:
        kept: models with effects that nothing speaks against, best first; two effects at once in the only one
            where both are needed.
        judged: all models that the locked pushes judged, those of most evidence first.
        objection: what speaks against a model, as a clause.
        before: errors of each dataset's locked pushes without effects; None where there are none.
    """
    names = tuple(effect.name for one in kept for effect in one.fit.effects)
    if len(kept) == 1:
        lacks = "one effect" if len(names) == 1 else "two effects at once"
        sentence = f"The model lacks {lacks} in these datasets: {' and '.join(names)}."
        return JointAnswer("effect", sentence, names, len(names) == 2)
    if names:
        which = "the datasets cannot tell which of these it is"
        return JointAnswer("ambiguous", f"The model lacks an effect; {which}: {', '.join(names)}.", names)
    if judged:
        # The table has the effect of most evidence first, too.
        against = objection(judged[0])
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
