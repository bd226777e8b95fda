"""The whole procedure in a world of cells with control noise, and its ways out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slipmap.models.measurements.push_dataset import Noise, PushDataset, Table
from slipmap.planners import push_decisions
from slipmap.planners.goals import Graspable
from slipmap.planners.pregrasp import bring_to_edge, learn_by_pushing
from slipmap.planners.push_decisions import NoPushLeft, PushNotMade, Way, near_enough, next_push, push_to_goal
from slipmap.planners.robust_push import plan_push
from slipmap.planners.settings import GoalSettings, PregraspSettings, PushSettings
from slipmap.planners.table_push import TablePush
from tests.planners.cell_world import RADIUS, TABLE, CellWorld, belief_about

GOALS = GoalSettings(samples=500, count=50)
SETTINGS = PregraspSettings(push=PushSettings(candidates=40, refinements=20, lengths=20), goals=GOALS)
QUICK = PregraspSettings(
    push=PushSettings(candidates=10, refinements=4, lengths=10, scenarios=4), goals=GOALS
)


def rng(seed=0):
    return np.random.default_rng(seed)


def some_goals(world, belief):
    settings = replace(SETTINGS.goals, count=20)
    thing = Graspable.of(
        belief.grid, world.thing.height, belief.centers_of_mass, belief.probability, settings
    )
    return thing.sample_goals(TABLE, rng())


@pytest.mark.parametrize(("name", "yaw"), [("hammer", 1.0), ("wrench", -2.0)])
def test_an_object_known_by_its_belief_is_brought_to_the_edge(name, yaw):
    world = CellWorld(name, [0.0, 0.0, yaw], seed=1)
    belief = belief_about(world.thing)
    ended = bring_to_edge(world, belief, world.thing.height, SETTINGS, rng())
    assert ended.success, ended.reason
    assert len(ended.pushes) <= 5
    assert np.hypot(*(world.pose - ended.goal.pose)[:2]) < 0.02
    assert world.lowest > 0
    # It was far away before, and is at the edge now.
    corners = world.thing.grid.exterior @ np.array(
        [[np.cos(world.pose[2]), np.sin(world.pose[2])], [-np.sin(world.pose[2]), np.cos(world.pose[2])]]
    )
    assert np.hypot(*(corners + world.pose[:2]).T).max() > TABLE.radius + 0.01
    assert ended.grasp is not None


def test_an_unknown_object_is_explored_first():
    world = CellWorld("spray_gun", [0.0, 0.0, 0.5], seed=3)

    def dataset(trials, grid):
        return PushDataset("", "", grid, None, None, RADIUS, TABLE, 9.81, Noise(), tuple(trials), "")

    settings, choices = replace(SETTINGS, explorations=2, strategy="random", hypotheses=4), rng()
    belief, trials = learn_by_pushing(world, world.thing.grid, dataset, settings, choices)
    assert [trial.role for trial in trials] == ["fit", "fit"]
    ended = bring_to_edge(world, belief, world.thing.height, settings, choices, method="uniform")
    assert len(ended.belief) == 4
    assert ended.method == "uniform"
    assert ended.success == (world.lowest > 0)


def test_the_same_seed_makes_the_same_pushes():
    ends = []
    for _ in range(2):
        world = CellWorld("box", [0.0, 0.0, 0.0], seed=1)
        bring_to_edge(world, belief_about(world.thing), world.thing.height, QUICK, rng(4))
        ends.append(world.pose)
    assert (ends[0] == ends[1]).all()


def test_goals_that_no_robot_can_serve_are_a_reason():
    world = CellWorld("box", [0.0, 0.0, 0.0], seed=1)
    belief = belief_about(world.thing)
    ended = bring_to_edge(world, belief, world.thing.height, QUICK, rng(), goal_allowed=lambda goal: False)
    assert not ended.success
    assert "poses at the edge" in ended.reason


def test_a_fall_is_told_and_ends_it(monkeypatch):
    world = CellWorld("box", [0.0, 0.0, 0.0], seed=1)
    belief = belief_about(world.thing)
    push = world.push

    def knocked_off(planned):
        trial = push(planned)
        world.lowest = -1.0
        return trial

    monkeypatch.setattr(world, "push", knocked_off)
    ended = bring_to_edge(world, belief, world.thing.height, QUICK, rng())
    assert (ended.success, ended.reason, len(ended.pushes)) == (False, "the box fell", 1)


def test_a_robot_that_refuses_is_asked_for_other_pushes_until_it_is_too_often(monkeypatch):
    world = CellWorld("box", [0.0, 0.0, 0.0], seed=1)
    asked = []

    def refuse(push):
        asked.append(push)
        raise PushNotMade("the arm is tired")

    may = []

    def plan(*arguments):
        may.append(arguments[6])
        return plan_push(*arguments)

    monkeypatch.setattr(world, "push", refuse)
    monkeypatch.setattr(push_decisions, "plan_push", plan)
    belief = belief_about(world.thing)
    settings = replace(QUICK, refusals=3)
    ended = push_to_goal(world, belief, some_goals(world, belief), settings, rng())
    assert not ended.reached
    assert "3 pushes in a row were refused or missed, the last because the arm is tired" in ended.reason
    assert len(asked) == 3
    assert [may[-1](push) for push in asked[:2]] == [False, False]
    elsewhere = TablePush(asked[0].begin + 0.01, asked[0].end + 0.01, 0.05)
    assert may[-1](elsewhere)


def test_pushes_without_effect_lead_to_other_goals_and_then_to_an_end(monkeypatch):
    world = CellWorld("box", [0.0, 0.0, 0.0], seed=1)
    push, pose = world.push, world.pose

    def in_vain(planned):
        trial = push(planned)
        world.pose = pose
        return trial

    monkeypatch.setattr(world, "push", in_vain)
    belief = belief_about(world.thing)
    goals = some_goals(world, belief)[:2]
    ended = push_to_goal(world, belief, goals, replace(QUICK, patience=2, pushes=9), rng())
    assert len(ended.pushes) == 4
    assert {id(made.goal) for made in ended.pushes} == {id(goal) for goal in goals}
    assert "given up after 2 pushes" in ended.reason
    ended = push_to_goal(world, belief, goals, replace(QUICK, pushes=3), rng())
    assert ended.reason == "no goal was reached in 3 pushes"


def test_waypoints_are_followed_from_the_nearest_and_dropped_when_passed(monkeypatch):
    world = CellWorld("hammer", [0.435, 0.04, np.pi - 1], seed=0)
    belief = belief_about(world.thing)
    targets = []

    def told(belief, pose, target, *rest):
        targets.append(np.atleast_2d(target))
        return SimpleNamespace(target=0)

    monkeypatch.setattr(push_decisions, "plan_push", told)
    goals = [replace(some_goals(world, belief)[0], pose=np.array([0.435, -0.04, np.pi + 1]))]
    _, way = next_push(belief, world.pose, goals, None, TABLE, SETTINGS, rng())
    assert len(way.waypoints) > 1
    assert targets[0] == pytest.approx(goals[0].pose[None])
    assert targets[1] == pytest.approx(way.waypoints[:1])
    long = Way(0, np.array([[0.2, 0.1, 1.0], [0.3, 0.0, 2.0], [0.4, 0.0, 3.0], goals[0].pose]))
    _, left = next_push(belief, np.array([0.31, 0.01, 2.1]), goals, long, TABLE, SETTINGS, rng())
    assert (left.waypoints == long.waypoints[2:]).all()
    assert targets[-1] == pytest.approx(long.waypoints[2:3])
    _, last = next_push(belief, long.waypoints[2], goals, long, TABLE, SETTINGS, rng())
    assert last.waypoints[:, :2] == pytest.approx(goals[0].pose[None, :2])


def test_goals_that_are_given_up_are_not_pushed_to():
    world = CellWorld("box", [0.0, 0.0, 0.0], seed=0)
    belief = belief_about(world.thing)
    goals = some_goals(world, belief)[:1]
    with pytest.raises(NoPushLeft, match="of 1 goals, 1 were given up"):
        next_push(belief, world.pose, goals, None, TABLE, SETTINGS, rng(), left_out={0})
    with pytest.raises(ValueError, match="no goal"):
        next_push(belief, world.pose, [], None, TABLE, SETTINGS, rng())


def test_an_object_that_lies_at_any_goal_is_not_pushed():
    world = CellWorld("box", [0.0, 0.0, 0.0], seed=0)
    belief = belief_about(world.thing)
    goals = some_goals(world, belief)
    world.pose = goals[-1].pose.copy()
    ended = push_to_goal(world, belief, goals, QUICK, rng())
    assert ended.reached and not ended.pushes
    assert near_enough(ended.goal.pose, world.pose, QUICK.push)
    assert ended.reason == "the object already lies at a goal"
    ended = push_to_goal(world, belief, goals, replace(QUICK, pushes=1), rng(), good=lambda pose: False)
    assert not ended.reached and len(ended.pushes) == 1


def test_near_enough_is_both_place_and_angle():
    goal = np.array([0.1, 0.2, 3.1])
    settings = PushSettings(tolerance=0.02, tolerance_angle=15.0)
    for off, near in (
        ([0.019, 0, 2 * np.pi - 0.25], True),
        ([0.015, 0.015, 0], False),
        ([0, 0, 0.27], False),
    ):
        assert near_enough(goal + np.array(off), goal, settings) == near


@pytest.mark.parametrize(
    ("part", "field", "value"),
    [("push", "candidates", 1), ("push", "tolerance", 0.0), ("poke", "taps", 2.0), ("goals", "epsilon", 0.9)],
)
def test_settings_out_of_range_are_named(part, field, value):
    settings = PregraspSettings()
    setattr(getattr(settings, part), field, value)
    with pytest.raises(ValueError, match=field):
        settings.check()
    with pytest.raises(ValueError, match=r"strategy must be one of random"):
        PregraspSettings(strategy="best").check()


def test_the_square_table_has_edges_too():
    table = Table("rectangle", (0.0, 0.0), size=(0.9, 0.8))
    world = CellWorld("spray_gun", [0.05, 0.0, 0.5], seed=2, table=table)
    ended = bring_to_edge(world, belief_about(world.thing), world.thing.height, SETTINGS, rng())
    assert ended.success, ended.reason
    assert world.lowest > 0
