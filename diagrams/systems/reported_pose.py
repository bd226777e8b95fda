"""What a tracker reports of a model that is stepped: late, off or out of scale, where an effect says so."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff

from models.effects.stepper import Stepper
from models.physics.cell_grid import FloatArray


def history_length(stepper: Stepper) -> int:
    """Number of past poses that a report may need: as far back as the latency may reach."""
    if stepper.program.delay is None:
        return 0
    # The delay is the sum of its parameters, so that their largest values give its largest.
    latest, _ = stepper.delay(np.concatenate([[p.high for p in e.parameters] for e in stepper.effects]))
    return int(np.ceil(latest / stepper.h)) + 1


def pose_then(stepper: Stepper, pose: Any, history: Any, effects: Any) -> Any:
    """The pose (3,) that the tracker reports now; floats in, floats out, and so with AutoDiffXd.

    Where it reports early, nobody knows yet how the object is driven on: it is taken to keep its velocity.

    Args:
        stepper: the model.
        pose: (3,) true pose.
        history: (L, 3) true poses one, two, … steps ago.
        effects: (P,) parameters of the effects.
    """
    derivatives = pose.dtype == object
    values = values_of(effects)
    if stepper.program.delay is not None:
        delay, slopes = stepper.delay(values)
        steps: Any = delay / stepper.h
        whole = min(max(int(steps), 0), len(history) - 1)
        if derivatives:
            steps = with_gradient(np.array([steps]), slopes[None] / stepper.h, effects)[0]
        then = np.vstack([pose, history])[whole : whole + 2]
        pose = then[0] + (steps - whole) * (then[1] - then[0])
    if stepper.program.measured is None:
        return pose
    if not derivatives:
        return stepper.reported(pose, values)[0]
    reported, by_pose, by_effects = stepper.reported(values_of(pose), values)
    return with_gradient(reported, np.hstack([by_pose, by_effects]), np.concatenate([pose, effects]))


def values_of(numbers: Any) -> FloatArray:
    """Values (N,) of numbers (N,) that may have derivatives."""
    if numbers.dtype == object:
        return ExtractValue(numbers)[:, 0]
    return numbers


def with_gradient(values: FloatArray, jacobian: FloatArray, arguments: Any) -> Any:
    """AutoDiffXd (M,) of values whose derivatives by the arguments (N,) are `jacobian` (M, N): the chain
    rule."""
    value: Any = values
    return InitializeAutoDiff(value, jacobian @ ExtractGradient(arguments))[:, 0]
