"""Algorithm 3's choice of a push: near to the target in all hypotheses, and never over the edge."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.objects.footprints import cells_from_polygon
from slipmap.models.physics.balance import balance_margins
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.maps import Maps
from slipmap.models.physics.pushes import Push
from slipmap.models.physics.rollout import RolloutError, Slider
from slipmap.planners.contact_lines import ContactContour
from slipmap.planners.exploration import NoReachablePush
from slipmap.planners.push_decisions import goal_costs
from slipmap.planners.robust_push import Scenarios, plan_push
from slipmap.planners.settings import PushSettings
from slipmap.planners.table_push import TablePush
from slipmap.planners.waypoints import PoseMetric
from tests.planners.cell_world import RADIUS, TABLE, CellWorld, belief_about

SETTINGS = PushSettings(candidates=40, refinements=20, lengths=20)
BELIEF = belief_about(benchmark_object("hammer"))
START = np.array([0.05, -0.02, 0.8])


def plan(targets, seed=0, pose=START, belief=BELIEF, settings=SETTINGS, **options):
    rng = np.random.default_rng(seed)
    return plan_push(belief, pose, np.asarray(targets, dtype=float), TABLE, settings, rng, **options)


@pytest.mark.parametrize("seed", [0, 3, 7])
def test_a_target_that_some_push_reaches_is_reached(seed):
    rng = np.random.default_rng(100 + seed)
    contour = ContactContour(BELIEF.grid, RADIUS, SETTINGS.approach)
    line = contour.lines(rng.uniform(0, 0.8, 20), rng.uniform(-0.3, 0.3, 20))
    c, s = np.cos(START[2]), np.sin(START[2])
    turn = np.array([[c, -s], [s, c]])
    begin, end = (START[:2] + turn @ (line.touches[0] + way * line.directions[0]) for way in (-0.02, 0.12))
    world = CellWorld("hammer", START, seed, noise=0.0)
    world.push(TablePush(begin, end, SETTINGS.speed))
    planned = plan(world.pose, seed, settings=PushSettings())
    again = CellWorld("hammer", START, seed, noise=0.0)
    again.push(planned.push)
    metric = PoseMetric(BELIEF.grid)
    assert metric.gap(START, world.pose) > 0.03
    assert metric.gap(again.pose, world.pose) < SETTINGS.tolerance
    assert planned.gap < 0.012
    assert planned.pushes < 1.3
    assert planned.predicted.shape == (20, 3)
    assert metric.gap(planned.predicted, world.pose).mean() == pytest.approx(planned.gap, abs=0.005)


@pytest.mark.parametrize(
    ("belief", "table", "settings", "rng", "words"),
    [
        ("belief.npz", TABLE, SETTINGS, np.random.default_rng(0), "belief must be a Belief"),
        (BELIEF, None, SETTINGS, np.random.default_rng(0), "table must be a Table, such as .*; got None"),
        (BELIEF, TABLE, None, np.random.default_rng(0), "settings must be a PushSettings"),
        (BELIEF, TABLE, SETTINGS, 0, "rng must be a Generator, such as .*; got a int"),
    ],
)
def test_other_kinds_of_arguments_are_refused_by_name(belief, table, settings, rng, words):
    with pytest.raises(TypeError, match=words):
        plan_push(belief, START, [0.1, 0.0, 0.0], table, settings, rng)


def test_a_frame_is_pushed_from_inside_where_that_is_best():
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    gaps = []
    for opening in (0.09, 0.02):  # too narrow for the finger
        grid = cells_from_polygon(0.13 * square, [opening * square], count=60)
        even = np.full(len(grid), 0.01)
        belief = belief_about(SimpleNamespace(grid=grid, mu=30.0 * even, mass=even, mu_finger=0.3))
        planned = plan([0.15, 0.0, 0.0], pose=np.zeros(3), belief=belief)
        assert (np.abs(planned.push.begin).max() < 0.045) == (opening == 0.09)
        gaps.append(planned.gap)
    assert gaps[0] < gaps[1]


@pytest.mark.filterwarnings("error")
def test_an_object_of_a_single_cell_is_pushed_too():
    square = 0.03 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    grid = CellGrid(np.zeros((1, 2)), 0.06, square)
    belief = belief_about(SimpleNamespace(grid=grid, mu=np.array([0.3]), mass=np.array([0.2]), mu_finger=0.3))
    assert np.isfinite(belief.end_errors).all()
    planned = plan([0.1, 0.0, 0.0], pose=np.zeros(3), belief=belief)
    assert planned.predicted.mean(axis=0)[:2] == pytest.approx([0.1, 0.0], abs=0.018)
    rng = np.random.default_rng(0)
    inside, over = goal_costs(belief, np.array([[0.3, 0, 0], [0.5, 0, 0]]), TABLE, SETTINGS, rng)
    assert inside == 0.0 < over


def test_no_push_over_the_edge_even_where_the_target_is_there():
    edge = np.array([0.38, 0.0, 0.3])
    planned = plan([0.6, 0.0, 0.3], pose=edge)
    margins = balance_margins(BELIEF.grid, BELIEF.centers_of_mass, planned.predicted, TABLE)
    assert planned.fall_probability < 0.05
    assert np.diagonal(margins).min() > 0


def test_ends_tell_a_fall_on_the_way_from_one_at_the_end():
    scenarios = Scenarios.of(BELIEF, SETTINGS, np.random.default_rng(0))
    poses = np.repeat([[0.1, 0.0, 0.3], [0.6, 0.0, 0.3], [0.1, 0.0, 0.3]], [18, 1, 1], axis=0)
    falls = np.repeat([False, True], [18, 2])
    ends = scenarios.ends(poses, falls, TABLE)
    inside, beyond = balance_margins(BELIEF.grid, BELIEF.centers_of_mass, poses[[0, 18]], TABLE)
    assert ends.margins == pytest.approx([*inside[:18], beyond[18], 0.0])
    assert beyond[18] < 0.0 < inside.min()


def test_the_ends_of_a_push_over_the_edge_are_falls():
    reckless = replace(SETTINGS, fall_cost=0.0)
    planned = plan([0.6, 0.0, 0.3], pose=np.array([0.4, 0.0, 0.3]), settings=reckless)
    assert planned.fall_probability == pytest.approx(1.0)
    assert planned.ends.falls.all()
    assert planned.ends.margins.max() < 0.0
    assert planned.predicted == pytest.approx(planned.ends.poses)  # one scenario for each hypothesis


def test_the_nearest_of_many_targets_is_served_unless_it_costs_more():
    targets = [[-0.3, 0.2, 2.0], [0.10, -0.02, 0.8], [0.3, 0.2, -2.0]]
    assert plan(targets).target == 1
    assert plan(targets).pushes < 1.5
    assert plan(targets, costs=np.array([0.0, 50.0, 0.0])).target != 1


def test_pushes_that_the_model_cannot_predict_are_not_planned(monkeypatch):
    def unsolved(*arguments, **options):
        raise RolloutError("model 0, push 0: a step did not converge")

    monkeypatch.setattr(Slider, "rollout", unsolved)
    with pytest.raises(NoReachablePush, match=r"the model can predict none of \d+ lines of push"):
        plan(START + np.array([0.1, 0.0, 0.0]))


def test_only_allowed_pushes_are_planned():
    target = START + np.array([0.1, 0.0, 0.0])
    free = plan(target)
    side = np.sign(free.push.direction[1]) or 1.0
    planned = plan(target, allowed=lambda push: push.direction[1] * side < 0)
    assert planned.push.direction[1] * side < 0
    assert planned.pushes > free.pushes
    with pytest.raises(NoReachablePush, match="none of"):
        plan(target, allowed=lambda push: False)


def test_a_line_that_is_not_allowed_is_asked_for_again_only_much_shorter():
    asked = []

    def never(push):
        asked.append(push)
        return False

    with pytest.raises(NoReachablePush):
        plan(START + np.array([0.1, 0.0, 0.0]), allowed=never)
    lengths = {}
    for push in asked:
        lengths.setdefault((*push.begin, *push.direction.round(6)), []).append(
            push.length - SETTINGS.approach
        )
    assert len(lengths) > 40
    for ways in lengths.values():
        assert all(later <= 0.7 * earlier + 1e-9 for earlier, later in pairwise(ways))


def test_the_same_seed_plans_the_same_push():
    one, other, another = plan([0.2, 0.1, 1.2], 3), plan([0.2, 0.1, 1.2], 3), plan([0.2, 0.1, 1.2], 4)
    assert (one.push.begin == other.push.begin).all()
    assert (one.predicted == other.predicted).all()
    assert not (one.push.begin == another.push.begin).all()


def test_the_likelier_hypothesis_decides_where_two_differ():
    along = np.exp(25 * BELIEF.grid.centers[:, 0])
    thing = benchmark_object("hammer")
    maps = Maps(
        np.array([thing.mass * along, thing.mass / along]), np.array([thing.mu] * 2), np.full(2, 0.25)
    )
    pair = replace(BELIEF, maps=maps, probability=np.full(2, 0.5))
    tip = START[:2] + np.linspace(-0.06, 0.06, 100)[:, None] * [-np.sin(START[2]), np.cos(START[2])]
    ends = pair.slider.rollout(maps, [Push(0.02, tip, START)]).end[:, 0, :3]
    metric = PoseMetric(pair.grid)
    assert metric.gap(*ends) > 0.05
    for k, p in enumerate((np.array([0.99, 0.01]), np.array([0.01, 0.99]))):
        planned = plan(ends[k], belief=replace(pair, probability=p))
        gaps = metric.gap(planned.predicted, ends[k])
        assert gaps[k] < 0.01 < gaps[1 - k]


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"pose": np.zeros(2)}, r"pose must be of shape \(3,\), got \(2,\)"),
        ({"pose": [np.nan, 0.0, 0.0]}, "pose must be finite, got nan"),
        ({"targets": np.zeros((0, 3))}, r"targets must be of shape \(3,\) or \(G, 3\), got \(0, 3\)"),
        ({"targets": []}, r"targets must be .* got \(0,\)"),
        ({"targets": [[0.3, 0.0]]}, r"targets must be .* got \(1, 2\)"),
        ({"targets": [0.3, np.inf, 0.0]}, "targets must be finite, got inf"),
        ({"costs": [1.0, 2.0]}, r"costs must be of shape \(1,\), got \(2,\)"),
        ({"costs": [np.nan]}, "costs must be finite"),
    ],
)
def test_wrong_arguments_are_refused_by_name(changed, told):
    with pytest.raises(ValueError, match=told):
        plan(**{"targets": [0.2, 0.0, 0.0], **changed})


def test_lists_are_poses_too():
    one = plan([0.15, 0.05, 0.2], pose=list(START))
    np.testing.assert_array_equal(one.push.end, plan(np.array([0.15, 0.05, 0.2])).push.end)
