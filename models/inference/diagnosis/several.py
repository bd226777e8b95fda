"""Find the effect that several datasets lack together: objects with their own maps on one table, seen by one
tracker.

1. Some pushes of each dataset are locked away; with four datasets or more, so is one whole object in four.
2. The model without effects is fitted to each dataset, and every effect is added to first order with all maps
   refitted. The most promising effects are refitted in full.
3. Evidence for an effect is the drop in cost less what its parameters, free within their scales, would gain
   anyway (Laplace). Effects whose evidence is close to the best are rivals.
4. The locked pushes judge each rival, with the maps of every object refitted and the shared parameters held.
   Their cost must drop in total and in most datasets. A rival that falls behind on open and locked pushes
   together is out. If a rival that fails on the locked pushes is still far ahead, nothing is named.

Effects of an object have separate parameters in each dataset; for a whole locked object they are free.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, get_args

import numpy as np

from slipmap.models.effects.effect import Effect, Owner, bounds
from slipmap.models.effects.library import LIBRARY
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.diagnosis.locked import LockedErrors, locked_trials
from slipmap.models.inference.diagnosis.results import ParameterEstimate
from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.inference.observations import Observation, observe_all
from slipmap.models.inference.prediction import predicted_motion
from slipmap.models.inference.prior import MapPrior
from slipmap.models.inference.push_errors import errors
from slipmap.models.inference.together import JointFit, Taught, Together, is_shared
from slipmap.models.measurements import DatasetError, PushDataset
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import RolloutError
from slipmap.models.progress import Progress, StageProgress, part_of, silent

_REFITTED = 8
"""Number of effects that are refitted in full."""

_EVIDENCE = 5.0
"""Evidence, in nats, above which an effect counts: 150 to 1."""

_ALONE, _AHEAD = 20.0, 0.8
"""The same for a single dataset, and the largest share of it that the next effect may reach."""

_RIVAL = 3.0
"""Nats by which a rival may be behind, and by which the cost of the locked pushes must drop: 20 to 1."""

_JUDGED = 3
"""Most effects that the locked pushes judge."""

_WHOLE_FROM = 4
"""One dataset in this many is locked away as a whole."""

_NEAR_NOISE = 2.0
"""Root-mean-square misfit of locked pushes, in units of sensor noise, that needs no explanation."""


@dataclass(frozen=True, eq=False)
class JointCandidate:
    """What several datasets say about one effect."""

    name: str
    first_gain: float  # drop in cost to first order, nats
    gain: float | None  # the same after a full refit; None without one
    evidence: float | None  # the same less what its parameters would gain anyway
    in_set: bool  # whether the data cannot rule it out
    objection: str | None  # what speaks against an effect that the locked pushes have judged


@dataclass(frozen=True, eq=False)
class DatasetResult:
    """One dataset of several."""

    name: str
    open_trials: tuple[str, ...]  # pushes that were fitted
    locked: tuple[str, ...]  # pushes that judge
    whole: bool  # whether the whole object was locked away: its open pushes taught only its maps
    before: LockedErrors | None  # without effects; None where nothing was locked
    after: LockedErrors | None  # with the best effect; None where there is none
    fall: float | None  # drop in cost of its locked pushes with the best effect, nats
    # the best effect's parameters from this dataset alone, to first order; empty for a whole locked object
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
    effects: tuple[str, ...]  # what the data cannot rule out, best first
    shared: bool  # whether the datasets have one set of the best effect's parameters
    parameters: tuple[ParameterEstimate, ...]  # shared parameters of the effects, each effect fitted alone
    candidates: tuple[JointCandidate, ...]  # best first
    datasets: tuple[DatasetResult, ...]
    fall: float | None  # drop in cost of all locked pushes with the best effect, nats
    seconds: float
    seed: int

    @property
    def effect(self) -> str | None:
        """The one effect that is named."""
        return self.effects[0] if self.verdict == "effect" else None

    def next_step(self) -> str:
        """What to do next, with the command to type."""
        if self.effect is not None:
            return f"for each dataset, run `slipmap fit DATASET --effect {self.effect}` to learn this model."
        if self.verdict == "adequate":
            return (
                "for each dataset, run `slipmap identify DATASET -o belief.npz` to learn the model to plan"
                " with."
            )
        return (
            "run `slipmap diagnose DATASET` for each dataset, since a joint diagnosis misses what only one of"
            " them has; or name with --apart what they do not share."
        )

    def to_json(self) -> dict[str, Any]:
        """The machine-readable result."""
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "next_step": self.next_step(),
            "effect": self.effect,
            "effects": list(self.effects),
            "shared": self.shared,
            "parameters": {
                name: _by_name([p for p in self.parameters if p.effect == name])
                for name in dict.fromkeys(p.effect for p in self.parameters)
            },
            "candidates": [vars(candidate) for candidate in self.candidates],
            "datasets": [one.to_json() for one in self.datasets],
            "fall": self.fall,
            "seconds": self.seconds,
            "seed": self.seed,
        }


def _by_name(estimates: Sequence[ParameterEstimate]) -> dict[str, dict[str, Any]]:
    return {p.name: {"value": p.value, "low": p.low, "high": p.high, "unit": p.unit} for p in estimates}


def diagnose_together(
    datasets: Sequence[PushDataset],
    *,
    effects: Sequence[Effect] = LIBRARY,
    apart: Collection[str] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> JointDiagnosis:
    """Find out which physical effect several datasets lack together.

    Args:
        datasets: two or more, each of one object.
        effects: candidates.
        apart: owners of effects that the datasets do not share, out of `object`, `table`, `tracker`,
            `finger`, `force sensor`; the object is never shared.
        seed: of the draw of locked pushes.
        progress: called with (stage, done, total).

    Raises:
        DatasetError: fewer than two datasets, two with the same name, or one without a push left to fit.
        ValueError: an unknown owner in `apart`.

    Example:
        >>> import dataclasses
        >>> import slipmap
        >>> first, again = (slipmap.simulated_hammer(seed=s, fit=3, heldout=2)[0] for s in (1, 2))
        >>> again = dataclasses.replace(again, name="again")
        >>> tilt = slipmap.effects_named(["table_tilt"])
        >>> slipmap.diagnose_together([first, again], effects=tilt).effects
        ()
    """
    strangers = [owner for owner in apart if owner not in get_args(Owner)]
    if strangers:
        raise ValueError(f"apart: unknown owner {strangers[0]!r}; choose from {', '.join(get_args(Owner))}")
    names = [dataset.name for dataset in datasets]
    if len(datasets) < 2 or len(set(names)) < len(names):
        raise DatasetError(
            "a joint diagnosis needs two or more datasets with different names, got"
            f" {', '.join(names) or 'none'}"
        )
    started = time.perf_counter()
    inquiry = _Inquiry(datasets, tuple(effects), frozenset(apart), seed, progress or silent)
    return replace(inquiry.run(), seconds=time.perf_counter() - started)


def named_by_evidence(
    dataset: PushDataset, effects: Sequence[Effect], seed: int, progress: StageProgress
) -> Effect | None:
    """The effect that one dataset names by evidence and locked pushes, under the forgiving likelihood.

    Where pushes are missed by many times the noise, a few of them decide a strict fit. The effect must have
    the largest evidence, far ahead of the next and beyond what errors of the grid and contact can mimic.

    Args:
        dataset: with the locked pushes held out.
        effects: candidates.
        seed: of the predictions.
        progress: called with the numbers of parts done and of all parts.
    """
    inquiry = _Inquiry([dataset], tuple(effects), frozenset(), seed, lambda _, *parts: progress(*parts))
    found = inquiry.run()
    evidence = {one.name: one.evidence for one in found.candidates if one.evidence is not None}
    if found.effect is None:
        return None
    first, *others = sorted(evidence, key=lambda name: -evidence[name])
    least = max([_ALONE, *(evidence[name] / _AHEAD for name in others)])
    if found.effect != first or evidence[first] < least:
        return None
    return next(effect for effect in effects if effect.name == first)


@dataclass(frozen=True, eq=False)
class _Ground:
    """One dataset, fitted without effects, with its locked pushes."""

    taught: Taught
    locked: Sequence[Observation]
    whole: bool

    def judged(self, prior: MapPrior, z: FloatArray, seed: int) -> tuple[LockedErrors, FloatArray] | None:
        """Errors and costs (L,) of the locked pushes at coordinates z (d,); None without locked pushes."""
        if not self.locked:
            return None
        dataset, slider = self.taught.dataset, prior.slider
        belief = Belief.learned(
            dataset, slider, prior.maps(z[None]), np.ones(1), method="gauss-newton", seed=seed,
            trials=[o.trial for o in self.taught.observations], settings={},
        )  # fmt: skip
        noise = sensor_noise(dataset)
        found = [
            errors(o, motion.middle_poses, motion.mean_forces, dataset.grid, noise)
            for o, motion in zip(self.locked, predicted_motion(belief, self.locked), strict=True)
        ]
        names = ("mean_add", "final_add", "misfit")
        rows = (np.array([getattr(one, name) for one in found]) for name in names)
        return LockedErrors(*rows), self.taught.costs(self.locked, prior, z)


@dataclass(frozen=True, eq=False)
class _Judged:
    """A rival that the locked pushes have judged."""

    effect: Effect
    fit: JointFit
    after: list[LockedErrors | None]  # of each dataset
    falls: list[float]  # drop in cost of each dataset's locked pushes, nats
    score: float  # evidence from the open pushes plus drop in cost of the locked ones, nats

    @property
    def fall(self) -> float:
        """Drop in cost of all locked pushes, nats."""
        return sum(self.falls)

    @property
    def falls_in_most(self) -> bool:
        """Whether the cost drops in more than half of the datasets that have locked pushes."""
        judging = [fall for fall, now in zip(self.falls, self.after, strict=True) if now is not None]
        return sum(fall > 0.0 for fall in judging) > len(judging) / 2


class _Inquiry:
    """The steps of one diagnosis."""

    def __init__(
        self,
        datasets: Sequence[PushDataset],
        effects: tuple[Effect, ...],
        apart: frozenset[str],
        seed: int,
        report: Progress,
    ) -> None:
        self.effects, self.apart, self.seed, self.report = effects, apart, seed, report
        rng = np.random.default_rng(seed)
        count = len(datasets)
        whole = rng.choice(count, count // _WHOLE_FROM, replace=False)
        stage = partial(report, "fitting without effects")
        self.grounds = [
            _ground(dataset, k in whole, rng, part_of(stage, k, count)) for k, dataset in enumerate(datasets)
        ]
        self.asked = [ground for ground in self.grounds if not ground.whole]
        self.together = Together([ground.taught for ground in self.asked], apart)
        self.before = [g.judged(g.taught.prior, g.taught.base.z[0], seed) for g in self.grounds]

    def run(self) -> JointDiagnosis:
        """Go through the steps; `seconds` stays 0."""
        first = self.together.first_gains(self.effects, partial(self.report, "screening effects"))
        base = self.together.fitted((), ())
        fits: dict[str, JointFit] = {}
        evidence: dict[str, float] = {}
        for step, one in enumerate(first[:_REFITTED]):
            self.report("refitting with effects", step, _REFITTED)
            try:
                fit = self.together.fitted((one.effect,), (one.start,))
            except (RolloutError, np.linalg.LinAlgError):
                continue
            fits[one.effect.name] = fit
            evidence[one.effect.name] = base.cost - fit.cost - (fit.occam - base.occam)
        self.report("refitting with effects", _REFITTED, _REFITTED)
        ahead = [name for name in sorted(evidence, key=lambda name: -evidence[name])]
        asked = [name for name in ahead if evidence[name] > _EVIDENCE][:_JUDGED]
        stage = partial(self.report, "judging by locked pushes")
        judged = [
            self._judge(fits[name], evidence[name], part_of(stage, step, len(asked)))
            for step, name in enumerate(asked)
        ]
        there = [one for one in judged if one.falls_in_most and one.fall > _RIVAL and self._there(one)]
        best = max((one.score for one in there), default=0.0)
        kept = sorted((one for one in there if one.score > best - _RIVAL), key=lambda one: -one.score)
        objections = {one.effect.name: self._objection(one) for one in judged if one not in there}
        if there and any(one.score > best + _RIVAL for one in judged if one not in there):
            kept = []
        candidates = tuple(
            JointCandidate(
                one.effect.name,
                one.gain,
                base.cost - fits[one.effect.name].cost if one.effect.name in fits else None,
                evidence.get(one.effect.name),
                any(one.effect is rival.effect for rival in kept),
                objections.get(one.effect.name),
            )
            for one in sorted(first, key=lambda one: -evidence.get(one.effect.name, one.gain - 1e6))
        )
        return self._answer(kept, judged, candidates)

    def _judge(self, fit: JointFit, evidence: float, progress: StageProgress) -> _Judged:
        """Errors on the locked pushes, with every object's maps refitted and the effect held."""
        (effect,) = fit.effects
        shared = is_shared(effect, self.apart)
        after: list[LockedErrors | None] = []
        falls, asked = [], 0
        for k, ground in enumerate(self.grounds):
            own = ground.whole and not shared
            values = effect.nulls if own else fit.values(0 if ground.whole else asked)
            stage = part_of(progress, k, len(self.grounds))
            free = np.full(len(values), own)
            prior, z = ground.taught.holding((effect,), values, free, stage)
            before, now = self.before[k], ground.judged(prior, z, self.seed)
            after.append(None if now is None else now[0])
            falls.append(0.0 if before is None or now is None else float((before[1] - now[1]).sum()))
            asked += not ground.whole
        return _Judged(effect, fit, after, falls, evidence + sum(falls))

    def _objection(self, one: _Judged) -> str:
        """Why the locked pushes or its interval speak against an effect."""
        if one.fall <= _RIVAL:
            return "the locked pushes are not clearly predicted better with it"
        if not one.falls_in_most:
            names = [g.taught.dataset.name for g in self.grounds]
            worse = [
                name
                for name, fall, now in zip(names, one.falls, one.after, strict=True)
                if now is not None and fall <= 0.0
            ]
            return f"the locked pushes of {', '.join(worse)} are predicted worse with it"
        return "its 90 % interval includes the value without the effect"

    def _there(self, one: _Judged) -> bool:
        """Whether the interval of any amplitude excludes its null; True for an effect that is not shared."""
        if not is_shared(one.effect, self.apart):
            return True
        pairs = zip(one.effect.parameters, self._estimates(one), strict=True)
        return any(p.null is not None and not e.low <= p.null <= e.high for p, e in pairs)

    def _estimates(self, one: _Judged) -> tuple[ParameterEstimate, ...]:
        """Shared parameters with 90 % intervals, widened where the datasets disagree beyond their errors."""
        values, deviations = one.fit.values(0), one.fit.deviations(0)
        alone = [one.fit.alone(k) for k in range(len(self.asked))]
        for i in np.flatnonzero(one.effect.amplitudes):
            scatter = _between(np.array([v[i] for v, _ in alone]), np.array([s[i] for _, s in alone]))
            deviations[i] = np.sqrt(deviations[i] ** 2 + scatter / len(alone))
        return _intervals(one.effect, values, deviations)

    def _answer(
        self, kept: Sequence[_Judged], judged: Sequence[_Judged], candidates: tuple[JointCandidate, ...]
    ) -> JointDiagnosis:
        names = tuple(one.effect.name for one in kept)
        best = kept[0] if kept else None
        squares = [one[0].misfit ** 2 for one in self.before if one is not None]
        if len(names) == 1:
            verdict, sentence = "effect", f"The model lacks one effect in these datasets: {names[0]}."
        elif names:
            verdict = "ambiguous"
            sentence = (
                "The model lacks an effect; the datasets cannot tell which of these it is:"
                f" {', '.join(names)}."
            )
        elif judged:
            verdict = "undecided"
            first = max(judged, key=lambda one: one.score)
            sentence = (
                f"{first.effect.name} would explain most, but {self._objection(first)}. No effect is named."
            )
        elif squares and float(np.concatenate(squares).mean()) > _NEAR_NOISE**2:
            verdict = "undecided"
            sentence = (
                "The model error is larger than the sensor noise, but no effect that the datasets could share"
                " explains it."
            )
        else:
            verdict, sentence = "adequate", "The model explains the data; no effect is missing."
        shared = best is not None and is_shared(best.effect, self.apart)
        results, asked = [], 0
        for k, ground in enumerate(self.grounds):
            alone: tuple[ParameterEstimate, ...] = ()
            if best is not None and not ground.whole:
                alone = _intervals(best.effect, *best.fit.alone(asked))
            asked += not ground.whole
            results.append(
                DatasetResult(
                    ground.taught.dataset.name,
                    tuple(o.trial for o in ground.taught.observations),
                    tuple(o.trial for o in ground.locked),
                    ground.whole,
                    None if (before := self.before[k]) is None else before[0],
                    None if best is None else best.after[k],
                    None if best is None or before is None else best.falls[k],
                    alone,
                )
            )
        return JointDiagnosis(
            verdict, sentence, names, shared,
            tuple(p for one in kept if is_shared(one.effect, self.apart) for p in self._estimates(one)),
            candidates, tuple(results),
            None if best is None else best.fall, 0.0, self.seed,
        )  # fmt: skip


