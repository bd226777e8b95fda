"""When does a gain count? Thresholds of a diagnosis, and the rules that its verdicts follow from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from slipmap.models.effects.effect import Effect
from slipmap.models.inference.diagnosis.locked import LockedErrors
from slipmap.models.inference.diagnosis.screening import Screening
from slipmap.models.inference.push_errors import Paired
from slipmap.models.inference.results import Identification
from slipmap.models.physics.cell_grid import FloatArray

LEVEL = 0.01
"""Gains that come about by chance more seldom than this count."""

FEWEST_DRAWS = 99
"""Simulated datasets without which no p-value could reach the level."""

QUICK_GAIN = 8.0
"""Gain, in nats, that counts where chance was not simulated."""

_MATERIAL = 0.03
"""What gains less than this share on top of an effect's own gain is a matter of its exact form."""

_MATERIAL_BY_FAR = 0.01
"""The same where it gains more than `PROBE_GAIN`: effects that act like the hidden one and are not it left 28
nats and more, 1 to 3 % of their own; hidden effects themselves left up to 13, or less than 0.5 %."""

PROBE_GAIN = 20.0
"""Gain, in nats, below which a finding in the model without effects may come from the grid and the contact,
which are not exact: a probe's does not count, and an effect is not named for it."""

UNKNOWN_GAIN = 45.0
"""Gain, in nats, from which a finding that no effect explains is called unknown physics. Between this and
`PROBE_GAIN` lie what really was unknown and what an independent simulator, with nothing hidden, gained by its
own grid and contact (up to 40 nats): there the verdict is that it cannot be told."""

PAIR_GAIN = 2 * UNKNOWN_GAIN
"""Gain, in nats, that two effects have to have together when refitted. Each may hide the other from the first
question, but a faint finding that no effect explains is not two effects."""

_FAR_OFF = 2.0
"""Misfit of locked pushes, in sensor noise, that calls for an explanation."""

_FAR_ABOVE_NOISE = 3.0
"""Misfit, in sensor noise, from which no model is adequate: that of the typical push, so that one which
starts near to balance does not decide. Of simulated pushes with nothing hidden it is 1.0 to 1.6."""

_LEAST_HELP = 0.1
"""Share by which an answer has to lower it. The true effect lowers it several times over; one that bends to
a few open pushes does not."""

_REST_GAIN = 8.0
"""The same for all that is found on top of an effect, where it may come from the effect's exact form."""

_CLEARLY_WORSE = 0.02
CLEARLY_WORSE_GAIN = 40.0
"""A candidate whose gain is smaller than the best one's by this share and by so many nats is ruled out by
that alone."""

_CLEARLY_WORSE_QUICKLY = 0.1
"""The share where chance was not simulated: searches are cut short then."""

_NEARLY = 0.05
"""The share for one that predicts pushes left out better than the best."""

_FAR_WORSE = 0.6
_FAR_WORSE_GAIN = 10.0
"""The same share and nats for one that is not even asked what it leaves."""

ROUGH = 0.03
"""α above which an error model is rough: no sensor's noise, but a description of pushes that scatter."""

AGREEMENT = 0.05
"""Share of sign changes of whole pushes that may gain as much, where the error model is rough."""

FEWEST_PUSHES = 4
"""Pushes below which nothing found does not mean that nothing is there."""

_BLIND = 1.0
"""Standard deviation, in scales, above which the pushes could not have shown an effect of ordinary size."""


@dataclass(frozen=True)
class Remainder:
    """What is left to gain on top of a candidate."""

    # the effect or probe whose gain shows that the candidate does not explain the data, or None
    rejected_by: str | None
    gain: float  # of that addition, or else the largest, nats
    p_value: float | None  # of that gain; None where chance was not simulated
    clean: bool  # whether nothing at all is left


