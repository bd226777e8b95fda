"""What a model says of pushes that it was not fitted to."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm, t

from slipmap.models.inference.cross_validation import LeftOut, end_errors, leave_out
from slipmap.models.inference.error_model import SensorNoise
from slipmap.models.inference.gauss_newton import fit
from slipmap.models.inference.hypotheses import trusting
from slipmap.models.inference.likelihood import Likelihood
from slipmap.models.inference.observations import observe_all
from slipmap.models.inference.prior import MapPrior, PriorSettings, slider_for


@pytest.fixture(scope="module")
def likelihood(recorded) -> Likelihood:  # type: ignore[no-untyped-def]
    dataset = recorded.dataset
    prior = MapPrior(slider_for(dataset), PriorSettings(), dataset.mass)
    return Likelihood(prior, observe_all(dataset, dataset.fit_trials), dataset.noise, trusting(0.005))


def test_each_push_is_left_out_of_one_fit(likelihood: Likelihood) -> None:
    best = fit(likelihood, likelihood.prior.start(0.35)[None]).best()
    found = leave_out(likelihood, best)
    B = len(likelihood.observations)
    assert len(found.fold) == B and set(found.fold) == set(range(len(found.fits.z)))
    own = found.fits.push_cost[found.fold, np.arange(B)]
    # Pushes left out are predicted worse than those that teach, all in all, and not wildly.
    assert best.push_cost.sum() < own.sum() < 50 * best.push_cost.sum()
    ends = found.ends()
    measured = np.array([o.poses[-1] for o in likelihood.observations])
    assert np.hypot(*(ends - measured)[:, :2].T).max() < 0.01


def test_errors_are_those_beyond_sensors_and_scatter_widened_as_students(monkeypatch) -> None:  # type: ignore[no-untyped-def]
    """Four pushes that end off by 3 % of their way of 0.1 m, half of it known to the hypotheses."""
    off = 3e-3
    grid = SimpleNamespace(centers=np.array([[-0.05, 0.0], [0.05, 0.0]]), width=0.1)
    likelihood: Any = SimpleNamespace(prior=SimpleNamespace(slider=SimpleNamespace(grid=grid)))
    measured = np.zeros(3)
    observations: Any = [
        SimpleNamespace(poses=measured[None], travel=lambda centers: np.array([0.1])) for _ in range(4)
    ]
    spread = np.sqrt(0.5) * off
    poses = np.array([[[-spread, -spread, 0.0]], [[spread, spread, 0.0]]])
    motions: Any = [SimpleNamespace(poses=poses, probability=np.array([0.5, 0.5])) for _ in range(4)]
    left_out = LeftOut(likelihood, None, np.arange(4))  # type: ignore[arg-type]
    monkeypatch.setattr(LeftOut, "ends", lambda self: np.tile([off, -off, 0.0], (4, 1)))
    place, turn = end_errors(left_out, observations, motions, SensorNoise(0.0, 0.0, 0.0, True))
    widened = t.ppf(0.95, 4) / norm.ppf(0.95)
    assert place == pytest.approx(widened * np.sqrt(0.5) * off / 0.1)
    assert turn == 0.0
