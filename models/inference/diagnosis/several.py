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
5. If one effect is named, a second one is looked for beside it, under the α that suits the first.

Effects of an object have separate parameters in each dataset; for a whole locked object they are free.

`fit_together` asks about given effects in the same way, and learns a belief of each object. What the other
datasets tell about a shared parameter is the prior of this object's own fit; the parameter may differ from
dataset to dataset by as much as the datasets disagree.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from slipmap.models.blas import one_blas_thread
from slipmap.models.effects.effect import Effect, Owner, bounds
from slipmap.models.effects.library import LIBRARY
from slipmap.models.effects.registry import candidates_given, effects_given
from slipmap.models.inference.diagnosis.joint_answer import answer_about, joint_answer, objection_to
from slipmap.models.inference.diagnosis.locked import CLEARLY, Ground, JudgedFit, LockedErrors, with_locked
from slipmap.models.inference.diagnosis.outcomes import doubts_of_check, wrong_sizes
from slipmap.models.inference.diagnosis.results import (
    DatasetResult,
    JointCandidate,
    JointDiagnosis,
    JointIdentification,
    ParameterEstimate,
    estimated,
)
from slipmap.models.inference.diagnosis.verdict_rules import far_above_noise
from slipmap.models.inference.identification import check_request, learn
from slipmap.models.inference.mixture import EffectsGiven
from slipmap.models.inference.observations import observe_all
from slipmap.models.inference.results import holds_null
from slipmap.models.inference.together import FirstGain, JointFit, Together, alone, between, is_shared
from slipmap.models.measurements import DatasetError, PushDataset
from slipmap.models.measurements.push_dataset import check_datasets_given, check_distinct
from slipmap.models.measurements.trial_checks import fault_of_frame
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import RolloutError
from slipmap.models.progress import Progress, StageProgress, about, part_of, silent
from slipmap.models.settings import check_whole

_REFITTED = 8
"""Number of effects that are refitted in full."""

EVIDENCE = 5.0
"""Evidence, in nats, above which an effect counts: 150 to 1."""

_ALONE, _AHEAD = 20.0, 0.8
"""The same for a single dataset, and the largest share of it that the next effect may reach."""

_RIVAL = CLEARLY
"""Nats by which a rival may be behind."""

_SECONDS = 4
"""Number of second effects that are refitted beside a first."""

_JUDGED = 3
"""Most effects that the locked pushes judge."""

_WHOLE_FROM = 4
"""One dataset in this many is locked away as a whole."""


@one_blas_thread()
def diagnose_together(
    datasets: Sequence[PushDataset],
    *,
    effects: Sequence[Effect | str] = LIBRARY,
    apart: Collection[str] = (),
    draws: int = 199,
    seed: int = 0,
    progress: Progress | None = None,
) -> JointDiagnosis:
    """Find out which physical effect several datasets lack together.

    Args:
        datasets: two or more, each of one object.
        effects: candidates; those of the library may be given by name.
        apart: owners of effects that the datasets do not share, out of `object`, `table`, `tracker`,
            `finger`, `force sensor`; the object is never shared.
        draws: random signs of whole pushes for the p-values; with 0 there are none.
        seed: of the draws and of the choice of locked pushes.

    Raises:
        DatasetError: fewer than two datasets, two with the same name or the same push, or one without a push
            left to fit.
        RolloutError: a model cannot be computed.
        ValueError: an unknown owner in `apart`; draws or a seed that are no whole number.

    Example:
        >>> import dataclasses
        >>> import slipmap
        >>> from slipmap.models.inference.diagnosis.several import diagnose_together
        >>> first, again = (slipmap.simulated_hammer(seed=s, fit=3, heldout=2)[0] for s in (1, 2))
        >>> again = dataclasses.replace(again, name="again")
        >>> tilt = slipmap.effects_named(["table_tilt"])
        >>> diagnose_together([first, again], effects=tilt).effects
        ()
    """
    check_together(datasets, apart)
    check_whole("draws", draws, 0)
    check_whole("seed", seed, 0)
    started = time.perf_counter()
    inquiry = _Inquiry(datasets, candidates_given(effects), frozenset(apart), seed, progress or silent)
    return replace(inquiry.run(draws), seconds=time.perf_counter() - started)


