"""Ways by RRT*: straight where that is safe, around where it is not."""

import numpy as np
import pytest

from slipmap.models.geometry import angle_between
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.physics.balance import balance_margins
from slipmap.planners import waypoints
from slipmap.planners.waypoints import NoWay, PoseMetric, find_waypoints
from tests.planners.cell_world import TABLE, belief_about

BELIEF = belief_about(benchmark_object("hammer"))
# The head points outward half-way between these, and would tip the hammer over.
START, GOAL = np.array([0.435, 0.04, np.pi - 1]), np.array([0.435, -0.04, np.pi + 1])


def way(start=START, goal=GOAL, seed=0, **options):
    return find_waypoints(BELIEF, start, goal, TABLE, np.random.default_rng(seed), **options)


def worst_fall(poses):
    """Largest probability of falling on straight ways through poses."""
    steps = np.concatenate([one + np.linspace(0, 1, 60)[:, None] * (other - one) for one, other in poses])
    margins = balance_margins(BELIEF.grid, BELIEF.centers_of_mass, steps, TABLE)
    return ((margins < 0) @ BELIEF.probability).max()


def test_the_straight_way_is_the_goal_alone():
    goal = np.array([0.3, 0.1, 7.0])
    found = way(np.zeros(3), goal)
    assert found == pytest.approx(np.array([[0.3, 0.1, 7.0 - 2 * np.pi]]))


def test_the_way_leads_around_what_would_make_the_object_fall():
    assert worst_fall([(START, GOAL)]) > 0.4
    found = way()
    poses = [START, *found]
    assert len(found) > 1
    assert worst_fall(list(zip(poses, found, strict=False))) <= 0.1 + 1e-9
    assert found[-1][:2] == pytest.approx(GOAL[:2])
    assert angle_between(found[-1, 2], GOAL[2]) == pytest.approx(0, abs=1e-9)
    # Not far longer than it has to be.
    metric = PoseMetric(BELIEF.grid)
    assert sum(metric.gap(a, b) for a, b in zip(poses, found, strict=False)) < 0.6


def test_the_same_seed_finds_the_same_way():
    one, other = way(seed=5), way(seed=6)
    assert (one == way(seed=5)).all()
    assert one[0] != pytest.approx(other[0])


def test_no_way_is_an_error_that_says_between_what(monkeypatch):
    monkeypatch.setattr(waypoints, "ITERATIONS", 1)
    with pytest.raises(NoWay, match=r"from \[0.435, 0.04"):
        way()


@pytest.mark.parametrize("goal", [[0.9, 0.0, 0.0], [3.0, 0.0, 1.0]])
def test_a_goal_beyond_the_table_is_none(goal):
    with pytest.raises(NoWay, match="the object falls with a probability of 100%"):
        way(np.zeros(3), np.array(goal))
