"""Screening: the gain of each candidate over a fitted model, to first order, with everything else refitted.

One rollout of the model with all candidates at their nulls gives, for each open push, derivatives with
respect to the maps, the effects already present, and every candidate. The gain of a candidate is the increase
of the predictive score on left-out pushes. The largest gains by chance are simulated with residuals drawn
from the error model.

Every model, with or without a candidate, may include every effect to a negligible amount (`_TOLERANCE`), so
that a table that is level to a tenth of a degree counts as level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from slipmap.models.effects.effect import Effect, EffectError, Scene
from slipmap.models.effects.library import LIBRARY
from slipmap.models.effects.probes import PROBES
from slipmap.models.inference.diagnosis.correlated import CorrelatedLikelihood, PushEquations, whitened_rows
from slipmap.models.inference.diagnosis.fitting import Fitted, Fitter
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import RolloutError
from slipmap.models.progress import StageProgress, side_by_side

_TOLERANCE = 1.0 / 30.0
"""Negligible amount of an effect, in scales of its amplitudes."""

_FREE = 3.0
"""Standard deviation of a candidate's amplitudes, in their scales."""

_LARGEST = 1e100
"""Size from which the squares of derivatives, or sums of their products, would overflow."""


@dataclass(frozen=True, eq=False)
class Screening:
    """Gains of candidates on top of a fitted model."""

    candidates: tuple[Effect, ...]  # the effects that were tried
    gain: FloatArray  # (C,) best gain of each over its starts, nats
    start: np.ndarray  # (C,) index of the best start
    chance: FloatArray  # (C, D) the same gains for data simulated without any missing effect
    # (C, D) the same for the data with the residuals of whole pushes flipped in sign at random; the first
    # column is the data unchanged. Without columns unless asked for
    turned: FloatArray
    # (C,) smallest standard deviation of an amplitude that the data leave, in its scales
    sharpness: FloatArray

    @property
    def by_name(self) -> dict[str, float]:
        """Gains by the candidates' names, nats."""
        return {c.name: float(gain) for c, gain in zip(self.candidates, self.gain, strict=True)}

    def p_value(self, gain: float) -> float:
        """Share of datasets, simulated and measured, whose largest gain is at least this one."""
        largest = self.chance.max(axis=0)
        return float((1 + (largest >= gain).sum()) / (1 + len(largest)))

    def p_of_agreement(self) -> float:
        """Share of sign flips whose largest gain reaches that of the data; small where pushes agree."""
        largest = self.turned.max(axis=0)
        return float((largest >= largest[0] - 1e-9).mean())


def screen(
    fitter: Fitter,
    fitted: Fitted,
    everything: Sequence[Effect],
    named: int,
    scene: Scene,
    draws: int,
    rng: np.random.Generator,
    progress: StageProgress | None = None,
    *,
    flips: bool = False,
) -> Screening:
    """Gains of all effects on top of a fitted model.

    Args:
        fitted: the model, at its optimum.
        everything: named effects, then probes.
        named: number of named effects; every model may include these to a negligible amount.
        scene: for the candidates' starts.
        draws: D, simulated datasets.
        flips: whether the gains of data with flipped signs are wanted too.
    """
    report = progress or (lambda done, total: None)
    jacobians, residuals, base_columns, own_columns = _stacked(fitter, fitted, everything, scene, report)
    candidates = [i for i, columns in enumerate(own_columns) if columns]
    guesses = max(len(own_columns[i]) for i in candidates)
    report(guesses, guesses + 1)
    tolerated = [i for i in candidates if i < named]
    spare = np.concatenate([np.zeros(0, dtype=np.int64), *(own_columns[i][0] for i in tolerated)])

    small = rng.standard_normal((len(spare), draws)) * _TOLERANCE
    # Drawn in any case, so that chance is the same.
    signs = rng.choice([-1.0, 1.0], (len(residuals), draws))
    signs[:, 0] = 1.0
    signs = signs if flips else signs[:, :0]
    drawn = [
        np.concatenate(
            [r[:, None], rng.standard_normal((len(r), draws)) + J[:, spare] @ small, r[:, None] * turn],
            axis=1,
        )
        for J, r, turn in zip(jacobians, residuals, signs, strict=True)
    ]
    equations = PushEquations.of(jacobians, drawn)
    pull = fitted.z - fitted.prior_mean

    def score(candidate: int | None, g: int) -> FloatArray:
        others = [own_columns[i][0] for i in tolerated if i != candidate]
        columns = [base_columns, *others]
        precision = [np.ones(len(base_columns)), *(np.full(len(c), _TOLERANCE**-2.0) for c in others)]
        if candidate is not None:
            columns.append(own_columns[candidate][g])
            precision.append(np.full(len(columns[-1]), _FREE**-2.0))
        joined = np.concatenate(columns)
        hold = np.zeros(len(joined))
        hold[: len(pull)] = pull
        found, best = equations.scores(joined, np.concatenate(precision), hold)
        if candidate is not None:
            # An amplitude of the wrong sign, such as a negative drag, explains nothing.
            signs = everything[candidate].signs[everything[candidate].amplitudes]
            wrong = (best[len(best) - len(signs) :] * signs[:, None] < 0.0).any(axis=0)
            found[:, wrong] = without[:, wrong]
        return found

    without = np.zeros(0)
    without = score(None, 0)
    gain, start, chance, turned, sharpness = [], [], [], [], []
    total = equations.normal.sum(axis=0)

    def gains(i: int) -> FloatArray:
        """(starts, 1 + D + flips) gains of a candidate over all pushes."""
        return np.array([(score(i, g) - without).sum(axis=0) for g in range(len(own_columns[i]))])

    for i, totals in zip(candidates, side_by_side([partial(gains, i) for i in candidates]), strict=True):
        best = int(np.argmax(totals[:, 0]))
        gain.append(totals[best, 0])
        start.append(best)
        chance.append(totals[:, 1 : 1 + draws].max(axis=0))
        turned.append(totals[:, 1 + draws :].max(axis=0))
        both = np.concatenate([base_columns, own_columns[i][best]])
        width = len(base_columns)
        precision = np.concatenate([np.ones(width), np.full(len(both) - width, _FREE**-2.0)])
        covariance = np.linalg.inv(total[both[:, None], both] + np.diag(precision))
        sharpness.append(float(np.sqrt(np.diagonal(covariance)[width:].min())))
    report(guesses + 1, guesses + 1)
    return Screening(
        tuple(everything[i] for i in candidates),
        np.array(gain),
        np.array(start),
        np.array(chance),
        np.array(turned),
        np.array(sharpness),
    )


