"""One model of several datasets: objects with separate maps, and effects of what they share.

The coordinates are those of every object's maps, one after the other, then those of the effects: once where
the datasets share the effect's owner (`Effect.belongs_to`), otherwise once for each dataset. The normal
equations are sums over the datasets with a block arrow structure; they are small compared with the rollouts,
so they are solved as one dense matrix, and the time of a fit is proportional to its pushes. The likelihood is
the forgiving one, with the α of largest evidence for each dataset, so that a push near balance does not
outweigh all others.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from slipmap.models.effects.effect import Effect, Scene
from slipmap.models.inference.gauss_newton import Fits, fit
from slipmap.models.inference.hypotheses import fit_with_trust
from slipmap.models.inference.likelihood import (
    Likelihood,
    LikelihoodSettings,
    NormalEquations,
    PushCosts,
)
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.prior import (
    EffectCoordinates,
    MapPrior,
    slider_for,
    structures_of,
)
from slipmap.models.measurements import PushDataset
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.progress import StageProgress

_EXACT = 1e-3
"""Standard deviation of a held parameter, as a share of its scale."""

_SCREENED = 20
"""Most pushes of a dataset used to find the effects that are worth refitting."""

_START_STEPS = 3

_BLIND = 1e3
"""Standard deviation, in scales, of a parameter that a dataset does not determine."""


def is_shared(effect: Effect, apart: Collection[str]) -> bool:
    """Whether several datasets share an effect's parameters.

    Args:
        effect: the effect.
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
        count = len(self.observations)
        kept = np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))
        base = replace(self.base, offsets=self.base.offsets[:, kept])
        return replace(self, observations=[self.observations[b] for b in kept], base=base)

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
        prior = _prior(self.dataset, effects, self.weight, (values, spread))
        likelihood = Likelihood(prior, self.observations, self.dataset.noise, self.settings)
        start = np.concatenate([self.base.z[0], np.zeros(len(values))])
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
) -> MapPrior:
    settings = next(iter(structures_of(dataset).values()))  # the one that `identify` tries first
    return MapPrior(
        slider_for(dataset, effects), settings, dataset.mass, weight, effect_prior, known=dataset.known
    )  # fmt: skip


class JointPrior(EffectCoordinates):
    """Joint coordinates of several datasets' maps and of effects.

    Args:
        priors: of each dataset, with the same effects at the same scales.
        effects: the effects.
        apart: as for `is_shared`.

    Attributes:
        places: (d_k,) indices of each dataset's own coordinates among the joint ones.
    """

    def __init__(self, priors: Sequence[MapPrior], effects: Sequence[Effect], apart: Collection[str]) -> None:
        begins = np.cumsum([0, *(prior.plain for prior in priors)])
        self.plain = int(begins[-1])
        places = [[np.arange(begin, end)] for begin, end in pairwise(begins)]
        columns = [np.zeros(0, dtype=np.int64)]  # index of each parameter in a dataset's prior
        at, size = 0, self.plain
        for effect in effects:
            own = at + np.arange(len(effect.parameters))
            for k, place in enumerate(places):
                if k == 0 or not is_shared(effect, apart):
                    columns.append(own)
                    size += len(own)
                place.append(np.arange(size - len(own), size))
            at += len(own)
        self.places = [np.concatenate(place) for place in places]
        every, first = np.concatenate(columns), priors[0]
        self.effect_centers, self.effect_scales = first.effect_centers[every], first.effect_scales[every]
        self.effect_bounds = first.effect_bounds[0][every], first.effect_bounds[1][every]
        self.amplitudes = first.amplitudes[every]


