"""Maps from whitened coordinates, and the chain rule back to them."""

import numpy as np
import pytest

from slipmap.models.inference.prior import MapPrior, PriorSettings, covariance_basis
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Push, Slider

SQUARE = cells_from_polygon([[-0.05, -0.04], [0.05, -0.04], [0.05, 0.04], [-0.05, 0.04]], count=30)


@pytest.fixture
def prior() -> MapPrior:
    return MapPrior(Slider(SQUARE, 0.005), PriorSettings(), mass=0.8)


def test_the_middle_of_the_prior_is_the_uniform_object(prior):
    maps = prior.maps(np.zeros((1, prior.size)))
    assert np.ptp(maps.mass) < 1e-12 and maps.mass.sum() == pytest.approx(0.8)
    assert maps.mu == pytest.approx(prior.settings.friction_mean)
    assert prior.maps(prior.start(0.7)[None]).mu_finger[0] == pytest.approx(0.7)


def test_total_mass_varies_by_its_own_coordinate_alone(prior):
    z = np.random.default_rng(0).standard_normal((50, prior.size))
    total = prior.maps(z).mass.sum(axis=1)
    assert np.log(total / 0.8) == pytest.approx(0.02 * z[:, -3], abs=1e-9)


def test_drawn_maps_vary_as_the_settings_say():
    settings = PriorSettings(load_map=0.4, mass_share=0.75, split=0.3, white=0.1)
    prior = MapPrior(Slider(SQUARE, 0.005), settings, mass=None)
    z = np.random.default_rng(1).standard_normal((4000, prior.size))
    z[:, -2] = 0.0
    maps = prior.maps(z)
    log_mu = np.log(maps.mu)
    assert log_mu.std(axis=0) == pytest.approx(np.hypot(0.25 * 0.4, 0.3), rel=0.06)
    load = np.log(maps.mass) + log_mu
    differences = load[:, 0] - load[:, 7]  # in which neither the total mass nor its normalisation shows
    d = prior.basis[0] - prior.basis[7]
    assert differences.std() == pytest.approx(0.4 * np.sqrt(d @ d), rel=0.06)
    neighbours = np.corrcoef(log_mu[:, 0], log_mu[:, 1])[0, 1]
    assert 0.7 < neighbours < 0.95  # alike, but a tenth of the variance is each cell's own


def test_basis_reproduces_its_covariance():
    settings = PriorSettings(white=0.05, modes=1000)
    basis = covariance_basis(SQUARE, settings)
    covariance = basis @ basis.T
    assert np.diag(covariance) == pytest.approx(1.0)
    d = np.hypot(*(SQUARE.centers[0] - SQUARE.centers[7]))
    diameter = np.hypot(*(np.ptp(SQUARE.centers, axis=0) + SQUARE.width))
    assert covariance[0, 7] == pytest.approx(0.95 * np.exp(-0.5 * (d / (0.2 * diameter)) ** 2))


def test_maps_of_four_times_the_strength_vary_four_times_in_load_and_twice_in_how_it_is_split():
    settings = PriorSettings(load_map=0.1, mass_share=0.8, split=0.05)
    prior = MapPrior(Slider(SQUARE, 0.005), settings, mass=None)
    r = prior.basis.shape[1]
    z = np.random.default_rng(3).standard_normal((1, prior.size))
    z[:, 2 * r :] = 0.0

    def contrasts(part, strength):
        chosen = np.zeros_like(z)
        chosen[:, part] = z[:, part]
        maps = prior.maps(chosen, strength)
        return np.log(maps.mu / maps.mu[:, :1]), np.log(maps.mass / maps.mass[:, :1])

    for part, factor in ((slice(r), 4.0), (slice(r, 2 * r), 2.0)):
        for more, usual in zip(contrasts(part, 4.0), contrasts(part, 1.0), strict=True):
            assert more == pytest.approx(factor * usual, abs=1e-12)
            assert np.ptp(usual) > 0.01


def test_rescaled_coordinates_give_the_same_maps_at_other_strengths(prior):
    z = np.random.default_rng(4).standard_normal(prior.size)
    strength = np.array([0.8, 1.0, 3.5])
    maps, usual = prior.maps(prior.rescaled(z, strength), strength), prior.maps(z[None])
    assert maps.mass == pytest.approx(np.repeat(usual.mass, 3, axis=0), rel=1e-9)
    assert maps.mu == pytest.approx(np.repeat(usual.mu, 3, axis=0), rel=1e-9)


@pytest.mark.parametrize("strength", [1.0, 2.5])
@pytest.mark.parametrize("table", [None, Table("round", (-0.47, 0.01), radius=0.5)], ids=["floor", "rim"])
def test_chain_rule_agrees_with_differences(strength, table):
    prior = MapPrior(Slider(SQUARE, 0.005, table=table), PriorSettings(), mass=0.8)
    rng = np.random.default_rng(2)
    z = 0.4 * rng.standard_normal((1, prior.size))
    steps = np.arange(101) * 0.005
    tip = np.column_stack([-0.056 + 0.06 * steps, np.full(101, 0.013)])
    push = Push(0.005, tip, np.zeros(3), pose_times=np.array([0.25, 0.5]), force_times=np.array([0.4]))

    def poses(at):
        return prior.slider.rollout(prior.maps(at, strength), [push]).poses[0]

    maps = prior.maps(z, strength)
    rollouts = prior.slider.rollout(maps, [push], sensitivities=True)
    assert rollouts.reached.all() == (table is not None) and not rollouts.tipped.any()
    by_z = prior.chain(maps, rollouts.d_poses, strength)[0]
    size = np.abs(by_z).max()
    for column in [0, 1, 7, 40, 41, *range(prior.size - 3, prior.size)]:
        e = np.zeros((1, prior.size))
        e[0, column] = 1e-5
        difference = (poses(z + e) - poses(z - e)) / 2e-5
        assert difference == pytest.approx(by_z[..., column], abs=2e-6 * size)
