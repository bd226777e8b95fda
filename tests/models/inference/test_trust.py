"""How far off the model is held to be, against a density in closed form and pushes with a known error."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import slipmap
from slipmap.models import progress
from slipmap.models.inference.gauss_newton import (
    _damped_step,
    _eased,
    _promised,
    _shifted,
    _start_slopes,
    fit,
)
from slipmap.models.inference.hypotheses import (
    FINE_ERROR,
    MODEL_ERRORS,
    draws,
    explains_exactly,
    fit_with_trust,
    log_evidence,
    refined,
    refits,
    trusting,
)
from slipmap.models.inference.identification import identify
from slipmap.models.inference.likelihood import DrawnErrors, Likelihood, NormalEquations
from slipmap.models.inference.observations import MEASURED_CONTACT, observe_all
from slipmap.models.inference.prior import MapPrior, PriorSettings
from slipmap.models.physics.rollout import Slider


@dataclass
class LinearPushes:
    """Pushes whose poses depend linearly on maps and start, where Laplace's approximation is exact."""

    by_maps: np.ndarray
    by_start: np.ndarray
    measured: np.ndarray
    sigma: float
    start_sigma: np.ndarray

    @property
    def observations(self):
        return self.measured

    def log_widths(self):
        return self.measured.size * np.log(self.sigma)

    def linearise(self, z, offsets, strength, weights):
        r = (
            np.einsum("bri,ki->kbr", self.by_maps, z)
            + np.einsum("brj,kbj->kbr", self.by_start, offsets)
            - self.measured
        ) / self.sigma
        A, C = self.by_maps / self.sigma, self.by_start / self.sigma
        scaled = offsets / self.start_sigma
        cost = 0.5 * (r**2).sum(axis=2) + 0.5 * (scaled**2).sum(axis=2)
        gain = np.linalg.inv(C.transpose(0, 2, 1) @ C + np.diag(self.start_sigma**-2.0))
        start_gradient = np.einsum("brj,kbr->bkj", C, r) + (scaled / self.start_sigma).transpose(1, 0, 2)
        coupling = A.transpose(0, 2, 1) @ C
        hessian = (A.transpose(0, 2, 1) @ A - coupling @ gain @ coupling.transpose(0, 2, 1)).sum(axis=0)
        by_push = np.einsum("bri,kbr->bki", A, r) - np.einsum(
            "bij,bjl,bkl->bki", coupling, gain, start_gradient
        )
        K = len(z)

        def each(x):
            return np.repeat(x[:, None], K, axis=1)

        hessians = np.repeat(hessian[None], K, axis=0)
        return NormalEquations(
            cost, hessians, by_push.sum(axis=0), each(gain), start_gradient, each(coupling)
        )


def test_evidence_is_the_density_of_the_data_where_everything_is_linear():
    rng = np.random.default_rng(0)
    B, R, d = 3, 8, 5
    by_maps, by_start = rng.standard_normal((B, R, d)), rng.standard_normal((B, R, 3))
    start_sigma = np.array([0.3, 0.5, 0.2])
    measured = rng.standard_normal((B, R))
    for sigma in (0.4, 1.3):
        linear = LinearPushes(by_maps, by_start, measured, sigma, start_sigma)
        best = fit(linear, np.zeros((1, d)), iterations=60, tolerance=1e-12)
        maps = by_maps.reshape(B * R, d)
        covariance = maps @ maps.T + sigma**2 * np.eye(B * R)
        for b in range(B):
            rows = slice(b * R, (b + 1) * R)
            covariance[rows, rows] += by_start[b] @ np.diag(start_sigma**2) @ by_start[b].T
        exact = multivariate_normal(np.zeros(B * R), covariance).logpdf(measured.ravel())
        ours = log_evidence(cast(Likelihood, linear), best) - 0.5 * B * R * np.log(2.0 * np.pi)
        assert ours == pytest.approx(exact, abs=1e-6)


@dataclass
class BentValley:
    """One push with a pose z_1 - 10 z_0², and another z_0 / 20 that hardly says how far along z_0 lies."""

    measured: np.ndarray
    calls: int = 0
    start_sigma = np.ones((1, 3))

    @property
    def observations(self):
        return [None]

    def linearise(self, z, offsets, strength, weights):
        self.calls += 1
        first = z[0, 0]
        tangent = np.array([[[-20.0 * first, 1.0], [0.05, 0.0]]])
        measured = self.measured - np.array([[10.0 * first**2, 0.0]])
        linear = LinearPushes(tangent, np.zeros((1, 2, 3)), measured, 1e-3, np.ones(3))
        return linear.linearise(z, offsets, strength, weights)


def test_damping_follows_what_a_step_promised_and_gave():
    kept = _eased(np.array([1.0, 0.5, 0.1, 1e-6, 3.0]), np.ones(5))
    np.testing.assert_allclose(kept, [1 / 3, 1.0, 1.512, 2.0, 1 / 3], atol=1e-5)


