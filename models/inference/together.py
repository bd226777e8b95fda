"""One model of several datasets: objects with separate maps, and effects of what they share.

The coordinates are those of every object's maps, one after the other, then those of the effects: once where
the datasets share the effect's owner (`Effect.belongs_to`), otherwise once for each dataset; last come those
of what a slope brings with it in each dataset, which are free like maps (`Together.refined`). The normal
equations are sums over the datasets with a block arrow structure; they are small compared with the rollouts,
so they are solved as one dense matrix, and the time of a fit is proportional to its pushes. The likelihood is
the forgiving one, with the α of largest evidence for each dataset, so that a push near balance does not
outweigh all others. Effects are looked for with the α of the model without them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from slipmap.models.effects.effect import Effect, Scene
from slipmap.models.inference import friction_laws
from slipmap.models.inference.gauss_newton import Fits, fit
from slipmap.models.inference.hypotheses import fit_with_trust
from slipmap.models.inference.likelihood import Likelihood, LikelihoodSettings, NormalEquations
from slipmap.models.inference.observations import Observation, scene_of
from slipmap.models.inference.prior import EffectCoordinates, MapPrior, slider_for, structures_of
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.progress import StageProgress, part_of

_EXACT = 1e-3
"""Standard deviation of a held parameter, as a share of its scale."""

_SCREENED = 20
"""Most pushes of a dataset used to find the effects that are worth refitting."""

_START_STEPS = 3

_TOLD = 0.5
"""Standard deviation, in scales, up to which the pushes bound a parameter rather than its prior."""

_BLIND = 1e3
"""Standard deviation, in scales, of a parameter that a dataset does not determine."""

_OPEN, _HELD = 1e2, 1e-3
"""What one dataset says alone: standard deviations, in scales, of amplitudes, left to the pushes, and of held
parameters."""

_ITERATIONS, _TOLERANCE = 15, 1e-4
"""The same: most iterations, and the share of the cost below which a step ends them, hundredths of a nat."""


def is_shared(effect: Effect, apart: Collection[str]) -> bool:
    """Whether several datasets share an effect's parameters.

    Args:
        apart: owners of effects (`Effect.belongs_to`) that the datasets do not share.
    """
    return effect.belongs_to != "object" and effect.belongs_to not in apart


@dataclass(frozen=True, eq=False)
class Taught:
    """The open pushes of one dataset, and the fit of the model without effects to them."""

    dataset: PushDataset
    observations: Sequence[Observation]  # its open pushes
    settings: LikelihoodSettings  # with the α of largest evidence
    base: Fits  # one hypothesis

    @classmethod
    def of(cls, dataset: PushDataset, observations: Sequence[Observation], progress: StageProgress) -> Taught:
        """Fit the model without effects.

        Raises:
            RolloutError: it cannot be computed.
        """
        prior = _prior(dataset, (), None)
        likelihood, best = fit_with_trust(prior, observations, dataset.noise, prior.starts(), progress)[-1]
        return cls(dataset, observations, likelihood.settings, best)

    def few(self, most: int) -> Taught:
        """The same with at most this many pushes, spread evenly."""
        kept = self.evenly(most)
        base = replace(self.base, offsets=self.base.offsets[:, kept])
        return replace(self, observations=[self.observations[b] for b in kept], base=base)

    def evenly(self, most: int) -> NDArray[np.int64]:
        """Places of at most this many pushes, spread evenly."""
        count = len(self.observations)
        return np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))

    @property
    def weight(self) -> float:
        """Weight of the object in the first fit, N."""
        return float(self.prior.maps(self.base.z).mass.sum()) * self.dataset.gravity

    def likelihood(self, effects: Sequence[Effect], weight: float) -> Likelihood:
        """Likelihood of the model with some effects; the weight sets the scale of effects that are forces."""
        prior = _prior(self.dataset, effects, weight)
        return Likelihood(prior, self.observations, self.dataset.noise, self.settings)

    def holding(
        self, effects: Sequence[Effect], values: FloatArray, free: NDArray[np.bool_], progress: StageProgress
    ) -> tuple[MapPrior, FloatArray]:
        """Maps fitted with the effects' parameters (P,) held, except the free ones: the prior, and the
        coordinates (d,) in it."""
        scales = _prior(self.dataset, effects, self.weight).effect_scales
        spread = np.where(free, scales, _EXACT * scales)
        prior = _prior(self.dataset, effects, self.weight, (values, spread), slopes=True)
        likelihood = Likelihood(prior, self.observations, self.dataset.noise, self.settings)
        start = np.concatenate([self.base.z[0], np.zeros(prior.size - prior.plain)])
        return prior, fit(likelihood, start[None], offsets=self.base.offsets, progress=progress).z[0]

    def costs(self, observations: Sequence[Observation], prior: MapPrior, z: FloatArray) -> FloatArray:
        """(B,) costs of other pushes at coordinates z (d,), nats; starts are free within tracker noise, so
        that a push near balance is not overrated."""
        likelihood = Likelihood(prior, observations, self.dataset.noise, self.settings)
        offsets, weights = np.zeros((1, len(observations), 3)), np.ones((1, len(observations)))
        best = np.full(len(observations), np.inf)
        for _ in range(_START_STEPS):
            found = likelihood.linearise(z[None], offsets, np.ones(1), weights)
            best = np.minimum(best, found.cost[0])
            step = np.einsum("bij,bj->bi", found.start_gain[:, 0], found.start_gradient[:, 0])
            offsets = np.clip(offsets - step, -4.0 * likelihood.start_sigma, 4.0 * likelihood.start_sigma)
        return best

    @property
    def prior(self) -> MapPrior:
        """Prior of the model without effects."""
        return _prior(self.dataset, (), None)

    @property
    def widening(self) -> float:
        """Typical size of the pushes' errors over that of the residuals that the fitted maps left."""
        rows = self.likelihood((), self.weight).degrees
        hessian = self.base.hessian[0]
        spent = float(np.trace(np.linalg.solve(hessian + np.eye(len(hessian)), hessian)))
        return float(np.sqrt(rows / max(rows - spent, 1.0)))


