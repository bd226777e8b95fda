"""Priors centred on what is known of the maps."""

import dataclasses

import numpy as np
import pytest

from slipmap.models.inference.identification import identify
from slipmap.models.inference.prior import MapPrior, PriorSettings, structures_of
from slipmap.models.measurements import KnownMaps
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Slider
from slipmap.models.physics.step import INERTIA_COLUMNS

SQUARE = cells_from_polygon([[-0.05, -0.04], [0.05, -0.04], [0.05, 0.04], [-0.05, 0.04]], count=30)
N = len(SQUARE)
SETTINGS = PriorSettings(modes=N)


def partly(values, cells):
    row = np.full(N, np.nan)
    row[:cells] = values
    return row


PARTS = KnownMaps(partly(0.05, 8), partly(0.5, 12), 0.25, mass_spread=0.1, friction_spread=0.04)
MOST = KnownMaps(partly(0.099, 8), partly(0.5, 12), 0.25, mass_spread=0.02, friction_spread=0.04)
PLATE = KnownMaps(np.ones(N), np.ones(N), mass_ratios=True, friction_ratios=True, friction_spread=0.02)


def prior_of(known, mass=0.8, table=None):
    return MapPrior(Slider(SQUARE, 0.005, table=table), SETTINGS, mass, known=known)


def drawn(prior, count=3000):
    return prior.maps(np.random.default_rng(0).standard_normal((count, prior.size)))


def test_the_middle_of_the_prior_is_what_is_known():
    prior = prior_of(PARTS)
    maps = prior.maps(prior.starts())
    assert maps.mass[0, :8] == pytest.approx(0.05) and maps.mass.sum() == pytest.approx(0.8)
    assert maps.mass[0, 8:] == pytest.approx(0.4 / (N - 8))
    assert maps.mu[0, :12] == pytest.approx(0.5) and maps.mu[0, 12:] == pytest.approx(0.3)
    assert maps.mu_finger == pytest.approx(0.25)


def test_known_cells_vary_by_their_spread_and_free_ones_as_before():
    maps, free = drawn(prior_of(PARTS)), drawn(prior_of(None))
    assert np.log(maps.mass)[:, :8].std(axis=0) == pytest.approx(0.1, rel=0.06)
    assert np.log(maps.mu)[:, :12].std(axis=0) == pytest.approx(0.04, rel=0.06)
    assert np.log(maps.mu)[:, 12:].std(axis=0) == pytest.approx(np.log(free.mu)[:, 12:].std(axis=0), rel=0.06)
    assert np.log(maps.mu_finger).std() == pytest.approx(0.05, rel=0.06)


def test_a_uniform_plate_keeps_an_open_size():
    maps = drawn(prior_of(PLATE, mass=None))
    level = np.log(maps.mu).mean(axis=1)
    assert level.std() == pytest.approx(SETTINGS.friction_scale, rel=0.06)
    assert (np.log(maps.mu) - level[:, None]).std() < 0.02
    assert np.log(maps.mass.sum(axis=1)).std() == pytest.approx(SETTINGS.unknown_mass, rel=0.06)


def test_a_weighed_object_keeps_its_mass_whatever_is_known_of_its_cells():
    for known in (PARTS, MOST):
        maps = drawn(prior_of(known))
        assert np.log(maps.mass.sum(axis=1) / 0.8).std() < 1.3 * SETTINGS.known_mass
        assert maps.mass.min() > 0.0


@pytest.mark.parametrize("known", [PARTS, MOST, PLATE], ids=["parts", "most", "plate"])
@pytest.mark.parametrize("table", [None, Table("round", (0.0, 0.0), radius=0.5)], ids=["endless", "table"])
def test_derivatives_are_those_of_the_maps(known, table):
    prior = prior_of(known, table=table)
    slider, z = prior.slider, np.random.default_rng(1).standard_normal(prior.size)

    def reduced(z):
        maps = prior.maps(z[None])
        load = maps.mass[0] * maps.mu[0] * slider.gravity
        return np.concatenate([load, slider.inertia(maps.mass)[0], maps.mu_finger]), maps.mass[0]

    step = 1e-6 * np.eye(prior.size)
    pairs = [(reduced(z + s), reduced(z - s)) for s in step]
    columns, first = prior.columns(prior.maps(z[None]))[0], N + INERTIA_COLUMNS + 1
    expected = np.array([(up[0] - down[0]) / 2e-6 for up, down in pairs]).T
    assert columns[:first] == pytest.approx(expected, abs=1e-7)
    if table is not None:
        masses = np.array([(up[1] - down[1]) / 2e-6 for up, down in pairs]).T
        assert columns[-N:] == pytest.approx(masses, abs=1e-8)


def test_coordinates_near_some_maps_give_their_free_cells():
    prior = prior_of(PARTS)
    maps = prior.maps(np.random.default_rng(2).standard_normal((1, prior.size)))
    again = prior.maps(prior.near(maps))
    assert again.mu[0, 12:] == pytest.approx(maps.mu[0, 12:], rel=1e-6)
    assert again.mass[0, 12:] / again.mass[0, 12] == pytest.approx(
        maps.mass[0, 12:] / maps.mass[0, 12], rel=1e-6
    )
    assert again.mu[0, :8] == pytest.approx(0.5, rel=0.04)


def learn(dataset, known):
    return identify(dataclasses.replace(dataset, known=known), hypotheses=4, friction_laws=False)


def test_a_wrong_known_map_does_not_change_a_weighed_mass(recorded):
    mass, n = float(recorded.truth.mass.sum()), len(recorded.dataset.grid)
    known = KnownMaps(np.where(np.arange(n) < n // 3, 0.99 * mass / (n // 3), np.nan))
    result = learn(dataclasses.replace(recorded.dataset, mass=mass), known)
    (total,) = [one for one in result.quantities if one.name == "total mass"]
    assert total.low < mass < total.high < 1.15 * mass


def test_true_maps_predict_better_than_learnt_ones_and_wrong_ones_are_doubted(recorded):
    truth, dataset = recorded.truth, recorded.dataset
    known = KnownMaps(truth.mass[0], truth.mu[0], float(truth.mu_finger[0]), 0.01, 0.01, 0.01)
    assert list(structures_of(dataclasses.replace(dataset, known=known))) == ["known"]
    few = dataset.with_fit_pushes(1)
    free, right = learn(few, None), learn(few, known)
    assert right.errors("heldout").mean() < 0.5 * free.errors("heldout").mean()
    assert right.share_of_known > 0.1 and free.share_of_known is None
    (arm,) = [quantity for quantity in right.quantities if quantity.name.startswith("friction arm")]
    assert arm.shown and arm.reason == "known beforehand"
    misled = learn(dataset, dataclasses.replace(known, friction=truth.mu[0][::-1]))
    assert misled.share_of_known == 0.0
    assert not any(fact.shown for fact in misled.quantities)
    assert {fact.reason for fact in misled.quantities} == {"the pushes contradict the known maps"}
    assert misled.errors("heldout").mean() > 3 * right.errors("heldout").mean()


@pytest.mark.filterwarnings("error")
def test_maps_near_given_ones_are_those_known_where_every_cell_is():
    prior = prior_of(KnownMaps(np.full(N, 0.8 / N), np.full(N, 0.3)))
    given = prior.maps(np.zeros((1, prior.size)))
    assert not prior.near(given)[0, : 2 * prior.basis.shape[1]].any()
