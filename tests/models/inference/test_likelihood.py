"""Costs and their slopes."""

from dataclasses import replace

import numpy as np
import pytest

from slipmap.models.effects.registry import effects_named
from slipmap.models.geometry import at_centroid, from_centroid, radius_of_gyration
from slipmap.models.inference.gauss_newton import fit, of_dataset
from slipmap.models.inference.likelihood import DrawnErrors, Likelihood, LikelihoodSettings, huber
from slipmap.models.inference.observations import MEASURED_CONTACT, observe_all
from slipmap.models.inference.prior import MapPrior, PriorSettings
from slipmap.models.measurements import DatasetError, Noise
from slipmap.models.measurements.simulated import GOOD_SENSORS, record_pushes
from slipmap.models.physics.rollout import RolloutError, Slider
from slipmap.planners.exploration import candidate_pushes


def likelihood_of(dataset) -> Likelihood:
    slider = Slider(dataset.grid, dataset.finger_radius, dataset.gravity, MEASURED_CONTACT)
    prior = MapPrior(slider, PriorSettings(), dataset.mass)
    return Likelihood(prior, observe_all(dataset, dataset.fit_trials), dataset.noise, LikelihoodSettings())


@pytest.fixture(scope="module")
def likelihood(recorded) -> Likelihood:
    return likelihood_of(recorded.dataset)


def drawn_errors(rng: np.random.Generator, K: int, B: int) -> DrawnErrors:
    return DrawnErrors(rng.standard_normal((K, B, 4, 3)), rng.standard_normal((K, B, 2)))


@pytest.mark.parametrize(("outline", "assumed"), [(None, False), (4e-4, False), (None, True)])
def test_gradient_is_the_slope_of_the_cost_with_starts_at_their_best(recorded, outline, assumed):
    likelihood = likelihood_of(
        replace(recorded.dataset, noise=replace(recorded.dataset.noise, outline=outline))
    )
    rng = np.random.default_rng(0)
    d, B = likelihood.prior.size, len(likelihood.observations)
    z = 0.2 * rng.standard_normal((1, d))
    ones = np.ones(1)
    weights = rng.uniform(0.5, 1.5, (1, B))
    offsets = np.zeros((1, B, 3))
    errors = drawn_errors(rng, 1, B) if assumed else None
    for _ in range(12):  # bring the eliminated start offsets to their minimum: there the two slopes agree
        equations = likelihood.linearise(z, offsets, ones, weights, errors=errors)
        gain, slope = equations.start_gain[:, 0], equations.start_gradient[:, 0]
        offsets[0] -= 0.7 * np.einsum("bij,bj->bi", gain, slope)
    equations = likelihood.linearise(z, offsets, ones, weights, errors=errors)
    size = np.abs(equations.gradient).max()
    for column in [0, 3, 40, d - 3, d - 2, d - 1]:
        e = np.zeros((1, d))
        e[0, column] = 1e-5
        up, down = (
            likelihood.linearise(moved, offsets, ones, weights, errors=errors).cost
            for moved in (z + e, z - e)
        )
        change = up - down
        assert (weights * change).sum() / 2e-5 == pytest.approx(
            equations.gradient[0, column], abs=2e-3 * size
        )


def test_an_outline_that_is_off_is_as_if_the_object_started_elsewhere(recorded):
    """Exact pushes that touch beside where they seem to: the offsets that undo this leave no residual."""
    noise = Noise(position=1e-6, angle=1e-5, tip=1e-6, force=1e-4, outline=4e-4)
    prior = likelihood_of(recorded.dataset).prior
    z = prior.start(0.3)[None]
    drawn = candidate_pushes(recorded.slider.grid, 0.006, np.random.default_rng(5), 6, length=(0.06, 0.1))
    pushes = [candidate.push([0.05, -0.02, 0.7]) for candidate in drawn]
    dataset = record_pushes(prior.slider, prior.maps(z), pushes, np.random.default_rng(7), noise=noise)
    off = 4e-4 * np.random.default_rng(7).standard_normal((1, 6, 2))
    likelihood = Likelihood(prior, observe_all(dataset), noise, LikelihoodSettings())

    def misfit(offsets):
        offsets = np.concatenate([offsets, np.zeros((1, 6, 1))], axis=-1)
        cost = likelihood.linearise(z, offsets, np.ones(1), np.ones((1, 6))).cost
        return cost[0] - 0.5 * ((offsets / likelihood.start_sigma) ** 2).sum(axis=-1)[0]

    assert 50.0 * misfit(-off).sum() < misfit(0.0 * off).sum() < 0.5 * misfit(off).sum()