def _prior(
    dataset: PushDataset,
    effects: Sequence[Effect],
    weight: float | None,
    effect_prior: tuple[FloatArray, FloatArray] | None = None,
    *,
    slopes: bool = False,
) -> MapPrior:
    settings = next(iter(structures_of(dataset).values()))  # the one that `identify` tries first
    more = friction_laws.beside_slope(effects, dataset) if slopes else ()
    prior = MapPrior(
        slider_for(dataset, (*effects, *more)), settings, dataset.mass, weight, known=dataset.known
    )
    P = _parameters(effects)
    if effect_prior is not None:
        prior.effect_centers[:P], prior.effect_scales[:P] = effect_prior
    prior.effect_centers[P:], prior.effect_scales[P:] = friction_laws.effect_prior(more, dataset)
    return prior


def _parameters(effects: Sequence[Effect]) -> int:
    return sum(len(effect.parameters) for effect in effects)


class JointPrior(EffectCoordinates):
    """Joint coordinates of several datasets' maps and of effects.

    Args:
        priors: of each dataset, with the same effects at the same scales, and perhaps more of its own.
        effects: those of all datasets, which come first.
        apart: as for `is_shared`.

    Attributes:
        places: (d_k,) indices of each dataset's own coordinates among the joint ones.
    """

    def __init__(self, priors: Sequence[MapPrior], effects: Sequence[Effect], apart: Collection[str]) -> None:
        begins = np.cumsum([0, *(prior.plain for prior in priors)])
        self.plain = int(begins[-1])
        places = [[np.arange(begin, end)] for begin, end in pairwise(begins)]
        size = self.plain
        for effect in effects:
            count = len(effect.parameters)
            for k, place in enumerate(places):
                size += count if k == 0 or not is_shared(effect, apart) else 0
                place.append(np.arange(size - count, size))
        for prior, place in zip(priors, places, strict=True):
            more = prior.size - prior.plain - _parameters(effects)
            place.append(np.arange(size, size + more))
            size += more
        self.places = [np.concatenate(place) for place in places]
        self.effect_centers, self.effect_scales, low, high = np.zeros((4, size - self.plain))
        self.effect_bounds, self.amplitudes = (low, high), np.zeros(size - self.plain, dtype=bool)
        for prior, every in zip(priors, self.places, strict=True):
            own = every[prior.plain :] - self.plain
            self.effect_centers[own], self.effect_scales[own] = prior.effect_centers, prior.effect_scales
            low[own], high[own] = prior.effect_bounds
            self.amplitudes[own] = prior.amplitudes


