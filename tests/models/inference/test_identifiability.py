"""Whether mass, moment of inertia and shares of thirds count as shown, and whether intervals hold."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from slipmap.models.effects.registry import effects_named
from slipmap.models.inference import identification
from slipmap.models.inference.identifiability import thirds_of
from slipmap.models.inference.identification import identify
from slipmap.models.inference.results import Quantity
from slipmap.models.measurements import Channel, KnownMaps, PushDataset, Trial
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners.exploration import candidate_pushes

FRICTION = 4.0  # N
INERTIAL = ("total mass", "moment of inertia about the centre of mass")


@cache
def pushed(mu: float, speed: tuple[float, float]) -> tuple[PushDataset, float]:
    """Pushes of a block that always has the same friction force, and its mass, kg."""
    grid = cells_from_polygon([[-0.05, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.05, 0.03]])
    slider = Slider(grid, finger_radius=0.006)
    mass, n = FRICTION / slider.gravity / mu, len(grid)
    maps = Maps(np.full((1, n), mass / n), np.full((1, n), mu), np.array([0.25]))
    rng = np.random.default_rng(1)
    length = (0.03, 0.05) if speed[0] > 0.01 else (0.015, 0.025)  # slow ones have more steps all the same
    pushes = [
        candidate.push([0.0, 0.0, rng.uniform(-3.0, 3.0)])
        for candidate in candidate_pushes(grid, 0.006, rng, 8, length=length, speed=speed)
    ]
    return record_pushes(slider, maps, pushes, rng, rate=100.0), mass


def learned(dataset: PushDataset) -> dict[str, Quantity]:
    result = identify(dataset, hypotheses=8, friction_laws=False)
    return {quantity.name: quantity for quantity in result.quantities}


@pytest.mark.parametrize("mu", [0.05, 1.2])
def test_slow_pushes_show_friction_but_neither_mass_nor_moment_of_inertia(mu):
    dataset, _ = pushed(mu, (0.004, 0.005))
    facts = learned(dataset)
    assert facts["total friction"].shown
    for name in INERTIAL:
        assert not facts[name].shown and "friction outweighs inertia" in facts[name].reason
    # What friction and its prior allow: 0.3 within a factor of three.
    mass = facts["total mass"]
    assert mass.low < FRICTION / 9.81 / 0.9 and mass.high > FRICTION / 9.81 / 0.1


def test_fast_pushes_show_mass_and_moment_of_inertia():
    dataset, mass = pushed(0.3, (0.2, 0.3))
    facts = learned(dataset)
    assert all(facts[name].shown for name in INERTIAL)
    assert facts["total mass"].low < mass < facts["total mass"].high
    assert facts["total mass"].high < 1.5 * facts["total mass"].low


def test_motion_is_not_called_slow_where_inertia_shows_something():
    dataset, _ = pushed(0.3, (0.2, 0.3))
    dataset = replace(dataset, trials=dataset.trials[:2])
    facts = learned(dataset)
    left = [facts[name] for name in (*INERTIAL, "centre of mass, x", "centre of mass, y")]
    assert {quantity.shown for quantity in left} == {True, False}
    assert not any("motion is so slow" in quantity.reason for quantity in left)
    assert any("inertia shows too little of it" in quantity.reason for quantity in left)


def test_a_weighed_mass_is_shown_even_by_slow_pushes():
    dataset, mass = pushed(0.3, (0.004, 0.005))
    facts = learned(replace(dataset, mass=mass))
    assert facts["total mass"].shown
    assert not facts["moment of inertia about the centre of mass"].shown


def test_a_weight_that_the_pushes_contradict_is_not_shown():
    dataset, mass = pushed(0.3, (0.2, 0.3))
    total = learned(replace(dataset, mass=2.0 * mass))["total mass"]
    assert not total.shown and "kg were weighed, but the pushes contradict this" in total.reason


def test_a_friction_that_is_odd_for_the_weight_is_doubted_where_it_stands():
    dataset, mass = pushed(0.3, (0.03, 0.05))
    assert "weight" not in learned(replace(dataset, mass=mass))["total friction"].reason
    heavy = learned(replace(dataset, mass=10.0 * mass))["total friction"]
    assert heavy.shown and "0.031 times the weight: are force and mass in N and kg" in heavy.reason


@pytest.mark.parametrize(
    ("speed", "known", "shown"),
    [((0.03, 0.1), False, False), ((0.03, 0.1), True, True), ((0.25, 0.6), False, True)],
    ids=["slow", "slow, with known friction", "fast"],
)
def test_the_centre_of_mass_is_shown_by_inertia_or_known_friction(speed, known, shown):
    """Slow pushes of an object whose halves have frictions 4:1 show no more of it than the halves' loads."""
    grid = cells_from_polygon([[-0.08, -0.04], [0.08, -0.04], [0.08, 0.04], [-0.08, 0.04]])
    slider, n = Slider(grid, finger_radius=0.006), len(grid)
    mu = np.where(grid.centers[:, 0] > 0, 0.48, 0.12)
    maps = Maps(np.full((1, n), 0.7 / n), mu[None], np.array([0.3]))
    rng = np.random.default_rng(0)
    pushes = [
        candidate.push([0.0, 0.0, rng.uniform(-3.0, 3.0)])
        for candidate in candidate_pushes(grid, 0.006, rng, 8, length=(0.05, 0.12), speed=speed)
    ]
    dataset = record_pushes(slider, maps, pushes, rng, mass=0.7, rate=100.0)
    center = learned(replace(dataset, known=KnownMaps(friction=mu) if known else None))["centre of mass, x"]
    assert center.shown == shown
    assert center.low < 0.0 < center.high or not shown


