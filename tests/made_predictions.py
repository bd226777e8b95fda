"""Predictions with errors as a test wants them."""

from __future__ import annotations

import numpy as np

from slipmap.models.inference.end_region import EndRegion
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.prediction import Motion, Prediction
from slipmap.models.inference.push_errors import Errors
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Push

SQUARE = cells_from_polygon([[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]], count=9)


def made_prediction(
    trial="trials/000.json",
    role="fit",
    *,
    times=(0.1, 0.2),
    measured=None,
    hypotheses=None,
    final_add=0.001,
    spread=0.002,
    no_motion_add=0.1,
    uniform_add=0.05,
    start_sensitivity=1.0,
    excess=0.1,
):
    """Its poses are zeros unless they are given: measured (S, 3), hypotheses (K, S, 3). Its end is so many
    times as far off as the 95 % region reaches."""
    measured = np.zeros((len(times), 3)) if measured is None else measured
    hypotheses = measured[None] if hypotheses is None else hypotheses
    count = len(hypotheses)
    none = np.zeros(0)
    push = Push(0.1, np.zeros((9, 2)), np.zeros(3), pose_times=np.array(times))
    observation = Observation(
        trial, role, push, measured, np.ones(len(measured)), 1, np.zeros((0, 2)), none, none.astype(bool)
    )
    motion = Motion(hypotheses, np.zeros((count, 0, 2)), np.full(count, 1.0 / count), SQUARE)
    return Prediction(
        observation,
        motion,
        *(Errors(value, *[np.nan] * 10) for value in (final_add, uniform_add, no_motion_add)),
        spread,
        0.0,
        start_sensitivity,
        np.zeros((2, 3)),
        region_left_by(excess, measured[-1]),
    )


def region_left_by(excess, end):
    """A region that an end (3,) is so many times as far out of as it reaches."""
    plain = EndRegion.of(np.zeros((1, 3)), np.ones(1), np.full(3, 1e-3))
    off = np.array([1e-3, 0.0, 0.0])
    return EndRegion(end - off * excess / plain.excess(off), plain.covariances, plain.freedom)
