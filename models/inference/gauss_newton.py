"""Levenberg-damped Gauss-Newton for many hypotheses at once.

All hypotheses are rolled out in one parallel call and take their steps in lockstep, each with its own
damping. Their weights of the pushes and prior means may differ: the same code serves multiple starts,
refits with pushes left out, and randomised refits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from slipmap.models.effects.effect import Effect
from slipmap.models.inference.likelihood import (
    DrawnErrors,
    NormalEquations,
    PushCosts,
    PushLikelihood,
    overflowing,
)
from slipmap.models.measurements import DatasetError
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import RolloutError
from slipmap.models.progress import StageProgress, go_on, part_of

_EQUATIONS = 2**29
"""Most bytes for the normal equations of hypotheses fitted together; the pushes' starts take most of them."""

_DAMPING = 1e-6, 1e12
"""Least and largest damping; with the largest, steps are rounded off."""

_UNDECIDED, _OUT_OF_REACH = 3, 30.0
"""A hypothesis is not given up in its first iterations, nor later unless it is behind by more than this
factor times what an undamped step promises. In the diagnoses of two datasets (effects/public-tilt and
public-field), no search fell by more than 9.5 times that from there on; this is three times as much."""


@dataclass(frozen=True, eq=False)
class Fits:
    """K fitted hypotheses."""

    z: FloatArray  # (K, d) coordinates
    offsets: FloatArray  # (K, B, 3) start offsets, m and rad
    cost: FloatArray  # (K,) weighted cost, prior included
    push_cost: FloatArray  # (K, B) cost of each push, unweighted
    hessian: FloatArray  # (K, d, d) of the weighted data cost; add the identity for the prior
    start_gain: FloatArray  # (K, B, 3, 3) see `NormalEquations`

    def best(self) -> Fits:
        """The hypothesis of lowest cost."""
        k = [int(np.argmin(self.cost))]
        return Fits(*(getattr(self, name)[k] for name in Fits.__annotations__))


@contextmanager
def of_dataset(name: str, effects: Sequence[Effect] = ()) -> Iterator[None]:
    """Fits without which nothing can be said about a dataset.

    Args:
        name: of the dataset.

    Raises:
        DatasetError: a fit fails, as where an object moves far for a tiny change of its maps.
    """
    try:
        yield
    except (RolloutError, np.linalg.LinAlgError) as error:
        model = f"the model with {', '.join(effect.name for effect in effects)} cannot be computed"
        moderate = "let an effect's formulas stay moderate wherever the object was, or fit without it"
        unknown = "how the pushes depend on the maps cannot be computed"
        tips = (
            "does the object start or end where it tips? `slipmap check` looks at the table, the frames and"
            " the units"
        )
        what, advice = (model, moderate) if effects else (unknown, tips)
        raise DatasetError(f"dataset {name}: {what} ({error}); {advice}") from error