def _ground(dataset: PushDataset, whole: bool, rng: np.random.Generator, progress: StageProgress) -> _Ground:
    locked = locked_trials(dataset, rng)
    open_trials = [trial for trial in dataset.trials if trial.name not in locked]
    if not open_trials:
        raise DatasetError(
            f"dataset {dataset.name} has no push left to fit; set the role of at least one push to fit"
        )
    taught = Taught.of(dataset, observe_all(dataset, open_trials), progress)
    judging = [trial for trial in dataset.trials if trial.name in locked]
    return _Ground(taught, observe_all(dataset, judging), whole)


def _between(values: FloatArray, deviations: FloatArray) -> float:
    """Variance of a quantity between datasets in excess of their standard deviations (DerSimonian and Laird,
    1986); 0 for a single dataset."""
    if len(values) < 2:
        return 0.0
    weights = deviations**-2.0
    mean = float(weights @ values / weights.sum())
    excess = float(weights @ (values - mean) ** 2) - (len(values) - 1)
    return max(0.0, excess / float(weights.sum() - (weights**2).sum() / weights.sum()))


def _intervals(effect: Effect, values: FloatArray, spread: FloatArray) -> tuple[ParameterEstimate, ...]:
    """90 % intervals, clipped to the allowed range."""
    allowed = bounds([effect])
    rows = (np.clip(values + side * 1.645 * spread, *allowed).tolist() for side in (0, -1, 1))
    numbers = zip(effect.parameters, *rows, strict=True)
    return tuple(ParameterEstimate(effect.name, p.name, p.unit, *own) for p, *own in numbers)
