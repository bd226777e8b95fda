"""Find the physical effect that the model lacks: the procedure from pushes to verdict.

1. Some pushes are locked away. The model without effects and the error model are fitted to the rest.
2. Every candidate is added to first order, with the maps refitted, and scored on left-out pushes. The
   largest gain is compared with the largest gain by chance. If it is no larger, the model is adequate or the
   data are too few.
3. Candidates are refitted in full, first with long time steps, then under the error model of the best. A gain
   of step 2 that a refit does not find again does not count.
4. Each remaining candidate is screened again: does anything gain on top of it? The true effect leaves nothing
   to gain; an impostor leaves the true one. The candidates that pass are the answer: one, or a set.
5. If none passes, pairs are tried; if no pair passes, the effect is unknown to the library. Pairs are also
   tried where much is left on top of all that pass; the locked pushes then decide between one and two.
6. If nothing is named and the model is far off, a fit that tolerates large errors is tried (`several`). It
   also decides between one effect and two where pushes are missed by far with the one. If the model without
   effects meets the locked pushes to the noise, it is adequate though something gains a little.

`verdict_rules` holds the thresholds, `outcomes` the verdicts.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from slipmap.models.blas import one_blas_thread
from slipmap.models.effects.effect import Effect, EffectError
from slipmap.models.effects.library import LIBRARY
from slipmap.models.effects.probes import PROBES
from slipmap.models.effects.registry import candidates_given
from slipmap.models.inference.diagnosis import outcomes
from slipmap.models.inference.diagnosis.fitting import Fitted, Fitter
from slipmap.models.inference.diagnosis.judging import Learning, judged, laws_beside
from slipmap.models.inference.diagnosis.locked import (
    locked_errors,
    locked_trials,
    open_trials,
    with_locked,
)
from slipmap.models.inference.diagnosis.outcomes import Outcome, with_other_causes
from slipmap.models.inference.diagnosis.refits import Refits, better_base, pairs, refit_candidates
from slipmap.models.inference.diagnosis.results import (
    QUICK_COARSENESS,
    CandidateResult,
    Diagnosis,
    ParameterEstimate,
    estimates_by_effect,
    parameter_estimates,
)
from slipmap.models.inference.diagnosis.screening import Screening, screen
from slipmap.models.inference.diagnosis.several import named_by_evidence
from slipmap.models.inference.diagnosis.verdict_rules import (
    AGREEMENT,
    AT_NOISE,
    CLEARLY_WORSE_GAIN,
    FAR_FROM_FEW,
    FEWEST_DRAWS,
    FEWEST_PUSHES,
    LEVEL,
    PAIR_GAIN,
    PROBE_GAIN,
    REST_GAIN,
    ROUGH,
    UNKNOWN_GAIN,
    Objection,
    Remainder,
    Rules,
    far_above_noise,
    not_outdone,
    typical_misfit,
    with_better_predictors,
    worth_asking,
)
from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.inference.friction_laws import LAW_EFFECTS
from slipmap.models.inference.identification import learn, with_fewer_cells
from slipmap.models.inference.observations import Observation, observe_all, to_learn_from
from slipmap.models.inference.push_errors import repeated_pushes
from slipmap.models.inference.results import Identification
from slipmap.models.measurements import PushDataset
from slipmap.models.measurements.push_dataset import check_dataset_given
from slipmap.models.measurements.trial_checks import fault_of_frame
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import RolloutError
from slipmap.models.progress import Progress, StageProgress, side_by_side, silent
from slipmap.models.settings import check_whole


@one_blas_thread()
def diagnose(
    dataset: PushDataset,
    *,
    effects: Sequence[Effect | str] = LIBRARY,
    draws: int = 199,
    quick: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find out whether the model lacks a physical effect on a dataset, and which.

    Args:
        dataset: measured pushes.
        effects: candidates; those of the library may be given by name.
        draws: simulated datasets for the p-values.
        quick: simulate none and judge gains by a fixed threshold, with fewer pushes and larger steps.
        seed: of every random draw.
        progress: called with (stage, done, total).

    Raises:
        DatasetError: no push is left to fit.
        EffectError: an unknown or no candidate, or one whose formula cannot be used.
        TypeError: something other than a dataset.
        ValueError: too few draws for the level of the test; draws or a seed that are no whole number.
    """
    check_dataset_given(dataset)
    check_whole("seed", seed, 0)
    candidates = candidates_given(effects)
    check_whole("draws", draws, 0)
    if not quick and draws < FEWEST_DRAWS:
        raise ValueError(f"draws must be at least {FEWEST_DRAWS} for p <= {LEVEL}, got {draws}")
    started = time.perf_counter()
    report = progress or silent
    rng = np.random.default_rng(seed)
    report("preparing pushes", 0, 1)
    locked = locked_trials(dataset, rng)
    trials = to_learn_from(open_trials(dataset, locked))
    if quick and len(trials) > 10:
        # A quick diagnosis takes ten pushes, spread evenly.
        kept = np.linspace(0, len(trials) - 1, 10).round().astype(int)
        trials = [trials[b] for b in kept]
    coarseness = QUICK_COARSENESS if quick else 1.0
    observations = observe_all(dataset, trials, coarseness)
    few = with_fewer_cells(dataset)
    divided = with_locked(dataset, locked)
    everything = observe_all(divided)
    report("preparing pushes", 1, 1)

    def inquire() -> tuple[Inquiry, Outcome]:
        inquiry = Inquiry(few, observations, candidates, 0 if quick else draws, rng, report)
        return inquiry, inquiry.run()

    # What `identify` and `fit` learn from the same pushes.
    learning = Learning(partial(learn, divided, everything, seed=seed), report)
    tasks: list[Callable[[], Any]] = [inquire, partial(learning.of, [None], LAW_EFFECTS)]
    (inquiry, outcome), (without,) = side_by_side(tasks)

    judge = partial(judged, inquiry, learning)
    outcome, learned, tried = judge(outcome, [], inquiry.rough)
    by_evidence = cache(partial(inquiry.by_evidence, with_locked(few, locked), seed))
    second = None if quick or not locked else inquiry.second_beside_first(by_evidence)
    if second is not None:
        found, with_it, _ = judge(second, tried, True)
        if found.rivals:
            outcome, learned = found, with_it
        else:
            outcome = replace(outcome, objections={**outcome.objections, **found.objections})
    if not (outcome.rivals or outcome.fault or quick) and locked:
        for again in by_evidence():
            found, with_it, _ = judge(again, [], inquiry.rough)
            if found.rivals:
                outcome, learned = found, with_it
                break
    laws = laws_beside(outcome.rivals)
    (without,) = learning.of([None], laws)
    before = locked_errors(without)
    outcome = inquiry.in_view_of(None if before is None else before.misfit, outcome)
    after = locked_errors(learned[0]) if learned else None
    free_mass = partial(learn, replace(divided, mass=None), everything, None, seed=seed, laws=laws)
    outcome = with_other_causes(outcome, dataset, without, before, after, free_mass)
    return Diagnosis(
        **vars(outcome),
        candidates=tuple(inquiry.candidates(learned, outcome.effects)),
        p_value=inquiry.p_value,
        open_trials=tuple(o.trial for o in observations),
        locked=tuple(locked),
        without_effects=without,
        with_effects=learned[0] if learned else None,
        base=inquiry.base,
        motion_error=inquiry.error.motion,
        force_error=inquiry.error.force,
        quick=quick,
        seconds=time.perf_counter() - started,
        seed=seed,
    )


