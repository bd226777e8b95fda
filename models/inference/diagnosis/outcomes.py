"""What a diagnosis may come to: each verdict with its sentence and the models that belong to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from slipmap.models.effects.probes import PROBES
from slipmap.models.inference.diagnosis.fitting import Fitted
from slipmap.models.inference.diagnosis.screening import Screening
from slipmap.models.inference.diagnosis.verdict_rules import STAYS_OFF


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
    fault: str | None = None  # of the records, which has to be mended before anything can be told
    # what speaks against those that the open pushes would name, by their names
    objections: Mapping[str, str] = field(default_factory=dict)


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


def without_those_objected_to(
    answer: Outcome, objections: Mapping[str, str], base: Fitted, screening: Screening
) -> Outcome:
    """An answer less those of its rivals that something speaks against.

    Args:
        answer: with rivals.
        objections: what speaks against some of them, by `name_of`.
        base: the model without effects.
        screening: gains on top of that.
    """
    kept = [rival for rival in answer.rivals if name_of(rival) not in objections]
    if len(kept) == len(answer.rivals):
        return answer
    if kept:
        whole = one_of(kept) if len(kept[0].effects) == 1 else two_at_once(kept)
        return replace(whole, objections=objections)
    names = list(objections)
    clauses = dict.fromkeys(objections.values())
    stays_off = STAYS_OFF in clauses
    sentence = (
        f"On the open pushes {' or '.join(names)} would explain {'something' if stays_off else 'much'}, but"
        f" {' or '.join(clauses)}"
    )
    if stays_off:
        found = unknown(base, screening)
        return replace(
            found,
            sentence=f"{sentence}: that is not what is missing. {found.sentence}",
            objections=objections,
        )
    return Outcome(
        "undecided",
        f"{sentence}: the pushes are too few, or scatter too much, to decide.",
        base,
        objections=objections,
    )


def far_off(base: Fitted, misfit: float) -> Outcome:
    """Nothing gains enough, but predictions are far off; `misfit` is that of the typical push."""
    sentence = (
        f"The model is not adequate: it misses pushes by {misfit:.0f} times the sensor noise, and no effect"
        " that was tried explains this. The cause may be an effect outside the library, the object's outline"
        " or the recording; start with any warnings that were given when the dataset was read."
    )
    return Outcome("undecided", sentence, base)


def records_wrong(base: Fitted, fault: str) -> Outcome:
    """Finger and object do not touch in the records; `fault` is a clause that says how, and asks why."""
    sentence = f"The records contradict themselves, so that no effect can be told: {fault}"
    return Outcome("undecided", sentence, base, fault=fault)


def name_of(rival: Fitted) -> str:
    """The effects of a model, for a person."""
    return " and ".join(effect.name for effect in rival.effects)


def one_of(rivals: Sequence[Fitted]) -> Outcome:
    """One effect, or a set that the pushes cannot tell apart, best first."""
    names = tuple(fitted.effects[0].name for fitted in rivals)
    listed = ", ".join(names)
    if len(rivals) == 1:
        return Outcome(
            "effect", f"The model lacks one effect: {listed}.", rivals[0], names, rivals=tuple(rivals)
        )
    sentence = f"The model lacks an effect; the pushes cannot tell which of these it is: {listed}."
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
        sentence = f"The model lacks two effects at once: {names[0]} and {names[1]}."
        return Outcome("effect", sentence, best, names, together=True, rivals=rivals)
    listed = ", or ".join(map(name_of, rivals))
    sentence = f"The model lacks two effects at once; the pushes cannot tell which: {listed}."
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
