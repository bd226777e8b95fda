"""Covariances of the error model, and noise found in rows."""

from dataclasses import replace

import numpy as np
import pytest

from slipmap.models.inference.belief import OUTLINE_ERROR, Belief
from slipmap.models.inference.error_model import (
    MEMORY,
    ErrorModel,
    SensorNoise,
    outline_errors,
    sensor_noise,
    travelled,
)
from slipmap.models.inference.observations import observe_all
from slipmap.models.inference.prediction import drawn_ends
from slipmap.models.measurements import Channel, Noise
from slipmap.models.measurements.lasting_noise import Lasting

NOISE = SensorNoise(2e-4, 2e-3, 0.1, True)


class TestCovariance:
    def test_errors_of_the_motion_add_up_along_the_way(self, recorded) -> None:
        observation = observe_all(recorded.dataset)[0]
        centers = recorded.slider.grid.centers
        travel = travelled(observation, centers)
        whole = ErrorModel(NOISE, 0.05, 0.1).pose_covariance(observation, travel, 0.04)[0]
        covariance = whole - np.diag(NOISE.position**2 / observation.pose_rows)
        # The double integral by brute force.
        fine = np.linspace(0.0, travel[-1], 1500)
        kernel = np.exp(-np.abs(fine[:, None] - fine) / MEMORY) * (fine[1] - fine[0]) ** 2
        k, j = len(travel) // 2, len(travel) - 1
        expected = 0.05**2 * kernel[np.ix_(fine <= travel[k], fine <= travel[j])].sum()
        assert covariance[k, j] == pytest.approx(expected, rel=0.01)
        assert covariance[k, j] == pytest.approx(covariance[j, k], rel=1e-12)

    def test_way_is_the_sum_of_all_moves(self, recorded) -> None:
        observation = observe_all(recorded.dataset)[0]
        travel = travelled(observation, recorded.slider.grid.centers)
        assert (np.diff(travel) >= 0).all()
        assert travel[-1] >= observation.travel(recorded.slider.grid.centers)[-1] * (1 - 1e-9)


class TestSensorNoise:
    def test_declared_noise_is_believed(self, recorded) -> None:
        noise = sensor_noise(recorded.dataset)
        assert noise.declared
        assert noise.position == recorded.dataset.noise.position

    def test_noise_is_found_where_nothing_is_declared(self, recorded) -> None:
        silent = replace(recorded.dataset, noise=Noise())
        found, declared = sensor_noise(silent), sensor_noise(recorded.dataset)
        assert not found.declared and not found.assumed
        assert found.position == pytest.approx(declared.position, rel=0.25)
        assert found.force == pytest.approx(declared.force, rel=0.5)

    def test_rounded_poses_are_as_noisy_as_their_rounding(self, recorded) -> None:
        """Most rows repeat the one before, and scatter by nothing."""
        step = np.array([2e-3, 2e-3, 0.02])
        trials = tuple(
            replace(
                one,
                object_pose=Channel(one.object_pose.time, step * np.round(one.object_pose.values / step)),
            )
            for one in recorded.dataset.trials
        )
        found = sensor_noise(replace(recorded.dataset, noise=Noise(), trials=trials))
        assert found.position >= 0.99 * step[0] / np.sqrt(12.0)
        assert found.angle >= 0.99 * step[2] / np.sqrt(12.0)

    @pytest.mark.parametrize("rows", [30, 60])
    def test_noise_of_a_slow_camera_is_found_too(self, recorded, rows) -> None:
        found, declared = sensor_noise(thinned(recorded.dataset, rows)), sensor_noise(recorded.dataset)
        assert not found.declared and not found.assumed
        assert 0.8 * declared.position < found.position < 1.6 * declared.position
        assert 0.8 * declared.angle < found.angle < 1.6 * declared.angle

    def test_noise_of_poses_is_assumed_where_only_ends_are_known(self, recorded) -> None:
        found = sensor_noise(thinned(recorded.dataset, 2))
        assert found.assumed and not found.declared
        assert (found.position, found.angle) == (1e-4, 1e-3)

    def test_what_is_declared_of_the_noise_is_kept(self, recorded) -> None:
        dense = replace(recorded.dataset, noise=Noise(position=3e-5))
        assert sensor_noise(dense).position == 3e-5 and not sensor_noise(dense).assumed
        sparse = replace(thinned(recorded.dataset, 6), noise=Noise(position=3e-5))
        assert sensor_noise(sparse).position == 3e-5 and sensor_noise(sparse).assumed


def thinned(dataset, rows):
    """The dataset with so many poses a push, from an unknown sensor."""

    def fewer(pose):
        kept = np.linspace(0, len(pose.time) - 1, rows).round().astype(int)
        return Channel(pose.time[kept], pose.values[kept])

    trials = tuple(replace(trial, object_pose=fewer(trial.object_pose)) for trial in dataset.trials)
    return replace(dataset, noise=Noise(), trials=trials)


def test_starts_are_drawn_as_wide_as_a_mean_of_lasting_rows_is(recorded):
    observations = observe_all(recorded.dataset)[:1]
    assert observations[0].start_rows > 10
    noise = sensor_noise(recorded.dataset)
    lasting = replace(noise, lasting_position=Lasting(1.0, 1e4), lasting_angle=Lasting(1.0, 1e4))
    sure = Belief.learned(
        recorded.dataset, recorded.slider, recorded.truth[np.zeros(20, dtype=int)], np.full(20, 0.05),
        method="", seed=0, trials=[], settings={},
    )  # fmt: skip
    far, near = (drawn_ends(sure, observations, one).std(axis=0) for one in (lasting, noise))
    assert (far > 2.0 * near).all()


def test_ends_are_drawn_with_outlines_that_would_be_seen_as_the_given_one(recorded):
    """As if the finger were displaced, without any other noise."""
    observations = [replace(one, finger=None) for one in observe_all(recorded.dataset)[:4]]
    sure = Belief.learned(
        recorded.dataset, recorded.slider, recorded.truth[np.zeros(20, dtype=int)], np.full(20, 0.05),
        method="", seed=0, trials=[], settings={OUTLINE_ERROR: 4e-4},
    )  # fmt: skip
    drawn = drawn_ends(sure, observations, SensorNoise(0.0, 0.0, 0.0, True))
    ways = 4e-4 * outline_errors(20)
    ways -= ways.mean(axis=0)
    for b, observation in enumerate(observations):
        beside = [replace(observation.push, tip=observation.push.tip - way) for way in ways]
        ends = recorded.slider.rollout(recorded.truth, beside).end[0, :, :3]
        order = [np.argmin(np.abs(drawn[:, b] - end).sum(axis=1)) for end in ends]
        assert drawn[order, b] == pytest.approx(ends, abs=2e-6)
        assert ends.std(axis=0)[:2].max() > 5e-5


def test_errors_of_outlines_have_unit_variance_and_are_largest_at_few_places():
    for count in (20, 100):
        errors = outline_errors(count)
        assert errors.var(axis=0) == pytest.approx([1.0, 1.0], abs=0.05)
        assert errors.mean(axis=0) == pytest.approx([0.0, 0.0], abs=0.15)
        far = np.linalg.norm(errors, axis=1)
        assert (far > 2.4).sum() == count // 5 and far.max() < 2.5 * far.min() + 1e-12