@dataclass(frozen=True)
class Rules:
    """What counts, for some candidates."""

    effects: tuple[Effect, ...]  # the named candidates; all others are probes
    simulated: bool  # whether chance was simulated, so that there are p-values

    def p_value(self, screening: Screening, gain: float) -> float | None:
        """Of a gain; None where chance was not simulated."""
        return screening.p_value(gain) if self.simulated else None

    def beyond_chance(self, screening: Screening, gain: float) -> bool:
        """Whether chance hardly gains as much."""
        return screening.p_value(gain) <= LEVEL if self.simulated else gain > QUICK_GAIN

    def found(self, screening: Screening, floor: float, probe_floor: float) -> int | None:
        """Index of the candidate whose gain counts most, or None where all of it may be chance.

        Args:
            screening: gains.
            floor: that a named effect has to exceed.
            probe_floor: that a probe has to exceed.
        """
        for i in np.argsort(-screening.gain):
            gain = float(screening.gain[i])
            if not self.beyond_chance(screening, gain):
                return None
            if gain > (floor if screening.candidates[i] in self.effects else probe_floor):
                return int(i)
        return None

    def missing(self, first: Screening) -> bool:
        """Whether the model without effects misses anything."""
        return self.found(first, 0.0, PROBE_GAIN) is not None

    def remainder(self, rest: Screening, own_gain: float) -> Remainder:
        """What is left to gain on top of a candidate that gains `own_gain` nats when refitted."""
        found = self.found(rest, _REST_GAIN, _REST_GAIN)
        top = int(np.argmax(rest.gain)) if found is None else found
        gain = float(rest.gain[top])
        share = _MATERIAL_BY_FAR if gain > PROBE_GAIN else _MATERIAL
        material = found is not None and gain >= share * own_gain
        return Remainder(
            rest.candidates[top].name if material else None, gain, self.p_value(rest, gain), found is None
        )

    def stands(self, first: Screening, name: str, fitted_gain: float) -> bool:
        """Whether a candidate's own gain is beyond chance and more than the grid's errors may feign.

        To first order, or by far when refitted.
        """
        gain = float(first.gain[[c.name for c in first.candidates].index(name)])
        return (gain > PROBE_GAIN and self.beyond_chance(first, gain)) or fitted_gain > 3 * PROBE_GAIN

    def stands_faintly(self, first: Screening, name: str, fitted_gain: float) -> bool:
        """Whether it is half of what `stands` asks, and beyond chance: then the locked pushes decide.

        Of what has nothing hidden, hardly one in forty comes so far.
        """
        gain = float(first.gain[[c.name for c in first.candidates].index(name)])
        return (
            self.simulated
            and gain > PROBE_GAIN / 2
            and fitted_gain > 3 * PROBE_GAIN / 2
            and self.beyond_chance(first, gain)
        )

    def completes(self, rest: Screening, second_gain: float) -> bool:
        """Whether a second effect that gains `second_gain` nats makes a pair that leaves nothing.

        What is left must be small beside the gain of the second effect, not only of both.
        """
        found = self.found(rest, _REST_GAIN, _REST_GAIN)
        enough = found is None or rest.gain[found] < 2 * _MATERIAL * second_gain
        return second_gain > PROBE_GAIN and bool(enough)

    def rivals_the_best(self, gain: float, best: float) -> bool:
        """Whether a refitted candidate explains about as much as the best one."""
        share = _CLEARLY_WORSE if self.simulated else _CLEARLY_WORSE_QUICKLY
        return gain > best - max(CLEARLY_WORSE_GAIN, share * best)

    def blind(self, first: Screening) -> bool:
        """Whether the pushes could not have shown most effects of ordinary size."""
        pairs = zip(first.candidates, first.sharpness, strict=True)
        seen = [sharpness for effect, sharpness in pairs if effect in self.effects]
        return sum(1 for sharpness in seen if sharpness > _BLIND) > len(seen) / 2


def worth_asking(gain: float, best: float) -> bool:
    """Whether a refitted candidate is near enough to the best one to be asked what it leaves."""
    return gain > best - max(_FAR_WORSE_GAIN, _FAR_WORSE * best)


