"""Imagined pushes against finer rollouts that really stop, with the finger really off."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from slipmap.models.geometry import relative
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.physics.balance import balance_margins
from slipmap.models.physics.rollout import Push
from slipmap.planners import robust_push
from slipmap.planners.contact_lines import ContactContour
from slipmap.planners.robust_push import Scenarios, foresee, least_margins
from slipmap.planners.settings import PushSettings
from slipmap.planners.waypoints import PoseMetric
from tests.planners.cell_world import RADIUS, TABLE, belief_about

THING = benchmark_object("hammer")
POSE = np.array([0.05, -0.02, 0.8])


def imagined(belief, settings, pose=POSE, table=TABLE):
    rng = np.random.default_rng(0)
    contour = ContactContour(belief.grid, RADIUS, settings.approach)
    lines = contour.spread(np.zeros(0), settings.candidates, np.radians(settings.cone), rng)
    scenarios = Scenarios.of(belief, settings, rng)
    return scenarios, foresee(scenarios, pose, lines, table, settings)


def pushed(scenarios, s, begin, end, pose, speed=0.03):
    """Pose after a slow push in fine steps, with a rest at the end."""
    way = np.hypot(*(end - begin))
    steps = int(way / 5e-4)
    tip = begin + np.outer(np.append(np.linspace(0, 1, steps + 1), np.ones(40)), end - begin)
    push = Push(5e-4 / speed, tip, pose)
    return scenarios.slider.rollout(scenarios.maps[s : s + 1], [push]).end[0, 0, :3]


def test_every_length_ends_where_a_push_of_that_length_ends_with_the_finger_off():
    settings = PushSettings(candidates=6, scenarios=3)
    belief = belief_about(THING, hypotheses=3)
    scenarios, seen = imagined(belief, settings)
    errors = []
    for c in range(6):
        for s, (dx, dy, turn) in enumerate(scenarios.noise):
            cos, sin = np.cos(turn), np.sin(turn)
            direction = np.array([[cos, -sin], [sin, cos]]) @ seen.directions[c]
            begin = seen.begins[c] + [dx, dy]
            for length in (5, 20):
                end = begin + (settings.approach + seen.lengths[length]) * direction
                expected = pushed(scenarios, s, begin, end, POSE)
                errors.append(np.abs(seen.poses[c, length, s] - expected) * [1, 1, 0.1])
    assert np.median(errors) < 3e-4
    assert np.quantile(errors, 0.95) < 1.5e-3


def test_noise_is_drawn_for_each_hypothesis_and_has_no_bias():
    settings = PushSettings(scenarios=20)
    one = Scenarios.of(belief_about(THING, hypotheses=1), settings, np.random.default_rng(0))
    assert len(one) == 20
    assert one.probability @ one.noise == pytest.approx(np.zeros(3), abs=1e-15)
    assert one.noise[:, 2].std() == pytest.approx(np.radians(1.0), rel=0.4)
    many = Scenarios.of(belief_about(THING, hypotheses=30), settings, np.random.default_rng(0))
    assert many.hypothesis.tolist() == list(range(30))
    assert one.of_hypotheses(np.arange(60.0).reshape(20, 3)).shape == (1, 3)


@pytest.mark.parametrize("table", [TABLE, Table("rectangle", (0.1, 0.0), size=(0.9, 0.7))])
def test_falls_are_the_hypotheses_that_lose_balance_on_the_way(table):
    settings = PushSettings(candidates=8, margin=0.01)
    belief = belief_about(THING, hypotheses=20)
    pose = np.array([0.4, 0.1, 1.0])
    scenarios, seen = imagined(belief, settings, pose, table)
    expected = np.zeros_like(seen.falls)
    for c in range(8):
        for s, k in enumerate(scenarios.hypothesis):
            margins = balance_margins(
                belief.grid, belief.centers_of_mass[k : k + 1], seen.poses[c, :, s], table
            )
            expected[c] += scenarios.probability[s] * (np.minimum.accumulate(margins[:, 0]) < 0.01)
    assert seen.falls == pytest.approx(expected)
    assert 0.05 < expected.mean() < 0.95


def test_a_slender_object_does_not_count_as_falling_where_it_lies_safely():
    wrench = belief_about(benchmark_object("wrench"))
    free = balance_margins(wrench.grid, wrench.centers_of_mass, np.zeros((1, 3)), TABLE)[0]
    least = least_margins(wrench, PushSettings(margin=0.03))
    assert (least < free).all()
    assert least_margins(belief_about(THING), PushSettings(margin=0.002)) == pytest.approx(0.002)


def test_at_the_rim_the_table_stays_where_it_is_with_the_finger_off():
    """Imagined with object and table moved instead of the finger."""
    settings = PushSettings(candidates=12, scenarios=3, longest=0.05, lengths=2, position_noise=0.005)
    belief = belief_about(THING, hypotheses=3)
    table = Table("rectangle", (0.06 - 0.5, 0.0), size=(1.0, 1.0))
    pose = np.array([0.04, 0.0, np.pi / 2])
    scenarios, seen = imagined(belief, settings, pose, table)
    errors, wrong = [], []
    for c in range(12):
        for s, (dx, dy, turn) in enumerate(scenarios.noise):
            cos, sin = np.cos(turn), np.sin(turn)
            direction = np.array([[cos, -sin], [sin, cos]]) @ seen.directions[c]
            begin = seen.begins[c] + [dx, dy]
            end = begin + (settings.approach + seen.lengths[1]) * direction
            center = scenarios.centers_of_mass[s : s + 1]
            if balance_margins(belief.grid, center, seen.poses[c, :, s], table).min() < 0.005:
                continue
            for slider, gaps in ((scenarios.slider.on(table), errors), (scenarios.slider.on(None), wrong)):
                there = pushed(replace(scenarios, slider=slider), s, begin, end, pose)
                gaps.append(np.abs(seen.poses[c, 1, s] - there) * [1, 1, 0.1])
    assert np.median(errors) < 1.5e-4 and np.max(errors) < 1e-3
    assert np.median(wrong) > 3 * np.median(errors) and np.max(wrong) > 4e-3


def test_what_is_imagined_onward_knows_no_rim():
    """`moves` are those of the same pushes in the middle of the table; there they are those of `poses`."""
    settings = PushSettings(candidates=6, scenarios=4)
    belief = belief_about(THING, hypotheses=2)
    pose, inner = np.array([0.42, 0.0, 1.0]), np.array([0.0, 0.0, 1.0])
    _, rim = imagined(belief, settings, pose)
    _, middle = imagined(belief, settings, inner)
    assert rim.moves == pytest.approx(middle.moves, abs=1e-9)
    assert relative(inner, middle.poses) == pytest.approx(middle.moves, abs=1e-12)
    assert np.abs(relative(pose, rim.poses) - rim.moves).max() > 1e-3


def test_tipping_between_looks_is_a_fall(monkeypatch):
    settings = PushSettings(candidates=8)
    pose = np.array([0.42, 0.1, 1.0])
    monkeypatch.setattr(robust_push, "own_balance_margins", lambda *arguments: np.ones(len(arguments[2])))
    _, seen = imagined(belief_about(THING, hypotheses=5), settings, pose)
    assert seen.falls.max() == pytest.approx(1.0)
    assert (np.diff(seen.falls, axis=1) >= 0).all()
    assert seen.falls[:, 0].max() < 1.0


def test_what_the_model_is_off_by_is_imagined_in_proportion_to_the_way():
    """The region of a plan is as wide as the belief says that ends are off; other draws stay as they were."""
    settings = PushSettings(candidates=6, scenarios=400, position_noise=0.0, angle_noise=0.0)
    sure = belief_about(THING, hypotheses=1)
    doubtful = replace(sure, settings={**sure.settings, "end_errors": [0.1, 0.05]})
    plain, seen = imagined(sure, settings)
    drifting, wide = imagined(doubtful, settings)
    assert not plain.drift.any() and (plain.noise == drifting.noise).all()
    off = wide.poses - seen.poses
    assert np.abs(np.einsum("s,clsx->clx", drifting.probability, off)).max() < 1e-9
    metric = PoseMetric(sure.grid)
    way = metric.gap(seen.poses[:, :, 0], POSE)
    expected = way[..., None] * [0.1, 0.1, 0.05 / metric.radius]
    assert off.std(axis=2) == pytest.approx(expected, rel=1e-6)
    assert (wide.poses[:, -1].std(axis=1)[:, :2] > 1e-3).any()


def test_all_plausible_sizes_of_the_models_error_are_imagined():
    """As many ends lie within a distance as in regions of predicted ends, which average over the sizes."""
    settings = PushSettings(candidates=6, scenarios=1000, position_noise=0.0, angle_noise=0.0)
    sure = belief_about(THING, hypotheses=1)
    sizes = [0.001, 0.01, 0.1]
    doubtful = replace(sure, settings={**sure.settings, "end_errors": [sizes, sizes]})
    drifting, _ = imagined(doubtful, settings)
    assert np.abs(drifting.probability @ drifting.drift).max() < 1e-12
    x = np.abs(drifting.drift[:, 0])
    for limit in (0.002, 0.02, 0.2):
        expected = np.mean([2 * norm.cdf(limit / size) - 1 for size in sizes])
        assert np.mean(x < limit) == pytest.approx(expected, abs=0.04)


def test_an_object_that_may_end_elsewhere_falls_more_often():
    settings = PushSettings(candidates=12, scenarios=60, position_noise=0.0, angle_noise=0.0)
    sure = belief_about(THING, hypotheses=1)
    near_the_rim = np.array([0.30, 0.0, 0.4])
    believed = [replace(sure, settings={"end_errors": errors}) for errors in ([0.0, 0.0], [0.1, 0.1])]
    falls = [imagined(belief, settings, near_the_rim)[1].falls for belief in believed]
    doubtful = (falls[1] > 0.0) & (falls[1] < 1.0)
    assert not ((falls[0] > 0.0) & (falls[0] < 1.0)).any()
    assert doubtful.any()
