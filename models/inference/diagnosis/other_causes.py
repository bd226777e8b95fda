"""What may be wrong with the dataset rather than the physics, so that an effect is named, or none found.

Wrong facts about the object or the finger act like effects: a finger that is thinner than stated like a soft
one, a wrong mass like loose mass or friction that depends on speed, and cells that are wider than the base on
which the object rests like physics that nobody knows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from slipmap.models.inference.diagnosis.locked import LockedErrors, locked_errors
from slipmap.models.inference.diagnosis.outcomes import Outcome
from slipmap.models.inference.identifiability import coarse_cells
from slipmap.models.inference.push_errors import Paired
from slipmap.models.inference.results import Identification
from slipmap.models.measurements import PushDataset
from slipmap.models.measurements.contact import common_cause, contact_rows
from slipmap.models.measurements.dataset_check import check_dataset

_LIKE_A_WRONG_SIZE = ("finger_compliance", "sensor_latency", "force_latency")
_LIKE_A_WRONG_MASS = ("loose_mass", "load_transfer", "stribeck_friction", "viscous_friction")

_AS_WELL = 1.05
"""Misfit of locked pushes with the mass left open, over that with the effect, up to which it explains them as
well."""


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
    after: LockedErrors | None,
    free_mass: Callable[[], Identification],
) -> Outcome:
    """An answer that also names what else would explain the pushes, and says to rule this out first.

    Args:
        answer: the verdict.
        dataset: all pushes.
        without: what `identify` learns without effects.
        after: errors of the locked pushes with the answer; None where nothing was locked.
        free_mass: learns the same as `without` with the mass left open.
    """
    if answer.verdict == "adequate" or answer.fault is not None:
        return answer
    told = [
        _wrong_size(answer.effects, dataset),
        _wrong_mass(answer.effects, dataset, after, free_mass),
        _coarse_cells(answer, without),
    ]
    found = [one for one in told if one is not None]
    return replace(
        answer,
        sentence=" ".join([answer.sentence, *(sentence for sentence, _ in found)]),
        first=tuple(todo for _, todo in found),
        doubts=doubts_of_check(dataset),
    )


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
        "measure the finger and the outline, and correct finger.radius or object.outline",
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
    errors = locked_errors(learned)
    mass = next(quantity for quantity in learned.quantities if quantity.name == "total mass")
    assert errors is not None
    if mass.low <= dataset.mass <= mass.high or Paired.of(after.misfit, errors.misfit).ratio > _AS_WELL:
        return None
    return (
        f"A wrong object.mass would look like {named}: with {mass.low:.2g} to {mass.high:.2g} kg instead of"
        f" {dataset.mass:.3g} kg, the model predicts the locked pushes as well without any effect.",
        "weigh the object, and correct object.mass",
    )


def _coarse_cells(answer: Outcome, without: Identification) -> tuple[str, str] | None:
    """Cells too wide for the base that carries the object, where no effect explains the pushes."""
    coarse = coarse_cells(without.belief) if answer.verdict == "unknown" else None
    if coarse is None:
        return None
    return f"Cells that are too coarse would look like this too: {coarse}.", "give the object finer cells"