def test_errors_that_a_hypothesis_assumes_are_subtracted_from_the_measurements(likelihood):
    """Pushes of twelve poses, of which three in turn share an error; of a single pose; and without forces."""

    def last(observation, poses):
        push = replace(observation.push, pose_times=observation.push.pose_times[-poses:])
        return replace(observation, push=push, poses=observation.poses[-poses:])

    a, b, c = likelihood.observations[:3]
    seen, grid = [last(a, 12), last(b, 1), last(c, 12).without_forces], likelihood.prior.slider.grid
    assuming = Likelihood(likelihood.prior, seen, GOOD_SENSORS, likelihood.settings)
    rng = np.random.default_rng(4)
    z, offsets, weights = np.zeros((2, likelihood.prior.size)), np.zeros((2, 3, 3)), np.ones((2, 3))
    errors = drawn_errors(rng, 2, 3)
    ours = assuming.linearise(z, offsets, np.ones(2), weights, errors=errors)
    scale = np.array([1.0, 1.0, radius_of_gyration(grid)])
    for k in range(2):
        moved = []
        for b, one in enumerate(seen):
            sigma, count = assuming._sigmas[b][:, None], len(one.poses)
            off = sigma * (
                np.repeat(errors.poses[k, b], 3, axis=0) if count == 12 else errors.poses[k, b, :1]
            )
            poses = from_centroid(at_centroid(one.poses, grid) - off / scale, grid)
            off = assuming._force_sigmas[b] * errors.forces[k, b] if one.sliding.any() else 0.0
            moved.append(replace(one, poses=poses, forces=one.forces - off))
        plain = Likelihood(likelihood.prior, moved, GOOD_SENSORS, likelihood.settings)
        plain._sigmas, plain._force_sigmas = assuming._sigmas, assuming._force_sigmas
        theirs = plain.linearise(z[:1], offsets[:1], np.ones(1), weights[:1])
        assert ours.cost[k] == pytest.approx(theirs.cost[0], rel=1e-9)
        assert ours.gradient[k] == pytest.approx(theirs.gradient[0], rel=1e-6, abs=1e-9)


def test_a_push_with_no_weight_does_not_count(likelihood):
    z = np.zeros((1, likelihood.prior.size))
    B = len(likelihood.observations)
    weights = np.zeros((1, B))
    weights[0, 2] = 1.0
    alone = Likelihood(likelihood.prior, [likelihood.observations[2]], GOOD_SENSORS, likelihood.settings)
    ours = likelihood.linearise(z, np.zeros((1, B, 3)), np.ones(1), weights)
    theirs = alone.linearise(z, np.zeros((1, 1, 3)), np.ones(1), np.ones((1, 1)))
    assert ours.hessian == pytest.approx(theirs.hessian, rel=1e-9)
    assert ours.gradient == pytest.approx(theirs.gradient, rel=1e-9)


def test_pushes_rolled_out_in_parts_give_the_same_equations(likelihood, monkeypatch):
    rng = np.random.default_rng(1)
    B = len(likelihood.observations)
    z = 0.2 * rng.standard_normal((2, likelihood.prior.size))
    offsets, weights = 1e-4 * rng.standard_normal((2, B, 3)), rng.uniform(0.5, 1.5, (2, B))
    together = likelihood.linearise(z, offsets, np.ones(2), weights, by_push=True)
    monkeypatch.setattr("slipmap.models.inference.likelihood._JACOBIANS", 1)
    parts = likelihood.linearise(z, offsets, np.ones(2), weights, by_push=True)
    for name, value in vars(together).items():
        assert getattr(parts, name) == pytest.approx(value, rel=1e-12, abs=1e-12), name


