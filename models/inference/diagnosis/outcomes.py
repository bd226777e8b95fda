"""Possible outcomes of a diagnosis: each verdict with its sentence and its models, and what may be wrong with
the dataset rather than the physics, so that an effect is named, or none found.

Wrong facts about the object or the finger act like effects: a finger that is thinner than stated like a soft
one, a wrong mass like loose mass or friction that depends on speed, and cells that are wider than the base on
which the object rests like physics that nobody knows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from slipmap.models.effects.probes import PROBES
from slipmap.models.inference.diagnosis.fitting import MOTION_ERRORS, Fitted
from slipmap.models.inference.diagnosis.locked import LockedErrors, locked_errors
from slipmap.models.inference.diagnosis.screening import Screening
from slipmap.models.inference.diagnosis.verdict_rules import AT_NOISE, Objection, typical_misfit
from slipmap.models.inference.identifiability import coarse_cells
from slipmap.models.inference.push_errors import Paired
from slipmap.models.inference.results import Identification, Quantity
from slipmap.models.measurements import PushDataset
from slipmap.models.measurements.contact import common_cause, contact_rows
from slipmap.models.measurements.dataset_check import check_dataset

_LIKE_A_WRONG_SIZE = ("finger_compliance", "sensor_latency", "force_latency")
_LIKE_A_WRONG_MASS = ("loose_mass", "load_transfer", "stribeck_friction", "viscous_friction")

_MEASURE = "measure the finger and the outline, and correct finger.radius or object.outline"

_STATED = 0.02
"""How far the logarithm of the learned mass may lie from what was stated while nothing suggests that it is
wrong: one standard deviation of that. Stated three times too large, it was learned 3 % off."""

_AS_WELL = 1.05
"""Misfit of locked pushes with the mass left open, over that with the effect, up to which it explains them as
well."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """A verdict."""

    verdict: str  # one of `results.VERDICTS`
    sentence: str  # the verdict in words
    best: Fitted  # fitted model with the best effects, or without
    effects: tuple[str, ...] = ()  # what the data cannot rule out, best first; together if `together`
    together: bool = False  # whether all of the effects are needed at once
    depends_on: str | None = None  # sentence of the probe that finds structure that no effect explains
    rivals: tuple[Fitted, ...] = ()  # fitted models of the effects
    fault: str | None = None  # fault in the records that must be fixed before any effect can be identified
    # objections to effects that the open pushes favour, by name
    objections: Mapping[str, str] = field(default_factory=dict)
    first: tuple[str, ...] = ()  # what to do before the answer is trusted, each an imperative clause
    doubts: tuple[str, ...] = ()  # what `slipmap check` finds wrong with the dataset, where that matters


def nothing_missing(base: Fitted) -> Outcome:
    """The model explains the data."""
    return Outcome("adequate", "The model explains the data; no effect is missing.", base)


def nothing_visible(base: Fitted, pushes: str) -> Outcome:
    """Nothing was found, but these pushes would not have revealed most effects."""
    sentence = f"Nothing seems to be missing, but {pushes} could not have revealed most effects."
    return Outcome("undecided", sentence, base)


def cannot_show_why(base: Fitted, pushes: str, misfit: float) -> Outcome:
    """Predictions are far off, but these pushes would not reveal most effects; `misfit` as for `far_off`."""
    sentence = (
        f"The model is far off: it misses pushes by {misfit:.0f} times the sensor noise. But {pushes} could"
        " not show why, since most effects would not be revealed."
    )
    return Outcome("undecided", sentence, base)


def scatter(base: Fitted) -> Outcome:
    """The model error is large, and no effect explains it."""
    error = base.likelihood.error.motion
    share = f"{100 * error:.0f} % or more" if error == MOTION_ERRORS[-1] else f"about {100 * error:.0f} %"
    sentence = (
        f"The model error is large, {share} of the distance moved, but no effect explains it:"
        " the pushes may not be repeatable, or something unknown disturbs them."
    )
    return Outcome("undecided", sentence, base)


def disagreement(base: Fitted, pushes: int, p: float) -> Outcome:
    """The pushes disagree on which effect gains; p is the share of random sign flips that gain as much."""
    sentence = (
        f"The model leaves much unexplained, but the {pushes} pushes do not agree on the cause: with the"
        f" signs of their residuals flipped at random, they would show as much in {100 * p:.0f} % of cases."
    )
    if pushes == 1:
        sentence = (
            "The model leaves much unexplained, but a single push cannot show whether others would agree on"
            " the cause."
        )
    return Outcome("undecided", sentence, base)


def too_faint(base: Fitted) -> Outcome:
    """An effect gains, but too little to be named."""
    sentence = "Something may be missing, but its trace in these pushes is too faint to say what it is."
    return Outcome("undecided", sentence, base)


def without_those_objected_to(
    answer: Outcome, objections: Mapping[str, Objection], base: Fitted, screening: Screening
) -> Outcome:
    """Drop from an answer the rivals that are objected to.

    Args:
        answer: with rivals.
        objections: to some of them, by `name_of`.
        screening: gains over that model.
    """
    kept = [rival for rival in answer.rivals if name_of(rival) not in objections]
    if len(kept) == len(answer.rivals):
        return answer
    told = {name: one.clause() for name, one in objections.items()}
    if kept:
        whole = one_of(kept) if len(kept[0].effects) == 1 else two_at_once(kept)
        return replace(whole, objections=told)
    reasons = {one.reason for one in objections.values()}
    sentence = (
        f"On the open pushes, {' or '.join(objections)} would explain"
        f" {'something' if 'stays off' in reasons else 'much'}, but {_objected(objections)}"
    )
    if any(one.leaves_much for one in objections.values()):
        found = unknown(base, screening)
        return replace(
            found, sentence=f"{sentence}, so something else is missing. {found.sentence}", objections=told
        )
    return Outcome(
        "undecided",
        f"{sentence}. There are too few pushes, or they are too alike or scatter too much, to decide.",
        base,
        objections=told,
    )


def _objected(objections: Mapping[str, Objection]) -> str:
    """Objections to answers that were just named, as clauses that say which answer each is about."""
    alike: dict[Objection, list[str]] = {}
    for name, one in objections.items():
        alike.setdefault(one, []).append(name)
    if len(alike) > 1:
        return ", and ".join(one.clause(" or ".join(names)) for one, names in alike.items())
    every = {1: None, 2: "either"}.get(len(objections), "any of them")
    return next(iter(alike)).clause(every)


def far_off(base: Fitted, misfit: float, most: tuple[str, float] | None = None) -> Outcome:
    """No effect is accepted, but predictions are far off; `misfit` is that of the typical push.

    Args:
        misfit: in units of sensor noise.
        most: the effect that explains most of it although something remains, and the misfit with it.
    """
    cause = "an effect outside the library, the object's outline or the recording"
    warnings = "start with any warnings that were given when the dataset was read."
    sentence = f"The model is not adequate: it misses pushes by {misfit:.0f} times the sensor noise, and"
    if most is None:
        sentence += f" no effect that was tried explains this. The cause may be {cause}; {warnings}"
    else:
        name, left = most
        sentence += (
            f" {name} explains most of it (with it, {left:.1f} times), but something remains, so it is not"
            f" named. The rest may come from another effect, as the table says, or from {cause}; {warnings}"
        )
    return Outcome("undecided", sentence, base)


def records_wrong(base: Fitted, fault: str) -> Outcome:
    """The recorded finger and object do not fit together; `fault` is a clause with the symptom and cause."""
    sentence = f"The records contradict themselves, so no effect can be identified: {fault}"
    return Outcome("undecided", sentence, base, fault=fault)


def name_of(rival: Fitted) -> str:
    """The effects of a model as text."""
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
    """Two effects that are both needed, the stronger first; or several such pairs, best first."""
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


def unknown(base: Fitted, screening: Screening, nearest: str = "") -> Outcome:
    """The residual has structure, described by the probe that gains most in a screening.

    Args:
        screening: gains over that model, or over the effect that comes nearest.
        nearest: that effect, what it gains and what is left on top, as a clause.
    """
    probes = [(g, c) for g, c in zip(screening.gain, screening.candidates, strict=True) if c in PROBES]
    _, probe = max(probes, key=lambda pair: pair[0])
    behaves = "It behaves like this:"
    if nearest:
        behaves = f"Nearest comes {nearest}. What is left then behaves like this:"
    return Outcome(
        "unknown",
        f"The residual has structure that no effect in the library explains. {behaves}"
        f" {probe.sentence[0].lower()}{probe.sentence[1:]}",
        base,
        depends_on=f"{probe.name}: {probe.sentence}",
    )


# What else would explain the pushes.


def doubts_of_check(dataset: PushDataset) -> tuple[str, ...]:
    """What `slipmap check` calls wrong or reading warned of, by the names of its findings."""
    found = [
        finding.what
        for finding in check_dataset(dataset).findings
        if finding.verdict == "wrong"
        or (finding.advice and any(finding.found in warning for warning in dataset.warnings))
    ]
    return tuple(dict.fromkeys(found))


def with_other_causes(
    answer: Outcome,
    dataset: PushDataset,
    without: Identification,
    before: LockedErrors | None,
    after: LockedErrors | None,
    free_mass: Callable[[], Identification],
) -> Outcome:
    """An answer that also names what else would explain the pushes, and says to rule this out first.

    Only a wrong mass is looked for where nothing is missing.

    Args:
        dataset: all pushes.
        without: what `identify` learns without effects.
        before: errors of the locked pushes without effects; None where nothing was locked.
        after: the same with the answer; None also where it has no effects.
        free_mass: learns the same as `without` with the mass left open.
    """
    if answer.fault is not None:
        return answer
    told = [
        _wrong_size(answer.effects, dataset),
        _wrong_mass(answer.effects, dataset, after, free_mass),
        None if answer.effects else _contradicted_mass(dataset, without, before, free_mass),
        _coarse_cells(answer, without),
    ]
    found = [one for one in told if one is not None]
    return replace(
        answer,
        sentence=" ".join([answer.sentence, *(sentence for sentence, _ in found)]),
        first=tuple(todo for _, todo in found),
        doubts=() if answer.verdict == "adequate" else doubts_of_check(dataset),
    )


def wrong_sizes(effects: Sequence[str], datasets: Sequence[PushDataset]) -> tuple[list[str], list[str]]:
    """Datasets in which contact suggests that the finger's radius or the outline is wrong, where that would
    look like one of several effects: sentences, and what to do first."""
    names: dict[str, list[str]] = {}
    for dataset in datasets:
        found = _wrong_size(effects, dataset)
        if found is not None:
            names.setdefault(found[0], []).append(dataset.name)
    sentences = [f"In {', '.join(own)}: {text[0].lower()}{text[1:]}" for text, own in names.items()]
    every = [dataset.name for dataset in datasets if any(dataset.name in own for own in names.values())]
    return sentences, [f"{_MEASURE} of {', '.join(every)}"] * bool(every)


def _named(effects: Sequence[str], among: Sequence[str]) -> str:
    return " or ".join(effect for effect in effects if effect in among)


def _wrong_size(effects: Sequence[str], dataset: PushDataset) -> tuple[str, str] | None:
    """The finger's radius or the outline, where contact suggests that one is wrong."""
    named = _named(effects, _LIKE_A_WRONG_SIZE)
    if not named:
        return None
    rows = contact_rows(dataset, dataset.trials)
    cause = common_cause(dataset, rows, len(rows))
    if cause is None or cause.kind != "radius":
        return None
    return (
        f"A wrong finger.radius or outline would look like {named}, and contact suggests it: {cause.text}",
        _MEASURE,
    )