class JointLikelihood:
    """Costs of the pushes of several datasets, like `PushLikelihood` for one.

    Args:
        prior: joint coordinates.
        parts: likelihood of each dataset.
    """

    def __init__(self, prior: JointPrior, parts: Sequence[PushCosts]) -> None:
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
        taught: the datasets.
        apart: owners of effects that they do not share.
    """

    def __init__(self, taught: Sequence[Taught], apart: Collection[str] = ()) -> None:
        self.taught = list(taught)
        self.apart = frozenset(apart)
        # Effects that are forces have one scale for all datasets.
        self.weight = float(np.exp(np.mean(np.log([one.weight for one in taught]))))
        self.base_cost = sum(float(one.base.cost[0]) for one in taught)
        self._offsets = np.concatenate([one.base.offsets for one in taught], axis=1)

    def is_shared(self, effect: Effect) -> bool:
        """Whether the datasets share the effect's parameters."""
        return is_shared(effect, self.apart)

    def scene(self) -> Scene:
        """The scene from which effects derive their starting values."""
        observations = [o for one in self.taught for o in one.observations]
        poses = np.concatenate([o.poses for o in observations])[:, :2]
        center = 0.5 * (poses.min(axis=0) + poses.max(axis=0))
        speeds = [np.hypot(*np.diff(o.push.tip, axis=0).T) / o.push.h for o in observations]
        moving = [float(v[v > 1e-3].mean()) for v in speeds if (v > 1e-3).any()]
        return Scene(
            (float(center[0]), float(center[1])),
            float(np.abs(poses - center).max()),
            max(float(np.linalg.norm(one.dataset.grid.exterior, axis=1).max()) for one in self.taught),
            float(np.median(moving)) if moving else 0.05,
            len(observations),
            self.weight,
        )

    def first_gains(
        self,
        effects: Sequence[Effect],
        progress: StageProgress,
        draws: int = 0,
        rng: np.random.Generator | None = None,
    ) -> list[FirstGain]:
        """Gain of each effect with all maps refitted, to first order, from at most `_SCREENED` pushes per
        dataset; first those of the largest evidence (the gain, less what the parameters would gain anyway).

        By chance alone, the residuals of any push could equally well have had the opposite sign. So the
        p-values compare with the largest gain over all effects when whole pushes change sign at random. The
        prior's pull balances only the signs of the data, so it is left out of both. The fitted maps have
        already taken their share of the residuals, and take it again from residuals that have changed sign;
        so these are widened first.

        Args:
            effects: to try.
            progress: called with the numbers of parts done and of all parts.
            draws: random sign patterns for the p-values; without any there are none.
            rng: of the signs.
        """
        rng = rng or np.random.default_rng(0)
        scene = self.scene()
        starts = [effect.start_values(scene) for effect in effects]
        at = np.cumsum([0, *(len(effect.parameters) for effect in effects)])
        # By start: gain of the data, the same without the prior's pull, then of each pattern of signs.
        gains: list[list[FloatArray]] = [[] for _ in effects]
        occam: list[list[float]] = [[] for _ in effects]
        rounds = max(len(start) for start in starts)
        few = [one.few(_SCREENED) for one in self.taught]
        likelihoods = [one.likelihood(effects, self.weight) for one in few]
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
                values = np.concatenate([start[min(g, len(start) - 1)] for start in starts])
                z = np.concatenate([one.base.z[0], prior.effect_coordinates(values)])
                weights = np.ones((1, len(one.observations)))
                equations = likelihood.linearise(z[None], one.base.offsets, np.ones(1), weights, by_push=True)
                for i in asked:
                    own = prior.plain + at[i] + np.flatnonzero(effects[i].amplitudes)
                    said[i].append(_eliminated(equations, one.base.z[0], own, signs[k]))
            for i in asked:
                if self.is_shared(effects[i]):
                    normals, slopes = zip(*said[i], strict=True)
                    said[i] = [(np.sum(normals, axis=0), np.sum(slopes, axis=0))]
                gains[i].append(np.sum([_fall(normal, slope) for normal, slope in said[i]], axis=0))
                occam[i].append(sum(_occam(normal) for normal, _ in said[i]))
        tried = [np.array(own) for own in gains]
        chance = np.max([own[:, 2:].max(axis=0) for own in tried], axis=0)

        def p_value(gain: float) -> float | None:
            return float((1 + (chance >= gain).sum()) / (1 + draws)) if draws else None

        found = []
        for effect, own, start, spent in zip(effects, tried, starts, occam, strict=True):
            best = int(np.argmax(own[:, 0]))
            gain = float(own[best, 0])
            p = p_value(float(own[:, 1].max()))
            found.append(FirstGain(effect, gain, gain - spent[best], start[best], p))
        return sorted(found, key=lambda one: -one.evidence)

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


