"""Which physical effect do the data miss? The procedure, from pushes to verdict.

1. Some pushes are locked away. The model without effects and the error model are fitted to the rest.
2. Every candidate is added to first order, maps refitted, and scored on pushes left out. The largest gain
   is compared with the largest gain by chance. Where it is no larger, the model is adequate, or the data
   too few.
3. Candidates are refitted in full, under the error model of the best.
4. Each that is left is asked the same question again: does anything gain on top of it? The true effect
   leaves nothing to gain; an impostor leaves the true one. Those that pass are the answer: one, or a set.
5. Where none passes, pairs are tried; where no pair passes, the effect is unknown to the library.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from models.effects.effect import Effect, bounds
from models.effects.library import LIBRARY
from models.effects.probes import PROBES
from models.inference.diagnosis.error_model import sensor_noise
from models.inference.diagnosis.fitting import Fitted, Fitter, estimate_errors
from models.inference.diagnosis.locked import locked_errors, locked_trials
from models.inference.diagnosis.results import CandidateResult, Diagnosis, ParameterEstimate
from models.inference.diagnosis.screening import Screening, screen
from models.inference.observations import Observation, observe_all
from models.measurements import DatasetError, PushDataset

LEVEL = 0.01
"""Gains that come about by chance more seldom than this count."""

MATERIAL = 0.03
"""What gains less than this share on top of an effect's own gain is a matter of its exact form."""

CLEARLY_WORSE = 0.02
CLEARLY_WORSE_GAIN = 40.0
"""A candidate whose gain is smaller than the best one's by this share and by so many nats is ruled out by
that alone."""

MOST_ASKED = 5
MOST_ASKED_QUICKLY = 2

ROUGH = 0.03
"""α above which an error model is rough: no sensor's noise, but a description of pushes that scatter."""

AGREEMENT = 0.05
"""Share of sign changes of whole pushes that may gain as much, where the error model is rough."""

PROBE_GAIN = 20.0
"""Gain, in nats, below which a finding in the model without effects may come from the grid and the contact,
which are not exact: a probe's does not count, and an effect is not named for it."""

REST_GAIN = 8.0
"""The same for all that is found on top of an effect, where it may come from the effect's exact form."""

QUICK_GAIN = 8.0
"""Gain, in nats, that counts where chance was not simulated."""

QUICK_ITERATIONS = 1
QUICK_REFITS = 3
"""Where chance was not simulated, one step of the full fit chooses what is refitted in full."""

FEWEST_PUSHES = 4
FEWEST_DRAWS = 99

Progress = Callable[[str, int, int], None]


