"""Several explanations of the same pushes, each with a share of the belief.

More than numbers is unknown about an object: how much and how smoothly its maps vary (`prior.STRUCTURES`),
and which law friction follows (`friction_laws`). Each combination worth trying is fitted, and the hypotheses
are divided among them in proportion to

    p(structure) E^(1/T),    T = (rows that a push counts as) · α / 0.5 %

where E is the evidence of `hypotheses` under its best α, and α in T is that of the likeliest combination. The
evidence is tempered because it assumes that errors along a push are as independent as in the likelihood, and
that the model is right; the larger the model error, the less both hold.

Maps that vary strongly can follow the errors of a wrong law in a few pushes, and then predict badly. With
fewer than `_ENOUGH_PUSHES`, such maps count only where they explain the pushes exactly by the plain law: with
the smallest α, and with residuals no larger than that α allows.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from slipmap.models.effects.effect import Effect, columns_of
from slipmap.models.effects.library import LIBRARY
from slipmap.models.inference.belief import RIVALS, Belief
from slipmap.models.inference.friction_laws import PLAIN, beside_slope, combinations, effect_prior, name_of
from slipmap.models.inference.gauss_newton import Fits
from slipmap.models.inference.hypotheses import (
    MODEL_ERRORS,
    Draws,
    Ladder,
    draws,
    explains_exactly,
    fit_with_trust,
    log_evidence,
    refined,
    refits,
    trusted,
)
from slipmap.models.inference.likelihood import Likelihood
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.prior import (
    BOLD,
    PLAUSIBLE,
    STRUCTURES,
    MapPrior,
    PriorSettings,
    slider_for,
    structures_of,
)
from slipmap.models.measurements import Noise, PushDataset
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps, RolloutError, Slider
from slipmap.models.progress import Progress, StageProgress, part_of, shares_of, side_by_side

if TYPE_CHECKING:
    from slipmap.models.inference.diagnosis.fitting import Fitted

LEAST_SHARE = 0.05
"""Explanations with a smaller share are dropped."""

_ENOUGH_PUSHES, _MANY_PUSHES = 8, 20
"""With this many pushes every structure is weighted by its evidence; with more than this many, other laws are
not tried where the model error is largest."""


_COMPARED = 100
"""Of more than twice as many pushes, so many are used to choose laws and structures."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """A model fitted to the pushes."""

    law: str  # `plain`, or the names of its effects, see `friction_laws`
    structure: str  # of the maps, see `prior.STRUCTURES`
    ladder: Ladder  # of `fit_with_trust`
    log_evidence: float  # of the best fit in it, α's prior included; -inf where a fit failed
    given: tuple[Effect, ...] = ()  # effects besides those of the law
    share: float = 1.0  # of the belief
    fine: Ladder = field(default_factory=list)  # of `refined`, where the smallest α allows more than need be

    @property
    def likelihood(self) -> Likelihood:
        """Likelihood of the pushes, with the best α."""
        return self.ladder[-1][0]

    @property
    def best(self) -> Fits:
        """The best fit."""
        return self.ladder[-1][1]

    @property
    def model_error(self) -> float:
        """α of the best fit."""
        return self.likelihood.settings.model_error

    @property
    def exact(self) -> bool:
        """Whether the smallest α is the best, and the misfit no larger than it allows on average."""
        return self.model_error == MODEL_ERRORS[0] and explains_exactly(*self.ladder[0])

    @property
    def drawn_from(self) -> Ladder:
        """The fits that hypotheses are drawn around."""
        return self.fine or self.ladder

    @property
    def maps(self) -> Maps:
        """Maps of the best fit, one hypothesis."""
        return self.likelihood.prior.maps(self.best.z)


@dataclass(frozen=True, eq=False)
class EffectsGiven:
    """Effects of which other pushes tell something, like a `Fitted` of these pushes."""

    effects: tuple[Effect, ...]
    values: FloatArray  # (P,) expected parameters
    scales: FloatArray  # (P,) their standard deviations
    maps: Maps  # to start from, one hypothesis; its effects do not count


def on_a_slope(found: Fitted | EffectsGiven, dataset: PushDataset) -> Fitted | EffectsGiven:
    """The same effects, with what a slope brings with it; see `beside_slope`."""
    more = beside_slope(found.effects, dataset)
    if not more:
        return found
    means, deviations = effect_prior(more, dataset)
    values, scales = np.concatenate([found.values, means]), np.concatenate([found.scales, deviations])
    return EffectsGiven((*found.effects, *more), values, scales, found.maps)


def explain(
    dataset: PushDataset,
    observations: Sequence[Observation],
    settings: PriorSettings | None,
    progress: StageProgress,
    found: Fitted | EffectsGiven | None = None,
    *,
    laws: Collection[str],
) -> list[Explanation]:
    """Explanations of the pushes with their shares.

    They are chosen with long steps, and then fitted with the usual ones. Hundreds of pushes leave no doubt
    about laws and structures, so these are chosen on `_COMPARED` of them.

    Args:
        dataset: the pushes, the object and its height.
        settings: the only prior of the maps; if None, all structures that the object may have are tried.
        found: fit of the model with effects. All laws then include these effects, with priors centred on its
            values, so that nothing pulls them to their nulls where the likelihood says little.
        laws: names of the effects that laws besides the plain one may consist of.

    Returns:
        Explanations with their shares, the largest first; shares sum to one.

    Raises:
        RolloutError: not even the plain law could be fitted, or none of the chosen ones to all pushes.
    """
    some = np.arange(len(observations))
    if len(some) > 2 * _COMPARED:
        some = np.sort(np.random.default_rng(0).choice(len(observations), _COMPARED, replace=False))
    few, first = [observations[b] for b in some.tolist()], part_of(progress, 0, 2)
    compared = partial(_compared, dataset, laws=laws)
    try:
        chosen = compared([one.with_long_steps for one in few], settings, first, found)
    except (RolloutError, np.linalg.LinAlgError):  # the usual ones may do
        chosen = compared(few, settings, first, found)

    def later(done: int, total: int) -> None:
        progress(total + done, 2 * total)

    every: list[Explanation] = []
    for place, one in enumerate(chosen):
        prior, own = one.likelihood.prior, part_of(later, place, len(chosen))
        try:
            ladder = fit_with_trust(prior, observations, dataset.noise, one.best.z, own, near=one.ladder)
        except (RolloutError, np.linalg.LinAlgError):
            if not every and one is chosen[-1]:
                raise
            continue
        every.append(Explanation(one.law, one.structure, ladder, _evidence(ladder), one.given))
    progress(1, 1)
    return shared_out(every)


def with_fine_fits(every: Sequence[Explanation], noise: Noise) -> list[Explanation]:
    """The explanations, the exact ones with the fits of `refined`."""
    fine = side_by_side([partial(refined, one.ladder, noise) for one in every if one.exact])
    found = iter(fine)
    return [replace(one, fine=next(found)) if one.exact else one for one in every]


def _compared(
    dataset: PushDataset,
    observations: Sequence[Observation],
    settings: PriorSettings | None,
    progress: StageProgress,
    found: Fitted | EffectsGiven | None,
    *,
    laws: Collection[str],
) -> list[Explanation]:
    """Fit the plain law with every structure, and the other laws with the usual one; as `explain`.

    The usual structure is the first, or `smooth` if the smallest α suits the first best. With at least
    `_ENOUGH_PUSHES`, the likeliest law is fitted with every structure too.
    """
    given = () if found is None else found.effects
    structures = {"own": settings} if settings is not None else structures_of(dataset)
    others = combinations(dataset, given, laws)
    # A second law may be tried with these too.
    besides = [name for name in list(structures)[1:] if name != "smooth"]
    shares = iter(shares_of(progress, len(structures) + len(others) + (len(besides) if others else 0)))

    def fitted(law: Sequence[Effect], structure: str, known: Sequence[Explanation]) -> list[Explanation]:
        """The fit of a law and structure, from the best known fit of the law, else of the plain law, else
        from uniform objects; none where this one fails but another is known."""
        means, deviations = effect_prior(law, dataset)
        if found is not None:
            means = np.concatenate([found.values, means])
            deviations = np.concatenate([found.scales, deviations])
        slider = slider_for(dataset, (*given, *law))
        prior = MapPrior(
            slider, structures[structure], dataset.mass,
            effect_prior=(means, deviations), known=dataset.known,
        )  # fmt: skip
        name = name_of(law)
        if known:
            best = max(known, key=lambda one: (one.law == name, one.log_evidence)).maps
            more = prior.effect_centers[best.effects.shape[1] :]
            best = replace(best, effects=np.concatenate([best.effects, more[None]], axis=1))
            starts = np.array([prior.start(float(best.mu_finger[0])), *prior.moved(best)])
        else:
            starts = prior.starts()
            if found is not None:
                starts = np.concatenate([starts, prior.near(found.maps)])
        only_exact = structure in BOLD and len(observations) < _ENOUGH_PUSHES
        own = next(shares)
        try:
            ladder = fit_with_trust(prior, observations, dataset.noise, starts, own, only_exact=only_exact)
        except (RolloutError, np.linalg.LinAlgError):
            if not known:
                raise
            return []
        finally:
            own(1, 1)
        return [Explanation(name, structure, ladder, _evidence(ladder), given)]

    def chain(law: Sequence[Effect], usual: Explanation) -> list[Explanation]:
        """Fits of a law with the structures besides the usual one, each from the best so far."""
        chained = [usual]
        for structure in besides:
            chained += fitted(law, structure, chained)
        return chained[1:]

    every = fitted((), next(iter(structures)), [])
    if "smooth" in list(structures)[1:] and every[0].model_error == MODEL_ERRORS[0]:
        every = fitted((), "smooth", every) or every
    plain = every[0]
    if plain.model_error == MODEL_ERRORS[-1] and len(observations) > _MANY_PUSHES:
        # The other laws could not be distinguished from the plain one, and would take long.
        others = []
    enough = len(observations) >= _ENOUGH_PUSHES
    of_laws = [partial(fitted, law, plain.structure, [plain]) for law in others]
    of_structures = [partial(chain, (), plain)]
    if enough:
        for own in side_by_side(of_laws):
            every += own
        likeliest = _likeliest(every)
        if likeliest is not plain:
            (law,) = (law for law in others if name_of(law) == likeliest.law)
            of_structures.append(partial(chain, law, likeliest))
        of_laws = []
    every += [one for own in side_by_side([*of_structures, *of_laws]) for one in own]
    progress(1, 1)
    return shared_out(every)


def _evidence(ladder: Ladder) -> float:
    """Log evidence of the best fit, α's prior included; -inf if it cannot be computed."""
    likelihood, last = ladder[-1]
    evidence = log_evidence(likelihood, last) - float(np.log(likelihood.settings.model_error))
    return evidence if np.isfinite(evidence) else -np.inf


