"""Intervals of shares and means."""

from __future__ import annotations

import numpy as np
import pytest

from slipmap.diagrams.application.campaigns.trials import mean, share


def test_wilsons_interval_solves_its_equation() -> None:
    z = 1.959963984540054
    for successes, count in ((9, 10), (97, 100), (3, 17)):
        found = share(successes, count)
        for end in (found.low, found.high):
            # The ends are the shares from which the observed one is just z standard deviations away.
            assert abs(successes / count - end) == pytest.approx(z * np.sqrt(end * (1 - end) / count))
    assert share(10, 10).high == pytest.approx(1.0)
    assert share(10, 10).low == pytest.approx(10 / (10 + z**2))
    assert share(0, 0).text() == "–"


def test_interval_of_a_mean_holds_it_as_often_as_stated() -> None:
    rng = np.random.default_rng(0)
    found = [mean(rng.normal(3.0, 2.0, 5)) for _ in range(2000)]
    inside = np.mean([one.low < 3.0 < one.high for one in found])
    assert inside == pytest.approx(0.95, abs=0.015)
    assert not np.isfinite(mean([1.0]).low)
    assert mean([1.0]).text(1e3, 0) == "1000"
    assert mean([1.0, 2.0]).count == 2


def test_estimates_are_told_as_in_a_table() -> None:
    assert share(97, 100).percent() == "97 (92 to 99)"