class JointLikelihood:
    """Costs of the pushes of several datasets, like `PushLikelihood` for one."""

    def __init__(self, prior: JointPrior, parts: Sequence[Likelihood]) -> None:
        self.prior = prior
        self.parts = list(parts)
        self.observations: Sequence[Observation] = [o for part in parts for o in part.observations]
        self.start_sigma = np.concatenate([part.start_sigma for part in parts])
        ends = np.cumsum([0, *(len(part.observations) for part in parts)])
        self.pushes = [slice(int(begin), int(end)) for begin, end in pairwise(ends)]

    def linearise(
        self, z: FloatArray, offsets: FloatArray, strength: FloatArray, weights: FloatArray
    ) -> NormalEquations:
        """Costs and normal equations at coordinates z (K, d) and start offsets (K, B, 3)."""
        K, d, B = len(z), self.prior.size, len(self.observations)
        cost, hessian, gradient = np.zeros((K, B)), np.zeros((K, d, d)), np.zeros((K, d))
        gain, slope, coupling = np.zeros((B, K, 3, 3)), np.zeros((B, K, 3)), np.zeros((B, K, d, 3))
        for part, place, own in zip(self.parts, self.prior.places, self.pushes, strict=True):
            found = part.linearise(z[:, place], offsets[:, own], strength, weights[:, own])
            cost[:, own] = found.cost
            hessian[:, place[:, None], place] += found.hessian
            gradient[:, place] += found.gradient
            gain[own], slope[own] = found.start_gain, found.start_gradient
            coupling[own, :, place] = found.coupling
        return NormalEquations(cost, hessian, gradient, gain, slope, coupling)


@dataclass(frozen=True, eq=False)
class FirstGain:
    """Gain of an effect to first order, from the best of its starts."""

    effect: Effect
    gain: float  # drop in cost, nats
    evidence: float  # the same less what the parameters would gain anyway (Laplace)
    start: FloatArray  # (P,) parameters, the amplitudes at their nulls
    p_value: float | None  # share of random signs under which the largest gain of all is at least its own


