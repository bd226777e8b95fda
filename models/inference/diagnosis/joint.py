"""One model of several datasets: objects with maps of their own, and effects of what they share.

Coordinates are those of every object's maps, one after the other, then the effects': once where the datasets
share what an effect belongs to (`Effect.belongs_to`), else once for each dataset. Normal equations are sums
over the datasets, an arrow of blocks; they are small beside the rollouts, so that they are solved as one
dense matrix and a fit takes time in proportion to its pushes.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np

from slipmap.models.effects.effect import Effect, Scene
from slipmap.models.inference.diagnosis.correlated import CorrelatedLikelihood
from slipmap.models.inference.diagnosis.fitting import Fitted, Fitter
from slipmap.models.inference.error_model import ErrorModel, SensorNoise
from slipmap.models.inference.likelihood import Likelihood, NormalEquations, PushCosts
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.prior import EffectCoordinates, MapPrior
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.progress import StageProgress, part_of


def is_shared(effect: Effect, apart: Collection[str]) -> bool:
    """Whether several datasets have one set of an effect's parameters."""
    return effect.belongs_to != "object" and effect.belongs_to not in apart


class JointPrior(EffectCoordinates):
    """Coordinates of several datasets' maps and of effects.

    Args:
        priors: of each dataset, with the same effects.
        effects: these.
        apart: owners of effects that are not the same for all datasets.
    """

    def __init__(self, priors: Sequence[MapPrior], effects: Sequence[Effect], apart: Collection[str]) -> None:
        self.priors = list(priors)
        begins = np.cumsum([0, *(prior.plain for prior in priors)])
        self.plain = int(begins[-1])
        places = [[np.arange(begin, end)] for begin, end in pairwise(begins)]
        columns: list[tuple[int, np.ndarray]] = []  # a dataset, and which of its parameters stand here
        at, size = 0, self.plain
        for effect in effects:
            own = at + np.arange(len(effect.parameters))
            for k in range(len(priors)):
                if k == 0 or not is_shared(effect, apart):
                    columns.append((k, own))
                    size += len(own)
                places[k].append(np.arange(size - len(own), size))
            at += len(own)
        self.places = [np.concatenate(place) for place in places]

        def gathered(name: str) -> FloatArray:
            return np.concatenate([np.zeros(0), *(getattr(priors[k], name)[own] for k, own in columns)])

        self.effect_centers, self.effect_scales = gathered("effect_centers"), gathered("effect_scales")
        low, high = (
            np.concatenate([np.zeros(0), *(priors[k].effect_bounds[end][own] for k, own in columns)])
            for end in (0, 1)
        )
        self.effect_bounds = low, high
        self.amplitudes = gathered("amplitudes").astype(bool)


@dataclass(frozen=True)
class ErrorModels(ErrorModel):
    """Error models of several datasets; α, β and noise are the largest of them."""

    parts: tuple[ErrorModel, ...] = ()

    @classmethod
    def of(cls, parts: Sequence[ErrorModel]) -> ErrorModels:
        """Of each dataset."""
        noises = [part.noise for part in parts]
        position, angle, force = (
            max(getattr(one, name) for one in noises) for name in ("position", "angle", "force")
        )
        noise = SensorNoise(position, angle, force, all(one.declared for one in noises))
        return cls(noise, max(p.motion for p in parts), max(p.force for p in parts), tuple(parts))


class JointLikelihood:
    """Costs of the pushes of several datasets; of one hypothesis or more, as `PushLikelihood` has them.

    Args:
        prior: their coordinates.
        parts: likelihood of each dataset.
    """

    def __init__(self, prior: JointPrior, parts: Sequence[PushCosts]) -> None:
        self.prior = prior
        self.parts = list(parts)
        self.observations: Sequence[Observation] = [o for part in parts for o in part.observations]
        self.start_sigma = np.concatenate([part.start_sigma for part in parts])
        ends = np.cumsum([len(part.observations) for part in parts])
        self.pushes = [
            slice(int(end) - len(p.observations), int(end)) for end, p in zip(ends, parts, strict=True)
        ]

    @property
    def error(self) -> ErrorModels:
        """Of the strict likelihoods."""
        return ErrorModels.of([cast(CorrelatedLikelihood, part).error for part in self.parts])

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
class FittedTogether(Fitted):
    """One model fitted to several datasets."""

    @property
    def joint(self) -> JointLikelihood:
        """Of all datasets."""
        return cast(JointLikelihood, self.likelihood)

    @property
    def parts(self) -> tuple[Fitted, ...]:
        """The same model as each dataset has it."""
        joint = self.joint
        return tuple(
            Fitted(
                self.effects, cast(CorrelatedLikelihood, part), self.z[place], self.prior_mean[place],
                self.offsets[own], np.nan,
            )
            for part, place, own in zip(joint.parts, joint.prior.places, joint.pushes, strict=True)
        )  # fmt: skip


