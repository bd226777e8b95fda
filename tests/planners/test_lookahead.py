"""The look ahead finds what pushes would follow: against brute force, and for a target two pushes away."""

import numpy as np
import pytest

from slipmap.models.geometry import compose, relative
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.planners.contact_lines import ContactContour
from slipmap.planners.robust_push import Lookahead, Scenarios, foresee, further_pushes
from slipmap.planners.settings import PushSettings
from slipmap.planners.waypoints import PoseMetric
from tests.planners.cell_world import RADIUS, TABLE, belief_about

SETTINGS = PushSettings(candidates=16, lengths=10)
BELIEF = belief_about(benchmark_object("box"), hypotheses=6)
METRIC = PoseMetric(BELIEF.grid)
POSE = np.zeros(3)


@pytest.fixture(scope="module")
def seen():
    rng = np.random.default_rng(0)
    lines = ContactContour(BELIEF.grid, RADIUS, SETTINGS.approach).spread(np.zeros(0), 16, 0.4, rng)
    return foresee(Scenarios.of(BELIEF, SETTINGS, rng), POSE, lines, TABLE, SETTINGS)


def ahead(seen):
    return Lookahead(seen, METRIC, SETTINGS, np.random.default_rng(0))


def test_one_push_is_the_best_of_all_wherever_the_object_lies(seen):
    start, targets = (
        np.array([0.2, -0.1, 2.0]),
        np.array([[0.3, 0.0, 2.2], [0.0, 0.0, 0.0], [0.1, -0.2, 1.0]]),
    )
    ends = compose(start, relative(POSE, seen.poses))
    square = METRIC.gaps(ends, targets) ** 2
    best = np.sqrt(np.einsum("clsg,s->clg", square, seen.probability).min(axis=(0, 1)))
    expected = 1.0 + further_pushes(best, SETTINGS)
    assert ahead(seen).after(start, targets, pairs=False) == pytest.approx(expected, rel=1e-6)


def test_a_target_that_two_pushes_reach_takes_two(seen):
    likely = relative(POSE, seen.poses).mean(axis=2)
    target = compose(compose(POSE, likely[3, 9]), likely[3, 9])
    look = ahead(seen)
    alone = look.after(POSE, target[None], pairs=False)[0]
    pair = look.after(POSE, target[None], pairs=True)[0]
    assert pair == pytest.approx(2.0, abs=0.15)
    assert alone > pair


def test_gaps_within_the_tolerance_need_no_push_and_larger_ones_ever_more():
    few = further_pushes(np.array([0.0, 0.005, 0.1, 0.5, 1.0]), SETTINGS)
    assert few[0] == 0
    assert few[1] < 0.02
    assert few[2] > 1
    assert (np.diff(few) > 0).all()