def _admitted(every: Sequence[Explanation]) -> list[Explanation]:
    """Explanations that this number of pushes can support."""
    if len(every[0].likelihood.observations) >= _ENOUGH_PUSHES:
        return list(every)
    # Fitted again with the usual steps, the only one that was chosen may not be exact by a hair.
    return [one for one in every if one.structure not in BOLD or (one.law == PLAIN and one.exact)] or list(
        every
    )


def bold_compared(every: Sequence[Explanation]) -> bool:
    """Whether structures that vary strongly were among those compared, or the structure was given."""
    enough = len(every[0].likelihood.observations) >= _ENOUGH_PUSHES
    exact = any(one.law == PLAIN and one.exact for one in every)
    return enough or exact or any(one.structure not in STRUCTURES for one in every)


def _likeliest(every: Sequence[Explanation]) -> Explanation:
    return max(_admitted(every), key=lambda one: one.log_evidence)


def weighed(every: Sequence[Explanation]) -> list[Explanation]:
    """Explanations with their shares, 0 for those below `LEAST_SHARE`."""
    best = _likeliest(every)
    rows = best.likelihood.rows_counted / len(best.likelihood.observations)
    temperature = rows * best.model_error / MODEL_ERRORS[0]
    evidence = np.array([one.log_evidence for one in every])
    shares = np.array([PLAUSIBLE.get(one.structure, 1.0) for one in every])
    if np.isfinite(best.log_evidence):
        shares = shares * np.exp((evidence - best.log_evidence) / temperature)
    shares /= shares.sum()
    shares = np.where(shares < LEAST_SHARE, 0.0, shares)
    shares /= shares.sum()
    return [replace(one, share=float(share)) for one, share in zip(every, shares, strict=True)]