@overflowing()
def fit(
    likelihood: PushCosts,
    start: FloatArray,
    *,
    weights: FloatArray | None = None,
    prior_mean: FloatArray | None = None,
    strength: FloatArray | None = None,
    offsets: FloatArray | None = None,
    errors: DrawnErrors | None = None,
    iterations: int = 25,
    tolerance: float = 1e-3,
    worth: float | None = None,
    progress: StageProgress | None = None,
) -> Fits:
    """Minimise  Σ_b weight_b cost_b(z) + ½ |z - prior_mean|²  from each start.

    Args:
        likelihood: costs of the pushes.
        start: (K, d) coordinates to start from.
        weights: (K, B) weights of the pushes, ones if None.
        prior_mean: (K, d) centre of the prior, zeros if None.
        strength: (K,) see `MapPrior.maps`, ones if None.
        offsets: (K, B, 3) start offsets to start from, zeros if None.
        errors: that hypotheses assume in the measurements of a `Likelihood`, none if None.
        iterations: largest number of iterations.
        tolerance: a hypothesis stops when an accepted step lowers its cost by less than this share, or a
            rejected one promised no more.
        worth: cost above which a fit is useless. A hypothesis that can hardly reach it, or the best of the
            others, is given up where it is. If None, all are followed to the end.
        progress: called with (iteration, iterations).

    Raises:
        RolloutError: a start cannot be computed, or costs or derivatives overflow at all of them.
        Unwanted: nobody waits for the fit any more; see `go_on`.
    """
    K, B = len(start), len(likelihood.observations)
    weights = np.ones((K, B)) if weights is None else weights
    mean = np.zeros_like(start) if prior_mean is None else prior_mean
    strength = np.ones(K) if strength is None else strength
    shift = np.zeros((K, B, 3)) if offsets is None else offsets.copy()
    together = max(1, _EQUATIONS // (128 * B * start.shape[1]))
    if together < K:
        parts = np.split(np.arange(K), np.arange(together, K, together))
        fits = [
            fit(
                likelihood, start[part], weights=weights[part], prior_mean=mean[part],
                strength=strength[part], offsets=shift[part],
                errors=None if errors is None else errors.of(part),
                iterations=iterations, tolerance=tolerance, worth=worth,
                progress=None if progress is None else part_of(progress, place, len(parts)),
            )
            for place, part in enumerate(parts)
        ]  # fmt: skip
        return Fits(
            *(np.concatenate([getattr(found, name) for found in fits]) for name in Fits.__annotations__)
        )
    z = start.copy()
    damping, growth = np.full(K, 1e-2), np.full(K, 2.0)

    def total(found: NormalEquations, at: FloatArray, who: np.ndarray) -> FloatArray:
        cost = (weights[who] * found.cost).sum(axis=1) + 0.5 * ((at - mean[who]) ** 2).sum(axis=1)
        return np.where(found.finite, cost, np.inf)

    def linearised(at: FloatArray, offsets: FloatArray, who: np.ndarray) -> NormalEquations:
        if errors is None:
            return likelihood.linearise(at, offsets, strength[who], weights[who])
        assert isinstance(likelihood, PushLikelihood)
        return likelihood.linearise(at, offsets, strength[who], weights[who], errors=errors.of(who))

    equations = linearised(z, shift, np.arange(K))
    cost = total(equations, z, np.arange(K))
    active = np.flatnonzero(np.isfinite(cost))
    if len(active) == 0:
        raise RolloutError("costs or their derivatives overflow")
    for done in range(1, iterations + 1):
        go_on()
        step = np.zeros_like(z)
        for k in active:
            step[k] = _damped_step(equations, int(k), z[k] - mean[k], damping[k])
        new_z = z[active] + step[active]
        slopes = _start_slopes(equations, active, step[active])
        new_shift = _shifted(
            equations, active, slopes, damping[active], shift[active], likelihood.start_sigma
        )
        promised = _promised(
            equations, active, step[active], slopes, new_shift - shift[active], (z - mean)[active],
            weights[active],
        )  # fmt: skip
        trial = linearised(new_z, new_shift, active)
        new_cost = total(trial, new_z, active)
        drop = cost[active] - new_cost
        better = drop > 0.0
        gain = np.where(better, drop, 0.0)
        winners = active[better]
        z[winners], shift[winners], cost[winners] = new_z[better], new_shift[better], new_cost[better]
        _overwrite(equations, winners, trial, better)
        eased = _eased(gain, promised)
        damping[active] = np.clip(damping[active] * np.where(better, eased, growth[active]), *_DAMPING)
        growth[active] = np.where(better, 2.0, 2.0 * growth[active])
        negligible = tolerance * np.maximum(cost[active], 1e-3)
        resting = np.where(better, gain, promised) < negligible
        if worth is not None and done > _UNDECIDED:
            behind = cost[active] - min(worth, cost.min())
            asked = ~resting & (behind > 0.0)
            resting |= behind > _OUT_OF_REACH * _undamped(equations, active, z - mean, weights, asked)
        active = active[~resting]
        if progress is not None:
            progress(done, iterations)
        if len(active) == 0:
            break
    return Fits(z, shift, cost, equations.cost, equations.hessian, equations.start_gain.swapaxes(0, 1))


def _eased(gain: FloatArray, promised: FloatArray) -> FloatArray:
    """Factors (K,) on the damping after steps that lowered the cost by `gain`, where the quadratic model
    promised `promised`: a third where it was right, up to two where it promised far too much (Nielsen,
    Damping parameter in Marquardt's method, IMM-REP-1999-05)."""
    ratio = np.clip(gain / np.maximum(promised, 1e-300), 0.0, 2.0)
    return np.maximum(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)


def _damped_step(
    equations: NormalEquations, k: int, from_mean: FloatArray, damping: float, longest: float = 1.5
) -> FloatArray:
    """(d,) step of hypothesis k; no coordinate changes by more than `longest` standard deviations of the
    prior. Zero if it overflows. Damped further where derivatives are so large that, rounded, the system is
    not positive definite.

    Raises:
        LinAlgError: no damping makes it so.
    """
    diagonal = np.diagonal(equations.hessian[k]) + 1.0
    while True:
        system = equations.hessian[k].copy()
        np.fill_diagonal(system, diagonal * (1.0 + damping))
        try:
            factor = scipy.linalg.cho_factor(system, overwrite_a=True, check_finite=False)
            break
        except np.linalg.LinAlgError:
            if damping >= _DAMPING[1]:
                raise
            damping = max(100.0 * damping, _DAMPING[0])
    step = -scipy.linalg.cho_solve(factor, equations.gradient[k] + from_mean, check_finite=False)
    if not np.isfinite(step).all():
        return np.zeros_like(step)
    return step * min(1.0, longest / max(float(np.abs(step).max()), 1e-12))


def _start_slopes(equations: NormalEquations, who: np.ndarray, step: FloatArray) -> FloatArray:
    """(B, K, 3) slopes of the quadratic model along the start offsets, after steps (K, d) of the maps."""
    every = len(who) == equations.coupling.shape[1]
    coupling = equations.coupling if every else equations.coupling[:, who]
    after: FloatArray = equations.start_gradient[:, who] + (step[None, :, None] @ coupling)[:, :, 0]
    return after


def _shifted(
    equations: NormalEquations,
    who: np.ndarray,
    slopes: FloatArray,
    damping: FloatArray,
    shift: FloatArray,
    sigma: FloatArray,
) -> FloatArray:
    """Start offsets after a step of the maps, with its damping, kept within four standard deviations."""
    own = (equations.start_gain[:, who] @ slopes[..., None])[..., 0].swapaxes(0, 1)
    result = shift - own / (1.0 + damping[:, None, None])
    return np.clip(result, -4.0 * sigma, 4.0 * sigma)


def _promised(
    equations: NormalEquations,
    who: np.ndarray,
    step: FloatArray,
    slopes: FloatArray,
    moved: FloatArray,
    from_mean: FloatArray,
    weights: FloatArray,
) -> FloatArray:
    """(K,) drop in cost that the quadratic model predicts for steps (K, d) of the maps and (K, B, 3) of the
    start offsets; `slopes` along the offsets are those after the step of the maps."""
    curved = np.einsum("kij,kj->ki", equations.hessian[who], step) + step
    maps = -((equations.gradient[who] + from_mean + 0.5 * curved) * step).sum(axis=1)
    starts, gains = equations.start_gradient[:, who], equations.start_gain[:, who]
    best = np.einsum("kb,bki,bkij,bkj->k", weights, starts, gains, starts)
    # What the offsets fall short of their best, being damped and kept within bounds.
    short = (gains @ slopes[..., None])[..., 0] + moved.swapaxes(0, 1)
    lost = (short * np.linalg.solve(gains, short[..., None])[..., 0]).sum(axis=-1)
    return maps + 0.5 * (best - np.einsum("kb,bk->k", weights, lost))


def _undamped(
    equations: NormalEquations,
    who: np.ndarray,
    from_mean: FloatArray,
    weights: FloatArray,
    wanted: NDArray[np.bool_],
) -> FloatArray:
    """(K,) drop in cost that the quadratic model predicts for its minimum; infinite where not wanted."""
    found = np.full(len(who), np.inf)
    asked = who[wanted]
    if len(asked):
        step = np.zeros((len(asked), from_mean.shape[1]))
        for place, k in enumerate(asked):
            step[place] = _damped_step(equations, int(k), from_mean[k], 0.0, np.inf)
        slopes = _start_slopes(equations, asked, step)
        moved = -(equations.start_gain[:, asked] @ slopes[..., None])[..., 0].swapaxes(0, 1)
        found[wanted] = _promised(equations, asked, step, slopes, moved, from_mean[asked], weights[asked])
    return found


def _overwrite(old: NormalEquations, who: np.ndarray, new: NormalEquations, rows: np.ndarray) -> None:
    for name in ("cost", "hessian", "gradient"):
        getattr(old, name)[who] = getattr(new, name)[rows]
    for name in ("start_gain", "start_gradient", "coupling"):
        getattr(old, name)[:, who] = getattr(new, name)[:, rows]