_FIRSTS_TRIED = 2
"""Candidates to which a second effect is added."""


class Inquiry:
    """The steps of one diagnosis and what they found on the way."""

    def __init__(
        self,
        dataset: PushDataset,
        observations: Sequence[Observation],
        effects: tuple[Effect, ...],
        draws: int,
        rng: np.random.Generator,
        report: Progress,
    ) -> None:
        measured = any(observation.sliding.any() for observation in observations)
        # Without measured forces, nothing can be learned about the force sensor.
        effects = tuple(effect for effect in effects if measured or not effect.only_force)
        if not effects:
            raise EffectError(
                "diagnose: no candidate is left: only effects of the force sensor were asked for, but no"
                " force was measured; name another effect"
            )
        self.effects = effects
        self.fault = fault_of_frame(dataset, dataset.trials)
        self.draws = draws
        self.rng = rng
        self.report = report
        self.rules = Rules(effects, simulated=draws > 0)
        self.fitter = Fitter(dataset, observations, sensor_noise(dataset))
        report("fitting without effects", 0, 1)
        self.base = self.fitter.from_scratch(partial(report, "fitting without effects"))
        self.scene = self.fitter.scene(self.base)
        report("fitting without effects", 1, 1)
        self.error = self.base.likelihood.error
        self.second_look = False
        self.refits = Refits(self.base, {}, {})
        self.rest: dict[str, Screening] = {}  # on top of each candidate that was asked
        self.left: dict[str, Remainder] = {}
        self.accepted: list[str] = []
        self.faint = self.only_a_trace = False
        self.unseen: str | None = None  # pushes that show too little, in words
        self.first: Screening
        self.p_value: float | None = None

    def run(self) -> Outcome:
        """Go through the steps."""
        self.first = self._ask_every_effect()
        if self.fault is not None and far_above_noise(self.misfit()) is not None:
            return outcomes.records_wrong(self.base, self.fault)
        missing = self.rules.missing(self.first)
        if not missing and far_above_noise(self.misfit()) is None:
            return self._nothing_found()
        self.refits = refit_candidates(
            self.fitter, self.base, self.first, self.effects, self.scene,
            quick=not self.draws, progress=partial(self.report, "refitting with effects"),
        )  # fmt: skip
        self.error = self.refits.plain.likelihood.error
        if self._found_better_base():
            return self.run()
        missing = missing and not self.rules.vanishes(self.first, self.refits.gains)
        if not missing and max(self.refits.gains.values(), default=0.0) < UNKNOWN_GAIN:
            self.error = self.base.likelihood.error
            return self._nothing_found()
        disagreement = self._disagreement()
        if disagreement is not None:
            return disagreement
        if not self.refits.fits:
            return outcomes.unknown(self.base, self.first)
        self._ask_what_is_left()
        if self.accepted:
            gains, predicted = self.refits.gains, self.first.by_name
            kept = not_outdone(self.accepted, self.left, gains, predicted)
            self.accepted = with_better_predictors(kept, gains, predicted)
            return outcomes.one_of([self.refits.fits[name] for name in self.accepted])
        if float(self.first.gain.max()) < PROBE_GAIN:
            return self._too_faint()
        found = self._pairs(self.rest)
        if found:
            return outcomes.two_at_once(found)
        if float(self.first.gain.max()) < UNKNOWN_GAIN:
            return self._too_faint()
        name, screening = next(iter(self.rest.items()))
        return outcomes.unknown(self.base, screening, self._nearest(name))

    def _nearest(self, name: str) -> str:
        """A candidate that would explain the pushes but for what gains on top of it, as a clause."""
        left = self.left[name]
        if left.rejected_by is None:
            return ""
        by_effect = left.rejected_by in {effect.name for effect in self.effects}
        more = f", but {left.rejected_by} on top gains {left.gain:.0f} more" * by_effect
        return f"{name} ({self.refits.gains[name]:.0f} nats when refitted){more}"

    def _screen(
        self, fitted: Fitted, progress: StageProgress | None = None, *, flips: bool = False
    ) -> Screening:
        everything = (*self.effects, *PROBES)
        return screen(
            self.fitter, fitted, everything, len(self.effects), self.scene, max(self.draws, 1), self.rng,
            progress, flips=flips,
        )  # fmt: skip

    def _ask_every_effect(self) -> Screening:
        """Gains on top of the model without effects."""
        flips = self.draws > 0 and not self.fitter.noise.declared  # for `_disagreement`
        first = self._screen(self.base, partial(self.report, "screening effects"), flips=flips)
        named = [effect in self.effects for effect in first.candidates]
        self.p_value = self.rules.p_value(first, float(first.gain[named].max()))
        return first

    @property
    def rough(self) -> bool:
        """Whether the locked pushes must improve by more than chance."""
        return self.faint or self.error.motion > ROUGH

    def misfit(self, fitted: Fitted | None = None) -> FloatArray:
        """Misfit (B,) of each open push, in units of sensor noise, forces included; without effects unless a
        fit is given."""
        fitted = fitted or self.base
        noise = self.fitter.noise
        sigma = np.array([noise.position, noise.position, noise.angle * self.fitter.measured.radius])
        found = []
        for push in fitted.likelihood.rows(fitted.z, fitted.offsets):
            parts = [(push.pose / sigma).ravel(), (push.force / noise.force).ravel()]
            found.append(float(np.sqrt((np.concatenate(parts) ** 2).mean())))
        return np.array(found)

    def _too_faint(self) -> Outcome:
        """An effect gains, but too little; if pushes are missed by far, something else is wrong."""
        misfit = far_above_noise(self.misfit())
        if misfit is None:
            self.only_a_trace = float(self.first.gain.max()) < PROBE_GAIN
            return outcomes.too_faint(self.base)
        return outcomes.far_off(self.base, misfit, self._explains_most(misfit))

    def in_view_of(self, locked: FloatArray | None, outcome: Outcome) -> Outcome:
        """The answer, corrected by the misfit (L,) of locked pushes without effects, if there are any.

        Missed by far, the model is not adequate. Met to the noise, it is, though a trace of something gains.
        """
        misfit = far_above_noise(self.misfit() if locked is None else locked)
        if misfit is not None and outcome.verdict == "adequate":
            return outcomes.far_off(self.base, misfit)
        if misfit is not None and self.unseen is not None and outcome.best is self.base:
            # Few pushes leave the maps open, so that the right model misses others too, but by less.
            far = misfit > FAR_FROM_FEW or far_above_noise(self.misfit()) is not None
            return outcomes.cannot_show_why(self.base, self.unseen, misfit) if far else outcome
        if locked is None or typical_misfit(locked) > AT_NOISE or not self.only_a_trace or outcome.rivals:
            return outcome
        self.error = self.base.likelihood.error
        return self._nothing_found()

    def _explains_most(self, misfit: float) -> tuple[str, float] | None:
        """The best effect, and the misfit of the typical push with it, where it more than halves `misfit`.

        It gains more than chance, and was struck out only because something gains on top of it.
        """
        name = next(iter(self.refits.order), None)
        if name is None or name not in self.left or self.left[name].rejected_by is None:
            return None
        left = typical_misfit(self.misfit(self.refits.fits[name]))
        stands = self.rules.beyond_chance(self.first, self.first.by_name[name])
        return (name, left) if stands and left < 0.5 * misfit else None

    def _nothing_found(self) -> Outcome:
        """Adequate, unless the pushes scatter or could not have revealed an effect of ordinary size."""
        pushes = len(self.fitter.observations)
        different = pushes - sum(len(group) - 1 for group in repeated_pushes(self.fitter.observations))
        if different < FEWEST_PUSHES:
            what = "one push" if different == 1 else f"{different} pushes"
            self.unseen = what if different == pushes else f"repeats of {what}"
        elif self.rules.blind(self.first):
            self.unseen = "these pushes"
        if self.unseen is not None:
            return outcomes.nothing_visible(self.base, self.unseen)
        if self.error.motion > ROUGH:
            return outcomes.scatter(self.base)
        return outcomes.nothing_missing(self.base)

    def _found_better_base(self) -> bool:
        """Adopt a better model without effects where a refit leads to one, once; whether it did."""
        if self.second_look or not self.draws:
            return False
        self.second_look = True
        better = better_base(self.fitter, self.refits)
        if better is None:
            return False
        self.base, self.error = better, better.likelihood.error
        self.refits = Refits(self.base, {}, {})
        return True

    def _disagreement(self) -> Outcome | None:
        """`undecided` where much is left even with the best effect, and the pushes disagree on what gains.

        The error model then only describes scatter, so chance is judged by the pushes alone: the residuals of
        whole pushes change sign at random. Where the noise is declared, whatever exceeds it is model error,
        however few pushes show it.
        """
        if self.error.motion <= ROUGH or not self.draws or self.fitter.noise.declared:
            return None
        p = self.first.p_of_agreement()
        if p <= AGREEMENT:
            return None
        return outcomes.disagreement(self.base, len(self.fitter.observations), p)

    def _ask_what_is_left(self) -> None:
        """Gains on top of each candidate close to the best; accepts those that explain the data."""
        gains = self.refits.gains
        order = self.refits.order
        best = gains[order[0]]
        asked = [name for name in order if worth_asking(gains[name], best)][: 5 if self.draws else 2]
        faint: list[str] = []
        for step, name in enumerate(asked):
            self.report("checking what is left", step, len(asked))
            rival = self.rules.rivals_the_best(gains[name], best)
            if not (rival or self.draws):
                continue
            self.rest[name] = self._screen(self.refits.fits[name])
            self.left[name] = self.rules.remainder(self.rest[name], gains[name])
            explains = self.left[name].rejected_by is None
            if explains and rival and self.rules.stands(self.first, name, gains[name]):
                self.accepted.append(name)
            elif explains and rival and self.rules.stands_faintly(self.first, name, gains[name]):
                faint.append(name)
        if faint and not self.accepted:
            self.accepted, self.faint = faint, True
        self.report("checking what is left", len(asked), len(asked))

    def second_beside_first(self, by_evidence: Callable[[], list[Outcome]]) -> Outcome | None:
        """Two effects, where each accepted one leaves much that a second effect explains.

        What is left is small beside a gain of 20 000 nats, but far more than an effect's exact form leaves.
        Or it gains little only because an error model that was fitted with one effect forgives it. Where
        pushes are missed by far, a fit that tolerates large errors decides, if it names the same first.

        Args:
            by_evidence: what that fit names.
        """
        fits = self.refits.fits
        if any(far_above_noise(self.misfit(fits[name])) is not None for name in self.accepted):
            found = by_evidence()
            if found and set(found[-1].effects) <= set(self.accepted):
                return found[0] if found[0].together else None
        much = {name: self.rest[name] for name in self.accepted if self._leaves_much(name)}
        if not much or len(much) < len(self.accepted):
            return None
        nearer = [pair for pair in self._pairs(much) if self._nearer(pair)]
        return outcomes.two_at_once(nearer) if nearer else None

    def without_needless(self, rivals: Sequence[Fitted], against: Mapping[str, Objection]) -> list[Fitted]:
        """Single effects, best first: what is left of pairs in which one interval includes its null."""
        needed: dict[str, Fitted] = {}
        for pair in rivals:
            found = against.get(outcomes.name_of(pair))
            if found is None or found.effect is None:
                continue
            for effect in pair.effects:
                if effect.name != found.effect and effect.name in self.refits.fits:
                    needed[effect.name] = self.refits.fits[effect.name]
        return sorted(needed.values(), key=lambda fitted: fitted.cost)

    def _leaves_much(self, name: str) -> bool:
        """Whether much gains on top of a candidate, or something where pushes are missed by far."""
        if name not in self.rest:
            return False
        far = far_above_noise(self.misfit(self.refits.fits[name])) is not None
        least = REST_GAIN if far else PROBE_GAIN
        return self.rules.found(self.rest[name], least, np.inf) is not None

    def _nearer(self, pair: Fitted) -> bool:
        """Whether a pair comes near the noise, or halves the misfit of its first effect."""
        first = self.refits.fits[pair.effects[0].name]
        left = far_above_noise(self.misfit(pair))
        return left is None or left < 0.5 * typical_misfit(self.misfit(first))

    def _pairs(self, rest: dict[str, Screening]) -> list[Fitted]:
        """Pairs of effects that together leave nothing, best first; several where the first is ambiguous.

        A pair with more parameters than the best one has to fit better: a distant tether imitates a tilt.
        """
        gains = self.refits.gains
        best = max(gains.values(), default=0.0)
        found: list[Fitted] = []
        for step, name in enumerate(list(rest)[:_FIRSTS_TRIED]):
            if found and not self.rules.rivals_the_best(gains[name], best):
                break
            self.report("trying pairs", step, _FIRSTS_TRIED)
            pair = self._pair_with(name, rest[name])
            if pair is not None:
                found.append(pair)
        found.sort(key=lambda pair: pair.cost)

        def size(pair: Fitted) -> int:
            return sum(len(effect.parameters) for effect in pair.effects)

        near = [pair for pair in found if pair.cost < found[0].cost + CLEARLY_WORSE_GAIN]
        return [pair for pair in near if size(pair) <= size(found[0])]

    def _pair_with(self, name: str, rest: Screening) -> Fitted | None:
        """A pair of a candidate and a second effect that together leave nothing, if there is one.

        Tried are the effects that gain most on top of the candidate, then what gains most on top of a pair.
        """
        first, plain = self.refits.fits[name], self.refits.plain
        tried: list[Effect] = []
        on_top = [rest]  # and then what is left by the first pair
        for screening in on_top:
            untried = [effect for effect in self.effects if effect not in tried]
            for pair in pairs(self.fitter, first, screening, untried, self.scene):
                tried.append(pair.effects[-1])
                left, second = self._screen(pair), first.cost - pair.cost
                if plain.cost - pair.cost > PAIR_GAIN and self.rules.completes(
                    left, self.refits.gains[name], second
                ):
                    return pair
                if screening is not rest:
                    break
                if len(on_top) == 1:
                    on_top.append(left)
        return None

    def by_evidence(self, divided: PushDataset, seed: int) -> list[Outcome]:
        """What a fit that tolerates large errors names: two effects at once and the first of them, or one
        effect, or nothing.

        Where the model error is far above the noise, a few pushes decide a strict fit. If neither noise nor
        maps are known, the pushes themselves may scatter that much, and no effect is named.
        """
        if self.error.motion <= ROUGH or not (self.fitter.noise.declared or divided.known):
            return []
        effects: tuple[Effect, ...] = ()
        with suppress(RolloutError):
            effects = named_by_evidence(
                divided, self.effects, seed, partial(self.report, "trying a forgiving fit")
            )
        guesses = []
        for effect in effects:
            place = self.first.candidates.index(effect)
            start = effect.start_values(self.scene)[int(self.first.start[place])]
            guesses.append(self.fitter.start_of(effect, start, self.error, self.base))
        found = []
        for count in range(len(effects), 0, -1):
            values = np.concatenate(guesses[:count])
            fitted = self.fitter.with_effects(effects[:count], self.error, self.base, values, afresh=True)
            if fitted is not None:
                found.append(outcomes.one_of([fitted]) if count == 1 else outcomes.two_at_once([fitted]))
        return found

    def candidates(self, learned: Sequence[Identification], answer: Sequence[str]) -> list[CandidateResult]:
        """All named candidates, best first; those in the answer carry the parameters that were learned."""
        told: dict[str, tuple[ParameterEstimate, ...]] = {}
        for one in learned:
            told = estimates_by_effect(one) | told
        results = []
        for i, effect in enumerate(self.first.candidates):
            if effect not in self.effects:
                continue
            name, gain = effect.name, float(self.first.gain[i])
            fitted, left = self.refits.fits.get(name), self.left.get(name)
            own = told.get(name) or (parameter_estimates(fitted) if fitted is not None else ())
            results.append(
                CandidateResult(
                    name=name,
                    gain=gain,
                    p_value=self.rules.p_value(self.first, gain),
                    fitted_gain=self.refits.gains.get(name),
                    rejected_by=left.rejected_by if left else None,
                    remaining_gain=left.gain if left else None,
                    remaining_p=left.p_value if left else None,
                    in_set=name in answer,
                    parameters=own,
                )
            )
        return sorted(
            results, key=lambda c: (-(c.fitted_gain if c.fitted_gain is not None else -np.inf), -c.gain)
        )
