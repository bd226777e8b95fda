"""The next push separates simulated rivals, and by as much as it claims."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from slipmap.models.effects.registry import effects_named
from slipmap.models.geometry import placed
from slipmap.models.inference.diagnosis.correlated import CorrelatedLikelihood, FitData
from slipmap.models.inference.diagnosis.fitting import Fitted, Fitter
from slipmap.models.inference.diagnosis.results import ParameterEstimate, parameter_estimates
from slipmap.models.inference.error_model import FORCE_MEMORY, MEMORY, ErrorModel, sensor_noise
from slipmap.models.inference.observations import observe_all
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners import telling_push
from slipmap.planners.action_selection import choose_push
from slipmap.planners.exploration import NoReachablePush, candidate_pushes
from slipmap.planners.rehearsal import habits_of
from slipmap.planners.telling_push import push_of, rivals_of, robots_question

RADIUS, MASS, MU = 0.006, 0.6, 0.3
SPEED = 0.05
KEYS = {
    "pose", "contact", "direction_deg", "speed", "length", "dwell", "tip_start", "tip_end", "separates",
    "separation",
    "sentence",
}  # fmt: skip


def next_push(diagnosis, dataset, seed=0):
    return telling_push.next_push(diagnosis, dataset, seed)[0]


class World:
    """Six recorded pushes along +x, all at one speed, and models of them."""

    def __init__(self) -> None:
        rng = np.random.default_rng(2)
        self.grid = cells_from_polygon(np.array([[-5, -3], [5, -3], [5, 3], [-5, 3]]) * 0.01, width=0.02)
        n = len(self.grid)
        slider = Slider(self.grid, RADIUS)
        maps = Maps(np.full((1, n), MASS / n), np.full((1, n), MU), np.array([0.35]))
        pushes = []
        for candidate in candidate_pushes(
            self.grid, RADIUS, rng, 6, length=(0.06, 0.08), speed=(SPEED, SPEED), cone=0.2
        ):
            yaw = -np.arctan2(candidate.direction[1], candidate.direction[0])
            pushes.append(candidate.push([*rng.uniform(-0.03, 0.03, 2), yaw + rng.normal(0, 0.1)]))
        self.dataset = record_pushes(slider, maps, pushes, rng, mass=MASS)
        self.observations = observe_all(self.dataset)
        noise = sensor_noise(self.dataset)
        self.error = ErrorModel(noise, 0.08, 0.04)
        self.fitter = Fitter(self.dataset, self.observations, noise)
        self.fitter.weight = MASS * 9.81

    def model(self, name: str = "", values: tuple[float, ...] = (), friction: float = MU) -> Fitted:
        """A fitted model with an effect of known size and uniform friction."""
        effects = effects_named([name]) if name else ()
        prior = self.fitter.prior(effects)
        z = np.zeros(prior.size)
        z[prior.plain - 2] = np.log(friction / 0.3) / prior.settings.friction_scale
        if name:
            z[prior.plain :] = prior.effect_coordinates(np.array(values))
        likelihood = CorrelatedLikelihood(prior, FitData(self.observations, prior.slider.grid), self.error)
        offsets = np.zeros((len(self.observations), 3))
        return Fitted(tuple(effects), likelihood, z, np.zeros(prior.size), offsets, 0.0)

    def diagnosis(self, verdict: str, rivals: list[Fitted], depends_on: str | None = None) -> SimpleNamespace:
        base = self.model()
        best = rivals[0] if rivals else base
        return SimpleNamespace(
            verdict=verdict,
            rivals=tuple(rivals),
            base=base,
            best=best,
            depends_on=depends_on,
            candidates=(),
            quick=False,
            coarseness=1.0,
            fault=None,
        )


@pytest.fixture(scope="module")
def world() -> World:
    return World()


def apart(world: World, told: dict, one: Fitted, other: Fitted) -> float:
    """Separation of two models on a push, computed anew from dense covariances."""
    push = push_of(told, order=len(world.dataset.trials))
    outs = []
    for fitted in (one, other):
        prior = fitted.likelihood.prior
        outs.append(prior.slider.rollout(prior.maps(fitted.z[None]), [push]))
    centers = world.grid.centers
    radius = np.sqrt((centers**2).sum(axis=1).mean())
    middle = 0.5 * (outs[0].poses[0] + outs[1].poses[0])
    track = np.vstack([push.start_pose, middle])
    way = np.cumsum(add(track[1:], track[:-1], centers))
    # Fine quadrature of the error that lasts a stretch of way.
    at = np.linspace(0, way[-1], 1501)[1:] - way[-1] / 3000
    kernel = np.exp(-np.abs(at[:, None] - at) / MEMORY) * (way[-1] / 1500) ** 2
    until = (at[None] < way[:, None]).astype(float)
    lasting = world.error.motion**2 * until @ kernel @ until.T
    noise = world.error.noise
    pose_rows = np.median(np.concatenate([o.pose_rows for o in world.observations]))
    force_rows = np.median(np.concatenate([o.force_rows[o.sliding] for o in world.observations]))
    total = 0.0
    difference = (outs[0].poses - outs[1].poses)[0] * [1, 1, radius]
    for i, sigma in enumerate((noise.position, noise.position, radius * noise.angle)):
        total += difference[:, i] @ np.linalg.solve(
            lasting + sigma**2 / pose_rows * np.eye(30), difference[:, i]
        )
    edges = np.linspace(0, len(push.tip) - 1, 31).astype(int)
    means = np.array([[out.forces[0, a:b].mean(axis=0) for a, b in pairwise(edges)]
                      for out in outs])  # fmt: skip
    speed = np.hypot(*np.diff(push.tip, axis=0).T)
    pace = np.array([speed[a:b].mean() for a, b in pairwise(edges)])
    size = np.hypot(*means.mean(axis=0).T)
    good = (pace > 0.5 * pace.max()) & (size > 0.2 * np.percentile(size, 90))
    good = good & np.roll(good, 1) & np.roll(good, -1)
    times = (np.arange(30) + 0.5)[good] / 30 * push.h * (len(push.tip) - 1)
    typical = np.median(size[good])
    covariance = (world.error.force * typical) ** 2 * np.exp(-np.abs(times[:, None] - times) / FORCE_MEMORY)
    covariance += noise.force**2 / force_rows * np.eye(len(times))
    for i in range(2):
        gap = (means[0] - means[1])[good, i]
        total += gap @ np.linalg.solve(covariance, gap)
    return float(np.sqrt(total))


def test_viscous_and_stribeck_are_told_apart_by_speed(world: World) -> None:
    # At the speed of all recorded pushes, both have the friction of the plain model with 0.3.
    excess, slow, area = 0.5, 0.05, 0.1 * 0.06
    stribeck = world.model(
        "stribeck_friction", (excess, slow, 2.0), MU / (1 + excess * np.exp(-((SPEED / slow) ** 2)))
    )
    drag = 0.3 * MU * MASS * 9.81 / (area * SPEED)
    viscous = world.model("viscous_friction", (drag,), 0.7 * MU)
    for seed in range(3):
        told = next_push(world.diagnosis("ambiguous", [viscous, stribeck]), world.dataset, seed)
        assert told is not None
        assert set(told) == KEYS
        assert told["separates"] == ["viscous_friction", "stribeck_friction"]
        assert abs(np.log(told["speed"] / SPEED)) > 0.3
        assert SPEED / 1.6 < told["speed"] < 1.6 * SPEED
        claimed = told["separation"]
        assert apart(world, told, viscous, stribeck) == pytest.approx(claimed, rel=0.03)
        assert claimed > 1.4 * apart(world, told | {"speed": SPEED}, viscous, stribeck)
        assert "(viscous_friction)" in told["sentence"]


def test_tilt_and_tether_are_told_apart_by_a_reversed_push_or_another_place(world: World) -> None:
    tilt = world.model("table_tilt", (0.06, 0.0))
    stiffness = 0.06 * MASS * 9.81 / 0.2
    tether = world.model("tether", (stiffness, 0.22, 0.0, 0.0, 0.0, 0.0))
    told = next_push(world.diagnosis("ambiguous", [tilt, tether]), world.dataset)
    assert told is not None
    assert apart(world, told, tilt, tether) == pytest.approx(told["separation"], rel=0.03)
    likeness = []
    for observation in world.observations:
        tip = observation.push.tip
        recorded = {
            "pose": observation.push.start_pose,
            "tip_start": tip[0],
            "tip_end": tip[-1],
            "speed": SPEED,
            "dwell": 0.0,
        }
        likeness.append(apart(world, recorded, tilt, tether))
    assert told["separation"] > 1.3 * max(likeness)
    starts = np.array([o.push.start_pose[:2] for o in world.observations])
    moved = np.hypot(*(starts - told["pose"][:2]).T).min()
    assert abs(told["direction_deg"]) > 45 or moved > 0.02


def test_the_push_can_be_made(world: World) -> None:
    rivals = [world.model("table_tilt", (0.06, 0.0)), world.model("tether", (1.0, 0.2, 0.0, 0.0, 0.0, 0.0))]
    table = Table("rectangle", (0.0, 0.0), size=(0.36, 0.3))
    dataset = replace(world.dataset, table=table)
    for seed in range(3):
        told = next_push(world.diagnosis("ambiguous", rivals), dataset, seed)
        assert told is not None
        push = push_of(told)
        c, s = np.cos(told["pose"][2]), np.sin(told["pose"][2])
        local = (push.tip - told["pose"][:2]) @ np.array([[c, -s], [s, c]])
        from shapely import Point

        # The finger stands free at first and meets the outline at the contact point.
        assert world.grid.polygon.distance(Point(local[0])) > RADIUS + 1e-3
        x, y = told["contact"]
        assert world.grid.polygon.boundary.distance(Point(x, y)) < 1e-9
        direction = (local[-1] - local[0]) / np.hypot(*(local[-1] - local[0]))
        touch = np.array([x, y]) - local[0]
        assert abs(touch[0] * direction[1] - touch[1] * direction[0]) <= RADIUS + 1e-9
        corners = world.grid.exterior @ np.array([[c, s], [-s, c]]) + told["pose"][:2]
        assert np.all(np.abs(corners) < [0.18, 0.15])
        for fitted in rivals:
            prior = fitted.likelihood.prior
            force = np.hypot(*prior.slider.rollout(prior.maps(fitted.z[None]), [push]).forces[0].T)
            moving = np.hypot(*np.diff(push.tip, axis=0).T) > 0.99 * told["speed"] * push.h
            # The finger has not slid off when it stops.
            assert np.median(force[np.flatnonzero(moving)[-10:]]) > 0.1
        assert np.hypot(*np.subtract(told["tip_end"], told["tip_start"])) == pytest.approx(
            told["length"] + 0.01
        )


def test_one_effect_is_pinned_down_at_the_ends_of_its_interval(world: World) -> None:
    """The interval that the diagnosis reports, or that of the fit where it reports none."""
    viscous = world.model("viscous_friction", (500.0,))
    diagnosis = world.diagnosis("effect", [viscous])
    told = next_push(diagnosis, world.dataset)
    assert told is not None
    assert told["separates"][0].startswith("viscous_friction drag_per_area = ")
    assert told["separation"] > 0.1
    own = [rival.maps.effects[0, 0] for rival in rivals_of(diagnosis, world.dataset)]
    (fitted,) = parameter_estimates(viscous)
    assert own == pytest.approx([fitted.low, fitted.high])
    estimate = ParameterEstimate("viscous_friction", "drag_per_area", "N s/m³", 500.0, 300.0, 900.0)
    diagnosis.candidates = (SimpleNamespace(name="viscous_friction", parameters=(estimate,)),)
    rivals = rivals_of(diagnosis, world.dataset)
    assert [rival.maps.effects[0, 0] for rival in rivals] == pytest.approx([300.0, 900.0])
    assert [rival.name for rival in rivals] == [
        f"viscous_friction drag_per_area = {end} N s/m³" for end in (300, 900)
    ]


def test_what_only_the_way_shows_is_not_told_by_pushes_seen_at_their_ends(world: World) -> None:
    """A late tracker changes no pose at rest."""
    question = robots_question(
        world.diagnosis("effect", [world.model("sensor_latency", (0.05,))]), world.dataset
    )
    assert question is not None
    pushes = [push_of(next_push(world.diagnosis("undecided", []), world.dataset))]
    ends = [
        replace(trial, object_pose=replace(trial.object_pose, time=time[[0, -1]], values=poses[[0, -1]]))
        for trial in world.dataset.trials
        for time, poses in [(trial.object_pose.time, trial.object_pose.values)]
    ]
    habits = habits_of(world.observations, replace(world.dataset, trials=tuple(ends)))
    assert habits.ends_only and not question.habits.ends_only
    assert question.told_by(pushes)[0] > 10.0
    assert replace(question, habits=habits).told_by(pushes)[0] < 0.01


def test_a_push_claims_only_what_it_tells(world: World, monkeypatch) -> None:
    """Of three models, two are predicted alike, or all are."""
    tilt, tether = (
        world.model("table_tilt", (0.06, 0.0)),
        world.model("tether", (1.0, 0.2, 0.0, 0.0, 0.0, 0.0)),
    )
    diagnosis = world.diagnosis("ambiguous", [tilt, tether])
    whole = telling_push.Question.apart
    monkeypatch.setattr(telling_push, "_CANDIDATES", 30)
    monkeypatch.setattr(telling_push.Question, "apart", lambda *one: np.minimum(whole(*one), 0.9))
    assert telling_push.next_push(diagnosis, world.dataset, 0) == (None, "table_tilt from tether")

    def one_hidden(question, pushes):
        found = whole(question, pushes)
        return (
            np.where(np.arange(len(found))[:, None] == 0, 0.1, found) if len(question.rivals) > 3 else found
        )

    monkeypatch.setattr(telling_push.Question, "apart", one_hidden)
    undecided = world.diagnosis("undecided", [])
    hidden, *others = [rival.name for rival in rivals_of(undecided, world.dataset)][1:]
    told = next_push(undecided, world.dataset)
    assert hidden not in told["separates"] and set(told["separates"]) <= set(others)
    assert told["separation"] > 1.0 and f"but not {hidden}" in told["sentence"]


def test_undecided_shows_what_is_hardly_seen(world: World) -> None:
    told = next_push(world.diagnosis("undecided", []), world.dataset)
    assert told is not None
    assert 2 <= len(told["separates"]) <= 5
    assert "no effect" not in told["separates"]


@pytest.mark.parametrize(
    ("probe", "words"),
    [
        ("force_by_place", "at another place"),
        ("friction_by_direction", "turned by 90 degrees"),
        ("friction_by_speed", "times its speed"),
        ("friction_by_time", "a stop of 2 s"),
        ("friction_by_order", "exactly as it was"),
    ],
)
def test_unknown_repeats_the_worst_push_with_one_thing_changed(world: World, probe: str, words: str) -> None:
    told = next_push(world.diagnosis("unknown", [], f"{probe}: some sentence."), world.dataset)
    assert told is not None
    assert words in told["sentence"]
    (trial,) = re.findall(r"push (trials/\d+\.json)", told["sentence"])
    (recorded,) = [o.push for o in world.observations if o.trial == trial]
    moved = not np.allclose(told["pose"], recorded.start_pose)
    assert moved == (probe in ("force_by_place", "friction_by_direction"))
    push_of(told)
    # The model fits; the worst of six pushes has about the expected error, however many rows it has.
    assert 0.3 < told["separation"] < 3.0 and "times the expected error" in told["sentence"]


@pytest.mark.parametrize(
    ("probe", "low", "high", "words"),
    [
        ("friction_by_direction", (-0.1, -0.14), (0.2, 0.07), "turned by -90 degrees"),
        ("friction_by_direction", (-0.15, -0.08), (0.15, 0.05), "turned by 180 degrees"),
        ("friction_by_direction", (-0.05, -0.08), (0.13, 0.05), "exactly as it was, because a change would"),
        ("force_by_place", (-0.05, -0.08), (0.13, 0.06), "at another place"),
        ("force_by_place", (-0.03, -0.075), (0.12, 0.04), "exactly as it was, because a change would"),
    ],
)
def test_the_worst_push_changed_stays_on_the_table(world: World, probe: str, low, high, words: str) -> None:
    """The worst push goes from x = -24 mm, y = -71 mm to 115 and 35 mm, by the corners of the outline."""
    table = Table("rectangle", tuple(np.add(low, high) / 2), size=tuple(np.subtract(high, low)))
    diagnosis = world.diagnosis("unknown", [], f"{probe}: some sentence.")
    told = next_push(diagnosis, replace(world.dataset, table=table))
    assert told is not None
    before = placed(world.grid.exterior, np.array(told["pose"]))
    after = before + np.subtract(told["tip_end"], told["tip_start"])
    assert table.margin(np.vstack([before, after])).min() > 0.0
    assert words in told["sentence"]
    assert ("depends on what you changed" in told["sentence"]) == ("exactly" not in words)


def test_nothing_to_find_out(world: World) -> None:
    assert next_push(world.diagnosis("adequate", []), world.dataset) is None


def test_a_seed_gives_the_same_push(world: World) -> None:
    rivals = [world.model("table_tilt", (0.06, 0.0)), world.model("tether", (1.0, 0.2, 0.0, 0.0, 0.0, 0.0))]
    diagnosis = world.diagnosis("ambiguous", rivals)
    first = next_push(diagnosis, world.dataset, 4)
    assert first == next_push(diagnosis, world.dataset, 4)
    assert next_push(diagnosis, world.dataset, 5) != first


def test_a_robots_push_is_the_one_of_its_own_that_tells_most(world):
    """Of the pushes that it can make where the object lies."""
    tilt = world.model("table_tilt", (0.06, 0.0))
    question = robots_question(world.diagnosis("effect", [tilt]), world.dataset)
    assert question.words == "table_tilt from no effect"
    pose, offered = np.array([0.01, 0.02, 0.3]), []

    def chosen(**options):
        rng = np.random.default_rng(4)
        return choose_push(world.grid, pose, RADIUS, tap=False, rng=rng, **options)

    def offer(push):
        offered.append(push)
        return False

    def told(push):
        asked = {"pose": pose, "tip_start": push.begin, "tip_end": push.end, "speed": push.speed, "dwell": 0}
        return apart(world, asked, tilt, world.model())

    with pytest.raises(NoReachablePush):
        chosen(strategy="random", allowed=offer)
    best = chosen(question=question)
    assert len(offered) > 20 and told(best.push) > 1.3 * np.median([told(push) for push in offered])
    assert best.why.startswith("to tell table_tilt from no effect: ")
    assert float(best.why.split()[-3]) == pytest.approx(told(best.push), rel=0.2)
    # Where the arm cannot make it, the next best is taken.
    other = chosen(question=question, allowed=lambda push: not np.array_equal(push.end, best.push.end))
    assert float(other.why.split()[-3]) <= float(best.why.split()[-3])
    assert not np.array_equal(other.push.end, best.push.end)


def test_a_robot_asks_what_its_diagnosis_left_open(world):
    tilt, tether = (
        world.model("table_tilt", (0.06, 0.0)),
        world.model("tether", (4.0, 0.3, 0.0, 0.1, 0.0, 0.0)),
    )
    ambiguous = robots_question(world.diagnosis("ambiguous", [tilt, tether]), world.dataset)
    assert ambiguous.words == "table_tilt from tether"
    undecided = world.diagnosis("undecided", [])
    gains = [("tether", 1.0), ("viscous_friction", 3.0), ("table_tilt", 5.0), ("sensor_latency", 2.5)]
    undecided.candidates = tuple(SimpleNamespace(name=n, gain=g, fitted_gain=None) for n, g in gains)
    assert (
        robots_question(undecided, world.dataset).words == "table_tilt, viscous_friction and no effect apart"
    )
    for verdict in ("adequate", "unknown"):
        assert robots_question(world.diagnosis(verdict, []), world.dataset) is None


def test_a_finger_that_begins_in_an_opening_is_lowered_into_it():
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    ring = cells_from_polygon(0.1 * square + [0.05, 0.0], [0.04 * square + [0.1, 0.0]], count=40)
    push = {"pose": [0.3, 0.2, 0.5 * np.pi], "tip_end": [0.3, 0.5], "speed": 0.02, "dwell": 0.0}
    push["length"] = 0.19
    said = telling_push._how_to(push | {"tip_start": [0.3, 0.3]}, ring)
    assert "lower the finger into the opening first, then move it from (300, 300) mm" in said
    assert "to (300, 500) mm, 190 mm of this after first touch, at 20 mm/s" in said
    said = telling_push._how_to(push | {"tip_start": [0.4, 0.0]}, ring)
    assert "opening" not in said and "move the finger from (400, 0) mm" in said
