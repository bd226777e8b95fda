"""Residuals, derivatives and costs under the error model."""

from dataclasses import replace

import numpy as np
import pytest

import slipmap
from slipmap.models.effects.library import LIBRARY
from slipmap.models.inference.diagnosis.correlated import CorrelatedLikelihood, FitData, whitened_rows
from slipmap.models.inference.diagnosis.fitting import Fitter
from slipmap.models.inference.error_model import ErrorModel, sensor_noise
from slipmap.models.inference.observations import MEASURED_CONTACT, observe_all
from slipmap.models.inference.prior import MapPrior, PriorSettings
from slipmap.models.measurements.trial import Channel
from slipmap.models.physics.rollout import Slider


@pytest.fixture(scope="module", params=[None, 4e-4], ids=["outline exact", "outline uncertain"])
def likelihood(recorded, request) -> CorrelatedLikelihood:
    tilt = [effect for effect in LIBRARY if effect.name == "table_tilt"]
    d = replace(recorded.dataset, noise=replace(recorded.dataset.noise, outline=request.param))
    slider = Slider(d.grid, d.finger_radius, d.gravity, MEASURED_CONTACT, tilt)
    prior = MapPrior(slider, PriorSettings(modes=6), d.mass, 8.0)
    observations = [o for o in observe_all(d) if o.role == "fit"]
    return CorrelatedLikelihood(
        prior, FitData(observations, prior.slider.grid), ErrorModel(sensor_noise(d), 0.02, 0.05)
    )


@pytest.fixture(scope="module")
def point(likelihood) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    z = likelihood.prior.start(0.3) + 0.2 * rng.normal(size=likelihood.prior.size)
    offsets = rng.normal(size=(len(likelihood.observations), 3)) * 2e-4
    return z, offsets


class TestRows:
    def test_derivatives_agree_with_differences(self, likelihood, point) -> None:
        z, offsets = point
        rows = likelihood.rows(z, offsets)
        step = 1e-5
        for column in (0, 7, likelihood.prior.plain - 1, likelihood.prior.size - 1):
            up, down = z.copy(), z.copy()
            up[column] += step
            down[column] -= step
            above, below = likelihood.rows(up, offsets), likelihood.rows(down, offsets)
            errors, sizes = [], []
            for b, row in enumerate(rows):
                for name in ("pose", "force"):
                    difference = (getattr(above[b], name) - getattr(below[b], name)) / (2 * step)
                    errors.append(np.abs(getattr(row, f"{name}_slopes")[..., column] - difference).ravel())
                    sizes.append(np.abs(difference).ravel())
            # Contacts change their state here and there: the bulk decides.
            assert np.quantile(np.concatenate(errors), 0.9) < 1e-5 * np.concatenate(sizes).max()

    @pytest.mark.parametrize("column", range(3))
    def test_derivatives_by_the_start_agree_with_differences(self, likelihood, point, column) -> None:
        z, offsets = point
        step = np.zeros_like(offsets)
        step[:, column] = 1e-7
        above, below = likelihood.rows(z, offsets + step), likelihood.rows(z, offsets - step)
        errors = [
            np.abs(row.pose_slopes[..., column - 3] - (up.pose - down.pose) / 2e-7).ravel()
            for row, up, down in zip(likelihood.rows(z, offsets), above, below, strict=True)
        ]
        assert np.quantile(np.concatenate(errors), 0.9) < 1e-4

    def test_gradient_is_that_of_the_cost(self, likelihood, point) -> None:
        z, offsets = point
        ones = np.ones(1), np.ones((1, len(offsets)))
        equations = likelihood.linearise(z[None], offsets[None], *ones)
        # With the start offsets at their best for z the gradient by z is that of the whole cost.
        for _ in range(8):
            slope = equations.start_gradient[:, 0]
            offsets = offsets - np.einsum("bij,bj->bi", equations.start_gain[:, 0], slope)
            equations = likelihood.linearise(z[None], offsets[None], *ones)
        column, step = likelihood.prior.plain - 1, 1e-4
        costs = []
        for sign in (1.0, -1.0):
            moved = z.copy()
            moved[column] += sign * step
            costs.append(likelihood.linearise(moved[None], offsets[None], *ones).cost.sum())
        slope = (costs[0] - costs[1]) / (2 * step)
        assert equations.gradient[0, column] == pytest.approx(slope, rel=0.02)