class Together:
    """The model of several datasets.

    Args:
        apart: owners of effects that they do not share.
        weight: scale of effects that are forces, one for all datasets, N; the objects' mean weight if None.
    """

    def __init__(
        self, taught: Sequence[Taught], apart: Collection[str] = (), weight: float | None = None
    ) -> None:
        self.taught = list(taught)
        self.apart = frozenset(apart)
        self.weight = weight or float(np.exp(np.mean(np.log([one.weight for one in taught]))))
        self.base_cost = sum(float(one.base.cost[0]) for one in taught)
        self._offsets = np.concatenate([one.base.offsets for one in taught], axis=1)

    def is_shared(self, effect: Effect) -> bool:
        """Whether the datasets share the effect's parameters."""
        return is_shared(effect, self.apart)

    def scene(self) -> Scene:
        """The scene from which effects derive their starting values."""
        observations = [o for one in self.taught for o in one.observations]
        return scene_of(observations, [one.dataset.grid for one in self.taught], self.weight)

    def first_gains(
        self,
        effects: Sequence[Effect],
        progress: StageProgress,
        draws: int = 0,
        rng: np.random.Generator | None = None,
        beside: JointFit | None = None,
    ) -> list[FirstGain]:
        """Gain of each effect with all maps refitted, to first order, from at most `_SCREENED` pushes per
        dataset; first those of the largest evidence (the gain, less what the parameters would gain anyway).

        By chance alone, the residuals of any push could equally well have had the opposite sign. So the
        p-values compare with the largest gain over all effects when whole pushes change sign at random. The
        prior's pull balances only the signs of the data, so it is left out of both. The fitted maps have
        already taken their share of the residuals, and take it again from residuals that have changed sign;
        so these are widened first.

        Args:
            draws: random sign patterns for the p-values; without any there are none.
            rng: of the signs.
            beside: a model `around` which the datasets are taken, whose effects stay in the model and are
                refitted too; none of them is tried.
        """
        rng = rng or np.random.default_rng(0)
        scene = self.scene()
        starts = [effect.start_values(scene) for effect in effects]
        at = np.cumsum([0, *(len(effect.parameters) for effect in effects)])
        present = () if beside is None else beside.effects
        every_effect = (*effects, *present)
        # By start: gain of the data, the same without the prior's pull, then of each pattern of signs.
        gains: list[list[FloatArray]] = [[] for _ in effects]
        occam: list[list[float]] = [[] for _ in effects]
        rounds = max(len(start) for start in starts)
        few = [one.few(_SCREENED) for one in self.taught]
        likelihoods = [one.likelihood(every_effect, self.weight) for one in few]
        signs = []
        for every, one in zip(self.taught, few, strict=True):
            turned = every.widening * rng.choice([-1.0, 1.0], (len(one.observations), draws))
            signs.append(np.concatenate([np.ones((len(turned), 1)), turned], axis=1))
        for g in range(rounds):
            asked = [i for i, start in enumerate(starts) if g < len(start)]
            said: list[list[tuple[FloatArray, FloatArray]]] = [[] for _ in effects]
            for k, (one, likelihood) in enumerate(zip(few, likelihoods, strict=True)):
                progress(g * len(self.taught) + k, rounds * len(self.taught))
                prior = likelihood.prior
                tried = [start[min(g, len(start) - 1)] for start in starts]
                values = np.concatenate(tried if beside is None else [*tried, beside.values(k)])
                z = np.concatenate([one.base.z[0], prior.effect_coordinates(values)])
                weights = np.ones((1, len(one.observations)))
                equations = likelihood.linearise(z[None], one.base.offsets, np.ones(1), weights, by_push=True)
                there = prior.plain + at[-1] + np.flatnonzero(prior.amplitudes[at[-1] :])
                free = np.concatenate([np.arange(prior.plain), there])
                pull = np.concatenate([one.base.z[0], np.zeros(len(there))])
                for i in asked:
                    own = prior.plain + at[i] + np.flatnonzero(effects[i].amplitudes)
                    said[i].append(_eliminated(equations, free, pull, own, signs[k]))
            for i in asked:
                if self.is_shared(effects[i]):
                    normals, slopes = zip(*said[i], strict=True)
                    said[i] = [(np.sum(normals, axis=0), np.sum(slopes, axis=0))]
                allowed = effects[i].signs[effects[i].amplitudes]
                gains[i].append(np.sum([_fall(normal, slope, allowed) for normal, slope in said[i]], axis=0))
                occam[i].append(sum(_occam(normal) for normal, _ in said[i]))
        by_start = [np.array(own) for own in gains]
        chance = np.max([own[:, 2:].max(axis=0) for own in by_start], axis=0)

        def p_value(gain: float) -> float | None:
            return float((1 + (chance >= gain).sum()) / (1 + draws)) if draws else None

        found = []
        for effect, own, start, spent in zip(effects, by_start, starts, occam, strict=True):
            best = int(np.argmax(own[:, 0]))
            gain = float(own[best, 0])
            p = p_value(float(own[:, 1].max()))
            found.append(FirstGain(effect, gain, gain - spent[best], start[best], p))
        return sorted(found, key=lambda one: -one.evidence)

    def remaining(
        self, effects: Sequence[Effect], starts: Sequence[FloatArray], answer: JointFit
    ) -> dict[tuple[str, str], tuple[float, float, float]]:
        """How large each effect could still be beside a fitted model, to first order around it.

        From at most `_SCREENED` pushes of each dataset, with its maps and the parameters of the model's
        effects refitted, and widened where the datasets disagree beyond their errors.

        Args:
            effects: all that were tried, those of the model among them.
            starts: parameters (P,) of each, the amplitudes at their nulls; the others are held.
            answer: the model, with or without effects.

        Returns:
            Value and ends of the 90 % interval, by effect and parameter, of amplitudes of effects that the
            datasets share and the model lacks; only where the pushes say more than the prior.
        """
        values = np.concatenate([np.zeros(0), *starts])
        ends = np.cumsum([0, *(len(effect.parameters) for effect in effects)])
        at = {effect: np.arange(*span) for effect, span in zip(effects, pairwise(ends), strict=True)}
        present = np.concatenate([np.zeros(0, np.int64), *(at[effect] for effect in answer.effects)])
        asked = [effect for effect in effects if effect not in answer.effects and self.is_shared(effect)]
        said: dict[Effect, list[tuple[FloatArray, FloatArray]]] = {effect: [] for effect in asked}
        for k, one in enumerate(self.taught):
            few, kept = one.few(_SCREENED), one.evenly(_SCREENED)
            likelihood = few.likelihood(effects, self.weight)
            prior = likelihood.prior
            values[present] = answer.values(k)
            maps = answer.found.z[0, answer.likelihood.prior.places[k][: prior.plain]]
            z = np.concatenate([maps, prior.effect_coordinates(values)])
            offsets = answer.found.offsets[:, answer.likelihood.pushes[k]][:, kept]
            equations = likelihood.linearise(z[None], offsets, np.ones(1), np.ones((1, len(kept))))
            free = np.concatenate([np.arange(prior.plain), prior.plain + present[prior.amplitudes[present]]])
            pull = np.concatenate([maps, np.zeros(len(free) - len(maps))])
            for effect in asked:
                own = prior.plain + at[effect][effect.amplitudes]
                said[effect].append(_eliminated(equations, free, pull, own))
        found: dict[tuple[str, str], tuple[float, float, float]] = {}
        for effect in asked:
            own = at[effect][effect.amplitudes]
            step, deviations = _agreed(said[effect])
            low, high = (limit[own] for limit in prior.effect_bounds)
            sizes = [
                np.clip(
                    prior.effect_centers[own] + prior.effect_scales[own] * (step + side * deviations),
                    low,
                    high,
                )
                for side in (0.0, -1.645, 1.645)
            ]
            names = [(effect.name, p.name) for p in effect.parameters if p.null is not None]
            for name, told, *size in zip(names, deviations <= _TOLD, *sizes, strict=True):
                if told:
                    found[name] = (float(size[0]), float(size[1]), float(size[2]))
        return found

    def fitted(self, effects: Sequence[Effect], starts: Sequence[FloatArray]) -> JointFit:
        """Fit the model with some effects, from parameters (P,) of each.

        Raises:
            RolloutError: it cannot be computed.
        """
        parts = [one.likelihood(effects, self.weight) for one in self.taught]
        prior = JointPrior([part.prior for part in parts], effects, self.apart)
        values = [
            start if self.is_shared(effect) else np.tile(start, len(parts))
            for effect, start in zip(effects, starts, strict=True)
        ]
        maps = [one.base.z[0] for one in self.taught]
        parameters = prior.effect_coordinates(np.concatenate([np.zeros(0), *values]))
        z = np.concatenate([*maps, parameters])
        mean = np.where(np.concatenate([np.zeros(prior.plain, bool), ~prior.amplitudes]), z, 0.0)
        likelihood = JointLikelihood(prior, parts)
        found = fit(likelihood, z[None], prior_mean=mean[None], offsets=self._offsets, iterations=40)
        return JointFit(tuple(effects), likelihood, mean, found)

    def around(self, found: JointFit) -> Together:
        """The same datasets, with the maps and under the α of a fitted model."""
        taught = []
        for k, one in enumerate(self.taught):
            prior, part = found.likelihood.prior, found.likelihood.parts[k]
            base = replace(
                one.base,
                z=found.found.z[:, prior.places[k][: part.prior.plain]],
                offsets=found.found.offsets[:, found.likelihood.pushes[k]],
            )
            taught.append(replace(one, settings=part.settings, base=base))
        return Together(taught, self.apart, self.weight)

    def refined(self, found: JointFit, progress: StageProgress) -> JointFit:
        """The same effects fitted again, as they are reported: with the α of largest evidence with
        these effects, and with what a slope brings in each dataset (`beside_slope`).

        Raises:
            RolloutError: it cannot be computed.
        """
        parts, away = [], found.found.z[0] - found.mean
        for k, one in enumerate(self.taught):
            place = found.likelihood.prior.places[k]
            centers = found.likelihood.parts[k].prior.effect_values(found.mean[None, place])[0]
            prior = _prior(one.dataset, found.effects, self.weight, (centers, found.scales), slopes=True)
            start = np.concatenate([away[place], np.zeros(prior.size - len(place))])[None]
            own = part_of(progress, k, len(self.taught))
            parts.append(fit_with_trust(prior, one.observations, one.dataset.noise, start, own)[-1][0])
        joint = JointPrior([part.prior for part in parts], found.effects, self.apart)
        z = np.concatenate([away, np.zeros(joint.size - len(away))])
        likelihood = JointLikelihood(joint, parts)
        again = fit(likelihood, z[None], offsets=found.found.offsets, iterations=40)
        return JointFit(found.effects, likelihood, np.zeros(joint.size), again)


