"""Algorithm 2: which push is chosen, and what it keeps to."""

from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from slipmap.models.inference.belief import Belief
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.objects import cells_from_polygon
from slipmap.models.objects.benchmark_objects import hammer
from slipmap.models.physics.balance import balance_margins
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.rollout import Maps, Push, Slider, Smoothing
from slipmap.planners.action_selection import _imagined, choose_push
from slipmap.planners.exploration import NoReachablePush
from slipmap.planners.settings import STRATEGIES, PokeSettings
from slipmap.planners.table_push import TablePush

RADIUS = 0.008
POSE = np.array([0.02, -0.03, 0.7])


def a_belief(masses) -> Belief:
    grid, truth = hammer()
    return Belief(
        grid=grid, finger_radius=RADIUS, gravity=9.81,
        maps=Maps(np.array(masses), np.repeat(truth.mu, len(masses), axis=0), np.full(len(masses), 0.3)),
        probability=np.full(len(masses), 1 / len(masses)), smoothing=Smoothing(),
        dataset="", fingerprint="", method="gauss-newton", seed=0,
    )  # fmt: skip


def choose(seed=0, **options):
    return choose_push(hammer()[0], POSE, RADIUS, rng=np.random.default_rng(seed), **options)


@pytest.fixture(scope="module")
def off_its_table():
    """A hammer on a table so small that every push moves it over the rim."""
    return {
        "belief": a_belief(hammer()[1].mass),
        "past": [choose(5)],
        "settings": PokeSettings(shortest=0.25, longest=0.3),
        "table": Table("round", tuple(POSE[:2]), radius=0.25),
    }


def outline_on_table(grid, pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return shapely.Polygon(grid.exterior @ np.array([[c, s], [-s, c]]) + pose[:2])


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_push_begins_beside_the_object_and_runs_into_it(strategy):
    grid, truth = hammer()
    past = [choose(seed) for seed in (5, 6)]
    belief = a_belief([truth.mass[0], truth.mass[0] * 2])
    choice = choose(strategy=strategy, past=past, belief=belief, tap=False)
    outline = outline_on_table(grid, POSE)
    assert outline.distance(shapely.Point(choice.push.begin)) > RADIUS
    assert outline.distance(shapely.LineString([choice.push.begin, choice.push.end])) == 0
    habits = PokeSettings()
    assert habits.shortest <= choice.push.length - habits.approach <= habits.longest
    assert habits.slowest <= choice.push.speed <= habits.fastest


def test_the_first_poke_is_slow_and_most_others_are_taps():
    habits = PokeSettings(taps=0.8)
    assert [habits.is_tap(number) for number in range(10)] == [False, *4 * [True], False, *4 * [True]]
    assert choose().push.creep == 0.0
    tap = choose(past=[choose()]).push
    assert tap.speed == habits.tap_speed
    assert tap.creep == pytest.approx(habits.approach + 0.004)


def test_the_most_different_push_is_farther_from_the_past_than_random_ones():
    past = [choose(seed) for seed in range(4)]

    def nearest(choice):
        return min(
            np.hypot(*(choice.contact - p.contact)) / 0.07 + np.hypot(*(choice.direction - p.direction))
            for p in past
        )

    chosen = [nearest(choose(seed, strategy="most-different", past=past)) for seed in range(10, 20)]
    drawn = [nearest(choose(seed, strategy="random", past=past)) for seed in range(10, 20)]
    assert np.mean(chosen) > 1.3 * np.mean(drawn)


def test_the_most_distinctive_push_is_where_hypotheses_disagree():
    """Hypotheses that differ in where the mass is turn differently; the chosen push must show it more."""
    grid, truth = hammer()
    uniform = np.full(len(grid), truth.mass.sum() / len(grid))
    belief = a_belief([truth.mass[0], uniform])

    def gap(choice):
        from slipmap.planners.rehearsal import straight_push

        out = belief.slider.rollout(
            belief.maps, [straight_push(POSE, choice.push.begin, choice.push.end, choice.push.speed)]
        )
        return np.hypot(*(out.end[0, 0, :2] - out.end[1, 0, :2])) + 0.05 * abs(
            out.end[0, 0, 2] - out.end[1, 0, 2]
        )

    past = [choose(99)]
    chosen = [gap(choose(s, strategy="most-distinctive", past=past, belief=belief)) for s in range(4)]
    drawn = [gap(choose(s, strategy="random", past=past, belief=belief)) for s in range(12)]
    assert min(chosen) > np.mean(drawn)
    assert np.mean(chosen) > 2 * np.mean(drawn)


def test_a_hypothesis_without_probability_decides_nothing():
    grid, truth = hammer()
    rng = np.random.default_rng(1)
    wild = truth.mass[0] * rng.uniform(0.1, 3.0, len(grid))
    three = a_belief([truth.mass[0], truth.mass[0] * 1.5, wild])
    impossible = replace(three, probability=np.array([0.5, 0.5, 0.0]))
    two = a_belief([truth.mass[0], truth.mass[0] * 1.5])
    options = {"strategy": "most-distinctive", "past": [choose(99)]}
    a, b = (choose(3, belief=belief, **options) for belief in (impossible, two))
    assert np.array_equal(a.push.begin, b.push.begin)


def test_the_object_stays_in_its_region():
    far = np.array([0.3, 0.0, 0.2])
    grid = hammer()[0]
    for seed in range(10):
        choice = choose_push(grid, far, RADIUS, strategy="random", rng=np.random.default_rng(seed))
        c, s = np.cos(far[2]), np.sin(far[2])
        middle = far[:2] + np.array([[c, -s], [s, c]]) @ grid.centers.mean(axis=0)
        way = choice.push.direction * (choice.push.length - PokeSettings().approach)
        assert np.hypot(*(middle + way)) < np.hypot(*middle)


@pytest.mark.parametrize("known", [False, True])
def test_near_the_rim_no_push_risks_a_fall(known):
    """The table's rim is 4 cm from the hammer's centre of mass, and under its head."""
    grid, truth = hammer()
    center = truth.mass[0] @ grid.centers / truth.mass[0].sum()
    table = Table("rectangle", (POSE[0] + 0.2 - 0.5, 0.0), size=(1.0, 0.8))
    pose = np.array([0.18 - center[0], -0.03, 0.0])
    habits = PokeSettings(region=0.5)
    belief = a_belief([truth.mass[0], truth.mass[0]]) if known else None
    slider = Slider(grid, RADIUS, table=table)

    def worst(**options):
        ends = []
        for seed in range(15):
            choice = choose_push(
                grid, pose, RADIUS, rng=np.random.default_rng(seed), strategy="random", settings=habits,
                belief=belief, **options,
            )  # fmt: skip
            end = slider.rollout(truth, [_imagined(choice.push, pose)]).end[0, :, :3]
            ends.append(balance_margins(grid, [center], end, table).min())
        return min(ends)

    now = balance_margins(grid, [center], pose[None], table).min()
    assert 0.03 < now < 0.05
    assert worst() < 0.0
    assert worst(table=table) > (0.02 if known else 0.0)


@pytest.mark.parametrize(("x", "mu"), [(0.25, 0.02), (0.3, 0.03), (0.35, 0.03)])
def test_a_slippery_object_comes_to_rest_on_the_table(x, mu):
    """A tap makes it slide on for seconds and over 10 cm; the finger has stopped long before."""
    grid = cells_from_polygon(0.05 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), width=0.02)
    maps = Maps(np.full((3, len(grid)), 0.02), np.full((3, len(grid)), mu), np.full(3, 0.3))
    belief = replace(a_belief([hammer()[1].mass[0]] * 3), grid=grid, maps=maps)
    table, pose = Table("round", (0.0, 0.0), radius=0.5), np.array([x, 0.0, 0.0])
    slider, taps = Slider(grid, RADIUS, table=table), []
    for seed in range(8):
        with suppress(NoReachablePush):
            choice = choose_push(
                grid, pose, RADIUS, strategy="random", belief=belief, table=table, tap=True,
                settings=PokeSettings(region=0.9), rng=np.random.default_rng(seed),
                allowed=lambda push: push.direction[0] > 0.7 and push.creep > 0,
            )  # fmt: skip
            taps.append(Push(0.005, choice.push.path(0.005, rest=6.0), pose))
    assert len(taps) >= 4
    assert not slider.rollout(maps[:1], taps).tipped.any()


