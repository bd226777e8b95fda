"""Differences of angles are the short way round."""

import numpy as np
import pytest

from slipmap.models.geometry import angle_between


def test_angles_wrap_to_half_a_turn():
    assert angle_between(3.0, -3.0) == pytest.approx(6.0 - 2 * np.pi)
    assert angle_between(np.array([np.pi, 0.2]), 0.0) == pytest.approx([-np.pi, 0.2])


def test_the_difference_turns_one_into_the_other():
    one, other = np.random.default_rng(0).uniform(-20, 20, (2, 100))
    between = angle_between(one, other)
    assert np.abs(between).max() <= np.pi
    assert np.exp(1j * (other + between)) == pytest.approx(np.exp(1j * one))