@dataclass(frozen=True, eq=False)
class JointFit:
    """One model fitted to several datasets; what a slope brings with it counts as part of each object."""

    effects: tuple[Effect, ...]
    likelihood: JointLikelihood
    mean: FloatArray  # (d,) of the prior
    found: Fits  # one hypothesis

    @property
    def cost(self) -> float:
        """Cost of the fit, nats."""
        return float(self.found.cost[0])

    @property
    def occam(self) -> float:
        """½ log det of the posterior's precision, in units of the prior's."""
        return _occam(self.found.hessian[0])

    def evidence(self, base: JointFit) -> float:
        """Log probability of the pushes over that of a model without effects (Laplace), nats."""
        return base.cost - self.cost - (self.occam - base.occam)

    @property
    def _count(self) -> int:
        return _parameters(self.effects)

    def values(self, k: int) -> FloatArray:
        """(P,) parameters of the effects in dataset k."""
        prior = self.likelihood.parts[k].prior
        return prior.effect_values(self.found.z[:, self.likelihood.prior.places[k]])[0, : self._count]

    def by_effect(self, k: int) -> list[FloatArray]:
        """The same, (P_e,) of each effect."""
        return np.split(self.values(k), np.cumsum([len(effect.parameters) for effect in self.effects])[:-1])

    @property
    def scales(self) -> FloatArray:
        """(P,) standard deviations of the parameters in the prior."""
        return self.likelihood.parts[0].prior.effect_scales[: self._count]

    def deviations(self, k: int) -> FloatArray:
        """(P,) their standard deviations, marginal over everything else."""
        joint = self.likelihood.prior
        own = joint.places[k][joint.places[k] >= joint.plain] - joint.plain
        return joint.effect_deviations(self.found.hessian[0])[own[: self._count]]


