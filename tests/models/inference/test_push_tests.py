"""Tests that count pushes: right false-alarm rates whatever the correlation within a push."""

import numpy as np
import pytest
from scipy.stats import binom, ttest_1samp

from slipmap.models.inference.sign_flips import (
    all_signs,
    holm,
    push_sums,
    sign_flip_test,
    smallest_p,
)


def wandering(rng, pushes, samples):
    """Residuals of pushes that wander, with another loudness for each push: (pushes * samples,)."""
    loudness = np.exp(rng.normal(size=(pushes, 1)))
    steps = rng.normal(size=(pushes, samples)).cumsum(axis=1) + 3 * rng.normal(size=(pushes, 1))
    return (loudness * steps).ravel(), np.repeat(np.arange(pushes), samples)


@pytest.mark.parametrize("pushes", [8, 24])
def test_false_alarms_come_at_the_nominal_rate_on_correlated_residuals(pushes):
    rng = np.random.default_rng(1)
    runs, found, naive = 400, 0, 0
    for _ in range(runs):
        residual, push = wandering(rng, pushes, 20)
        feature = rng.normal(size=(pushes, 3)).repeat(20, axis=0)
        products = residual[:, None] * feature
        found += sign_flip_test(push_sums(products, push, pushes), rng, flips=299).p <= 0.05
        naive += ttest_1samp(products[:, 0], 0.0).pvalue <= 0.05
    low, high = binom.ppf([0.001, 0.999], runs, 0.05)
    assert found <= high
    if pushes > 12:
        assert found >= low
    assert naive > 0.4 * runs  # what counting samples would have said


def test_a_pattern_that_pushes_share_is_found_and_named():
    rng = np.random.default_rng(2)
    scores = rng.normal(size=(20, 6))
    scores[:, 4] -= 1.5
    test = sign_flip_test(scores, rng)
    assert test.p < 0.002
    assert test.strongest == 4 and test.z[4] < -3


def test_few_pushes_are_tried_exhaustively():
    test = sign_flip_test(np.ones((5, 1)), np.random.default_rng(0))
    assert test.p == pytest.approx(2 / 32)
    assert smallest_p(5) == pytest.approx(2 / 32)
    assert len(np.unique(all_signs(5), axis=0)) == 32


def test_one_push_that_shouts_is_no_evidence():
    scores = np.zeros((20, 1))
    scores[3] = 1e6
    scores[5] = 1.0
    assert sign_flip_test(scores, np.random.default_rng(0)).p > 0.4


def test_nothing_gives_one():
    assert sign_flip_test(np.zeros((7, 2)), np.random.default_rng(0)).p == 1.0
    assert smallest_p(0) == 1.0


def test_holm_on_a_worked_example():
    # Sorted 0.005, 0.011, 0.02, 0.04 times 4, 3, 2, 1, made monotone.
    np.testing.assert_allclose(holm(np.array([0.011, 0.04, 0.005, 0.02])), [0.033, 0.04, 0.02, 0.04])
    np.testing.assert_allclose(holm(np.array([0.6, 0.7])), [1.0, 1.0])


def test_sums_over_pushes():
    sums = push_sums(np.array([[1.0], [2.0], [4.0]]), np.array([2, 0, 2]), 4)
    np.testing.assert_array_equal(sums[:, 0], [2, 0, 5, 0])
