import numpy as np
import pytest

from slipmap.models.measurements import read_dataset
from slipmap.models.measurements.motion import initial_twist

LEVEL = np.array([0.25e-3, 0.25e-3, 2.6e-3])  # m, m, rad


def gaussian(rng, rows):
    return rng.normal(size=(rows, 3)) * LEVEL


def wandering(rng, rows):
    """First-order process with a correlation of ten rows."""
    steps = rng.normal(size=(rows, 3))
    for row in range(1, rows):
        steps[row] = 0.9 * steps[row - 1] + np.sqrt(1.0 - 0.81) * steps[row]
    return steps * LEVEL


def flipping(rng, rows):
    """A tracker that jumps between two solutions, as in mcube_steel."""
    return (rng.random((rows, 1)) < 0.3) * np.array([1e-4, 5e-5, 3e-3]) + 0.01 * gaussian(rng, rows)


def spiky(rng, rows):
    noise = gaussian(rng, rows)
    noise[rng.integers(0, rows // 4, size=2)] += 40.0 * LEVEL
    return noise


def jittered_time(rng, step, rows):
    return 1.46e9 + step * (np.arange(rows) + rng.uniform(0.0, 0.2, rows))


@pytest.mark.parametrize("rows", [12, 80])
@pytest.mark.parametrize("noise", [gaussian, flipping, spiky])
@pytest.mark.parametrize("step", [0.004, 0.01, 1 / 60])
def test_rest_is_exactly_zero_whatever_the_noise(noise, step, rows):
    rng = np.random.default_rng(1)
    for _ in range(50):
        assert not initial_twist(jittered_time(rng, step, rows), noise(rng, rows)).any()


def later_push(rng, time, step):
    """Poses that rest for 3 to 15 rows and then move at a constant twist."""
    pushed = np.maximum(0.0, time - time[0] - rng.uniform(3.0, 15.0) * step)
    return np.outer(pushed, rng.normal(size=3) * [0.1, 0.1, 1.0])


@pytest.mark.parametrize("push", [lambda rng, time, step: 0.0, later_push])
@pytest.mark.parametrize("step", [0.004, 0.01, 1 / 60])
def test_a_wandering_tracker_hardly_ever_passes_for_motion(step, push):
    rng = np.random.default_rng(1)
    times = [jittered_time(rng, step, 80) for _ in range(150)]
    moving = [initial_twist(time, wandering(rng, 80) + push(rng, time, step)).any() for time in times]
    assert np.mean(moving) <= 0.01


@pytest.mark.parametrize("step", [0.004, 0.01, 1 / 60])
def test_an_object_that_is_pushed_later_rests_at_first(step):
    rng = np.random.default_rng(2)
    for _ in range(50):
        time = jittered_time(rng, step, 80)
        pose = later_push(rng, time, step)
        assert not initial_twist(time, pose + gaussian(rng, 80)).any()
        assert not initial_twist(time, pose).any()


def test_an_onset_between_the_second_and_third_row_without_noise_is_rest():
    time = np.arange(60) / 60
    pushed = np.maximum(0.0, time - 1.2 / 60)[:, None] * [0.1, 0.0, 0.5]
    assert not initial_twist(time, pushed).any()


@pytest.mark.parametrize("noise", [gaussian, wandering, flipping])
@pytest.mark.parametrize("step", [0.004, 0.01, 1 / 60])
def test_a_slide_is_found_and_measured(noise, step):
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(30):
        time = jittered_time(rng, step, 80)
        twist = np.array([0.4, -0.3, 2.0])
        duration = 0.25  # at 2 m/s², to rest
        since = np.minimum(time - time[0], duration)[:, None]
        pose = twist * (since - since**2 / (2.0 * duration)) + [0.3, 0.1, -2.0]
        errors.append(initial_twist(time, pose + noise(rng, 80)) - twist)
    assert np.all(np.median(np.abs(errors), axis=0) < [0.03, 0.03, 0.3])
    assert np.all(np.abs(np.mean(errors, axis=0)) < [0.02, 0.02, 0.2])


def test_the_velocity_is_from_the_longest_window_though_a_shorter_one_scatters_by_chance():
    rng = np.random.default_rng(7)
    time, errors = np.arange(60) * 0.005, []
    for speed in rng.uniform(0.3, 0.8, 200):
        since = np.minimum(time, speed / 3.0)[:, None]
        pose = (speed * since - 1.5 * since**2) * [1.0, 0.0, 0.0]
        noise = rng.normal(size=pose.shape) * [1e-4, 1e-4, 5e-4]
        errors.append(initial_twist(time, pose + noise)[0] - speed)
    assert np.sqrt(np.mean(np.square(errors))) < 7e-3  # 12 mm/s from the first window that fits


def test_a_slide_without_noise_is_exact_to_a_percent():
    time = np.arange(80) * 0.005
    since = np.minimum(time, 0.2)[:, None]
    twist = np.array([0.5, 0.2, -3.0])
    pose = twist * (since - since**2 / 0.4)
    np.testing.assert_allclose(initial_twist(time, pose), twist, rtol=0.01)


def test_one_wrong_row_does_not_spoil_the_velocity():
    rng = np.random.default_rng(4)
    time = np.arange(80) * 0.005
    pose = np.outer(time, [0.5, 0.0, 1.0]) + 0.1 * gaussian(rng, 80)
    pose[3] += [0.02, -0.02, 0.5]
    np.testing.assert_allclose(initial_twist(time, pose), [0.5, 0.0, 1.0], atol=0.02)


def test_five_rows_are_too_few_to_tell():
    time = np.arange(6) * 0.01
    pose = np.outer(time, [0.5, 0.0, 0.0])
    assert not initial_twist(time[:5], pose[:5]).any()
    assert initial_twist(time, pose)[0] == pytest.approx(0.5)


PUSHED = ["bullet/hammer_p0", "effects/public-tilt", "real/mcube_steel", "real/mit_plywood_hex"]


@pytest.mark.parametrize("name", PUSHED)
def test_shipped_pushes_start_at_rest(shared_data, name):
    for trial in read_dataset(shared_data / name).trials:
        assert not trial.initial_velocity().any(), trial.name


def test_the_cube_enters_at_its_speed_and_slows_down_evenly(shared_data):
    for trial in read_dataset(shared_data / "real/cube_slides").trials:
        velocity = trial.initial_velocity()
        assert 0.5 < np.hypot(*velocity[:2]) < 0.95
        # independent of the fit: mean velocity over 27 ms, less what its friction takes in half of that
        time, pose = trial.object_pose.time[:5], trial.object_pose.values[:5]
        mean = (pose[-1] - pose[0]) / (time[-1] - time[0])
        lost = 2.2 * 0.5 * (time[-1] - time[0]) * mean[:2] / np.hypot(*mean[:2])
        np.testing.assert_allclose(velocity[:2], mean[:2] + lost, atol=0.02)
        assert velocity[2] == pytest.approx(mean[2], abs=0.3)