@dataclass(frozen=True, eq=False)
class JointFit:
    """One model fitted to several datasets."""

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

    def values(self, k: int) -> FloatArray:
        """(P,) parameters of the effects in dataset k."""
        prior = self.likelihood.parts[k].prior  # type: ignore[attr-defined]
        return prior.effect_values(self.found.z[:, self.likelihood.prior.places[k]])[0]

    @property
    def scales(self) -> FloatArray:
        """(P,) standard deviations of the parameters in the prior."""
        return self.likelihood.parts[0].prior.effect_scales  # type: ignore[attr-defined]

    def deviations(self, k: int) -> FloatArray:
        """(P,) their standard deviations, marginal over everything else."""
        joint = self.likelihood.prior
        own = joint.places[k][joint.places[k] >= joint.plain] - joint.plain
        return joint.effect_deviations(self.found.hessian[0])[own]

    def alone(self, k: int) -> tuple[FloatArray, FloatArray]:
        """Parameters (P,) from dataset k alone, to first order and without a prior of the effects, and their
        standard deviations. Parameters that only shape an effect are held."""
        part, place = self.likelihood.parts[k], self.likelihood.prior.places[k]
        prior: MapPrior = part.prior  # type: ignore[attr-defined]
        z, pushes = self.found.z[:, place], self.likelihood.pushes[k]
        offsets = self.found.offsets[:, pushes]
        equations = part.linearise(z, offsets, np.ones(1), np.ones((1, offsets.shape[1])))
        amplitudes = np.flatnonzero(prior.amplitudes)
        pull = (self.found.z[0] - self.mean)[place][: prior.plain]
        normal, slope = _eliminated(equations, pull, prior.plain + amplitudes)
        covariance = np.linalg.inv(normal + _BLIND**-2.0 * np.eye(len(slope)))
        coordinates, deviations = z[0, prior.plain :].copy(), np.zeros(len(prior.amplitudes))
        coordinates[amplitudes] -= covariance @ slope[:, 0]
        deviations[amplitudes] = np.sqrt(np.diagonal(covariance))
        return prior.effect_centers + prior.effect_scales * coordinates, prior.effect_scales * deviations


def _eliminated(
    equations: NormalEquations, pull: FloatArray, own: np.ndarray, signs: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Normal matrix (c, c) and slopes (c, 1 + D) of some coordinates, the maps (the first ones, with a prior)
    eliminated: the slope of the data, then those with the pushes' signs (B, D) changed."""
    maps = np.arange(len(pull))
    hessian, slopes = equations.hessian[0], equations.gradient[0][:, None]
    pulls = pull[:, None]
    if signs is not None:
        assert equations.push_gradient is not None
        slopes = np.concatenate([slopes, equations.push_gradient[:, 0].T @ signs], axis=1)
        # The prior balances only the data.
        pulls = np.concatenate([pulls, np.zeros((len(pull), signs.shape[1]))], axis=1)
    across = hessian[np.ix_(maps, own)]
    columns = np.concatenate([across, slopes[maps] + pulls], axis=1)
    solved = np.linalg.solve(hessian[np.ix_(maps, maps)] + np.eye(len(maps)), columns)
    normal = hessian[np.ix_(own, own)] - across.T @ solved[:, : len(own)]
    return normal, slopes[own] - across.T @ solved[:, len(own) :]


def _occam(normal: FloatArray) -> float:
    """½ log det of the posterior's precision, in units of the prior's, from the data's normal matrix."""
    return 0.5 * float(np.linalg.slogdet(normal + np.eye(len(normal)))[1])


def _fall(normal: FloatArray, slopes: FloatArray) -> FloatArray:
    """Drop in cost, prior included, by the best step from zero, for each column of slopes (c, 1 + D)."""
    step = np.linalg.solve(normal + np.eye(len(slopes)), slopes)
    return np.asarray(0.5 * (slopes * step).sum(axis=0))