def _wrong_mass(
    effects: Sequence[str],
    dataset: PushDataset,
    after: LockedErrors | None,
    free_mass: Callable[[], Identification],
) -> tuple[str, str] | None:
    """The stated mass, where the plain model with another one predicts the locked pushes as well."""
    named = _named(effects, _LIKE_A_WRONG_MASS)
    if not named or dataset.mass is None or after is None:
        return None
    learned = free_mass()
    errors, mass = locked_errors(learned), _total_mass(learned)
    assert errors is not None
    if mass.low <= dataset.mass <= mass.high or Paired.of(after.misfit, errors.misfit).ratio > _AS_WELL:
        return None
    return (
        f"A wrong object.mass would look like {named}: with {mass.low:.2g} to {mass.high:.2g} kg instead of"
        f" {dataset.mass:.3g} kg, the model predicts the locked pushes as well without any effect.",
        "weigh the object, and correct object.mass",
    )


def _contradicted_mass(
    dataset: PushDataset,
    without: Identification,
    before: LockedErrors | None,
    free_mass: Callable[[], Identification],
) -> tuple[str, str] | None:
    """The stated mass, where the plain model with another one predicts the locked pushes clearly better.

    This takes another fit, so only where the learned mass is drawn away from what was stated, or the locked
    pushes are missed by more than the noise.
    """
    if dataset.mass is None or before is None or not len(before.misfit):
        return None
    drawn = abs(math.log(_total_mass(without).value / dataset.mass)) > _STATED
    if not drawn and typical_misfit(before.misfit) <= AT_NOISE:
        return None
    learned = free_mass()
    errors, mass = locked_errors(learned), _total_mass(learned)
    assert errors is not None
    paired = Paired.of(before.misfit, errors.misfit)
    if mass.low <= dataset.mass <= mass.high or paired.verdict != "for":
        return None
    return (
        f"But the stated object.mass of {dataset.mass:.3g} kg contradicts the pushes: with {mass.low:.2g} to"
        f" {mass.high:.2g} kg, the model predicts the locked pushes better, with {paired.ratio:.2g} times the"
        " misfit.",
        "weigh the object, and correct object.mass",
    )


def _total_mass(learned: Identification) -> Quantity:
    return next(quantity for quantity in learned.quantities if quantity.name == "total mass")


def _coarse_cells(answer: Outcome, without: Identification) -> tuple[str, str] | None:
    """Cells too wide for the base that carries the object, where no effect explains the pushes."""
    coarse = coarse_cells(without.belief) if answer.verdict == "unknown" else None
    if coarse is None:
        return None
    return f"Cells that are too coarse would look like this too: {coarse}.", "give the object finer cells"
