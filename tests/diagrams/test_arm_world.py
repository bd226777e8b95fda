"""The station as a world: what planning asks of it, and the grasp."""

import numpy as np
import pytest

from diagrams.arm_world import ArmWorld
from diagrams.perception.renderer import RendererUnavailable, require_renderer
from diagrams.station.scenario import Scenario
from planners.goal_settings import GoalSettings
from planners.goals import Graspable
from planners.table_push import TablePush
from planners.world import PushNotMade


@pytest.fixture(scope="module")
def world():
    try:
        require_renderer()
    except RendererUnavailable as reason:
        pytest.skip(str(reason))
    scenario = Scenario()
    scenario.simulation.time_step = 0.005
    scenario.camera.rate = 6.0
    scenario.object.name = "wrench"
    scenario.object.pose = [-0.1, 0.1, 20.0]
    return ArmWorld(scenario)


def truth(world):
    return world._says(world.station, "truth.object_pose").translation().copy()


def test_the_world_looks_pushes_and_refuses(world):
    before = world.look()
    assert np.hypot(*(before[:2] - truth(world)[:2])) < 0.15  # the frame's origin is another one
    with pytest.raises(PushNotMade, match="faster than the finger may push"):
        world.push(TablePush([0.0, 0.0], [0.1, 0.0], 0.9))
    np.testing.assert_allclose(world.look(), before, atol=0.01)
    true_before = truth(world)
    begin = before[:2] - [0.0, 0.08]
    push = TablePush(begin, begin + np.array([0.0, 0.12]), 0.1)
    assert world.can_push(push)
    trial = world.push(push)
    after = world.look()
    assert after[1] - before[1] > 0.02
    assert trial.object_pose.values[-1] == pytest.approx(after, abs=0.01)
    assert np.hypot(*(truth(world) - true_before)[:2]) > 0.02
    assert len(trial.tip_pose.time) > 50
    assert trial.ft_wrench is not None


def test_grasps_beside_the_near_half_only(world):
    seen = world.first_look()
    middle = seen.grid.centers.mean(axis=0)
    thing = Graspable.of(seen.grid, seen.cell_heights, middle[None], [1.0], GoalSettings(samples=300))
    goals = thing.sample_goals(world.table, np.random.default_rng(0))
    sides = np.array([goal.grasp.at(goal.pose)[0] for goal in goals])
    near, far = goals[int(np.argmax((sides < -0.2) & (sides > -0.4)))], goals[int(np.argmax(sides))]
    assert world.can_grasp(near.grasp, near.pose)
    assert not world.can_grasp(far.grasp, far.pose)