@pytest.mark.parametrize(("damping", "bound"), [(0.0, 100.0), (0.3, 100.0), (50.0, 100.0), (0.3, 0.05)])
def test_a_step_gives_what_it_promises_where_everything_is_linear(damping, bound):
    rng = np.random.default_rng(4)
    by_maps, by_start = rng.standard_normal((3, 8, 4)), rng.standard_normal((3, 8, 3))
    linear = LinearPushes(by_maps, by_start, rng.standard_normal((3, 8)), 0.4, np.array([0.3, 0.5, 0.2]))
    z, shift, one = rng.standard_normal((1, 4)), 0.1 * rng.standard_normal((1, 3, 3)), np.ones((1, 3))
    who, factor = np.arange(1), np.array([damping])
    equations = linear.linearise(z, shift, np.ones(1), one)
    step = _damped_step(equations, 0, z[0], damping)[None]
    slopes = _start_slopes(equations, who, step)
    moved = _shifted(equations, who, slopes, factor, shift, bound * np.ones((3, 3)))
    promised = _promised(equations, who, step, slopes, moved - shift, z, one)
    assert (np.abs(moved) == 4.0 * bound).any() == (bound < 1.0)

    def cost(z, shift):
        return linear.linearise(z, shift, np.ones(1), one).cost.sum() + 0.5 * (z**2).sum()

    assert promised[0] == pytest.approx(cost(z, shift) - cost(z + step, moved), rel=1e-9)


def test_a_system_that_rounding_makes_indefinite_is_damped_further():
    """Derivatives of 1e10: what the prior adds is lost, and an eigenvalue is negative."""
    along = 1e10 * np.array([1.0, 1.0, 1.0])
    hessian = np.outer(along, along) - 1e5 * np.eye(3)
    gradient = along * 1e-3
    equations = SimpleNamespace(hessian=hessian[None], gradient=gradient[None])
    step = _damped_step(equations, 0, np.zeros(3), 1e-20)
    assert np.isfinite(step).all() and step @ gradient < 0.0
    hopeless = SimpleNamespace(hessian=np.array([[[1.0, 1e20], [1e20, 1.0]]]), gradient=np.ones((1, 2)))
    with pytest.raises(np.linalg.LinAlgError):
        _damped_step(hopeless, 0, np.zeros(2), 0.1)


def test_a_bent_valley_is_followed_to_its_end():
    """With damping that falls by the same factor after every success, this took 242 linearisations."""
    valley = BentValley(np.array([[0.0, 0.1]]))
    found = fit(valley, np.array([[-1.0, 10.0]]), iterations=300, tolerance=1e-9)
    first, second = found.z[0]
    assert second == pytest.approx(10.0 * first**2, abs=1e-3) and first > 1.6
    assert valley.calls < 160


def test_a_fit_that_nobody_waits_for_ends(monkeypatch):
    linear = LinearPushes(np.ones((1, 1, 1)), np.ones((1, 1, 3)), np.ones((1, 1)), 0.1, np.ones(3))
    monkeypatch.setattr(progress._helping, "wanted", lambda: False, raising=False)
    with pytest.raises(progress.Unwanted):
        fit(linear, np.zeros((1, 1)))


def ladder_of(dataset):
    slider = Slider(dataset.grid, dataset.finger_radius, dataset.gravity, MEASURED_CONTACT)
    prior = MapPrior(slider, PriorSettings(), dataset.mass)
    starts = np.array([prior.start(friction) for friction in (0.12, 0.35, 1.0)])
    observations = observe_all(dataset, dataset.fit_trials)
    return fit_with_trust(prior, observations, dataset.noise, starts, lambda done, total: None)


def bent(dataset, share):
    """Every push goes astray by a share of its way, each to a side of its own."""
    rng = np.random.default_rng(1)
    trials = []
    for trial in dataset.trials:
        poses = trial.object_pose.values.copy()
        way = np.linalg.norm(poses[:, :2] - poses[0, :2], axis=1)
        poses[:, :2] += share * way[:, None] * rng.standard_normal(2)
        trials.append(replace(trial, object_pose=replace(trial.object_pose, values=poses)))
    return replace(dataset, trials=tuple(trials))


def test_pushes_that_follow_the_model_are_trusted_and_pushes_that_do_not_are_not(recorded):
    assert [likelihood.settings.model_error for likelihood, _ in ladder_of(recorded.dataset)] == [0.005]
    ladder = ladder_of(bent(recorded.dataset, 0.1))
    errors = tuple(likelihood.settings.model_error for likelihood, _ in ladder)
    assert errors == MODEL_ERRORS[: len(errors)] and errors[-1] >= 0.04


