"""What a diagnosis may come to: each verdict with its sentence and the models that belong to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from slipmap.models.effects.probes import PROBES
from slipmap.models.inference.diagnosis.fitting import Fitted
from slipmap.models.inference.diagnosis.screening import Screening


@dataclass(frozen=True, eq=False)
class Outcome:
    """A verdict."""

    verdict: str  # one of `results.VERDICTS`
    sentence: str  # the verdict for a person
    best: Fitted  # fitted model with the best effects, or without
    effects: tuple[str, ...] = ()  # what the data cannot rule out, best first; together if `together`
    together: bool = False  # whether the effects are needed at the same time
    depends_on: str | None = None  # sentence of the probe that finds structure that no effect explains
    rivals: tuple[Fitted, ...] = ()  # fitted models of the effects


def nothing_missing(base: Fitted) -> Outcome:
    """The model explains the data."""
    return Outcome("adequate", "The model explains the data; no effect is missing.", base)


def nothing_visible(base: Fitted, pushes: str) -> Outcome:
    """Nothing is seen, but it could not have been."""
    sentence = f"Nothing is seen to be missing, but {pushes} could not have shown most effects."
    return Outcome("undecided", sentence, base)


def scatter(base: Fitted) -> Outcome:
    """The model is off by much, and no effect explains it."""
    share = 100 * base.likelihood.error.motion
    sentence = (
        f"The model is off by about {share:.0f} % of the way, which is much, but no effect explains"
        " it: the pushes may scatter by themselves, or something unknown disturbs them."
    )
    return Outcome("undecided", sentence, base)


def disagreement(base: Fitted, pushes: int, p: float) -> Outcome:
    """Pushes do not agree on what gains; p is the share of sign changes that gain as much."""
    sentence = (
        f"Much is left that the model does not explain, but the {pushes} pushes do not agree on what it"
        f" is: turned round at random, they would show as much in {100 * p:.0f} % of cases."
    )
    if pushes == 1:
        sentence = (
            "Much is left that the model does not explain, but a single push cannot show whether others would"
            " agree on what it is."
        )
    return Outcome("undecided", sentence, base)


def too_faint(base: Fitted) -> Outcome:
    """Something gains, but too little."""
    sentence = "Something may be missing, but the pushes show too little of it to say what."
    return Outcome("undecided", sentence, base)


def refuted_by_locked_pushes(answer: Outcome, base: Fitted) -> Outcome:
    """The pushes that were locked away do not become better with the answer, or not beyond chance."""
    sentence = (
        f"On the open pushes {' and '.join(answer.effects)} would explain much, but the misfit of the locked"
        " pushes does not clearly fall with it: the pushes are too few, or scatter too much, to decide."
    )
    return Outcome("undecided", sentence, base)


def no_help_to_locked_pushes(answer: Outcome, base: Fitted, screening: Screening) -> Outcome:
    """The pushes that were locked away stay as far off with the answer as without."""
    found = unknown(base, screening)
    sentence = (
        f"On the open pushes {' and '.join(answer.effects)} would explain something, but the locked pushes"
        f" are as far off with it as without: it is not what is missing. {found.sentence}"
    )
    return Outcome("unknown", sentence, base, depends_on=found.depends_on)


def one_of(rivals: Sequence[Fitted]) -> Outcome:
    """One effect, or a set that the data cannot tell apart, best first."""
    names = tuple(fitted.effects[0].name for fitted in rivals)
    listed = ", ".join(names)
    if len(rivals) == 1:
        return Outcome(
            "effect", f"The data miss one effect: {listed}.", rivals[0], names, rivals=tuple(rivals)
        )
    sentence = f"An effect is missing; the data cannot tell which of these it is: {listed}."
    return Outcome("ambiguous", sentence, rivals[0], names, rivals=tuple(rivals))


def two_at_once(found: Sequence[Fitted]) -> Outcome:
    """Two effects that are needed at the same time, the stronger first; or such pairs, best first."""
    best = found[0]
    different: dict[frozenset[str], Fitted] = {}
    for pair in found:
        different.setdefault(frozenset(effect.name for effect in pair.effects), pair)
    rivals = tuple(different.values())
    if len(rivals) == 1:
        names = tuple(effect.name for effect in best.effects)
        sentence = f"The data miss two effects at once: {names[0]} and {names[1]}."
        return Outcome("effect", sentence, best, names, together=True, rivals=rivals)
    listed = ", or ".join(" and ".join(effect.name for effect in pair.effects) for pair in rivals)
    sentence = f"Two effects at once are missing; the data cannot tell which: {listed}."
    union = dict.fromkeys(effect.name for pair in rivals for effect in pair.effects)
    return Outcome("ambiguous", sentence, best, tuple(union), rivals=rivals)


def unknown(base: Fitted, screening: Screening) -> Outcome:
    """Structure is left, described by the probe that gains most in a screening."""
    probes = [(g, c) for g, c in zip(screening.gain, screening.candidates, strict=True) if c in PROBES]
    _, probe = max(probes, key=lambda pair: pair[0])
    return Outcome(
        "unknown",
        "Structure is left that no effect of the library explains; the residual behaves like this:"
        f" {probe.sentence[0].lower()}{probe.sentence[1:]}",
        base,
        depends_on=f"{probe.name}: {probe.sentence}",
    )
