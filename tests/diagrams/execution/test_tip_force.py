"""The force at the finger from joint torques."""

import numpy as np
import pytest

from slipmap.diagrams.execution.arm_motion import FingerKinematics, tip_force
from slipmap.diagrams.station.arm import arm_model


@pytest.fixture(scope="module")
def jacobian():
    kinematics = FingerKinematics(arm_model())
    return kinematics.jacobian(kinematics.inverse(np.array([0.05, 0.1, 0.004])))


@pytest.mark.parametrize("height", [0.0, 0.02, 0.06])
def test_force_is_found_wherever_it_acts_on_the_finger(jacobian, height):
    force = np.array([6.0, -8.0, 1.0])  # of the finger on the object
    moment = np.cross([0.0, 0.0, height], -force)
    torque = jacobian.T @ np.concatenate([moment, -force])
    np.testing.assert_allclose(tip_force(jacobian, torque), force, atol=0.05 * np.linalg.norm(force))


def test_noisy_torques_give_an_unbiased_force(jacobian):
    force = np.array([5.0, 0.0, 0.0])
    rng = np.random.default_rng(0)
    torque = jacobian.T @ np.concatenate([np.zeros(3), -force])
    found = np.array([tip_force(jacobian, torque + rng.normal(0, 0.1, 7)) for _ in range(400)])
    np.testing.assert_allclose(found.mean(axis=0), force, atol=0.1)
    assert found.std(axis=0).max() < 1.0
