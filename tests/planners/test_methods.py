"""The compared methods are beliefs of one hypothesis each, but for the paper's own."""

import numpy as np
import pytest

from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.planners.pregrasp import METHODS, planning_belief
from tests.planners.cell_world import belief_about

THING = benchmark_object("book")
BELIEF = belief_about(THING, hypotheses=5)


def of(method, seed=0, truth=THING.maps):
    return planning_belief(method, BELIEF, np.random.default_rng(seed), truth)


def test_all_but_probabilistic_plan_with_one_hypothesis():
    assert of("probabilistic") is BELIEF
    assert [len(of(method)) for method in METHODS[1:]] == [1, 1, 1]


def test_deterministic_draws_a_hypothesis_by_its_probability():
    drawn = [of("deterministic", seed).maps.mass[0] for seed in range(60)]
    counts = [sum(np.array_equal(mass, own) for mass in drawn) for own in BELIEF.maps.mass]
    assert sum(counts) == 60
    assert min(counts) >= 3


def test_uniform_keeps_friction_and_mass_but_not_their_places():
    even = of("uniform")
    assert even.friction_forces[0] == pytest.approx(BELIEF.probability @ BELIEF.friction_forces)
    assert even.centers_of_mass[0] == pytest.approx(BELIEF.grid.centers.mean(axis=0), abs=1e-12)
    assert np.ptp(even.maps.mu) == pytest.approx(0, abs=1e-15)


def test_true_takes_the_true_maps():
    assert of("true").centers_of_mass[0] == pytest.approx(THING.center_of_mass[:2])


@pytest.mark.parametrize(("method", "truth"), [("true", None), ("true", BELIEF.maps), ("best", THING.maps)])
def test_what_cannot_be_is_refused_by_name(method, truth):
    with pytest.raises(ValueError, match=f"'{method}'"):
        of(method, truth=truth)
