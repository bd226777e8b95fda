"""What a diagnosis reports, of one dataset or of several."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from slipmap.models.effects.effect import Effect, bounds
from slipmap.models.effects.library import LIBRARY
from slipmap.models.inference.diagnosis.fitting import Fitted
from slipmap.models.inference.diagnosis.joint_answer import MORE_PUSHES
from slipmap.models.inference.diagnosis.locked import LockedErrors, locked_errors, turned
from slipmap.models.inference.diagnosis.outcomes import Outcome
from slipmap.models.inference.results import Identification
from slipmap.models.physics.cell_grid import FloatArray

VERDICTS = ("adequate", "effect", "ambiguous", "unknown", "undecided")

QUICK_COARSENESS = 2.0
"""Factor by which a quick diagnosis lengthens the simulation's steps."""


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter of an effect with its 90 % interval."""

    effect: str
    name: str
    unit: str
    value: float
    low: float
    high: float


def parameter_estimates(fitted: Fitted) -> tuple[ParameterEstimate, ...]:
    """Parameters of a fitted model with their 90 % intervals."""
    return estimated(fitted.effects, fitted.values, fitted.standard_deviations)


def estimated(
    effects: Sequence[Effect], values: FloatArray, deviations: FloatArray
) -> tuple[ParameterEstimate, ...]:
    """Parameters (P,) of effects, given their standard deviations, with 90 % intervals clipped to the allowed
    range."""
    (low, high), spread = bounds(effects), 1.645 * deviations
    ends = np.maximum(values - spread, low).tolist(), np.minimum(values + spread, high).tolist()
    every = [(effect.name, p.name, p.unit) for effect in effects for p in effect.parameters]
    numbers = zip(every, values.tolist(), *ends, strict=True)
    return tuple(ParameterEstimate(*names, *own) for names, *own in numbers)


def estimates_by_effect(learned: Identification) -> dict[str, tuple[ParameterEstimate, ...]]:
    """Parameters of each effect learned with a belief, with their 90 % intervals."""
    return {
        effect: tuple(
            ParameterEstimate(effect, name, v["unit"], v["value"], v["low"], v["high"])
            for name, v in parameters.items()
        )
        for effect, parameters in learned.effect_estimates.items()
    }


@dataclass(frozen=True, eq=False)
class CandidateResult:
    """What the data say about one candidate."""

    name: str  # of the effect
    gain: float  # in predictive score on left-out pushes, to first order, nats
    # share of datasets simulated without any missing effect whose largest gain is at least this; None where
    # none were simulated
    p_value: float | None
    # drop in cost when everything is refitted with the effect, nats; None where it was not refitted
    fitted_gain: float | None = None
    # the effect or probe whose addition shows that this one does not explain the data; None where there is
    # none, or where this was not screened
    rejected_by: str | None = None
    remaining_gain: float | None = None  # of that addition, nats
    remaining_p: float | None = None  # its p-value
    in_set: bool = False  # whether it is in the answer
    parameters: tuple[ParameterEstimate, ...] = ()  # where it was refitted

    @property
    def explains(self) -> bool:
        """Whether it was screened for what it leaves, and nothing shows that it does not explain the data."""
        return self.remaining_gain is not None and self.rejected_by is None


@dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosis(Outcome):
    """Result of `diagnose`: the verdict and its evidence."""

    candidates: tuple[CandidateResult, ...]  # all that were tried, best first
    p_value: float | None  # of the largest gain; None where nothing was simulated
    open_trials: tuple[str, ...]  # pushes that were fitted
    locked: tuple[str, ...]  # pushes that were locked away
    # what `identify` learns from the open pushes; its laws of friction lack the effects of the answer
    without_effects: Identification
    with_effects: Identification | None  # the same with the best effects; None where there is none
    base: Fitted  # fitted model without effects
    motion_error: float  # α of the final error model
    force_error: float  # β of the final error model
    quick: bool  # whether calibration was skipped
    seconds: float  # run time
    seed: int  # of all random draws
    # the push to make next as plain numbers, filled in by a planner; None where it would decide nothing
    next_push: dict[str, object] | None = field(default=None)
    hopeless: str | None = None  # models that no push like the recorded ones would tell apart, in words

    def __repr__(self) -> str:
        return f"Diagnosis({self.verdict}: {self.sentence})"

    @property
    def before(self) -> LockedErrors | None:
        """Errors on locked pushes without any effect; None where none were locked."""
        return locked_errors(self.without_effects)

    @property
    def after(self) -> LockedErrors | None:
        """Errors on locked pushes with the best effects; equal to `before` where there are none."""
        return self.before if self.with_effects is None else locked_errors(self.with_effects)

    @property
    def effect_objects(self) -> tuple[Effect, ...]:
        """The effects of `best`."""
        return self.best.effects

    @property
    def coarseness(self) -> float:
        """Factor by which the simulation's steps were longer than usual."""
        return QUICK_COARSENESS if self.quick else 1.0

    @property
    def effect(self) -> str | None:
        """The one effect that is named, the stronger where two are needed."""
        return self.effects[0] if self.verdict == "effect" else None

    @property
    def parameters(self) -> tuple[ParameterEstimate, ...]:
        """Parameters of the effects in the answer."""
        found = {candidate.name: candidate.parameters for candidate in self.candidates}
        return tuple(p for name in self.effects for p in found.get(name, ()))

    def next_step(self, where: str = "DATASET") -> str:
        """What to do next, with the command to type.

        Args:
            where: the dataset in that command, and options that say how to read and explain it.
        """
        again = f"`slipmap diagnose {where}`"
        if self.fault is not None:
            check = f"`slipmap check {_plain(where)}`"
            return f"correct the records, check them with {check}, then run {again} again."
        return _after(self.corrections(where), again, self._step(where, again))

    def corrections(self, where: str = "DATASET") -> list[str]:
        """What to correct or rule out before the answer is trusted, each an imperative clause."""
        if not self.doubts:
            return list(self.first)
        found = ", ".join(self.doubts)
        return [*self.first, f"correct what `slipmap check {_plain(where)}` finds wrong ({found})"]

    def _step(self, where: str, again: str) -> str:
        """What follows from the verdict alone; `again` is the command of this diagnosis."""
        push = "record more pushes into the dataset (imported files: import all again)"
        if self.next_push is not None:
            push = (
                "record the proposed push and add it with `role: fit` (imported files: list those to hold out"
                " under `heldout` in the setup.yaml, and import all again)"
            )
        elif self.hopeless is not None:
            push = (
                f"no push like those made so far would tell {self.hopeless}; {push}, faster or slower, longer"
                " or elsewhere"
            )
        if self.quick and self.verdict != "adequate":
            return f"run {again} without --quick to learn how certain this is."
        if self.verdict == "adequate":
            return f"run `slipmap identify {_plain(where)} -o belief.npz` to learn the model to plan with."
        if self.verdict == "effect":
            return f"run `{_fit(where, self.effects, self.best)}` to learn this model."
        if self.verdict == "ambiguous":
            simplest = min(self.rivals, key=lambda rival: sum(len(one.parameters) for one in rival.effects))
            command = _fit(where, [effect.name for effect in simplest.effects], simplest)
            return (
                f"{push}, then run {again} again. If no more pushes can be made, predict with what has the"
                f" fewest parameters: run `{command}`."
            )
        if self.verdict == "unknown":
            return (
                f"run `slipmap compare {where}` to see where and how the model fails; write your own effect"
                f" in a file and try it with `slipmap diagnose {_plain(where)} --effect-file FILE`."
            )
        return f"{push}, then run {again} again; `slipmap compare {where}` shows how far off the model is."

    def to_json(self, where: str = "DATASET") -> dict[str, object]:
        """The machine-readable result; lengths in m, null for what is absent; `where` as in `next_step`."""

        def mean(errors: LockedErrors | None, name: str) -> float | None:
            return None if errors is None else float(getattr(errors, name).mean())

        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "effect": self.effect,
            "effects": list(self.effects),
            "together": self.together,
            "parameters": {
                name: {
                    p.name: {"value": p.value, "low": p.low, "high": p.high, "unit": p.unit}
                    for p in self.parameters
                    if p.effect == name
                }
                for name in self.effects
            },
            "p_value": self.p_value,
            "depends_on": self.depends_on,
            "candidates": [
                {name: value for name, value in vars(c).items() if name != "parameters"}
                for c in self.candidates
            ],
            "open_trials": list(self.open_trials),
            "locked_trials": list(self.locked),
            "heldout_error_before": mean(self.before, "path"),
            "heldout_error_after": mean(self.after, "path"),
            "heldout_final_error_before": mean(self.before, "final"),
            "heldout_final_error_after": mean(self.after, "final"),
            "heldout_misfit_before": None if self.before is None else self.before.total_misfit,
            "heldout_misfit_after": None if self.after is None else self.after.total_misfit,
            "motion_error": self.motion_error,
            "force_error": self.force_error,
            "next_push": self.next_push,
            "first": self.corrections(where),
            "next_step": self.next_step(where),
            "calibrated": not self.quick,
            "seconds": self.seconds,
            "seed": self.seed,
        }