class JointFitter(Fitter):
    """Fits models to the open pushes of several datasets.

    Args:
        fitters: of each.
        apart: owners of effects that are not the same for all.
    """

    kind = FittedTogether

    def __init__(self, fitters: Sequence[Fitter], apart: Collection[str] = ()) -> None:
        self.fitters = tuple(fitters)
        self.apart = frozenset(apart)
        self.observations = [o for fitter in fitters for o in fitter.observations]
        self.noise = ErrorModels.of([ErrorModel(fitter.noise, 0.0, 0.0) for fitter in fitters]).noise

    @property
    def parts(self) -> tuple[Fitter, ...]:
        """Of each dataset."""
        return self.fitters

    def is_shared(self, effect: Effect) -> bool:
        """Whether the datasets have one set of an effect's parameters."""
        return is_shared(effect, self.apart)

    def strict(self, effects: Sequence[Effect], error: ErrorModel) -> CorrelatedLikelihood:
        """The strict likelihood of the model with some effects."""
        errors = cast(ErrorModels, error).parts
        parts = [fitter.strict(effects, own) for fitter, own in zip(self.fitters, errors, strict=True)]
        prior = JointPrior([part.prior for part in parts], effects, self.apart)
        return cast(CorrelatedLikelihood, JointLikelihood(prior, parts))

    def forgiving(self, prior: MapPrior) -> Likelihood:
        """The forgiving likelihood of the same model."""
        own = cast(JointPrior, prior)
        parts = [fitter.forgiving(part) for fitter, part in zip(self.fitters, own.priors, strict=True)]
        return cast(Likelihood, JointLikelihood(own, parts))

    def guess(self, effect: Effect, scene: Scene, start: int) -> FloatArray:
        """Parameters of an effect at one of its starts, for each dataset where they do not share it."""
        values = super().guess(effect, scene, start)
        return values if self.is_shared(effect) else np.tile(values, len(self.fitters))

    def from_scratch(self, progress: StageProgress) -> Fitted:
        """Fit the model without effects to each dataset."""
        count = len(self.fitters)
        bases = [f.from_scratch(part_of(progress, k, count)) for k, f in enumerate(self.fitters)]
        fitted = self._assembled(bases)
        # Effects that are forces have one scale for all.
        weight = self.weight_of(fitted)
        for fitter in self.fitters:
            fitter.weight = weight
        maps, offsets = zip(*(fitter.forgiving_start for fitter in self.fitters), strict=True)
        self.forgiving_start = np.concatenate(maps), np.concatenate(offsets)
        return fitted

    def base(self, error: ErrorModel, start: Fitted, progress: StageProgress | None = None) -> Fitted:
        """Fit the model without effects, from the maps of another fit."""
        errors = cast(ErrorModels, error).parts
        triples = zip(self.fitters, errors, start.parts, strict=True)
        return self._assembled([fitter.base(own, part) for fitter, own, part in triples])

    def _assembled(self, bases: Sequence[Fitted]) -> Fitted:
        error = ErrorModels.of([base.likelihood.error for base in bases])
        return FittedTogether(
            (), self.strict((), error), np.concatenate([base.z for base in bases]),
            np.concatenate([base.prior_mean for base in bases]),
            np.concatenate([base.offsets for base in bases]), sum(base.cost for base in bases),
        )  # fmt: skip

    def estimate_errors(self, fitted: Fitted) -> ErrorModel:
        """The error model of each dataset under which its pushes left out are most probable."""
        pairs = zip(self.fitters, fitted.parts, strict=True)
        return ErrorModels.of([fitter.estimate_errors(part) for fitter, part in pairs])

    @property
    def reach(self) -> float:
        """Of the largest object about its frame's origin, m."""
        return max(fitter.reach for fitter in self.fitters)

    def weight_of(self, base: Fitted) -> float:
        """N, the geometric mean."""
        weights = [fitter.weight_of(part) for fitter, part in zip(self.fitters, base.parts, strict=True)]
        return float(np.exp(np.mean(np.log(weights))))
