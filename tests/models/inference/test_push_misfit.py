"""The misfit of one push, and how evidence gathers over pushes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from slipmap.models.inference.belief import Belief
from slipmap.models.inference.error_model import ErrorModel
from slipmap.models.inference.observations import Observation
from slipmap.models.inference.prediction import predicted_motion
from slipmap.models.inference.push_misfit import (
    bet,
    observation_of,
    pose_noise,
    resting_misfit,
    steady_force,
    steady_forces,
    whitening_factors,
)
from slipmap.models.inference.residuals import centroid_tracks
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.rollout import Maps, Push, Smoothing
from slipmap.planners.exploration import candidate_pushes

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


def push_misfit(observation: Observation, predicted: np.ndarray) -> float:
    """Root mean square of the whitened residuals against poses predicted from the observed start."""
    _, measured, expected = centroid_tracks(observation, predicted, GRID)
    residual = (measured - expected)[1:]
    # The way is taken from the prediction: noise of the observed poses would lengthen it.
    factors = whitening_factors(replace(observation, poses=predicted), ERROR, GRID)
    white = [scipy.linalg.solve_triangular(factors[i], residual[:, i], lower=True) for i in range(3)]
    return float(np.sqrt(np.mean(np.square(white))))


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
        misfits.append(push_misfit(observation_of(push, observed), poses + start))
    # Without a wrong speed there is a little less than the model expects.
    assert 0.85 < np.sqrt(np.mean(np.square(misfits))) < 1.0
    too_far = poses + (poses - push.start_pose) * [0.4, 0.4, 0.0]
    assert push_misfit(observation_of(push, too_far), poses) > 2.0


def test_p_of_an_end_is_uniform_if_errors_are_as_told() -> None:
    """Ends drawn from the error model, of the start and of the end as seen and of the way, and from as many
    hypotheses as make their spread normal."""
    rng = np.random.default_rng(3)
    start = np.array([0.1, -0.05, 0.4])
    lean = rng.normal(size=100)
    lean = (lean - lean.mean()) / lean.std()
    told = start + [0.05, 0.01, 0.3] + lean[:, None] * np.array([2e-3, 1e-3, 0.05])
    probability = np.full(100, 1 / 100)
    radius = np.sqrt(np.sum((GRID.centers - GRID.centers.mean(axis=0)) ** 2, axis=1).mean())
    way = add(probability @ told, start, GRID.centers)
    length = 0.03
    lasting = 0.02 * np.sqrt(2 * length * (way - length * (1 - np.exp(-way / length))))
    spread = np.sqrt(lasting**2 + 2 * np.array([5e-4, 5e-4, radius * 4e-3]) ** 2)
    found = []
    for _ in range(1000):
        end = told[rng.integers(100)] + spread * rng.normal(size=3) / [1, 1, radius]
        found.append(resting_misfit(start, end, told, probability, ERROR, GRID)[1])
    # Kolmogorov's bound at 0.1 % for 1000 draws.
    assert np.abs(np.sort(found) - np.arange(1, 1001) / 1000).max() < 0.062


def test_an_end_is_usual_beside_doubtful_hypotheses_and_not_beside_sure_ones() -> None:
    start, end = np.zeros(3), np.array([0.05, 0.0, 0.12])
    sure = np.array([[0.05, 0.0, 0.35], [0.05, 0.0, 0.37]])
    doubtful = np.array([[0.05, 0.0, 0.1], [0.05, 0.0, 0.62]])
    half = np.full(2, 0.5)
    misfit, p = resting_misfit(start, end, sure, half, ERROR, GRID)
    assert misfit > 3.0 and p < 1e-4
    less, usual = resting_misfit(start, end, doubtful, half, ERROR, GRID)
    assert less < 1.0 and usual > 0.3
    # Doubt about the angle does not excuse another place.
    _, elsewhere = resting_misfit(start, end + np.array([0.0, 0.02, 0.0]), doubtful, half, ERROR, GRID)
    assert elsewhere < 1e-4


def test_a_belief_of_few_pushes_is_surprised_less() -> None:
    """Hypotheses differ each time by as much as three pushes tell of their true spread: held to be exact, it
    gives small p far too often."""
    rng = np.random.default_rng(6)
    start, half = np.zeros(3), np.full(40, 1 / 40)
    exact, told = [], []
    for _ in range(400):
        spread = 0.01 * np.sqrt(rng.chisquare(6, size=3) / 6)
        drawn = rng.normal(size=(40, 3))
        poses = spread * (drawn - drawn.mean(axis=0)) / drawn.std(axis=0) / [1, 1, 0.05]
        end = 0.01 * rng.normal(size=3) / [1, 1, 0.05]
        exact.append(resting_misfit(start, end, poses, half, ERROR, GRID)[1])
        told.append(resting_misfit(start, end, poses, half, ERROR, GRID, taught=3)[1])
    assert np.mean(np.array(exact) < 0.01) > 0.04
    assert np.mean(np.array(told) < 0.01) < 0.02


def test_p_is_uniform_with_a_force_that_is_off_as_told() -> None:
    rng = np.random.default_rng(4)
    start = np.array([0.1, -0.05, 0.4])
    told = np.repeat(start[None], 100, axis=0)
    lean = rng.normal(size=100)
    forces = np.array([2.0, 1.0]) + 0.2 * ((lean - lean.mean()) / lean.std())[:, None] * np.array([1.0, -1.0])
    probability = np.full(100, 1 / 100)
    error = ErrorModel(ERROR.noise, ERROR.motion, 0.1)
    radius = np.sqrt(np.sum((GRID.centers - GRID.centers.mean(axis=0)) ** 2, axis=1).mean())
    found = []
    for _ in range(1000):
        end = start + np.sqrt(2) * np.array([5e-4, 5e-4, radius * 4e-3]) * rng.normal(size=3) / [1, 1, radius]
        force = forces[rng.integers(100)] + 0.1 * np.hypot(2.0, 1.0) * rng.normal(size=2)
        found.append(resting_misfit(start, end, told, probability, error, GRID, (force, forces))[1])
    # Kolmogorov's bound at 0.1 % for 1000 draws.
    assert np.abs(np.sort(found) - np.arange(1, 1001) / 1000).max() < 0.062


def test_a_force_that_no_hypothesis_tells_is_a_misfit_where_the_end_is_none() -> None:
    start, end = np.zeros(3), np.array([0.05, 0.0, 0.12])
    half, told = np.full(2, 0.5), np.array([[0.05, 0.0, 0.11], [0.05, 0.0, 0.13]])
    error = ErrorModel(ERROR.noise, ERROR.motion, 0.1)
    forces = np.array([[2.0, 0.0], [2.1, 0.0]])
    _, usual = resting_misfit(start, end, told, half, error, GRID, (np.array([2.2, 0.1]), forces))
    _, rare = resting_misfit(start, end, told, half, error, GRID, (np.array([2.9, 0.5]), forces))
    assert usual > 0.3 and rare < 1e-3


@pytest.mark.parametrize(("measured", "surprising"), [((2.0, 0.5), True), ((0.0, 0.0), False)])
def test_a_finger_that_misses_in_every_hypothesis(measured, surprising) -> None:
    still, half = np.zeros(3), np.full(2, 0.5)
    error = ErrorModel(ERROR.noise, ERROR.motion, 0.1)
    force = np.array(measured), np.zeros((2, 2))
    misfit, p = resting_misfit(still, still, np.zeros((2, 3)), half, error, GRID, force)
    assert np.isfinite(misfit) and (p < 1e-6) == surprising


def test_the_steady_force_is_that_of_a_push_and_not_of_a_tap(belief: Belief, pushes: list[Push]) -> None:
    push = pushes[0]
    times = push.h * (np.arange(20) + 0.5) * (len(push.tip) - 1) / 20
    timed = replace(push, force_times=times)
    forces = belief.slider.rollout(belief.maps[1], [timed]).forces[0]
    still = observation_of(timed, push.start_pose[None])
    for steady in (6, 5):
        counts = np.arange(20) < steady
        seen = replace(still, forces=forces, force_rows=np.ones(20), sliding=counts)
        if steady == 5:
            assert steady_force(seen) is None
            continue
        found = steady_force(seen)
        assert found is not None
        assert found == pytest.approx(forces[:6].mean(axis=0))
        (motion,) = predicted_motion(belief, [seen])
        assert steady_forces(motion, seen)[1] == pytest.approx(found)


def test_bets_are_fair() -> None:
    """Mean at most 1 over uniform p, integrated on a scale that shows small p."""
    p = np.logspace(-300, 0, 200_001)
    values = np.array([bet(x) for x in p])
    assert 0.98 < np.trapezoid(values, p) < 1.0
    assert bet(1.0) == pytest.approx(0.5)
    assert bet(1.0 - 2e-4) == pytest.approx(0.5, abs=1e-3)
    assert bet(0.01) > 4.0


def test_false_alarms_are_as_rare_as_promised() -> None:
    """Pushes until E reaches 20, with uniform p that is not believed below 0.005: 20 at least on average."""
    rng = np.random.default_rng(4)
    waits = []
    for _ in range(60):
        evidence, count = 1.0, 0
        while evidence < 20.0 and count < 200:
            evidence = max(evidence, 1.0) * bet(max(rng.uniform(), 0.005))
            count += 1
        waits.append(count)
    assert np.mean(waits) > 20.0