def test_pushes_of_different_sizes_keep_their_own_equations(likelihood):
    """Pushes are sorted by size, so that those of one size are weighted together."""
    dense = likelihood.observations
    ends = [
        replace(o, push=replace(o.push, pose_times=o.push.pose_times[-1:]), poses=o.poses[-1:])
        for o in dense[:2]
    ]
    mixed = [dense[0], ends[0], dense[1].without_forces, dense[1], ends[1]]
    every = Likelihood(likelihood.prior, mixed, GOOD_SENSORS, likelihood.settings)
    rng = np.random.default_rng(2)
    z, B = 0.2 * rng.standard_normal((2, likelihood.prior.size)), len(mixed)
    offsets, weights = 1e-4 * rng.standard_normal((2, B, 3)), rng.uniform(0.5, 1.5, (2, B))
    together = every.linearise(z, offsets, np.ones(2), weights)
    hessian, gradient = np.zeros_like(together.hessian), np.zeros_like(together.gradient)
    for b, own in enumerate(mixed):
        alone = Likelihood(likelihood.prior, [own], GOOD_SENSORS, likelihood.settings)
        alone.start_sigma = every.start_sigma[b : b + 1]
        one = alone.linearise(z, offsets[:, b : b + 1], np.ones(2), weights[:, b : b + 1])
        hessian, gradient = hessian + one.hessian, gradient + one.gradient
        assert together.cost[:, b] == pytest.approx(one.cost[:, 0], rel=1e-12)
        for name in ("start_gain", "start_gradient", "coupling"):
            ours, theirs = getattr(together, name)[b], getattr(one, name)[0]
            assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-9 * np.abs(theirs).max()), name
    assert together.hessian == pytest.approx(hessian, rel=1e-9, abs=1e-9 * np.abs(hessian).max())
    assert together.gradient == pytest.approx(gradient, rel=1e-9, abs=1e-9 * np.abs(gradient).max())


def test_lockstep_gives_what_each_start_gives_alone(likelihood):
    prior = likelihood.prior
    starts = np.array([prior.start(0.15), prior.start(0.5)])
    together = fit(likelihood, starts, iterations=6)
    for k in (0, 1):
        alone = fit(likelihood, starts[k : k + 1], iterations=6)
        assert together.z[k] == pytest.approx(alone.z[0], abs=1e-9)
        assert together.cost[k] == pytest.approx(alone.cost[0], rel=1e-9)


@pytest.mark.parametrize("forces", [True, False])
def test_derivatives_give_the_same_equations_in_columns_and_in_coordinates(likelihood, monkeypatch, forces):
    """Where a rollout has many more columns than there are coordinates, these are used from the start."""
    pushes = [push if forces else push.without_forces for push in likelihood.observations]
    likelihood = Likelihood(likelihood.prior, pushes, GOOD_SENSORS, likelihood.settings)
    rng = np.random.default_rng(3)
    B = len(pushes)
    z, strength = 0.2 * rng.standard_normal((2, likelihood.prior.size)), np.array([0.8, 1.2])
    offsets, weights = 1e-4 * rng.standard_normal((2, B, 3)), rng.uniform(0.5, 1.5, (2, B))
    found = []
    for ratio in (0.0, np.inf):
        monkeypatch.setattr("slipmap.models.inference.likelihood._MANY_COLUMNS", ratio)
        found.append(vars(likelihood.linearise(z, offsets, strength, weights, by_push=True)))
    for name, value in found[0].items():
        assert found[1][name] == pytest.approx(value, rel=1e-9, abs=1e-9 * np.abs(value).max()), name


