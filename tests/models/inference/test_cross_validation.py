"""What a model says of pushes that it was not fitted to."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from slipmap.models.inference.cross_validation import LeftOut, end_errors, leave_out
from slipmap.models.inference.end_region import MODEL_FREEDOM
from slipmap.models.inference.error_model import SensorNoise
from slipmap.models.inference.gauss_newton import fit
from slipmap.models.inference.hypotheses import trusting
from slipmap.models.inference.likelihood import Likelihood
from slipmap.models.inference.observations import observe_all
from slipmap.models.inference.prediction import effective_travel
from slipmap.models.inference.prior import MapPrior, PriorSettings, slider_for
from slipmap.models.physics.cell_grid import FloatArray


@pytest.fixture(scope="module")
def likelihood(recorded) -> Likelihood:  # type: ignore[no-untyped-def]
    dataset = recorded.dataset
    prior = MapPrior(slider_for(dataset), PriorSettings(), dataset.mass)
    return Likelihood(prior, observe_all(dataset, dataset.fit_trials), dataset.noise, trusting(0.005))


@pytest.fixture(scope="module")
def left_out(likelihood: Likelihood) -> LeftOut:
    return leave_out(likelihood, fit(likelihood, likelihood.prior.start(0.35)[None]).best())


def test_each_push_is_left_out_of_one_fit(likelihood: Likelihood, left_out: LeftOut) -> None:
    best = fit(likelihood, likelihood.prior.start(0.35)[None]).best()
    B = len(likelihood.observations)
    assert len(left_out.fold) == B and set(left_out.fold) == set(range(len(left_out.fits.z)))
    own = left_out.fits.push_cost[left_out.fold, np.arange(B)]
    # Pushes left out are predicted worse than those that teach, all in all, and not wildly.
    assert best.push_cost.sum() < own.sum() < 50 * best.push_cost.sum()
    ends, _ = left_out.ends()
    measured = np.array([o.poses[-1] for o in likelihood.observations])
    assert np.hypot(*(ends - measured)[:, :2].T).max() < 0.01


@pytest.mark.parametrize("noisier", [0.1, 10.0])
def test_variances_are_those_of_ends_under_maps_and_starts_that_the_other_pushes_leave_open(
    left_out: LeftOut, monkeypatch: pytest.MonkeyPatch, noisier: float
) -> None:
    """Maps and starts drawn as the Hessian and the tracker allow, a tenth as far, so that ends are linear."""
    likelihood, rng = left_out.likelihood, np.random.default_rng(2)
    monkeypatch.setattr(likelihood, "tracker_sigma", noisier * likelihood.tracker_sigma)
    prior, shrunk = likelihood.prior, 0.1
    ends, variances = left_out.ends()
    for b in (0, 3):
        k = int(left_out.fold[b])
        root = np.linalg.cholesky(np.linalg.inv(left_out.fits.hessian[k] + np.eye(prior.size)))
        z = left_out.fits.z[k] + shrunk * rng.standard_normal((600, prior.size)) @ root.T
        push = likelihood.observations[b].push
        starts = push.start_pose + shrunk * likelihood.tracker_sigma[b] * rng.standard_normal((600, 1, 3))
        drawn = prior.slider.rollout(prior.maps(z), [push], start_poses=starts).end[:, 0, :3]
        assert drawn.std(axis=0) / shrunk == pytest.approx(np.sqrt(variances[b]), rel=0.15)
        assert drawn.mean(axis=0) == pytest.approx(ends[b], abs=3e-4)


def test_what_the_record_leaves_open_of_the_fingers_track_counts(
    left_out: LeftOut, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tracks half a millimetre beside the recorded one, each with its opposite."""
    likelihood = left_out.likelihood
    _, before = left_out.ends()
    aside = 5e-4 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    pushes = [o.push for o in likelihood.observations]
    beside = [
        SimpleNamespace(push=p, likely_pushes=[replace(p, tip=p.tip + off) for off in aside]) for p in pushes
    ]
    monkeypatch.setattr(likelihood, "observations", beside)
    _, now = left_out.ends()
    slider = likelihood.prior.slider
    for b in (0, 3):
        k = int(left_out.fold[b])
        maps = likelihood.prior.maps(left_out.fits.z[k : k + 1])
        ends = slider.rollout(maps, beside[b].likely_pushes).end[0, :, :3]
        assert ends.var(axis=0).max() > 1e-9
        assert now[b] - before[b] == pytest.approx(ends.var(axis=0), rel=0.01)