def not_outdone(
    accepted: Sequence[str],
    left: Mapping[str, Remainder],
    gains: Mapping[str, float],
    predicted: Mapping[str, float],
) -> list[str]:
    """Those accepted: one that leaves nothing at all beats those that leave a little and explain less.

    By how much less grows with the gain, as do the errors of an effect's exact form: beside 2200 nats, 20 do
    not tell a tilted table from a far tether that pulls almost like one. One that predicts pushes left out
    better is not beaten: a richer effect fits closer.

    Args:
        accepted: names.
        left: what each leaves.
        gains: of each when refitted, nats.
        predicted: of each on pushes left out, to first order, nats.
    """
    clean = [name for name in accepted if left[name].clean]
    if not clean:
        return list(accepted)
    first = max(clean, key=lambda name: gains[name])
    least = gains[first] - max(_REST_GAIN, _CLEARLY_WORSE * gains[first])

    def stays(name: str) -> bool:
        return left[name].clean or gains[name] > least or predicted[name] > predicted[first]

    return [name for name in accepted if stays(name)]


def with_better_predictors(
    accepted: Sequence[str], gains: Mapping[str, float], predicted: Mapping[str, float]
) -> list[str]:
    """Those accepted, and any other that explains nearly as much when refitted and predicts pushes left out
    better than the best of them, although it leaves a little.

    A far tether, with six parameters, follows the small errors of a grid more closely than the tilted table
    that it imitates with two; what it predicts shows it.

    Args:
        accepted: names, not none.
        gains: of all that were refitted, nats.
        predicted: of each on pushes left out, to first order, nats.
    """
    best = max(accepted, key=lambda name: gains[name])

    def joins(name: str) -> bool:
        return gains[name] > (1.0 - _NEARLY) * gains[best] and predicted[name] > predicted[best]

    return [*accepted, *(name for name in gains if name not in accepted and joins(name))]


def objection(
    effects: Sequence[Effect],
    learnt: Identification,
    rough: bool,
    before: LockedErrors | None,
    after: LockedErrors | None,
) -> str | None:
    """What speaks against an answer that the open pushes gave, in a clause; None where nothing does.

    Args:
        effects: of the answer.
        learnt: with them, from the open pushes.
        rough: whether pushes scatter, or the answer is faint, so that chance could help the locked pushes.
        before: errors of the locked pushes without the answer.
        after: the same with it.
    """
    for effect in effects:
        if holds_null(effect, learnt):
            whose = "its" if len(effects) == 1 else f"{effect.name}'s"
            return f"{whose} 90 % interval holds nothing at all"
    if locked_pushes_object(rough, before, after):
        return "the locked pushes do not clearly become better with it"
    if locked_pushes_stay_off(before, after):
        return STAYS_OFF
    return None


STAYS_OFF = "the locked pushes are as far off with it as without"
"""The objection of `locked_pushes_stay_off`."""


def holds_null(effect: Effect, learnt: Identification) -> bool:
    """Whether the 90 % interval of every parameter at whose null an effect is nothing holds that null."""
    told = learnt.effect_estimates[effect.name]
    amplitudes = [parameter for parameter in effect.parameters if parameter.null is not None]
    return all(told[p.name]["low"] <= p.center <= told[p.name]["high"] for p in amplitudes)


def locked_pushes_object(rough: bool, before: LockedErrors | None, after: LockedErrors | None) -> bool:
    """Whether pushes that were locked away speak against an answer, or, if `rough`, not clearly for it.

    Their misfit has to fall: as a geometric mean and, where it is near to the noise, as a root mean square,
    too. Where pushes scatter, or the answer is faint, it has to fall by more than chance from push to push
    would have it.
    """
    if before is None or after is None:
        return False
    paired = Paired.of(before.misfit, after.misfit)
    if rough and len(before.misfit) > 1:
        return paired.verdict != "for"
    near = before.total_misfit < _FAR_OFF
    return paired.ratio >= 1.0 or (near and after.total_misfit >= before.total_misfit)


def locked_pushes_stay_off(before: LockedErrors | None, after: LockedErrors | None) -> bool:
    """Whether pushes that were locked away, and are far off, are nearly as far off with the answer."""
    if before is None or after is None or before.total_misfit < _FAR_OFF:
        return False
    return Paired.of(before.misfit, after.misfit).ratio > 1.0 - _LEAST_HELP


def far_above_noise(misfit: FloatArray) -> float | None:
    """The misfit of the typical push, of pushes with some (L,), where that is far above the noise."""
    typical = float(np.exp(np.log(misfit).mean())) if len(misfit) else 0.0
    return typical if typical > _FAR_ABOVE_NOISE else None