def test_friction_that_rises_along_the_table_is_reported_where_the_pushes_were_wherever_the_origin_is():
    grid = cells_from_polygon([[-0.05, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.05, 0.03]], count=40)
    effects = effects_named(["table_friction_field"])
    slider = Slider(grid, finger_radius=0.006, effects=effects)
    n, values = len(grid), np.array([[1.5, 0.0, 0.0, 0.0, 0.0, 0.1]])
    maps = Maps(np.full((1, n), 0.7 / n), np.full((1, n), 0.35), np.array([0.3]), values)
    rng = np.random.default_rng(2)
    pushes = [
        candidate.push([*rng.uniform(-0.2, 0.2, 2), rng.uniform(-3.0, 3.0)])
        for candidate in candidate_pushes(grid, 0.006, rng, 8, length=(0.05, 0.1))
    ]
    dataset = record_pushes(slider, maps, pushes, rng, mass=0.7, rate=100.0)

    def shifted(trial: Trial, x: float) -> Trial:
        pose, tip = trial.object_pose, trial.tip_pose
        return replace(
            trial,
            object_pose=Channel(pose.time, pose.values + np.array([x, 0.0, 0.0])),
            tip_pose=Channel(tip.time, tip.values + np.array([x, 0.0])),
        )

    middle = np.mean([trial.object_pose.values[:, 0].mean() for trial in dataset.trials])
    moved = replace(dataset, trials=tuple(shifted(trial, 1.5) for trial in dataset.trials))
    result = identify(moved, effects, hypotheses=4, friction_laws=False)
    facts = {quantity.name: quantity for quantity in result.quantities}
    rise = facts["table_friction_field: gradient_x"]
    assert rise.shown and rise.low < 1.5 < rise.high
    assert facts["total friction"].value == pytest.approx(0.7 * 9.81 * 0.35 * (1 + 1.5 * middle), rel=0.06)


@cache
def light_in_the_middle(seed: int) -> tuple[PushDataset, dict[str, float]]:
    """Pushes of a block with a nearly massless middle, and the true shares of its thirds."""
    grid = cells_from_polygon([[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]], count=40)
    slider = Slider(grid, finger_radius=0.006)
    mass = np.where(np.abs(grid.centers[:, 0]) > 0.025, 1.0, 0.003)
    maps = Maps(mass[None] / mass.sum(), np.full((1, len(grid)), 0.3), np.array([0.3]))
    rng = np.random.default_rng(seed)
    pushes = [
        candidate.push([0.0, 0.0, rng.uniform(-3.0, 3.0)])
        for candidate in candidate_pushes(grid, 0.006, rng, 6, length=(0.05, 0.1), speed=(0.03, 0.1))
    ]
    load = maps.mass[0] / maps.mass.sum()
    shares = {name: float(load @ parts) for name, parts in thirds_of(grid)}
    return record_pushes(slider, maps, pushes, rng, rate=100.0), shares


@cache
def learned_of_light_in_the_middle(seed: int) -> dict[str, Quantity]:
    return learned(light_in_the_middle(seed)[0])


@pytest.mark.parametrize("seed", [0, 3])
def test_shares_of_thirds_allow_for_maps_that_vary_more_than_the_likeliest_structure(seed):
    _, shares = light_in_the_middle(seed)
    facts = learned_of_light_in_the_middle(seed)
    for name, share in shares.items():
        fact = facts[f"share of mass × friction, {name}"]
        assert fact.low <= share <= fact.high, fact


def test_shares_are_not_shown_if_maps_that_vary_strongly_were_not_compared(monkeypatch):
    dataset, _ = light_in_the_middle(0)
    before = learned_of_light_in_the_middle(0)
    monkeypatch.setattr(identification, "bold_compared", lambda every: False)
    after = learned(dataset)
    of_shares = [name for name in before if name.startswith("share")]
    assert any(before[name].shown for name in of_shares)
    assert not any(after[name].shown for name in of_shares)
    assert any("how strongly the maps vary" in after[name].reason for name in of_shares)
    assert all(after[name] == before[name] for name in before if name not in of_shares)


def test_a_mass_that_no_object_of_this_size_has_is_not_shown():
    """Forces in grams: the block would be denser than gold."""
    dataset, _ = pushed(0.3, (0.2, 0.3))
    grams = [
        replace(one, ft_wrench=Channel(one.ft_wrench.time, 102.0 * one.ft_wrench.values))
        for one in dataset.trials
    ]
    facts = learned(replace(dataset, height=0.05, trials=tuple(grams)))
    for name in INERTIAL:
        assert not facts[name].shown and "is the force in N?" in facts[name].reason
    assert facts["total friction"].shown and "is the force in N?" in facts["total friction"].reason
