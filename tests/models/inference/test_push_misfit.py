"""The misfit of one push, and how evidence gathers over pushes."""

from __future__ import annotations

import numpy as np
import pytest

from models.effects.registry import effects_named
from models.effects.slider import EffectSlider
from models.inference.belief import Belief
from models.inference.diagnosis.error_model import ErrorModel
from models.inference.push_misfit import (
    bet,
    observed_push,
    pose_noise,
    push_misfit,
    rank_p,
    simulated_misfits,
)
from models.objects import cells_from_polygon
from models.physics.rollout import Maps, Push, Smoothing
from planners.exploration import candidate_pushes

GRID = cells_from_polygon(np.array([[-3, -2], [3, -2], [3, 2], [-3, 2]]) * 0.01, width=0.01)
ERROR = ErrorModel(pose_noise(5e-4, 4e-3), 0.02, 0.0)


@pytest.fixture(scope="module")
def belief() -> Belief:
    mass = 0.02 * (1.0 + np.array([[0.2], [0.25], [0.3]]) * GRID.centers[:, 0] / 0.03)
    maps = Maps(mass, np.full_like(mass, 0.3), np.full(3, 0.3))
    probability = np.array([0.2, 0.5, 0.3])
    return Belief(GRID, 0.005, 9.81, maps, probability, Smoothing(), "block", "0", "gauss-newton", 0)


@pytest.fixture(scope="module")
def pushes() -> list[Push]:
    rng = np.random.default_rng(5)
    found = candidate_pushes(GRID, 0.005, rng, 12, length=(0.06, 0.1))
    return [push.push([*rng.uniform(-0.2, 0.2, 2), rng.uniform(-3, 3)], h=0.01) for push in found]


def at_thirty_times(push: Push) -> Push:
    times = np.linspace(0, push.h * (len(push.tip) - 1), 31)[1:]
    return Push(push.h, push.tip, push.start_pose, pose_times=times)


def test_noise_alone_misfits_by_one(belief: Belief, pushes: list[Push]) -> None:
    """White noise of each pose and of the start that the prediction begins from."""
    rng = np.random.default_rng(2)
    push = at_thirty_times(pushes[0])
    poses = belief.slider.rollout(belief.maps[1], [push]).poses[0]
    noise = np.array([5e-4, 5e-4, 4e-3])
    misfits = []
    for _ in range(200):
        start = noise * rng.normal(size=3)
        observed = poses + noise * rng.normal(size=(30, 3))
        misfits.append(push_misfit(observed_push(push, observed), poses + start, ERROR, GRID))
    # Without a wrong speed there is a little less than the model expects.
    assert 0.85 < np.sqrt(np.mean(np.square(misfits))) < 1.0
    too_far = poses + (poses - push.start_pose) * [0.4, 0.4, 0.0]
    assert push_misfit(observed_push(push, too_far), poses, ERROR, GRID) > 2.0


def test_simulated_pushes_are_exchangeable_with_others_and_a_tilt_is_not(
    belief: Belief, pushes: list[Push]
) -> None:
    rng = np.random.default_rng(3)
    dense = [at_thirty_times(push) for push in pushes]
    calibration = simulated_misfits(belief, dense, ERROR, 200, rng)
    fresh = simulated_misfits(belief, dense, ERROR, 200, rng)
    ranks = np.array([rank_p(misfit, calibration) for misfit in fresh])
    # Kolmogorov's bound at 0.1 % for two samples of 200.
    assert np.abs(np.sort(ranks) - np.arange(1, 201) / 200).max() < 0.195
    maps = belief.maps[1:2]
    tilted = EffectSlider(GRID, 0.005, effects_named(["table_tilt"])).rollout(
        Maps(maps.mass, maps.mu, maps.mu_finger, np.array([[0.05, -0.06]])), dense
    )
    plain = belief.slider.rollout(maps, dense)
    misfits = [
        push_misfit(observed_push(push, tilted.poses_of(b)[0]), plain.poses_of(b)[0], ERROR, GRID)
        for b, push in enumerate(dense)
    ]
    assert np.median([rank_p(misfit, calibration) for misfit in misfits]) < 0.02


def test_simulated_starts_are_seen_with_noise(belief: Belief) -> None:
    """The finger stays away, so residuals are the noise of poses and of the start, as the error model has
    them; without the start's, the mean square would be smaller by one in thirty."""
    away = Push(0.05, np.full((31, 2), 1.0), np.zeros(3))
    misfits = simulated_misfits(belief, [away], ERROR, 1000, np.random.default_rng(6))
    assert np.mean(np.square(misfits)) == pytest.approx(1.0, abs=0.015)


def test_same_seed_same_misfits(belief: Belief, pushes: list[Push]) -> None:
    first, second = (simulated_misfits(belief, pushes, ERROR, 5, np.random.default_rng(1)) for _ in range(2))
    assert np.array_equal(first, second)


def test_bets_are_fair() -> None:
    """Mean at most 1 over uniform p, integrated on a scale that shows small p."""
    p = np.logspace(-300, 0, 200_001)
    values = np.array([bet(x) for x in p])
    assert 0.98 < np.trapezoid(values, p) < 1.0
    assert bet(1.0) == pytest.approx(0.5)
    assert bet(1.0 - 2e-4) == pytest.approx(0.5, abs=1e-3)
    assert bet(0.01) > 4.0
    assert rank_p(2.0, np.array([1.0, 3.0, 2.5])) == 0.75


def test_false_alarms_are_as_rare_as_promised() -> None:
    """Pushes until E reaches 20, if misfits are exchangeable: 20 at least on average."""
    rng = np.random.default_rng(4)
    waits = []
    for _ in range(60):
        before = list(rng.exponential(size=200))
        evidence, count = 1.0, 0
        while evidence < 20.0 and count < 200:
            misfit = rng.exponential()
            evidence = max(evidence, 1.0) * bet(rank_p(misfit, np.array(before)))
            before.append(misfit)
            count += 1
        waits.append(count)
    assert np.mean(waits) > 20.0