def shared_out(every: Sequence[Explanation]) -> list[Explanation]:
    """Explanations with their shares, the largest first, without those below `LEAST_SHARE`."""
    kept = [one for one in weighed(_admitted(every)) if one.share > 0]
    return sorted(kept, key=lambda one: -one.share)


def mixed_belief(
    dataset: PushDataset,
    every: Sequence[Explanation],
    hypotheses: int,
    seed: int,
    report: Progress,
) -> Belief:
    """Randomised refits around several explanations, each with its share of the hypotheses.

    Args:
        dataset: whose pushes were fitted.
        every: of `explain`, or of several models together, the largest share first.
        hypotheses: K.
        seed: of the draws.

    Returns:
        Hypotheses that carry the parameters of the given effects, then those of every law's effects; all are
        at their nulls where a hypothesis' own model lacks them.
    """
    every = every[:hypotheses]
    shares = np.array([one.share for one in every]) / sum(one.share for one in every)
    rng = np.random.default_rng(seed)
    tasks, parts_done = [], shares_of(partial(report, "hypotheses"), len(every))
    for place, (one, size) in enumerate(zip(every, _counts(shares, hypotheses), strict=True)):
        drawn = draws(one.drawn_from, size, rng, keep_best=place == 0)
        tasks.append(partial(_refitted, one.drawn_from, drawn, parts_done[place]))
    found = side_by_side(tasks)
    kept = [
        (one, float(share), *learned)
        for one, share, learned in zip(every, shares, found, strict=True)
        if learned is not None
    ]
    if not kept:
        raise RolloutError("no law of friction could be fitted to the pushes weighted at random")
    parts = [(maps, one.likelihood.prior.slider.effects) for one, _, maps, _ in kept]
    models = _by([name_of(one.given) for one, *_ in kept], [one[1] for one in kept])
    probability = [share * weights for _, share, _, weights in kept]
    total = sum(share for _, share, _, _ in kept)
    given = tuple(dict.fromkeys(effect for one, *_ in kept for effect in one.given))
    of_laws = [e for e in LIBRARY if e not in given and any(e in effects for _, effects in parts)]
    used = (*given, *of_laws)
    carried = [_with_parameters(maps, effects, used) for maps, effects in parts]
    likelihood = every[0].likelihood
    chosen_on = {"laws_chosen_on": _COMPARED} if len(likelihood.observations) > 2 * _COMPARED else {}
    own = likelihood.prior.slider
    slider = Slider(own.grid, own.finger_radius, own.gravity, own.smoothing, used, own.table)
    names = ("mass", "mu", "mu_finger", "effects")
    together = Maps(*(np.concatenate([getattr(maps, name) for maps in carried]) for name in names))
    return Belief.learned(
        dataset,
        slider,
        together,
        np.concatenate(probability) / total,
        method="gauss-newton",
        seed=seed,
        trials=[observation.trial for observation in likelihood.observations],
        settings={
            **trusted(every[0].drawn_from),
            **chosen_on,
            **({RIVALS: models} if len(models) > 1 else {}),
            "friction_laws": _by([one.law for one, *_ in kept], [one[1] for one in kept]),
            "structures": _by([one.structure for one, *_ in kept], [one[1] for one in kept]),
        },
    )


