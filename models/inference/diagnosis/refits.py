"""Full refits of the model with one more effect, and of the model without effects from their maps. Strict
fits of given effects, each started where it gains most to first order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np

from slipmap.models.effects.effect import Effect, Scene
from slipmap.models.inference.diagnosis.fitting import Fitted, Fitter, estimate_errors
from slipmap.models.inference.diagnosis.screening import Screening, screen
from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.inference.observations import Observation
from slipmap.models.measurements import DatasetError, PushDataset
from slipmap.models.physics.rollout import RolloutError
from slipmap.models.progress import StageProgress, side_by_side

_TOGETHER = 4
"""Candidates in the first group that is refitted side by side; each later group is twice as large. A search
is given up by what earlier groups reached."""

_QUICK_REFITS = 3
"""Candidates besides the favourite that are refitted in full where chance was not simulated, chosen by a
short search and one step of the full fit."""

_WORTH_REFITTING, _WORTH_REFITTING_GAIN = 0.7, 30.0
"""Share of the best drop in cost, or nats, by which a candidate may be behind and still be refitted again."""

_BETTER_BASE = 5.0
"""Drop in cost, in nats, from which other maps of the model without effects count as better."""

_SECONDS_TRIED, _SECOND_SHARE = 2, 0.3
"""Number of second effects tried with a first, and the smallest share of the largest gain they must have."""


@dataclass(frozen=True, eq=False)
class Refits:
    """Candidates refitted in full."""

    plain: Fitted  # the model without effects, under the error model of the best of them
    fits: dict[str, Fitted]  # by name, those close to the best
    gains: dict[str, float]  # drop in cost by each, nats

    @property
    def order(self) -> list[str]:
        """Names, best first."""
        return sorted(self.fits, key=lambda name: -self.gains[name])


def refit_candidates(
    fitter: Fitter,
    base: Fitted,
    first: Screening,
    effects: Sequence[Effect],
    scene: Scene,
    *,
    quick: bool,
    progress: StageProgress,
) -> Refits:
    """Refit the screened effects, then again under the error model of the best.

    All effects are refitted, with long steps at first, since the first order misleads where the model had to
    bend its maps far to do without an effect; if `quick`, a short search selects a few.
    """
    error = base.likelihood.error
    coarse, alone = fitter, base
    if not quick:
        with suppress(RolloutError, np.linalg.LinAlgError):
            alone = fitter.with_long_steps.base(error, base)
            coarse = fitter.with_long_steps
    named = [i for i in np.argsort(-first.gain) if first.candidates[i] in effects]
    found: dict[str, Fitted] = {}

    def tried(i: int, worth: float) -> Fitted | None:
        effect = first.candidates[i]
        values = effect.start_values(scene)[int(first.start[i])]
        try:
            guess = coarse.start_of(effect, values, error, alone)
        except (RolloutError, np.linalg.LinAlgError):
            return None
        if quick:
            return coarse.with_effects((effect,), error, None, guess, afresh=True, iterations=1, forgiving=6)
        return coarse.with_effects((effect,), error, alone, guess, afresh=True, worth=worth)

    begin = 0
    while begin < len(named):
        progress(begin, len(named) + 2)
        own = named[begin : 2 * begin + _TOGETHER]
        begin += len(own)
        least = min((fitted.cost for fitted in found.values()), default=alone.cost)
        tasks = [partial(tried, i, _ceiling(alone.cost, least)) for i in own]
        for i, fitted in zip(own, side_by_side(tasks), strict=True):
            if fitted is not None:
                found[first.candidates[i].name] = fitted
    if not found:
        return Refits(base, {}, {})
    favourite = first.candidates[named[0]].name
    if quick:
        # One step does not bring every candidate near its optimum, so the first-order favourite stays in.
        ahead = sorted(found, key=lambda name: found[name].cost)[:_QUICK_REFITS]
        found = {name: fit for name, fit in found.items() if name in ahead or name == favourite}
    best = min(found.values(), key=lambda fitted: fitted.cost)
    progress(len(named), len(named) + 2)
    if not quick:
        found = _from_maps_of(coarse, alone, best, found, effects, scene)
        best = min(found.values(), key=lambda fitted: fitted.cost)
    error = estimate_errors(best, fitter.noise)
    ceiling = _ceiling(alone.cost, best.cost)
    close = [
        (name, fitted)
        for name, fitted in found.items()
        if fitted.cost <= ceiling or (quick and name == favourite)
    ]

    def again(fitted: Fitted | None) -> Fitted | None:
        if fitted is None:
            return fitter.base(error, base)
        return fitter.with_effects(fitted.effects, error, fitted, fitted.values)

    plain, *refitted = side_by_side([partial(again, fitted) for fitted in (None, *(fit for _, fit in close))])
    assert plain is not None
    fits = {name: fit for (name, _), fit in zip(close, refitted, strict=True) if fit is not None}
    progress(len(named) + 2, len(named) + 2)
    return Refits(plain, fits, {name: plain.cost - fitted.cost for name, fitted in fits.items()})


def _from_maps_of(
    fitter: Fitter,
    base: Fitted,
    best: Fitted,
    found: dict[str, Fitted],
    effects: Sequence[Effect],
    scene: Scene,
) -> dict[str, Fitted]:
    """Candidates refitted once more from the maps of the best refit, where that explains the pushes better.

    Maps that were bent to do without any effect may lead the search for the right one into a valley, and
    that for an effect that acts much like it past this valley. Where the best one has several starts, it is
    refitted too, from the maps of the base: the start that gains most to first order may lead into another
    valley than the true one.

    Args:
        base: the model without effects.
        found: refits so far, by name.
    """
    worth = _ceiling(base.cost, best.cost)
    starts = {effect: effect.start_values(scene) for effect in effects}
    tried = {effect: own for effect, own in starts.items() if effect not in best.effects or len(own) > 1}

    def again(effect: Effect) -> Fitted | None:
        with suppress(RolloutError, np.linalg.LinAlgError):
            near = base if effect in best.effects else best
            return fitter.from_maps_of(near, effect, tried[effect], worth)
        return None

    better = dict(found)
    for effect, fitted in zip(tried, side_by_side([partial(again, effect) for effect in tried]), strict=True):
        known = found.get(effect.name)
        if fitted is not None and (known is None or fitted.cost < known.cost):
            better[effect.name] = fitted
    return better


def _ceiling(base: float, best: float) -> float:
    """Cost up to which a candidate is refitted again, from that without effects and the best so far."""
    return best + _WORTH_REFITTING * max(base - best, _WORTH_REFITTING_GAIN)


def better_base(fitter: Fitter, refits: Refits) -> Fitted | None:
    """The model without effects, refitted from the maps of the best refit, if that explains the data better.

    The effect then helped the search, not the model. None also where no fit gets away from these maps.
    """
    if not refits.fits:
        return None
    best = min(refits.fits.values(), key=lambda fitted: fitted.cost)
    with suppress(RolloutError, np.linalg.LinAlgError):
        again = fitter.base(refits.plain.likelihood.error, best)
        if again.cost <= refits.plain.cost - _BETTER_BASE:
            return fitter.base(estimate_errors(again, fitter.noise), again)
    return None


def pairs(
    fitter: Fitter, first: Fitted, rest: Screening, effects: Sequence[Effect], scene: Scene
) -> Iterator[Fitted]:
    """Fits of two effects at once: a first, and those of `effects` that gain most on top of it."""
    order = [i for i in np.argsort(-rest.gain) if rest.candidates[i] in effects][:_SECONDS_TRIED]
    for i in order:
        if rest.gain[i] < _SECOND_SHARE * rest.gain.max():
            continue
        second = rest.candidates[i]
        guess = second.start_values(scene)[int(rest.start[i])]
        values = np.concatenate([first.values, guess])
        error = first.likelihood.error
        pair = fitter.with_effects((*first.effects, second), error, first, values, afresh=True)
        if pair is not None:
            yield pair


@dataclass(frozen=True, eq=False)
class EffectSearch:
    """Fits models with different effects to the same pushes, all from one fit without effects."""

    fitter: Fitter
    base: Fitted

    @classmethod
    def of(
        cls, dataset: PushDataset, observations: Sequence[Observation], progress: StageProgress
    ) -> EffectSearch:
        """Fit the model without effects.

        Raises:
            DatasetError: the pushes cannot be computed.
        """
        fitter = Fitter(dataset, observations, sensor_noise(dataset))
        return cls(fitter, fitter.from_scratch(progress))

    def find(self, effects: Sequence[Effect], rng: np.random.Generator, progress: StageProgress) -> Fitted:
        """Fit the model with all of some effects.

        Args:
            effects: at least one.

        Raises:
            DatasetError: the model with the effects cannot be fitted.
            EffectError: a formula cannot be used.
        """
        progress(0, 2)
        fitter, base = self.fitter, self.base
        scene = fitter.scene(base)
        first = screen(fitter, base, effects, len(effects), scene, 1, rng).start
        error = base.likelihood.error
        starts = [effect.start_values(scene) for effect in effects]
        guesses = [
            fitter.start_of(effect, own[int(k)], error, base)
            for effect, own, k in zip(effects, starts, first, strict=True)
        ]
        found = fitter.with_effects(effects, error, base, np.concatenate(guesses), afresh=True)
        if len(effects) == 1 and len(starts[0]) > 1:
            # As in a diagnosis: the start that gains most to first order may lead into another valley.
            with suppress(RolloutError, np.linalg.LinAlgError):
                again = fitter.from_maps_of(base, effects[0], starts[0], np.inf)
                found = again if found is None or again.cost < found.cost else found
        if found is None:
            raise DatasetError(
                f"the model with {', '.join(effect.name for effect in effects)} cannot be fitted to dataset"
                f" {fitter.dataset.name}: its rollouts do not converge, or their derivatives overflow"
            )
        progress(1, 2)
        error = estimate_errors(found, fitter.noise)
        found = fitter.with_effects(effects, error, found, found.values) or found
        progress(2, 2)
        return found