def diagnose(
    dataset: PushDataset,
    *,
    effects: Sequence[Effect] = LIBRARY,
    draws: int = 199,
    quick: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find out whether, and which, physical effect the model misses on a dataset.

    Args:
        dataset: measured pushes.
        effects: candidates.
        draws: simulated datasets for the p-values.
        quick: do not simulate any; gains are judged by a fixed threshold.
        seed: of every random draw.
        progress: called with (stage, done, total).

    Raises:
        DatasetError: no push is left to fit.
        EffectError: a candidate's formula cannot be used.
        ValueError: fewer draws than the level of the test needs.
    """
    if not quick and draws < FEWEST_DRAWS:
        raise ValueError(f"draws must be at least {FEWEST_DRAWS} to reach p <= {LEVEL}, got {draws}")
    started = time.perf_counter()
    report = progress or (lambda stage, done, total: None)
    rng = np.random.default_rng(seed)
    report("preparing pushes", 0, 1)
    locked = locked_trials(dataset, rng)
    every = observe_all(dataset)
    observations = [o for o in every if o.trial not in locked]
    if not observations:
        raise DatasetError(f"dataset {dataset.name} has no push left to fit; give at least one the role fit")
    inquiry = _Inquiry(dataset, observations, tuple(effects), 0 if quick else draws, rng, report)
    outcome = inquiry.run()
    held = [o for o in every if o.trial in locked]
    before = locked_errors(inquiry.base, dataset, held) if held else None
    after = locked_errors(outcome.best, dataset, held) if held and outcome.best.effects else before
    if (
        outcome.verdict in ("effect", "ambiguous")
        and inquiry.error.motion > ROUGH
        and before is not None
        and after is not None
        and after.total_misfit > before.total_misfit
    ):
        sentence = (
            f"On the open pushes {' and '.join(outcome.effects)} would explain much, but the locked pushes"
            " become worse with it: the pushes are too few, or scatter too much, to decide."
        )
        outcome = _Outcome("undecided", sentence, inquiry.base)
        after = before
    return Diagnosis(
        verdict=outcome.verdict,
        sentence=outcome.sentence,
        effects=outcome.effects,
        together=outcome.together,
        candidates=tuple(inquiry.candidates(outcome.best)),
        p_value=inquiry.p_value,
        depends_on=outcome.depends_on,
        open_trials=tuple(o.trial for o in observations),
        locked=tuple(locked),
        before=before,
        after=after,
        base=inquiry.base,
        best=outcome.best,
        effect_objects=outcome.best.effects,
        motion_error=inquiry.error.motion,
        force_error=inquiry.error.force,
        quick=quick,
        seconds=time.perf_counter() - started,
        seed=seed,
        rivals=outcome.rivals,
    )


class _Outcome:
    """Verdict and what belongs to it."""

    def __init__(
        self,
        verdict: str,
        sentence: str,
        best: Fitted,
        effects: Sequence[str] = (),
        together: bool = False,
        depends_on: str | None = None,
        rivals: Sequence[Fitted] = (),
    ) -> None:
        self.verdict = verdict
        self.sentence = sentence
        self.best = best
        self.effects = tuple(effects)
        self.together = together
        self.depends_on = depends_on
        self.rivals = tuple(rivals)


class _Inquiry:
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
        self.effects = effects
        self.everything = (*effects, *PROBES)
        self.draws = draws
        self.rng = rng
        self.report = report
        noise = sensor_noise(dataset)
        self.fitter = Fitter(dataset, observations, noise)
        self.noise = noise
        report("fitting without effects", 0, 1)
        self.base = self.fitter.from_scratch()
        self.error = self.base.likelihood.error
        self.scene = self.fitter.scene(self.base, typical_speed(observations))
        self.fitter.weight = self.scene.weight
        report("fitting without effects", 1, 1)
        self.second_look = False
        self.fits: dict[str, Fitted] = {}
        self.gains: dict[str, float] = {}
        self.asked: dict[str, tuple[str | None, float, float | None]] = {}
        self.accepted: list[str] = []
        self.first: Screening
        self.p_value: float | None = None

    def run(self) -> _Outcome:
        """Go through the steps."""
        self.report("asking every effect", 0, 1)
        self.first = self._screen(self.base)
        self.report("asking every effect", 1, 1)
        named = [effect in self.effects for effect in self.first.candidates]
        largest = float(self.first.gain[named].max())
        self.p_value = self.first.p_value(largest) if self.draws else None
        if self._found(self.first, 0.0, PROBE_GAIN) is None:
            return self._nothing_found()
        self._refit()
        if self._better_base():
            return self.run()
        # Where the noise was declared, what is left beyond it is the model's, however few pushes show it.
        if self.error.motion > ROUGH and self.draws and not self.noise.declared:
            disagreement = self._disagreement()
            if disagreement is not None:
                return disagreement
        if not self.fits:
            return self._unknown(self.first)
        order = sorted(self.fits, key=lambda name: -self.gains[name])
        best_gain = self.gains[order[0]]
        near = [n for n in order if self.gains[n] > best_gain - max(10.0, 0.6 * best_gain)]
        near = near[: MOST_ASKED if self.draws else MOST_ASKED_QUICKLY]
        rest: dict[str, Screening] = {}
        for step, name in enumerate(near):
            self.report("asking what is left", step, len(near))
            enough = self.gains[name] > best_gain - max(CLEARLY_WORSE_GAIN, CLEARLY_WORSE * best_gain)
            if not (enough or self.draws):
                continue
            rest[name] = self._screen(self.fits[name])
            if self._explains(name, rest[name]) and enough and self._stands(name):
                self.accepted.append(name)
        self.report("asking what is left", len(near), len(near))
        if not self.accepted:
            if float(self.first.gain.max()) < PROBE_GAIN:
                sentence = "Something may be missing, but the pushes show too little of it to say what."
                return _Outcome("undecided", sentence, self.base)
            return self._pairs(near, rest)
        # One that leaves nothing at all beats those that leave a little and explain less.
        clean = [n for n in self.accepted if self._found(rest[n], REST_GAIN, REST_GAIN) is None]
        top = max((self.gains[n] for n in clean), default=-np.inf)
        return self._answer([n for n in self.accepted if n in clean or self.gains[n] > top - REST_GAIN])

    def _answer(self, accepted: Sequence[str]) -> _Outcome:
        """One effect, or a set that the data cannot tell apart, best first."""
        self.accepted = list(accepted)
        rivals = [self.fits[name] for name in accepted]
        names = ", ".join(accepted)
        if len(rivals) == 1:
            sentence = f"The data miss one effect: {names}."
            return _Outcome("effect", sentence, rivals[0], accepted, rivals=rivals)
        sentence = f"An effect is missing; the data cannot tell which of these it is: {names}."
        return _Outcome("ambiguous", sentence, rivals[0], accepted, rivals=rivals)

    def _stands(self, name: str) -> bool:
        """Whether a candidate's own gain is beyond chance and more than the grid's errors may feign.

        To first order, or by far when refitted.
        """
        gain = float(self.first.gain[[c.name for c in self.first.candidates].index(name)])
        seen = gain > PROBE_GAIN and (not self.draws or self.first.p_value(gain) <= LEVEL)
        return seen or self.gains[name] > 3 * PROBE_GAIN

    def _screen(self, fitted: Fitted) -> Screening:
        return screen(
            self.fitter, fitted, self.everything, len(self.effects), self.scene, max(self.draws, 1), self.rng
        )

    def _found(self, screening: Screening, floor: float, probe_floor: float) -> int | None:
        """Index of the candidate whose gain counts most, or None where all of it may be chance.

        Args:
            screening: gains.
            floor: that a named effect has to exceed.
            probe_floor: that a probe has to exceed.
        """
        for i in np.argsort(-screening.gain):
            gain = float(screening.gain[i])
            if not (gain > QUICK_GAIN if not self.draws else screening.p_value(gain) <= LEVEL):
                return None
            if gain > (floor if screening.candidates[i] in self.effects else probe_floor):
                return int(i)
        return None

    def _nothing_found(self) -> _Outcome:
        """Adequate, unless the pushes could not have shown an effect of ordinary size."""
        seen = [
            s
            for effect, s in zip(self.first.candidates, self.first.sharpness, strict=True)
            if effect in self.effects
        ]
        blind = sum(1 for s in seen if s > 1.0)
        pushes = len(self.fitter.observations)
        if pushes < FEWEST_PUSHES or blind > len(seen) / 2:
            why = f"{pushes} pushes" if pushes < FEWEST_PUSHES else "these pushes"
            sentence = f"Nothing is seen to be missing, but {why} could not have shown most effects."
            return _Outcome("undecided", sentence, self.base)
        if self.error.motion > ROUGH:
            share = 100 * self.error.motion
            sentence = (
                f"The model is off by about {share:.0f} % of the way, which is much, but no effect explains"
                " it: the pushes may scatter by themselves, or something unknown disturbs them."
            )
            return _Outcome("undecided", sentence, self.base)
        return _Outcome("adequate", "The model explains the data; no effect is missing.", self.base)

    def _disagreement(self) -> _Outcome | None:
        """`undecided` where much is left even with the best effect, and pushes do not agree on what gains.

        Then the error model is no more than a description, and chance has to be judged by the pushes alone:
        by turning round the residuals of whole pushes at random.
        """
        p = self.first.p_of_agreement()
        if p <= AGREEMENT:
            return None
        pushes = len(self.fitter.observations)
        self.p_value = p
        return _Outcome(
            "undecided",
            f"Much is left that the model does not explain, but the {pushes} pushes do not agree on what it"
            f" is: turned round at random, they would show as much in {100 * p:.0f} % of cases.",
            self.base,
        )

    def _better_base(self) -> bool:
        """Whether the maps of a refit, without its effect, explain the data better than those found at first.

        Then it was the search that the effect helped, not the model. Asked once.
        """
        if self.second_look or not self.fits or not self.draws:
            return False
        self.second_look = True
        best = min(self.fits.values(), key=lambda fitted: fitted.cost)
        again = self.fitter.base(self.error, best)
        plain = self.fitter.base(self.error, self.base)
        if again.cost > plain.cost - 5.0:
            return False
        self.base = again
        self.error = estimate_errors(again, self.noise)
        self.base = self.fitter.base(self.error, again)
        self.fits.clear()
        self.gains.clear()
        return True

    def _refit(self) -> None:
        """Refit all candidates, then again under the error model of the best of them.

        All, since the first order misleads where the model without the effect had to bend its maps far.
        """
        named = [i for i in np.argsort(-self.first.gain) if self.first.candidates[i] in self.effects]
        found: dict[str, Fitted] = {}
        for step, i in enumerate(named):
            self.report("refitting with effects", step, len(named) + 2)
            effect = self.first.candidates[i]
            guess = effect.start_values(self.scene)[int(self.first.start[i])]
            near = self.base if self.draws else None
            iterations = 30 if self.draws else QUICK_ITERATIONS
            fitted = self.fitter.with_effects(
                (effect,), self.error, near, guess, afresh=True, iterations=iterations
            )
            if fitted is not None:
                found[effect.name] = fitted
        if not found:
            return
        if not self.draws:
            ahead = sorted(found, key=lambda name: found[name].cost)[:QUICK_REFITS]
            found = {name: found[name] for name in ahead}
        best = min(found.values(), key=lambda fitted: fitted.cost)
        self.report("refitting with effects", len(named), len(named) + 2)
        self.error = estimate_errors(best, self.noise)
        plain = self.fitter.base(self.error, self.base)
        ceiling = best.cost + 0.7 * max(self.base.cost - best.cost, 30.0)
        for name, fitted in found.items():
            if fitted.cost > ceiling:
                continue
            again = self.fitter.with_effects(fitted.effects, self.error, fitted, fitted.values)
            if again is not None:
                self.fits[name] = again
                self.gains[name] = plain.cost - again.cost
        self.report("refitting with effects", len(named) + 2, len(named) + 2)

    def _explains(self, name: str, rest: Screening) -> bool:
        """Whether nothing that matters is left to gain on top of a candidate; remembers what is."""
        found = self._found(rest, REST_GAIN, REST_GAIN)
        top = int(np.argmax(rest.gain)) if found is None else found
        gain = float(rest.gain[top])
        passed = found is None or gain < MATERIAL * self.gains[name]
        p = rest.p_value(gain) if self.draws else None
        self.asked[name] = (None if passed else rest.candidates[top].name, gain, p)
        return passed

    def _pairs(self, near: Sequence[str], rest: dict[str, Screening]) -> _Outcome:
        """Two effects at once, the second being what gains most on top of the first."""
        for step, name in enumerate([name for name in near if name in rest][:2]):
            self.report("trying pairs", step, 2)
            screening = rest[name]
            order = [i for i in np.argsort(-screening.gain) if screening.candidates[i] in self.effects][:2]
            for i in order:
                second = screening.candidates[i]
                if screening.gain[i] < 0.3 * screening.gain.max():
                    continue
                first = self.fits[name]
                guess = second.start_values(self.scene)[int(screening.start[i])]
                values = np.concatenate([first.values, guess])
                pair = self.fitter.with_effects(
                    (*first.effects, second), self.error, first, values, afresh=True
                )
                if pair is None:
                    continue
                left = self._screen(pair)
                found = self._found(left, REST_GAIN, REST_GAIN)
                # What is left must be small beside the gain of the second effect, not only of both.
                second_gain = self.fits[name].cost - pair.cost
                enough = found is None or left.gain[found] < 2 * MATERIAL * second_gain
                if second_gain > PROBE_GAIN and enough:
                    names = [effect.name for effect in pair.effects]
                    return _Outcome(
                        "effect",
                        f"The data miss two effects at once: {names[0]} and {names[1]}.",
                        pair, names, together=True, rivals=[pair],
                    )  # fmt: skip
        return self._unknown(rest[near[0]])

    def _unknown(self, screening: Screening) -> _Outcome:
        """Structure is left; told by the probe that gains most."""
        probes = [(g, c) for g, c in zip(screening.gain, screening.candidates, strict=True) if c in PROBES]
        _, probe = max(probes, key=lambda pair: pair[0])
        return _Outcome(
            "unknown",
            "Structure is left that no effect of the library explains; the residual behaves like this:"
            f" {probe.sentence[0].lower()}{probe.sentence[1:]}",
            self.base,
            depends_on=f"{probe.name}: {probe.sentence}",
        )

    def candidates(self, answer: Fitted) -> list[CandidateResult]:
        """All named candidates, best first; two effects found together have the parameters of their fit."""
        together = parameter_estimates(answer) if len(answer.effects) > 1 else ()
        results = []
        for i, effect in enumerate(self.first.candidates):
            if effect not in self.effects:
                continue
            fitted = self.fits.get(effect.name)
            by, gain, p = self.asked.get(effect.name, (None, None, None))
            results.append(
                CandidateResult(
                    effect.name,
                    float(self.first.gain[i]),
                    self.first.p_value(float(self.first.gain[i])) if self.draws else None,
                    self.gains.get(effect.name),
                    by,
                    gain,
                    p,
                    effect.name in self.accepted,
                    tuple(e for e in together if e.effect == effect.name)
                    or (() if fitted is None else parameter_estimates(fitted)),
                )
            )
        return sorted(
            results, key=lambda c: (-(c.fitted_gain if c.fitted_gain is not None else -np.inf), -c.gain)
        )


def parameter_estimates(fitted: Fitted) -> tuple[ParameterEstimate, ...]:
    """Parameters of a fitted model with their 90 % intervals, cut at the allowed range."""
    spread = 1.645 * fitted.standard_deviations
    low, high = bounds(fitted.effects)
    every = [(effect.name, parameter) for effect in fitted.effects for parameter in effect.parameters]
    return tuple(
        ParameterEstimate(
            name,
            parameter.name,
            parameter.unit,
            float(value),
            float(max(value - s, lo)),
            float(min(value + s, hi)),
        )
        for (name, parameter), value, s, lo, hi in zip(every, fitted.values, spread, low, high, strict=True)
    )


def typical_speed(observations: Sequence[Observation]) -> float:
    """Median over pushes of the finger's mean speed while it moves, m/s."""
    speeds = []
    for o in observations:
        speed = np.hypot(*np.diff(o.push.tip, axis=0).T) / o.push.h
        moving = speed[np.isfinite(speed) & (speed > 1e-3)]
        if len(moving):
            speeds.append(float(moving.mean()))
    return float(np.median(speeds)) if speeds else 0.05


__all__ = ["diagnose", "parameter_estimates", "typical_speed"]
