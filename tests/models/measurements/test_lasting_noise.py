"""Sensor noise that lasts from row to row, found while objects rest."""

from dataclasses import replace

import numpy as np
import pytest

from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.measurements import Channel, Noise, PushDataset, Trial
from slipmap.models.measurements.contact import contact_rows
from slipmap.models.measurements.dataset_check import check_dataset
from slipmap.models.measurements.lasting_noise import NONE_LASTS, Lasting, lasting_noise, rests_of
from slipmap.models.measurements.trial_checks import check_trials
from slipmap.models.objects import cells_from_polygon

SIGMA = np.array([2.5e-4, 2.5e-4, 2.6e-3])


def drifting(rng: np.random.Generator, rows: int, memory: float) -> np.ndarray:
    """(rows, 3) noise of standard deviation one; white if its memory, in rows, is 0."""
    kept = np.exp(-1.0 / memory) if memory else 0.0
    noise = rng.standard_normal((rows, 3))
    for k in range(1, rows):
        noise[k] = kept * noise[k - 1] + np.sqrt(1.0 - kept**2) * noise[k]
    return noise


def pushed_block(
    memory: float,
    *,
    creep: float = 0.0,
    count: int = 20,
    seed: int = 0,
    scale: float = 1.0,
    speed: float = 0.05,
) -> PushDataset:
    """Pushes of a block as an undeclared tracker sees them: 0.4 s of rest, 1 s of motion, 0.6 s of rest.

    Args:
        memory: of the tracker's noise, rows of 10 ms; 0 for white noise.
        creep: m by which the block creeps before every third push.
        scale: multiple of the usual noise.
        speed: of the finger, which touches the block after 0.4 s, m/s.
    """
    grid = cells_from_polygon([[-0.05, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.05, 0.03]])
    rng = np.random.default_rng(seed)
    t = np.arange(200) * 0.01
    trials = []
    for index in range(count):
        finger = np.clip(speed * (t - 0.4) + 0.01, 0.0, 0.06) - 0.06 - 0.01
        moved = np.maximum(finger + 0.06, 0.0) + creep * (index % 3 == 0) * np.minimum(t / 0.4, 1.0)
        finger = np.where(t > 1.5, finger[150] - 0.05 * (t - 1.5), finger)
        pose = np.column_stack([moved, 0 * t, 0 * t]) + scale * SIGMA * drifting(rng, len(t), memory)
        tip = np.column_stack([finger, 0 * t])
        trials.append(Trial(f"{index:03d}", "fit", Channel(t, pose), Channel(t, tip), None))
    return PushDataset(
        name="block", description="", grid=grid, height=None, mass=None, finger_radius=0.01, table=None,
        gravity=9.81, noise=Noise(), trials=tuple(trials), fingerprint="",
    )  # fmt: skip


def test_rests_are_the_rows_before_the_finger_comes_and_after_it_has_gone():
    dataset = pushed_block(0.0)
    before, after = rests_of(dataset, dataset.trials[0])
    assert 25 <= len(before) <= 40  # the finger touches the block at 0.4 s,
    assert 15 <= len(after) <= 25  # and is 2 mm away from 1.54 s on
    assert np.abs(before[:, 0]).max() < 4 * SIGMA[0] and np.ptp(after[:, 0]) < 8 * SIGMA[0]


@pytest.mark.parametrize("rows", [60, 300])
def test_outliers_are_no_noise_that_lasts(rows):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        worse = np.where(rng.random((20, rows, 1)) < 0.02, 10.0, 1.0)
        rests = SIGMA[0] * worse * rng.standard_normal((20, rows, 2))
        assert lasting_noise(list(rests), float(SIGMA[0]), 1e-4) == (pytest.approx(SIGMA[0]), NONE_LASTS)


