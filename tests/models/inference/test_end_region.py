"""The region of an end holds as many ends of a right model as it says, and is left where one is off."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import t

import slipmap
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.end_region import MODEL_FREEDOM, EndRegion
from slipmap.models.inference.error_model import SensorNoise, sensor_noise
from slipmap.models.inference.observations import observe_all
from slipmap.models.inference.prediction import predict_observations
from slipmap.models.inference.push_misfit import observation_of
from slipmap.planners.exploration import candidate_pushes

SIGMA = np.array([1e-3, 2e-3, 0.02])
LEANING = np.array([[2e-3, 1e-3, 0.05], [0.0, 1e-3, -0.02], [0.0, 0.0, 0.01]])


@pytest.mark.parametrize(("hypotheses", "off"), [(1, 1.0), (8, 0.0), (8, 1.0), (20, 0.3)])
def test_of_ends_as_told_as_many_lie_inside_as_the_level_says(hypotheses: int, off: float) -> None:
    """Hypotheses are as few draws of the same distribution as the truth is one of."""
    rng = np.random.default_rng(3)
    inside = np.zeros(3)
    count = 1500
    for _ in range(count):
        spread = LEANING.T @ rng.normal(size=(3, hypotheses + 1)) * (hypotheses > 1)
        noise = max(off, 1e-3) * SIGMA
        region = EndRegion.of(spread[:, 1:].T, np.full(hypotheses, 1 / hypotheses), noise)
        end = spread[:, 0] + noise * rng.normal(size=3)
        inside += [region.holds(end, level) for level in (0.5, 0.9, 0.95)]
    assert inside / count == pytest.approx([0.5, 0.9, 0.95], abs=0.04)


@pytest.mark.parametrize(("model", "noise"), [(1.0, 0.0), (1.0, 0.7), (0.2, 1.0)])
def test_a_model_that_is_now_and_then_far_off_is_outside_as_often_as_the_level_says(
    model: float, noise: float
) -> None:
    """The error has Student's distribution in every direction, and the tracker's noise comes on top."""
    rng = np.random.default_rng(6)
    count, sigma = 6000, max(noise, 1e-3) * SIGMA
    off = model * SIGMA * rng.normal(size=(count, 3))
    off /= np.sqrt(rng.chisquare(MODEL_FREEDOM, (count, 1)) / MODEL_FREEDOM)
    deviation = model * SIGMA * np.sqrt(MODEL_FREEDOM / (MODEL_FREEDOM - 2.0))
    region = EndRegion.of(np.zeros((1, 3)), np.ones(1), sigma, deviation)
    rarity = np.array([region.rarity(end) for end in off + sigma * rng.normal(size=(count, 3))])
    inside = [(rarity >= 1.0 - level).mean() for level in (0.5, 0.9, 0.95)]
    assert inside == pytest.approx([0.5, 0.9, 0.95], abs=0.05)


def test_where_the_size_of_the_models_error_is_open_as_many_lie_inside_as_the_level_says() -> None:
    """Any of three sizes, each a third of the pushes; the middle one alone would be left too often."""
    rng = np.random.default_rng(9)
    sizes = np.array([0.1, 1.0, 10.0])[:, None] * SIGMA
    region = EndRegion.of(np.zeros((1, 3)), np.ones(1), 0.01 * SIGMA, sizes)
    off = rng.standard_t(MODEL_FREEDOM, (3000, 1)) / np.sqrt(MODEL_FREEDOM / (MODEL_FREEDOM - 2.0))
    off = off * sizes[rng.integers(3, size=3000)]
    alone = EndRegion.of(np.zeros((1, 1)), np.ones(1), 0.01 * SIGMA[:1], sizes[:, :1])
    for level in (0.5, 0.9, 0.95):
        low, high = alone.interval(level)
        assert np.mean((low < off[:, 0]) & (off[:, 0] < high)) == pytest.approx(level, abs=0.03)
        assert alone.rarity(np.array([high])) == pytest.approx(1.0 - level)
    border = off[0] / region.excess(off[0])
    assert region.rarity(border) == pytest.approx(0.05) and region.excess(border) == pytest.approx(1.0)
    middle = EndRegion.of(np.zeros((1, 1)), np.ones(1), 0.01 * SIGMA[:1], sizes[1, :1])
    assert np.mean([middle.holds(one[:1]) for one in off]) < 0.85


def test_an_end_that_is_not_known_has_no_region() -> None:
    draws = np.full((4, 1), np.nan)
    region = EndRegion.of(draws, np.full(4, 0.25), np.array([1e-3]), np.array([[1e-3], [1e-2]]))
    assert np.isnan(region.interval(0.9)).all() and np.isnan(region.excess(np.zeros(1)))
    assert not region.holds(np.zeros(1))


def test_the_interval_of_one_number_is_students() -> None:
    draws = np.random.default_rng(7).normal(size=(12, 1))
    low, high = EndRegion.of(draws, np.full(12, 1 / 12), np.zeros(1)).interval(0.9)
    half = t.ppf(0.95, 11) * draws.std(ddof=1) * np.sqrt(1 + 1 / 12)
    assert (low, high) == pytest.approx((draws.mean() - half, draws.mean() + half))


def test_three_intervals_of_ninety_percent_would_surprise_more_often() -> None:
    rng = np.random.default_rng(4)
    region = EndRegion.of(np.zeros((1, 3)), np.ones(1), SIGMA)
    ends = SIGMA * rng.normal(size=(2000, 3))
    alone = (np.abs(ends) > 1.645 * SIGMA).any(axis=1).mean()
    together = np.mean([not region.holds(end) for end in ends])
    assert alone > 0.25 and together == pytest.approx(0.05, abs=0.015)


def test_what_hypotheses_do_together_is_no_surprise_and_what_they_do_not_is() -> None:
    """They lean: who ends farther turns more. Each number of an end that turns less is a usual one."""
    lean = np.linspace(-2.0, 2.0, 40)[:, None]
    region = EndRegion.of(lean * [2e-3, 0.0, 0.05], np.full(40, 1 / 40), 0.1 * SIGMA)
    assert region.holds(np.array([2e-3, 0.0, 0.05]))
    assert not region.holds(np.array([2e-3, 0.0, -0.05]))


def test_excess_is_one_on_the_border() -> None:
    region = EndRegion.of(np.zeros((1, 3)), np.ones(1), SIGMA)
    way = np.array([1e-3, -1e-3, 0.01])
    border = way / region.excess(way)
    assert region.excess(border) == pytest.approx(1.0)
    assert region.rarity(border) == pytest.approx(0.05)
    assert region.excess(3.0 * border) == pytest.approx(3.0)


def test_a_push_that_ends_elsewhere_surprises_and_one_as_predicted_does_not() -> None:
    # One push in twenty surprises by chance, as one of seed 2 does by a hair.
    dataset, _ = slipmap.simulated_hammer(seed=3, fit=4, heldout=3)
    belief = slipmap.identify(dataset, hypotheses=8, friction_laws=False).belief
    seen, noise = observe_all(dataset), sensor_noise(dataset)
    assert not any(push.surprising for push in predict_observations(belief, seen, noise))
    moved = replace(seen[-1], poses=seen[-1].poses + np.array([0.03, 0.0, 0.0]))
    (push,) = predict_observations(belief, [moved], noise)
    assert push.surprising and push.rarity < 0.05 and push.excess > 1.0
    assert push.allowed_add == pytest.approx(push.final_add / push.excess)
    turned = replace(seen[-1], poses=seen[-1].poses + np.array([0.0, 0.0, 2 * np.pi]))
    (push,) = predict_observations(belief, [turned], noise)
    assert not push.surprising, "a whole turn more is none"


def test_where_a_push_near_balance_may_end_includes_starts_that_look_the_same(recorded: Any) -> None:
    """Ends from starts within the tracker's noise; the hypotheses are sure, and their ends alone hold few."""
    rng = np.random.default_rng(8)
    noise = SensorNoise(5e-4, 5e-3, 0.0, True)
    maps = recorded.truth[np.zeros(20, dtype=int)]
    sure = Belief.learned(
        recorded.dataset, recorded.slider, maps, np.full(20, 0.05), method="", seed=0, trials=[], settings={}
    )  # fmt: skip
    pushes = [
        candidate.push([0.0, 0.0, 0.0])
        for candidate in candidate_pushes(sure.grid, 0.006, rng, 60, length=(0.08, 0.1))
    ]
    pushes = [replace(push, pose_times=np.array([push.h * (len(push.tip) - 1)])) for push in pushes]
    seen = [observation_of(push, np.zeros((1, 3))) for push in pushes]
    push = max(predict_observations(sure, seen, noise), key=lambda push: push.start_sensitivity)
    starts = noise.of_poses * rng.standard_normal((400, 1, 3))
    many = recorded.truth[np.zeros(400, dtype=int)]
    ends = recorded.slider.rollout(many, [push.observation.push], start_poses=starts).end[:, 0, :3]
    ends += noise.of_poses * rng.standard_normal((400, 3))
    alone = EndRegion.of(push.hypotheses[:, -1], sure.probability, noise.of_poses)
    assert np.mean([alone.holds(end, 0.9) for end in ends]) < 0.5
    assert np.mean([push.end_region.holds(end, 0.9) for end in ends]) == pytest.approx(0.9, abs=0.08)
    inside = (push.end_interval[0] < ends) & (ends < push.end_interval[1])
    assert inside.mean() == pytest.approx(0.9, abs=0.08)


def test_the_region_of_a_push_does_not_depend_on_what_else_is_predicted() -> None:
    dataset, _ = slipmap.simulated_hammer(seed=2, fit=3, heldout=3)
    belief = slipmap.identify(dataset, hypotheses=6, friction_laws=False).belief
    seen, noise = observe_all(dataset), sensor_noise(dataset)
    (alone,) = predict_observations(belief, seen[-1:], noise)
    among = predict_observations(belief, seen, noise)[-1]
    np.testing.assert_allclose(alone.end_interval, among.end_interval, rtol=0, atol=1e-12)
    assert alone.rarity == pytest.approx(among.rarity, abs=1e-9)
