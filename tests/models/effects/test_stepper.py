"""Single steps: the same motion as a rollout, and derivatives with respect to all inputs of a step."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from pushed_with_effects import (
    BLOCK,
    EFFECTS,
    RADIUS,
    SHOWN,
    H,
    coasting,
    plain_maps,
    slider_of,
    sliding_push,
    with_values,
)

from slipmap.models.physics.rollout import Maps, Push, RolloutError
from slipmap.models.physics.stepper import Stepper

WRENCH = np.array([0.1, 0.2, 0.01, 0.02, 0.003])
CASES = [None, *SHOWN]


def model_of(name: str | None) -> tuple[Stepper, Maps]:
    effects = [] if name is None else [EFFECTS[name]]
    maps = plain_maps() if name is None else with_values(plain_maps(), SHOWN[name])
    return Stepper(BLOCK, RADIUS, H, effects), maps


def state_after(stepper: Stepper, maps: Maps, push: Push, steps: int) -> np.ndarray:
    models = stepper.models(maps)
    state = stepper.start(models, push.start_pose, push.start_twist[None])
    for k in range(steps):
        state, _ = stepper.step(models, state, tip=push.tip[k : k + 2], time=k * H, order=push.order)
    return state


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("push", [sliding_push(), coasting()], ids=["pushed", "thrown"])
def test_steps_end_where_the_rollout_ends(name: str | None, push: Push) -> None:
    stepper, maps = model_of(name)
    end = slider_of(stepper.effects).rollout(maps, [push]).end[0, 0]
    state = state_after(stepper, maps, push, len(push.tip) - 1)[0]
    measured = stepper.program.measured
    reported = state[:3] if measured is None else measured(*state[:3], maps.effects[0])[0]
    assert np.abs(reported - end[:3]).max() < 1e-12
    assert np.abs(state[3:6] - end[3:]).max() < 1e-11


@pytest.mark.parametrize("name", CASES)
def test_jacobian_agrees_with_differences(name: str | None) -> None:
    """In the middle of a push, with a wrench as well."""
    stepper, maps = model_of(name)
    push = sliding_push()
    n, P, Z = len(BLOCK), stepper.program.parameters, stepper.size
    k = 40
    state = state_after(stepper, maps, push, k)[0]
    tip = push.tip[k : k + 2].ravel()
    ends = np.cumsum([n, n, 1, 6, P, Z - 6, 5])
    values = maps.effects[0] if name else np.zeros(0)
    at = np.concatenate([maps.mass[0], maps.mu[0], maps.mu_finger, state[:6], values, state[6:], WRENCH, tip])

    def step(row: np.ndarray, derive: bool = False) -> tuple[np.ndarray, np.ndarray]:
        mass, mu, finger, motion, effects, memory, wrench, track = np.split(row, ends)
        models = stepper.models(Maps(mass, mu, finger, effects[None]))
        states = np.concatenate([motion, memory])[None]
        track = track.reshape(2, 2)
        after, jacobian = stepper.step(
            models, states, wrench=wrench, tip=track, time=k * H, order=4.0, derive=derive
        )
        return after[0], jacobian

    jacobian = step(at, derive=True)[1][0]
    assert jacobian.shape == (Z, len(at))
    h = np.maximum(1e-6 * np.abs(at), 1e-8)
    h[ends[-1] :] = 1e-9
    found = np.empty_like(jacobian)
    for j, shift in enumerate(np.diag(h)):
        far, near = (
            step(at + 2 * shift)[0] - step(at - 2 * shift)[0],
            step(at + shift)[0] - step(at - shift)[0],
        )
        found[:, j] = (8 * near - far) / 12 / h[j]
    # Rounding of the differences, which are between numbers of the size of the state.
    rounding = 1e-14 * np.maximum(np.abs(state), 1.0)[:, None] / h
    assert (np.abs(found - jacobian) < 2e-4 * np.abs(jacobian).max(axis=0) + 3 * rounding).all()
    assert np.abs(jacobian[3:6, ends[-1] :]).max() > 1.0  # the finger touches the object


def test_many_models_step_as_each_alone() -> None:
    stepper, maps = model_of("loose_mass")
    push = sliding_push()
    factors = np.linspace(0.8, 1.2, 5)[:, None]
    every = Maps(maps.mass * factors, maps.mu / factors, np.full(5, 0.2), np.repeat(maps.effects, 5, axis=0))
    together = state_after(stepper, every, push, 30)
    alone = np.concatenate([state_after(stepper, every[k], push, 30) for k in range(5)])
    assert np.abs(together - alone).max() < 1e-12
    assert np.ptp(together[:, 2]) > 1e-4


def test_a_pickled_stepper_steps_alike() -> None:
    stepper, maps = model_of("load_transfer")
    push = sliding_push()
    copy = pickle.loads(pickle.dumps(stepper))
    assert np.array_equal(state_after(stepper, maps, push, 10), state_after(copy, maps, push, 10))


def test_impossible_numbers_are_told() -> None:
    stepper, maps = model_of(None)
    models = stepper.models(maps)
    state = stepper.start(models, np.zeros(3))
    with pytest.raises(RolloutError, match=r"model 0: the step from t = 0\.3 s"):
        stepper.step(models, state, wrench=np.array([np.nan, 0, 0, 0, 0]), time=0.3)
    with pytest.raises(ValueError, match="step h must be positive"):
        Stepper(BLOCK, RADIUS, 0.0)
    with pytest.raises(ValueError, match=r"step h must be at most 0\.1 s, got 0\.5 s"):
        Stepper(BLOCK, RADIUS, 0.5)
    with pytest.raises(ValueError, match="finger radius is 8 m; no finger is that thick"):
        Stepper(BLOCK, 8.0, 0.005)
    with pytest.raises(ValueError, match="maps have 3 effect parameters, the model has 0"):
        stepper.models(with_values(maps, [1.0, 2.0, 3.0]))
