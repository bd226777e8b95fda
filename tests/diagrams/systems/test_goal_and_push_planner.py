"""Planning as a block: when it plans, what it passes on, and what it makes of refusals."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from driven_block import DrivenBlock, seen_at

from slipmap.diagrams.systems.goal_and_push_planner import PERIOD, GoalAndPushPlanner
from slipmap.diagrams.systems.loop_messages import LoopStatus, PregraspPlan
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.belief import Belief
from slipmap.models.objects import cells_from_polygon
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.perception.seen_object import ObservedPose
from slipmap.models.physics.balance import balance_margins
from slipmap.models.physics.rollout import Maps, Push, Smoothing
from slipmap.planners.push_decisions import Way, near_enough
from slipmap.planners.robust_push import PushEnds, plan_push
from slipmap.planners.settings import GoalSettings, PregraspSettings, PushSettings
from tests.planners.cell_world import TABLE, belief_about, with_effects

HAMMER = benchmark_object("hammer")
BELIEF = belief_about(HAMMER, hypotheses=4)
SEEN = SimpleNamespace(grid=HAMMER.grid, cell_heights=HAMMER.height)
SETTINGS = PregraspSettings(
    push=PushSettings(candidates=10, refinements=4, lengths=10, scenarios=4),
    goals=GoalSettings(samples=200, count=10),
    refusals=2,
)
MIDDLE = (0.0, 0.0, 0.5)


class Planner(DrivenBlock):
    def __init__(self, settings=SETTINGS, **options) -> None:
        super().__init__(
            GoalAndPushPlanner(settings, TABLE, **options),
            belief=BELIEF, object_pose=seen_at(*MIDDLE), seen_object=SEEN, status=LoopStatus("recording", 4),
        )  # fmt: skip
        self.advance(0.5 * PERIOD)

    def plan(self, push: int = 5, attempt: int = 0, reason: str = "", **inputs) -> PregraspPlan | None:
        """What the block says once the loop asks."""
        self.set(status=LoopStatus("planning", push, attempt, reason), **inputs)
        self.advance(PERIOD)
        return self.read("plan")

    def at_the_goal(self) -> PregraspPlan:
        """The plan after a push that went as it should."""
        return self.plan(6, object_pose=seen_at(*self.plan(5).goal.pose))


def test_it_plans_when_asked_and_the_object_is_seen():
    planner = Planner()
    planner.advance(2 * PERIOD)
    assert planner.read("plan") is None
    assert planner.plan(object_pose=ObservedPose.unseen("occluded")) is None
    plan = planner.plan(object_pose=seen_at(*MIDDLE))
    assert plan.number == LoopStatus("planning", 5).number
    assert plan.push is not None
    assert plan.grasp is None
    assert 0.0 <= plan.success_probability <= 1.0
    assert plan.margin > 0.0
    before = plan.push.push.end
    planner.set(object_pose=seen_at(0.1, 0.0, 0.0))
    planner.advance(2 * PERIOD)
    assert (planner.read("plan").push.push.end == before).all()  # it stands


def test_the_same_seed_makes_the_same_plan_and_another_another():
    ends = [Planner(seed=seed).plan().push.push.end for seed in (1, 1, 2)]
    assert (ends[0] == ends[1]).all()
    assert (ends[0] != ends[2]).any()


def test_at_a_goal_it_asks_for_the_grasp_and_for_another_where_that_is_refused():
    planner = Planner()
    first = planner.at_the_goal()
    assert first.push is None
    assert first.grasp.push_id == first.number
    assert first.success_probability > 0.9
    second = planner.plan(6, 1, "no way to it")
    assert second.grasp.push_id == second.number
    apart = np.hypot(*(second.grasp.grasp.tip - first.grasp.grasp.tip))
    assert apart > 0.009 or second.grasp.grasp.approach != first.grasp.grasp.approach


def test_with_a_shifted_tracker_it_plans_where_the_object_is():
    shift, obstacles = np.array([0.03, 0.02, 0.0]), []
    shifted = with_effects(BELIEF, ["tracker_shift"], shift)
    planner = Planner(can_push=lambda obstacle, push: obstacles.append(obstacle.pose) or True)
    first = planner.plan(belief=shifted, object_pose=seen_at(*(MIDDLE + shift)))
    assert np.array(obstacles) == pytest.approx(np.tile(MIDDLE, (len(obstacles), 1)))
    assert first.push.push.end == pytest.approx(Planner().plan().push.push.end)
    grasp = planner.plan(6, object_pose=seen_at(*(first.goal.pose + shift))).grasp
    assert grasp.pose == pytest.approx(first.goal.pose)


def test_where_the_arm_can_take_it_from_no_side_it_pushes_on():
    planner, able = Planner(can_grasp=lambda grasp: able[0]), [True]
    planner.plan()
    able[0] = False
    assert planner.at_the_goal().push is not None


def test_a_refused_push_is_not_asked_for_again_and_too_many_end_it():
    planner = Planner()
    first = planner.plan().push.push
    second = planner.plan(attempt=1, reason="too far").push.push
    assert max(np.hypot(*(first.begin - second.begin)), np.hypot(*(first.end - second.end))) > 0.005
    last = planner.plan(attempt=2, reason="too near")
    assert (last.push, last.grasp) == (None, None)
    assert "2 pushes in a row were refused or missed, the last because too near" in last.reason


def reaches(planned, goal, settings) -> float:
    """Share of rollouts that end within the tolerances, with fresh noise of the finger."""
    rng, count = np.random.default_rng(8), 400
    begins = planned.push.begin + settings.position_noise * rng.standard_normal((count, 2))
    angles = np.radians(settings.angle_noise) * rng.standard_normal(count)
    way = np.linspace(0.0, planned.push.length, 200)
    x, y = planned.push.direction
    pushes = [
        Push(way[1] / planned.push.speed, begin + np.outer(way, [c * x - s * y, s * x + c * y]), np.zeros(3))
        for begin, c, s in zip(begins, np.cos(angles), np.sin(angles), strict=True)
    ]
    off = BELIEF.slider.rollout(BELIEF.maps, pushes).end[..., :3] - goal
    near = np.linalg.norm(off[..., :2], axis=-1) <= settings.tolerance
    return float((near & (np.abs(off[..., 2]) <= np.radians(settings.tolerance_angle))).mean())


def test_the_probability_of_success_counts_the_noise_of_the_finger():
    """On average over the noise, every hypothesis reaches these goals."""
    settings = PushSettings(candidates=10, refinements=4, lengths=10, scenarios=200, position_noise=0.01)
    procedure = GoalAndPushPlanner(PregraspSettings(push=settings), TABLE)._procedure
    rng = np.random.default_rng(1)
    planned = plan_push(BELIEF, np.zeros(3), [0.15, 0.1, 0.4], TABLE, settings, rng)
    center = planned.predicted.mean(axis=0)
    told, made = [], []
    for off in (0.0, 0.008, 0.016):
        goal = center + np.array([off, 0.0, 0.0])
        told.append(procedure._prospects_of_push(planned.ends, SimpleNamespace(pose=goal))[0])
        made.append(reaches(planned, goal, settings))
        assert all(near_enough(mean, goal, settings) for mean in planned.predicted)
    assert told == pytest.approx(made, abs=0.1)
    assert 0.3 < min(made) < max(made) < 0.87


def test_a_fall_on_the_way_is_no_success_and_leaves_no_margin():
    procedure = GoalAndPushPlanner(SETTINGS, TABLE)._procedure
    ends = PushEnds(
        np.zeros((4, 3)), np.array([False, True, True, False]), np.array([0.03, 0.0, -0.02, 0.01]),
        np.array([0.5, 0.2, 0.05, 0.25]),
    )  # fmt: skip
    told = procedure._prospects_of_push(ends, SimpleNamespace(pose=np.zeros(3)))
    assert told == pytest.approx((0.75, 0.0))


@pytest.mark.parametrize(
    "options", [{"can_see": lambda seen, pose: False}, {"can_grasp": lambda grasp: False}]
)
def test_without_a_goal_it_says_why(options):
    plan = Planner(**options).plan()
    assert (plan.push, plan.grasp) == (None, None)
    assert "of 200 poses at the edge" in plan.reason


def test_a_belief_with_another_effect_is_planned_with_anew():
    maps = replace(BELIEF.maps, effects=np.full((len(BELIEF), 2), 0.15))
    tilted = replace(BELIEF, maps=maps, effects=effects_named(["table_tilt"]))
    plans = []
    for belief in (tilted, BELIEF):
        planner = Planner()
        planner.plan(5)
        plans.append(planner.plan(6, belief=belief).push)
    assert (plans[0].predicted != plans[1].predicted).any()


def test_goals_stay_where_a_new_belief_still_accepts_them():
    procedure = GoalAndPushPlanner(SETTINGS, TABLE)._procedure
    rng = np.random.default_rng(0)
    first = procedure._begun(BELIEF, SEEN, rng, None)
    way = Way(3, first.goals[3].pose[None])
    first = replace(first, pursuit=first.pursuit.made(way))
    shifted = replace(BELIEF, probability=np.array([0.4, 0.3, 0.2, 0.1]))
    second = procedure._begun(shifted, SEEN, rng, first)
    assert [list(goal.pose) for goal in second.goals] == [list(goal.pose) for goal in first.goals]
    assert (second.pursuit.way.goal, second.pursuit.served) == (3, (3,))
    # Without the first two goals the others move up, and pushes to those two serve none of the rest.
    history = first.pursuit.made(Way(1, way.waypoints)).to_other_goals({3: 1, 4: 2})
    assert (history.way, history.served) == (None, (1, -1))
    assert history.left_out(1) == {1}


def test_goals_follow_a_belief_that_changes_though_its_effects_do_not():
    """A bar whose mass turns out to be at its other end would fall at the goals found before."""
    grid = cells_from_polygon([[-0.12, -0.015], [0.12, -0.015], [0.12, 0.015], [-0.12, 0.015]], count=60)
    at_one_end = np.where(grid.centers[:, 0] < -0.05, 1.0, 0.02)

    def believed(mass):
        maps = Maps(mass[None] / mass.sum(), np.full((1, len(grid)), 0.4), np.array([0.3]))
        return Belief(grid, 0.008, 9.81, maps, np.ones(1), Smoothing(), "bar", "", "gauss-newton", 0, {})

    before, after = believed(at_one_end), believed(at_one_end[::-1])
    seen = SimpleNamespace(grid=grid, cell_heights=np.full(len(grid), 0.03))
    planner = Planner()
    first = planner.plan(5, belief=before, seen_object=seen)
    second = planner.plan(6, belief=after)
    for belief, plan in ((before, first), (after, second)):
        margins = balance_margins(grid, belief.centers_of_mass, plan.goal.pose[None], TABLE)
        assert (margins > 0).all() and plan.push.fall_probability == 0.0
    assert (balance_margins(grid, after.centers_of_mass, first.goal.pose[None], TABLE) < 0).all()


def test_a_belief_that_changes_does_not_renew_the_number_of_pushes():
    settings = replace(SETTINGS, pushes=2)
    planner = Planner(settings=settings)
    for push in (5, 6):
        assert planner.plan(push, belief=replace(BELIEF, probability=np.eye(4)[push - 5])).push is not None
    last = planner.plan(7, belief=replace(BELIEF, probability=np.eye(4)[2]))
    assert last.push is None and "no goal was reached in 2 pushes" in last.reason


def test_the_true_maps_are_asked_for_by_the_method_true_alone():
    asked = []

    def truth(seen):
        asked.append(seen)
        return HAMMER.maps

    Planner(truth=truth).plan()
    assert not asked
    assert Planner(method="true", truth=truth).plan().push is not None
    assert len(asked) == 1
