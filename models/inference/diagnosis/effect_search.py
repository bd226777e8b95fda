"""Strict fit of the model with some effects, each started where it gains most to first order."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from slipmap.models.effects.effect import Effect
from slipmap.models.inference.diagnosis.fitting import Fitted, Fitter, estimate_errors
from slipmap.models.inference.diagnosis.screening import screen
from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.inference.observations import Observation
from slipmap.models.measurements import DatasetError, PushDataset
from slipmap.models.progress import Progress, part_of


def find_effects(
    dataset: PushDataset,
    observations: Sequence[Observation],
    effects: Sequence[Effect],
    rng: np.random.Generator,
    report: Progress,
) -> Fitted:
    """Fit the model with some effects to pushes.

    Args:
        dataset: the dataset that the pushes belong to.
        observations: pushes to learn from.
        effects: effects of the model, at least one.
        rng: of the draws.
        report: called with (stage, done, total).

    Raises:
        DatasetError: the model with the effects cannot be fitted.
        EffectError: a formula cannot be used.
    """
    stage = partial(report, "finding effects")
    stage(0, 3)
    fitter = Fitter(dataset, observations, sensor_noise(dataset))
    base = fitter.from_scratch(part_of(stage, 0, 3))
    stage(1, 3)
    scene = fitter.scene(base)
    starts = screen(fitter, base, effects, len(effects), scene, 1, rng).start
    error = base.likelihood.error
    guesses = [
        fitter.start_of(effect, effect.start_values(scene)[int(start)], error, base)
        for effect, start in zip(effects, starts, strict=True)
    ]
    found = fitter.with_effects(effects, error, base, np.concatenate(guesses), afresh=True)
    if found is None:
        raise DatasetError(
            f"the model with {', '.join(effect.name for effect in effects)} cannot be fitted to dataset"
            f" {dataset.name}: its rollouts do not converge"
        )
    stage(2, 3)
    error = estimate_errors(found, fitter.noise)
    found = fitter.with_effects(effects, error, found, found.values) or found
    stage(3, 3)
    return found