@pytest.mark.parametrize("memory", [10.0, 25.0])
def test_noise_that_lasts_is_not_taken_for_the_little_that_neighbouring_rows_differ(memory):
    found = sensor_noise(pushed_block(memory))
    assert 0.7 * SIGMA[0] < found.position < 1.4 * SIGMA[0]
    assert 0.7 * SIGMA[2] < found.angle < 1.4 * SIGMA[2]
    # Their mean is hardly better than one of them.
    assert 1.0 < found.lasting_position.independent(28) < 6.0
    assert found.of_means(28)[0] > 0.4 * SIGMA[0]


@pytest.mark.parametrize("seed", range(4))
def test_white_noise_is_estimated_from_neighbouring_rows_alone(seed):
    dataset = pushed_block(0.0, seed=seed)
    found = sensor_noise(dataset)
    assert found.lasting_position == found.lasting_angle == NONE_LASTS
    assert found.position == pytest.approx(SIGMA[0], rel=0.25)
    assert (found.of_means([1, 4]) == found.of_poses / np.array([[1.0], [2.0]])).all()


def test_objects_that_creep_before_some_pushes_are_not_noisy():
    still, creeping = sensor_noise(pushed_block(0.0)), sensor_noise(pushed_block(0.0, creep=5e-3))
    assert creeping.position == pytest.approx(still.position, rel=0.1)
    lasting = sensor_noise(pushed_block(25.0, creep=5e-3))
    assert 0.7 * SIGMA[0] < lasting.position < 1.4 * SIGMA[0]


def test_few_or_short_rests_tell_nothing():
    assert lasting_noise([np.cumsum(np.ones((30, 2)), axis=0)] * 4, 0.1, 0.0) == (0.1, NONE_LASTS)
    assert lasting_noise([np.cumsum(np.ones((9, 2)), axis=0)] * 40, 0.1, 0.2) == (0.2, NONE_LASTS)


def test_declared_noise_stays_as_declared():
    declared = replace(pushed_block(25.0), noise=Noise(position=1e-4, angle=1e-3))
    found = sensor_noise(declared)
    assert (found.position, found.angle) == (1e-4, 1e-3)
    assert found.lasting_position == found.lasting_angle == NONE_LASTS


def test_independent_rows_follow_the_variance_of_a_mean():
    n, share, memory = 30, 0.8, 7.0
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    covariance = share * np.exp(-apart / memory) + (1.0 - share) * np.eye(n)
    assert Lasting(share, memory).independent(n) == pytest.approx(1.0 / covariance.mean())
    assert Lasting(share, memory).independent(1) == pytest.approx(1.0)


@pytest.mark.parametrize("memory", [0.0, 25.0])
def test_checks_allow_for_noise_that_lasts_as_for_white_noise(memory):
    dataset = pushed_block(memory, scale=8.0)
    rows = contact_rows(dataset, dataset.trials)
    assert [one.noise.position for one in rows] == pytest.approx([8.0 * SIGMA[0]] * 20, rel=0.4)
    assert all(one.allowed > 3e-3 + 2.0 * 8.0 * SIGMA[0] for one in rows)
    # The block rests at first, whatever its noise does.
    assert np.mean([one.pressed[one.time < 0.3].mean() for one in rows]) < 0.1
    kept, warnings = check_trials(dataset, dataset.trials, "here")
    assert len(kept) == 20 and warnings == []


def test_noise_that_lasts_is_no_way_that_an_object_coasts():
    dataset = pushed_block(25.0, scale=4.0)
    assert check_dataset(dataset).coverage.coasting == 0


def test_slow_pushes_touch_all_the_same():
    """Rows 0.1 s apart have most of such noise in common, so that 1 mm of motion between them shows."""
    dataset = pushed_block(25.0, scale=1.4, speed=0.01)
    rows = contact_rows(dataset, dataset.trials)
    assert 4.0 * rows[0].noise.position > 1e-3
    assert np.mean([one.pressed[(one.time > 0.6) & (one.time < 1.3)].mean() for one in rows]) > 0.8
