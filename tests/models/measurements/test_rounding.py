"""Steps of rounded poses are found, and count as noise; even motion and fine rounding do not."""

from dataclasses import replace

import numpy as np
import pytest
from straight_pushes import straight_pushes

from slipmap.models.measurements.contact import contact_rows
from slipmap.models.measurements.motion import rounding_noise, rounding_steps
from slipmap.models.measurements.trial import Channel

TIME = np.arange(0.0, 3.0, 0.01)


def tracks(noise=0.0, count=5):
    """A pose that speeds up and turns, (300, 3) each."""
    rng = np.random.default_rng(0)
    way = np.clip(TIME - 0.5, 0.0, 2.0) ** 2 * 0.02
    return [
        np.column_stack([np.cos(turn) * way, np.sin(turn) * way, 3.0 * way + turn])
        + rng.normal(0.0, max(noise, 1e-12), (len(TIME), 3))
        for turn in 0.4 + np.arange(count)
    ]


def rounded(track, step):
    return np.round(track / step) * step


@pytest.mark.parametrize("noise", [0.0, 2e-4])
@pytest.mark.parametrize("step", [[1e-3, 1e-3, 0.0175], [2e-3, 5e-4, 1e-5]])
def test_steps_are_found(step, noise):
    told = np.where(np.array(step) > 1e-4, step, 0.0)
    found = rounding_steps([rounded(track, np.array(step)) for track in tracks(noise)])
    np.testing.assert_allclose(found, told, rtol=1e-3)


def test_a_fast_object_skips_values():
    way = np.outer(np.arange(40.0), [2.4e-3, 3.7e-3, 5.3e-3])
    poses = rounded(way, np.array([1e-3, 1e-3, 1e-3]))
    np.testing.assert_allclose(rounding_steps([poses]), 1e-3, rtol=1e-3)


@pytest.mark.parametrize("poses", [tracks(2e-4), tracks(0.0), [np.outer(TIME, [0.08, 0.02, 1.0])], []])
def test_other_poses_have_no_steps(poses):
    assert not rounding_steps(poses).any()


def test_even_pushes_have_no_steps():
    assert not rounding_steps([trial.object_pose.values for trial in straight_pushes(8).trials]).any()


def test_rounding_is_noise():
    step = np.array([1e-3, 1e-3, 0.02])
    poses = rounded(tracks()[0], step)
    np.testing.assert_allclose(rounding_noise([poses]), step / np.sqrt(12.0), rtol=1e-3)
    dataset = straight_pushes(1)
    (rows,) = contact_rows(dataset, [replace(dataset.trials[0], object_pose=Channel(TIME, poses))])
    assert rows.noise.position >= 0.99 * step[0] / np.sqrt(12.0)
    assert rows.noise.angle >= 0.99 * step[2] / np.sqrt(12.0)
