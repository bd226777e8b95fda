"""What friction may follow besides the plain law, and how much the pushes speak for it.

The plain model lets each cell carry the weight of its mass, however it is pushed, and slide against Coulomb's
friction. Two things are left out that hold for some recorded pushes and not for others:

- a finger that pushes above the table loads the object's front, by about its height times friction. How
  high the finger was is seldom recorded; half the object's height is the guess;
- a simulator that solves for friction impulse by impulse makes it lean to the axis of the world along which
  an impulse meets more mass, as Bullet's solver for articulated bodies does.

All combinations that the dataset allows (load transfer needs the object's height and mass) are fitted, each
from where the plain law led, and hypotheses of a belief are shared out among them in proportion to

    evidence^(1/T),    T = TEMPERATURE α / 0.5 %

with the evidence of `hypotheses`. It is tempered because it holds errors along a push for as independent as
the likelihood does, and the likelihood's model for the right one; neither is so, the less the further the
best law is off, by a share α of the way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slipmap.models.effects.effect import Effect, bounds
from slipmap.models.effects.library import LIBRARY
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.hypotheses import (
    MODEL_ERRORS,
    Ladder,
    fit_with_trust,
    log_evidence,
    refits,
    trusted,
)
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.prior import MapPrior, PriorSettings, slider_for
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps, RolloutError, Slider
from slipmap.models.progress import Progress, StageProgress, part_of

if TYPE_CHECKING:
    from slipmap.models.inference.diagnosis.fitting import Fitted

PLAIN = "plain"

TOGETHER = " + "
"""Between the effects in a law's name."""

TEMPERATURE = 4.0

LEAST_SHARE = 0.05
"""A law with less than this is left out."""

_EXPECTED = {
    "push_height": (0.5, 0.15),
    "mass_height": (0.5, 0.05),
    "share": (1.0, 0.01),
}
"""Prior mean and standard deviation of the laws' parameters; heights in those of the object. Friction leans
as in Bullet, or not at all."""


@dataclass(frozen=True, eq=False)
class Law:
    """A law of friction, fitted.

    Attributes:
        name: `plain`, or the names of its effects joined by `TOGETHER`.
        ladder: of `fit_with_trust`.
        log_evidence: of the best fit in it, α's prior included.
        share: of the belief.
    """

    name: str
    ladder: Ladder
    log_evidence: float
    share: float

    @property
    def model_error(self) -> float:
        """α of the best fit."""
        return self.ladder[-1][0].settings.model_error


def effect_prior(effects: Sequence[Effect], height: float | None) -> tuple[FloatArray, FloatArray]:
    """Prior means and standard deviations (P,) of the laws' parameters, for an object of some height, m."""
    every = [parameter for effect in effects for parameter in effect.parameters]
    if not every:
        return np.zeros(0), np.zeros(0)
    units = [height if parameter.unit == "m" else 1.0 for parameter in every]
    rows = np.array([_EXPECTED[parameter.name] for parameter in every])
    means, deviations = (rows * np.array(units, dtype=float)[:, None]).T
    return np.clip(means, *bounds(effects)), deviations


def fit_laws(
    dataset: PushDataset,
    observations: Sequence[Observation],
    settings: PriorSettings,
    finger_frictions: Sequence[float],
    progress: StageProgress,
    found: Fitted | None = None,
    *,
    plain_only: bool,
) -> list[Law]:
    """Fit the plain law from several starts, the others from where it led, and share the belief out.

    Args:
        dataset: the pushes, the object and its height.
        observations: pushes to learn from.
        settings: strength of the prior of the maps.
        finger_frictions: of the uniform objects for the plain law to start from.
        progress: called with (done, total).
        found: fit of the model with effects, which all laws then have too, around the values that it found:
            nothing pulls them to their nulls any more where the forgiving likelihood sees little of them.
        plain_only: whether to leave the other laws alone.

    Returns:
        The laws that have a share, the largest first; shares sum to one.
    """
    given = () if found is None else found.effects
    combinations: list[tuple[Effect, ...]] = [()] if plain_only else _combinations(dataset, given)
    laws: list[Law] = []
    for place, effects in enumerate(combinations):
        means, deviations = effect_prior(effects, dataset.height)
        if found is not None:
            means = np.concatenate([found.values, means])
            deviations = np.concatenate([found.likelihood.prior.effect_scales, deviations])
        slider = slider_for(dataset, (*given, *effects))
        prior = MapPrior(slider, settings, dataset.mass, effect_prior=(means, deviations))
        if effects:
            best = laws[0].ladder[-1][1]
            begin = np.concatenate([best.z, np.zeros((1, prior.size - best.z.shape[1]))], axis=1)
        else:
            begin = np.array([prior.start(friction) for friction in finger_frictions])
            if found is not None:
                begin = np.concatenate([begin, prior.near(found.maps)])
        report = part_of(progress, place, len(combinations))
        try:
            ladder = fit_with_trust(prior, observations, dataset.noise, begin, report)
        except (RolloutError, np.linalg.LinAlgError):
            if not effects:
                raise
            continue
        likelihood, last = ladder[-1]
        evidence = log_evidence(likelihood, last) - float(np.log(likelihood.settings.model_error))
        laws.append(Law(TOGETHER.join(effect.name for effect in effects) or PLAIN, ladder, evidence, 1.0))
    progress(1, 1)
    return shared_out(laws, _temperature(laws))


