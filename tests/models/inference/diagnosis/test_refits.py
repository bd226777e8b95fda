"""Refits of the model with an effect, and without one, from the maps of another refit."""

from types import SimpleNamespace

import numpy as np
import pytest

from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.diagnosis.fitting import Fitter
from slipmap.models.inference.diagnosis.refits import (
    EffectSearch,
    Refits,
    _from_maps_of,
    better_base,
)
from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.inference.observations import observe_all, to_learn_from
from slipmap.models.physics.rollout import RolloutError
from tests.models.inference.test_mixture import made_by


def quiet(done, total):
    """Show no progress."""


FAILURES = [np.linalg.LinAlgError("not positive definite"), RolloutError("diverges")]


@pytest.mark.parametrize("failure", FAILURES)
def test_maps_from_which_no_fit_gets_away_are_no_better(failure):
    """Without the effect, maps that were bent around it may predict so badly that no step can be computed."""

    def base(error, start):
        raise failure

    plain = SimpleNamespace(cost=100.0, likelihood=SimpleNamespace(error=None))
    refits = Refits(plain, {"table_tilt": SimpleNamespace(cost=10.0)}, {"table_tilt": 90.0})
    assert better_base(SimpleNamespace(base=base), refits) is None


def test_a_tether_is_found_from_the_maps_of_the_tilt_that_it_looks_like(recorded):
    """From any of its starts: those that lead farthest are followed."""
    tilt, tether = effects_named(["table_tilt", "tether"])
    truth = np.array([4.0, 0.35, 0.2, 0.2, 0.0, 0.0])
    dataset = made_by(recorded, values={"tether": tuple(truth)}, heldout=0)
    observations = to_learn_from(observe_all(dataset))
    fitter = Fitter(dataset, observations, sensor_noise(dataset))
    base = fitter.from_scratch(quiet)
    error = base.likelihood.error
    tilted = fitter.with_effects((tilt,), error, base, np.zeros(2), afresh=True)
    right = fitter.with_effects((tether,), error, tilted, truth)
    starts = tether.start_values(fitter.scene(base))
    found = fitter.from_maps_of(tilted, tether, starts, np.inf)
    assert found.effects == (tether,)
    assert found.cost < tilted.cost - 5.0 < base.cost - 100.0
    assert found.cost < right.cost + 3.0


def test_patches_are_found_from_both_signs_and_radii(recorded):
    """From one sign or one radius alone, a gradient or a narrow patch takes its place."""
    (field,) = effects_named(["table_friction_field"])
    for patch in [(-0.8, -0.011, -0.088, 0.128), (0.8, -0.105, 0.034, 0.182), (-0.8, 0.041, 0.035, 0.154)]:
        truth = (0.0, 0.0, *patch)
        dataset = made_by(recorded, values={"table_friction_field": truth}, heldout=0)
        search = EffectSearch.of(dataset, to_learn_from(observe_all(dataset)), quiet)
        found = search.find([field], np.random.default_rng(0), quiet)
        error = found.likelihood.error
        right = search.fitter.with_effects((field,), error, found, np.array(truth))
        assert found.cost < right.cost + 3.0


@pytest.mark.parametrize("failure", FAILURES)
@pytest.mark.parametrize("starts", [1, 2])
def test_the_better_of_both_refits_is_kept(failure, starts):
    """The best one is refitted, from the maps without effects, only where it has several starts."""
    names = ["table_tilt", "tether", "skate", "viscous_friction", "loose_mass"]
    effects = {effect.name: effect for effect in effects_named(names)}

    def fitted(name: str, cost: float) -> SimpleNamespace:
        return SimpleNamespace(effects=(effects[name],), cost=cost)

    found = {"table_tilt": 10.0, "tether": 50.0, "skate": 40.0, "loose_mass": 45.0}
    again = {"tether": 5.0, "skate": 60.0, "viscous_friction": 70.0, "table_tilt": 9.0}
    asked = []
    base = SimpleNamespace(effects=(), cost=60.0)

    def from_maps_of(near, effect, starts, worth):
        asked.append(effect.name)
        assert worth == 10.0 + 0.7 * 50.0
        assert near is (base if effect.name == "table_tilt" else before["table_tilt"])
        if effect.name not in again:
            raise failure
        return fitted(effect.name, again[effect.name])

    before = {name: fitted(name, cost) for name, cost in found.items()}
    scene = SimpleNamespace(center=(0.0, 0.0), reach=0.1)
    fitter = SimpleNamespace(from_maps_of=from_maps_of)
    for effect in effects.values():
        effect.start_values = lambda scene: np.zeros((starts, 1))
    try:
        after = _from_maps_of(fitter, base, before["table_tilt"], before, list(effects.values()), scene)
    finally:
        for effect in effects.values():
            del effect.start_values
    better = {"tether": 5.0, "viscous_friction": 70.0} | ({"table_tilt": 9.0} if starts > 1 else {})
    assert sorted(asked) == sorted(set(names) - ({"table_tilt"} if starts == 1 else set()))
    assert {name: one.cost for name, one in after.items()} == found | better