def alone(found: JointFit, k: int) -> tuple[FloatArray, FloatArray]:
    """Parameters (P,) of the effects from dataset k alone, without a prior of theirs, and their standard
    deviations.

    The dataset's maps are refitted too. The joint model bends the maps of an object whose dataset disagrees
    with the others, and to first order around such maps the parameters may come out far off, with the wrong
    sign. Parameters that only shape an effect are held, with deviations of 0.

    Raises:
        RolloutError: the derivatives overflow.
    """
    likelihood, place = copy(found.likelihood.parts[k]), found.likelihood.prior.places[k]
    prior = likelihood.prior = copy(likelihood.prior)
    values = found.values(k)
    P = len(values)
    amplitudes = prior.amplitudes[:P]
    prior.effect_centers, prior.effect_scales = prior.effect_centers.copy(), prior.effect_scales.copy()
    prior.effect_centers[:P] = values
    prior.effect_scales[:P] *= np.where(amplitudes, _OPEN, _HELD)
    own = slice(prior.plain, prior.plain + P)
    start, mean = found.found.z[:, place].copy(), found.mean[None, place].copy()
    start[:, own] = mean[:, own] = 0.0
    offsets = found.found.offsets[:, found.likelihood.pushes[k]]
    best = fit(
        likelihood, start, prior_mean=mean, offsets=offsets, iterations=_ITERATIONS, tolerance=_TOLERANCE
    )
    deviations = prior.effect_deviations(best.hessian[0])[:P]
    return prior.effect_values(best.z)[0, :P], np.where(amplitudes, deviations, 0.0)