@dataclass(frozen=True, eq=False)
class JointCandidate:
    """What several datasets say about one effect."""

    name: str
    first_gain: float  # drop in cost to first order, nats
    # share of random signs of whole pushes under which the largest first gain of all effects is at least this
    p_value: float | None
    gain: float | None  # the same after a full refit; None without one
    evidence: float | None  # the same less what its parameters would gain anyway
    in_set: bool  # whether it is in the answer
    # what speaks against an effect that the locked pushes have judged; `not refitted` where a refit failed
    objection: str | None
    # how large an effect that the datasets share could still be beside the answer, to first order; empty for
    # effects of the answer and where the pushes do not tell
    bounds: tuple[ParameterEstimate, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The machine-readable result."""
        return vars(self) | {"bounds": _by_name(self.bounds)}


@dataclass(frozen=True, eq=False)
class DatasetResult:
    """One dataset of several."""

    name: str
    open_trials: tuple[str, ...]  # pushes that were fitted
    locked: tuple[str, ...]  # pushes that judge
    whole: bool  # whether the whole object was locked away: its open pushes taught only its maps
    before: LockedErrors | None  # without effects; None where nothing was locked
    after: LockedErrors | None  # with the answer, or the first of several; None where there is none
    fall: float | None  # drop in cost of its locked pushes with it, nats
    # its parameters from this dataset alone, its maps refitted; empty for a whole locked object
    alone: tuple[ParameterEstimate, ...]

    def to_json(self) -> dict[str, Any]:
        """The machine-readable result, lengths in m."""

        def of(found: LockedErrors | None) -> dict[str, float] | None:
            if found is None:
                return None
            return {
                "path": float(found.path.mean()),
                "final": float(found.final.mean()),
                "misfit": found.total_misfit,
            }

        return {
            "dataset": self.name,
            "open_trials": list(self.open_trials),
            "locked_trials": list(self.locked),
            "whole": self.whole,
            "before": of(self.before),
            "after": of(self.after),
            "fall": self.fall,
            "alone": _by_name(self.alone),
        }


@dataclass(frozen=True, eq=False)
class JointDiagnosis:
    """Result of `diagnose_together`."""

    verdict: str  # adequate, effect, ambiguous or undecided
    sentence: str  # the verdict in words
    effects: tuple[str, ...]  # what the data cannot rule out, best first; two at once if `together`
    shared: bool  # whether the datasets have one set of the best effect's parameters
    # shared parameters of the effects; each effect is fitted alone unless both are needed at once
    parameters: tuple[ParameterEstimate, ...]
    candidates: tuple[JointCandidate, ...]  # best first
    p_value: float | None  # of the largest first gain
    datasets: tuple[DatasetResult, ...]
    fall: float | None  # drop in cost of all locked pushes with the answer, nats
    # what `slipmap check` finds wrong, by the name of the dataset; empty where the model is adequate
    doubts: dict[str, tuple[str, ...]]
    seconds: float
    seed: int
    together: bool = False  # whether two effects are needed at once
    apart: tuple[str, ...] = ()  # owners of effects that the datasets do not share, as given
    # whose the first effect of the answer is (`Effect.belongs_to`), or the one that would explain most
    owner: str | None = None
    first: tuple[str, ...] = ()  # what to do before the answer is trusted, each an imperative clause

    @property
    def effect(self) -> str | None:
        """The one effect that is named, the first where two are needed."""
        return self.effects[0] if self.verdict == "effect" else None

    def next_step(self, where: str = "DATASET...") -> str:
        """What to do next, with the command to type; `where` names the datasets in that command."""
        return _after(self.corrections(), f"`slipmap diagnose {where}`", self._step(where))

    def corrections(self) -> list[str]:
        """What to correct before the answer is trusted, each an imperative clause."""
        return [
            *self.first,
            *(
                f"correct what `slipmap check` finds wrong with {name} ({', '.join(found)})"
                for name, found in self.doubts.items()
                if found
            ),
        ]

    def _step(self, where: str) -> str:
        """What follows from the verdict alone."""
        if self.effect is not None:
            names = " ".join(f"--effect {name}" for name in self.effects)
            more = "" if set(self.effects) <= {effect.name for effect in LIBRARY} else _own(where)
            output = f"with-{'-'.join(self.effects)}.npz"
            command = f"slipmap fit {_plain(where)} {names}{more} -o {output}"
            learn = f"run `{command}` to learn this model, with one belief of each object."
            without = [
                one.name for one in self.datasets if one.fall is not None and turned(one.fall) == "worse"
            ]
            if not (self.shared and without):
                return learn
            names, do = ", ".join(without), "does" if len(without) == 1 else "do"
            return (
                f"if {names} {do} not share the {self.owner} with the others, add {self._apart} to"
                f" `slipmap diagnose {where}`, or leave {names} out; otherwise {learn}"
            )
        if self.verdict == "adequate":
            return (
                "for each dataset, run `slipmap identify DATASET -o belief.npz` to learn the model to plan"
                " with."
            )
        if not any(one.locked for one in self.datasets):
            return f"{MORE_PUSHES}, then run `slipmap diagnose {where}` again."
        each = (
            "run `slipmap diagnose DATASET` for each dataset, since a joint diagnosis misses what only one of"
        )
        if self.owner is None and not self.apart:
            return f"{each} them has; or name with --apart what they do not share."
        if self.owner in (None, "object", *self.apart):
            return f"{each} them has."
        return f"{each} them has; or, if they do not share the {self.owner}, add {self._apart}."

    @property
    def _apart(self) -> str:
        """The option that says that the datasets do not share the owner of the first effect."""
        return f"`--apart {shlex.quote(self.owner or '')}`"

    def to_json(self, where: str = "DATASET...") -> dict[str, Any]:
        """The machine-readable result; `where` as in `next_step`."""
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "first": self.corrections(),
            "next_step": self.next_step(where),
            "effect": self.effect,
            "effects": list(self.effects),
            "together": self.together,
            "shared": self.shared,
            "parameters": _by_effect(self.parameters),
            "candidates": [candidate.to_json() for candidate in self.candidates],
            "p_value": self.p_value,
            "datasets": [one.to_json() for one in self.datasets],
            "fall": self.fall,
            "seconds": self.seconds,
            "seed": self.seed,
        }


@dataclass(frozen=True, eq=False)
class JointIdentification:
    """Result of `fit_together`."""

    verdict: str  # for, against or undecided
    sentence: str  # the verdict in words
    effects: tuple[str, ...]  # in the model
    parameters: tuple[ParameterEstimate, ...]  # shared parameters of the effects
    evidence: float  # drop in cost of the open pushes less what the parameters would gain anyway, nats
    fall: float  # drop in cost of all locked pushes, nats
    datasets: tuple[DatasetResult, ...]
    learned: tuple[Identification, ...]  # of each dataset, with the effects
    seconds: float
    seed: int

    def held_out_errors(self) -> dict[str, float]:
        """Mean error (ADD) at the end, m, of each dataset's held-out pushes as its belief predicts them."""
        errors = {one.belief.dataset: one.errors("heldout") for one in self.learned}
        return {name: float(own.mean()) for name, own in errors.items() if len(own)}

    def to_json(self) -> dict[str, Any]:
        """The machine-readable result."""
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "effects": list(self.effects),
            "parameters": _by_effect(self.parameters),
            "evidence": self.evidence,
            "fall": self.fall,
            "datasets": [one.to_json() for one in self.datasets],
            "held_out_errors": self.held_out_errors(),
            "seconds": self.seconds,
            "seed": self.seed,
        }