def test_pushes_that_half_a_percent_explains_exactly_are_fitted_with_less_and_predict_better():
    misses = []
    for seed in range(4):
        dataset, truth = slipmap.simulated_hammer(seed=seed, fit=6, heldout=4)
        coarse = ladder_of(dataset)
        fine = refined(coarse, dataset.noise)
        assert [likelihood.settings.model_error for likelihood, _ in fine] == [FINE_ERROR]
        slider = coarse[0][0].prior.slider
        pushes = [observation.push for observation in observe_all(dataset, dataset.heldout_trials)]
        every = [truth, *(likelihood.prior.maps(best.z) for likelihood, best in (*coarse, *fine))]
        true, *ends = (slider.rollout(maps, pushes).end[0, :, :2] for maps in every)
        misses.append([np.hypot(*(end - true).T).mean() for end in ends])
    with_coarse, with_fine = np.sum(misses, axis=0)
    assert with_fine < 0.85 * with_coarse


def test_a_belief_from_pushes_that_follow_the_model_is_drawn_around_the_fine_fit(recorded):
    belief = identify(recorded.dataset, hypotheses=3, friction_laws=False).belief
    assert belief.settings["model_errors"] == [FINE_ERROR]


def test_pushes_that_go_astray_by_a_few_percent_are_fitted_with_no_less(recorded):
    dataset = bent(recorded.dataset, 0.03)
    ladder = ladder_of(dataset)
    assert len(ladder) == 1 and explains_exactly(*ladder[0])
    assert refined(ladder, dataset.noise) == []


def test_hypotheses_scatter_as_the_posterior_does_where_pushes_agree(recorded):
    ladder = ladder_of(recorded.dataset)
    ((likelihood, best),) = ladder
    prior, centers = likelihood.prior, recorded.dataset.grid.centers
    drawn = draws(ladder, 40, np.random.default_rng(3), keep_best=True)

    def measured(maps):
        """Centre of friction and logarithm of the total friction."""
        load = maps.mass * maps.mu
        total = load.sum(axis=1, keepdims=True)
        return np.hstack([load @ centers / total, np.log(total)])

    def scatter(drawn):
        maps, probability = refits(ladder, drawn, lambda done, total: None)
        values = measured(maps)
        return np.sqrt(probability @ (values - probability @ values) ** 2)

    steps = 1e-4 * np.eye(prior.size)
    up, down = (measured(prior.maps(best.z + sign * steps)) for sign in (1.0, -1.0))
    slopes = (up - down) / 2e-4
    covariance = slopes.T @ np.linalg.solve(best.hessian[0] + np.eye(prior.size), slopes)
    deviation = np.sqrt(np.diag(covariance))
    without = drawn._replace(errors=DrawnErrors(*(0.0 * part for part in drawn.errors)))
    assert (scatter(without) < 0.6 * deviation).all()
    assert (0.75 * deviation < scatter(drawn)).all() and (scatter(drawn) < 1.3 * deviation).all()


def test_assumed_errors_cancel_on_average_and_point_in_as_many_directions_as_there_are_hypotheses(recorded):
    ladder = ladder_of(bent(recorded.dataset, 0.1))
    drawn = draws(ladder[:2], 20, np.random.default_rng(3), keep_best=False)
    for part in drawn.errors:
        for rung in (0, 1):
            own = part[rung::2].reshape(10, -1)
            assert np.allclose(own.mean(axis=0), 0.0) and np.mean(own**2) == pytest.approx(1.0, rel=0.25)
            assert np.linalg.matrix_rank(own) == 9
    # A single hypothesis under a likelihood has errors all the same.
    (alone,) = draws(ladder[:1], 1, np.random.default_rng(3), keep_best=False).errors.poses
    assert alone.all()


def test_errors_are_not_assumed_where_pushes_disagree(recorded):
    ladder = ladder_of(bent(recorded.dataset, 0.1))
    assert len(ladder) > 2
    drawn = draws(ladder[:2], 7, np.random.default_rng(3), keep_best=True)
    for part in drawn.errors:
        assert not part[0].any() and part[2].any()
    silent = lambda done, total: None  # noqa: E731
    with_errors, _ = refits(ladder[:2], drawn, silent)
    without = drawn._replace(errors=DrawnErrors(*(0.0 * part for part in drawn.errors)))
    assert np.array_equal(with_errors.mass, refits(ladder[:2], without, silent)[0].mass)


def test_the_less_poses_are_trusted_the_less_are_forces(recorded):
    ladder = ladder_of(bent(recorded.dataset, 0.1))
    assert [likelihood.settings.force_error for likelihood, _ in ladder][:2] == pytest.approx([0.05, 0.15])
    assert [trusting(alpha).force_error for alpha in (0.04, 0.1)] == pytest.approx([0.4, 0.4])


def test_hypotheses_take_turns_under_every_likelihood_of_the_ladder(recorded):
    belief = identify(
        bent(recorded.dataset, 0.1), hypotheses=7, seed=1, prior_settings=PriorSettings(), friction_laws=False
    ).belief
    errors = belief.settings["model_errors"]
    assert len(errors) >= 3
    for rung in range(len(errors)):
        turn = np.arange(rung, 7, len(errors))
        assert belief.probability[turn].sum() == pytest.approx(len(turn) / 7)