OUTWARDS = np.array([0.39, 0.0, -np.pi / 2])
"""Where the hammer's head points over the rim of a round table of radius 0.5 m."""


def believed_near_the_rim(doubt):
    """The truth, by which a hammer at `OUTWARDS` stays, and with probability `doubt` a heavier head, by which
    it would have fallen."""
    grid, truth = hammer()
    mass = truth.mass[0]
    belief = a_belief([mass, mass * np.where(grid.centers[:, 1] > 0.1, 4.0, 0.25)])
    belief = replace(belief, probability=np.array([1.0 - doubt, doubt]))
    table = Table("round", (0.0, 0.0), radius=0.5)
    margins = balance_margins(grid, belief.centers_of_mass, OUTWARDS[None], table)[0]
    assert margins[1] < 0.0 < margins[0]
    return belief, table


def away_from_the_rim(doubt, strategy="random"):
    """The choice at `OUTWARDS`, and how much farther it moves each centre of mass inside the support, m."""
    belief, table = believed_near_the_rim(doubt)
    choice = choose_push(
        belief.grid, OUTWARDS, RADIUS, strategy=strategy, belief=belief, past=[choose(5)], table=table,
        rng=np.random.default_rng(1),
    )  # fmt: skip
    ends = belief.on(table).slider.rollout(belief.maps, [_imagined(choice.push, OUTWARDS)]).end[:, 0, :3]
    places = np.concatenate([OUTWARDS[None], ends])
    margins = balance_margins(belief.grid, belief.centers_of_mass, places, table)
    return choice, np.array([margins[1 + k, k] - margins[0, k] for k in range(2)])


