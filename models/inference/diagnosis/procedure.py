"""Which physical effect do the data miss? The procedure, from pushes to verdict.

1. Some pushes are locked away. The model without effects and the error model are fitted to the rest.
2. Every candidate is added to first order, maps refitted, and scored on pushes left out. The largest gain
   is compared with the largest gain by chance. Where it is no larger, the model is adequate, or the data
   too few.
3. Candidates are refitted in full, under the error model of the best.
4. Each that is left is asked the same question again: does anything gain on top of it? The true effect
   leaves nothing to gain; an impostor leaves the true one. Those that pass are the answer: one, or a set.
5. Where none passes, pairs are tried; where no pair passes, the effect is unknown to the library.

The steps from the second on are those of `inquiry`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from models.effects.effect import Effect
from models.effects.library import LIBRARY
from models.inference.diagnosis import outcomes
from models.inference.diagnosis.inquiry import Inquiry, Progress
from models.inference.diagnosis.locked import locked_errors, locked_trials
from models.inference.diagnosis.results import QUICK_COARSENESS, Diagnosis
from models.inference.diagnosis.verdict_rules import (
    FEWEST_DRAWS,
    LEVEL,
    locked_pushes_object,
    locked_pushes_stay_off,
)
from models.inference.observations import observe_all
from models.measurements import DatasetError, PushDataset

QUICK_PUSHES = 10
"""Pushes that a quick look takes, spread evenly over all that are open."""


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
        quick: do not simulate any; gains are judged by a fixed threshold. Fewer pushes, larger steps.
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
    open_trials = [trial for trial in dataset.trials if trial.name not in locked]
    if quick and len(open_trials) > QUICK_PUSHES:
        kept = np.linspace(0, len(open_trials) - 1, QUICK_PUSHES).round().astype(int)
        open_trials = [open_trials[b] for b in kept]
    if not open_trials:
        raise DatasetError(f"dataset {dataset.name} has no push left to fit; give at least one the role fit")
    coarseness = QUICK_COARSENESS if quick else 1.0
    observations = observe_all(dataset, open_trials, coarseness)
    held = observe_all(dataset, [trial for trial in dataset.trials if trial.name in locked], coarseness)
    inquiry = Inquiry(dataset, observations, tuple(effects), 0 if quick else draws, rng, report)
    outcome = inquiry.run()
    before = locked_errors(inquiry.base, dataset, held) if held else None
    after = locked_errors(outcome.best, dataset, held) if held and outcome.best.effects else before
    if outcome.effects and locked_pushes_object(inquiry.error.motion, before, after):
        outcome, after = outcomes.refuted_by_locked_pushes(outcome, inquiry.base), before
    elif outcome.effects and locked_pushes_stay_off(before, after):
        outcome, after = outcomes.no_help_to_locked_pushes(outcome, inquiry.base, inquiry.first), before
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


__all__ = ["diagnose"]