@pytest.mark.parametrize("thinned", [1, 4])
def test_whitened_residuals_of_the_truth_are_of_size_one(recorded, thinned) -> None:
    """In every push: also in those of few rows, whose poses are means of none, beside others of many."""
    d = recorded.dataset
    trials = [replace(t, object_pose=rarer(t.object_pose, thinned)) for t in d.trials[::2]]
    d = replace(d, trials=(*trials, *d.trials[1::2]))
    observations = observe_all(d)
    assert {o.pose_rows[0] for o in observations} == ({5.0} if thinned == 1 else {1.0, 5.0})
    noise = sensor_noise(d)
    prior = MapPrior(recorded.slider, PriorSettings(), d.mass)
    likelihood = CorrelatedLikelihood(
        prior, FitData(observations, prior.slider.grid), ErrorModel(noise, 1e-4, 1e-3)
    )
    # The true maps in the prior's coordinates, with all modes kept: log of the maps is linear in them.
    basis, s = prior.basis, prior.settings
    log_mass = np.log(recorded.truth.mass[0])
    log_mu = np.log(recorded.truth.mu[0] / s.friction_mean)
    z = np.zeros(prior.size)
    r = basis.shape[1]
    relative_mass, relative_mu = log_mass - log_mass.mean(), log_mu - log_mu.mean()
    load = relative_mass + relative_mu
    z[:r] = np.linalg.lstsq(s.load_map * basis, load, rcond=None)[0]
    z[2 * r + 1] = log_mu.mean() / s.friction_scale
    z[r : 2 * r] = np.linalg.lstsq(s.split * basis, relative_mass - s.mass_share * load, rcond=None)[0]
    z[prior.plain - 1] = np.log(0.3 / s.finger_friction_mean) / s.finger_friction
    offsets = np.zeros((len(observations), 3))
    _, residuals = whitened_rows(likelihood, likelihood.rows(z, offsets), offsets)
    # Poses alone: forces depend on the rattling of a finger path that is known with noise.
    for half in (slice(None, len(trials)), slice(len(trials), None)):
        pairs = zip(residuals[half], observations[half], strict=True)
        poses = np.concatenate([r[: 3 * len(o.poses)] for r, o in pairs])
        assert np.sqrt(np.median(poses**2)) == pytest.approx(0.6745, rel=0.25)


def test_at_the_best_fit_the_prior_balances_the_data_whatever_the_starts_are() -> None:
    """With the starts as noise, as with the starts fitted."""
    dataset, _ = slipmap.simulated_hammer(seed=1, fit=4, heldout=0)
    fitter = Fitter(dataset, observe_all(dataset), sensor_noise(dataset))
    best = fitter.from_scratch(lambda *told: None)
    likelihood = best.likelihood
    assert np.abs(best.offsets / likelihood.start_sigma).max() > 0.3
    rows = likelihood.rows(best.z, best.offsets)
    slope = sum(J.T @ r for J, r in zip(*whitened_rows(likelihood, rows, best.offsets), strict=True))
    pull = best.z - best.prior_mean
    assert np.linalg.norm(slope + pull) < 0.02 * np.linalg.norm(pull)


def rarer(channel: Channel, thinned: int) -> Channel:
    """Every so many rows, and the last."""
    rows = np.unique(np.append(np.arange(0, len(channel.time), thinned), len(channel.time) - 1))
    return Channel(channel.time[rows], channel.values[rows])
