"""Plans with a belief whose tracker is off: they are about where the object is, not where it is reported."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from slipmap.models.geometry import compose, relative
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.rollout import Push
from slipmap.planners.action_selection import choose_push
from slipmap.planners.goals import Graspable
from slipmap.planners.pregrasp import bring_to_edge
from slipmap.planners.push_decisions import near_enough, push_to_goal
from slipmap.planners.robust_push import plan_push
from slipmap.planners.settings import GoalSettings, PregraspSettings, PushSettings
from tests.planners.cell_world import RADIUS, TABLE, CellWorld, belief_about, with_effects

SETTINGS = PregraspSettings(
    push=PushSettings(candidates=20, refinements=8, lengths=20), goals=GoalSettings(samples=500, count=50)
)
LATE, SHIFT = 0.08, np.array([0.03, 0.02, 0.02])  # s; reported in true poses: m, m, rad
TRUE = np.array([0.1, -0.05, 0.6])


def reported(true):
    return compose(SHIFT, true)


def off(belief):
    """The belief in a world with a late and shifted tracker."""
    return with_effects(belief, ["sensor_latency", "tracker_shift"], [LATE, *SHIFT])


class ShiftedWorld(CellWorld):
    def look(self):
        return reported(super().look())


@pytest.fixture(scope="module")
def plain():
    return belief_about(CellWorld("hammer", TRUE, seed=0).thing)


def test_the_true_pose_is_found_in_each_hypothesis_and_expected_over_all(plain):
    assert plain.true_pose(TRUE) is TRUE
    assert off(plain).true_pose(reported(TRUE)) == pytest.approx(TRUE, abs=1e-12)
    assert off(plain).in_world().true_pose(TRUE) is TRUE
    shifts = np.zeros((len(plain), 3))
    shifts[:, 0] = np.linspace(0.0, 0.01, len(plain))
    likely = replace(off(plain), probability=np.linspace(0.0, 1.0, len(plain)) / (len(plain) / 2))
    maps = Maps(likely.maps.mass, likely.maps.mu, likely.maps.mu_finger, np.pad(shifts, ((0, 0), (1, 0))))
    likely = replace(likely, maps=maps)
    assert likely.true_pose(TRUE) == pytest.approx(TRUE - likely.probability @ shifts, abs=1e-12)


def test_rollouts_in_the_world_are_those_without_the_tracker(plain):
    pushes = [choose_push(plain.grid, TRUE, RADIUS, rng=np.random.default_rng(0)).push]
    ways = [push.begin + np.outer(np.linspace(0, 1, 101), push.end - push.begin) for push in pushes]
    moved = [Push(0.01, way, TRUE, pose_times=np.array([0.4, 0.8])) for way in ways]
    without = plain.slider.rollout(plain.maps, moved).poses_of(0)
    late = off(plain)
    for slider in (late.in_world().slider, pickle.loads(pickle.dumps(late.in_world().slider)).on(TABLE)):
        assert slider.rollout(late.maps, moved).poses_of(0) == pytest.approx(without, abs=1e-12)
    assert np.abs(late.slider.rollout(late.maps, moved).poses_of(0) - without).max() > 1e-3


def test_a_push_is_planned_where_the_object_is(plain):
    target = TRUE + np.array([0.06, 0.03, 0.1])
    one, other = (
        plan_push(belief, pose, target, TABLE, SETTINGS.push, np.random.default_rng(0))
        for belief, pose in ((plain, TRUE), (off(plain), reported(TRUE)))
    )
    assert other.push.begin == pytest.approx(one.push.begin, abs=1e-9)
    assert other.push.end == pytest.approx(one.push.end, abs=1e-9)
    assert other.predicted == pytest.approx(one.predicted, abs=1e-9)
    assert other.gap < 0.02


def test_a_push_to_learn_from_is_chosen_where_the_object_is(plain):
    table = replace(TABLE, radius=0.3)
    one, other = (
        choose_push(
            plain.grid, pose, RADIUS, belief=belief, past=[choose_push(
                plain.grid, TRUE, RADIUS, rng=np.random.default_rng(1))],
            table=table, rng=np.random.default_rng(0),
        )
        for belief, pose in ((plain, TRUE), (off(plain), reported(TRUE)))
    )  # fmt: skip
    assert other.push.begin == pytest.approx(one.push.begin, abs=1e-9)
    assert other.push.end == pytest.approx(one.push.end, abs=1e-9)


def test_an_object_is_brought_to_the_true_edge(plain):
    world = ShiftedWorld("hammer", [0.0, 0.0, 1.0], seed=1)
    ended = bring_to_edge(world, off(plain), world.thing.height, SETTINGS, np.random.default_rng(0))
    assert ended.success, ended.reason
    assert near_enough(world.pose, ended.goal.pose, replace(SETTINGS.push, tolerance=0.02))
    assert world.lowest > 0
    thing = Graspable.of_belief(plain, world.thing.height, SETTINGS.goals)
    assert ended.grasp.at(world.pose) == pytest.approx(
        thing.grasps_at(world.pose, TABLE)[0].at(world.pose), abs=0.01
    )


def test_a_goal_is_reached_where_the_object_is_not_where_it_is_reported(plain):
    world = ShiftedWorld("hammer", TRUE, seed=1, noise=0.0)
    settings = replace(SETTINGS, pushes=0, push=replace(SETTINGS.push, tolerance=0.01))
    goals = Graspable.of_belief(plain, world.thing.height, SETTINGS.goals).sample_goals(
        TABLE, np.random.default_rng(0)
    )
    seems = relative(SHIFT, goals[0].pose)  # reported at the goal
    for there, reached in ((goals[0].pose, True), (seems, False)):
        world.pose = there
        ended = push_to_goal(world, off(plain), goals[:1], settings, np.random.default_rng(0))
        assert ended.reached == reached
    assert near_enough(world.look(), goals[0].pose, settings.push)