def test_hypotheses_that_agree_are_rolled_out_once(likelihood, monkeypatch):
    prior, B = likelihood.prior, len(likelihood.observations)
    strength = np.array([0.7, 1.0, 1.4])
    z = prior.rescaled(0.2 * np.random.default_rng(4).standard_normal(prior.size), strength)
    offsets, weights = np.full((3, B, 3), 1e-4), np.random.default_rng(5).uniform(0.5, 1.5, (3, B))
    rolled, rollout = [], prior.slider.rollout
    monkeypatch.setattr(
        prior.slider, "rollout", lambda maps, *a, **kw: rolled.append(len(maps)) or rollout(maps, *a, **kw)
    )
    together = likelihood.linearise(z, offsets, strength, weights)
    assert rolled == [1]
    for k in range(3):
        one = slice(k, k + 1)
        alone = likelihood.linearise(z[one], offsets[one], strength[one], weights[one])
        for name in ("cost", "hessian", "gradient"):
            ours, theirs = getattr(together, name)[one], getattr(alone, name)
            assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-9 * np.abs(theirs).max()), name
    offsets[1, 0, 0] = 0.0
    likelihood.linearise(z, offsets, strength, weights)
    assert rolled[-1] == 3


def test_a_fit_that_cannot_reach_a_useful_cost_is_given_up(likelihood):
    starts = np.array([likelihood.prior.start(mu) for mu in (0.15, 0.35)])
    iterations: dict[float | None, int] = {}

    def fitted(worth):
        return fit(likelihood, starts, worth=worth, progress=lambda done, _: iterations.update({worth: done}))

    whole, useless, useful = fitted(None), fitted(-1e6), fitted(np.inf)
    assert iterations[-1e6] == 4 < iterations[None]
    assert (useless.cost > whole.cost).all()
    assert useful.best().cost == pytest.approx(whole.best().cost, rel=1e-9)


def test_where_equations_overflow_a_step_fails_and_a_start_is_given_up(likelihood):
    """As with a formula like exp(2000 x): the cost is finite there, its curvature is not."""
    starts = np.array([likelihood.prior.start(mu) for mu in (0.15, 0.35)])
    sound = fit(likelihood, starts[1:])

    class Overflowing:
        observations, start_sigma = likelihood.observations, likelihood.start_sigma

        def linearise(self, z, offsets, strength, weights):
            found = likelihood.linearise(z, offsets, strength, weights)
            found.hessian[np.abs(z[:, -1] - starts[0, -1]) < 1e-3] = np.inf
            return found

    with np.errstate(all="raise"):
        half = fit(Overflowing(), starts)
    assert half.cost[0] == np.inf and half.best().cost == pytest.approx(sound.cost)
    with pytest.raises(RolloutError, match="overflow"):
        fit(Overflowing(), starts[:1])


def test_fit_lowers_the_cost_and_stays_at_a_minimum(likelihood):
    prior = likelihood.prior
    start = prior.start(0.35)[None]
    fitted = fit(likelihood, start)
    B = len(likelihood.observations)
    before = likelihood.linearise(start, np.zeros((1, B, 3)), np.ones(1), np.ones((1, B))).cost.sum()
    assert fitted.cost[0] < 0.2 * before
    rng = np.random.default_rng(1)
    for _ in range(8):
        z = fitted.z + 0.05 * rng.standard_normal(fitted.z.shape)
        there = likelihood.linearise(z, fitted.offsets, np.ones(1), np.ones((1, B)))
        nearby = there.cost.sum() + 0.5 * (z**2).sum()
        assert nearby > fitted.cost[0] * 0.999


def test_huber_cost_is_linear_beyond_its_limit(likelihood):
    norm = np.array([0.5, 2.0, 4.0, 6.0])
    weight, cost = huber(norm, norm**2, likelihood.settings.huber)
    assert cost == pytest.approx([0.125, 2.0, 2.0 * 3.0, 2.0 * 5.0])
    assert weight == pytest.approx([1.0, 1.0, 0.5, 1.0 / 3.0])


def test_a_fit_that_fails_names_the_dataset_and_what_to_check():
    with pytest.raises(DatasetError, match="dataset plate: how the pushes depend"), of_dataset("plate"):
        raise np.linalg.LinAlgError("not positive definite")
    effects = effects_named(["table_tilt"])
    with pytest.raises(DatasetError, match="plate: the model with table_tilt"), of_dataset("plate", effects):
        raise RolloutError("a step did not converge")