@one_blas_thread()
def fit_together(
    datasets: Sequence[PushDataset],
    effects: Sequence[Effect | str],
    *,
    apart: Collection[str] = (),
    hypotheses: int = 20,
    seed: int = 0,
    progress: Progress | None = None,
) -> JointIdentification:
    """Learn the maps of several objects, each from its own dataset, with effects that they share.

    Pushes are locked away, and the effects fitted and judged, as by `diagnose_together` with the same seed.

    Args:
        datasets, apart, progress: as in `diagnose_together`.
        effects: of the model; those of the library may be given by name.
        hypotheses: of each belief, at least 2.

    Raises:
        DatasetError: as in `diagnose_together`, or the model with the effects cannot be fitted.
        RolloutError: another model cannot be computed.
        ValueError: an unknown owner in `apart`, no effect, or too few hypotheses.
        EffectError: an unknown effect, or a formula that cannot be used.

    Example:
        >>> import dataclasses
        >>> import slipmap
        >>> from slipmap.models.inference.diagnosis.several import fit_together
        >>> first, again = (slipmap.simulated_hammer(seed=s, fit=2, heldout=1)[0] for s in (1, 2))
        >>> again = dataclasses.replace(again, name="again")
        >>> found = fit_together([first, again], ["table_tilt"], hypotheses=2)
        >>> [one.belief.dataset for one in found.learned]
        ['hammer', 'again']
    """
    check_together(datasets, apart)
    added = effects_given(effects)
    if not added:
        raise ValueError("name at least one effect to add to the model")
    for dataset in datasets:
        check_request(dataset, hypotheses, seed)
    started = time.perf_counter()
    inquiry = _Inquiry(datasets, added, frozenset(apart), seed, progress or silent)
    return replace(inquiry.learned_with_all(hypotheses), seconds=time.perf_counter() - started)


def check_together(datasets: Sequence[PushDataset], apart: Collection[str]) -> None:
    """Refuse datasets that cannot be taken together, and unknown owners of effects.

    Raises:
        DatasetError: fewer than two datasets, or two with the same name or the same push.
        TypeError: something other than datasets.
        ValueError: an unknown owner.
    """
    check_datasets_given(datasets)
    strangers = [owner for owner in apart if owner not in get_args(Owner)]
    if strangers:
        raise ValueError(f"apart: unknown owner {strangers[0]!r}; choose from {', '.join(get_args(Owner))}")
    names = [dataset.name for dataset in datasets]
    if len(datasets) < 2 or len(set(names)) < len(names):
        (name, uses), *_ = Counter(names).most_common(1) or [("none", 0)]
        same = f"; change `name` in the dataset.yaml of one of those called {name}" if uses > 1 else ""
        raise DatasetError(
            "taken together are two or more datasets with different names, got"
            f" {', '.join(names) or 'none'}{same}"
        )
    check_distinct(datasets)


def named_by_evidence(
    dataset: PushDataset, effects: Sequence[Effect], seed: int, progress: StageProgress
) -> tuple[Effect, ...]:
    """The effects that one dataset names by evidence and locked pushes, under the forgiving likelihood.

    Where pushes are missed by many times the noise, a few of them decide a strict fit. A single effect must
    have the largest evidence, far ahead of the next and beyond what errors of the grid and contact can mimic;
    of two, so must the second with the first in the model.

    Args:
        dataset: with the locked pushes held out.
        seed: of the predictions.

    Returns:
        One effect, or two, the first first; empty if none is named.
    """
    inquiry = _Inquiry([dataset], tuple(effects), frozenset(), seed, lambda _, *parts: progress(*parts))
    found = inquiry.run(0)
    evidence = {one.name: one.evidence for one in found.candidates if one.evidence is not None}
    if not found.together and (found.effect is None or found.effect != _far_ahead(evidence)):
        return ()
    return tuple(next(effect for effect in effects if effect.name == name) for name in found.effects)