class _Stacked(NamedTuple):
    """Whitened derivatives of all pushes with respect to every possible coordinate of a model."""

    jacobians: list[FloatArray]  # (R_b, W) of each push
    residuals: list[FloatArray]  # (R_b,) of each push
    base_columns: np.ndarray  # of the fitted model
    own_columns: list[list[np.ndarray]]  # of each effect, for each of its starts; none for those in the model


def _stacked(
    fitter: Fitter, fitted: Fitted, everything: Sequence[Effect], scene: Scene, report: StageProgress
) -> _Stacked:
    names = [effect.name for effect in everything]
    present = [names.index(effect.name) for effect in fitted.effects]
    candidates = [i for i in range(len(everything)) if i not in present]
    starts = [effect.start_values(scene) for effect in everything]
    # Later rounds need only the effects with several starts. Another one in the model would make this a
    # combination of its own, which takes longer to compile than it saves.
    several = [i for i, start in enumerate(starts) if len(start) > 1]
    later = several if set(present) <= set(several) else list(range(len(everything)))
    values = fitted.values
    for effect, i in zip(fitted.effects, present, strict=True):
        starts[i] = values[None, : len(effect.parameters)]
        values = values[len(effect.parameters) :]

    width = len(fitted.z)
    base_columns = np.arange(width)
    own_columns: list[list[np.ndarray]] = [[] for _ in everything]
    residuals: list[FloatArray] = []
    jacobians: list[list[FloatArray]] = [[] for _ in fitter.observations]
    guesses = max(len(starts[i]) for i in candidates)
    for g in range(guesses):
        report(g, guesses + 1)  # the last part, all scores, takes about as long as several of the others
        tried = later if g else list(range(len(everything)))
        prior = fitter.prior([everything[i] for i in tried])
        likelihood = CorrelatedLikelihood(prior, fitter.measured, fitted.likelihood.error)
        ends = prior.plain + np.cumsum([len(everything[i].parameters) for i in tried])
        at = {
            i: np.arange(end - len(everything[i].parameters), end) for i, end in zip(tried, ends, strict=True)
        }
        taken = [] if g else [np.arange(prior.plain), *(at[i] for i in present)]
        guess = np.concatenate([starts[i][min(g, len(starts[i]) - 1)] for i in tried])
        z = np.concatenate([fitted.z[: prior.plain], prior.effect_coordinates(guess)])
        for i in candidates:
            if g < len(starts[i]):
                columns = at[i][everything[i].amplitudes]
                taken.append(columns)
                own_columns[i].append(np.arange(width, width + len(columns)))
                width += len(columns)
        chosen = np.concatenate(taken)
        try:
            rows = [push.by(chosen) for push in likelihood.rows(z, fitted.offsets)]
        except RolloutError as error:
            own = [e.name for e in everything if e not in LIBRARY and e not in PROBES]
            model = f"the model with {', '.join(own) or 'all effects'}"
            raise EffectError(f"{model} cannot be computed on these pushes: {error}") from error
        white, rest = whitened_rows(likelihood, rows, fitted.offsets)
        residuals = residuals or rest
        for parts, J in zip(jacobians, white, strict=True):
            parts.append(J)
    stacked = [np.concatenate(parts, axis=1) for parts in jacobians]
    largest = np.max([np.abs(J).max(axis=0) for J in stacked], axis=0)
    for effect, starts_of in zip(everything, own_columns, strict=True):
        if not all((largest[columns] < _LARGEST).all() for columns in starts_of):
            raise EffectError(
                f"the model with {effect.name} cannot be computed on these pushes: its derivatives overflow."
                " Let its formulas stay moderate wherever the object was, as exp(x / 0.1) does and"
                " exp(2000 * x) does not"
            )
    return _Stacked(stacked, residuals, base_columns, own_columns)
