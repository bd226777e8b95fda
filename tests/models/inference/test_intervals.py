import numpy as np
import pytest

from slipmap.models.inference.end_region import EndRegion
from slipmap.models.inference.summaries import interval


def test_interval_of_many_draws_is_the_normal_one():
    draws = np.random.default_rng(0).normal(3.0, 2.0, 20000)
    value, low, high = interval(draws, np.full(20000, 1 / 20000))
    assert value == pytest.approx(3.0, abs=0.05)
    assert (low, high) == pytest.approx((3.0 - 1.645 * 2.0, 3.0 + 1.645 * 2.0), abs=0.06)


@pytest.mark.parametrize("count", [8, 20])
def test_an_interval_holds_nine_in_ten_of_what_is_drawn_as_the_hypotheses_are(count):
    drawn = np.exp(np.random.default_rng(4).standard_normal((4000, count + 1)))
    equal = np.full(count, 1 / count)
    bounds = np.array([interval(values[1:], equal, log=True)[1:] for values in drawn])
    inside = np.mean((bounds[:, 0] < drawn[:, 0]) & (drawn[:, 0] < bounds[:, 1]))
    assert inside == pytest.approx(0.9, abs=0.02)


@pytest.mark.parametrize("count", [8, 20])
def test_the_region_holds_nine_in_ten_of_what_is_drawn_as_the_hypotheses_are(count):
    """However few they are; the ellipse of a normal distribution that is known would hold 72 and 83 %."""
    rng = np.random.default_rng(5)
    mixed = np.array([[1.0, 0.0], [0.7, 0.3]])
    drawn = rng.standard_normal((4000, count + 1, 2)) @ mixed
    equal = np.full(count, 1 / count)
    inside = np.mean([EndRegion.of(p[1:], equal, np.zeros(2)).holds(p[0], 0.9) for p in drawn])
    assert inside == pytest.approx(0.9, abs=0.02)