def _far_ahead(evidence: Mapping[str, float]) -> str | None:
    """The name of the largest evidence, if that suffices alone and is far ahead of the next."""
    first, *others = sorted(evidence, key=lambda name: -evidence[name])
    least = max([_ALONE, *(evidence[name] / _AHEAD for name in others)])
    return first if evidence[first] >= least else None


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
        self.datasets, self.effects, self.apart = datasets, effects, apart
        self.seed, self.report = seed, report
        self.rng = rng = np.random.default_rng(seed)
        count = len(datasets)
        whole = rng.choice(count, count // _WHOLE_FROM, replace=False)
        stage = partial(report, "fitting without effects")
        self.grounds = [
            Ground.of(dataset, k in whole, rng, part_of(stage, k, count))
            for k, dataset in enumerate(datasets)
        ]
        self.asked = [ground for ground in self.grounds if not ground.whole]
        self.together = Together([ground.taught for ground in self.asked], apart)
        # Effects that gain much beside a first one, but alike, by the name of the first.
        self.alike_beside: dict[str, list[str]] = {}
        self.found_alone: dict[tuple[JointFit, int], tuple[FloatArray, FloatArray]] = {}
        self.before = [g.judged(g.taught.prior, g.taught.base.z[0], seed) for g in self.grounds]
        self.faults: dict[str, str] = {}  # in the records, which no effect explains, by dataset
        for dataset, before in zip(datasets, self.before, strict=True):
            if before is None or far_above_noise(before[0].misfit) is not None:
                fault = fault_of_frame(dataset, dataset.trials)
                self.faults |= {} if fault is None else {dataset.name: fault}

    def run(self, draws: int) -> JointDiagnosis:
        """Go through the steps; `seconds` stays 0."""
        stage = partial(self.report, "screening effects")
        first = self.together.first_gains(self.effects, stage, draws, self.rng)
        base = self.together.fitted((), ())
        fits: dict[str, JointFit] = {}
        evidence: dict[str, float] = {}
        objections: dict[str, str] = {}
        for step, one in enumerate(first[:_REFITTED]):
            self.report("refitting with effects", step, _REFITTED)
            try:
                fit = self.together.fitted((one.effect,), (one.start,))
            except (RolloutError, np.linalg.LinAlgError):
                objections[one.effect.name] = "not refitted"
                continue
            fits[one.effect.name] = fit
            evidence[one.effect.name] = fit.evidence(base)
        self.report("refitting with effects", _REFITTED, _REFITTED)
        ahead = sorted(evidence, key=lambda name: -evidence[name])
        asked = [name for name in ahead if evidence[name] > EVIDENCE][:_JUDGED]
        if self.faults:
            objections |= dict.fromkeys(asked, "the records contradict themselves")
            asked = []
        stage = partial(self.report, "judging by locked pushes")
        judged: list[JudgedFit] = []
        for step, name in enumerate(asked):
            try:
                judged.append(self._judge(fits[name], evidence[name], part_of(stage, step, len(asked))))
            except (RolloutError, np.linalg.LinAlgError):
                objections[name] = "not refitted"
        there = [one for one in judged if one.is_supported and self._there(one)]
        best = max((one.score for one in there), default=0.0)
        kept = sorted((one for one in there if one.score > best - _RIVAL), key=lambda one: -one.score)
        objections |= {one.name: objection_to(one) for one in judged if one not in there}
        if there and any(one.score > best + _RIVAL for one in judged if one not in there):
            kept = []
        together, answer = self.together, fits[kept[0].name] if kept else base
        # A first that the locked pushes object to may be right with a second, if nothing else is missing.
        leader = (kept or sorted(judged, key=lambda one: -one.score))[0] if len(kept) < 2 and judged else None
        both = None if leader is None else self._with_second(leader, objections)
        if leader is not None and both is not None:
            objection = self._objection_to_second(leader, both, stands=bool(kept))
            if objection is None:
                kept, together, answer = [both], self.together.around(both.fit), both.fit
            else:
                objections[both.fit.effects[-1].name] = objection
        named = [effect.name for one in kept for effect in one.fit.effects]
        remaining = {}
        if draws:
            starts = {one.effect: one.start for one in first}
            with suppress(RolloutError, np.linalg.LinAlgError):
                remaining = together.remaining(self.effects, [starts[e] for e in self.effects], answer)

        def place(one: FirstGain) -> tuple[bool, float]:
            name = one.effect.name
            return name not in named, -evidence.get(name, one.evidence - 1e6)

        candidates = tuple(
            JointCandidate(
                one.effect.name,
                one.gain,
                one.p_value,
                base.cost - fits[one.effect.name].cost if one.effect.name in fits else None,
                evidence.get(one.effect.name),
                one.effect.name in named,
                None if one.effect.name in named else objections.get(one.effect.name),
                tuple(
                    ParameterEstimate(one.effect.name, p.name, p.unit, *remaining[one.effect.name, p.name])
                    for p in one.effect.parameters
                    if (one.effect.name, p.name) in remaining and one.effect.name not in named
                ),
            )
            for one in sorted(first, key=place)
        )
        return self._answer(kept, judged, candidates)

    def _with_second(self, first: JudgedFit, objections: dict[str, str]) -> JudgedFit | None:
        """The model with the effect whose evidence beside a first one is large and far ahead of the next,
        judged by the locked pushes; None where there is none, with an objection to each of several.

        It is looked for under the α that suits the first, since the one without effects hides what is small
        beside it.
        """
        around, values = self.together.around(first.fit), first.fit.by_effect(0)
        others = [effect for effect in self.effects if effect not in first.fit.effects]
        stage = partial(self.report, "trying a second effect")
        try:
            on_top = around.first_gains(others, part_of(stage, 0, 2), beside=first.fit) if others else []
            asked = [one for one in on_top if one.evidence > EVIDENCE][:_SECONDS]
            if not asked:
                stage(1, 1)
                return None
            single = around.fitted(first.fit.effects, values)
        except (RolloutError, np.linalg.LinAlgError):
            return None
        pairs: dict[str, JointFit] = {}
        for step, one in enumerate(asked):
            part_of(stage, 1, 2)(step, len(asked))
            with suppress(RolloutError, np.linalg.LinAlgError):
                effects = (*first.fit.effects, one.effect)
                pairs[one.effect.name] = around.fitted(effects, [*values, one.start])
        stage(1, 1)
        evidence = {name: pair.evidence(single) for name, pair in pairs.items()}
        second = _far_ahead(evidence) if evidence else None
        if second is None:
            least = max(_ALONE, _AHEAD * max(evidence.values(), default=0.0))
            close = [name for name, gain in evidence.items() if gain > least]
            self.alike_beside[first.name] = close
            for name in close:
                rivals = ", ".join(rival for rival in close if rival != name)
                objections[name] = f"gains much beside {first.name}, but so would {rivals}"
            return None
        with suppress(RolloutError, np.linalg.LinAlgError):
            return self._judge(pairs[second], evidence[second], partial(self.report, "judging both"))
        return None

    def _objection_to_second(self, first: JudgedFit, both: JudgedFit, *, stands: bool) -> str | None:
        """What speaks against a second effect beside a first one; None where both are needed.

        Args:
            first, both: the models that the locked pushes have judged.
            stands: whether the first does alone; otherwise both must come near the noise.
        """
        against = None
        if not (both.is_supported and self._there(both)):
            against = objection_to(both)
        elif not both.is_better_than(first, _RIVAL):
            against = f"the locked pushes are not clearly predicted better with both than with {first.name}"
        elif not stands and far_above_noise(both.misfits) is not None:
            against = "the locked pushes are far off with both"
        return against and f"gains much beside {first.name}, but {against}"

    def learned_with_all(self, hypotheses: int) -> JointIdentification:
        """Fit all effects at once, judge them, and learn a belief of each object; `seconds` stays 0.

        Raises:
            DatasetError: the model with the effects cannot be fitted.
        """
        names = " and ".join(effect.name for effect in self.effects)
        base = self.together.fitted((), ())
        try:
            fit = self._one_by_one(self.effects)
            # Evidence is counted under the α without effects, as in the diagnosis of a single one.
            single = len(fit.effects) == 1
            counted = fit if single else self.together.fitted(fit.effects, fit.by_effect(0))
            evidence = counted.evidence(base)
            judged = self._judge(fit, evidence, partial(self.report, "judging by locked pushes"))
        except (RolloutError, np.linalg.LinAlgError) as error:
            raise DatasetError(
                f"the model with {names} cannot be fitted to these datasets: {error}"
            ) from error
        verdict, sentence = answer_about(judged, evidence > EVIDENCE, self._there(judged), self.faults)
        learned = []
        for k, ground in enumerate(self.grounds):
            values, scales = self._told_by_others(judged.fit, k)
            found = EffectsGiven(self.effects, values, scales, judged.held[k])
            dataset = with_locked(self.datasets[k], [o.trial for o in ground.locked])
            own = about(dataset.name, self.report)
            everything = observe_all(dataset)
            learned.append(
                learn(dataset, everything, found, hypotheses=hypotheses, seed=self.seed, report=own)
            )
        return JointIdentification(
            verdict, sentence, tuple(effect.name for effect in self.effects), self._estimates(judged),
            evidence, judged.fall, self._by_dataset(judged), tuple(learned), 0.0, self.seed,
        )  # fmt: skip

    def _one_by_one(self, effects: Sequence[Effect]) -> JointFit:
        """The model with some effects, each of which starts where it gains most beside those before it.

        Raises:
            RolloutError: it cannot be computed.
        """
        stage = partial(self.report, "refitting with effects")
        first, *others = effects
        (best,) = self.together.first_gains([first], part_of(stage, 0, len(effects)))
        fit = self.together.fitted([first], [best.start])
        for step, effect in enumerate(others, 1):
            before = self.together.refined(fit, part_of(stage, step, len(effects)))
            around = self.together.around(before)
            (best,) = around.first_gains([effect], lambda done, total: None, beside=before)
            fit = around.fitted((*before.effects, effect), [*before.by_effect(0), best.start])
        stage(1, 1)
        return fit

    def _place(self, k: int) -> int | None:
        """Place of dataset k among those that teach effects; None for a whole locked object."""
        ground = self.grounds[k]
        return None if ground.whole else self.asked.index(ground)

    def _shared(self, effects: Sequence[Effect]) -> NDArray[np.bool_]:
        """(P,) whether the datasets share each parameter of some effects."""
        return np.concatenate([np.full(len(e.parameters), is_shared(e, self.apart)) for e in effects])

    def _told_by_others(self, fit: JointFit, k: int) -> tuple[FloatArray, FloatArray]:
        """Values (P,) and standard deviations of the effects' parameters to expect in dataset k, before its
        own pushes are seen: from the other datasets, for parameters that they share."""
        place, values = self._place(k), self._values(fit, k)
        scales = np.array(fit.scales)
        centers = np.concatenate([effect.nulls for effect in fit.effects])
        each = [self._alone(fit, j) for j in range(len(self.asked))]
        amplitudes = np.concatenate([effect.amplitudes for effect in fit.effects])
        for i in np.flatnonzero(self._shared(fit.effects)):
            if not amplitudes[i]:
                scales[i] = fit.deviations(0)[i]
                continue
            own, widths = (np.array([one[part][i] for one in each]) for part in (0, 1))
            scatter = between(own, widths)
            weights = 1.0 / (widths**2 + scatter)
            if place is not None:
                weights[place] = 0.0
            precision = float(weights.sum()) + scales[i] ** -2
            values[i] = (float(weights @ own) + centers[i] * scales[i] ** -2) / precision
            scales[i] = np.sqrt(1.0 / precision + scatter)
        return np.clip(values, *bounds(fit.effects)), scales

    def _values(self, fit: JointFit, k: int) -> FloatArray:
        """(P,) parameters in dataset k; those of a whole locked object's own effects are at their nulls."""
        place = self._place(k)
        if place is not None:
            return fit.values(place)
        nulls = np.concatenate([effect.nulls for effect in fit.effects])
        return np.where(self._shared(fit.effects), fit.values(0), nulls)

    def _judge(self, fit: JointFit, evidence: float, progress: StageProgress) -> JudgedFit:
        """Errors on the locked pushes, with every object's maps refitted and the effects held.

        Effects are looked for under the α of the model without them; judged and reported is the refined fit.
        """
        fit = self.together.refined(fit, part_of(progress, 0, 2))
        after: list[LockedErrors | None] = []
        falls, held = [], []
        for k, ground in enumerate(self.grounds):
            free = ~self._shared(fit.effects) & ground.whole
            stage = part_of(part_of(progress, 1, 2), k, len(self.grounds))
            prior, z = ground.taught.holding(fit.effects, self._values(fit, k), free, stage)
            before, now = self.before[k], ground.judged(prior, z, self.seed)
            after.append(None if now is None else now[0])
            falls.append(0.0 if before is None or now is None else float((before[1] - now[1]).sum()))
            held.append(prior.maps(z[None]))
        names = tuple(ground.taught.dataset.name for ground in self.grounds)
        shared = bool(self._shared(fit.effects).all())
        return JudgedFit(fit, after, falls, held, evidence + sum(falls), names, shared)

    def _there(self, one: JudgedFit) -> bool:
        """Whether the interval of an amplitude of each effect excludes its null; True for an effect that is
        not shared."""
        told: dict[str, dict[str, dict[str, float]]] = {}
        for own in self._estimates(one):
            told.setdefault(own.effect, {})[own.name] = {"low": own.low, "high": own.high}
        shared = [effect for effect in one.fit.effects if is_shared(effect, self.apart)]
        return not any(holds_null(effect, told[effect.name]) for effect in shared)

    def _estimates(self, one: JudgedFit) -> tuple[ParameterEstimate, ...]:
        """Shared parameters with 90 % intervals, widened where the datasets disagree beyond their errors.

        Around values that the prior pulled far, the joint fit seems to know a parameter better than its
        datasets do: its precision is at most that of the prior and of each dataset alone together.
        """
        values, deviations = one.fit.values(0), one.fit.deviations(0)
        shared = self._shared(one.fit.effects)
        apart = [self._alone(one.fit, k) for k in range(len(self.asked))]
        amplitudes = np.concatenate([effect.amplitudes for effect in one.fit.effects])
        for i in np.flatnonzero(amplitudes):
            own, widths = (np.array([each[part][i] for each in apart]) for part in (0, 1))
            known = (widths**-2.0).sum() + one.fit.scales[i] ** -2
            deviations[i] = np.sqrt(max(deviations[i] ** 2, 1.0 / known) + between(own, widths) / len(apart))
        every = estimated(one.fit.effects, values, deviations)
        return tuple(estimate for estimate, own in zip(every, shared, strict=True) if own)

    def _alone(self, fit: JointFit, place: int) -> tuple[FloatArray, FloatArray]:
        """Parameters (P,) from one of the datasets that teach effects, and their standard deviations."""
        if (fit, place) not in self.found_alone:
            self.found_alone[fit, place] = alone(fit, place)
        return self.found_alone[fit, place]

    def _by_dataset(self, best: JudgedFit | None) -> tuple[DatasetResult, ...]:
        """Each dataset with and without the effects of a model."""
        results = []
        for k, ground in enumerate(self.grounds):
            place, before = self._place(k), self.before[k]
            by_itself: tuple[ParameterEstimate, ...] = ()
            if best is not None and place is not None:
                by_itself = estimated(best.fit.effects, *self._alone(best.fit, place))
            results.append(
                DatasetResult(
                    ground.taught.dataset.name,
                    tuple(o.trial for o in ground.taught.observations),
                    tuple(o.trial for o in ground.locked),
                    ground.whole,
                    None if before is None else before[0],
                    None if best is None else best.after[k],
                    None if best is None or before is None else best.falls[k],
                    by_itself,
                )
            )
        return tuple(results)

    def _answer(
        self, kept: Sequence[JudgedFit], judged: Sequence[JudgedFit], candidates: tuple[JointCandidate, ...]
    ) -> JointDiagnosis:
        best = kept[0] if kept else None
        beside = [] if best is None else self.alike_beside.get(best.name, [])
        answer = joint_answer(kept, judged, [one and one[0] for one in self.before], beside, self.faults)
        leading = kept[:1] or judged[:1]
        sized, first = wrong_sizes([e.name for one in leading for e in one.fit.effects], self.datasets)
        shared = best is not None and is_shared(best.fit.effects[0], self.apart)
        return JointDiagnosis(
            answer.verdict, " ".join([answer.sentence, *sized]), answer.effects, shared,
            tuple(p for one in kept for p in self._estimates(one)), candidates,
            min((c.p_value for c in candidates if c.p_value is not None), default=None),
            self._by_dataset(best), None if best is None else best.fall,
            {} if answer.verdict == "adequate" else {d.name: doubts_of_check(d) for d in self.datasets},
            0.0, self.seed, answer.together, tuple(sorted(self.apart)),
            leading[0].fit.effects[0].belongs_to if leading else None, tuple(first),
        )  # fmt: skip