def _agreed(said: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Best step (c,) of an effect's coordinates from normal matrices and slopes of the datasets, and standard
    deviations, widened where the datasets disagree."""
    normals, slopes = zip(*said, strict=True)
    covariance = np.linalg.inv(np.sum(normals, axis=0) + np.eye(len(normals[0])))
    step = -covariance @ np.sum(slopes, axis=0)[:, 0]
    alone = [np.linalg.inv(normal + _BLIND**-2.0 * np.eye(len(normal))) for normal in normals]
    steps = -np.array([own @ slope[:, 0] for own, slope in zip(alone, slopes, strict=True)])
    widths = np.sqrt([np.diagonal(own) for own in alone])
    scatter = np.array([between(own, wide) for own, wide in zip(steps.T, widths.T, strict=True)])
    return step, np.sqrt(np.diagonal(covariance) + scatter / len(said))


def between(values: FloatArray, deviations: FloatArray) -> float:
    """Variance of a quantity between datasets in excess of their standard deviations (DerSimonian and Laird,
    1986); 0 for a single dataset.

    Args:
        values: (M,) of each dataset.
        deviations: (M,) their standard deviations.
    """
    if len(values) < 2:
        return 0.0
    weights = deviations**-2.0
    mean = float(weights @ values / weights.sum())
    excess = float(weights @ (values - mean) ** 2) - (len(values) - 1)
    return max(0.0, excess / float(weights.sum() - (weights**2).sum() / weights.sum()))


def _eliminated(
    equations: NormalEquations,
    free: np.ndarray,
    pull: FloatArray,
    own: np.ndarray,
    signs: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Normal matrix (c, c) and slopes (c, 1 + D) of some coordinates, with the free ones eliminated, which a
    prior pulls: the slope of the data, then those with the pushes' signs (B, D) changed."""
    hessian, slopes = equations.hessian[0], equations.gradient[0][:, None]
    pulls = pull[:, None]
    if signs is not None:
        assert equations.push_gradient is not None
        slopes = np.concatenate([slopes, equations.push_gradient[:, 0].T @ signs], axis=1)
        # The prior balances only the data.
        pulls = np.concatenate([pulls, np.zeros((len(pull), signs.shape[1]))], axis=1)
    across = hessian[np.ix_(free, own)]
    columns = np.concatenate([across, slopes[free] + pulls], axis=1)
    solved = np.linalg.solve(hessian[np.ix_(free, free)] + np.eye(len(free)), columns)
    normal = hessian[np.ix_(own, own)] - across.T @ solved[:, : len(own)]
    return normal, slopes[own] - across.T @ solved[:, len(own) :]


def _occam(normal: FloatArray) -> float:
    """½ log det of the posterior's precision, in units of the prior's, from the data's normal matrix."""
    return 0.5 * float(np.linalg.slogdet(normal + np.eye(len(normal)))[1])


def _fall(normal: FloatArray, slopes: FloatArray, allowed: FloatArray) -> FloatArray:
    """Drop in cost, prior included, by the best step from zero, for each column of slopes (c, 1 + D).

    A step to an amplitude of the wrong sign, such as a negative drag, explains nothing; see `Effect.signs`.
    """
    step = -np.linalg.solve(normal + np.eye(len(slopes)), slopes)
    wrong = (step * allowed[:, None] < 0.0).any(axis=0)
    return np.where(wrong, 0.0, -0.5 * (slopes * step).sum(axis=0))