def _refitted(ladder: Ladder, drawn: Draws, progress: StageProgress) -> tuple[Maps, FloatArray] | None:
    """Result of `refits`, or None where it fails: refits lead to wilder maps than fits do, and the belief
    can do without one explanation."""
    try:
        return refits(ladder, drawn, progress)
    except (RolloutError, np.linalg.LinAlgError):
        return None


def _by(names: Sequence[str], shares: Sequence[float]) -> dict[str, float]:
    """Share of the whole by name, the largest first."""
    total = math.fsum(shares)
    pairs = list(zip(names, shares, strict=True))
    sums = {key: math.fsum(share for name, share in pairs if name == key) / total for key in names}
    return dict(sorted(sums.items(), key=lambda item: -item[1]))


def _with_parameters(maps: Maps, effects: Sequence[Effect], used: Sequence[Effect]) -> Maps:
    """The maps with parameters of all used effects, at their nulls for effects that the maps lack."""
    by_effect = {effect: maps.effects[:, columns_of(effect, effects)] for effect in effects}
    columns = [by_effect.get(effect, np.repeat(effect.nulls[None], len(maps), axis=0)) for effect in used]
    return Maps(
        maps.mass, maps.mu, maps.mu_finger, np.concatenate([np.zeros((len(maps), 0)), *columns], axis=1)
    )


def _counts(shares: FloatArray, hypotheses: int) -> list[int]:
    """Number of hypotheses for each share, at least one; there are no more shares than hypotheses."""
    counts = [max(1, int(share * hypotheses)) for share in shares]
    while sum(counts) > hypotheses:
        counts[int(np.argmax(counts))] -= 1
    while sum(counts) < hypotheses:
        behind = [share * hypotheses - count for share, count in zip(shares, counts, strict=True)]
        counts[int(np.argmax(behind))] += 1
    return counts