def _temperature(laws: Sequence[Law]) -> float:
    """By which evidence is tempered: `TEMPERATURE`, the more the law of most evidence is held to be off."""
    likeliest = max(laws, key=lambda law: np.nan_to_num(law.log_evidence, nan=-np.inf))
    return TEMPERATURE * likeliest.model_error / MODEL_ERRORS[0]


def shared_out(laws: Sequence[Law], temperature: float = TEMPERATURE) -> list[Law]:
    """The laws with their shares, the largest first, without those below `LEAST_SHARE`, and without those
    whose evidence is no number."""
    laws = [law for law in laws if np.isfinite(law.log_evidence)] or list(laws[:1])
    if len(laws) == 1:
        return [replace(laws[0], share=1.0)]
    evidence = np.array([law.log_evidence for law in laws])
    shares = np.exp((evidence - evidence.max()) / temperature)
    shares /= shares.sum()
    shares = np.where(shares < LEAST_SHARE, 0.0, shares)
    shares /= shares.sum()
    kept = [replace(law, share=float(share)) for law, share in zip(laws, shares, strict=True) if share > 0]
    return sorted(kept, key=lambda law: -law.share)


def _combinations(dataset: PushDataset, given: Sequence[Effect]) -> list[tuple[Effect, ...]]:
    """Effects of each law that the dataset can be asked about beside the given ones, the plain one first."""
    known = {effect.name: effect for effect in LIBRARY}
    transfer, lean = known["load_transfer"], known["impulse_friction"]
    # The load shifts by height times force over weight: of an object that nobody weighed, other faults of the
    # model would be taken for a small weight.
    if dataset.height is None or dataset.mass is None:
        laws: list[tuple[Effect, ...]] = [(), (lean,)]
    else:
        laws = [(), (lean,), (transfer,), (transfer, lean)]
    return [law for law in laws if not set(law) & set(given)]


def mixed_belief(
    dataset: PushDataset,
    laws: Sequence[Law],
    given: Sequence[Effect],
    hypotheses: int,
    seed: int,
    report: Progress,
    *,
    settings: Mapping[str, Any],
) -> Belief:
    """Randomised refits under several laws of friction, each with its share of the hypotheses.

    Args:
        dataset: whose pushes were fitted.
        laws: of `fit_laws`.
        given: effects that all laws have.
        hypotheses: K.
        seed: of the draws.
        report: called with (stage, done, total).
        settings: what else the belief keeps on record.

    Returns:
        Hypotheses that carry the parameters of the given effects, then those of all that any law has, at
        their nulls where their own has not.
    """
    laws = laws[:hypotheses]
    shares = np.array([law.share for law in laws]) / sum(law.share for law in laws)
    counts = _counts(shares, hypotheses)
    rng = np.random.default_rng(seed)
    parts: list[tuple[Maps, tuple[Effect, ...]]] = []
    probability: list[FloatArray] = []
    kept: dict[str, float] = {}
    done = 0
    for law, count, share in zip(laws, counts, shares, strict=True):
        effects = law.ladder[0][0].prior.slider.effects

        def progress(made: int, total: int, done: int = done, count: int = count) -> None:
            report("hypotheses", total * done + count * made, total * hypotheses)

        done += count
        try:
            maps, weights = refits(law.ladder, count, rng, progress)
        except (RolloutError, np.linalg.LinAlgError):
            # Refits lead to wilder maps than fits do; the other laws can do without this one.
            if len(effects) == len(given):
                raise
            continue
        parts.append((maps, effects))
        probability.append(share * weights)
        kept[law.name] = float(share)
    if not kept:
        raise RolloutError("no law of friction could be fitted to the pushes weighted at random")
    total = sum(kept.values())
    of_laws = [e for e in LIBRARY if e not in given and any(e in effects for _, effects in parts)]
    used = (*given, *of_laws)
    carried = [_with_parameters(maps, effects, used) for maps, effects in parts]
    heaviest = laws[0].ladder
    own = heaviest[0][0].prior.slider
    slider = Slider(own.grid, own.finger_radius, own.gravity, own.smoothing, used, own.table)
    names = ("mass", "mu", "mu_finger", "effects")
    together = Maps(*(np.concatenate([getattr(maps, name) for maps in carried]) for name in names))
    shared = {"friction_laws": {name: share / total for name, share in kept.items()}}
    return Belief.learnt(
        dataset,
        slider,
        together,
        np.concatenate(probability) / total,
        method="gauss-newton",
        seed=seed,
        trials=[observation.trial for observation in heaviest[0][0].observations],
        settings={**settings, **trusted(heaviest), **shared},
    )


def _with_parameters(maps: Maps, effects: Sequence[Effect], used: Sequence[Effect]) -> Maps:
    """The maps with parameters of all used effects, at their nulls where they have none of their own."""
    own = np.split(maps.effects, np.cumsum([len(effect.parameters) for effect in effects]), axis=1)
    by_effect = dict(zip(effects, own, strict=False))
    columns = [by_effect.get(effect, np.repeat(effect.nulls[None], len(maps), axis=0)) for effect in used]
    return Maps(
        maps.mass, maps.mu, maps.mu_finger, np.concatenate([np.zeros((len(maps), 0)), *columns], axis=1)
    )


def _counts(shares: FloatArray, hypotheses: int) -> list[int]:
    """How many hypotheses each share gets, at least one; there are no more shares than hypotheses."""
    counts = [max(1, int(share * hypotheses)) for share in shares]
    while sum(counts) > hypotheses:
        counts[int(np.argmax(counts))] -= 1
    while sum(counts) < hypotheses:
        behind = [share * hypotheses - count for share, count in zip(shares, counts, strict=True)]
        counts[int(np.argmax(behind))] += 1
    return counts