@pytest.mark.parametrize("strategy", ["random", "most-distinctive"])
def test_a_negligible_hypothesis_forbids_no_push_that_the_others_allow(strategy):
    negligible, _ = away_from_the_rim(1e-6, strategy)
    impossible, _ = away_from_the_rim(0.0, strategy)
    assert np.array_equal(negligible.push.begin, impossible.push.begin)


@pytest.mark.parametrize("strategy", ["random", "most-distinctive"])
def test_a_hypothesis_by_which_the_object_had_fallen_asks_for_pushes_inwards(strategy):
    _, gained = away_from_the_rim(0.2, strategy)
    assert (gained >= 0.0).all()


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_where_nothing_is_safe_it_says_so(strategy, off_its_table):
    with pytest.raises(NoReachablePush, match=r"0 of .* safe on the table"):
        choose(strategy=strategy, **off_its_table)


def test_where_nothing_is_safe_a_question_is_not_asked(off_its_table):
    def told_by(pushes):
        raise AssertionError(f"asked about {len(pushes)} pushes")

    question = SimpleNamespace(told_by=told_by, habits=SimpleNamespace(pushes=1))
    with pytest.raises(NoReachablePush, match=r"0 of .* safe on the table"):
        choose(question=question, **off_its_table)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_where_no_tap_is_safe_it_pushes_slowly(strategy):
    """On a slippery table, the only tap to choose from would send the hammer over the rim."""
    belief = a_belief(hammer()[1].mass)
    belief = replace(belief, maps=replace(belief.maps, mu=0.1 * belief.maps.mu))
    habits = PokeSettings(tap_speed=1.0, region=0.5, longest=0.08, candidates=1)
    table = Table("round", tuple(POSE[:2]), radius=0.15)
    choice = choose(
        3, strategy=strategy, tap=True, belief=belief, past=[choose(5)], settings=habits, table=table
    )
    assert choice.push.creep == 0.0


def test_what_the_robot_cannot_do_is_passed_over():
    choice = choose(allowed=lambda push: push.begin[0] > POSE[0])
    assert choice.push.begin[0] > POSE[0]
    with pytest.raises(NoReachablePush, match="the robot can make none"):
        choose(allowed=lambda push: False)


def test_a_strategy_must_be_known():
    with pytest.raises(ValueError, match="random, most-different, most-distinctive"):
        choose(strategy="best")


def test_the_same_draws_give_the_same_push():
    a, b = choose(7), choose(7)
    assert np.array_equal(a.push.begin, b.push.begin) and not np.array_equal(
        a.push.begin, choose(8).push.begin
    )


def test_a_robot_that_can_make_no_tap_pushes_slowly():
    push = choose(tap=True, allowed=lambda push: push.creep == 0.0).push
    assert push.creep == 0.0
    assert push.speed <= PokeSettings().fastest


def farthest_end_beside(push, belief):
    """How much farther than the finger is displaced a push may end elsewhere, in the first hypothesis."""
    slider, maps, imagined = belief.slider, belief.maps[:1], _imagined(push, POSE)
    end = slider.rollout(maps, [imagined]).end[0, 0, :3]
    ways = [1e-3 * np.array([np.cos(a), np.sin(a)]) for a in POSE[2] + np.arange(4) * np.pi / 2]
    beside = [replace(imagined, tip=imagined.tip + way) for way in ways]
    return add(slider.rollout(maps, beside).end[0, :, :3], end, belief.grid.centers).max() / 1e-3


@pytest.mark.parametrize("seed", [0, 2, 4, 6])
def test_a_push_that_hinges_on_where_the_finger_touches_is_the_last_choice(seed):
    """Hypotheses that agree on all else disagree most on whether the finger slips off a corner."""
    _, truth = hammer()
    alike = np.exp(0.1 * np.random.default_rng(seed).standard_normal((4, len(truth.mass[0]))))
    belief = a_belief(alike * truth.mass)
    choice = choose(seed, past=[choose(5)], belief=belief, tap=False)
    assert farthest_end_beside(choice.push, belief) <= 3.0


def test_a_pose_may_be_a_list():
    grid = hammer()[0]
    chosen = choose_push(grid, POSE.tolist(), RADIUS, rng=np.random.default_rng(0))
    assert np.array_equal(chosen.push.begin, choose().push.begin)


@pytest.mark.parametrize("pose", [[np.nan, 0.0, 0.0], [0.0, 0.0]])
def test_what_is_no_pose_is_refused(pose):
    with pytest.raises(ValueError, match=r"choose_push: pose must be (finite|of shape \(3,\)), got"):
        choose_push(hammer()[0], pose, RADIUS, rng=np.random.default_rng(0))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"belief": "belief.npz"}, "belief must be a Belief, such as .*; got a str"),
        ({"table": 0.5}, "choose_push: table must be a Table, such as .*; got a float"),
        ({"past": 3}, "choose_push: past must be a list"),
        (
            {"past": [TablePush([-0.1, 0.0], [0.1, 0.0], 0.02)]},
            "choose_push: a past push must be a Choice, .*; got a TablePush",
        ),
    ],
)
def test_other_kinds_of_arguments_are_refused_by_name(options, words):
    with pytest.raises(TypeError, match=words):
        choose(**options)
