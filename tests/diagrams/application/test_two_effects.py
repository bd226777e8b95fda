"""Two effects that are hidden at once are found together, with the parameters of one fit."""

from __future__ import annotations

import numpy as np
import pytest
from hidden_effects import DRAG, LATENCY, TILT, late_and_oily_pushes, tilted_and_oily_pushes, tilted_pushes

from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.diagnosis import judging, procedure as steps
from slipmap.models.inference.diagnosis.outcomes import two_at_once
from slipmap.models.inference.diagnosis.procedure import diagnose
from slipmap.models.inference.diagnosis.results import Diagnosis


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    """A diagnosis of pushes on a table that is neither level nor dry, chance simulated."""
    return diagnose(tilted_and_oily_pushes(), draws=99)


def test_both_effects_are_named(found):
    assert (found.verdict, found.together) == ("effect", True)
    assert set(found.effects) == {"table_tilt", "viscous_friction"}
    assert found.sentence == "The model lacks two effects at once: table_tilt and viscous_friction."
    rejected = {candidate.name: candidate.rejected_by for candidate in found.candidates}
    assert rejected["table_tilt"] == "viscous_friction"  # the tilt alone leaves the oil
    assert found.after.total_misfit < 0.2 * found.before.total_misfit


def test_the_parameters_are_those_of_the_common_fit(found):
    estimates = {(p.effect, p.name): p for p in found.parameters}
    common = [(effect.name, p.name) for effect in found.best.effects for p in effect.parameters]
    assert list(estimates) == common
    # Sizes are told by another likelihood than the one that found the effects, of the same common fit.
    for parameter, value in zip(found.parameters, found.best.values, strict=True):
        assert parameter.low < value < parameter.high
    for name, slope in TILT.items():
        assert estimates["table_tilt", name].value == pytest.approx(slope, abs=0.003)
    assert estimates["viscous_friction", "drag_per_area"].value == pytest.approx(DRAG, rel=0.15)
    document = found.to_json()["parameters"]
    assert {effect: list(numbers) for effect, numbers in document.items()} == {
        "table_tilt": ["down_x", "down_y"],
        "viscous_friction": ["drag_per_area"],
    }


def test_a_second_effect_is_named_beside_one_that_explains_nearly_all(monkeypatch):
    """By the share of the gain that is left, the lag alone explains these pushes: 41 of 12 000 nats."""
    asked, objections = [], judging.objections

    def judged(rivals, rough, baseline):
        asked.append((rough, baseline))
        return objections(rivals, rough, baseline)

    monkeypatch.setattr(judging, "objections", judged)
    monkeypatch.setattr(steps.Inquiry, "rough", False)
    found = diagnose(late_and_oily_pushes(), draws=99)
    assert found.sentence == "The model lacks two effects at once: sensor_latency and viscous_friction."
    assert {c.name for c in found.candidates if c.in_set} == set(found.effects)
    assert found.after.total_misfit < 0.1 * found.before.total_misfit
    estimates = {p.effect: p for p in found.parameters}
    assert estimates["sensor_latency"].low < LATENCY < estimates["sensor_latency"].high
    assert estimates["viscous_friction"].low < DRAG < estimates["viscous_friction"].high
    # Both must be clearly better than the lag alone, which is already better than nothing.
    (loosely, without), (clearly, with_lag) = asked
    assert (loosely, clearly) == (False, True)
    assert with_lag.total_misfit < 0.6 * without.total_misfit


def test_of_two_effects_one_that_may_be_zero_is_dropped(monkeypatch):
    """The other one is named alone, since the locked pushes support it."""
    (friction,) = effects_named(["viscous_friction"])
    run = steps.Inquiry.run

    def find_both(inquiry):
        run(inquiry)
        tilt = inquiry.refits.fits["table_tilt"]
        values = [*tilt.values, *friction.start_values(inquiry.scene)[0]]
        both = (*tilt.effects, friction)
        error = tilt.likelihood.error
        return two_at_once([inquiry.fitter.with_effects(both, error, tilt, np.array(values), afresh=True)])

    monkeypatch.setattr(steps.Inquiry, "run", find_both)
    found = diagnose(tilted_pushes(), draws=99)
    assert (found.verdict, found.effects, found.together) == ("effect", ("table_tilt",), False)
    assert found.objections == {
        "table_tilt and viscous_friction": "the 90 % interval of viscous_friction is consistent"
        " with no effect at all"
    }
    assert [candidate.name for candidate in found.candidates if candidate.in_set] == ["table_tilt"]
    assert found.after.total_misfit < 0.6 * found.before.total_misfit
