import numpy as np
import pytest

from slipmap.models.measurements import Channel, Trial, finger_path, pose_times, wrench_samples


def trial(tip_time, wrench_time=None, start=1000.0, rows=11):
    time = start + 0.1 * np.arange(rows)
    tip_time = np.asarray(tip_time, dtype=float)
    tip = Channel(tip_time, np.column_stack([tip_time - start, 5.0 + 0.0 * tip_time]))
    wrench = None
    if wrench_time is not None:
        wrench = Channel(np.asarray(wrench_time), np.outer(wrench_time, [1.0, 2.0, 3.0]))
    return Trial("a.json", "fit", Channel(time, np.zeros((rows, 3))), tip, wrench)


def test_time_zero_is_the_first_pose():
    np.testing.assert_allclose(pose_times(trial([1000.0])), 0.1 * np.arange(11), atol=1e-9)


def test_finger_keeps_its_own_stamps_and_gains_the_ends():
    time, path = finger_path(trial([999.95, 1000.2, 1000.7, 1001.3]))
    np.testing.assert_allclose(time, [0.0, 0.2, 0.7, 1.0], atol=1e-9)
    np.testing.assert_allclose(path[:, 0], time, atol=1e-9)  # linear, also at the added ends
    np.testing.assert_allclose(path[:, 1], 5.0)


def test_finger_is_held_before_its_first_and_after_its_last_row():
    time, path = finger_path(trial([1000.3, 1000.6]))
    np.testing.assert_allclose(time, [0.0, 0.3, 0.6, 1.0], atol=1e-9)
    np.testing.assert_allclose(path[:, 0], [0.3, 0.3, 0.6, 0.6], atol=1e-9)


@pytest.mark.parametrize(
    "stamps", [[1000.0, 1001.0], [1000.5], [990.0, 991.0], [1005.0], [999.0, 1002.0], [999.2, 999.5, 1000.5]]
)
def test_finger_path_covers_exactly_the_span(stamps):
    time, path = finger_path(trial(stamps))
    assert time[0] == 0.0 and time[-1] == pose_times(trial(stamps))[-1]
    assert np.all(np.diff(time) > 0.0) and path.shape == (len(time), 2) and np.isfinite(path).all()


def test_rounding_of_large_stamps_makes_no_time_twice():
    start = 1460088637.218
    time = start + 1e-6 * np.arange(11)
    tip = Channel(time, np.column_stack([time - start, time - start]))
    moving = Trial("a", "fit", Channel(time, np.zeros((11, 3))), tip)
    assert np.all(np.diff(finger_path(moving)[0]) > 0.0)


def test_wrench_rows_keep_their_stamps_within_the_span():
    assert wrench_samples(trial([1000.0])) is None
    samples = wrench_samples(trial([1000.0], [999.9, 1000.25, 1000.9, 1001.2]))
    assert samples is not None
    np.testing.assert_allclose(samples[0], [0.25, 0.9], atol=1e-9)
    np.testing.assert_allclose(samples[1][:, 1], [2000.5, 2001.8])