def test_what_the_outline_leaves_open_counts(left_out: LeftOut, monkeypatch: pytest.MonkeyPatch) -> None:
    likelihood = left_out.likelihood
    _, before = left_out.ends()
    monkeypatch.setattr(likelihood, "outline", 4e-4)
    _, now = left_out.ends()
    ways = 4e-4 * np.random.default_rng(0).standard_normal((200, 2))
    for b in range(4):
        maps = likelihood.prior.maps(left_out.fits.z[left_out.fold[b]][None])
        push = likelihood.observations[b].push
        beside = [replace(push, tip=push.tip + way) for way in ways]
        spread = likelihood.prior.slider.rollout(maps, beside).end[0, :, :3].std(axis=0)
        assert np.sqrt(now[b] - before[b]) == pytest.approx(spread, rel=0.3)


def known(off: FloatArray, variance: float, travel: FloatArray) -> LeftOut:
    """Pushes that end off by some (B, 3) m on average, after some travel (B,), with a variance of x, y, θ."""
    grid = SimpleNamespace(centers=np.array([[-1.0, 0.0], [1.0, 0.0]]), width=0.1)
    observations = [
        SimpleNamespace(poses=np.zeros((1, 3)), travel=lambda centers, way=way: np.array([way]))
        for way in travel
    ]
    likelihood: Any = SimpleNamespace(
        prior=SimpleNamespace(slider=SimpleNamespace(grid=grid)), observations=observations
    )
    found = LeftOut(likelihood, None, np.arange(len(off)))  # type: ignore[arg-type]
    object.__setattr__(found, "ends", lambda: (off, np.full(off.shape, variance)))
    return found


@pytest.mark.parametrize("variance", [(1e-3) ** 2, (4e-3) ** 2])
def test_what_the_other_pushes_leave_open_is_no_error_of_the_model(variance: float) -> None:
    """Six pushes over 0.1 m that end off by no more than fits to the other five allow."""
    rng = np.random.default_rng(0)
    shares = []
    for _ in range(40):
        off = np.sqrt(variance) * rng.standard_normal((6, 3))
        left_out = known(off, variance, np.full(6, 0.1))
        shares.append(np.median(end_errors(left_out, SensorNoise(1e-4, 1e-4, 0.0, True))[0]))
    assert np.median(shares) < 0.2 * np.sqrt(variance) / 0.1
    assert min(shares) > 0.0


def test_a_share_of_the_travel_is_found_and_a_push_far_off_does_not_hide_it() -> None:
    rng = np.random.default_rng(1)
    share, travel = 0.05, rng.uniform(0.0, 0.1, 200)
    errors = rng.standard_t(MODEL_FREEDOM, (200, 3)) * share * effective_travel(travel)[:, None]
    deviation = share * np.sqrt(MODEL_FREEDOM / (MODEL_FREEDOM - 2.0))
    told = end_errors(known(errors, 1e-8, travel), SensorNoise(1e-4, 1e-4, 0.0, True))
    # Two hundred pushes determine it well.
    assert told[0] == pytest.approx([deviation] * 9, rel=0.2)
    assert np.median(told[0]) == pytest.approx(deviation, rel=0.15)
    errors[0] = 1.0
    wilder = end_errors(known(errors, 1e-8, travel), SensorNoise(1e-4, 1e-4, 0.0, True))
    assert wilder[0] == pytest.approx(told[0], rel=0.1)


def test_values_of_the_share_are_equally_likely() -> None:
    """Shares drawn as likely as is assumed, each shown by three pushes only: their ranks are uniform."""
    rng = np.random.default_rng(2)
    ranks = np.zeros(10)
    for share in 10.0 ** rng.uniform(-4.0, 0.0, 400):
        errors = rng.standard_t(MODEL_FREEDOM, (3, 3)) * share / np.sqrt(MODEL_FREEDOM) * 0.1
        told = end_errors(known(errors, 1e-10, np.full(3, 0.1)), SensorNoise(1e-6, 1e-6, 0.0, True))
        ranks[np.searchsorted(told[0], share)] += 1
    # Half a ninth of them lie below the lowest value and above the highest one.
    expected = 400 * np.array([0.5, *[1.0] * 8, 0.5]) / 9
    assert ((ranks - expected) ** 2 / expected).sum() < chi2.ppf(0.999, 9)


@pytest.mark.parametrize(
    ("error", "variance"), [(np.nan, 1e-8), (np.inf, 1e-8), (1e-3, np.inf), (1e-3, np.nan)]
)
def test_of_pushes_that_a_fit_says_nothing_of_any_error_is_expected(error: float, variance: float) -> None:
    errors = np.full((6, 3), 1e-3)
    errors[2, 0] = error
    told = end_errors(known(errors, variance, np.full(6, 0.1)), SensorNoise(1e-4, 1e-4, 0.0, True))
    assert told[0] == [1.0] * 9