def _plain(where: str) -> str:
    """What a command takes that knows no effects of one's own."""
    pairs = pairwise(["", *shlex.split(where)])
    return shlex.join(word for before, word in pairs if "--effect-file" not in (before, word))


def _own(where: str) -> str:
    """The option that names files of effects; `FILE` where none was given."""
    pairs = pairwise(["", *shlex.split(where)])
    files = [word for before, word in pairs if before == "--effect-file"]
    return "".join(f" --effect-file {shlex.quote(file)}" for file in files or ["FILE"])


def _fit(where: str, names: Sequence[str], fitted: Fitted) -> str:
    """The command that learns a model with the effects of these names, those of `fitted`."""
    options = " ".join(f"--effect {name}" for name in names)
    own = "" if set(fitted.effects) <= set(LIBRARY) else _own(where)
    return f"slipmap fit {_plain(where)} {options}{own} -o with-{'-'.join(names)}.npz"


def _after(first: Sequence[str], again: str, step: str) -> str:
    """A step to take after other things, if there are any, and the command that is to be run again."""
    if not first:
        return step
    return f"{'; '.join(first)}; then run {again} again. If nothing can be corrected, {step}"


def _by_effect(estimates: Sequence[ParameterEstimate]) -> dict[str, dict[str, dict[str, Any]]]:
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for p in estimates:
        own = {"value": p.value, "low": p.low, "high": p.high, "unit": p.unit}
        found.setdefault(p.effect, {})[p.name] = own
    return found


def _by_name(estimates: Sequence[ParameterEstimate]) -> dict[str, dict[str, Any]]:
    """By parameter; where there are several effects, by effect and parameter in one name."""
    single = len({p.effect for p in estimates}) == 1
    found = _by_effect(estimates)
    return {
        name if single else f"{effect}: {name}": own
        for effect, parameters in found.items()
        for name, own in parameters.items()
    }
